"""The same scene told otherwise: other units, sizes and places, names and orders; turned, mirrored; one thread or two.

A shipped scene is run by make as it is, and again after each transformation (transformed.py). The value is the largest
difference of a reflectance.
"""

import hashlib
import shutil
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from tests.verify import transformed as t
from tests.verify.walks import Found, walk

SCENE = "flat-grey"
LARGER = ("office", "office-mirror", "desk-brushed")
EXACT, TURNED_EXACT, TURNED_SIGMA = 1e-6, 2e-4, 0.2
WAYS = {
    "as it is, again": t.same,
    "groups and objects renamed": t.renamed,
    "in mm": t.in_unit("mm", 1e-3),
    "in km": t.in_unit("km", 1e3),
    "1000 times larger": t.scaled(1e3),
    "1000 times smaller": t.scaled(1e-3),
    "1000 m away": t.moved(1e3, -1e3, 5e2),
    "1e6 m away": t.moved(1e6, -1e6, 5e5),
    "polygons in another order": t.reordered(1),
}
TURNED = {"turned": t.turned(1), "turned otherwise": t.turned(2)}
MIRRORED = {"mirrored": t.mirrored}


@cache
def answer(way, scene=SCENE):
    """What make finds in a folder of its own, after a transformation of the scene."""
    folder = Path(tempfile.mkdtemp(prefix="verify-"))
    try:
        shutil.copytree(t.ROOT / "data" / scene, folder / "data" / scene)
        told = folder / "data" / scene
        names = t.new_names(told) if way == "groups and objects renamed" else None
        order = [2, 0, 1] if way == "channels in another order" else [0, 1, 2]
        change = {**WAYS, **TURNED, **MIRRORED, "channels in another order": t.channels(order)}.get(way, t.same)
        change(told)
        one = way == "one thread"
        return t.answer(folder, scene, files(way), threads=1 if one else 2, names=names, order=order)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def files(way):
    """The goals of a run: the pictures, too, where bytes are compared."""
    return ["materials.json"] if way not in ("one thread", "two threads") else ["materials.json", "rendered.exr"]


def difference(way, scene=SCENE):
    """(largest difference of rho, the same in sigma of the scene as it is)"""
    here, there = answer("as it is", scene), answer(way, scene)
    if here.rho.keys() != there.rho.keys():
        return np.inf, np.inf
    off = {g: np.abs(there.rho[g] - rho) for g, rho in here.rho.items()}
    z = {g: np.divide(v, here.sigma[g], out=np.zeros_like(v), where=v > 0) for g, v in off.items()}
    return max(float(v.max()) for v in off.values()), max(float(v.max()) for v in z.values())


@walk("told otherwise", "the same scene", law="every reflectance within 1e-6", at=WAYS, short=[2, 7, 8])
def same(way):
    off, z = difference(way)
    return Found(off, 0.0, off, EXACT, None, f"{z:.1g} sigma")


@walk("told otherwise", "channels in another order", law="every reflectance within 1e-6", at=["office"], short=[])
def channels(scene):
    off, z = difference("channels in another order", scene)
    return Found(off, 0.0, off, EXACT, None, f"{z:.1g} sigma")


@walk("told otherwise", "turned", law="within 2e-4 and .2 sigma", at=TURNED, short=[])
def turned(way):
    return _nearly(way, SCENE)


@walk("told otherwise", "mirrored", law="within 2e-4 and .2 sigma", at=[SCENE, *LARGER], short=[])
def mirrored(scene):
    return _nearly("mirrored", scene)


@walk("told otherwise", "turned scenes", law="within 2e-4 and .2 sigma", at=LARGER, short=[])
def turned_scenes(scene):
    return _nearly("turned", scene)


def _nearly(way, scene):
    off, z = difference(way, scene)
    return Found(off, 0.0, max(off / TURNED_EXACT, z / TURNED_SIGMA), 1.0, None, f"{z:.2g} sigma")


@walk("told otherwise", "one thread or two", law="equal bytes", at=["materials.json", "rendered.exr"], short=[])
def threads(name):
    one, two = answer("one thread"), answer("two threads")
    return Found(
        None,
        None,
        float(one.bytes[name] != two.bytes[name]),
        0.0,
        None,
        hashlib.sha256(one.bytes[name]).hexdigest()[:12],
    )
