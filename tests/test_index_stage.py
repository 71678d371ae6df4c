"""The stages index and coverage from outside."""

import json

import numpy as np
import pytest

from lib.buffers import index_buffer
from lib.given import cameras, image
from lib.given import model as models
from tests.helpers.boxes import look, pixel_shares, room

OUTPUTS = {
    "group": "group.png",
    "object": "object.png",
    "facet": "facet.png",
    "legend": "legend.json",
    "depth": "depth.exr",
    "hidden": "hidden.png",
    "trusted": "trusted.png",
    "report": "index.report.json",
}


@pytest.fixture
def folder(tmp_path):
    """A small scene: a room with three boxes, its camera, a grey photograph of it."""
    room(7, boxes=3).write(tmp_path / "model.obj")
    K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
    cameras.write_cameramodel(tmp_path / "left.cameramodel", look((0.5, 0.6, 1.6), (4, 3, 1), K, 80, 60))
    image.write_png8(tmp_path / "left.png", np.full((60, 80, 3), (120, 130, 140), np.uint8))
    (tmp_path / "out").mkdir()
    return tmp_path


def index_command(folder, *more, **replaced):
    files = {"model": "model.obj", "camera": "left.cameramodel", "photograph": "left.png"} | replaced
    words = ["stages/index.py"]
    for name, file in files.items():
        words += [f"--{name}", folder / file]
    for name, file in OUTPUTS.items():
        words += [f"--{name}", folder / "out" / file]
    return [*words, *more]


def test_stage_writes_what_the_contract_says(run, folder):
    result = run(*index_command(folder))
    assert result.returncode == 0, result.stderr
    out = folder / "out"
    model, camera = models.load(folder / "model.obj"), cameras.read_cameramodel(folder / "left.cameramodel")
    facet = image.read_labels(out / "facet.png") - 1
    legend = json.loads((out / "legend.json").read_text())
    assert legend["groups"] == list(model.groups) and legend["objects"] == list(model.objects)
    assert legend["facets"] == np.column_stack([model.facet_object, model.facet_group]).tolist()
    assert np.array_equal(image.read_labels(out / "group.png") - 1, model.facet_group[facet])
    assert np.array_equal(image.read_labels(out / "object.png") - 1, model.facet_object[facet])
    depth = image.read_exr(out / "depth.exr")
    assert (
        np.allclose(depth, index_buffer.reference(model, camera).depth, rtol=1e-6)
        or (facet != index_buffer.reference(model, camera).facet).any()
    )
    for name in ("trusted", "hidden"):
        assert set(np.unique(image.read_labels(out / f"{name}.png"))) == {0, 255}
    report = json.loads((out / "index.report.json").read_text())
    assert report["status"] == "complete"
    assert sum(group["seen"] for group in report["groups"].values()) == 80 * 60
    assert (
        sum(group["trusted"] for group in report["groups"].values())
        == (image.read_labels(out / "trusted.png") > 0).sum()
    )


def test_stage_without_graphics_casts_rays(run, folder):
    """libglvnd is pointed to no driver at all: a warning, and the same files."""
    drawn = run(*index_command(folder))
    facet = image.read_labels(folder / "out" / "facet.png")
    result = run(*index_command(folder), env={"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent.json"})
    assert drawn.returncode == result.returncode == 0, result.stderr
    assert "rays instead" in result.stderr
    assert json.loads((folder / "out" / "index.report.json").read_text())["method"] == "rays"
    assert (image.read_labels(folder / "out" / "facet.png") != facet).mean() <= 1e-3


def test_stage_looking_away(run, folder):
    K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
    cameras.write_cameramodel(folder / "left.cameramodel", look((0.5, 0.6, 100), (4, 3, 900), K, 80, 60))
    assert run(*index_command(folder)).returncode == 0
    assert json.loads((folder / "out" / "index.report.json").read_text())["status"] == "nothing seen"
    assert not image.read_labels(folder / "out" / "group.png").any()


def break_vertex(folder):
    path = folder / "model.obj"
    path.write_text(path.read_text().replace("v 6.0 ", "v nan ", 1))


def drop_material(folder):
    path = folder / "model.obj"
    path.write_text("\n".join(line for line in path.read_text().split("\n") if not line.startswith("usemtl")))


def cut_photograph(folder):
    path = folder / "left.png"
    path.write_bytes(path.read_bytes()[:-20])


def other_size(folder):
    image.write_png8(folder / "left.png", np.full((60, 81, 3), 99, np.uint8))


@pytest.mark.parametrize(
    "damage, says",
    [
        (break_vertex, "model.obj: line 3: vertex x = nan is not finite"),
        (drop_material, "has no material"),
        (cut_photograph, "left.png: truncated"),
        (other_size, "left.png: size: 81 x 60 is not the camera's 80 x 60"),
        (lambda folder: (folder / "left.png").unlink(), "left.png"),
        (lambda folder: (folder / "model.obj").write_text(""), "model.obj: faces: the model has none"),
        (lambda folder: (folder / "left.cameramodel").write_text("{"), "left.cameramodel: not a camera model"),
    ],
)
def test_stage_refuses(refuses, folder, damage, says):
    damage(folder)
    (line,) = refuses(*index_command(folder))
    assert line.startswith("index.py: ") and says in line
    assert not list((folder / "out").iterdir())


@pytest.mark.parametrize("words, says", [(("--keep", "0"), "keep"), (("--margin-px", "-1"), "margin")])
def test_stage_refuses_numbers(refuses, folder, words, says):
    assert says in refuses(*index_command(folder, *words))[0]
    assert not list((folder / "out").iterdir())


def coverage_command(folder, facet, *more):
    files = {"model": folder / "model.obj", "camera": folder / "left.cameramodel", "facet": facet}
    files |= {"coverage": folder / "coverage.npz", "report": folder / "coverage.report.json"}
    return ["stages/coverage.py", *(word for name, path in files.items() for word in (f"--{name}", path)), *more]


@pytest.mark.parametrize("method", ["opengl", "rays"])
def test_coverage_stage(run, folder, method):
    assert run(*index_command(folder)).returncode == 0
    result = run(*coverage_command(folder, folder / "out" / "facet.png", "--method", method))
    assert result.returncode == 0, result.stderr
    with np.load(folder / "coverage.npz", allow_pickle=False) as arrays:
        assert all(sum(shares.values()) == 64 for shares in pixel_shares(dict(arrays)).values())
        assert json.loads((folder / "coverage.report.json").read_text())["mixed_pixels"] == len(arrays["pixel"]) > 100


def test_coverage_refuses_another_models_facets(refuses, folder):
    image.write_png16(folder / "facet.png", np.full((60, 80), 999))
    (line,) = refuses(*coverage_command(folder, folder / "facet.png"))
    assert "999 is beyond the model's 24 facets" in line and not (folder / "coverage.npz").exists()
