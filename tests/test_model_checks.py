"""What is doubtful about a model: one line each, and none for models that are in order."""

import json

import numpy as np
import pytest

from lib.buffers import index_buffer, model_checks
from lib.given import cameras, image, model
from tests.helpers import rooms
from tests.helpers.boxes import look

K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
ROOM = rooms.room() | rooms.LAMP
BOX = (1.5, 1.2, 0, 2.5, 2, 0.8)
WALL = [(1, 3, 1), (1, 3, 2), (2, 3, 2), (2, 3, 1)]  # on the wall north, seen from the south


def camera(eye=(0.5, 0.3, 1.6), at=(2.5, 2, 0.8)):
    return look(eye, at, K, 80, 60)


@pytest.fixture
def found(tmp_path):
    def findings(objects, scale=1.0, **seen):
        world = model.load(rooms.write(tmp_path / "m.obj", objects, scale=scale))
        eye = camera(*(scale * np.array(p) for p in ((0.5, 0.3, 1.6), (2.5, 2, 0.8)))) if not seen else camera(**seen)
        return model_checks.findings(world, eye, index_buffer.reference(world, eye).facet)

    return findings


def shifted(y):
    return [(x, y0 + y, z) for x, y0, z in WALL]


def inward(name, *corners):
    return {name: [(name, p) for p in rooms.box(*corners, inward=True).values()]}


IN_ORDER = {
    "a box on the floor": rooms.solid("box", *BOX),
    "without the face on which it stands": {"box": rooms.solid("box", *BOX)["box"][1:]},
    "a poster on the wall": rooms.panel("poster", *WALL),
    "a thin solid on the wall": rooms.solid("poster", 1, 2.999, 1, 2, 3, 2),
    "a sheet well before the wall": rooms.panel("poster", *shifted(-0.01)),
    "boxes side by side": rooms.solid("a", 1, 1, 0, 2, 2, 1) | rooms.solid("b", 2, 1, 0, 3, 2, 1),
    "two sheets back to back": rooms.panel("a", *shifted(-1)) | rooms.panel("b", *shifted(-1)[::-1]),
    "an open bin": {"bin": [f for k, f in enumerate(rooms.solid("bin", *BOX)["bin"]) if k != 1]},
    "a table top of one polygon, from below": rooms.panel("t", (1, 1, 1.9), (3, 1, 1.9), (3, 2, 1.9), (1, 2, 1.9)),
}


@pytest.mark.parametrize("things", IN_ORDER.values(), ids=IN_ORDER)
def test_models_in_order(found, things):
    assert found(ROOM | things) == []


def test_a_room_in_millimetres(found):
    (line,) = found(ROOM, scale=1000)
    assert line.startswith("it is 5,590 m from corner to corner") and "millimetres" in line
    assert found(ROOM, scale=50) == []


def test_doubled_faces(found):
    twice = rooms.panel("a", *shifted(-1)) | rooms.panel("b", *(shifted(-1)[k] for k in (2, 3, 0, 1)))
    (line,) = found(ROOM | twice)
    assert line.startswith("doubled faces") and "'a' and 'b'" in line


@pytest.mark.parametrize("scale", [1, 0.01, 20])
def test_narrow_gaps(found, scale):
    (line,) = found(ROOM | rooms.panel("poster", *shifted(-0.0008)), scale=scale)
    assert line.startswith("narrow gaps") and f"'room' and 'poster' ({0.8 * scale:.2g} mm)" in line
    (line,) = found(ROOM | rooms.solid("box", 1, 1, 0.0005, 2, 2, 1), scale=scale)
    assert f"'room' and 'box' ({0.5 * scale:.2g} mm)" in line


def test_faces_inside_out(found):
    (line,) = found(ROOM | inward("box", *BOX))
    assert "backs" in line and "'box'" in line
    open_box = {"box": inward("box", *BOX)["box"][1:]}
    (line,) = found(ROOM | open_box)
    assert "backs" in line and "'box'" in line


def test_a_room_made_of_a_cube_may_look_outwards(found):
    """Both sides of its walls are lit alike; a box in it that looks inwards is still said."""
    outward = {"room": [(name, p[::-1]) for name, p in rooms.room()["room"]]}
    assert found(outward | rooms.LAMP) == []
    (line,) = found(outward | rooms.LAMP | inward("box", *BOX))
    assert "backs" in line and "'box'" in line and "room" not in line


def test_neighbours_turned_opposite_ways(found):
    box = rooms.solid("box", *BOX)["box"]
    lines = found(ROOM | {"box": [(box[0][0], box[0][1][::-1]), *box[1:]]})
    assert len(lines) == 1 and "turned opposite ways, in 'box'" in lines[0]


def test_the_stage_warns(run, tmp_path):
    path = rooms.write(tmp_path / "model.obj", ROOM | rooms.panel("poster", *shifted(-0.0008)))
    cameras.write_cameramodel(tmp_path / "left.cameramodel", camera())
    image.write_png8(tmp_path / "left.png", np.full((60, 80, 3), (120, 130, 140), np.uint8))
    words = ["--model", path, "--camera", tmp_path / "left.cameramodel", "--photograph", tmp_path / "left.png"]
    report = tmp_path / "report.json"
    result = run("stages/index.py", *words, "--facet", tmp_path / "facet.png", "--report", report)
    assert result.returncode == 0, result.stderr
    (warning,) = json.loads(report.read_text())["warnings"]
    assert warning.startswith(f"{path}: narrow gaps") and warning in result.stderr
