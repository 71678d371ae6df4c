"""`photos/` and `photos` of scene.yaml: what the plan makes of them, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from lib.given import image
from lib.planning import folder as folders
from lib.planning import scene as scenes
from lib.planning.command import command
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import explain, walk
from tests.helpers.attic import CAMERA, attic

ROOT = Path(__file__).resolve().parents[1]
LAMPS = "lamps: {lamp: [1, 1, 1]}\n"
PINHOLE = CAMERA.format(lens="LENSMODEL_PINHOLE")


@pytest.fixture
def folder(tmp_path):
    return attic(tmp_path)


def read(folder, text=LAMPS):
    (folder / "scene.yaml").write_text(text)
    stages = read_pipeline(ROOT / "pipeline.yaml")
    return scenes.read(folder, stages), stages


def plan(folder, text=LAMPS):
    return walk(*read(folder, text), folder.parent / "build")


def photograph(folder, name, size=4):
    (folder / "photos").mkdir(exist_ok=True)
    image.write_png8(folder / "photos" / name, np.zeros((size, size, 3), np.uint8))


def test_a_scene_without_photos_does_not_know_the_stage(folder):
    without = plan(folder)
    assert "locate" not in without.stages and "locate" not in explain(without)
    assert "--photos" not in command(without, without.stages["report"], "python").argv
    (folder / "photos").mkdir()
    (folder / "photos" / "read.me").write_text("nothing yet")
    assert plan(folder).planned == without.planned


def test_photographs_are_located_and_shown(folder):
    photograph(folder, "door.png")
    located = plan(folder, LAMPS + "photos: {door: {exposure: 0.5, lamps: {lamp: [0, 0, 0]}}}")
    assert located.planned[:2] == ["locate", "edges"] and "photos.json" in located.goals
    run = command(located, located.stages["locate"], "python")
    words = " ".join(run.argv)
    assert "--photos" in words and '"exposure": 0.5' in words.replace('":0.5', '": 0.5')
    assert folder / "photos" / "door.png" in run.inputs
    shown = command(located, located.stages["report"], "python")
    assert "--poses" in shown.argv and "--photos" in shown.argv


def test_the_right_photograph_is_passed_where_it_is_posed(folder):
    photograph(folder, "door.png")
    photograph(folder, "../right.png")
    assert "--camera-right" not in command(plan(folder), plan(folder).stages["locate"], "python").argv
    (folder / "right.posed.cameramodel").write_text(PINHOLE)
    assert "--camera-right" in command(plan(folder), plan(folder).stages["locate"], "python").argv


@pytest.mark.parametrize(
    "text, line",
    [
        ("photos: [door]", 'photos: ["door"] is not a mapping'),
        (
            "photos: {window: {exposure: 1}}",
            'photos.window: {"exposure": 1} names no photograph of photos/: it has door',
        ),
        ("photos: {door: 0.5}", "photos.door: 0.5 is not a mapping"),
        ("photos: {door: {iso: 100}}", "photos.door.iso: 100 is an unknown key; known are exposure, lamps"),
        ("photos: {door: {exposure: 0}}", "photos.door.exposure: 0 is neither a positive number nor `unknown`"),
        ("photos: {door: {exposure: half}}", 'photos.door.exposure: "half" is neither a positive number nor `unknown`'),
        ("photos: {door: {lamps: {lamp: off}}}", 'photos.door.lamps.lamp: "off" is not a list of three numbers'),
        ("photos: {door: {lamps: {lamp: [-1, 0, 0]}}}", "photos.door.lamps.lamp: [-1, 0, 0] is negative"),
        (
            "photos: {door: {lamps: {wall: [0, 0, 0]}}}",
            "photos.door.lamps.wall: [0, 0, 0] names no lamp of scene.yaml: there are lamp",
        ),
    ],
)
def test_what_is_refused_in_scene_yaml(folder, text, line):
    photograph(folder, "door.png")
    assert read(folder, LAMPS + text)[0].problems == (f"{folder}/scene.yaml: {line}",)


def test_what_is_refused_in_the_folder(folder):
    """IMG_1.JPG of a telephone was passed over in silence."""
    for name in ("a.png", "a.jpg", "my door.png", "b.png"):
        photograph(folder, name)
    for name in ("IMG_1.JPG", "IMG_2.heic", "notes.txt"):
        (folder / "photos" / name).write_text("")
    for name in ("b.posed.cameramodel", "c.cameramodel"):
        (folder / "photos" / name).write_text(PINHOLE)
    problems = set(read(folder)[0].problems)
    where = folder / "photos"
    assert problems == {
        f"{where}: a.jpg and a.png: only one of them may be given",
        f"{where}/my door.png: my door: is not a name of letters, digits, _ and -",
        f"{where}/c.cameramodel: is the camera of no photograph in {where}",
        f"{where}/IMG_1.JPG: is no photograph that can be read: it must end in .png, .jpg, .tif, .exr",
        f"{where}/IMG_2.heic: is no photograph that can be read: it must end in .png, .jpg, .tif, .exr",
    }


def test_photos_is_a_folder(folder):
    (folder / "photos").write_text("")
    assert read(folder)[0].problems == (f"{folder}/photos: is a file, not a folder",)


def test_the_folder_is_opened_before_anything_runs(folder):
    photograph(folder, "a.png", size=5)
    photograph(folder, "b.png")
    (folder / "photos" / "a.cameramodel").write_text(PINHOLE)
    (folder / "photos" / "b.cameramodel").write_text("no camera")
    (folder / "photos" / "c.png").write_bytes(b"")
    problems = folders.inspect(read(folder)[0], {"photos/"})
    assert problems[0].startswith(f"{folder}/photos/a.png: size: 5 x 5 is not the camera's 4 x 4")
    assert problems[1].startswith(f"{folder}/photos/b.cameramodel: not a camera model")
    assert problems[2] == f"{folder}/photos/c.png: the file is empty"
