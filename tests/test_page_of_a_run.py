"""The page of a real run shows what the stages' files say. A record made by hand would agree with any mistake."""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lib.core import record
from lib.verdict.comparison import Comparison
from lib.verdict.page.html import fixed, number, percent, pm
from tests.helpers import small_office
from tests.helpers.html import sane

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.scene


@pytest.fixture(scope="module")
def office():
    """The folder of the small office's results."""
    return small_office.run()


@pytest.fixture(scope="module")
def page(office):
    return sane((office / "report.html").read_text(encoding="utf-8"))


def read(path):
    return json.loads(path.read_text())


def stages(folder):
    """{stage: its report}, of those before the page."""
    names = (path.name.removesuffix(".report.json") for path in folder.glob("*.report.json"))
    return {name: read(folder / f"{name}.report.json") for name in names if name != "report"}


def test_every_section_is_there(page):
    assert page.titles == [
        "What now",
        "Warnings",
        "Difference",
        "Materials",
        "How each surface reflects",
        "Light and camera",
        "Transfer models compared",
        "Where the camera is",
        "What each pixel shows",
        "Convergence",
        "Time",
        "How it was made",
    ]


def test_every_warning_is_shown(page, office):
    warnings = {(stage, text) for stage, report in stages(office).items() for text in report["warnings"]}
    shown = [item.text for item in page.section("Warnings").all("li")]
    assert {*shown} == {f"{stage} {text}" for stage, text in warnings} and len(shown) == len(warnings) > 0


def test_the_head_says_what_the_files_say(page, office):
    materials, scores = read(office / "materials.json"), read(office / "rendered.json")
    errors = {e["name"]: e["value"] for e in read(office / "compare.json")["errors"]}
    groups = [g for name, g in materials["groups"].items() if name not in materials["lamps"]]
    warnings = sum(len(report["warnings"]) for report in stages(office).values())
    assert page.one("h1").text == "office Converged" and warnings == 1
    assert page.one("nav").text.startswith(f"{warnings} warning ")  # below the picture
    gamma = pm(materials["transfer"]["gamma"], materials["transfer"]["sigma"], 3)
    assert page.one("p", "verdict").text == (
        f"Re-rendering differs from the photograph by {percent(scores['rmse'])} of full scale;"
        f" {sum(g['identified'] for g in groups)} of {len(groups)} groups identified; gamma {gamma}."
        f" Against the known truth, reflectances are off by {percent(errors['reflectance.mean_relative'])} on average."
    )


def test_materials_are_those_of_the_file_beside_the_truth(page, office):
    found = read(office / "materials.json")["groups"]
    truth = read(small_office.OFFICE / "truth/materials.json")["groups"]
    rows = {row[1].split()[0]: row for row in page.section("Materials").one("table").rows()}
    assert rows.keys() == {name for name in found if name != "lamp"}
    known = [name for name in rows if found[name]["identified"]]
    assert len(known) >= 10
    for name in known:
        for c in range(3):
            value, sigma = found[name]["rho_d"][c], found[name]["sigma"]["rho_d"][c]
            true = truth[name]["rho_d"][c]
            off = percent(value / true - 1, 2 if abs(value / true - 1) < 0.1 else 1, sign=True)
            z = abs(value - true) / sigma
            assert rows[name][2 + c] == f"{value:.4f} ± {sigma:.4f} truth {true:.4f} {off}, {z:.1f} σ", name
        assert rows[name][-2:] == [number(found[name]["pixels"]), percent(found[name]["error"])]


def test_reflectances_fitted_again_stand_beside_those_of_the_fit(page, office):
    """display.transfer_models writes `rmse_refitted`; the page once looked for another name and left the column out.

    At the light of the fit a histogram comes nearer to the photograph than the camera's own gamma, which seems to
    refute figure 4.5. With reflectances fitted again it does not.
    """
    models = read(office / "render.report.json")["transfer_models"]
    table = page.section("Transfer models compared").one("table")
    assert table.heads() == ["Model", "RMSE", "Reflectances refitted", "Note"]
    assert [row[1:] for row in table.rows()] == [
        [percent(model["rmse"]), percent(model["rmse_refitted"]), model["note"]] for model in models
    ]
    of_kind = {model["kind"]: model for model in reversed(models)}  # the first gamma is the fit's
    assert of_kind["histogram"]["rmse"] < of_kind["gamma"]["rmse"]
    assert of_kind["histogram"]["rmse_refitted"] > 2 * of_kind["gamma"]["rmse_refitted"]


def test_times_are_those_of_the_reports_with_their_sums(page, office):
    """CPU seconds that count, imports, compilation and hashing apart, and on the clock all that a user waits."""
    reports, table = stages(office), page.section("Time").one("table")
    assert table.heads()[:6] == ["Stage", "CPU s", "Imports s", "Compilation s", "Hashing s", "Clock s"]
    *rows, total = table.rows()
    assert {row[0] for row in rows} == reports.keys() and total[0] == "all"
    clock = {name: r["waited_s"] for name, r in reports.items()}
    for name, *cells in rows:
        r = reports[name]
        assert cells[:5] == [
            fixed(r["cpu_s"], 2),
            fixed(r["imports_s"], 2),
            fixed(r.get("compile_s"), 2),
            fixed(r["hashing_s"], 2),
            fixed(clock[name], 2),
        ]
        assert clock[name] > r["wall_s"] + r["imports_wall_s"] - 1e-9
    sums = [sum(r.get(key, 0) for r in reports.values()) for key in ("cpu_s", "imports_s", "compile_s", "hashing_s")]
    assert total[1:6] == [fixed(value, 2) for value in (*sums, sum(clock.values()))]
    fact = page.one("dl", "facts").all("div")[-1].text
    assert f"{fixed(sum(clock.values()), 1)} s on the clock with imports and compilation" in fact


def test_the_comparison_is_read_as_it_was_written(office):
    content = read(office / "compare.json")
    assert record.plain(record.of(content, "compare.json", Comparison)) == content and content["groups"]


def test_every_error_of_the_scorecard_is_listed(page, office):
    with open(office / "scorecard.csv", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["error"] and row["stage"] != "total"]
    shown = [row[:3] for row in page.section("How it was made").one("table").rows()]
    for row in rows:
        value = float(row["value"]) if row["value"] else None
        words = row["error"].replace(".", ": ").replace("_", " ")
        assert any(s[:2] == [row["stage"], words] and near(s[2], value) for s in shown), row


def near(text, value):
    """The same number, up to the three digits that are shown."""
    return text in (number(value), number(int(value)) if value is not None and value == int(value) else None)


def test_the_curve_of_the_fit_has_a_point_for_each_iteration(page, office):
    trace = stages(office)["fit"]["trace"]
    plots = {div.one("h3").text: div for div in page.section("Convergence").one("div", "two").elements}
    assert len(trace) >= 3
    assert len(points(plots["fit"].one("polyline"))) == len(points(plots["fit: gamma"].one("polyline"))) == len(trace)


def points(polyline):
    """(n, 2) px"""
    return np.array([point.split(",") for point in polyline.attributes["points"].split()], float)


# ---- a pair ----


@pytest.fixture(scope="module")
def segmented(tmp_path_factory):
    """The report of segmentation of a pair, and the page that shows it."""
    folder = tmp_path_factory.mktemp("pair")
    for side in ("left", "right"):
        shutil.copyfile(ROOT / f"data/venus/{side}.png", folder / f"{side}.png")
    words = {
        "stages/segment.py": ["photograph left.png", "photograph-right right.png", "report segment.report.json"]
        + ["regions left.regions.png", "regions-right right.regions.png"],
        "stages/report.py": ["photograph left.png", "photograph-right right.png", "reports segment.report.json"]
        + ["regions left.regions.png", "regions-right right.regions.png"]
        + ["page report.html", "report report.report.json"],
    }
    for stage, options in words.items():
        pairs = [word for option in options for word in (f"--{option.split()[0]}", str(folder / option.split()[1]))]
        result = subprocess.run([sys.executable, ROOT / stage, *pairs], cwd=ROOT, capture_output=True, text=True)
        assert result.returncode == 0, result.stderr
    return read(folder / "segment.report.json"), sane((folder / "report.html").read_text(encoding="utf-8"))


def test_the_energy_has_a_line_for_each_photograph(segmented):
    """One line through both once jumped from the end of the left one up to the start of the right one."""
    report, page = segmented
    energy = {side: [t["energy"] for t in report["trace"] if t["side"] == side] for side in ("left", "right")}
    assert all(len(values) >= 3 for values in energy.values())
    section = page.section("Convergence")
    assert [key.text for key in section.one("p", "keys").all("span")] == ["energy, left", "energy, right"]
    lines = [points(line) for line in section.all("polyline")]
    assert [len(line) for line in lines] == [len(values) for values in energy.values()]
    for line, values in zip(lines, energy.values(), strict=True):
        assert (np.sign(np.diff(line[:, 1])) == -np.sign(np.diff(values))).all()  # lower energy, further down
        assert (np.diff(line[:, 0]) >= 0).all()
    assert lines[0][-1, 0] <= lines[1][0, 0]  # the right one is worked on after the left one


def test_regions_are_counted(segmented):
    report, page = segmented
    captions = [caption.text for caption in page.section("Regions").all("figcaption")]
    assert captions == [f"{side.capitalize()}: {report['regions'][side]} regions" for side in ("left", "right")]
