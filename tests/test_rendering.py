"""The picture.

By hand (closed forms), by law (furnace, flux, units), by difference (many rays, finer pixels), at the edge.
"""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from lib.buffers import coverage as coverage_
from lib.buffers import index_buffer
from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import image, model
from lib.given.cameras import Camera, write_cameramodel
from lib.given.transfer import Transfer
from lib.given.view import View
from lib.light import factors_file, form_factors, outside
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.chains import GLOSSY, MIRROR, Finish
from lib.picture import (
    appearance,
    display,
    fragments,
    indirect,
    phong,
    pixel_light,
    ray_light,
    rendering,
    texels,
)
from lib.picture import leaves as leaves_
from lib.picture import pixels as pixels_
from lib.picture.appearance import Appearance
from lib.picture.subject import Quality, Subject
from lib.verdict.page import running
from tests.helpers import rooms
from tests.helpers.page_parts import parts_of
from tests.helpers.views import SIZE, look

UNDER_UNIT_SQUARE = 0.23945647046077354  # element under the centre of a unit square, distance 1


def scene(
    folder,
    objects,
    camera,
    rho=0.5,
    E=1.0,
    lamps=("lamp",),
    channels=1,
    kind="linear",
    gamma=1.0,
    patches=150,
    bits=8,
    **placed,
):
    """A Subject without files between the stages; rho, E : a number, or {group or lamp: number}."""
    world = model.load(rooms.write(folder / "model.obj", objects, **placed))
    surface = surfaces.surface(world, lamps)
    m = rooms.patches(surface, patches)
    factor = lamps_.patch_direct(surface, m, lamps_.emitters(surface, lamps), len(lamps), n_points=16)
    factors = factors_file.FormFactors(
        m,
        form_factors.rays(surface, m, n_rays=256),
        factor,
        tuple(lamps),
        surface.group[m.side // 2],
        surface.groups,
        np.ones(len(surface.groups)),
        surface.local.diagonal,
    )
    facet = index_buffer.reference(world, camera).facet
    coverage = coverage_.coverage(world, camera, facet, "rays")
    value = lambda table, name, default: (
        table.get(name, default) if isinstance(table, dict) else (0.0 if name in lamps and table is rho else table)
    )
    photograph = image.Photograph(np.full((*facet.shape, channels), 0.5), bits, bits == 0, channels)
    look = Appearance(
        np.repeat([[value(rho, g, 0.0)] for g in surface.groups], channels, axis=1),
        np.repeat(np.reshape([value(E, name, 1.0) for name in lamps], (-1, 1)), channels, axis=1),
    )
    view = View(camera, world, photograph, facet)
    return Subject(view, surface, factors, coverage, look, Transfer(kind, gamma))


def furnished(folder, camera=None, lamp=rooms.LAMP, **options):
    """A room with a hanging lamp, a table of one polygon and a box on the floor."""
    objects = (
        rooms.room()
        | lamp
        | rooms.solid("box", 0.8, 0.6, 0, 1.4, 1.3, 0.9)
        | rooms.panel("table", (2.2, 1.4, 0.7), (3.2, 1.4, 0.7), (3.2, 2.2, 0.7), (2.2, 2.2, 0.7))
    )
    rho = {"bottom": 0.4, "top": 0.8, "west": 0.6, "east": 0.5, "south": 0.6, "north": 0.7, "box": 0.3, "table": 0.5}
    return scene(folder, objects, camera or look((3.6, 0.3, 1.6), (1.2, 2.0, 0.6)), rho=rho, E=6.0, **options)


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    s = furnished(tmp_path_factory.mktemp("office"))
    return s, rendering.render(s)


# ---- by hand ----


def floor_below(folder, extra, E=4.0):
    """A unit lamp 1 above a floor of reflectance 0.5 in a black hall, seen from the side.

    The middle pixel shows the spot below the lamp's centre.
    """
    objects = (
        rooms.room(6, 6, 6) | rooms.panel("lamp", (2.5, 2.5, 1), (2.5, 3.5, 1), (3.5, 3.5, 1), (3.5, 2.5, 1)) | extra
    )
    camera = look((3, 0.5, 0.6), (3, 3, 0), size=(33, 25), focal=900)
    picture = rendering.render(scene(folder, objects, camera, rho={"bottom": 0.5}, E=E), Quality(shadow_rays=1024))
    return picture.linear[12, 16, 0]


def test_light_under_a_square_lamp(tmp_path):
    assert floor_below(tmp_path, {}) == pytest.approx(0.5 * 4 * UNDER_UNIT_SQUARE, rel=1e-3)


@pytest.mark.scene
def test_a_lamp_of_many_triangles(office, tmp_path):
    """The same lamp as a mesh: its light is interpolated between blocks of pixels."""
    x, y = np.meshgrid(np.linspace(1.5, 2.5, 5), np.linspace(1, 2, 5), indexing="ij")
    corners = lambda i, j: tuple((x[a, b], y[a, b], 2.4) for a, b in ((i, j), (i, j + 1), (i + 1, j + 1), (i + 1, j)))
    cells = {"lamp": [("lamp", corners(i, j)) for i in range(4) for j in range(4)]}
    many = rendering.render(furnished(tmp_path, lamp=cells)).linear
    s, one = office
    mask = s.pure & ~np.isin(s.group, s.lamp_groups)
    assert np.median(np.abs(many[mask] / one.linear[mask] - 1)) < 0.01


def test_shadow_of_a_square(tmp_path):
    """An opaque quarter square half way hides the middle half square of the lamp from the spot below."""
    hidden = 4 / (2 * np.pi) * (0.25 / np.hypot(1, 0.25)) * np.arctan(0.25 / np.hypot(1, 0.25)) * 2
    shade = rooms.panel(
        "shade", *((3 + x, 3 + y, 0.5) for x, y in ((-0.125, -0.125), (-0.125, 0.125), (0.125, 0.125), (0.125, -0.125)))
    )
    assert floor_below(tmp_path, shade) == pytest.approx(0.5 * 4 * (UNDER_UNIT_SQUARE - hidden), rel=0.015)


def test_a_lamp_shows_its_emittance_in_front_and_what_it_reflects_behind(tmp_path):
    objects = rooms.room() | rooms.LAMP
    rho = {"bottom": 0.5, "top": 0.5, "west": 0.5, "east": 0.5, "south": 0.5, "north": 0.5, "lamp": 0.2}
    s = scene(tmp_path, objects, look((2, 1.45, 0.5), (2, 1.5, 2.4), size=(9, 9)), rho=rho, E=3.0)
    front = rendering.render(s).linear[4, 4, 0]
    assert 3.0 < front < 3.0 + 0.2
    s = scene(tmp_path, objects, look((2, 1.45, 2.49), (2, 1.5, 2.4), size=(9, 9)), rho=rho, E=3.0)
    assert 0 < rendering.render(s).linear[4, 4, 0] < 0.2


def test_fragments_are_weighed_by_area_in_linear_light():
    pixels = pixels_.Pixels(
        np.array([0, 1], np.int32),
        np.zeros(2, np.int32),
        np.array([0, 1], np.int32),
        np.array([0, 2], np.int32),
        np.zeros((2, 3)),
        np.arange(2),
        np.array([[0, 1]]),
    )
    none = np.zeros((0, 3))
    pieces = fragments.Fragments(
        np.array([1]),
        np.array([0, 2]),
        np.array([0, 1], np.int32),
        np.array([0, 2], np.int32),
        np.array([16, 32]) / 64,
        none,
        np.zeros(0, np.int32),
        none,
        np.ones(2, bool),
    )
    picture = rendering.compose((1, 2), pixels, np.array([[0.4], [9.0]]), pieces, np.array([[0.4], [1.0]]))
    assert picture[0, :, 0] == pytest.approx([0.4, 0.4 * 0.25 + 1.0 * 0.5])  # a quarter shows nothing: black


# ---- by law ----


def test_furnace(tmp_path):
    """Everything glows and reflects alike: B = E / (1 - rho) in every pixel."""
    groups = ("bottom", "top", "west", "east", "south", "north")
    s = scene(
        tmp_path,
        rooms.room(),
        look((3.5, 0.4, 1.5), (0.5, 2.5, 1)),
        rho=dict.fromkeys(groups, 0.6),
        E=1.0,
        lamps=groups,
    )
    assert rendering.render(s).linear == pytest.approx(np.full((48, 64, 1), 2.5), rel=5e-3)


@pytest.mark.parametrize(
    "kind, lost", [(None, 0.01), (MIRROR, 0.01), (GLOSSY, 0.015)], ids=["diffuse", "mirror", "gloss"]
)
def test_an_open_room_in_a_glow(tmp_path, kind, lost):
    """What reflects all light, whatever way, is as bright as the glow around it: 1 in every pixel.

    lost : what Ward's lobes lose at grazing angles
    """
    objects = rooms.room() | rooms.LAMP
    objects["room"] = [wall for wall in objects["room"] if wall[0] != "south"]
    rho = dict.fromkeys(("bottom", "top", "west", "east", "north", "lamp"), 0.999)
    s = scene(tmp_path, objects, look((2, -2, 1.2), (2, 1.5, 1.2)), rho=rho, E=0.0)
    factors = outside.with_outside(s.factors, lambda: s.surface)
    E = np.zeros((len(factors.lamps), 1))
    E[factors.outside.first] = 1
    seen = replace(s.appearance, E=E)
    if kind is not None:
        wall = s.groups.index("north")
        rho = seen.rho.copy()
        rho[wall] = 0.8 if kind == GLOSSY else 0
        finish = Finish((wall,), np.array([kind]), np.full((1, 2), 0.1), np.array([[1.0, 0, 0]]))
        seen = replace(seen, rho=rho, finish=finish, rho_s=np.full((1, 1), 0.199 if kind == GLOSSY else 1.0))
    picture = rendering.render(replace(s, factors=factors, appearance=seen))
    shown = picture.linear[s.pure, 0]
    assert np.median(shown) == pytest.approx(1.0, abs=lost) and np.quantile(shown, 0.02) > 0.97 - lost
    assert picture.light.imbalance < 1e-2


def test_flux_is_balanced(office, tmp_path):
    light = office[1].light
    assert light.imbalance < 5e-3 and light.escaped.sum() < 1e-3 * light.emitted.sum()
    objects = rooms.room() | rooms.LAMP
    objects["room"] = [wall for wall in objects["room"] if wall[0] != "south"]  # an open scene
    light = rendering.render(scene(tmp_path, objects, look((2, -2, 1.2), (2, 1.5, 1.2)), E=5.0)).light
    assert light.imbalance < 1e-2 and light.escaped.sum() > 0.05 * light.emitted.sum()


@pytest.mark.parametrize("scale, offset", [(1e-3, (0, 0, 0)), (1.0, (1e6, -1e6, 0))])
def test_same_picture_in_millimetres_and_far_away(office, tmp_path, scale, offset):
    s, picture = office
    T = s.view.camera.T_cam_world.copy()
    T[:3, 3] = scale * T[:3, 3] - T[:3, :3] @ offset
    moved = rendering.render(furnished(tmp_path, Camera(s.view.camera.K, *SIZE, T), scale=scale, offset=offset))
    pure = s.pure
    assert np.median(np.abs(moved.linear[pure] / picture.linear[pure] - 1)) < 2e-3


def test_one_channel_as_three(office, tmp_path):
    grey, coloured = office[1].linear, rendering.render(furnished(tmp_path, channels=3)).linear
    assert coloured.shape == (48, 64, 3)
    assert coloured == pytest.approx(np.repeat(grey, 3, axis=2), rel=1e-3, abs=1e-5)


# ---- by difference ----


def test_interpolated_light_against_many_rays(office):
    """At single pixels 8,192 rays, no leaves: what the fits through the leaves must agree with."""
    s, picture = office
    surface, factors, seen = s.surface, s.factors, picture.pixels
    lamps = lamps_.emitters(surface, factors.lamps)
    shown = texels.light_map(
        surface,
        factors.mesh,
        lamps,
        s.appearance.E,
        picture.light.indirect,
        factors.rows.exposed,
        s.appearance.rho[surface.group],
    )
    irradiance = pixel_light.direct(surface, lamps, 1, seen, s.view.camera)[0] @ s.appearance.E
    leaves = indirect.gather(surface, shown, lamps, s.appearance.E, seen, irradiance)
    spread = leaves_.interpolated(leaves, seen)
    some = np.random.default_rng(1).choice(len(seen), 200, replace=False)
    exact = ray_light.gathered_light(
        surface, shown, lamps, s.appearance.E, seen.p, some, some + 1, seen.side[some], 8192, 5
    )[0]
    error = np.abs(spread[some] - exact)[:, 0] / (exact + irradiance[some])[:, 0]
    assert np.median(error) < 5e-3 and np.quantile(error, 0.95) < 0.04
    assert len(leaves) < len(seen) / 2


@pytest.mark.scene
def test_mixed_pixels_against_finer_ones(office, tmp_path):
    """A picture four times as fine, averaged, is the anti-aliased picture; without the A-buffer it is not."""
    s, picture = office
    K = s.view.camera.K * 4
    K[:2, 2] += 1.5
    K[2] = [0, 0, 1]
    fine = rendering.render(furnished(tmp_path, Camera(K, 4 * SIZE[0], 4 * SIZE[1], s.view.camera.T_cam_world))).linear
    mean = fine.reshape(48, 4, 64, 4, 1).mean(axis=(1, 3))
    mixed = ~s.pure & (s.facet >= 0)
    rms = lambda a: float(np.sqrt(np.mean((a[mixed] - mean[mixed]) ** 2)))
    none = {
        "pixel": np.zeros(0, int),
        "start": np.zeros(1, int),
        "facet": np.zeros(0, np.int32),
        "count": np.zeros(0),
    }
    bare = rendering.render(replace(s, coverage=none)).linear
    lamp = np.isin(s.group, s.lamp_groups)
    mixed &= (mean < 2)[..., 0] & ~lamp
    assert rms(picture.linear) < 0.02 < rms(bare)


# ---- display ----


def test_histogram_finds_the_transfer():
    """T = E2^-1(E1(B)) of a ramp seen through gamma 2 is gamma 2; the linear map of a group is found exactly."""
    B = np.random.default_rng(2).random((60, 50, 3)) * 0.8
    group, pure = np.zeros((60, 50), int), np.ones((60, 50), bool)
    assert display.finished(B, Transfer("histogram"), B**0.5, group, pure) == pytest.approx(B**0.5, abs=5e-3)
    assert display.finished(B, Transfer("histogram_per_group"), B**0.5, group, pure) == pytest.approx(B**0.5, abs=1e-2)
    assert display.finished(B, Transfer("linear_per_group"), 0.1 + 0.5 * B, group, pure) == pytest.approx(
        0.1 + 0.5 * B, abs=1e-12
    )
    flat = np.full((60, 50, 1), 0.3)
    assert display.finished(flat, Transfer("linear_per_group"), flat + 0.1, group, pure) == pytest.approx(flat + 0.1)
    assert display.finished(flat, Transfer("histogram"), flat + 0.1, group, pure) == pytest.approx(flat + 0.1)


def test_the_table_of_transfer_models_prefers_the_true_one():
    rng = np.random.default_rng(3)
    group = np.repeat(np.arange(4), 300).reshape(40, 30)
    B = rng.uniform(0.05, 0.6, (40, 30, 3)) * rng.uniform(0.3, 1, 4)[group][..., None]
    rows = display.transfer_models(B, B ** (1 / 2.0), group, group >= 0, Transfer("gamma", 2.0), group >= 0)
    assert [r["kind"] for r in rows] == [
        "gamma",
        "gamma",
        "linear",
        "srgb",
        "linear_per_group",
        "histogram",
        "histogram_per_group",
    ]
    assert (
        rows[0]["rmse"] < 1e-9
        and all(r["rmse"] > 1e-3 for r in rows[1:5])
        and all(r["rmse_refitted"] <= r["rmse"] + 1e-9 for r in rows[:4])
    )


def test_colour_differences():
    red, grey = np.array([[[1.0, 0, 0]]]), np.array([[[0.5]]])
    assert display.ciede2000(red, red)[0, 0] == 0 and display.ciede2000(red, red * 0.9)[0, 0] > 1
    assert display.ciede2000(grey, grey + 0.01)[0, 0] == pytest.approx(
        display.ciede2000(np.full((1, 1, 3), 0.5), np.full((1, 1, 3), 0.51))[0, 0]
    )


def test_phong_finds_its_two_numbers(office):
    s, picture = office
    lamps = lamps_.emitters(s.surface, s.factors.lamps)
    r = s.appearance.rho[s.surface.group[picture.pixels.facet]]
    lit = phong.phong(s.surface, lamps, picture.pixels.p, picture.pixels.side, s.appearance.E)
    ambient, power = phong.ambient_and_power(
        r, lit, (r * (0.3 + 0.7 * lit)) ** 0.5, lambda c, B: np.maximum(B, 0) ** 0.5
    )
    assert ambient == pytest.approx([0.3], rel=1e-3) and power == pytest.approx([0.7], rel=1e-3)


# ---- at the edge ----


def test_a_camera_that_sees_nothing(tmp_path):
    s = furnished(tmp_path, look((9, 9, 9), (20, 20, 20)))
    picture = rendering.render(s)
    assert (picture.linear == 0).all() and phong.phong_picture(s, picture)[0].shape == (48, 64, 1)
    assert display.scores(s.show(picture.linear), s.wanted, s.group, s.groups)["groups"] == {}


def test_no_lamp_and_black_walls(tmp_path):
    assert (rendering.render(furnished(tmp_path, lamps=())).linear == 0).all()
    s = furnished(tmp_path)
    s.appearance.rho[:] = 0
    picture = rendering.render(s).linear[s.pure & ~np.isin(s.group, s.lamp_groups)]
    assert (picture == 0).all()


def test_off_centre_principal_point(office, tmp_path):
    """The same rays in other pixels: the picture moves by whole pixels."""
    s, picture = office
    K = s.view.camera.K.copy()
    K[:2, 2] += [10, -6]
    moved = rendering.render(furnished(tmp_path, Camera(K, *SIZE, s.view.camera.T_cam_world))).linear
    both = s.pure[6:, :-10]
    assert np.median(np.abs(moved[:-6, 10:][both] / picture.linear[6:, :-10][both] - 1)) < 5e-3


MATERIALS = {
    "groups": {
        "wall": {"kind": "diffuse", "rho_d": [0.5, 0.4, 0.3]},
        "shelf": {"rho_d": None, "assumed": [0.2, 0.2, 0.2]},
        "attic": {"rho_d": None},
    },
    "lamps": {"lamp": {"emittance": [4, 4, 4]}},
    "transfer": {"kind": "gamma", "gamma": 2.0},
}


def test_materials_are_read(tmp_path):
    path = tmp_path / "materials.json"
    path.write_text(json.dumps(MATERIALS))
    look, found, warnings = appearance.read(path, ("wall", "shelf", "attic", "lamp"), ("lamp",), 3, 0)
    assert (
        look.rho.tolist() == [[0.5, 0.4, 0.3], [0.2] * 3, [0] * 3, [0] * 3]
        and look.E.tolist() == [[4] * 3]
        and (found.transfer.kind, found.transfer.gamma) == ("gamma", 2.0)
    )
    assert len(warnings) == 1 and "attic" in warnings[0] and look.finish is None


@pytest.mark.parametrize(
    "change, word",
    [
        ({"groups": {}}, "missing"),
        ({"transfer": {"kind": "curve"}}, "linear: missing"),
        ({"lamps": {}}, "lamp"),
        ({"groups": MATERIALS["groups"] | {"wall": {"rho_d": [1.2, 0, 0]}}}, "1.2"),
        ({"groups": MATERIALS["groups"] | {"wall": {"kind": "mirror"}}}, "rho_s"),
        ({"groups": MATERIALS["groups"] | {"wall": {"kind": "velvet"}}}, "velvet"),
        ({"transfer": {"kind": "gamma", "gamma": -1}}, "-1"),
    ],
)
def test_materials_are_checked(tmp_path, change, word):
    path = tmp_path / "materials.json"
    path.write_text(json.dumps(MATERIALS | change))
    with pytest.raises(BadInput) as error:
        appearance.read(path, ("wall", "shelf", "attic", "lamp"), ("lamp",), 3, 0)
    assert str(path) in str(error.value) and word in str(error.value)


# ---- from outside ----


@pytest.mark.scene
def test_as_a_user_would(tmp_path, run, refuses):
    s = furnished(tmp_path)
    factors_file.write(tmp_path / "formfactors.npz", s.factors)
    artefact.write_npz(tmp_path / "coverage.npz", **s.coverage)
    write_cameramodel(tmp_path / "camera.cameramodel", s.view.camera)
    image.write_png16(tmp_path / "facet.png", s.facet + 1)
    image.write_png16(tmp_path / "left.png", np.full((48, 64, 3), [20000, 30000, 40000]))
    content = {
        "groups": {
            g: {"kind": "diffuse", "rho_d": [float(s.appearance.rho[i, 0])] * 3}
            for i, g in enumerate(s.groups)
            if g != "lamp"
        },
        "lamps": {"lamp": {"emittance": [6, 6, 6]}},
        "transfer": {"kind": "gamma", "gamma": 2.2},
    }
    (tmp_path / "materials.json").write_text(json.dumps(content))
    inputs = {
        "model": "model.obj",
        "camera": "camera.cameramodel",
        "photograph": "left.png",
        "facet": "facet.png",
        "formfactors": "formfactors.npz",
        "materials": "materials.json",
        "coverage": "coverage.npz",
    }
    outputs = {
        "rendered": "rendered.png",
        "exr": "rendered.exr",
        "difference": "difference.png",
        "scores": "rendered.json",
        "report": "render.report.json",
    }
    words = lambda files: [w for key, name in files.items() for w in (f"--{key}", tmp_path / name)]
    (tmp_path / "short.png").write_bytes((tmp_path / "left.png").read_bytes()[:200])
    lines = refuses("stages/render.py", *words(inputs | {"photograph": "short.png"} | outputs))
    assert len(lines) == 1 and "short.png" in lines[0]
    assert not any((tmp_path / name).exists() for name in outputs.values())
    result = run("stages/render.py", *words(inputs | outputs))
    assert result.returncode == 0, result.stderr
    linear, shown = image.read_exr(tmp_path / "rendered.exr"), image.read_photograph(tmp_path / "rendered.png")
    assert shown.bits == 16 and shown.channels_in_file == 3
    assert shown.values == pytest.approx(np.clip(linear, 0, 1)[..., : shown.values.shape[2]] ** (1 / 2.2), abs=1e-4)
    report, scores = (json.loads((tmp_path / name).read_text()) for name in ("render.report.json", "rendered.json"))
    errors = {e["name"]: e["value"] for e in report["errors"]}
    assert errors["rmse"] == scores["rmse"] and {"flux", "ciede2000", "phong.rmse"} <= set(errors)
    assert "wall" not in scores["groups"]
    assert {r["kind"] for r in report["transfer_models"]} == set(display.KINDS) - {
        "curve"
    }  # of a fit under a curve only
    two_measures(report, scores["rmse"])
    assert report["status"] == "complete"
    for group in content["groups"].values():
        group["error"] = 0.001
    (tmp_path / "materials.json").write_text(json.dumps(content | {"status": "converged"}))
    result = run("stages/render.py", *words(inputs | outputs))
    assert "its values are not proved" in result.stderr
    assert json.loads((tmp_path / "render.report.json").read_text())["status"] == "not converged"


def test_a_rendering_that_is_not_what_the_fit_said_proves_nothing():
    """The fit's light agreed with the photograph, the picture was .3 darker, and nothing said so."""
    group = np.repeat(["wall", "floor", None], 300).reshape(9, 100)
    photograph = np.full((9, 100, 3), 0.6)
    shown = photograph - 0.3 * (group == "wall")[..., None] + 0.01 * (group == "floor")[..., None]
    every = np.ones(group.shape, bool)
    (said,) = display.unlike(shown, photograph, group, every, {"wall": 0.02, "floor": 0.001})
    assert "'wall' is 0.300 (display) darker" in said
    assert display.unlike(shown, photograph, group, group == "floor", {"wall": 0.02, "floor": 0.001}) == []
    assert display.unlike(shown, photograph, group, every, {"wall": 0.12}) == []


def two_measures(report, rmse):
    """The trace has the gathering's error and the picture's, each under its own name; the page does not join them."""
    clocks = {"cpu_s", "wall_s", "iteration"}
    *gathering, last = report["trace"]
    assert gathering and all(set(point) == clocks | {"places", "foretold_error"} for point in gathering)
    assert set(last) == clocks | {"rmse"} and last["rmse"] == rmse
    section = running.convergence_section(parts_of({"reports": {"render": report}}))
    lines = [line.split() for line in re.findall(r'<polyline class="line \w+" points="([^"]*)"', section)]
    assert sorted(map(len, lines)) == sorted((len(gathering), 1))


def test_light_map_where_solids_overlap(tmp_path):
    """A texel inside a solid does not count, also where a ray up from it meets the outer side of a third solid first.

    Two beams reach into a block from both its sides and leave a gap inside it, across which their ends face each other.
    """
    boxes = {
        "block": ((1.0, 1.0, 0), (3.0, 2.0, 0.8)),
        "left": ((0.5, 1.2, 0.2), (1.8, 1.8, 0.6)),
        "right": ((2.2, 1.2, 0.2), (3.5, 1.8, 0.6)),
    }
    objects = rooms.room() | rooms.LAMP
    for name, (low, high) in boxes.items():
        objects |= rooms.solid(name, *low, *high)
    s = scene(tmp_path, objects, look((3.6, 0.3, 1.6), (1.2, 2.0, 0.6)))
    emitters = lamps_.emitters(s.surface, s.factors.lamps)
    light = np.zeros((len(s.factors.mesh), 1))
    E, rho = np.ones((1, 1)), np.full((len(s.surface.normal), 1), 0.5)
    shown = texels.light_map(s.surface, s.factors.mesh, emitters, E, light, s.factors.rows.exposed, rho)
    judged = 0
    for group in boxes:
        for f in np.flatnonzero(s.surface.group == s.groups.index(group)):
            p, good = places(s.surface, shown, 2 * f)
            others = [np.array(box) for name, box in boxes.items() if name != group]
            within = np.any([((p > low + 0.05) & (p < high - 0.05)).all(axis=1) for low, high in others], axis=0)
            without = np.all([((p < low - 0.05) | (p > high + 0.05)).any(axis=1) for low, high in others], axis=0)
            assert not good[within].any() and good[without & (p[:, 2] > 0.05)].all()
            judged += within.sum()
    assert judged > 20


def places(surface, shown, side):
    """(n, 3) m, the texels' middles on a side, and whether they count."""
    start, (nu, nv) = shown.start[side], shown.shape[side]
    if start < 0:
        return np.zeros((0, 3)), np.zeros(0, bool)
    f = side // 2
    u, v = np.meshgrid((np.arange(nu) + 0.5) / nu, (np.arange(nv) + 0.5) / nv, indexing="ij")
    size, axes = surface.size[f], surface.axes[f]
    p = surface.origin[f] + u.reshape(-1, 1) * size[0] * axes[0] + v.reshape(-1, 1) * size[1] * axes[1]
    return p * surface.local.diagonal + surface.local.centre, shown.good[start : start + nu * nv]
