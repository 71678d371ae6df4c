"""Local recognition: the static part of a model gives the cameras' pose, and each movable object has its own.

    result = place(model, sides, movable=["chair"])       # sides : rig.Side, posed in the model's frame

An object is sought along what it stands on, near its drawn place first and then further away: its edges are laid on
those of all photographs at many places (search.py).  The best places are refined on sub-pixel edges (fit.py), with
everything else in place that may hide it.  Then the photographs say whether it is there at all.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from lib.given.cameras import rt_from_matrix
from lib.given.model import parts
from lib.vision.objects import dimensions, search, supports
from lib.vision.objects.fit import HIT_PX, Fitted, Support, evidence, fitted
from lib.vision.objects.scenery import Photographs, Scenery
from lib.vision.recognition import symmetry
from lib.vision.refinement.rig import depth
from lib.vision.registration.motions import World

PRESENT, SURE = 0.7, 20.0  # share of an object's edges, and nats, that say that it is there
UNSURE = 0.55  # with fewer of its edges it is absent
LEAST = 12  # edge samples, 5 px apart, that must be visible where it is drawn, for an absence to be told
NEAR_M, NEAR_RAD = 0.16, np.radians(36)  # what is looked through first
SPACING_PX = 1.5  # of the reduced picture, between places that are tried
STARTS = 8
ROUGH = [(4, 6.0), (2, 5.0), (1, 5.0)]
FINE = [(1, 3.0), (1, 2.0)]
# Share of its edges that are found where an object is drawn, from which it stands there: path-traced ones that were
# right had .86 and .99 and were moved by 2.4 and 2.7 cm along the line of sight, for a few edges more.
DRAWN = 0.8
MOVED_CHI2, MOVED_M, BETTER = 40.0, 0.002, 5.0  # an object of the model is moved where it is surely elsewhere


@dataclass(frozen=True, eq=False)
class Placed:
    """What was found of an object.

    found : True, False, or None where the photographs cannot tell
    T : T_world_object (4, 4), None where it is not found; from its place in the model, or from its own file's frame
    covariance : (6, 6) of (omega, tau), T = exp(omega, tau) T_hat along the world's axes, rad and m
    why : movable, refined, or file
    """

    name: str
    found: bool | None
    why: str
    T: np.ndarray | None = None
    covariance: np.ndarray | None = None
    fit: Fitted | None = None

    def entry(self) -> dict:
        """Of pose.json."""
        rt = None if self.T is None else rt_from_matrix(self.T)
        return {"rt_world_object": rt, "covariance": self.covariance, "found": self.found}


@dataclass(frozen=True, eq=False)
class Result:
    """placed : [Placed];  model : Model with everything in place;  sizes : [dimensions.Size] that are wrong in it

    aside : [Placed] of those that are not where they are drawn, and were left there
    """

    placed: list
    model: object
    sizes: list
    aside: list


@dataclass(eq=False)
class _Job:
    """What stays the same for all objects.

    world : of the model as drawn;  files : indices of objects that are not in it
    """

    photographs: Photographs
    world: World
    within_m: float
    camera_covariance: object
    files: tuple = ()
    fits: dict = field(default_factory=dict)


def place(model, sides, movable, things=None, *, refine=False, fixed=(), camera_covariance=None, within_m=1.0):
    """Result: first the movable objects and those of files, then what `refine` allows, then wrong dimensions.

    model : as drawn; movable : names of objects with a pose of their own; things : {name: Model in its own frame}
    fixed : groups whose objects `refine` leaves alone; camera_covariance : (6, 6) of (omega, tau) of the left camera
    within_m : how far from where it is drawn a movable object is sought, along its support
    """
    world = World(model, sides[0].camera)
    whole = model
    for name, thing in (things or {}).items():
        whole = parts.joined(whole, name, thing)
    files = tuple(range(len(model.objects), len(whole.objects)))
    photographs = Photographs.of(sides, depth(model, sides[0].camera))
    job = _Job(photographs, world, within_m, camera_covariance, files)
    sought = [*(model.objects.index(name) for name in movable), *files]
    scenery = Scenery(whole, dict.fromkeys(sought))
    placed, scenery = _all_sought(job, scenery, sought)
    moved, mended = _refined(job, scenery, set(sought), fixed)
    there = [thing for thing in range(len(whole.objects)) if mended.poses.get(thing, True) is not None]
    sizes = dimensions.wrong(mended, [k for k in there if k in files or k in world.movable], photographs)
    if refine:
        return Result(placed + moved, mended.posed(), sizes, [])
    return Result(placed, scenery.posed(), sizes, moved)


# ---- movable objects ----


def _all_sought(job, scenery, things):
    """([Placed], Scenery): the largest first; once more when all others are in place."""
    size = {thing: np.linalg.norm(np.ptp(scenery.points(thing), axis=0)) for thing in things}
    fits = {}
    for thing in sorted(things, key=lambda k: -size[k]):
        fits[thing] = _sought(job, scenery, thing)
        if _says(fits[thing]):
            scenery = scenery.at(thing, fits[thing].T)
    for thing in [k for k in fits if _says(fits[k])]:
        fits[thing] = again = _final(job, scenery, thing, fits[thing].T)
        scenery = scenery.at(thing, again.T if _says(again) else None)
    placed = []
    for thing in things:
        found = _says(fits[thing])
        if found is False and not _can_be_told(job, scenery, thing):
            found = None
        if found is None and thing not in job.files:
            scenery = scenery.at(thing, np.eye(4))  # nobody knows: as drawn
        placed.append(_placed(job, scenery, thing, found, fits[thing], "file" if thing in job.files else "movable"))
    return placed, scenery


def _placed(job, scenery, thing, found, fit, why):
    name = scenery.model.objects[thing]
    if not found:
        return Placed(name, found, why, fit=fit)
    covariance = in_world(job.photographs.T_left_world, fit.covariance, job.camera_covariance)
    return Placed(name, True, why, fit.T, covariance, fit)


def in_world(T_left_world, covariance, camera_covariance):
    """(6, 6) along the world's axes: of an object's pose in the left camera, and of that camera's own."""
    R, t = T_left_world[:3, :3].T, -T_left_world[:3, :3].T @ T_left_world[:3, 3]
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    adjoint = np.block([[R, np.zeros((3, 3))], [cross @ R, R]])
    total = covariance + (0 if camera_covariance is None else np.asarray(camera_covariance))
    return adjoint @ total @ adjoint.T


def _says(fit):
    """Is it there? True, False, or None for neither: few edges that are found tell little, and are no absence."""
    if fit is None or fit.support < UNSURE:
        return False
    return True if fit.support >= PRESENT and fit.nats >= SURE and fit.covariance is not None else None


def _can_be_told(job, scenery, thing):
    """Would its edges be seen where it is drawn? Of an object of a file any place in sight would do."""
    return thing in job.files or evidence(scenery.at(thing, np.eye(4)), thing, job.photographs)[3] >= LEAST


def _support(job, scenery, thing, T):
    """The plane that it stands on; where there is none it is free."""
    p = scenery.points(thing)
    middle = T[:3, :3] @ ((p.min(axis=0) + p.max(axis=0)) / 2) + T[:3, 3]
    if thing in job.files:
        return Support(supports.upwards(job.photographs.cameras()[0]), middle)
    normal = job.world.axes(thing)[1]
    return None if normal is None else Support(normal, middle)


def _final(job, scenery, thing, T):
    return fitted(scenery, thing, T, job.photographs, _support(job, scenery, thing, T), FINE, final=True)


def _sought(job, scenery, thing) -> Fitted | None:
    """The place that the photographs support most."""
    alone = parts.only(scenery.model, [scenery.model.objects[thing]])
    wire, fields = search.wire(alone), search.fields(scenery, job.photographs)
    best = None
    for poses, spacing in _ways(job, scenery, thing, fields):
        if not len(poses):
            continue
        score = search.scores(wire, fields, poses)
        for k in search.best_apart(poses, score, scenery.points(thing), spacing, STARTS):
            support = _support(job, scenery, thing, poses[k])
            fit = fitted(scenery, thing, poses[k], job.photographs, support, ROUGH)
            if best is None or fit.nats > best.nats:
                best = fit
        if best is not None and best.support >= PRESENT and best.nats >= SURE:
            break
    if best is None:
        return None
    return _least_turned(_final(job, scenery, thing, best.T), alone)


def _ways(job, scenery, thing, fields):
    """Yields (poses, m between them): what is to be looked through, one after the other."""
    p = scenery.points(thing)
    middle, radius = (p.min(axis=0) + p.max(axis=0)) / 2, np.linalg.norm(np.ptp(p, axis=0)) / 2
    camera = job.photographs.cameras()[0]
    px = SPACING_PX / fields[0].K[0, 0]
    if thing in job.files:
        spacing = 2 * px * job.photographs.rig.depth
        for way in supports.orientations(camera):
            yield supports.places(scenery, p, way, camera, spacing, min(spacing / radius, np.radians(15))), spacing
        return
    normal = job.world.axes(thing)[1]
    normal = -job.photographs.T_left_world[1, :3] if normal is None else normal
    for reach, turn, coarse in ((min(NEAR_M, job.within_m), NEAR_RAD, 1), (job.within_m, np.pi, 2)):
        spacing = coarse * px * np.linalg.norm(middle - camera.centre)
        turns = int(np.ceil(turn / min(spacing / max(radius, 1e-6), np.radians(15))))
        yield search.grid(np.eye(4), middle, normal, spacing, reach, turn / turns, turns), spacing


def _least_turned(fit, alone):
    """Of the equal poses of a symmetric object the one that is turned least."""
    equal = [fit.T] + [fit.T @ motion.T for motion in symmetry.motions(alone) if motion.is_exact]
    turned = [np.linalg.norm(rt_from_matrix(T)[:3]) for T in equal]
    return replace(fit, T=equal[int(np.argmin(turned))])


def _aside_px(job, scenery, thing, T):
    """How far the corners of an object go at most, in any photograph."""
    p = scenery.points(thing)
    q = p @ T[:3, :3].T + T[:3, 3]
    return max(float(np.nanmax(np.abs(c.project(q) - c.project(p)), initial=0)) for c in job.photographs.cameras())


# ---- objects of the model that stand centimetres elsewhere ----


def _refined(job, scenery, sought, fixed):
    """([Placed] of those that stand elsewhere, Scenery with them in place)."""
    model, placed = scenery.model, []
    lamps = {int(model.facet_object[f]) for f in range(model.n_facets) if model.groups[model.facet_group[f]] in fixed}
    for thing in sorted(set(map(int, job.world.movable)) - sought - lamps, key=lambda k: -job.world.span[k]):
        fit = _elsewhere(job, scenery, thing)
        if fit is not None:
            scenery = scenery.at(thing, fit.T)
            placed.append(_placed(job, scenery, thing, True, fit, "refined"))
    return placed, scenery


def _elsewhere(job, scenery, thing) -> Fitted | None:
    """Where an object stands if it is surely not where it is drawn, else None."""
    photographs = job.photographs
    as_drawn = evidence(scenery, thing, photographs)
    if as_drawn[3] < LEAST or as_drawn[0] >= DRAWN:
        return None
    here = _final(job, scenery, thing, np.eye(4))
    if not (_says(here) and here.support > 0.85):
        without = scenery.at(thing, None)
        alone = parts.only(scenery.model, [scenery.model.objects[thing]])
        wire, fields = search.wire(alone), search.fields(without, photographs)
        poses, spacing = next(iter(_ways(job, scenery, thing, fields)))
        score = search.scores(wire, fields, poses)
        for k in search.best_apart(poses, score, scenery.points(thing), spacing, STARTS // 2):
            rough = fitted(scenery, thing, poses[k], photographs, _support(job, scenery, thing, poses[k]), ROUGH)
            if rough.nats > here.nats + BETTER:
                here = _final(job, scenery, thing, rough.T)
    if not _says(here) or here.nats < as_drawn[2] - BETTER:
        return None
    if _aside_px(job, scenery, thing, here.T) > HIT_PX and here.nats < as_drawn[2] + BETTER:
        return None  # as many edges are met where it is drawn: those of shadows, most likely
    step = rt_from_matrix(here.T)
    C = in_world(photographs.T_left_world, here.covariance, job.camera_covariance)
    p = scenery.points(thing)
    far = np.linalg.norm(p @ here.T[:3, :3].T + here.T[:3, 3] - p, axis=1).max()
    if far <= MOVED_M or step @ np.linalg.solve(C, step) <= MOVED_CHI2:
        return None
    size = dimensions.surest(scenery, thing, photographs)
    # One of another height may look moved, or the other way round: whichever leaves its edges less, and one cause
    # rather than both: what is higher and was lifted to its upper edges is still higher.
    if size and (size.rms_px < here.rms_px or dimensions.surest(scenery.at(thing, here.T), thing, photographs)):
        return None
    return here
