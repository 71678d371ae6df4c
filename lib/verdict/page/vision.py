"""The sections about the vision half (figures 2.2 to 2.8): lenses, regions, matches, facets, pose.

Lines over photographs are inline SVG in the pixels of the photograph, so they stay sharp at any size.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lib.buffers import edges, index_buffer
from lib.given.cameras import matrix_from_rt
from lib.verdict import records
from lib.verdict.page import space
from lib.verdict.page.html import css, finite, number, plural, render, sentence
from lib.verdict.page.pictures import colours, labels_uri, on_scale, photo_uri, smaller, uri
from lib.vision import facets_file

SIDES = ("left", "right")
UNITS = {"m": "m", "baseline": "baselines"}
LOW_PX, HIGH_PX = 0.01, 10.0  # ends of the scale of uncertainty, logarithmic
UNCERTAINTY_COLOURS = np.array(
    [[226, 240, 239], [150, 205, 200], [240, 206, 130], [222, 120, 60], [130, 30, 40]], float
)
UNCERTAINTY_PX = 480  # width of its picture
FEW = 12  # facets that are listed without a click


@dataclass
class Vision:
    """Of the two sides, in the pixels of the pinhole photographs:

    photographs : {side: (H, W, C) display values};
    regions, surfaces : {side: (H, W) labels from 1}
    cameras : {side: Camera} in the pair's frame;  wires : [Wire], the linear step first
    in_space : the facets and the model, from the pose;  beyond_m : {left label: of its facet of the model, see beyond}
    matches : [(left label, right label, similarity)];  facet_names : of the model's facets, "object, group"
    """

    photographs: dict = field(default_factory=dict)
    regions: dict = field(default_factory=dict)
    surfaces: dict = field(default_factory=dict)
    cameras: dict = field(default_factory=dict)
    wires: list = field(default_factory=list)
    in_space: space.Scene | None = None
    beyond_m: dict = field(default_factory=dict)
    matches: list | None = None
    facets: facets_file.Facets | None = None
    pose: records.Pose | None = None
    calibration: records.Calibration | None = None
    orientation: records.Orientation | None = None
    facet_names: list = field(default_factory=list)
    middles: dict = field(default_factory=dict)  # object -> (3,) m, world


class Wire(NamedTuple):
    """The model in both photographs from one pose of a trace; left, right : (S, 2, 2) px, ends of its visible edges.

    seen : numbers of the facets that they show
    """

    title: str
    left: np.ndarray
    right: np.ndarray
    seen: np.ndarray

    def on(self, side):
        """That of a side."""
        return {"left": self.left, "right": self.right}[side]


def see(*, model=None, cameras, pose=None, **files) -> Vision:
    """From what was read; the model names the facets and is drawn from each pose of the trace."""
    vision = Vision(cameras=cameras, pose=pose, **files)
    if model:
        of_facets = zip(model.facet_object, model.facet_group, strict=True)
        vision.facet_names = [f"{model.objects[o]}, {model.groups[g]}" for o, g in of_facets]
        owner, corners = model.facet_object[model.triangle_facet], model.corners()
        for thing in np.unique(owner):
            p = corners[owner == thing].reshape(-1, 3)
            vision.middles[model.objects[thing]] = (p.min(axis=0) + p.max(axis=0)) / 2
        if pose and len(cameras) == 2:
            vision.wires = wires(model, cameras, pose)
            if vision.facets:
                vision.in_space = space.scene(model, vision.facets.facets, pose, cameras, vision.wires[-1].seen)
                vision.beyond_m = beyond(model, vision.facets.facets, pose)
    return vision


def summary(vision: Vision):
    """What the vision half found, for the head of a page without photometry; empty where it found nothing."""
    said = []
    if vision.matches is not None:
        said.append(f"{len(vision.matches)} {plural(len(vision.matches), 'region')} matched")
    if vision.facets:
        facets = len(vision.facets.facets)
        said.append(f"{facets} {plural(facets, 'facet')} reconstructed")
    if sigma := pose_sigma(vision.pose):
        said.append(f"camera found to {number(sigma.mm, 2)} mm (1 σ)")
    if vision.calibration and vision.calibration.verdict:
        said.append(f"lenses: {vision.calibration.verdict.split('; ')[0]}")
    return sentence("; ".join(said)) + "." if said else ""


def sections(vision: Vision, width):
    """All sections, each "" where its data are missing."""
    width = min(width, 960)
    return [
        lenses_section(vision),
        regions_section(vision, width),
        facets_section(vision, width),
        pose_section(vision, width),
    ]


# ---- lines over a photograph ----


class Overlay(NamedTuple):
    """A photograph with lines over it. path : SVG;  labels : [(x, y, text)], px;  size : W, H;  alt : in words"""

    picture: str
    alt: str
    size: tuple
    path: str
    labels: list
    colour: str


def overlay(photograph, alt, lines, width, *, closed=False, labels=(), colour="#fff"):
    """lines : [(n, 2) px];  labels : [((x, y) px, text)]"""
    H, W = photograph.shape[:2]
    end = "Z" if closed else ""
    path = "".join("M" + "L".join(f"{x + 0.5:.1f} {y + 0.5:.1f}" for x, y in line) + end for line in lines)
    places = [(f"{x + 0.5:.1f}", f"{y + 0.5:.1f}", text) for (x, y), text in labels]
    return Overlay(photo_uri(photograph, width), alt, (W, H), path, places, colour)


# ---- lenses ----


class UncertaintyMap(NamedTuple):
    """One sigma of a projected point at distance_m over the picture; centre_px : the largest in the middle"""

    side: str
    picture: str
    distance_m: float | None
    centre_px: float | None


def lenses_section(vision: Vision):
    """What the lenses and the relative pose are good for, in words; how uncertain a pixel is across each picture."""
    calibration, orientation = vision.calibration, vision.orientation
    calibration = calibration or records.Calibration()
    if not (calibration.verdict or calibration.cameras or calibration.pair.baseline_m or orientation):
        return ""
    verdict, *reasons = (calibration.verdict or "").split("; ")
    cameras = {side: calibration.cameras[side] for side in SIDES if side in calibration.cameras}
    return render(
        "lenses.html",
        verdict=verdict,
        reasons=reasons,
        cameras=cameras,
        pair=calibration.pair,
        maps=[_uncertainty(side, lens) for side, lens in cameras.items() if lens.uncertainty.sigma_px and lens.size],
        stops=[css(colour) for colour in UNCERTAINTY_COLOURS],
        scale=(LOW_PX, float(np.sqrt(LOW_PX * HIGH_PX)), HIGH_PX),
        orientation=_orientation_facts(orientation) if orientation else None,
    )


def _uncertainty(side, camera: records.CalibratedLens):
    u = camera.uncertainty
    grid = np.array([[np.nan if v is None else v for v in row] for row in u.sigma_px], float)
    W, H = camera.size
    high, wide = max(1, round(UNCERTAINTY_PX * H / W / len(grid))), max(1, round(UNCERTAINTY_PX / grid.shape[1]))
    picture = np.repeat(np.repeat(uncertainty_colours(grid), high, axis=0), wide, axis=1)
    return UncertaintyMap(side, uri(picture), u.distance_m, u.centre_px)


def uncertainty_colours(sigma_px):
    """Uncertainty in pixels (any shape) as colours; unknown is grey."""
    known = np.isfinite(sigma_px)
    at = np.clip(np.log(np.where(known, sigma_px, 1) / LOW_PX) / np.log(HIGH_PX / LOW_PX), 0, 1)
    return np.where(known[..., None], on_scale(at, UNCERTAINTY_COLOURS), 128).astype(np.uint8)


def _orientation_facts(orientation: records.Orientation):
    facts = [f"{number(orientation.inliers)} point matches"] if finite(orientation.inliers) else []
    facts += [f"{number(orientation.rms_px, 2)} px rms"] if finite(orientation.rms_px) else []
    facts += [f"axes {number(orientation.angle_deg, 3)}° apart"] if finite(orientation.angle_deg) else []
    return ", ".join(facts)


# ---- regions and matches ----


def regions_section(vision: Vision, width):
    """Figures 2.2 and 2.3: every region in a colour, every surface; then matched ones in one colour, others black."""
    regions, surfaces = (
        {side: of[side] for side in SIDES if of.get(side) is not None} for of in (vision.regions, vision.surfaces)
    )
    if not (regions or surfaces):
        return ""
    matched = []
    if vision.matches is not None and len(surfaces) == 2:
        for i, (side, labels) in enumerate(surfaces.items()):
            match_of = _match_of_labels(labels, [match[i] for match in vision.matches])
            share = float((match_of[labels] > 0).mean()) if labels.size else 0.0
            matched.append((side, _matched_uri(match_of[labels], len(vision.matches), width), share))
    return render(
        "regions.html",
        regions=_shown(regions, width),
        surfaces=_shown(surfaces, width),
        matched=matched,
        matches=len(vision.matches or ()),
    )


def _shown(pictures, width):
    """[(side, picture, number of labels)]"""
    return [(side, labels_uri(labels, width), len(np.unique(labels))) for side, labels in pictures.items()]


def _match_of_labels(labels, matched):
    """(largest label + 1,) number of the match of each label from 1, 0 = none. matched : the labels, match by match"""
    result = np.zeros(int(labels.max(initial=0)) + 1, int)
    for n, label in enumerate(matched, start=1):
        if 0 < label < len(result):
            result[label] = n
    return result


def _matched_uri(match, n_matches, width):
    palette = np.concatenate([np.zeros((1, 3), np.uint8), colours(n_matches)])
    return uri(smaller(palette[match], width, nearest=True))


# ---- facets ----


class FacetRow(NamedTuple):
    """distance, sigma : at the middle of the facet, along the camera's axis, in the pair's unit

    model : name of the model's facet;  beyond : it lies so far beyond the middle, in the pair's unit
    """

    label: int
    distance: float
    sigma: float | None
    overlap: float | None
    by: str
    model: str
    beyond: float | None


def facets_section(vision: Vision, width):
    """Figures 2.4 and 2.5: the facets over both photographs and against the model; how well their distance is known."""
    if not (vision.facets and vision.facets.facets):
        return ""
    facets = vision.facets.facets
    drawn = [
        (side, _facets_over(vision, side, width))
        for side in SIDES
        if {side, "left"} <= vision.cameras.keys() and vision.photographs.get(side) is not None
    ]
    matches = vision.pose.matches if vision.pose else ()
    model_facet = {match.left_label: match.facet for match in matches}
    rows = [_facet_row(vision, f, _facet_name(vision, model_facet.get(f.left_label))) for f in facets]
    return render(
        "facets.html",
        drawn=drawn,
        views=space.views(vision.in_space, min(width, 720)) if vision.in_space else [],
        rows=rows,
        unit=UNITS.get(vision.facets.unit, ""),
        opened=len(rows) <= FEW,
    )


def _facets_over(vision: Vision, side, width):
    facets = vision.facets.facets
    rings = [project(vision.cameras[side], vision.cameras["left"], f.polygon) for f in facets]
    keep = [(ring, f) for ring, f in zip(rings, facets, strict=True) if np.isfinite(ring).all()]
    labels = [(tuple(ring.mean(0)), f.left_label) for ring, f in keep]
    alt = f"The {side} photograph with {len(keep)} reconstructed {plural(len(keep), 'facet')} as wireframes"
    return overlay(vision.photographs[side], alt, [ring for ring, _ in keep], width, closed=True, labels=labels)


def project(camera, left, points):
    """(n, 2) px of points (n, 3) m in the left camera's frame. left : the left camera in the pair's frame"""
    T = np.linalg.inv(left.T_cam_world)
    return camera.project(np.asarray(points, float) @ T[:3, :3].T + T[:3, 3])


def beyond(model, facets, pose: records.Pose):
    """{left label: m}: how far beyond the facet's middle, along its ray, the plane of its facet of the model lies."""
    T = matrix_from_rt(pose.rt_cam_world)
    middles = {f.left_label: (pose.scale or 1.0) * np.mean(np.asarray(f.polygon, float), axis=0) for f in facets}
    result = {}
    for match in pose.matches:
        if match.left_label in middles and 0 <= (match.facet if match.facet is not None else -1) < model.n_facets:
            middle, n = middles[match.left_label], T[:3, :3] @ model.facet_normal[match.facet]
            along = n @ middle / np.linalg.norm(middle)
            if abs(along) > 1e-6:
                result[match.left_label] = float((model.facet_offset[match.facet] + n @ T[:3, 3] - n @ middle) / along)
    return result


def _facet_row(vision: Vision, f: facets_file.Facet, name):
    centre = np.mean(np.asarray(f.polygon, float), axis=0)
    ray = centre / centre[2] if centre[2] else centre
    sigma = None
    if f.covariance is not None:
        # of z = 1 / (m . ray), to first order
        sigma = float(np.sqrt(max(ray @ np.asarray(f.covariance, float) @ ray, 0)) * centre[2] ** 2)
    off = vision.beyond_m.get(f.left_label)
    return FacetRow(f.left_label, float(centre[2]), sigma, f.overlap, _by(f), name, off)


def _by(f: facets_file.Facet):
    """What told the facet, in words."""
    words = {"both": "contour and texture"}.get(f.by, f.by or "–")
    return f"{words}, loose" if f.loose else words


def _facet_name(vision: Vision, facet):
    """Of a model's facet, or a dash."""
    if facet is None:
        return "–"
    return vision.facet_names[facet] if 0 <= facet < len(vision.facet_names) else f"facet {facet}"


# ---- the pose ----


class PoseSigma(NamedTuple):
    """One sigma of the camera's direction and place."""

    degrees: float
    mm: float


def pose_sigma(pose: records.Pose | None):
    """PoseSigma, or None where the pose does not say."""
    if not (pose and pose.covariance):
        return None
    s = np.sqrt(np.maximum(np.diag(np.asarray(pose.covariance, float)), 0))
    return PoseSigma(float(np.degrees(np.linalg.norm(s[:3]))), float(1000 * np.linalg.norm(s[3:])))


def wires(model, cameras, pose: records.Pose, most=3):
    """[Wire]: the trace of a pose as wireframes; of a long one the first, the last and one between.

    cameras : {side: Camera} in the pair's frame
    """
    steps = [step for step in pose.trace if step.rt_cam_world]
    if not steps or steps[-1].rt_cam_world != pose.rt_cam_world:
        steps.append(records.PoseStep(step="result", rt_cam_world=pose.rt_cam_world))
    last = len(steps) - 1
    keep = {round(i) for i in np.linspace(0, last, most)}
    result = []
    for i in sorted(keep):
        (left, seen), (right, seen_right) = (_wireframe(model, cameras, side, steps[i], pose) for side in SIDES)
        result.append(Wire(_title(steps[i], i), left, right, np.union1d(seen, seen_right)))
    return result


def _title(step: records.PoseStep, i):
    error = f": {number(step.error_px, 2)} px" if finite(step.error_px) else ""
    iteration = i if step.iteration is None else step.iteration
    known = {"linear": "after the linear step", "result": "result"}
    return known.get(step.step, f"after iteration {iteration}") + error


def _wireframe(model, cameras, side, step: records.PoseStep, pose: records.Pose):
    T_side_left = cameras[side].T_cam_world @ np.linalg.inv(cameras["left"].T_cam_world)
    T_side_left[:3, 3] *= step.scale or pose.scale or 1.0  # metres per unit of the pair
    camera = replace(cameras[side], T_cam_world=T_side_left @ matrix_from_rt(step.rt_cam_world))
    buffer = index_buffer.reference(model, camera)
    return edges.wireframe(model, camera, buffer.facet, buffer.depth), np.unique(buffer.facet[buffer.facet >= 0])


def pose_section(vision: Vision, width):
    """Figures 2.6 to 2.8: the model over both photographs, after the linear step and after each iteration."""
    if not vision.pose:
        return ""
    said = []
    if sigma := pose_sigma(vision.pose):
        said.append(f"known to {number(sigma.degrees, 2)}° and {number(sigma.mm, 2)} mm (1 σ)")
    matched = len(vision.pose.matches)
    said.append(f"{matched} {plural(matched, 'facet')} matched")
    if others := vision.pose.others:
        said.append(f"{others} other {plural(others, 'pose')} would explain the facets as well")
    elif equal := len(vision.pose.ambiguous):
        said.append(f"the model comes onto itself: as good as {equal} other {plural(equal, 'pose')}")
    photographs = {side: vision.photographs[side] for side in SIDES if vision.photographs.get(side) is not None}
    *steps, result = vision.wires or [None]
    return render(
        "pose.html",
        said=sentence("; ".join(said)),
        result=result and _wires_over(photographs, [result], width, colour="#ffe14d"),
        steps=_wires_over(photographs, steps, min(width, 480)),
        objects=[_object_row(name, o, vision.middles.get(name)) for name, o in (vision.pose.objects or {}).items()],
    )


def _object_row(name, where, middle):
    """(name, what is said of it, where its middle is, how far it is turned).  middle : (3,) m, world, or None"""
    if not where.found:
        return name, "absent" if where.found is False else "not to be told", "", ""
    rt = np.array(where.rt_world_object)
    turned, at = f"{number(np.degrees(np.linalg.norm(rt[:3])), 3)}°", ""
    if middle is not None:
        at = "[" + ", ".join(f"{x:.4f}" for x in middle) + "] m"
    if where.covariance is None or middle is None:
        return name, "found", at, turned
    C, (x, y, z) = np.array(where.covariance), middle
    follows = np.column_stack([[[0, z, -y], [-z, 0, x], [y, -x, 0]], np.eye(3)])  # the middle, by omega and tau
    mm = 1000 * np.sqrt(np.trace(follows @ C @ follows.T))
    degrees = np.degrees(np.sqrt(np.trace(C[:3, :3])))
    return name, f"known to {number(degrees, 2)}° and {number(mm, 2)} mm (1 σ)", at, turned


def _wires_over(photographs, wires, width, **options):
    """[(side, title, Overlay)]"""
    return [
        (side, wire.title, overlay(photograph, _alt(side, wire), wire.on(side), width, **options))
        for wire in wires
        for side, photograph in photographs.items()
    ]


def _alt(side, wire):
    return f"The {side} photograph with the model’s visible edges, {wire.title}"
