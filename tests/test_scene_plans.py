"""Scenes with the real pipeline: what is not built, what matters for some goals, which camera a stage sees."""

import itertools
import struct
from pathlib import Path

import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import image
from lib.given.cameras import matrix_from_rt
from lib.planning import doctor, files, makefile, rules
from lib.planning import scene as scenes
from lib.planning.command import command
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import explain, walk
from tests.helpers.attic import CAMERA, attic

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def folder(tmp_path):
    return attic(tmp_path)


def plan(folder, *wishes):
    """The real pipeline beside empty executables."""
    project = folder.parent / "project"
    (project / "stages").mkdir(parents=True, exist_ok=True)
    (project / "pipeline.yaml").write_text((ROOT / "pipeline.yaml").read_text())
    stages = read_pipeline(project / "pipeline.yaml")
    for stage in stages.values():
        Path(stage.script).touch()
    return walk(scenes.read(folder, stages), stages, folder.parent / "build", wishes or (None,))


def refusal(folder, text, *wishes):
    (folder / "scene.yaml").write_text(text)
    with pytest.raises(BadInput) as bad:
        plan(folder, *wishes)
    return [line.replace(f"{folder}/", "") for line in bad.value.problems]


def test_lamps_are_needed_when_a_goal_needs_photometry(folder):
    said = "scene.yaml: lamps: missing, and formfactors needs to know which groups emit: write `lamps: {lamp: unknown}`"
    assert [line for line in refusal(folder, "goals: [formfactors.npz]") if line.startswith(said)]
    (folder / "scene.yaml").write_text("goals: [group.png]")
    assert plan(folder).planned == ["index", "compare"]


def test_what_is_left_out_and_why(folder):
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}")
    assert (
        explain(plan(folder))
        == """attic: edges -> index -> formfactors -> gather -> fit -> coverage -> render -> compare -> report
  without units: no goal needs it
  without calibrate: no goal needs it
  without undistort: no goal needs it
  without undistort_right: no goal needs it
  without orient: no goal needs it
  without segment: no goal needs it
  without surfaces: no goal needs it
  without match: no goal needs it
  without reconstruct: no goal needs it
  without recognise: its output is given (left.posed.cameramodel)
  without radiosity: no goal needs it
  without mirror buffers, lobes and textures: fit and render make them only where a group's error, or `surfaces`, \
demands it; never for groups named diffuse
  without a second run of edges, index, formfactors, gather, fit: only where its light puts a lamp elsewhere"""
    )


def test_a_model_in_millimetres_is_read_in_metres_by_all_others(folder):
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}\nmodel: {unit: mm}")
    found = plan(folder)
    assert found.planned[0] == "units"
    readers = [name for name in found.planned if "model" in found.stages[name].reads]
    assert {found.stages[name].reads["model"] for name in readers[1:]} == {"model.metres.glb"}
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}\nmodel: {unit: m, up: z}")
    assert "units" not in plan(folder).planned


SEE = ["segment", "surfaces", "match", "reconstruct", "recognise"]
BENT = ["undistort", "undistort_right"]
FIT = ["edges", "index", "formfactors", "gather", "fit", "compare"]


def cameras(folder, *names, lens="LENSMODEL_PINHOLE", apart=0.1):
    """Camera files of those names; those of the right photograph stand `apart` metres to the side."""
    for name in names:
        rt = f"[ 0., 0., 0., {-apart if 'right' in name else 0.0}, 0., 0. ]"
        bent = ", 0." * {"LENSMODEL_OPENCV5": 5, "LENSMODEL_OPENCV8": 8}.get(lens, 0)
        (folder / f"{name}.cameramodel").write_text(
            CAMERA.format(lens=lens)
            .replace("[ 0., 0., 0., 0., 0., 0. ]", rt)
            .replace("1.5, 1.5 ]", f"1.5, 1.5{bent} ]")
        )


def chain(folder, text="lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]", *wishes):
    (folder / "scene.yaml").write_text(text)
    return plan(folder, *wishes).planned


def options(folder, stage):
    planned = plan(folder)
    argv, _ = command(planned, planned.stages[stage], "python3")
    return {word[2:]: Path(value).name for word, value in itertools.pairwise(argv[2:]) if word.startswith("--")}


@pytest.fixture
def pair(folder):
    """A pair of unknown pose, with a model."""
    (folder / "left.posed.cameramodel").unlink()
    (folder / "right.png").write_bytes(b"\x89PNG")
    return folder


def test_a_pair_with_boards_runs_the_whole_chain(pair, monkeypatch):
    monkeypatch.setitem(doctor.NEEDS, "mrcal", (lambda: True, "", None))
    (pair / "boards").mkdir()
    text = "board: {corners: [9, 6], square_m: 0.03}\nlamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]\n"
    assert chain(pair, text) == ["calibrate", *BENT, *SEE, *FIT]
    assert (
        options(pair, "recognise")["camera-right"] == "right.pinhole.cameramodel"
        and options(pair, "index")["camera"] == "left.posed.cameramodel"
    )
    assert (
        options(pair, "segment")["photograph-right"] == "right.pinhole.png"
        and options(pair, "fit")["photograph"] == "left.pinhole.png"
    )
    assert chain(pair, text + "lens: LENSMODEL_PINHOLE") == ["calibrate", *SEE, *FIT]
    assert options(pair, "match")["camera"] == "left.cameramodel" and options(pair, "index")["photograph"] == "left.png"
    assert refusal(pair, "lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]") == [
        "scene.yaml: board: missing, and calibrate needs to know the corners and squares of boards/"
    ]


def test_a_pair_alone_has_its_lenses_and_its_relative_pose_estimated(pair):
    assert chain(pair) == ["calibrate", "orient", *SEE, *FIT]
    found = options(pair, "reconstruct")
    assert found["camera"] == "left.oriented.cameramodel" and found["orientation"] == "orientation.json"


def test_given_cameras_of_the_pair(pair):
    cameras(pair, "left", "right")
    assert chain(pair) == [*SEE, *FIT] and options(pair, "match")["camera-right"] == "right.cameramodel"
    cameras(pair, "left", "right", lens="LENSMODEL_OPENCV5")
    assert chain(pair) == [*BENT, *SEE, *FIT] and options(pair, "match")["camera-right"] == "right.pinhole.cameramodel"
    assert options(pair, "undistort_right")["lens-camera"] == "right.cameramodel"
    cameras(pair, "left", "right", apart=5e-10)
    assert chain(pair) == ["orient", *SEE, *FIT] and options(pair, "orient")["lens-camera"] == "left.cameramodel"
    cameras(pair, "left", "right", lens="LENSMODEL_OPENCV5", apart=0)
    assert (
        chain(pair) == [*BENT, "orient", *SEE, *FIT]
        and options(pair, "orient")["lens-camera"] == "left.pinhole.cameramodel"
    )
    assert options(pair, "recognise")["camera"] == "left.oriented.cameramodel"


def test_the_same_centre_behind_different_rotations(pair):
    """x_cam = R (x - c), whatever R: only the centres are compared."""
    rng = np.random.default_rng(0)
    centre = rng.normal(size=3)
    for name, shift in (("left", 0), ("right", 0), ("right", 1e-6)):
        r = rng.normal(size=3)
        t = -matrix_from_rt([*r, 0, 0, 0])[:3, :3] @ (centre + shift)
        (pair / f"{name}.cameramodel").write_text(
            CAMERA.format(lens="LENSMODEL_PINHOLE").replace(
                "[ 0., 0., 0., 0., 0., 0. ]", str([*map(float, r), *map(float, t)])
            )
        )
        np.testing.assert_allclose(files.centre_of(pair / f"{name}.cameramodel"), centre + shift, atol=1e-12)
        if name == "right":
            (pair / "scene.yaml").write_text("")
            assert scenes.unoriented(scenes.read(pair, {})) == (shift == 0)


def test_one_camera_without_the_other(pair):
    cameras(pair, "left")
    assert refusal(pair, "goals: [facets.json]") == [
        "left.cameramodel: is given, but not that of the other photograph: give both, or none"
    ]


def test_a_posed_photograph_with_a_lens_is_undistorted_and_keeps_its_pose(folder):
    cameras(folder, "left.posed", lens="LENSMODEL_OPENCV8")
    assert chain(folder) == ["undistort", *FIT]
    assert options(folder, "undistort")["lens-camera"] == "left.posed.cameramodel"
    assert options(folder, "index") | {
        "camera": "left.pinhole.cameramodel",
        "photograph": "left.pinhole.png",
    } == options(folder, "index")


def large(path, size=(6000, 4000)):
    """The first bytes of a PNG of that size."""
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", *size))


def test_a_large_photograph_is_made_smaller_and_keeps_its_pose(folder):
    large(folder / "left.png")
    assert chain(folder) == ["undistort", *FIT]
    assert options(folder, "undistort")["megapixels"] == "6"
    assert options(folder, "index")["photograph"] == "left.pinhole.png"
    assert options(folder, "index")["camera"] == "left.pinhole.cameramodel"
    text = "lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]\nparams: {undistort: {megapixels: 24}}"
    assert chain(folder, text) == FIT
    large(folder / "left.png", (3000, 2000))
    assert chain(folder) == FIT


def test_a_large_photograph_beside_given_pictures_of_its_pixels_stays(folder):
    large(folder / "left.png")
    (folder / "group.png").write_bytes(b"\x89PNG")
    assert "undistort" not in chain(folder)


def test_the_pose_is_told_in_the_pixels_of_a_large_photograph(folder):
    """Without a lens the pose is of the photograph as it was taken, and undistortion makes both smaller."""
    (folder / "left.posed.cameramodel").unlink()
    large(folder / "left.png")
    (folder / "pose.csv").write_text("x_px,y_px,X,Y,Z\n" + "".join(f"{k},{k * k},{k},0,1\n" for k in range(9)))
    assert chain(folder) == ["undistort", "pose", *FIT]
    told = options(folder, "pose")
    assert told["photograph"] == "left.png" and "lens" not in told and "pinhole" not in told
    assert options(folder, "undistort")["lens-camera"] == told["posed"] == "left.posed.cameramodel"
    assert options(folder, "index")["camera"] == "left.pinhole.cameramodel"
    cameras(folder, "left")
    assert chain(folder) == ["undistort", "pose", *FIT]
    told = options(folder, "pose")
    assert told["photograph"] == "left.pinhole.png" and told["pinhole"] == "left.pinhole.cameramodel"
    assert options(folder, "undistort")["lens-camera"] == told["lens"] == "left.cameramodel"


def test_a_pose_that_is_told_beside_boards_is_in_the_pixels_of_the_lens(pair, monkeypatch):
    monkeypatch.setitem(doctor.NEEDS, "mrcal", (lambda: True, "", None))
    (pair / "boards").mkdir()
    (pair / "pose.csv").write_text("x_px,y_px,X,Y,Z\n" + "".join(f"{k},{k * k},{k},0,1\n" for k in range(9)))
    text = "board: {corners: [9, 6], square_m: 0.03}\nlamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]\n"
    assert chain(pair, text)[:2] == ["calibrate", "undistort"]
    told = options(pair, "pose")
    assert told["photograph"] == "left.pinhole.png" and told["lens"] == "left.cameramodel"
    assert told["pinhole"] == "left.pinhole.cameramodel"


def test_a_large_pair_without_cameras(pair):
    for side in files.SIDES:
        large(pair / f"{side}.png")
    assert chain(pair) == ["calibrate", *BENT, "orient", *SEE, *FIT]
    assert options(pair, "undistort_right")["lens-camera"] == "right.cameramodel"
    assert options(pair, "segment")["photograph-right"] == "right.pinhole.png"


def test_light_stays_light_when_it_is_undistorted(folder):
    (folder / "left.png").rename(folder / "left.exr")
    cameras(folder, "left.posed", lens="LENSMODEL_OPENCV8")
    assert chain(folder) == ["undistort", *FIT] and options(folder, "gather")["photograph"] == "left.pinhole.exr"


def test_one_photograph_alone_is_segmented(folder):
    assert chain(folder, "goals: [left.regions.png]") == ["segment", "compare"]
    assert "regions-right" not in options(folder, "segment")
    found = " ".join(refusal(folder, "goals: [matches.csv]"))
    assert "needs right.png or right.jpg or right.tif or right.exr, which is not in the scene's folder" in found


def test_vision_files_of_a_pair_whose_poses_are_given(folder):
    (folder / "right.png").write_bytes(b"\x89PNG")
    cameras(folder, "left.posed", "right.posed")
    assert chain(folder, "goals: [facets.json]") == ["segment", "surfaces", "match", "reconstruct", "compare"]
    assert options(folder, "match")["camera"] == "left.posed.cameramodel"


def spoil(folder, what):
    """One of the given files is not what it should be; returns what the one line must name."""
    photograph, model, camera = folder / "left.png", folder / "model.obj", folder / "left.posed.cameramodel"
    if what == "truncated":
        photograph.write_bytes(photograph.read_bytes()[:-20])
        return "left.png: truncated: "
    if what == "size":
        camera.write_text(camera.read_text().replace("[ 4, 4 ]", "[ 5, 4 ]"))
        return "left.png: size: 4 x 4 is not the camera's 5 x 4"
    if what == "nan":
        model.write_text(model.read_text().replace("v 1 0 0", "v 1 nan 0"))
        return "model.obj: line 3: vertex y = nan is not finite"
    if what == "index":
        model.write_text(model.read_text().replace("f 1 2 3", "f 1 2 4", 1))
        return "model.obj: line 6: face index 4 is out of range"
    if what == "camera":
        camera.write_text("{ 'lensmodel': ")
        return "left.posed.cameramodel: not a camera model"
    model.write_text(model.read_text().replace("usemtl lamp", "usemtl wall"))
    return "scene.yaml: lamps.lamp: [1, 1, 1] names no group of model.obj, which has light box, wall"


@pytest.mark.scene
@pytest.mark.parametrize("what", ["truncated", "size", "nan", "index", "camera", "group"])
def test_bad_files_are_refused_before_anything_is_written(folder, refuses, run, what):
    image.write_png8(folder / "left.png", np.full((4, 4, 3), 100))
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}")
    words = [
        "-m",
        "lib.planning.plan",
        "--data",
        folder.parent,
        "--build",
        folder.parent / "build",
        f"{folder.name}/index",
    ]
    line = spoil(folder, what)
    (said,) = refuses(*words)
    assert said.startswith(f"plan.py: {folder}/{line}") and not (folder.parent / "build").exists()


def test_good_files_are_opened_once(folder, run, monkeypatch):
    image.write_png8(folder / "left.png", np.full((4, 4, 3), 100))
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}")
    makefile.write(plan(folder), "python3", folder.parent / "project")
    monkeypatch.setattr(makefile.folder, "inspect", None)
    makefile.write(plan(folder), "python3", folder.parent / "project")


def test_a_missing_model(folder):
    (folder / "model.obj").unlink()
    (found,) = refusal(folder, "lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]")
    assert found.startswith(
        "scene.yaml: goals: materials.json needs model.obj or model.glb, which is not in the scene's folder (stage "
    )


def test_the_contract_is_the_projects_own_copy():
    text = (ROOT / "data/SCENE.md").read_text()
    assert text.startswith("# The scene contract") and all(f"{key}:" in text for key in rules.KEYS)


def test_every_file_between_stages_is_described():
    text = (ROOT / "data/SCENE.md").read_text() + (ROOT / "data/FORMATS.md").read_text()
    names = {file for stage in read_pipeline(ROOT / "pipeline.yaml").values() for file in stage.written.values()}
    assert [name for name in sorted(names) if name not in text and not name.startswith("<")] == []
