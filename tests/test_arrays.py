"""Arrays of intermediate results: another kind, shape or value than they must have is one line, whoever reads it."""

import json

import numpy as np
import pytest

from lib.analysis.answer.task import Task
from lib.analysis.seen import gather
from lib.core import arrays
from lib.core.arrays import Flag, Real, Size, Starts, Text, Whole
from lib.core.stage import BadInput
from lib.light import chains, factors_file, specular, specular_file
from lib.light import lamps as lamps_
from lib.light.mirror_view import MirrorView
from lib.light.specular_file import Traced
from tests.helpers import rooms, small_scenes, stages
from tests.helpers.boxes import look

TABLE = {"n": Size("N"), "start": Starts("T+1", into="K"), "of": Whole("K", below="N"), "x": Real("T", 2, low=0)}
TABLE |= {"pairs": Whole("2N", low=-1), "on": Flag(), "names": Text("T")}
SOUND = {
    "n": np.array(4),
    "start": np.array([0, 2, 2, 3]),
    "of": np.array([3, 0, 1]),
    "x": np.zeros((3, 2)),
    "pairs": -np.ones(8, int),
    "on": np.array(True),
    "names": np.array(["a", "b", "c"]),
}
WRONG = {
    "n": (np.array([4]), "shape: (1,) is not ()"),
    "start": (np.array([0, 2, 1, 3]), "value: starts do not rise from 0"),
    "of": (np.array([3, 0, 4]), "value: 4 is not below N = 4"),
    "x": (np.full((3, 2), np.nan), "holds a value that is not finite"),
    "pairs": (np.zeros(7, int), "shape: (7,) is not (2N,) with N = 4"),
    "on": (np.array(1), "type: int64 where true or false should be"),
    "names": (np.array(["a", "b"]), "shape: (2,) is not (T,) with T = 3"),
}


def test_sizes_are_told_by_the_first_array_that_has_them():
    assert arrays.check("a.npz", SOUND, TABLE) == {"N": 4, "T": 3, "K": 3}
    with pytest.raises(BadInput, match=r"^a.npz: n: value: 4 is not N = 5$"):
        arrays.check("a.npz", SOUND, TABLE, {"N": 5})
    with pytest.raises(BadInput, match=r"^a.npz: x: value: -1.0 is less than 0$"):
        arrays.check("a.npz", SOUND | {"x": SOUND["x"] - 1}, TABLE)
    with pytest.raises(BadInput, match=r"^a.npz: start: value: the last start, 9, is not K = 3$"):
        arrays.check("a.npz", SOUND | {"start": np.array([0, 2, 2, 9])}, TABLE, {"K": 3})


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said(name):
    with pytest.raises(BadInput) as refused:
        arrays.check("a.npz", SOUND | {name: WRONG[name][0]}, TABLE)
    assert str(refused.value) == f"a.npz: {name}: {WRONG[name][1]}"


def spoilt(array):
    """{how: the array of another kind, another shape, or with a value that none can have}"""
    yield "kind", np.full(array.shape, "x") if array.dtype.kind != "U" else np.zeros(array.shape)
    yield "axis", array[..., None]
    if array.ndim and len(array):
        yield "short", array[:-1] if len(array) > 1 else np.concatenate([array, array])
    if array.dtype.kind == "f":
        yield "nan", np.full(array.shape, np.nan)
    if array.dtype.kind == "i" and array.size:
        yield "less", np.full(array.shape, -9)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """formfactors.npz, gather.npz, audit.npz and specular.npz of a small room."""
    folder = tmp_path_factory.mktemp("arrays")
    K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
    objects = rooms.room() | rooms.LAMP
    made = small_scenes.Studio(folder, objects, look((0.3, 0.3, 1.6), (2.4, 2.2, 0.9), K, 80, 60), patches=30, rays=16)
    light = np.random.default_rng(0).uniform(0.2, 0.4, (60, 80, 1))
    made.write(small_scenes.photograph(light))
    s, mesh, lamps = made.surface, made.factors.mesh, lamps_.emitters(made.surface, ["lamp"])
    transport = specular.transport(s, mesh, small_scenes.finish(s, bottom="mirror"), chains.Chains(1), lamps, 1)
    some = np.zeros(2, int)
    view = MirrorView(some, some, np.zeros((2, 3)), some, np.zeros((2, 3)))
    specular_file.write(folder / "specular.npz", Traced(transport, some, view, np.array([[0, 0, -1.0, -1]])))
    return folder


READ = {"formfactors": factors_file.read, "gather": gather.read, "audit": gather.read, "specular": specular_file.read}
# of any length or sign as far as this file knows; `fit` compares `visible` with the groups
FREE = {"finish_kind", "complete", "lamp_0_mirrors", "visible", "F_chains", "D_chains"}


@pytest.mark.parametrize("name", READ)
def test_no_array_may_be_other_than_it_must(folder, name, tmp_path):
    READ[name](folder / f"{name}.npz")
    with np.load(folder / f"{name}.npz") as file:
        sound = dict(file)
    path, believed = tmp_path / f"{name}.npz", []
    for key, array in sound.items():
        for how, other in spoilt(array):
            np.savez(path, **sound | {key: other})
            try:
                READ[name](path)
                believed.append((key, how))
            except BadInput as error:
                assert str(error).startswith(f"{path}: ") and "\n" not in str(error), error
    assert {key for key, _ in believed} <= FREE, believed


TOGETHER = {
    "lamps": ("tiles_direct", lambda a: np.repeat(a, 2, axis=1), "2 lamps are not those of .*formfactors.npz: lamp$"),
    "groups": ("visible", lambda a: a[:-1], None),
    "facets": ("tiles_facet", lambda a: a + 99, r"value: \d+ is beyond the 7 facets of .*model.obj$"),
    "objects": ("object", lambda a: a + 99, r"value: \d+ is beyond the 2 objects of .*model.obj$"),
    "pixels": ("tiles_pixel", lambda a: a + 4800, r"value: \d+ is beyond the 4800 pixels of .*facet.png$"),
}


@pytest.mark.parametrize("what", TOGETHER)
def test_light_of_another_scene_is_refused(folder, what, tmp_path):
    """gather.npz that is sound by itself, and does not belong to the other files."""
    key, change, message = TOGETHER[what]
    with np.load(folder / "gather.npz") as file:
        sound = dict(file)
    np.savez(tmp_path / "gather.npz", **sound | {key: change(sound[key])})
    files = {"formfactors": "formfactors.npz", "audit": "audit.npz", "model": "model.obj", "facet": "facet.png"}
    files |= {"camera": "camera.cameramodel", "photograph": "left.png"}
    words = {name: folder / file for name, file in files.items()} | {"gather": tmp_path / "gather.npz"}
    words |= {"lamps": json.dumps({"lamp": [1]}), "materials": tmp_path / "materials.json"}
    with pytest.raises(BadInput, match=rf"gather.npz: {key}: {message}" if message else "gather.npz: "):
        task_of(words).view()


def task_of(words):
    """What stages/fit.py reads of its command line. words : {option: value}"""
    options = stages.module("fit").options()
    return Task.read(options.parse_args([str(w) for name, value in words.items() for w in (f"--{name}", value)]))


@pytest.mark.parametrize("where", ["loose", "causes"])
def test_edges_of_another_scene_are_refused(folder, where, tmp_path):
    """Objects that the model has not: of what stays, or of what was moved."""
    sofa = {"object": "sofa", "covariance": np.eye(6).tolist()} if where == "loose" else {"subject": "sofa"}
    (tmp_path / "edges.json").write_text(
        json.dumps({"given": {where: [sofa]}, "refined": None if where == "loose" else {}})
    )
    files = {"formfactors": "formfactors.npz", "audit": "audit.npz", "model": "model.obj", "facet": "facet.png"}
    files |= {"camera": "camera.cameramodel", "photograph": "left.png", "gather": "gather.npz"}
    words = {name: folder / file for name, file in files.items()} | {"edges": tmp_path / "edges.json"}
    task = task_of(words | {"lamps": json.dumps({"lamp": [1]}), "materials": tmp_path / "materials.json"})
    with pytest.raises(BadInput, match="edges.json: object: 'sofa' is none of"):
        task.view()
