"""The page is one file, shows only what there is, escapes everything, and holds no NaN."""
import copy
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from lib import image, page
from lib.page import Parts

NASTY = '<script>alert("x")</script>&\'"'
VOID = {"meta", "img", "input", "br", "line", "circle", "polyline", "polygon", "rect", "link", "hr"}


class Reader(HTMLParser):
    """Tags must nest; collects attributes and the text outside scripts and styles."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.text, self.tags = [], [], [], []
        self.feed(text)
        self.close()
        assert not self.open, self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, k, v or "") for k, v in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, k, v or "") for k, v in attrs]

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, (tag, self.open[-3:], self.getpos())

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("script", "style"):
            self.text.append(data)


def sane(text):
    """What must hold of every page; returns its visible text."""
    reader = Reader(text)
    for tag, name, value in reader.attributes:
        if name in ("src", "srcset", "href", "data", "poster", "action", "xlink:href"):
            assert value.startswith("data:"), (tag, name, value[:80])
        assert not name.startswith("on") or tag == "none", (tag, name)
        if name in ("points", "x", "y", "x1", "x2", "y1", "y2", "cx", "cy", "r", "viewbox", "width", "height"):
            assert not re.search(r"nan|inf", value, re.IGNORECASE), (tag, name, value)
    assert not set(reader.tags) & {"link", "iframe", "object", "embed", "base"}
    style = re.search(r"<style>(.*?)</style>", text, re.DOTALL)[1]
    assert "url(" not in style and "@import" not in style
    assert not re.search(r"fetch|XMLHttpRequest|import\(", re.findall(r"<script>(.*?)</script>", text, re.DOTALL)[-1])
    assert text.count("<script>") == 1 and text.count("</script>") == 1
    seen = " ".join(reader.text)
    bad = re.search(r".{0,30}\b(nan|NaN|inf|Infinity|None|null|True|False)\b", seen)
    assert not bad, bad
    assert len(text.encode()) < 6_000_000
    return seen


def everything(height=48, width=64, channels=3):
    rng = np.random.default_rng(1)
    photo = np.clip(np.linspace(0.1, 0.9, width)[None, :, None] + 0.02 * rng.standard_normal((height, width, channels)), 0, 1)
    labels = np.ones((height, width), np.int32)
    labels[:, width // 2:] = 2
    labels[:5] = 3
    labels[:2, :2] = 0
    def group(rho, **more):
        return {"kind": "diffuse", "rho_d": rho, "rho_s": [0, 0, 0], "alpha": None, "tangent": None, "texture": None, "assumed": None,
                "sigma": {"rho_d": [0.001, 0.002, 0.003]}, "pixels": 900, "error": 0.004, "identified": True} | more
    groups = {"wall": group([0.7, 0.6, 0.5]), "card": group([0.5] * 3, sigma={"rho_d": [0, 0, 0]}),
              "back": group(None, identified=False, assumed=[0.4, 0.41, 0.42], pixels=0, error=None, sigma={"rho_d": None}),
              "dark": group(None, identified=False, pixels=30, error=None, sigma=None)}
    reports = {
        "index": {"status": "complete", "cpu_s": 0.3, "wall_s": 0.4, "peak_mb": 200.5, "imports_s": 0.5, "warnings": ["a facet is not planar"], "errors": [], "trace": []},
        "fit": {"status": "converged", "cpu_s": 0.9, "wall_s": 0.5, "peak_mb": 300, "imports_s": 0.5, "compile_s": 1.0, "warnings": [],
                "errors": [{"name": "image.rmse", "value": 0.003, "unit": "display", "against": "photograph"}, {"name": "empty", "value": None, "unit": None, "against": None}],
                "trace": [{"cpu_s": t, "wall_s": t, "iteration": i, "image_rmse": 0.2 / (i + 1) ** 3, "gamma": 2 + 0.1 / (i + 1), "places": i} for i, t in enumerate((0.0, 0.1, 0.5, 0.9))],
                "arguments": {"lamps": {"lamp": [4, 4, 4]}, "materials": "m.json", "report": None}, "versions": {"numpy": "2.0"}, "inputs": {"gather.npz": "0" * 64}},
        "render": {"status": "complete", "cpu_s": 3, "wall_s": 2, "peak_mb": 100, "trace": [{"cpu_s": 1.0, "rmse": 0.1}],
                   "transfer_models": [{"kind": "gamma", "rmse": 0.004, "rmse_rescaled": 0.003, "note": "own"}, {"kind": "histogram", "rmse": 0.01, "note": ""}]}}
    truth = {"groups": {"wall": {"pixels": 900, "given": False, "identified": True, "counted": True, "rho_d": {
        "truth": [0.71, 0.6, 0.0], "value": [0.7, 0.6, 0.5], "sigma": [0.001, 0.002, 0.003], "absolute": [-0.01, 0, 0.5], "relative": [-0.014, 0, None], "in_sigmas": [-10, 0, None]}}},
        "transfer": {"value": {}, "truth": {"kind": "gamma", "gamma": 2.0, "sigma": None}},
        "lamps": {"spot": {"given": False, "truth": [2.1, 2.0, 2.0], "value": [2, 2, 2], "sigma": [0.1, 0.1, 0.1], "relative": [-0.05, 0, 0]}},
        "errors": [{"stage": "fit", "name": "reflectance.mean_relative", "value": 0.002, "unit": "1", "against": "truth"},
                   {"stage": "fit", "name": "reflectance.max_absolute", "value": 0.01, "unit": "1", "against": "truth"}]}
    return Parts(scene="attic", photograph=photo, rendered=np.clip(photo + 0.01, 0, 1), group=labels, object=labels, facet=labels, hidden=labels == 2, trusted=labels == 1,
                 depth=labels * 1.5, legend={"groups": ["wall", "card", "lamp"], "objects": ["a", "b", "c"], "facets": []},
                 materials={"status": "converged", "groups": groups, "scale": "lamps", "image": {"rmse": 0.003, "iterations": 4},
                            "lamps": {"lamp": {"emittance": [4, 4, 4], "sigma": None}, "spot": {"emittance": [2, 2, 2], "sigma": [0.1, 0.1, 0.1]}},
                            "transfer": {"kind": "gamma", "gamma": 2.004, "sigma": 0.003}},
                 scores={"rmse": 0.007, "ciede2000": 0.4, "groups": {"wall": {"rmse": 0.01, "ciede2000": 1}, "card": {"rmse": None, "ciede2000": None}}},
                 comparison=truth, reports=reports, plan=[("segment", "no goal needs it")])


SECTIONS = ("Difference", "Materials", "Light and camera", "Transfer models compared", "What each pixel shows", "Convergence", "Time", "Warnings", "How it was made")


def test_everything():
    text = page.build(everything())
    seen = sane(text)
    for title in SECTIONS:
        assert f"<h2>{title}</h2>" in text
    assert "agrees with the photograph to 0.70 % of full scale; 2 of 4 groups identified; gamma 2.004 ± 0.003." in seen
    for words in ("never seen; assumed from the other groups", "none of its 30 pixels can be trusted; no value", "given as a reference", "no goal needs it", "0.20 %",
                  "a facet is not planar", "−1.40 %, 10.0 σ"):
        assert words in seen, words
    assert 'class="off"' in text and 'type="range"' in text and "aria-label" in text


def test_nothing():
    text = page.build(Parts())
    assert "Nothing to report" in sane(text) and "<h2>" not in text


@pytest.mark.parametrize("missing", [name for name in Parts.__dataclass_fields__ if name not in ("scene", "linear")])
def test_each_part_may_be_missing(missing):
    parts = everything()
    setattr(parts, missing, {"reports": {}, "plan": []}.get(missing))
    sane(page.build(parts))


@pytest.mark.parametrize("only", [name for name in Parts.__dataclass_fields__ if name not in ("scene", "linear")])
def test_each_part_may_be_alone(only):
    sane(page.build(Parts(**{only: getattr(everything(), only)})))


def _walk(value, change):
    if isinstance(value, dict):
        return {k: _walk(v, change) for k, v in value.items()}
    if isinstance(value, list):
        return [_walk(v, change) for v in value]
    return change(value)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300])
def test_numbers_of_any_kind(bad):
    """No file of ours holds such a number; yet a page with NaN on it would be the last to say so."""
    parts = everything()
    for name in ("materials", "scores", "comparison", "reports"):
        setattr(parts, name, _walk(getattr(parts, name), lambda v: bad if isinstance(v, float) else v))
    sane(page.build(parts))
    if not np.isfinite(bad):
        parts.photograph = np.full_like(parts.photograph, bad)
        parts.depth = np.full(parts.depth.shape, bad)
        sane(page.build(parts))


def test_text_is_escaped():
    parts = everything()
    for name in ("materials", "scores", "comparison", "reports", "legend"):
        value = _walk(getattr(parts, name), lambda v: NASTY if isinstance(v, str) and v not in ("gamma", "converged", "lamps") else v)
        if name in ("materials", "scores", "comparison"):
            value["groups"] = {NASTY + k: v for k, v in value["groups"].items()}
        if name == "reports":
            value = {k + NASTY if k != "fit" else k: v for k, v in value.items()}
        setattr(parts, name, value)
    parts.scene, parts.plan = NASTY, [(NASTY, NASTY)]
    seen = sane(page.build(parts))
    assert NASTY in seen


def test_one_channel():
    parts = everything(channels=1)
    for g in parts.materials["groups"].values():
        for key in ("rho_d", "assumed"):
            g[key] = [g[key][0]] * 3 if g[key] else None
    text = page.build(parts)
    sane(text)
    assert "ρ R" not in text and 'data-label="ρ"' in text


def test_sizes_that_do_not_match():
    parts = everything()
    parts.rendered, parts.trusted = parts.rendered[:20], parts.trusted[:10]
    text = page.build(parts)
    sane(text)
    assert "<h2>Difference</h2>" not in text


def test_large_noisy_pictures_stay_below_the_limit():
    rng = np.random.default_rng(2)
    photo = rng.random((1200, 1800, 3))
    text = page.build(Parts(photograph=photo, rendered=1 - photo, facet=rng.integers(0, 60000, (1200, 1800)).astype(np.int32)))
    sane(text)
    assert "<h2>Difference</h2>" in text


@pytest.mark.parametrize("status, badge", [("converged", "good"), ("not converged", "warn"), ("nothing seen", "bad")])
def test_the_badge_says_what_came_out(status, badge):
    parts = everything()
    parts.materials["status"] = status
    assert page.verdict(parts)[0] == badge
    parts = everything()
    parts.reports["render"]["status"] = "not converged"
    assert page.verdict(parts)[0] == "warn" and "render" in page.verdict(parts)[2]


def test_difference_scale_is_round_and_keeps_the_sign():
    photo = np.full((10, 10, 3), 0.5)
    signed, half = page.difference(photo, photo + np.array([0.01, -0.03, 0.0]))
    assert np.allclose(signed, -0.03) and half == pytest.approx(0.05)
    assert page.difference(photo, photo)[1] > 0
    darker, equal, brighter = page.diverging(np.array([-1.0, 0, 1.0]), 0.5).astype(int)
    assert darker[2] > darker[0] and brighter[0] > brighter[2] and np.ptp(equal) < 10


def test_colours_differ():
    some = page.colours(40).astype(int)
    assert min(np.abs(a - b).max() for i, a in enumerate(some[:16]) for b in some[:i]) > 12
    assert page.colours(0).shape == (0, 3)


@pytest.mark.parametrize("low, high, log", [(0, 1, False), (1.9, 2.4, False), (-3, 0.5, True), (0.26, 0.31, True), (-9, 9, True), (-0.1, 0.1, False), (1e6, 1e6 + 1, False)])
def test_ticks_lie_inside_and_are_few(low, high, log):
    ticks = page._ticks(low, high, log)
    assert 2 <= len(ticks) <= 14 and all(low - 1e-6 <= v <= high + 1e-6 for v, _ in ticks)
    assert len({label for _, label in ticks}) == len(ticks)


# ---- from outside ----

@pytest.fixture
def outputs(tmp_path):
    parts = everything()
    for name in ("photograph", "rendered"):
        image.write_png8(tmp_path / f"{name}.png", (getattr(parts, name) * 255).round().astype(np.uint8))
    for name in ("group", "object", "facet"):
        image.write_png16(tmp_path / f"{name}.png", getattr(parts, name))
    for name in ("hidden", "trusted"):
        image.write_png8(tmp_path / f"{name}.png", getattr(parts, name))
    image.write_exr(tmp_path / "depth.exr", parts.depth, name="Z")
    for name in ("legend", "materials", "scores", "comparison"):
        (tmp_path / f"{name}.json").write_text(json.dumps(getattr(parts, name)))
    for name, report in parts.reports.items():
        (tmp_path / f"{name}.report.json").write_text(json.dumps(report))
    (tmp_path / "plan.mk").write_text("# Written by lib/plan.py; do not edit.\n# attic: index -> fit\n#   without segment: no goal needs it\n\nSHELL := bash\n#   without x: y\n")
    return tmp_path


def command(folder, **more):
    words = ["stages/report.py", "--scene", "attic", "--page", folder / "report.html", "--report", folder / "report.report.json"]
    for option, value in more.items():
        words += [f"--{option}", *(value if isinstance(value, list) else [value])]
    return words


def test_from_outside(run, outputs):
    files = {n: outputs / f"{n}.png" for n in ("photograph", "rendered", "group", "object", "facet", "hidden", "trusted")}
    files |= {n: outputs / f"{n}.json" for n in ("legend", "materials", "scores", "comparison")} | {"depth": outputs / "depth.exr"}
    result = run(*command(outputs, **files, reports=[outputs / f"{n}.report.json" for n in ("index", "fit", "render")], transfer='"gamma"'))
    assert result.returncode == 0, result.stderr
    text = (outputs / "report.html").read_text(encoding="utf-8")
    seen = sane(text)
    assert all(f"<h2>{title}</h2>" in text for title in SECTIONS)
    assert "no goal needs it" in seen and "without x" not in seen


def test_a_linear_photograph_is_shown_in_display_values(run, outputs):
    image.write_exr(outputs / "left.exr", np.full((8, 8, 3), 4.0))
    assert run(*command(outputs, photograph=outputs / "left.exr")).returncode == 0
    sane((outputs / "report.html").read_text(encoding="utf-8"))


def test_without_anything_there_is_still_a_page(run, tmp_path):
    assert run(*command(tmp_path)).returncode == 0
    sane((tmp_path / "report.html").read_text(encoding="utf-8"))


def test_bad_input_is_one_line(refuses, files_under, outputs):
    (outputs / "materials.json").write_text('{"groups": {"wall": {"rho_d": "white"}}}')
    before = files_under(outputs)
    lines = refuses(*command(outputs, materials=outputs / "materials.json"))
    assert len(lines) == 1 and "groups.wall.rho_d = 'white'" in lines[0]
    assert files_under(outputs) == before
