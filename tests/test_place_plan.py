"""`movable`, `refine` and objects/: what the plan makes of them, and what is refused."""

from pathlib import Path

import pytest

from lib.core.stage import BadInput
from lib.planning import folder as folders
from lib.planning import scene as scenes
from lib.planning.command import command
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import explain, walk
from tests.helpers.attic import CAMERA, attic

ROOT = Path(__file__).resolve().parents[1]
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wood\nf 1 2 3\n"


@pytest.fixture
def folder(tmp_path):
    return attic(tmp_path)


def read(folder, text):
    (folder / "scene.yaml").write_text(text)
    stages = read_pipeline(ROOT / "pipeline.yaml")
    return scenes.read(folder, stages), stages


def plan(folder, text):
    scene, stages = read(folder, text)
    return walk(scene, stages, folder.parent / "build")


def argv(plan, name):
    words = command(plan, plan.stages[name], "python").argv
    return {words[i]: words[i + 1] for i in range(2, len(words) - 1) if words[i].startswith("--")}


LAMPS = "lamps: {lamp: [1, 1, 1]}\n"


def test_a_scene_that_does_not_ask_does_not_know_the_stage(folder):
    asked = plan(folder, LAMPS)
    assert "place" not in asked.stages and "place" not in explain(asked)
    assert plan(folder, LAMPS + "movable: []\nrefine: []").planned == asked.planned
    (folder / "objects").mkdir()
    assert plan(folder, LAMPS).planned == asked.planned
    assert argv(asked, "index")["--model"].endswith("attic/model.obj")


@pytest.mark.parametrize("text", ["movable: [default]", "refine: [objects]", "objects"])
def test_later_stages_read_the_posed_model(folder, text):
    if text == "objects":
        (folder / "objects").mkdir()
        (folder / "objects" / "chair.obj").write_text(OBJ)
        text = ""
    placed = plan(folder, LAMPS + text)
    assert placed.planned[:2] == ["place", "edges"]
    assert argv(placed, "place")["--model"].endswith("attic/model.obj")
    for name in ("edges", "index", "formfactors", "gather", "fit", "coverage", "render", "report"):
        assert argv(placed, name)["--model"] == str(folder.parent / "build/attic/model.posed.glb"), name
    assert argv(placed, "report")["--pose"].endswith("attic/pose.json")


def test_a_pair_is_recognised_without_the_movable_objects_first(folder):
    (folder / "left.posed.cameramodel").unlink()
    (folder / "right.png").write_bytes(b"\x89PNG")
    for side, x in (("left", 0), ("right", 1)):
        text = CAMERA.format(lens="LENSMODEL_PINHOLE").replace("0., 0. ],", f"0., {x}. ],")
        (folder / f"{side}.cameramodel").write_text(text)
    placed = plan(folder, LAMPS + "movable: [default]")
    recognise, place = argv(placed, "recognise"), argv(placed, "place")
    assert recognise["--movable"] == place["--movable"] == '["default"]'
    assert recognise["--pose"] == place["--camera-pose"] and recognise["--pose"].endswith("pose.camera.json")
    assert recognise["--model"].endswith("model.obj") and place["--pose"].endswith("attic/pose.json")
    assert place["--camera-right"].endswith("right.posed.cameramodel") and place["--photograph-right"]
    assert "--movable" not in argv(plan(folder, LAMPS), "recognise")


def test_a_lone_pose_runs_no_stereo(folder):
    """left.posed.cameramodel and right.png: nothing tells where the right camera stands, and it is not asked for."""
    (folder / "right.png").write_bytes(b"\x89PNG")
    placed = plan(folder, LAMPS + "movable: [default]")
    assert "recognise" not in placed.planned and "--camera-right" not in argv(placed, "place")
    (folder / "right.posed.cameramodel").write_text(CAMERA.format(lens="LENSMODEL_PINHOLE"))
    assert argv(plan(folder, LAMPS + "movable: [default]"), "place")["--camera-right"].endswith(
        "attic/right.posed.cameramodel"
    )


@pytest.mark.parametrize(
    "text, line",
    [
        ("movable: chair", 'movable: "chair" is not a list of objects of the model'),
        ("movable: [7]", "movable: 7 is not a name (quote it)"),
        ("movable: [chair, chair]", 'movable: "chair" stands there twice'),
        ("movable: [lamp, {a: b}]", 'movable: {"a": "b"} is not a name (quote it)'),
        ("movable:", "movable: is empty: leave the key out or give it a value"),
        ("refine: objects", 'refine: "objects" is not a list of objects'),
        ("refine: [pose]", 'refine: "pose" is none of objects'),
        ("refine: [objects, objects]", 'refine: "objects" stands there twice'),
        ("refine: [[objects]]", 'refine: ["objects"] is not a name (quote it)'),
    ],
)
def test_what_is_refused(folder, text, line):
    assert f"{folder}/scene.yaml: {line}" in read(folder, text)[0].problems


def test_names_of_objects(folder):
    (folder / "objects").mkdir()
    for name in ("chair.obj", "chair.glb", "my chair.obj", "read.me"):
        (folder / "objects" / name).write_text(OBJ)
    problems = read(folder, "movable: [chair]")[0].problems
    assert f"{folder}/objects: chair.glb and chair.obj: only one of them may be given" in problems
    assert f"{folder}/objects/my chair.obj: my chair: is not a name of letters, digits, _ and -" in problems
    assert any(
        line.startswith(f'{folder}/scene.yaml: movable: "chair" is {folder}/objects/chair.') for line in problems
    )
    assert len(problems) == 3


def test_the_folder_is_opened_before_anything_runs(folder):
    """Objects that the model has not, and files that are no models."""
    (folder / "objects").mkdir()
    (folder / "objects" / "default.obj").write_text(OBJ)
    (folder / "objects" / "stool.obj").write_text("v 0 0 0\n")
    scene, _ = read(folder, "movable: [chiar]")
    problems = folders.inspect(scene, {"model.obj|glb", "objects/"})
    assert f'{folder}/scene.yaml: movable: "chiar" names no object of model.obj, which has default' in problems
    assert any(
        line.startswith(f"{folder}/objects/default.obj: default: is an object of model.obj too") for line in problems
    )
    assert f"{folder}/objects/stool.obj: faces: the model has none" in problems


def test_objects_is_a_folder(folder):
    (folder / "objects").write_text("")
    with pytest.raises(BadInput, match="objects: is a file, not a folder"):
        plan(folder, LAMPS)
