"""Comparing with truth: by hand, at the edge, from outside; and the two-sided bounds."""

import csv
import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from lib.core import record
from lib.core.stage import BadInput
from lib.given import cameras, image, model
from lib.given.materials import Materials
from lib.light import surface as surfaces
from lib.picture import albedo_maps as textures
from lib.verdict import comparing, index_errors, scorecard, stage_reports, texture_errors
from lib.verdict.answers import Answers
from lib.verdict.comparison import ErrorAgainst
from lib.verdict.records import Legend
from tests.helpers import rooms
from tests.helpers.views import FRONT, SQUARE, look


def group(rho, sigma=0.01, **more):
    return {
        "kind": "diffuse",
        "rho_d": rho,
        "rho_s": [0, 0, 0],
        "sigma": {"rho_d": [sigma] * 3} if sigma is not None else None,
        "identified": rho is not None,
        "assumed": None,
        **more,
    }


def materials(groups, lamps=None, gamma=2.0, sigma=None):
    return {
        "status": "converged",
        "groups": groups,
        "lamps": lamps or {},
        "transfer": {"kind": "gamma", "gamma": gamma, "sigma": sigma},
        "scale": "lamps",
    }


def compared(*, found, truth, shown=None, reports=None, albedo=None):
    """Comparison of materials, JSON as in the files. shown : {group: pixels} in truth's group image"""
    found, truth = (record.of(content, "materials.json", Materials) for content in (found, truth))
    pixels = labelled(**shown) if shown else {}
    reports = {stage: stage_reports.of(content, stage) for stage, content in (reports or {}).items()}
    return comparing.compare(Answers(materials=found), Answers(materials=truth, **pixels), reports, albedo)


def errors(**options):
    """{name: value} of the same."""
    return {error.name: error.value for error in compared(**options).errors}


def labelled(**pixels):
    """A one-row image with so many pixels of each group, and its legend."""
    labels = np.concatenate([np.full(n, i + 1) for i, n in enumerate(pixels.values())]).astype(np.int32)[None]
    return {"group": labels, "legend": Legend(groups=list(pixels), objects=[])}


def test_by_hand():
    """Two groups, one of them perfect: six channels, one off by 2 % = 0.01 = 10 sigma."""
    truth = materials({"wall": group([0.5, 0.5, 0.5]), "door": group([0.2, 0.3, 0.4])})
    found = materials(
        {"wall": group([0.51, 0.5, 0.5], 0.001), "door": group([0.2, 0.3, 0.4], 0.003)}, gamma=2.03, sigma=0.01
    )
    shown = dict(wall=500, door=700)
    e = errors(found=found, truth=truth, shown=shown)
    assert e["reflectance.mean_relative"] == pytest.approx(0.02 / 6)
    assert e["reflectance.max_absolute"] == pytest.approx(0.01)
    assert e["reflectance.within_3_sigma"] == pytest.approx(5 / 6)
    assert e["reflectance.median_sigma"] == pytest.approx(0.002)
    assert e["reflectance.unidentified"] == 0 and e["reflectance.groups"] == 2
    assert e["gamma.absolute"] == pytest.approx(0.03) and e["gamma.in_sigmas"] == pytest.approx(3)


def test_what_is_counted():
    """499 pixels are too few, lamps and references are no findings; a group without a value counts as unidentified."""
    truth = materials(
        {n: group([0.5] * 3) for n in ("wall", "book", "lamp", "card", "shelf")}, {"lamp": {"emittance": [4, 4, 4]}}
    )
    found = materials(
        {
            "wall": group([0.5] * 3),
            "book": group([0.9] * 3),
            "lamp": group([0.0] * 3),
            "card": group([0.6] * 3, 0),
            "shelf": group(None),
        },
        {"lamp": {"emittance": [4, 4, 4], "sigma": None}},
    )
    shown = dict(wall=500, book=499, lamp=1000, card=1000, shelf=1000)
    parts = {"found": found, "truth": truth, "shown": shown}
    e = errors(
        **parts, reports={"fit": {"arguments": {"reference": {"card": [0.6] * 3}, "lamps": {"lamp": [4, 4, 4]}}}}
    )
    assert e["reflectance.mean_relative"] == 0 and e["reflectance.groups"] == 2 and e["reflectance.unidentified"] == 1
    assert e["small.mean_relative"] == pytest.approx(0.8) and e["small.groups"] == 1
    assert not any(name.startswith("lamp.") for name in e)
    assert errors(**parts) == e  # without the fit's report a sigma of zero says the same


def test_only_unknown_lamps_count():
    truth = materials({}, {"a": {"emittance": [4, 4, 4]}, "b": {"emittance": [2, 2, 2]}})
    found = materials(
        {},
        {
            "a": {"emittance": [4.4, 4, 4], "sigma": {"emittance": [0.1] * 3}},
            "b": {"emittance": [1, 1, 1], "sigma": None},
        },
    )
    e = errors(found=found, truth=truth)
    assert e["lamp.max_relative"] == pytest.approx(0.1) and e["lamp.mean_relative"] == pytest.approx(0.1 / 3)


def test_a_channel_without_sigma_is_not_within_three_of_them():
    shown = dict(wall=500)
    e = errors(
        found=materials({"wall": group([0.51] * 3, None)}),
        truth=materials({"wall": group([0.5] * 3)}),
        shown=shown,
    )
    assert e["reflectance.within_3_sigma"] == 0 and "reflectance.median_sigma" not in e


def test_black_has_no_relative_error():
    shown = dict(wall=500)
    e = errors(
        found=materials({"wall": group([0.01, 0, 0])}),
        truth=materials({"wall": group([0.0, 0, 0])}),
        shown=shown,
    )
    assert "reflectance.mean_relative" not in e and e["reflectance.max_absolute"] == pytest.approx(0.01)


def test_differ_ignores_edges_and_the_order_of_names():
    truth = np.ones((6, 8), np.int32)
    truth[:, 4:] = 2
    ours = np.where(truth == 1, 2, 1)
    assert index_errors.differ(ours, ["b", "a"], truth, ["a", "b"]) == (0, 0)
    ours[:, 4] = 2  # one column moved: at the edge
    assert index_errors.differ(ours, ["b", "a"], truth, ["a", "b"]) == (0, 6 / 48)
    ours[0, 0] = 0  # nothing there, where truth has something
    inner, every = index_errors.differ(ours, ["b", "a"], truth, ["a", "b"])
    assert inner == pytest.approx(1 / 36) and every == pytest.approx(7 / 48)
    checkers = np.indices((4, 4)).sum(0) % 2 + 1
    assert index_errors.differ(checkers, ["a", "b"], checkers, ["a", "b"]) == (None, 0)


def test_edges_are_symmetric():
    """A lone pixel and its eight neighbours lie at an edge, nothing else."""
    truth = np.ones((7, 7), np.int32)
    truth[3, 3] = 2
    for y in range(7):
        for x in range(7):
            ours = truth.copy()
            ours[y, x] = 3 - ours[y, x]
            inner, _ = index_errors.differ(ours, ["a", "b"], truth, ["a", "b"])
            assert (inner == 0) == (abs(y - 3) <= 1 and abs(x - 3) <= 1), (x, y)


# ---- the ladder: kinds, mirrors, lobes, textures ----


def shiny(kind, rho_s, alpha=None, tangent=None, rho_d=(0, 0, 0), sigma=None):
    return group(list(rho_d), None) | {
        "kind": kind,
        "rho_s": list(rho_s),
        "alpha": alpha,
        "tangent": tangent,
        "sigma": sigma,
    }


def test_mirrors_and_lobes_by_hand():
    truth = {
        "wall": group([0.5] * 3),
        "glass": shiny("mirror", [1, 1, 1]),
        "brass": shiny("coloured_mirror", [0.9, 0.8, 0.5]),
        "tin": shiny("glossy", [0.3] * 3, [0.05, 0.05], rho_d=[0.1] * 3),
        "steel": shiny("glossy", [0.4] * 3, [0.2, 0.1], [0, 1, 0], [0.08] * 3),
    }
    found = {
        "wall": group([0.51] * 3, 0.01),
        "glass": shiny("mirror", [1, 1, 1], sigma={"rho_d": [0, 0, 0], "rho_s": [0, 0, 0]}),
        "brass": shiny("coloured_mirror", [0.9, 0.82, 0.5], sigma={"rho_s": [0.01, 0.005, 0.01]}),
        "tin": shiny(
            "glossy",
            [0.3] * 3,
            [0.055, 0.055],
            rho_d=[0.11, 0.1, 0.1],
            sigma={"rho_d": [0.001] * 3, "rho_s": [0.001] * 3, "alpha": [0.002] * 2},
        ),
        "steel": shiny(
            "glossy",
            [0.4, 0.4, 0.43],
            [0.2, 0.11],
            [0.1, -1, 0],
            [0.08] * 3,
            {"rho_d": [0.001] * 3, "rho_s": [0.02] * 3, "alpha": [0.01] * 2, "tangent_rad": 0.04},
        ),
    }
    shown = dict(wall=500, glass=500, brass=300, tin=200, steel=700)
    e = errors(found=materials(found), truth=materials(truth), shown=shown)
    assert e["kinds.right"] == 1 and e["kinds.groups"] == 5
    assert (
        e["reflectance.groups"] == 1
        and e["reflectance.mean_relative"] == pytest.approx(0.02)
        and "small.groups" not in e
    )
    assert e["mirror.rho_s"] == pytest.approx(0.02) and e["mirror.within_3_sigma"] == pytest.approx(5 / 6)
    assert (
        e["glossy.rho_d"] == pytest.approx(0.01)
        and e["glossy.rho_s"] == pytest.approx(0.03)
        and e["glossy.alpha"] == pytest.approx(0.1)
    )
    assert e["glossy.tangent"] == pytest.approx(np.degrees(np.arctan(0.1)))
    assert e["glossy.within_3_sigma"] == pytest.approx(
        15 / 16
    )  # a round alpha counts once: 3 + 3 + 1 and 3 + 3 + 2 + 1


def test_a_lobe_that_is_nearly_round_has_no_direction():
    shown = dict(steel=500)
    for long, there in ((0.114, False), (0.116, True)):
        truth = materials({"steel": shiny("glossy", [0.4] * 3, [long, 0.1], [1, 0, 0])})
        found = materials({"steel": shiny("glossy", [0.4] * 3, [0.2, 0.1], [0, 1, 0])})
        assert ("glossy.tangent" in errors(found=found, truth=truth, shown=shown)) is there


def test_wrong_kinds_are_listed_and_truth_says_what_a_group_is():
    """A mirror taken for diffuse counts among the mirrors, with all its rho_s.

    A wall taken for glossy keeps its diffuse error.
    """
    truth = {
        "wall": group([0.5] * 3),
        "glass": shiny("mirror", [1, 1, 1]),
        "tin": shiny("glossy", [0.3] * 3, [0.05, 0.05]),
        "door": group([0.5] * 3),
        "chip": shiny("mirror", [1, 1, 1]),
    }
    found = {
        "wall": shiny("glossy", [0.05] * 3, [0.2, 0.2], rho_d=[0.4] * 3),
        "glass": group([0.6] * 3),
        "tin": shiny("glossy", [0.3] * 3, [0.05, 0.05]),
        "door": group([0.5] * 3),
        "chip": group([0.1] * 3),
    }
    shown = dict(wall=500, glass=500, tin=500, door=500, chip=199)
    parts = {"found": materials(found), "truth": materials(truth), "shown": shown}
    comparison = compared(**parts)
    e = {error.name: error.value for error in comparison.errors}
    assert (
        e["kinds.right"] == 0.5
        and e["kinds.groups"] == 4
        and comparison.kinds == {"wall": ("glossy", "diffuse"), "glass": ("diffuse", "mirror")}
    )
    assert e["mirror.rho_s"] == 1 and e["mirror.within_3_sigma"] == 0 and e["glossy.rho_s"] == 0
    assert e["reflectance.groups"] == 2 and e["reflectance.max_relative"] == pytest.approx(0.2)
    named = {"fit": {"arguments": {"surfaces": {"glass": "diffuse", "tin": "glossy"}}}}
    assert errors(**parts, reports=named)["kinds.groups"] == 2  # what scene.yaml says is no finding


def test_where_all_is_diffuse_there_are_no_kinds():
    shown = dict(wall=500, tin=500)
    truth, found = (
        materials({"wall": group([0.5] * 3), "tin": group(None)}),
        materials({"wall": group([0.5] * 3), "tin": group([0.5] * 3)}),
    )
    names = set(errors(found=found, truth=truth, shown=shown))
    assert not any(name.startswith(("kinds", "mirror", "glossy", "texture", "reflectance.only")) for name in names)
    found["groups"]["wall"] |= {"kind": "glossy"}  # a wrong one is said even there
    assert errors(found=found, truth=truth, shown=shown)["kinds.right"] == 0


def test_what_a_mirror_shows_is_compared_where_one_of_the_two_shows_something():
    """10 x 10 px of a mirror show the floor; the names stand in another order in the two legends."""
    true = np.zeros((30, 40), np.uint16)
    true[10:20, 10:20] = 2
    ours = np.zeros_like(true)
    ours[10:20, 10:22] = 1  # two columns too wide, one of them at truth's edge
    shown = Answers(mirror=true, legend=Legend(groups=["glass", "floor"], objects=[]))
    legend = Legend(groups=["floor", "glass"], objects=[])
    found = Answers(materials=record.of(materials({}), "materials.json", Materials), mirror=ours, legend=legend)

    def scores(found):
        return {e.name: e.value for e in comparing.compare(found, shown, {}).errors if e.name.startswith("mirror.")}

    assert scores(found) == {"mirror.differ": 10 / (8 * 8 + 10), "mirror.differ_all": 20 / 120}
    without = dataclasses.replace(found, mirror=None)  # no mirror was found: it shows nothing
    assert scores(without) == {"mirror.differ": 1, "mirror.differ_all": 1}
    assert scores(dataclasses.replace(without, materials=None)) == {}  # nobody looked for one


def test_groups_that_only_a_mirror_shows():
    truth = materials(
        {
            "glass": shiny("mirror", [1, 1, 1]),
            "books": group([0.5] * 3),
            "attic": group([0.5] * 3),
            "card": group([0.5] * 3),
        }
    )
    found = materials(
        {
            "glass": shiny("mirror", [1, 1, 1]),
            "books": group([0.51] * 3),
            "attic": group(None),
            "card": group([0.5] * 3, 0),
        }
    )
    shown = dict(glass=900)
    parts = {"found": found, "truth": truth, "shown": shown}
    e = errors(**parts)
    assert e["reflectance.only_in_mirror"] == pytest.approx(0.02) and e["reflectance.only_in_mirror_groups"] == 1
    found["groups"]["glass"]["kind"] = "diffuse"
    assert "reflectance.only_in_mirror" not in errors(**parts)


# over the unit square: a picture of two pixels, 0.2 on one side and 0.6 on the other
STRIPES = np.array([[[0.2] * 3, [0.6] * 3]])


@pytest.fixture
def square(tmp_path):
    """A folder with a square of one group, `poster`, its posed camera, the facets seen, and its true texture."""
    (tmp_path / "truth").mkdir()
    rooms.write(tmp_path / "model.obj", SQUARE)
    camera = look(*FRONT, (128, 128), 120.0)
    cameras.write_cameramodel(tmp_path / "posed.cameramodel", camera)
    facet = np.zeros((128, 128), int)
    facet[20:108, 20:108] = 1
    image.write_png16(tmp_path / "facet.png", facet)
    image.write_exr(tmp_path / "truth/texture-0.exr", STRIPES)
    (tmp_path / "truth/textures.json").write_text(
        json.dumps({"panel": {"file": "texture-0.exr", "origin": [0, 0, 0], "u": [1, 0, 0], "v": [0, 1, 0]}})
    )
    return tmp_path


def found_texture(folder, off=0.0):
    """What fit would have written of it: two texels to a side, each `off` beside the truth; returns its name."""
    surface = surfaces.surface(model.load(folder / "model.obj"))
    middles = (np.arange(2) + 0.5) / 2
    p = (
        surface.origin[0]
        + middles[:, None, None] * surface.size[0, 0] * surface.axes[0, 0]
        + middles[:, None] * surface.size[0, 1] * surface.axes[0, 1]
    )
    x = (p * surface.local.diagonal + surface.local.centre)[..., :1]
    ones = np.ones((2, 2), np.float32)
    corners = (
        surface.origin[0] + np.stack([np.zeros(3), *(surface.size[0][:, None] * surface.axes[0])])
    ) * surface.local.diagonal + surface.local.centre
    albedo = np.repeat(np.where(x < 0.5, 0.2, 0.6) + off, 3, axis=2).astype(np.float32)
    return Path(
        textures.write(folder, textures.AlbedoMap(0, albedo, ones, ones, ones, np.full(3, 0.4), corners, 0))
    ).name


@pytest.mark.parametrize("off", [0.0, 0.05])
def test_albedo_of_a_texture_at_the_pixels_that_show_it(square, off):
    albedo = texture_errors.albedos(
        model.load(square / "model.obj"),
        cameras.read_cameramodel(square / "posed.cameramodel"),
        image.read_labels(square / "facet.png"),
        record.of(materials({"panel": group([0.4] * 3)}), "materials.json", Materials),
        {0: textures.read(square / found_texture(square, off))},
        texture_errors.read_true_textures(square / "truth/textures.json"),
    )
    ours, true = albedo["panel"]
    assert ours.shape == true.shape == (88 * 88, 3) and ours == pytest.approx(true + off, abs=1e-6)
    assert true.min() == pytest.approx(0.2) and true.max() == pytest.approx(0.6)
    truth, found = (
        materials({"panel": group(rho) | {"kind": kind}})
        for rho, kind in (([0.4] * 3, "textured"), ([0.43, 0.4, 0.4], "textured"))
    )
    shown = dict(panel=500)
    comparison = compared(found=found, truth=truth, shown=shown, albedo=albedo)
    e = {error.name: error.value for error in comparison.errors}
    assert (
        e["texture.rmse"] == pytest.approx(off, abs=1e-6)
        and e["texture.rho_d"] == pytest.approx(0.03)
        and "reflectance.groups" not in e
    )
    assert comparison.textures["panel"].pixels == 88 * 88


def test_without_a_texture_its_constant_counts(square):
    """0.4 all over: 0.2 off on half of the square, linear between the pixels' centres: sqrt((0.04 + 0.04 / 3) / 2)."""
    albedo = texture_errors.albedos(
        model.load(square / "model.obj"),
        look((0.5, 0.5, 1.1), (0.5, 0.5001, 0), (128, 128), 139.0),
        np.ones((128, 128), int),
        record.of(materials({"panel": group([0.4] * 3)}), "materials.json", Materials),
        {},
        texture_errors.read_true_textures(square / "truth/textures.json"),
    )
    ours, true = albedo["panel"]
    assert np.sqrt(((ours - true) ** 2).mean()) == pytest.approx(np.sqrt(0.08 / 3), abs=0.003)


@pytest.mark.parametrize(
    "text",
    [
        '{"panel": {"file": "texture-0.exr"}}',
        '{"panel": {"file": "x", "origin": [0, 0], "u": [1, 0, 0], "v": [0, 1, 0]}}',
        '{"panel": 3}',
        "[]",
    ],
)
def test_a_true_texture_without_its_place_is_refused(tmp_path, text):
    (tmp_path / "textures.json").write_text(text)
    with pytest.raises(BadInput, match="textures.json: .*has not file, origin, u and v of a texture"):
        texture_errors.read_true_textures(tmp_path / "textures.json")


def test_scorecard_has_a_row_for_every_stage_and_the_sum_of_times(tmp_path):
    reports = {
        "index": {"status": "complete", "cpu_s": 1, "wall_s": 2, "peak_mb": 10, "errors": []},
        "fit": {
            "status": "converged",
            "cpu_s": 0.5,
            "wall_s": 0.25,
            "peak_mb": 20,
            "errors": [{"name": "image", "value": 0.1, "unit": "1", "against": "photograph"}],
        },
        "render": {"status": "not converged", "cpu_s": 4, "wall_s": 4, "peak_mb": 5},
    }
    reports = {stage: stage_reports.of(content, stage) for stage, content in reports.items()}
    rows = scorecard.rows("s", reports, [ErrorAgainst("fit", "gamma.absolute", 0.01, "1", "truth")])
    scorecard.write(tmp_path / "s.csv", rows)
    text = (tmp_path / "s.csv").read_text().splitlines()
    assert text[0] == "scene,stage,error,value,unit,against,wall_s,cpu_s,peak_mb,status"
    assert [tuple(r[k] for k in ("stage", "error", "value", "status")) for r in csv.DictReader(text)] == [
        ("index", "", "", "complete"),
        ("fit", "image", "0.1", "converged"),
        ("fit", "gamma.absolute", "0.01", "converged"),
        ("render", "", "", "not converged"),
        ("total", "time.until_fit", "1.5", ""),
        ("total", "time.all", "5.5", ""),
    ]


@pytest.fixture
def checked(tmp_path):
    def call(
        bounds,
        values=(
            ("fit", "gamma.absolute", 0.004),
            ("fit", "residual", 1e-9),
            ("render", "residual", 1e-3),
            ("fit", "void", None),
        ),
    ):
        rows = [{"scene": "s", "stage": s, "error": n, "value": v} for s, n, v in values]
        scorecard.write(tmp_path / "scorecard.csv", rows)
        (tmp_path / "expected.csv").write_text("# why these bounds\nerror,low,high\n" + bounds)
        return scorecard.check(tmp_path / "scorecard.csv", tmp_path / "expected.csv")

    return call


@pytest.mark.parametrize(
    "bounds, lines, word",
    [
        ("gamma.absolute,0.001,0.01\n", 0, ""),
        ("gamma.absolute,0.004,0.004\n", 0, ""),
        ("gamma.absolute,0.001,0.003\n", 1, "above"),
        ("gamma.absolute,0.005,0.01\n", 1, "too good"),
        ("nothing,0,1\n", 1, "missing"),
        ("void,0,1\n", 1, "nothing"),
        ("residual,0,1e-6\n", 1, "render/residual"),
        ("fit/residual,0,1e-6\n", 0, ""),
        ("gamma.absolute,,0.01\n", 1, "not a range"),
        ("gamma.absolute,0.01,0.001\n", 1, "not a range"),
        ("gamma.absolute,nan,1\n", 1, "not a range"),
        ("gamma.absolute,0,inf\n", 1, "not a range"),
    ],
)
def test_bounds_hold_on_both_sides(checked, bounds, lines, word):
    violations = checked(bounds)
    assert len(violations) == lines and all(word in line and "\n" not in line for line in violations), violations


def test_a_table_without_its_columns_is_refused(tmp_path):
    (tmp_path / "e.csv").write_text("error,low\n")
    with pytest.raises(BadInput, match="high: the column is missing"):
        scorecard.read_table(tmp_path / "e.csv", ("error", "low", "high"))


# ---- from outside ----


@pytest.fixture
def outputs(tmp_path):
    """A scene of two groups as the stages leave it, and its truth."""
    labels = np.repeat([[1, 2]], 30, axis=0).repeat(30, axis=1)
    for folder in (tmp_path / "build", tmp_path / "truth"):
        folder.mkdir()
        image.write_png16(folder / "group.png", labels)
        (folder / "legend.json").write_text(json.dumps({"groups": ["wall", "door"], "objects": ["room"], "facets": []}))
        (folder / "materials.json").write_text(
            json.dumps(materials({"wall": group([0.5] * 3), "door": group([0.25] * 3)}, sigma=0.01))
        )
    (tmp_path / "build/fit.report.json").write_text(
        json.dumps({"status": "converged", "cpu_s": 1, "wall_s": 1, "peak_mb": 1, "errors": []})
    )
    (tmp_path / "build/rendered.json").write_text(json.dumps({"rmse": 0.004, "ciede2000": 0.5, "groups": {}}))
    return tmp_path


def command(folder, **more):
    words = [
        "stages/compare.py",
        "--scene",
        "box",
        "--scorecard",
        folder / "out/scorecard.csv",
        "--comparison",
        folder / "out/compare.json",
        "--report",
        folder / "out/compare.report.json",
    ]
    for option, value in more.items():
        words += [f"--{option}", value]
    return words


def test_from_outside(run, outputs):
    b = outputs / "build"
    result = run(
        *command(
            outputs,
            reports=b / "fit.report.json",
            materials=b / "materials.json",
            group=b / "group.png",
            legend=b / "legend.json",
            scores=b / "rendered.json",
            truth=f"{outputs}/truth/",
        )
    )
    assert result.returncode == 0, result.stderr
    rows = {r["error"]: r for r in csv.DictReader((outputs / "out/scorecard.csv").read_text().splitlines())}
    assert rows["reflectance.mean_relative"]["value"] == "0" and rows["reflectance.mean_relative"]["stage"] == "fit"
    assert rows["index.differ"]["value"] == "0" and rows["render.rmse"]["value"] == "0.004"
    assert json.loads((outputs / "out/compare.json").read_text())["groups"]["wall"]["counted"] is True


def test_without_truth_or_anything_there_is_still_a_scorecard(run, outputs):
    assert run(*command(outputs)).returncode == 0
    assert (outputs / "out/scorecard.csv").read_text().count("\n") == 1


def test_what_truth_or_the_camera_does_not_tell_is_not_asked(run, outputs):
    """A legend of truth with groups alone, and no pose.json, as of a camera told in numbers: both ended whole runs."""
    (outputs / "truth/legend.json").write_text('{"groups": ["wall", "door"]}')
    b = outputs / "build"
    result = run(
        *command(
            outputs,
            pose=b / "pose.json",
            group=b / "group.png",
            legend=b / "legend.json",
            truth=outputs / "truth",
        )
    )
    assert result.returncode == 0, result.stderr
    rows = {r["error"]: r for r in csv.DictReader((outputs / "out/scorecard.csv").read_text().splitlines())}
    assert rows["index.differ"]["value"] == "0" and "object.differ" not in rows


def test_another_size_is_said_and_left_out(run, outputs):
    image.write_png16(outputs / "truth/group.png", np.ones((5, 5), int))
    result = run(
        *command(
            outputs, group=outputs / "build/group.png", legend=outputs / "build/legend.json", truth=outputs / "truth"
        )
    )
    assert result.returncode == 0 and "5 x 5 is not the size" in result.stderr
    assert "index.differ" not in (outputs / "out/scorecard.csv").read_text()


def test_a_texture_and_a_wrong_kind_from_outside(run, square):
    file = found_texture(square, 0.05)
    entry = group([0.4] * 3) | {"kind": "textured", "texture": {"0": file}}
    (square / "materials.json").write_text(json.dumps(materials({"panel": entry, "tin": group([0.3] * 3)})))
    (square / "truth/materials.json").write_text(
        json.dumps(materials({"panel": entry, "tin": shiny("glossy", [0.3] * 3, [0.1, 0.1])}))
    )
    labels = np.concatenate([np.full((20, 128), 2), np.full((108, 128), 1)])
    image.write_png16(square / "truth/group.png", labels)
    (square / "truth/legend.json").write_text(json.dumps({"groups": ["panel", "tin"], "objects": [], "facets": []}))
    words = command(
        square,
        materials=square / "materials.json",
        facet=square / "facet.png",
        model=square / "model.obj",
        posed=square / "posed.cameramodel",
        truth=square / "truth",
    )
    result = run(*words)
    assert result.returncode == 0 and "group 'tin' is found diffuse; in truth it is glossy" in result.stderr, (
        result.stderr
    )
    rows = {r["error"]: r["value"] for r in csv.DictReader((square / "out/scorecard.csv").read_text().splitlines())}
    assert float(rows["texture.rmse"]) == pytest.approx(0.05, abs=1e-6) and rows["kinds.right"] == "0.5"
    assert json.loads((square / "out/compare.json").read_text())["kinds"] == {"tin": ["diffuse", "glossy"]}
    assert str(square / file) in json.loads((square / "out/compare.report.json").read_text())["inputs"]


@pytest.mark.parametrize(
    "change, line",
    [
        ({"texture": {"0": "texture-9.exr"}}, "texture-9.json: there is no such file"),
        ({"texture": {"x": "texture-0.exr"}}, "has x: 'texture-0.exr', which is not a facet's number and a file"),
        ({"texture": ["texture-0.exr"]}, "groups.panel.texture = ['texture-0.exr'] is neither null nor a table"),
        ({"rho_d": [1.2, 0, 0]}, "groups.panel.rho_d = [1.2, 0, 0] is outside [0, 1]"),
        ({"alpha": [1]}, "groups.panel.alpha = [1] is neither null nor two numbers"),
        ({"sigma": {"tangent_rad": "small"}}, "groups.panel.sigma.tangent_rad = 'small' is neither null nor a number"),
        ({"kind": 3}, "groups.panel.kind = 3 is neither null nor a word"),
    ],
)
def test_a_group_that_cannot_be_read_is_one_line(refuses, square, change, line):
    (square / "materials.json").write_text(json.dumps(materials({"panel": group([0.4] * 3) | change})))
    words = command(
        square,
        materials=square / "materials.json",
        facet=square / "facet.png",
        model=square / "model.obj",
        posed=square / "posed.cameramodel",
        truth=square / "truth",
    )
    lines = refuses(*words)
    assert len(lines) == 1 and line in lines[0], lines
    assert not (square / "out").exists()


@pytest.mark.parametrize(
    "file, content, line",
    [
        (
            "truth/materials.json",
            '{"groups": {"wall": {"rho_d": [1, 2]}}}',
            "groups.wall.rho_d = [1, 2] is neither null nor three numbers",
        ),
        ("truth/materials.json", "{", "not readable JSON"),
        ("truth/legend.json", '{"groups": 3}', "groups: missing, or not a list of names"),
        (
            "truth/legend.json",
            '{"groups": ["wall"], "objects": []}',
            "index: 2 is more than the 1 groups of the legend",
        ),
        ("truth/group.png", "", "the file is empty"),
    ],
)
def test_bad_input_is_one_line(refuses, files_under, outputs, file, content, line):
    (outputs / file).write_text(content)
    before = files_under(outputs)
    b = outputs / "build"
    lines = refuses(
        *command(
            outputs,
            materials=b / "materials.json",
            group=b / "group.png",
            legend=b / "legend.json",
            truth=outputs / "truth",
        )
    )
    assert any(line in text and str(outputs / "truth") in text for text in lines), lines
    assert files_under(outputs) == before
