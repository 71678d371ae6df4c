"""Where a further photograph of the scene was taken from, or why that cannot be told.

    place = locate(world, Taken("x", photograph, camera, lens_known=False), posed)

Two ways propose poses: features that posed photographs share with it (features.py), and its straight edges
(directions.py, positions.py), for plain rooms have few features. The edges of the model then decide, as they do for the
pair (lib/vision/refinement), and what the photographs show at the same places of the model must be alike (likeness.py).
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from lib.given.cameras import Camera, matrix_from_rt
from lib.given.image import Photograph
from lib.vision.corners.lines import segments
from lib.vision.location import directions, features, likeness, positions
from lib.vision.location.positions import Room
from lib.vision.location.straight import straight_edges
from lib.vision.orientation import match
from lib.vision.recognition.closed_form import DISTINCT, DISTINCT_RAD, Pose
from lib.vision.recognition.recognise import Recognition
from lib.vision.refinement import words
from lib.vision.refinement.edges import model_edges
from lib.vision.refinement.pose import refine
from lib.vision.refinement.rig import Side

JUDGED, AGREED = 4, 2  # starts that the model's edges judge; where two ways of finding them agree on the best
START_RAD, START_PART, START_FOCAL = 0.01, 0.01, 0.05  # one sigma of a start; of the depth, of the focal length
FIRST_FOCAL = 1.2  # of the longer side, COLMAP's for an unknown lens
FOCALS = FIRST_FOCAL * np.exp(0.15 * np.arange(-5, 6))  # that are tried there
TRIED = 3  # of them, that places are compared with
LENS_PX, CENTRE_PART = 0.1, 0.005  # what is known of a given lens; of the principal point of another, of the width
ALIKE = 0.8  # the least likeness of what two photographs show at the same places
APART = 0.5  # of a rival's unlikeness, that the pose's may be at most
UNKNOWN_FOCAL = 0.05  # sigma of a focal length, relative, with which a pose is told


class Known(NamedTuple):
    """A posed photograph: of `likeness.Known`, and grey (H, W) uint8."""

    name: str
    seen: likeness.Known
    grey: np.ndarray


class Taken(NamedTuple):
    """A photograph without a pose.  camera : Camera, of which K and the size count;  lens_known : or K is a guess

    other_lamps : other lamps shine than in the posed photographs
    """

    name: str
    photograph: Photograph
    grey: np.ndarray
    camera: Camera
    lens_known: bool
    other_lamps: bool = False


@dataclass(frozen=True, eq=False)
class World:
    """The model, its edges, their directions, and the room that the posed photographs show."""

    model: object
    edges: object
    directions: np.ndarray
    room: Room

    @classmethod
    def of(cls, model, cameras):
        """cameras : of the posed photographs"""
        edges = model_edges(model)
        shown = [camera.centre[None] for camera in cameras]
        for camera in cameras:
            step = max(camera.width // 64, 1)
            q = camera.pixels()[step // 2 :: step, step // 2 :: step].reshape(-1, 2)
            shown.append(features.on_model(model, camera, q, q).p)
        return cls(model, edges, directions.of_model(edges), Room.of(model, edges, np.concatenate(shown)))


@dataclass(frozen=True, eq=False)
class Place:
    """What was found.

    camera : posed, or None;  why : "" or the reason for none, with the figures
    covariance : (6, 6) of (omega, tau): T = exp(omega, tau) T_hat, camera's axes, rad and m
    focal_sigma : of an unknown lens, as a part of it, else None;  rms_px : of the edges
    support, evidence, needed : share of the model's edges that are there, what it is worth, what it must be, nats
    likeness : of what it and posed photographs show at the same places, 0 where they share too few
    matches : features that it shares with posed photographs, {name: how many agree with the pose}
    ambiguous : of lib/vision/refinement
    """

    name: str
    camera: Camera | None
    why: str
    covariance: np.ndarray | None = None
    focal_sigma: float | None = None
    rms_px: float | None = None
    support: float = 0.0
    evidence: float = 0.0
    needed: float = 0.0
    likeness: float = 0.0
    matches: dict | None = None
    ambiguous: tuple = ()


def locate(world, taken, known) -> Place:
    """The pose of one photograph.  known : list of Known, posed photographs"""
    shared = {one.name: _shared(world, one, taken) for one in known}
    by_features = _by_features(taken, shared)
    by_edges, compared = _by_edges(world, taken, by_features)
    if not by_features and not by_edges:
        most = max((len(seen.q) for seen in shared.values()), default=0)
        return Place(
            taken.name,
            None,
            f"nothing to begin with: it shares {most} features at most with a posed photograph, "
            f"{features.LEAST} that agree are needed, and its straight edges show no two directions of the model",
        )
    soft = likeness.blurred(taken.photograph)
    alike = lambda camera: likeness.likeness(world.model, [one.seen for one in known], soft, camera)
    depth = _depth(world, [*by_features, *by_edges][0])
    starts = _chosen(taken, by_features, by_edges, alike, depth)
    found = Recognition(
        tuple(_pose(start, taken, depth) for start in starts),
        "unproved",
        f"{compared} poses were compared",
        np.zeros(0),
        {"chance": math.log(max(compared, 1))},
    )
    side = Side(replace(taken.camera, T_cam_world=starts[0].T), taken.photograph)
    lens_px = LENS_PX if taken.lens_known else CENTRE_PART * taken.camera.width
    result = refine(
        world.model,
        [side],
        found,
        lens_px=lens_px,
        ln_hypotheses=found.counts["chance"],
        is_zoom=not taken.lens_known,
    )
    camera = result.cameras[0]
    like = alike(camera)
    place = Place(
        taken.name,
        camera,
        "",
        result.covariance,
        result.focal_sigma,
        result.rms_px,
        result.support,
        result.evidence,
        result.needed,
        like,
        {name: features.agreeing(seen, camera) for name, seen in shared.items()},
        result.ambiguous,
    )
    why = _refusal(taken, found, result, place, alike)
    return replace(place, camera=None, why=why) if why else place


def _shared(world, one, taken):
    """Features that a posed photograph and this one share, on the model."""
    q_known, q = match(one.grey, taken.grey)
    return features.on_model(world.model, one.seen.camera, q_known, q)


def _by_features(taken, shared):
    """Starts from the features of all posed photographs together, and of each alone."""
    together = features.Seen(*(np.concatenate(x) for x in zip(*shared.values(), strict=True)))
    sets = [together, *(shared.values() if len(shared) > 1 else ())]
    starts = [features.absolute_pose(seen, taken.camera, taken.lens_known) for seen in sets]
    return sorted((start for start in starts if start), key=lambda start: -start.agree)


def _by_edges(world, taken, by_features):
    """(starts from straight edges, best first; how many poses were compared)."""
    clear, lines = segments(taken.photograph), straight_edges(taken.photograph)
    longer = max(taken.camera.width, taken.camera.height)
    focals = [taken.camera.K[0, 0]]
    if not taken.lens_known:
        focals += [start.focal_px for start in by_features[:1]] + [f * longer for f in FOCALS]
    tried = []
    for focal in focals:
        camera = features.posed(features.Start(np.eye(4), focal, 0), taken.camera)
        turns = [t for some in (clear, lines) for t in directions.rotations(world.directions, some, camera.K)]
        if turns:
            best = max(turn.score for turn in turns)
            known = [directions.Turn(start.T[:3, :3], best) for start in by_features[:1]]
            tried.append((best, camera, [*known, *turns]))
    tried = sorted(tried, key=lambda t: -t[0])[:TRIED]
    starts = [start for _, camera, turns in tried for start in positions.search(world.room, lines, camera, turns)]
    compared = sum(len(turns) for _, _, turns in tried) * len(world.room.places) + len(by_features)
    return sorted(starts, key=lambda start: -start.agree), compared


def _chosen(taken, by_features, by_edges, alike, depth):
    """The starts that are judged: the best by features, by edges, and by likeness, each once."""
    pool = by_features[:2] + by_edges[:12]
    score = [alike(features.posed(start, taken.camera)) for start in pool]
    by_likeness = [pool[k] for k in np.argsort(-np.array(score), kind="stable")]
    firsts = [*by_features[:1], *by_edges[:1], *by_likeness[:1]]
    most = AGREED if all(_near(start, firsts[0], depth) for start in firsts) else JUDGED
    chosen = []
    for start in (*firsts, *by_edges[1:2], *by_likeness[1:]):
        if len(chosen) < most and not any(_near(start, other, depth) for other in chosen):
            chosen.append(start)
    return chosen


def _near(a, b, depth):
    """Are two starts one?"""
    turn = np.linalg.norm(a.T[:3, :3] - b.T[:3, :3]) / np.sqrt(2)
    centre = lambda T: -T[:3, :3].T @ T[:3, 3]
    return turn < DISTINCT_RAD and np.linalg.norm(centre(a.T) - centre(b.T)) < DISTINCT * depth


def _depth(world, start):
    """m: the median depth of the room's edges."""
    z = world.room.p @ start.T[2, :3] + start.T[2, 3]
    return float(np.median(z[z > 0])) if (z > 0).any() else 1.0


def _pose(start, taken, depth):
    """The start as recognition has it."""
    sigma = [START_RAD] * 3 + [START_PART * depth] * 3 + ([] if taken.lens_known else [START_FOCAL])
    scale = 1.0 if taken.lens_known else start.focal_px / taken.camera.K[0, 0]
    return Pose(start.T, scale, np.diag(np.square(sigma)), np.zeros((0, 2), int), float(start.agree), 0.0, 0.0, start.T)


def _refusal(taken, found, result, place, alike) -> str:
    """Why the pose is none, or ""."""
    if result.evidence < result.needed or result.support < result.least:
        return words.refusal(found, result)
    if place.focal_sigma is not None and place.focal_sigma > UNKNOWN_FOCAL:
        return f"its edges do not tell the focal length (sigma {place.focal_sigma:.0%}): give its .cameramodel"
    if not place.likeness and sum(place.matches.values()) < features.LEAST:
        return (
            f"the model's edges are there ({place.evidence:.0f} nats), but it shares too little with posed photographs "
            "to tell this place from another like it"
        )
    if taken.other_lamps:
        return "other poses explain the edges as well" if result.ambiguous else ""
    if place.likeness and place.likeness < ALIKE:
        return (
            f"the model's edges are there, but what it and posed photographs show at the same places correlates by "
            f"{place.likeness:.2f}, {ALIKE} needed"
        )
    rivals = [alike(_moved(place.camera, other["rt_cam_world"])) for other in result.ambiguous]
    if rivals and 1 - place.likeness > APART * (1 - max(rivals)):
        return (
            f"{len(rivals)} other poses explain the edges as well, and light parts them too little: it correlates "
            f"by {place.likeness:.2f}, at the best of the others by {max(rivals):.2f}"
        )
    return ""


def _moved(camera, rt):
    return replace(camera, T_cam_world=matrix_from_rt(rt))
