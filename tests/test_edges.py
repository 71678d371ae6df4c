"""The stage `edges`: camera and objects where the photograph's edges have them, before the light is asked for."""

import json
import runpy
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from lib.analysis.seen import places
from lib.core.stage import BadInput
from lib.given import cameras, edges_file, image
from lib.given import model as models
from lib.given.cameras import matrix_from_rt
from lib.given.view import View
from lib.planning import makefile, scene
from lib.planning.command import command
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import walk
from tests.helpers.changed_scenes import obj

ROOT = Path(__file__).resolve().parents[1]
GIVEN = {"model": "model.obj", "camera": "left.posed.cameramodel", "photograph": "left.png"}


def stage(name, **options):
    """The stage's work in this process."""
    kept = list(sys.path)
    found = runpy.run_path(str(ROOT / "stages" / f"{name}.py"), run_name="tested")
    sys.path[:] = kept
    words = [str(w) for key, value in options.items() for w in (f"--{key.replace('_', '-')}", value)]
    found["main"](found["options"]().parse_args(words))


@pytest.fixture
def office(tmp_path):
    """data/office without its truth."""
    return Path(shutil.copytree(ROOT / "data/office", tmp_path / "office", ignore=shutil.ignore_patterns("truth")))


def registered(folder, refines=True, **options):
    """(edges.json, its report) of a scene's folder."""
    out = folder / "out"
    out.mkdir(exist_ok=True)
    refined = {"camera_out": out / "refined.cameramodel", "model_out": out / "refined.glb"} if refines else {}
    given = {name: folder / file for name, file in GIVEN.items()}
    files = {"edges": out / "edges.json", "report": out / "edges.report.json"}
    stage("edges", **given, lamps='["lamp"]', **refined, **files, **options)
    return edges_file.read(out / "edges.json"), json.loads((out / "edges.report.json").read_text())


def view_of(folder, **refined):
    return View.read(**{name: folder / file for name, file in (GIVEN | refined).items()})


def written(folder):
    return sorted(path.name for path in (folder / "out").glob("refined.*"))


def turn(folder, rt=(0.004, -0.003, 0.001, 0.02, -0.01, 0.01)):
    """The given camera turned and moved, as it stands."""
    path = folder / GIVEN["camera"]
    camera = cameras.read_cameramodel(path)
    cameras.write_cameramodel(path, replace(camera, T_cam_world=matrix_from_rt(list(rt)) @ camera.T_cam_world))


def shift(folder, name, offset):
    def moved(line, thing):
        if thing != name or not line.startswith("v "):
            return line
        return "v " + " ".join(str(float(x) + d) for x, d in zip(line.split()[1:], offset, strict=True))

    obj(folder, moved)


# ---- the stage alone ----


def test_a_camera_that_is_off_is_put_right_and_asked_again(office, run):
    turn(office)
    edges, report = registered(office)
    before = places.by_edges(view_of(office), ["lamp"])
    assert edges.status == report["status"] == "refined" and edges.given == before.told
    assert [cause.cause for cause in edges.taken] == ["pose"] and written(office) == ["refined.cameramodel"]
    refined = cameras.read_cameramodel(office / "out/refined.cameramodel")
    np.testing.assert_allclose(
        refined.T_cam_world, before.refined(view_of(office), None).camera.T_cam_world, atol=1e-14
    )
    true = cameras.read_cameramodel(ROOT / "data/office" / GIVEN["camera"]).T_cam_world
    off = refined.T_cam_world @ np.linalg.inv(true)
    assert np.linalg.norm(cv2.Rodrigues(off[:3, :3])[0]) < 5e-4 and np.linalg.norm(off[:3, 3]) < 5e-3
    again = places.by_edges(view_of(office, camera="out/refined.cameramodel"), ["lamp"])
    assert edges.now == again.told and not edges.now.causes and edges.now.before_px < 0.2 < edges.given.before_px
    (note,) = report["notes"]
    assert note.startswith("put right: the camera is turned by")
    files = {"findings": office / "check.json", "picture": office / "check.png"}
    words = {name: office / file for name, file in GIVEN.items()} | {"edges": office / "out/edges.json"} | files
    said = run("stages/check.py", *(w for name, value in words.items() for w in (f"--{name}", value))).stdout
    assert f"  edges: {edges.given.why[0].text}: it is put right" in said.splitlines()


def test_an_object_that_stands_elsewhere_is_moved_in_the_model(office):
    shift(office, "bin", (0.02, -0.022, 0))
    edges, _ = registered(office)
    assert [(cause.cause, cause.subject) for cause in edges.taken] == [("objects", "bin")]
    assert written(office) == ["refined.glb"] and not edges.now.causes
    moved, true = models.load(office / "out/refined.glb"), models.load(ROOT / "data/office/model.obj")
    assert np.abs(moved.corners() - true.corners()).max() < 2e-3
    assert "bin" not in edges.given.covariances and "bin" in edges.now.covariances


@pytest.mark.parametrize("leave, options", [('["objects"]', {}), ("[]", {}), ("null", {"refines": False})])
def test_what_may_not_be_taken_is_said_alone(office, leave, options):
    turn(office)
    edges, report = registered(office, explain=leave, **options)
    assert edges.status == "elsewhere" and edges.given.why and edges.taken == [] == written(office)
    assert not report["notes"] and edges.now is edges.given


def test_an_exact_scene_stays_as_it_is(office):
    edges, report = registered(office)
    assert report["status"] == "good" and edges.now is edges.given and written(office) == [] == report["notes"]
    found = places.by_edges(view_of(office), ["lamp"])
    assert list(edges.now.covariances) == list(found.registration.loose)  # in their order: sigma is a sum over them
    assert all((edges.now.covariances[name] == C).all() for name, C in found.registration.loose.items())


def test_a_camera_that_looks_elsewhere_is_lost(office, run):
    turn(office, (0, 0, np.pi / 2, 0, 0, 0))
    edges, report = registered(office)
    assert report["status"] == "lost" and edges.now.is_lost and written(office) == []
    files = {"findings": office / "check.json", "picture": office / "check.png"}
    words = {name: office / file for name, file in GIVEN.items()} | {"edges": office / "out/edges.json"} | files
    said = run("stages/check.py", *(w for name, value in words.items() for w in (f"--{name}", value))).stdout
    assert f"! edges: {edges.now.why[0].text}" in said.splitlines()


def test_values_of_another_range_are_not_looked_at(office):
    turn(office)
    path = str(office / "left.png")
    image.write_png8(path, (cv2.imread(path)[..., ::-1] // 17).astype(np.uint8))
    edges, _ = registered(office)
    assert edges.status == "not looked" and edges.now.why == [] == written(office)


def test_a_file_that_is_no_answer_of_edges_is_refused(tmp_path):
    path = tmp_path / "edges.json"
    path.write_text('{"given": {"loose": [{"object": "box", "covariance": [[1]]}], "before_px": -1, "causes": 3}}')
    with pytest.raises(BadInput) as bad:
        edges_file.read(path)
    lines = " ".join(bad.value.problems)
    assert all(f"{path}: given.{field}" in lines for field in ("loose.0.covariance", "before_px", "causes"))


# ---- the plan ----


def planned(folder, *wishes):
    stages = read_pipeline(ROOT / "pipeline.yaml")
    return walk(scene.read(folder, stages), stages, folder.parent / "build", wishes or (None,))


def says(folder, text):
    with open(folder / "scene.yaml", "a") as file:
        file.write(f"\n{text}\n")


def argv(plan, name):
    """{option: value} of a stage's command line."""
    words = command(plan, plan.stages[name], "python").argv[2:]
    return dict(zip(words[::2], words[1::2], strict=True))


def test_all_behind_it_use_what_it_writes_at_the_first_go(office):
    plan = planned(office)
    assert plan.planned[:5] == ["edges", "index", "formfactors", "gather", "fit"] == list(plan.again)
    first, draft = argv(plan.draft, "edges"), plan.build / "draft"
    assert first["--camera-out"] == str(draft / "refined.cameramodel") and "--refined-camera" not in first
    for name in ("index", "gather", "fit"):
        assert argv(plan.draft, name)["--refined-camera"] == str(draft / "refined.cameramodel")
        assert draft / "edges.report.json" in command(plan.draft, plan.stages[name], "python").inputs
    assert argv(plan.draft, "formfactors")["--refined-model"] == str(draft / "refined.glb")
    assert argv(plan.draft, "fit")["--edges"] == str(draft / "edges.json")
    assert "--camera-out" not in argv(plan, "edges") and "--model-out" not in argv(plan, "fit")
    assert argv(plan, "render")["--refined-camera"] == str(plan.build / "refined.cameramodel")
    assert plan.build / "edges.report.json" in command(plan, plan.stages["render"], "python").inputs


def test_the_others_run_again_only_where_the_fit_moves_a_lamp(office):
    plan = planned(office)
    rules = makefile.makefile(plan, "python", ROOT)[0].split("\n\n")
    (second,) = (rule for rule in rules if rule.startswith(f"{plan.build / 'gather.npz'} "))
    tests = [line for line in second.splitlines() if line.startswith("\t@if [ -e ")]
    assert len(tests) == 1 and tests[0].count("[ -e ") == 1 and str(plan.build / "refined.json") in tests[0]


@pytest.mark.parametrize("text", ["explain: []", "params: {fit: {method: paper}}"])
def test_a_scene_in_which_nothing_may_be_other_than_given_has_none(office, text):
    says(office, text)
    plan, check = planned(office), planned(office, "check")
    assert "edges" not in plan.planned and check.planned == ["check"]
    assert "--edges" not in argv(plan, "fit") and "--edges" not in argv(check, "check")


def test_without_leave_for_the_geometry_it_is_said_and_nothing_taken(office):
    says(office, "explain: [curve]")
    plan = planned(office)
    assert plan.planned[0] == "edges" and plan.again == ()
    assert "--camera-out" not in argv(plan, "edges") and argv(plan, "fit")["--edges"] == str(plan.build / "edges.json")


@pytest.mark.parametrize("wish, before", [("index", ["edges"]), ("check", ["edges"]), ("formfactors", ["edges"])])
def test_one_stage_is_asked_for_with_it(office, wish, before):
    assert planned(office, wish).planned == [*before, wish]


def test_a_scene_without_materials_has_none(office):
    says(office, "goals: [group.png]")
    assert "edges" not in planned(office).planned
