"""Comparing with truth: by hand, at the edge, from outside; and the two-sided bounds."""
import csv
import json

import numpy as np
import pytest

from lib import comparing, image
from lib.stage import BadInput


def group(rho, sigma=0.01, **more):
    return {"kind": "diffuse", "rho_d": rho, "rho_s": [0, 0, 0], "sigma": {"rho_d": [sigma] * 3} if sigma is not None else None,
            "identified": rho is not None, "assumed": None, **more}


def materials(groups, lamps=None, gamma=2.0, sigma=None):
    return {"status": "converged", "groups": groups, "lamps": lamps or {}, "transfer": {"kind": "gamma", "gamma": gamma, "sigma": sigma}, "scale": "lamps"}


def errors(**parts):
    return {e["name"]: e["value"] for e in comparing.against_truth(**parts)[0]}


def labelled(**pixels):
    """A one-row image with so many pixels of each group, and its legend."""
    labels = np.concatenate([np.full(n, i + 1) for i, n in enumerate(pixels.values())]).astype(np.int32)[None]
    return {"group": labels}, {"groups": list(pixels), "objects": []}


def test_by_hand():
    """Two groups, one of them perfect: six channels, one off by 2 % = 0.01 = 10 sigma."""
    truth = materials({"wall": group([0.5, 0.5, 0.5]), "door": group([0.2, 0.3, 0.4])})
    found = materials({"wall": group([0.51, 0.5, 0.5], 0.001), "door": group([0.2, 0.3, 0.4], 0.003)}, gamma=2.03, sigma=0.01)
    images, legend = labelled(wall=500, door=700)
    e = errors(materials=found, truth=truth, true_images=images, true_legend=legend)
    assert e["reflectance.mean_relative"] == pytest.approx(0.02 / 6)
    assert e["reflectance.max_absolute"] == pytest.approx(0.01)
    assert e["reflectance.within_3_sigma"] == pytest.approx(5 / 6)
    assert e["reflectance.median_sigma"] == pytest.approx(0.002)
    assert e["reflectance.unidentified"] == 0 and e["reflectance.groups"] == 2
    assert e["gamma.absolute"] == pytest.approx(0.03) and e["gamma.in_sigmas"] == pytest.approx(3)


def test_what_is_counted():
    """499 pixels are too few, lamps and references are no findings; a group without a value counts as unidentified."""
    truth = materials({n: group([0.5] * 3) for n in ("wall", "book", "lamp", "card", "shelf")}, {"lamp": {"emittance": [4, 4, 4]}})
    found = materials({"wall": group([0.5] * 3), "book": group([0.9] * 3), "lamp": group([0.0] * 3), "card": group([0.6] * 3, 0), "shelf": group(None)},
                      {"lamp": {"emittance": [4, 4, 4], "sigma": None}})
    images, legend = labelled(wall=500, book=499, lamp=1000, card=1000, shelf=1000)
    parts = {"materials": found, "truth": truth, "true_images": images, "true_legend": legend}
    e = errors(**parts, reports={"fit": {"arguments": {"reference": {"card": [0.6] * 3}, "lamps": {"lamp": [4, 4, 4]}}}})
    assert e["reflectance.mean_relative"] == 0 and e["reflectance.groups"] == 2 and e["reflectance.unidentified"] == 1
    assert e["small.mean_relative"] == pytest.approx(0.8) and e["small.groups"] == 1
    assert not any(name.startswith("lamp.") for name in e)
    assert errors(**parts) == e                # without the fit's report a sigma of zero says the same


def test_only_unknown_lamps_count():
    truth = materials({}, {"a": {"emittance": [4, 4, 4]}, "b": {"emittance": [2, 2, 2]}})
    found = materials({}, {"a": {"emittance": [4.4, 4, 4], "sigma": [0.1] * 3}, "b": {"emittance": [1, 1, 1], "sigma": None}})
    e = errors(materials=found, truth=truth)
    assert e["lamp.max_relative"] == pytest.approx(0.1) and e["lamp.mean_relative"] == pytest.approx(0.1 / 3)


def test_a_channel_without_sigma_is_not_within_three_of_them():
    images, legend = labelled(wall=500)
    e = errors(materials=materials({"wall": group([0.51] * 3, None)}), truth=materials({"wall": group([0.5] * 3)}), true_images=images, true_legend=legend)
    assert e["reflectance.within_3_sigma"] == 0 and "reflectance.median_sigma" not in e


def test_black_has_no_relative_error():
    images, legend = labelled(wall=500)
    e = errors(materials=materials({"wall": group([0.01, 0, 0])}), truth=materials({"wall": group([0.0, 0, 0])}), true_images=images, true_legend=legend)
    assert "reflectance.mean_relative" not in e and e["reflectance.max_absolute"] == pytest.approx(0.01)


def test_differ_ignores_edges_and_the_order_of_names():
    truth = np.ones((6, 8), np.int32)
    truth[:, 4:] = 2
    ours = np.where(truth == 1, 2, 1)
    assert comparing.differ(ours, ["b", "a"], truth, ["a", "b"]) == (0, 0)
    ours[:, 4] = 2                             # one column moved: at the edge
    assert comparing.differ(ours, ["b", "a"], truth, ["a", "b"]) == (0, 6 / 48)
    ours[0, 0] = 0                             # nothing there, where truth has something
    inner, every = comparing.differ(ours, ["b", "a"], truth, ["a", "b"])
    assert inner == pytest.approx(1 / 36) and every == pytest.approx(7 / 48)
    checkers = np.indices((4, 4)).sum(0) % 2 + 1
    assert comparing.differ(checkers, ["a", "b"], checkers, ["a", "b"]) == (None, 0)


def test_edges_are_symmetric():
    """A lone pixel and its eight neighbours lie at an edge, nothing else."""
    truth = np.ones((7, 7), np.int32)
    truth[3, 3] = 2
    for y in range(7):
        for x in range(7):
            ours = truth.copy()
            ours[y, x] = 3 - ours[y, x]
            inner, _ = comparing.differ(ours, ["a", "b"], truth, ["a", "b"])
            assert (inner == 0) == (abs(y - 3) <= 1 and abs(x - 3) <= 1), (x, y)


def test_scorecard_has_a_row_for_every_stage_and_the_sum_of_times(tmp_path):
    reports = {"index": {"status": "complete", "cpu_s": 1, "wall_s": 2, "peak_mb": 10, "errors": []},
               "fit": {"status": "converged", "cpu_s": 0.5, "wall_s": 0.25, "peak_mb": 20, "errors": [{"name": "image", "value": 0.1, "unit": "1", "against": "photograph"}]},
               "render": {"status": "not converged", "cpu_s": 4, "wall_s": 4, "peak_mb": 5}}
    rows = comparing.scorecard("s", reports, [{"stage": "fit", "name": "gamma.absolute", "value": 0.01, "unit": "1", "against": "truth"}])
    comparing.write_scorecard(tmp_path / "s.csv", rows)
    text = (tmp_path / "s.csv").read_text().splitlines()
    assert text[0] == "scene,stage,error,value,unit,against,wall_s,cpu_s,peak_mb,status"
    assert [tuple(r[k] for k in ("stage", "error", "value", "status")) for r in csv.DictReader(text)] == [
        ("index", "", "", "complete"), ("fit", "image", "0.1", "converged"), ("fit", "gamma.absolute", "0.01", "converged"),
        ("render", "", "", "not converged"), ("total", "time.until_fit", "1.5", ""), ("total", "time.all", "5.5", "")]


@pytest.fixture
def checked(tmp_path):
    def call(bounds, values=(("fit", "gamma.absolute", 0.004), ("fit", "residual", 1e-9), ("render", "residual", 1e-3), ("fit", "void", None))):
        rows = [{"scene": "s", "stage": s, "error": n, "value": v} for s, n, v in values]
        comparing.write_scorecard(tmp_path / "scorecard.csv", rows)
        (tmp_path / "expected.csv").write_text("# why these bounds\nerror,low,high\n" + bounds)
        return comparing.check(tmp_path / "scorecard.csv", tmp_path / "expected.csv")
    return call


@pytest.mark.parametrize("bounds, lines, word", [
    ("gamma.absolute,0.001,0.01\n", 0, ""), ("gamma.absolute,0.004,0.004\n", 0, ""), ("gamma.absolute,0.001,0.003\n", 1, "above"),
    ("gamma.absolute,0.005,0.01\n", 1, "too good"), ("nothing,0,1\n", 1, "missing"), ("void,0,1\n", 1, "nothing"),
    ("residual,0,1e-6\n", 1, "render/residual"), ("fit/residual,0,1e-6\n", 0, ""), ("gamma.absolute,,0.01\n", 1, "not a range"),
    ("gamma.absolute,0.01,0.001\n", 1, "not a range"), ("gamma.absolute,nan,1\n", 1, "not a range"), ("gamma.absolute,0,inf\n", 1, "not a range")])
def test_bounds_hold_on_both_sides(checked, bounds, lines, word):
    violations = checked(bounds)
    assert len(violations) == lines and all(word in line and "\n" not in line for line in violations), violations


def test_a_table_without_its_columns_is_refused(tmp_path):
    (tmp_path / "e.csv").write_text("error,low\n")
    with pytest.raises(BadInput, match="high: the column is missing"):
        comparing.read_table(tmp_path / "e.csv", ("error", "low", "high"))


# ---- from outside ----

@pytest.fixture
def outputs(tmp_path):
    """A scene of two groups as the stages leave it, and its truth."""
    labels = np.repeat([[1, 2]], 30, axis=0).repeat(30, axis=1)
    for folder in (tmp_path / "build", tmp_path / "truth"):
        folder.mkdir()
        image.write_png16(folder / "group.png", labels)
        (folder / "legend.json").write_text(json.dumps({"groups": ["wall", "door"], "objects": ["room"], "facets": []}))
        (folder / "materials.json").write_text(json.dumps(materials({"wall": group([0.5] * 3), "door": group([0.25] * 3)}, sigma=0.01)))
    (tmp_path / "build/fit.report.json").write_text(json.dumps({"status": "converged", "cpu_s": 1, "wall_s": 1, "peak_mb": 1, "errors": []}))
    (tmp_path / "build/rendered.json").write_text(json.dumps({"rmse": 0.004, "ciede2000": 0.5, "groups": {}}))
    return tmp_path


def command(folder, **more):
    words = ["stages/compare.py", "--scene", "box", "--scorecard", folder / "out/scorecard.csv", "--comparison", folder / "out/compare.json",
             "--report", folder / "out/compare.report.json"]
    for option, value in more.items():
        words += [f"--{option}", value]
    return words


def test_from_outside(run, outputs):
    b = outputs / "build"
    result = run(*command(outputs, reports=b / "fit.report.json", materials=b / "materials.json", group=b / "group.png", legend=b / "legend.json",
                          scores=b / "rendered.json", truth=f"{outputs}/truth/"))
    assert result.returncode == 0, result.stderr
    rows = {r["error"]: r for r in csv.DictReader((outputs / "out/scorecard.csv").read_text().splitlines())}
    assert rows["reflectance.mean_relative"]["value"] == "0" and rows["reflectance.mean_relative"]["stage"] == "fit"
    assert rows["index.differ"]["value"] == "0" and rows["render.rmse"]["value"] == "0.004"
    assert json.loads((outputs / "out/compare.json").read_text())["groups"]["wall"]["counted"] is True


def test_without_truth_or_anything_there_is_still_a_scorecard(run, outputs):
    assert run(*command(outputs)).returncode == 0
    assert (outputs / "out/scorecard.csv").read_text().count("\n") == 1


def test_another_size_is_said_and_left_out(run, outputs):
    image.write_png16(outputs / "truth/group.png", np.ones((5, 5), int))
    result = run(*command(outputs, group=outputs / "build/group.png", legend=outputs / "build/legend.json", truth=outputs / "truth"))
    assert result.returncode == 0 and "5 x 5 is not the size" in result.stderr
    assert "index.differ" not in (outputs / "out/scorecard.csv").read_text()


@pytest.mark.parametrize("file, content, line", [
    ("truth/materials.json", '{"groups": {"wall": {"rho_d": [1, 2]}}}', "groups.wall.rho_d = [1, 2] is neither null nor three numbers"),
    ("truth/materials.json", "{", "not readable JSON"), ("truth/legend.json", '{"groups": 3}', "groups: missing, or not a list of names"),
    ("truth/legend.json", '{"groups": ["wall"], "objects": []}', "index: 2 is more than the 1 groups of the legend"),
    ("truth/group.png", "", "the file is empty")])
def test_bad_input_is_one_line(refuses, files_under, outputs, file, content, line):
    (outputs / file).write_text(content)
    before = files_under(outputs)
    b = outputs / "build"
    lines = refuses(*command(outputs, materials=b / "materials.json", group=b / "group.png", legend=b / "legend.json", truth=outputs / "truth"))
    assert any(line in text and str(outputs / "truth") in text for text in lines), lines
    assert files_under(outputs) == before
