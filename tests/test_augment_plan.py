"""`augment` in scene.yaml: what is refused, and what the plan makes of an entry."""

from pathlib import Path

import pytest

from lib.planning import augment
from lib.planning import scene as scenes
from lib.planning.command import command
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import explain, walk
from tests.helpers.attic import attic

ROOT = Path(__file__).resolve().parents[1]
LAMPS = "lamps: {lamp: [1, 1, 1]}\n"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wood\nf 1 2 3\n"
CSV = "eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,1,1,0,1\n0,1,1,1,1,1\n"


@pytest.fixture
def folder(tmp_path):
    folder = attic(tmp_path)
    (folder / "teapot.obj").write_text(OBJ)
    (folder / "way.csv").write_text(CSV)
    (folder / "door.cameramodel").write_text((folder / "left.posed.cameramodel").read_text())
    return folder


def read(folder, text):
    (folder / "scene.yaml").write_text(LAMPS + text)
    stages = read_pipeline(ROOT / "pipeline.yaml")
    return scenes.read(folder, stages), stages


def plan(folder, text, *wishes):
    scene, stages = read(folder, text)
    return walk(scene, stages, folder.parent / "build", wishes or (None,))


TEAPOT = "{name: teapot, add: {file: teapot.obj, at: [1, 0, 0.8], material: {kind: mirror}}}"
WALK = "{name: walk, cameras: way.csv, frames: 12}"


def test_each_entry_is_a_stage_and_a_goal(folder):
    asked = plan(folder, f"augment: [{TEAPOT}, {WALK}]")
    assert [name for name in asked.planned if name.startswith("augment")] == ["augment.teapot", "augment.walk"]
    made = {"augmented.teapot.png", "augmented.teapot.exr", "augmented.walk.mp4"}
    assert made <= set(asked.goals)
    argv, inputs = command(asked, asked.stages["augment.teapot"], "python")
    words = {argv[i]: argv[i + 1] for i in range(2, len(argv) - 1) if argv[i].startswith("--")}
    assert words["--picture"].endswith("attic/augmented.teapot.png") and "--preview" not in words
    assert f'"file": "{folder / "teapot.obj"}"' in words["--entry"]
    assert words["--report"].endswith("augment.teapot.report.json") and words["--rays"] == "256"
    assert folder / "teapot.obj" in inputs and folder / "way.csv" not in inputs
    argv, inputs = command(asked, asked.stages["augment.walk"], "python")
    assert argv[argv.index("--frames") + 1].endswith("attic/augmented.walk") and "--picture" not in argv
    assert folder / "way.csv" in inputs


def test_a_scene_that_does_not_ask_does_not_know_the_stage(folder):
    asked = plan(folder, "augment: []")
    assert not any(name.startswith("augment") for name in asked.stages) and "augment" not in explain(asked)
    assert asked.goals == plan(folder, "").goals


def test_one_entry_alone_and_all_of_them(folder):
    text = f"goals: [materials.json]\naugment: [{TEAPOT}, {WALK}]"
    assert "augment.walk" not in plan(folder, text, "augment.teapot").planned
    both = plan(folder, text, "augment").planned
    assert {"augment.teapot", "augment.walk"} <= set(both) and "render" not in both
    assert plan(folder, f"goals: [augmented.teapot.exr]\naugment: [{TEAPOT}]").planned[-2:] != []


def test_a_change_of_an_entry_changes_its_command_alone(folder):
    before = plan(folder, f"augment: [{TEAPOT}, {WALK}]")
    after = plan(folder, f"augment: [{TEAPOT.replace('1, 0, 0.8', '1, 0, 0.9')}, {WALK}]")
    lines = [{name: command(p, p.stages[name], "python").argv for name in p.planned} for p in (before, after)]
    assert [name for name in lines[0] if lines[0][name] != lines[1][name]] == ["augment.teapot"]


MATERIAL = "material: {kind: diffuse, rho_d: [0.5, 0.5, 0.5]}"


@pytest.mark.parametrize(
    ("entry", "line"),
    [
        ("name: a, colour: red", 'colour: "red" is an unknown key'),
        ("name: a b", 'name: "a b" is not a name'),
        ("name: a, camera: no.cameramodel", 'camera: "no.cameramodel" is not in the scene\'s folder'),
        ("name: a, camera: ../x.cameramodel", 'camera: "../x.cameramodel" lies outside the scene\'s folder'),
        ("name: a, camera: door.cameramodel, cameras: way.csv", 'cameras: "way.csv" stands beside `camera`'),
        ("name: a, cameras: [door.cameramodel], frames: 3", "is not a list of at least two files"),
        ("name: a, cameras: [door.cameramodel, door.cameramodel]", "frames: is missing"),
        ("name: a, cameras: way.csv, frames: 1", "frames: 1 is not a whole number from 2"),
        ("name: a, frames: 3", "frames: 3 needs `cameras`"),
        ("name: a, add: 3", "add: 3 is not a mapping"),
        ("name: a, add: {sphere: 1, at: [0, 0, 0]}", "add.material: is missing"),
        ("name: a, add: {sphere: 1, ellipsoid: [1, 1, 1], %s}", "is not exactly one of file, ellipsoid, sphere"),
        ("name: a, add: {sphere: -1, %s}", "add.sphere: -1 is not a positive radius"),
        ("name: a, add: {ellipsoid: [1, 0, 1], %s}", "is not three positive semi-axes"),
        ("name: a, add: {file: door.cameramodel, %s}", "is not a file ending in obj or glb"),
        ("name: a, add: {sphere: 1, at: [0, .nan, 0], %s}", "is not finite"),
        ("name: a, add: {sphere: 1, scale: 0, %s}", "add.scale: 0 is not a positive number"),
        ("name: a, add: {sphere: 1, material: {kind: velvet}}", 'material.kind: "velvet" is none of diffuse'),
        ("name: a, add: {sphere: 1, material: {kind: diffuse}}", "rho_d: is missing: a diffuse surface needs it"),
        ("name: a, add: {sphere: 1, material: {kind: coloured_mirror}}", "rho_s: is missing"),
        ("name: a, add: {sphere: 1, material: {kind: mirror, rho_s: [1, 1, 2]}}", "rho_s: [1, 1, 2] is outside [0, 1]"),
        (
            "name: a, add: {sphere: 1, material: {kind: coloured_mirror, rho_d: [1, 0, 0], rho_s: [1, 0, 0]}}",
            "reflects more than it receives",
        ),
        ("name: a, change: {wall: {rho_s: [1, 1, 1], kind: diffuse, rho_d: [0, 0, 0]}}", "has no meaning for diffuse"),
        (
            "name: a, change: {wall: {kind: glossy, rho_d: [0, 0, 0], rho_s: [1, 0, 0]}}",
            "alpha: is missing: a glossy surface needs it",
        ),
        ("name: a, change: {wall: {emittance: [1, 1, 1]}}", "is of added objects; `lamps` changes a lamp"),
        ("name: a, remove: carton", 'remove: "carton" is not a list of objects'),
        ("name: a, remove: [x, x]", 'remove: "x" stands there twice'),
        ("name: a, remove: [x], move: {x: [0, 0, 1]}", "is of an object that is removed"),
        ("name: a, move: {x: [0, 0]}", "move.x: [0, 0] is not a list of three numbers"),
        ("name: a, lamps: {lamp: [-1, 0, 0]}", "lamps.lamp: [-1, 0, 0] is negative"),
        ("name: a, grain: 1", "grain: 1 is neither true nor false"),
    ],
)
def test_one_line_per_problem(folder, entry, line):
    scene, _ = read(folder, f"augment: [{{{entry % MATERIAL if '%s' in entry else entry}}}]")
    assert len(scene.problems) == 1 and line in scene.problems[0]
    assert scene.problems[0].startswith(f"{folder / 'scene.yaml'}: augment[0]")


def test_pictures_that_look_at_the_photograph_cannot_be_changed(folder):
    scene, _ = read(folder, f"transfer: histogram\naugment: [{TEAPOT}]")
    assert "needs a transfer function of the light alone" in "\n".join(scene.problems)


def test_names_are_looked_for_in_the_model(folder, tmp_path):
    from lib.given import model as models

    scene, _ = read(
        folder,
        "augment:\n  - {name: a, remove: [x], move: {y: [0, 0, 1]}, change: {z: {rho_d: [0, 0, 0]}}, lamps:"
        " {q: [1, 1, 1]}}\n"
        "  - {name: b, add: {file: teapot.obj, material: {iron: {kind: mirror}}}}",
    )
    found = list(augment.inspect(scene, models.load(folder / "model.obj")))
    assert [line.split(": ", 2)[1:] for line in found][:4] == [
        ["augment[0].change", '"z" names no group of the model, which has wall, lamp, light box'],
        ["augment[0].lamps", '"q" names no lamp of scene.yaml, which has lamp'],
        ["augment[0].remove", '"x" names no object of the model, which has default'],
        ["augment[0].move", '"y" names no object of the model, which has default'],
    ]
    assert '"wood" of teapot.obj is missing' in found[4] and "names no group of teapot.obj" in found[5]
