"""The page is one file, shows only what there is, escapes everything, and holds no NaN."""

import json
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest

from lib.given import image
from lib.given.materials import SCALES
from lib.picture import albedo_maps
from lib.planning.command import imports
from lib.verdict import stage_reports
from lib.verdict.page import build, pictures, plots, summary
from lib.verdict.page.parts import Changed, Parts
from tests.helpers.html import sane
from tests.helpers.page_parts import climbed, everything, parts_of, texture

NASTY = '<script>alert("x")</script>&\'"'
BUFFERS = ("group", "object", "facet", "hidden", "trusted", "depth")
SECTIONS = {  # title -> whether its data are there
    "Warnings": lambda p: p.reports,
    "Difference": lambda p: p.photograph is not None and p.rendered is not None,
    "Materials": lambda p: p.materials,
    "How each surface reflects": lambda p: p.materials and p.reports,
    "Light and camera": lambda p: p.materials,
    "Transfer models compared": lambda p: p.reports,
    "What each pixel shows": lambda p: any(getattr(p, name) is not None for name in BUFFERS),
    "Convergence": lambda p: p.reports,
    "Time": lambda p: p.reports,
    "How it was made": lambda p: p.reports or p.plan or p.comparison,
}
PARTS = [f.name for f in fields(Parts) if f.name not in ("scene", "linear")]


def shown(files):
    """The page of files by hand, as a tree."""
    return sane(build.page(parts_of(files)))


def of_parts(parts):
    """The titles of its sections are those of which it has the data."""
    page = sane(build.page(parts))
    assert page.titles == [title for title, there in SECTIONS.items() if there(parts)]
    return page


# ---- what is there, and only that ----


def test_changed_pictures_lie_over_the_photograph_where_they_show_the_same_view():
    """A slider for a change of the photograph, a picture for another camera, a link for a sequence."""
    parts = parts_of(everything())
    entries = {"egg": {"name": "egg", "remove": ["a"]}, "door": {"name": "door", "camera": "door.cameramodel"}}
    reports = {f"augment.{name}": {"arguments": {"entry": entry}} for name, entry in entries.items()}
    parts.reports |= {name: stage_reports.of(content, name) for name, content in reports.items()}
    parts.changed = [Changed(name, f"augmented.{name}.png", parts.photograph) for name in entries]
    parts.changed.append(Changed("walk", "augmented.walk.mp4", None))
    section = sane(build.page(parts)).section("Changed pictures")
    assert [a.attributes["href"] for a in section.all("a")] == [one.address for one in parts.changed]
    assert len(section.all("input")) == 1 and section.one("span", "right").text == "egg"


def test_what_does_not_fit_is_no_finding():
    files = everything()
    found = files["materials"]
    wall = found["groups"]["wall"] | {"identified": False, "sigma": {"rho_d": None}}
    transfer = found["transfer"] | {"sigma": None, "asked": "auto"}
    why = [
        {"cause": "lamp_power", "subject": "lamp", "text": "lamp 'lamp': 0.8 times its emittance", "evidence_nats": 99}
    ]
    wrong = {"status": "does not fit", "groups": found["groups"] | {"wall": wall}, "transfer": transfer, "why": why}
    page = of_parts(parts_of(files | {"materials": found | wrong}))
    assert (
        page.one("span", "badge").text == "Does not fit" and "gamma 2.004 (no finding)" in page.one("p", "verdict").text
    )
    rows = {row[1].split()[0]: row for row in page.section("Materials").one("table").rows()}
    assert "no finding: the photograph does not fit it" in rows["wall"][1] and "±" not in rows["wall"][2]


@pytest.mark.parametrize("scale", SCALES)
def test_every_scale_has_its_words(scale):
    """A page with a contradicted one was a traceback."""
    files = everything()
    more = {"sigma_scale": [0.04, 0.05, 0.061]} if scale == "contradicted" else {}
    page = of_parts(parts_of(files | {"materials": files["materials"] | {"scale": scale} | more}))
    assert ("standard deviation is 6 %" in page.section("Light and camera").text) == (scale == "contradicted")


def test_everything():
    page = of_parts(parts_of(everything()))
    verdict = page.one("p", "verdict").text
    assert (
        "differs from the photograph by 0.70 % of full scale; 2 of 4 groups identified; gamma 2.004 ± 0.003." in verdict
    )
    assert "Against the known truth, reflectances are off by 0.20 % on average." in verdict
    rows = {row[1].split()[0]: row for row in page.section("Materials").one("table").rows()}
    assert rows["wall"][2] == "0.7000 ± 0.0010 truth 0.7100 −1.40 %, 10.0 σ" and "identified" in rows["wall"][1]
    assert rows["wall"][4] == "0.5000 ± 0.0030 truth 0.0000 +0.5000"  # black in truth: no relative error
    assert rows["card"][1] == "card diffuse, given as a reference"
    assert "never seen; assumed from the other groups" in rows["back"][1] and rows["back"][2] == "0.400"
    assert "none of its 30 pixels can be trusted; no value" in rows["dark"][1] and rows["dark"][2] == "–"
    assert page.section("Materials").one("p", "lead").one("span", "off").text == "1 channel"
    lamps = page.section("Light and camera").one("table").rows()
    assert lamps == [["lamp", "4", "given"], ["spot", "2 ± 0.1 truth 2.1 −5.00 %", "estimated"]]
    assert "γ = 2.004 ± 0.003, truth 2.000; the band is 3 σ wide" in page.section("Light and camera").text
    assert page.section("Warnings").text == "Warnings index a facet is not planar"
    assert "segment no goal needs it" in page.section("How it was made").text
    slider = page.one("input")
    assert slider.attributes["type"] == "range" and slider.attributes["aria-label"]


def test_notes_stand_apart_from_warnings():
    files = everything()
    files["reports"]["index"]["notes"] = ["2 polygons without area were dropped"]
    page = shown(files)
    assert page.section("Warnings").text == "Warnings index a facet is not planar"
    assert page.section("Notes").one("ul").text == "index 2 polygons without area were dropped"
    assert page.one("nav").text.startswith("1 warning ")


def test_the_picture_comes_before_links_and_warnings_and_the_next_steps_with_it():
    parts = parts_of(everything())
    parts.steps = ["Run `make attic/export`: <b>", "Then look."]
    text = build.page(parts)
    first, second = sane(text).one("div", "next").all("li")
    assert (first.text, second.text) == ("Run make attic/export : <b>", "Then look.") and first.one("code")
    body = text[text.index("<body>") :]
    places = [body.index(word) for word in ('<p class="verdict"', 'class="next"', "<img", "<nav", 'id="warnings"')]
    assert places == sorted(places) and "<a " not in body[: body.index("<img")]


def test_nothing():
    page = of_parts(Parts())
    assert page.one("span", "badge").text == "Nothing to report" and not page.all("h2")


@pytest.mark.parametrize("missing", PARTS)
def test_each_part_may_be_missing(missing):
    files = everything()
    files.pop(missing, None)
    of_parts(parts_of(files))


@pytest.mark.parametrize("only", PARTS)
def test_each_part_may_be_alone(only):
    of_parts(parts_of({name: value for name, value in everything().items() if name == only}))


def test_one_channel():
    files = everything(channels=1)
    for group in files["materials"]["groups"].values():
        for key in ("rho_d", "assumed"):
            group[key] = [group[key][0]] * 3 if group[key] else None
    page = of_parts(parts_of(files))
    heads = page.section("Materials").one("table").heads()
    assert heads[2] == "ρ" and "ρ R" not in heads


def test_sizes_that_do_not_match():
    files = everything()
    files["rendered"], files["trusted"] = files["rendered"][:20], files["trusted"][:10]
    page = shown(files)
    assert "Difference" not in page.titles and not page.all("input")
    assert page.one("div", "hero").one("figcaption").text == "The photograph"
    assert "tinted" not in page.section("What each pixel shows").text


@pytest.mark.scene
def test_large_noisy_pictures_stay_below_the_limit():
    rng = np.random.default_rng(2)
    photo = rng.random((1200, 1800, 3))
    facet = rng.integers(0, 60000, (1200, 1800)).astype(np.int32)
    text = build.page(Parts(photograph=photo, rendered=1 - photo, facet=facet))
    assert sane(text).titles == ["Difference", "What each pixel shows"]
    assert len(text.encode()) > 0.2 * build.LIMIT_BYTES  # and are no smaller than they must


@pytest.mark.parametrize("status, badge", [("converged", "good"), ("not converged", "warn"), ("nothing seen", "bad")])
def test_the_badge_says_what_came_out(status, badge):
    files = everything()
    files["materials"]["status"] = status
    assert summary.verdict(parts_of(files)).kind == badge
    files = everything()
    files["reports"]["render"]["status"] = "not converged"
    verdict = summary.verdict(parts_of(files))
    assert verdict.kind == "warn" and verdict.sentence.endswith("Not converged: render.")


def test_a_misfit_is_said():
    files = everything()
    files["reports"]["fit"]["misfit"] = 7.2
    verdict = summary.verdict(parts_of(files))
    assert verdict.badge == "Does not fit" and "It differs 7 times more than noise explains" in verdict.sentence


# ---- times ----


def test_times_are_counted_apart_and_waited_for_with_their_sums():
    page = shown(everything())
    table = page.section("Time").one("table")
    assert table.heads()[:6] == ["Stage", "CPU s", "Imports s", "Compilation s", "Clock s", "Peak MB"]
    assert [row[:5] for row in table.rows()] == [
        ["index", "0.30", "–", "–", "0.40"],
        ["fit", "0.90", "0.50", "1.00", "2.20"],
        ["render", "3.00", "–", "–", "2.00"],
        ["all", "4.20", "0.50", "1.00", "4.60"],
    ]
    fact = page.one("dl", "facts").all("div")[-1].text
    assert fact == (
        "Computing time 1.2 s of CPU, up to the reflectances; 4.2 s with the pictures;"
        " 4.6 s on the clock with imports and compilation"
    )


# ---- numbers and text of any kind ----


def walked(value, change):
    """The same thing with each leaf changed: records, tables and lists at any depth."""
    if is_dataclass(value):
        return replace(value, **{f.name: walked(getattr(value, f.name), change) for f in fields(value)})
    if isinstance(value, dict):
        return {key: walked(item, change) for key, item in value.items()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*(walked(item, change) for item in value))
    if isinstance(value, list | tuple):
        return type(value)(walked(item, change) for item in value)
    return change(value)


@pytest.mark.parametrize("make", [everything, climbed])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300])
def test_numbers_of_any_kind(bad, make):
    """No file of ours holds such a number; yet a page with NaN on it would be the last to say so."""
    parts = parts_of(make())
    for name in ("materials", "scores", "comparison", "reports"):
        changed = walked(getattr(parts, name), lambda v: bad if isinstance(v, float) else v)
        setattr(parts, name, changed)
    if not np.isfinite(bad):
        parts.photograph = np.full_like(parts.photograph, bad)
        parts.depth = np.full(parts.depth.shape, bad)
    titles = sane(build.page(parts)).titles
    assert {"Materials", "How each surface reflects", "Time"} <= {*titles}


@pytest.mark.parametrize("make", [everything, climbed])
def test_text_is_escaped(make):
    """Names and words of every file; only the words that choose what is shown stay as they are."""
    parts = parts_of(make())
    kept = ("gamma", "converged", "lamps")
    for name in ("materials", "scores", "comparison", "reports", "legend"):
        changed = walked(getattr(parts, name), lambda v: NASTY if isinstance(v, str) and v not in kept else v)
        setattr(parts, name, changed)
    for record in (parts.materials, parts.scores, parts.comparison):
        object.__setattr__(record, "groups", {NASTY + key: value for key, value in record.groups.items()})
    object.__setattr__(parts.materials, "lamps", {NASTY + key: lamp for key, lamp in parts.materials.lamps.items()})
    parts.thumbnails = {NASTY + key: value for key, value in parts.thumbnails.items()}
    ladder = parts.reports["fit"].ladder
    for key in ("diffuse", "end", "rungs", "rays"):
        object.__setattr__(ladder, key, {NASTY + name: value for name, value in getattr(ladder, key).items()})
    parts.reports = {key if key in ("fit", "render") else key + NASTY: value for key, value in parts.reports.items()}
    parts.scene, parts.plan = NASTY, [(NASTY, NASTY)]
    page = of_parts(parts)
    assert page.one("h1").text.startswith(NASTY)
    for title in SECTIONS:
        if title != "Convergence":  # of stages whose names were kept
            assert NASTY in page.section(title).text, title


# ---- scales, colours, ticks ----


def test_difference_scale_is_round_and_keeps_the_sign():
    photo = np.full((10, 10, 3), 0.5)
    signed, half = pictures.difference(photo, photo + np.array([0.01, -0.03, 0.0]))
    assert np.allclose(signed, -0.03) and half == pytest.approx(0.05)
    assert pictures.difference(photo, photo)[1] > 0
    darker, equal, brighter = pictures.diverging(np.array([-1.0, 0, 1.0]), 0.5).astype(int)
    assert darker[2] > darker[0] and brighter[0] > brighter[2] and np.ptp(equal) < 10


def test_colours_differ():
    some = pictures.colours(40).astype(int)
    assert min(np.abs(a - b).max() for i, a in enumerate(some[:16]) for b in some[:i]) > 12
    assert pictures.colours(0).shape == (0, 3)


@pytest.mark.parametrize(
    "low, high, log",
    [
        (0, 1, False),
        (1.9, 2.4, False),
        (-3, 0.5, True),
        (0.26, 0.31, True),
        (-9, 9, True),
        (-0.1, 0.1, False),
        (1e6, 1e6 + 1, False),
    ],
)
def test_ticks_lie_inside_and_are_few(low, high, log):
    ticks = plots.ticks(low, high, log)
    assert 2 <= len(ticks) <= 14 and all(low - 1e-6 <= v <= high + 1e-6 for v, _ in ticks)
    assert len({label for _, label in ticks}) == len(ticks)


# ---- from outside ----


@pytest.fixture
def outputs(tmp_path):
    files = everything()
    for name in ("photograph", "rendered"):
        image.write_png8(tmp_path / f"{name}.png", (files[name] * 255).round().astype(np.uint8))
    for name in ("group", "object", "facet"):
        image.write_png16(tmp_path / f"{name}.png", files[name])
    for name in ("hidden", "trusted"):
        image.write_png8(tmp_path / f"{name}.png", files[name])
    image.write_exr(tmp_path / "depth.exr", files["depth"], name="Z")
    for name in ("legend", "materials", "scores", "comparison"):
        (tmp_path / f"{name}.json").write_text(json.dumps(files[name]))
    for name, report in files["reports"].items():
        (tmp_path / f"{name}.report.json").write_text(json.dumps(report))
    (tmp_path / "plan.mk").write_text(
        "# Written by lib/planning/plan.py; do not edit.\n# attic: index -> fit\n"
        "#   without segment: no goal needs it\n\nSHELL := bash\n#   without x: y\n"
    )
    return tmp_path


def command(folder, **more):
    words = ["stages/report.py", "--scene", "attic"]
    words += ["--page", folder / "report.html", "--report", folder / "report.report.json"]
    for option, value in more.items():
        words += [f"--{option}", *(value if isinstance(value, list) else [value])]
    return words


def page_in(folder):
    return sane((folder / "report.html").read_text(encoding="utf-8"))


def test_from_outside(run, outputs):
    names = ("photograph", "rendered", "group", "object", "facet", "hidden", "trusted")
    files = {name: outputs / f"{name}.png" for name in names} | {"depth": outputs / "depth.exr"}
    files |= {name: outputs / f"{name}.json" for name in ("legend", "materials", "scores", "comparison")}
    reports = [outputs / f"{name}.report.json" for name in ("index", "fit", "render")]
    result = run(*command(outputs, **files, reports=reports, transfer='"gamma"'))
    assert result.returncode == 0, result.stderr
    page = page_in(outputs)
    assert page.titles == ["What now", *SECTIONS]
    assert [item.text for item in page.section("How it was made").one("ul", "plainlist").all("li")] == [
        "segment no goal needs it"
    ]


def test_textures_are_read_from_beside_the_materials(run, outputs):
    files = climbed()
    albedo_maps.write(outputs, texture())
    (outputs / "materials.json").write_text(json.dumps(files["materials"]))
    (outputs / "fit.report.json").write_text(json.dumps(files["reports"]["fit"]))
    result = run(*command(outputs, materials=outputs / "materials.json", reports=[outputs / "fit.report.json"]))
    assert result.returncode == 0, result.stderr
    album = page_in(outputs).section("How each surface reflects").one("div", "albums")
    assert album.one("figcaption").text.startswith("facet 7, 0.6 × 0.2 m")
    assert str(outputs / "texture-7.exr") in json.loads((outputs / "report.report.json").read_text())["inputs"]


def test_a_texture_that_is_not_there_is_one_line(refuses, outputs):
    (outputs / "materials.json").write_text(json.dumps(climbed()["materials"]))
    assert refuses(*command(outputs, materials=outputs / "materials.json")) == [
        f"report.py: {outputs}/texture-7.json: there is no such file"
    ]
    assert not (outputs / "report.html").exists()


def test_a_linear_photograph_is_shown_in_display_values(run, outputs):
    """Light above 1 is white, a fifth of it is 0.2^(1 / 2.2) of full scale."""
    light = np.full((8, 8, 3), 4.0)
    light[:, 4:] = 0.2
    image.write_exr(outputs / "left.exr", light)
    assert run(*command(outputs, photograph=outputs / "left.exr")).returncode == 0
    picture = decoded(page_in(outputs).one("div", "hero").one("img").attributes["src"])
    assert picture[0, 0] == 255
    assert picture[0, 7] == pytest.approx(255 * 0.2 ** (1 / 2.2), abs=2)


def decoded(uri):
    """The picture of a data URI."""
    import base64

    import cv2

    return cv2.imdecode(np.frombuffer(base64.b64decode(uri.partition(",")[2]), np.uint8), -1)


def test_without_anything_there_is_still_a_page(run, tmp_path):
    assert run(*command(tmp_path)).returncode == 0
    page = page_in(tmp_path)
    assert page.one("span", "badge").text == "Nothing to report" and not page.titles


@pytest.mark.parametrize(
    "file, content, line",
    [
        (
            "materials",
            '{"groups": {"wall": {"rho_d": "white"}}}',
            "groups.wall.rho_d = 'white' is neither null nor three",
        ),
        ("scores", '{"rmse": "small"}', "rmse = 'small' is neither null nor a number"),
        ("comparison", '{"errors": [{"name": 3}]}', "errors.0.name = 3 is neither null nor a word"),
        ("legend", '{"groups": ["wall"]}', "objects: missing, or not a list of names"),
        ("legend", "[]", "groups: missing, or not a list of names"),
    ],
)
def test_bad_input_is_one_line(refuses, files_under, outputs, file, content, line):
    path = outputs / f"{file}.json"
    path.write_text(content)
    before = files_under(outputs)
    lines = refuses(*command(outputs, **{file: path}))
    assert lines[0].startswith(f"report.py: {path}: ") and line in lines[0], lines
    assert files_under(outputs) == before


def test_an_edit_of_a_template_makes_the_page_again(root):
    files = {path.name for path in imports(root / "stages/report.py", root)}
    assert {"page.css", "page.js", "page.html", "materials.html"} <= files
