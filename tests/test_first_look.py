"""make <scene>/check: what is doubtful about a scene, each thing by the mistake that makes it."""

import json

import cv2
import numpy as np
import pytest

from lib.buffers import first_look, index_buffer
from lib.given import cameras, image, model
from tests.helpers import rooms
from tests.helpers.mistakes import camera, scene


def looked(folder, objects=None, posed=None, values=None, **words):
    """{about: [lines that are doubts]} of a room, and all lines."""
    world = model.load(rooms.write(folder / "model.obj", objects or {**rooms.room(), **rooms.LAMP}))
    posed = posed or camera()
    values = np.random.default_rng(1).uniform(0.1, 0.9, (posed.height, posed.width, 3)) if values is None else values
    shown = image.Photograph(values, 8, False, 3)
    facet = index_buffer.reference(world, posed).facet
    found = first_look.findings(world, posed, shown, facet, ["lamp"], **words)
    return {finding.about for finding in found if finding.doubt}, "\n".join(finding.text for finding in found)


def test_a_good_scene_leaves_no_doubt(tmp_path):
    doubts, text = looked(tmp_path)
    assert doubts <= {"groups"}, text  # a picture of 64 x 48 shows all groups small
    assert "(0.40, 0.40, 1.50) m, inside" in text and "70 degrees across" in text and "closes around" in text
    assert "lamp: 1 facets, 1 m2, its front is free" in text and "z of the model is up" in text


def larger(objects, scale):
    return {o: [(g, [scale * np.array(p, float) for p in c]) for g, c in polygons] for o, polygons in objects.items()}


@pytest.mark.parametrize(("scale", "unit"), [(1000, "mm"), (100, "cm")])
def test_a_model_in_other_units(tmp_path, scale, unit):
    far = cameras.look_at(*(scale * np.array(p) for p in ((0.4, 0.4, 1.5), (3, 2, 1))), 70, 64, 48)
    doubts, text = looked(tmp_path, larger({**rooms.room(), **rooms.LAMP}, scale), far)
    assert "units" in doubts and f"model: {{unit: {unit}}}" in text


def test_a_room_in_inches_taken_for_centimetres(tmp_path):
    low = cameras.look_at(*(0.39 * np.array(p) for p in ((0.4, 0.4, 1.5), (3, 2, 1))), 70, 64, 48)
    doubts, text = looked(tmp_path, larger({**rooms.room(), **rooms.LAMP}, 0.39), low)
    assert "units" in doubts and "if nobody could stand in it, write model: {unit: in}" in text


def test_a_unit_that_makes_the_model_small_is_no_missing_wall(tmp_path):
    doubts, text = looked(tmp_path, larger({**rooms.room(), **rooms.LAMP}, 0.1), camera())
    assert "openings" in doubts and "so unit, up or pose are not as told" in text and "draw the walls" not in text


def test_y_is_up(tmp_path):
    turned = cameras.look_at((0.4, 0.4, 1.0), (3, 0.6, 2), 70, 64, 48, up=(0, 1, 0))
    doubts, text = looked(tmp_path, posed=turned)
    assert "up axis" in doubts and "model: {up: y}" in text
    assert "up axis" not in looked(tmp_path, posed=turned, up="y")[0]


def test_a_lamp_that_shines_into_the_ceiling(tmp_path):
    corners = [(1.5, 1, 2.49), (2.5, 1, 2.49), (2.5, 2, 2.49), (1.5, 2, 2.49)]
    doubts, text = looked(tmp_path, {**rooms.room(), **rooms.panel("lamp", *corners)})
    assert "lamps" in doubts and "its front looks at top within 5 cm: turn its faces round" in text
    assert "lamps" not in looked(tmp_path, {**rooms.room(), **rooms.panel("lamp", *corners[::-1])})[0]


def test_a_room_without_its_back_wall(tmp_path):
    walls = {"room": [(g, c) for g, c in rooms.room()["room"] if g not in ("west", "south")]}
    doubts, text = looked(tmp_path, {**walls, **rooms.LAMP})
    assert "openings" in doubts and "draw the walls, floor and ceiling behind the camera too" in text


def test_a_photograph_that_is_too_dark_or_white(tmp_path):
    dark = np.random.default_rng(1).uniform(0.02, 0.1, (48, 64, 3))
    assert "photograph" in looked(tmp_path, values=dark)[0]
    white = np.ones((48, 64, 3))
    doubts, text = looked(tmp_path, values=white)
    assert "photograph" in doubts and "are white" in text
    assert "EXIF says" in looked(tmp_path, turned=3)[1]


def test_large_photographs_are_told_what_they_need():
    simple, many = (
        first_look.cost((288, 512), has=8.0, facets=n, lamps=lamps).text for n, lamps in ((40, 1), (11143, 13))
    )
    assert "and 35 s" in simple and "and 3 minutes" in many, (simple, many)
    found = first_look.cost((4500, 6000, 3), has=8.0)
    assert found.doubt and "27.0 megapixels" in found.text and "this machine has 8.0 GB" in found.text


def test_the_stage_draws_the_model_over_the_photograph(tmp_path, run):
    folder = scene(tmp_path / "room")
    words = ["--model", "model.obj", "--camera", "left.posed.cameramodel", "--photograph", "left.png"]
    words = [folder / word if "." in word else word for word in words]
    out = {name: tmp_path / name for name in ("check.json", "check.png", "check.report.json")}
    options = zip(("--findings", "--picture", "--report"), out.values(), strict=True)
    result = run("stages/check.py", *words, "--lamps", '["lamp"]', *(word for pair in options for word in pair))
    assert result.returncode == 0, result.stderr
    content = json.loads(out["check.json"].read_text())
    assert content["status"] in ("good", "doubtful") and {"about", "text", "doubt"} == set(content["findings"][0])
    assert all(finding["text"] in result.stdout for finding in content["findings"])
    drawn = cv2.imread(str(out["check.png"]))
    assert drawn.shape == (48, 64, 3)
    corner = np.round(camera().project([[4.0, 3.0, 1.2]])[0]).astype(int)  # on the edge between two walls
    assert (drawn[corner[1], corner[0]] == [0, 170, 255]).all() or drawn[corner[1], corner[0], 2] > 200
