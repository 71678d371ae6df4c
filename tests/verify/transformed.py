"""A scene of one photograph, told in another way: other units, another place, other names, another order.

Each transformation changes a scene's folder in place, and none changes what the photograph says. So the answer must
be the same, and `answer` brings it back into the terms of the scene as it was.
"""

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.given import cameras
from tests.helpers.changed_scenes import clean

ROOT = Path(__file__).resolve().parents[2]


class Drawing(NamedTuple):
    """model.obj as a list of (object, group, corners (n, 3))."""

    polygons: list

    @classmethod
    def read(cls, folder):
        vertices, polygons, thing, group = [], [], "default", ""
        for line in (folder / "model.obj").read_text().splitlines():
            key, _, rest = line.partition(" ")
            if key == "v":
                vertices.append([float(x) for x in rest.split()])
            elif key == "o":
                thing = rest
            elif key == "usemtl":
                group = rest
            elif key == "f":
                polygons.append((thing, group, np.array([vertices[int(k) - 1] for k in rest.split()])))
        return cls(polygons)

    def write(self, folder):
        """Corners are shared as they were: equal places are one vertex."""
        lines, places, last = [], {}, (None, None)
        for thing, group, corners in self.polygons:
            if thing != last[0]:
                lines.append(f"o {thing}")
            if (thing, group) != last:
                lines.append(f"usemtl {group}")
            last = (thing, group)
            numbers = []
            for corner in corners:
                key = tuple(float(x) for x in corner)
                if key not in places:
                    places[key] = len(places) + 1
                    lines.append("v " + " ".join(repr(x) for x in key))
                numbers.append(places[key])
            lines.append("f " + " ".join(map(str, numbers)))
        (folder / "model.obj").write_text("\n".join(lines) + "\n")

    def changed(self, change):
        return Drawing([(thing, group, change(corners)) for thing, group, corners in self.polygons])


def _facts(folder, change):
    import yaml

    path = folder / "scene.yaml"
    facts = yaml.safe_load(path.read_text())
    change(facts)
    path.write_text(json.dumps(facts))


def _camera(folder, change):
    path = folder / "left.posed.cameramodel"
    cameras.write_cameramodel(path, change(cameras.read_cameramodel(path)))


def _posed(camera, R, centre):
    """The camera with its axes turned by R (world) and its centre moved."""
    T = np.eye(4)
    T[:3, :3] = camera.T_cam_world[:3, :3] @ R.T
    T[:3, 3] = -T[:3, :3] @ centre
    return replace(camera, T_cam_world=T)


def same(folder):
    """As it is."""


def in_unit(unit, metres):
    def change(folder):
        Drawing.read(folder).changed(lambda p: p / metres).write(folder)
        _facts(folder, lambda facts: facts.update(model={"unit": unit}))

    return change


def scaled(factor):
    """Another size, told in metres all the same."""

    def change(folder):
        Drawing.read(folder).changed(lambda p: p * factor).write(folder)
        _camera(folder, lambda c: _posed(c, np.eye(3), c.centre * factor))

    return change


def moved(*offset):
    def change(folder):
        Drawing.read(folder).changed(lambda p: p + offset).write(folder)
        _camera(folder, lambda c: _posed(c, np.eye(3), c.centre + offset))

    return change


def turned(seed):
    """About any axis."""
    from scipy.spatial.transform import Rotation

    R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()

    def change(folder):
        Drawing.read(folder).changed(lambda p: p @ R.T).write(folder)
        _camera(folder, lambda c: _posed(c, R, R @ c.centre))

    return change


def mirrored(folder):
    """Model and photograph together: x becomes -x, left becomes right."""
    import cv2

    flip = np.diag([-1.0, 1, 1])
    Drawing.read(folder).changed(lambda p: (p @ flip)[::-1]).write(folder)

    def camera(c):
        K = c.K.copy()
        K[0, 2] = c.width - 1 - K[0, 2]
        T = np.eye(4)
        T[:3, :3] = flip @ c.T_cam_world[:3, :3] @ flip
        T[:3, 3] = -T[:3, :3] @ (flip @ c.centre)
        return replace(c, K=K, T_cam_world=T)

    _camera(folder, camera)
    picture = cv2.imread(str(folder / "left.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(folder / "left.png"), np.ascontiguousarray(picture[:, ::-1]))


def channels(order):
    """Red, green and blue in another order, in the photograph and in what is told."""

    def change(folder):
        import cv2

        picture = cv2.imread(str(folder / "left.png"), cv2.IMREAD_UNCHANGED)
        if picture.ndim == 3:
            cv2.imwrite(str(folder / "left.png"), np.ascontiguousarray(picture[:, :, ::-1][:, :, order][:, :, ::-1]))

        def facts(told):
            for key in ("lamps", "reference"):
                for name, value in told.get(key, {}).items():
                    told[key][name] = [value[k] for k in order]

        _facts(folder, facts)

    return change


def new_names(folder):
    """{group: another name}, such that they sort the other way round."""
    names = sorted({group for _, group, _ in Drawing.read(folder).polygons}, reverse=True)
    return {name: f"g{k:03d}" for k, name in enumerate(names)}


def renamed(folder):
    """Groups and objects under other names."""
    new = new_names(folder)
    polygons = [(f"z-{thing}", new[group], p) for thing, group, p in Drawing.read(folder).polygons]
    Drawing(polygons).write(folder)

    def facts(told):
        for key in ("lamps", "reference", "surfaces"):
            if key in told:
                told[key] = {new.get(name, name): value for name, value in told[key].items()}

    _facts(folder, facts)


def reordered(seed):
    """Polygons in another order, each begun at another corner."""

    def change(folder):
        rng = np.random.default_rng(seed)
        polygons = Drawing.read(folder).polygons
        order = rng.permutation(len(polygons))
        Drawing(
            [
                (thing, group, np.roll(p, int(rng.integers(len(p))), axis=0))
                for thing, group, p in (polygons[k] for k in order)
            ]
        ).write(folder)

    return change


class Answer(NamedTuple):
    """rho, sigma : {group: (3,)} of the groups that are identified;  gamma;  bytes : {goal: its file}"""

    rho: dict
    sigma: dict
    gamma: float
    bytes: dict


def answer(folder, name, goals, threads=2, names=None, order=(0, 1, 2)):
    """What `make` finds in folder/data/<name>, in the terms of the scene as it was."""
    _facts(folder / "data" / name, lambda facts: facts.update(goals=list(goals)))
    words = ["make", f"DATA={folder}/data", f"BUILD={folder}/build", name]
    environment = clean() | {"NUMBA_NUM_THREADS": str(threads)}
    environment |= {key: str(threads) for key in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if threads == 1}
    run = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True)
    if run.returncode:
        raise RuntimeError((run.stdout[-1000:] + run.stderr[-1000:]).strip())
    build = folder / "build" / name
    found = json.loads((build / "materials.json").read_text())
    back = {new: old for old, new in (names or {}).items()}
    place = np.argsort(order)
    groups = {back.get(g, g): value for g, value in found["groups"].items() if value["identified"]}
    return Answer(
        {g: np.array(value["rho_d"])[place] for g, value in groups.items()},
        {g: np.array(value["sigma"]["rho_d"])[place] for g, value in groups.items()},
        found["transfer"].get("gamma"),
        {goal: (build / goal).read_bytes() for goal in goals},
    )
