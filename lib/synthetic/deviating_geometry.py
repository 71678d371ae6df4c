"""Ways in which a given model, camera or scene.yaml deviates from the world that was photographed.

Each takes a `Given` and a generator, and returns (the changed one, {what was changed}).
"""

from dataclasses import replace

import numpy as np

from lib.synthetic.geometry import Polygon, box
from lib.synthetic.given_scene import ROOM, Given
from lib.synthetic.optics import rotation

POSE_PX = 2.0  # rms over the picture
OBJECT_M = 0.03
LAMP_M = 0.12
FREE_PX = 2000
SEEN_PX = 1000  # of an object whose material is forgotten
UNSEEN_PX = 200  # of an object that nobody would model
COPLANAR_M = 1e-4

# ---- the camera ----


def _with_pose(given, T) -> Given:
    return replace(given, camera=replace(given.camera, T_cam_world=T))


def pose(given, random, n_px=POSE_PX):
    """The camera turned and moved, so that what it sees lies n_px off, rms; as much by the turn as by the move."""
    K, T, (_, p_world) = given.camera.K, given.camera.T_cam_world, given.view()
    p = p_world @ T[:3, :3].T + T[:3, 3]
    axis, way = (v / np.linalg.norm(v) for v in random.normal(size=(2, 3)))
    depth = np.median(p[:, 2])

    def off(a):
        """(rms px, T) of a camera turned by a rad and moved by a x the median depth."""
        dT = np.eye(4)
        dT[:3, :3], dT[:3, 3] = rotation(a * axis), a * depth * way
        there = p @ dT[:3, :3].T + dT[:3, 3]
        here = p[:, 2:] > 0.2
        q = [x[:, :2] / np.maximum(x[:, 2:], 0.05) for x in (p, there)]
        return np.sqrt((((q[1] - q[0]) * (K[0, 0], K[1, 1])) ** 2 * here).sum() / here.sum()), dT @ T

    low, high = 0.0, 0.1
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if off(middle)[0] < n_px else (low, middle)
    rms, moved = off(high)
    said = {
        "rms_px": round(float(rms), 4),
        "turned_rad": (high * axis).tolist(),
        "moved_m": (high * depth * way).tolist(),
    }
    return _with_pose(given, moved), said


def half_pixel(given, random):
    """The principal point half a pixel off in x and in y."""
    K = given.camera.K.copy()
    offset = random.choice([-0.5, 0.5], 2)
    K[:2, 2] += offset
    return replace(given, camera=replace(given.camera, K=K)), {"offset_px": offset.tolist()}


def turned(given, random):
    """The camera a quarter turn about its axis, or looking the other way."""
    T, way = given.camera.T_cam_world, ("left", "right", "back")[random.integers(3)]
    up = T[:3, 2]
    vector = {"left": (0, 0, np.pi / 2), "right": (0, 0, -np.pi / 2), "back": np.pi * up}[way]
    dT = np.eye(4)
    dT[:3, :3] = rotation(vector)
    return _with_pose(given, dT @ T), {"way": way}


# ---- objects ----


def objects(given, random, off_m=OBJECT_M):
    """One to three free-standing objects moved along the floor, clear of each other and of all else."""
    free = given.free(FREE_PX)
    number = int(random.integers(1, min(3, len(free)) + 1))
    offsets = {}
    for name in sorted(random.permutation(free)[:number]):
        for _ in range(200):
            a = random.uniform(0, 2 * np.pi)
            offset = off_m * np.array([np.cos(a), np.sin(a), 0])
            moved = given.with_moved({**offsets, name: offset})
            if _clear(moved, name):
                offsets[str(name)] = offset
                break
        else:
            raise ValueError(f"{name}: nowhere to move it")
    return given.with_moved(offsets), {"offset_m": {name: x.tolist() for name, x in offsets.items()}}


def _clear(given, name, clear=0.005) -> bool:
    """Whether an object's bounding box touches no other's, and lies within the room."""
    low, high = given.span(name)
    outer = given.span("walls")
    if (low[:2] - clear < outer[0][:2]).any() or (high[:2] + clear > outer[1][:2]).any():
        return False
    others = [given.span(other) for other in given.objects() if other not in (*ROOM, name)]
    return not any((low - clear < b).all() and (high + clear > a).all() for a, b in others)


def every_object(given, random, sigma_m):
    """Each thing that is not the room or a lamp moved along the floor by N(0, sigma_m) in x and y, as anyone's model
    has them; none cuts into another that it did not cut before."""
    lamps = {p.object for p in given.polygons if p.group in given.lamps}
    offsets = {}
    for name in given.objects():
        if name in (*ROOM, *lamps):
            continue
        before = _cut(given, name)
        for _ in range(50):
            offset = np.append(random.normal(0, sigma_m, 2), 0.0)
            if _cut(given.with_moved({**offsets, name: offset}), name) <= before:
                offsets[name] = offset
                break
    return given.with_moved(offsets), {"offset_m": {name: x.tolist() for name, x in offsets.items()}}


def _cut(given, name, by=1e-3) -> set:
    """The objects, or "walls", that an object's bounding box cuts into by so many metres."""
    low, high = given.span(name)
    outer = given.span("walls")
    cut = {"walls"} if (low < outer[0] - by).any() or (high > outer[1] + by).any() else set()
    for other in given.objects():
        if other not in (*ROOM, name):
            a, b = given.span(other)
            if (low + by < b).all() and (high - by > a).all():
                cut.add(other)
    return cut


def objects_1cm(given, random):
    """Every object N(0, 1 cm) off in x and y."""
    return every_object(given, random, 0.01)


def objects_3cm(given, random):
    """Every object N(0, 3 cm) off in x and y."""
    return every_object(given, random, 0.03)


def lamps_3cm(given, random, sigma_m=0.03):
    """Every lamp N(0, 3 cm) off in x and y."""
    offsets = {}
    for name in dict.fromkeys(p.object for p in given.polygons if p.group in given.lamps):
        for _ in range(200):
            offset = np.append(random.normal(0, sigma_m, 2), 0.0)
            if _cut(given.with_moved({name: offset}), name) <= _cut(given, name):
                offsets[name] = offset
                break
    return given.with_moved(offsets), {"lamps_offset_m": {name: x.tolist() for name, x in offsets.items()}}


def all_3cm(given, random):
    """Every object and every lamp N(0, 3 cm) off in x and y."""
    moved, said = every_object(given, random, 0.03)
    moved, more = lamps_3cm(moved, random)
    return moved, said | more


def half_modelled(given, random):
    """What the camera hardly sees is not in the model, and free things that are no boxes are boxes."""
    lamps = {p.object for p in given.polygons if p.group in given.lamps}
    seen = given.of_objects()
    gone = [n for n in given.objects() if n not in (*ROOM, *lamps) and seen.get(n, 0) < UNSEEN_PX]
    coarse = [n for n in given.free(FREE_PX) if n not in gone]
    kept = []
    for polygon in given.polygons:
        if polygon.object in gone:
            continue
        if polygon.object not in coarse:
            kept.append(polygon)
        elif polygon.object not in {p.object for p in kept}:
            low, high = given.span(polygon.object)
            kept += box(polygon.object, polygon.group, low, np.maximum(high, low + 0.01))
    return replace(given, polygons=tuple(kept)), {"without": gone, "boxes": coarse}


def extra_object(given, random):
    """A box stands in the model that the photograph does not show."""
    low, high = given.span("walls")
    groups = sorted({p.group for p in given.polygons} - set(given.lamps))
    for _ in range(300):
        size = random.uniform(0.2, 0.6, 3)
        at = np.append(random.uniform(low[:2] + 0.1, high[:2] - 0.1 - size[:2]), low[2])
        more = tuple(box("extra", str(random.choice(groups)), at, at + size))
        with_it = replace(given, polygons=given.polygons + more, seen={})
        if not _cut(with_it, "extra") and with_it.of_objects().get("extra", 0) >= FREE_PX:
            return with_it, {"extra": [*at.tolist(), *size.tolist()]}
    raise ValueError("nowhere to put it")


def missing_object(given, random):
    """A free-standing object that the photograph shows, and the model does not have."""
    name = str(random.choice(given.free(FREE_PX)))
    return replace(given, polygons=tuple(p for p in given.polygons if p.object != name)), {"object": name}


def forgotten_usemtl(given, random):
    """An object without its usemtl: the one before in the file gives its group."""
    choices = []
    for before, polygon in zip(given.polygons, given.polygons[1:], strict=False):
        groups = {p.group for p in given.polygons if p.object == polygon.object}
        changes = before.object != polygon.object and groups - {before.group}
        lamps = (groups | {before.group}) & set(given.lamps)
        seen = given.of_objects().get(polygon.object, 0) >= SEEN_PX
        if seen and changes and len(groups) == 1 and not lamps and polygon.object not in ROOM:
            choices.append((polygon.object, before.group, polygon.group))
    name, group, was = choices[random.integers(len(choices))]
    forget = lambda p: replace(p, group=group) if p.object == name else p
    return replace(given, polygons=tuple(map(forget, given.polygons))), {"object": name, "group": group, "was": was}


def open_objects(given, random):
    """Solids drawn without the faces that lie on other objects: bottoms and backs."""
    kept = tuple(p for p in given.polygons if p.object in ROOM or not _covered(p, given.polygons))
    gone = [(p.object, p.group) for p in given.polygons if not any(p is k for k in kept)]
    return replace(given, polygons=kept), {"faces": gone}


def _covered(polygon, polygons) -> bool:
    """Whether a polygon lies on polygons of other objects everywhere: asked near its corners, and inside."""
    middle = polygon.points.mean(0)
    p = np.concatenate([middle + s * (polygon.points - middle) for s in (0.0, 0.5, 0.98)])
    p = np.concatenate([p, (p + np.roll(p, 1, 0)) / 2])
    on, n = np.zeros(len(p), bool), polygon.normal()
    for other in polygons:
        coplanar = np.abs((other.points - middle) @ n).max() < COPLANAR_M
        if coplanar and other.object != polygon.object:
            on |= _inside(other, p)
    return bool(on.all())


def _inside(polygon, p) -> np.ndarray:
    """(n,) whether points lie on a convex polygon."""
    n = polygon.normal()
    on = np.abs((p - polygon.points[0]) @ n) < COPLANAR_M
    for corner, edge in zip(polygon.points, np.roll(polygon.points, -1, 0) - polygon.points, strict=True):
        on &= (p - corner) @ np.cross(n, edge / np.linalg.norm(edge)) > -COPLANAR_M
    return on


def open_room(given, random):
    """The wall behind the camera is not modelled."""
    number, _ = given.view()
    forward = given.camera.T_cam_world[2, :3]
    shown = {int(i) for i in np.unique(number)}
    hidden = [i for i, p in enumerate(given.polygons) if p.object == "walls" and i not in shown]
    if not hidden:
        raise ValueError("every wall is seen")
    behind = max(hidden, key=lambda i: given.polygons[i].normal() @ forward)
    said = {"wall": given.polygons[behind].points.tolist()}
    return replace(given, polygons=tuple(p for i, p in enumerate(given.polygons) if i != behind)), said


# ---- lamps ----


def lamp(given, random, off_m=LAMP_M):
    """A lamp moved horizontally, clear of walls and of all else."""
    names = [p.object for p in given.polygons if p.group in given.lamps]
    name = str(random.choice(sorted(set(names))))
    for _ in range(200):
        a = random.uniform(0, 2 * np.pi)
        offset = off_m * np.array([np.cos(a), np.sin(a), 0])
        moved = given.with_moved({name: offset})
        if _clear(moved, name, 0.02):
            return moved, {"lamp": name, "offset_m": offset.tolist()}
    raise ValueError(f"{name}: nowhere to move it")


def flipped_lamp(given, random):
    """The lamps' corners the other way round: they shine at the ceiling."""
    flip = lambda p: replace(p, points=p.points[::-1]) if p.group in given.lamps else p
    return replace(given, polygons=tuple(map(flip, given.polygons))), {"lamps": list(given.lamps)}


def neutral_lamp(given, random):
    """The lamps' colours guessed grey, with the same mean."""
    return _told_lamps(given, {group: [round(float(np.mean(E)), 4)] * 3 for group, E in given.lamps.items()})


def lamp_power(given, random):
    """The lamps told a quarter to a half brighter than they are, or darker."""
    factor = float(random.uniform(1.25, 1.5) ** random.choice((-1, 1)))
    return _told_lamps(given, {group: [round(factor * e, 4) for e in E] for group, E in given.lamps.items()})


def _told_lamps(given, lamps):
    return replace(given, facts={**given.facts, "lamps": lamps}), {"lamps": lamps, "were": given.lamps}


# ---- the model's frame ----


def _in_frame(given, change) -> Given:
    return replace(given, polygons=tuple(Polygon(p.object, p.group, change(p.points)) for p in given.polygons))


def y_up(given, random):
    """The model's y points up; the camera is as it was."""
    return _in_frame(given, lambda p: np.c_[p[:, 0], p[:, 2], -p[:, 1]]), {"up": "y"}


def millimetres(given, random):
    """The model is in millimetres; the camera's place is in metres."""
    return _in_frame(given, lambda p: 1000 * p), {"unit": "mm"}
