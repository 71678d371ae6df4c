"""Exports: files that other programs read as they are meant.

What only a heavy program can tell stands in test_export_renderers.py.
"""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lib.export import gltf, kinds, microfacet
from lib.export import scene as scenes
from lib.given import cameras, materials
from lib.given import model as models
from lib.light import ward
from tests.helpers import parlour

FILES = {
    "gltf": ["scene.glb"],
    "mitsuba": ["scene.xml"],
    "radiance": ["scene.rad", "view.vf"],
    "usd": ["scene.usda"],
    "colmap": ["cameras.txt", "images.txt", "points3D.txt"],
    "blender": ["scene.py"],
}
OPTIONS = {"radiance": ["radiance", "radiance-view"], "colmap": ["colmap-cameras", "colmap-images", "colmap-points"]}


def scene_of(words, up="z"):
    return scenes.read(**{str(o)[2:]: path for o, path in zip(words[::2], words[1::2], strict=True)}, up=up)


@pytest.fixture(scope="module")
def words(tmp_path_factory):
    return parlour.write(tmp_path_factory.mktemp("parlour"))


@pytest.fixture(scope="module")
def scene(words):
    return scene_of(words)


@pytest.fixture(scope="module")
def exported(words, tmp_path_factory):
    """A folder with every kind, written by the stage as Make runs it."""
    folder = tmp_path_factory.mktemp("exports")
    given = []
    for kind, names in FILES.items():
        for option, name in zip(OPTIONS.get(kind, [kind]), names, strict=True):
            given += [f"--{option}", folder / kind / name]
    root = Path(__file__).resolve().parents[1]
    argv = [sys.executable, root / "stages/export.py", *words, *given, "--report", folder / "report.json"]
    done = subprocess.run(list(map(str, argv)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


# ---- what every kind is made of ----


def test_pieces_are_the_model(scene, words):
    """Each triangle once; what lies in the plane of another face is a hair above it; a textured facet is apart."""
    model = models.load(words[1])
    assert sum(len(piece.corners) for piece in scene.pieces) == len(model.triangles)
    (desk,) = [piece for piece in scene.pieces if piece.object == "desk"]
    (plate,) = [piece for piece in scene.pieces if piece.object == "plate"]
    assert 0 < np.ptp([desk.corners[..., 2].mean(), plate.corners[..., 2].mean()]) < 1e-3
    (drawn,) = [piece for piece in scene.pieces if piece.texture is not None]
    assert drawn.uv.min() == pytest.approx(0, abs=1e-9) and drawn.uv.max() == pytest.approx(1)
    low_left = drawn.corners.reshape(-1, 3)[drawn.uv.reshape(-1, 2).sum(axis=1).argmin()]
    assert low_left == pytest.approx([1, 2.98, 1.1], abs=1e-3)
    assert scenes.rows_from_top(drawn.texture)[-1, 0] == pytest.approx([0.8, 0.1, 0.1])  # red is at the lower left


def test_tangents_lie_on_the_facet(scene):
    (plate,) = [piece for piece in scene.pieces if piece.look.anisotropic]
    assert plate.tangents == pytest.approx(np.tile(parlour.TANGENT, (2, 1)))
    step = plate.corners[0, 1] - plate.corners[0, 0]
    assert plate.uv[0, 1, 0] - plate.uv[0, 0, 0] == pytest.approx(step @ parlour.TANGENT)


@pytest.mark.parametrize("up", scenes.AXES)
@pytest.mark.parametrize("to", ["y", "z"])
def test_up_is_turned_up(up, to):
    R = scenes.rotation(scenes.AXES[up], scenes.AXES[to])
    assert R @ scenes.AXES[up] == pytest.approx(scenes.AXES[to])
    assert pytest.approx(np.eye(3)) == R @ R.T and np.linalg.det(R) == pytest.approx(1)


# ---- glTF ----


def test_materials_go_through_gltf_and_back(scene, exported):
    """By the factors alone; also the exact values beside them."""
    found = gltf.read_looks(exported / "gltf/scene.glb")
    assert sorted(found) == sorted("print 7" if name == "print" else name for name in scene.looks)
    for name, look in scene.looks.items():
        if name == "print":
            continue
        rho_d, rho_s, alpha, emittance = found[name]
        assert rho_d == pytest.approx(look.rho_d, abs=1e-9) and rho_s == pytest.approx(look.rho_s, abs=1e-9), name
        assert (alpha is None) == (look.alpha is None) and (emittance is None) == (look.emittance is None)
        if alpha is not None:
            assert alpha == pytest.approx(look.alpha, abs=1e-9)
        if emittance is not None:
            assert emittance == pytest.approx(look.emittance)


def test_gltf_keeps_the_exact_values(scene, exported):
    import pygltflib

    file = pygltflib.GLTF2().load_binary(str(exported / "gltf/scene.glb"))
    for material in file.materials:
        assert material.extras["exact"] == scene.looks[material.name.removesuffix(" 7")].exact
    assert file.cameras[0].extras["K"] == scene.camera.K.tolist()


def test_gltf_is_read_back_as_the_same_model(words, exported):
    """By our own reader: objects, facets and groups; y is up."""
    given, found = models.load(words[1]), models.load(exported / "gltf/scene.glb")
    assert found.n_facets == given.n_facets and set(found.objects) == set(given.objects)
    assert found.vertices.min(axis=0) == pytest.approx([0, 0, -3], abs=1e-3)  # (x, y, z) is (x, z, -y)
    assert found.facet_area().sum() == pytest.approx(given.facet_area().sum(), rel=1e-5)


def test_trimesh_sees_the_photograph_s_view(scene, exported):
    """The camera of the file sees a point where ours sees it, but for the principal point."""
    import trimesh

    loaded = trimesh.load(exported / "gltf/scene.glb")
    assert len(loaded.geometry) >= len(parlour.GROUPS) + 1
    T_world_cam, _ = loaded.graph[next(n for n in loaded.graph.nodes if n.startswith("photograph"))]
    p = np.array([1.3, 2.0, 0.7])
    y_up = np.array([p[0], p[2], -p[1]])
    q = (np.linalg.inv(T_world_cam) @ [*y_up, 1])[:3]
    seen = [-q[0] / q[2], q[1] / q[2]]  # it looks along -z, y is up
    ours = scene.camera.points(p)
    assert seen == pytest.approx(ours[:2] / ours[2], abs=1e-6)


# ---- COLMAP ----


def test_colmap_s_model_reprojects_the_vertices(words, exported):
    import pycolmap

    found = pycolmap.Reconstruction(str(exported / "colmap"))
    camera = cameras.read_cameramodel(words[3])
    image, points = found.images[1], found.points3D
    p = np.array([point.xyz for point in points.values()])
    given = np.unique(models.load(words[1]).vertices, axis=0)
    assert np.unique(p, axis=0) == pytest.approx(given, abs=0)
    ours = camera.project(p)
    front = ~np.isnan(ours[:, 0])
    assert front.sum() > 10
    theirs = np.array([image.project_point(point) for point in p[front]])
    assert theirs - 0.5 == pytest.approx(ours[front], abs=1e-6)


# ---- lobes ----


@pytest.mark.parametrize(
    "distribution, alpha, at_most", [("beckmann", 0.05, 0.01), ("beckmann", 0.3, 0.12), ("ggx", 0.1, 0.25)]
)
def test_a_microfacet_lobe_is_nearly_ward_s(distribution, alpha, at_most):
    off = microfacet.residual(distribution, (alpha, alpha))
    assert at_most / 3 < off < at_most


# ---- what is refused ----


def test_a_wrong_name_or_axis_is_refused_and_nothing_is_written(words, tmp_path, refuses):
    lines = refuses("stages/export.py", *words, "--gltf", tmp_path / "out/room.glb")
    assert "room.glb: is not called scene.glb" in lines[0]
    refuses("stages/export.py", *words, "--gltf", tmp_path / "out/scene.glb", "--up", '"w"')
    assert not (tmp_path / "out").exists()


def test_a_group_without_values_is_refused_as_render_refuses_it(tmp_path, refuses):
    words = parlour.write(tmp_path / "parlour")
    found = materials.read(words[7])
    del found.groups["varnish"]
    materials.write(words[7], found)
    lines = refuses("stages/export.py", *words, "--gltf", tmp_path / "out/scene.glb")
    assert "group 'varnish': missing" in lines[0] and not (tmp_path / "out").exists()


# ---- what is lost is said ----


def test_losses_are_said(tmp_path, scene):
    assert [len(kinds.losses(kind, scene)) for kind in ("gltf", "mitsuba", "radiance")] == [1, 0, 0]
    assert "6 px off" in kinds.losses("gltf", scene)[0]
    thrown = scene_of(parlour.write(tmp_path, throw=((0, 0, -1), 4.0)))
    said = {kind: any("lobe" in line for line in kinds.losses(kind, thrown)) for kind in kinds.KINDS}
    assert {kind for kind, is_lost in said.items() if is_lost} == {"gltf", "mitsuba", "usd"}


def test_the_report_says_how_far_lobes_are_off(exported):
    report = json.loads((exported / "report.json").read_text())
    off = {error["name"]: error["value"] for error in report["errors"]}
    assert off["mitsuba.lobe.varnish"] == pytest.approx(microfacet.residual("beckmann", (0.15, 0.15)))
    assert off["gltf.lobe.steel"] > off["mitsuba.lobe.steel"] > 0 and "radiance.lobe.steel" not in off
    assert report["losses"].keys() == FILES.keys() and report["losses"]["radiance"] == []


@pytest.mark.parametrize("alpha", [(0.1, 0.1), (0.28, 0.07)])
def test_beckmann_s_weight_is_ward_s_loss_of_light(alpha):
    """Straight on Beckmann's lobe reflects all; Ward's, its albedo. At other angles the share is nearly the same."""
    assert microfacet.weight(alpha) == pytest.approx(ward.albedo(ward.BOUNDED, *alpha, 0.0), abs=0.012)


def test_what_does_not_fit_is_said_of_all_that_is_made_from_it():
    why = [materials.Why("object_missing", None, "something is not in the model", None)]
    (said,) = materials.Materials(status="does not fit", groups={}, why=why).cautions
    assert said.startswith("the scene does not fit") and said.endswith("something is not in the model")
    assert materials.Materials(status="converged", groups={}).cautions == []
