"""The page is one file, shows only what there is, escapes everything, and holds no NaN."""
import copy
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from lib import image, ladder_page, page, textures
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
                "arguments": {"lamps": {"lamp": [4, 4, 4]}, "materials": "m.json", "report": None}, "versions": {"numpy": "2.0"}, "inputs": {"gather.npz": "0" * 64},
                "ladder": {"threshold": 0.0125, "diffuse": {"wall": 0.004, "card": 0.01}, "rays": {}, "rounds": 0}},
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


def texture(facet=7, nu=4, nv=2):
    """0.6 m wide and 0.2 m high, brighter to the right in R and upwards in G; its left half is not told by the photograph."""
    u, v = (np.arange(n, dtype=float) / (n - 1) for n in (nu, nv))
    albedo = np.stack([np.broadcast_to(u[:, None], (nu, nv)), np.broadcast_to(v, (nu, nv)), np.zeros((nu, nv))], axis=2).astype(np.float32)
    ones = np.ones((nu, nv), np.float32)
    return textures.Texture(facet, albedo, np.where(u[:, None] < 0.5, 0, ones).astype(np.float32), 0 * ones, ones, np.full(3, 0.4), np.array([[1, 1, 1], [1.6, 1, 1], [1, 1, 1.2]]), 0)


def climbed():
    """Everything, and a group on each kind of rung; the shelf lacked only the light of the mirror."""
    parts = everything()
    groups, fit = parts.materials["groups"], parts.reports["fit"]
    def up(rung, sigma=None, **more):
        tried = [{"rung": r, "excess": 0.1 / (i + 1), "diffuse": 0.14} for i, r in enumerate(ladder_page.RUNGS[1:ladder_page.RUNGS.index(rung) + 1])]
        return copy.deepcopy(groups["wall"]) | {"kind": "glossy" if rung == "anisotropic" else rung, "sigma": {"rho_d": [0.001] * 3} | (sigma or {}),
                                                "ladder": {"rung": rung, "why": "off by 0.1387 beyond noise as diffuse; rho_s = 0.9, 0.8, 0.5 is not 1", "tried": tried}} | more
    groups |= {"glass": up("mirror", {"rho_d": [0, 0, 0], "rho_s": [0, 0, 0]}, rho_d=[0.0] * 3, rho_s=[1.0, 1.0, 1.0]),
               "brass": up("coloured_mirror", {"rho_d": [0, 0, 0], "rho_s": [0.002, 0.003, 0.004]}, rho_d=[0.0] * 3, rho_s=[0.9, 0.8, 0.5]),
               "tin": up("glossy", {"rho_s": [0.002] * 3, "alpha": [0.001] * 2}, rho_s=[0.3] * 3, alpha=[0.05, 0.05]),
               "steel": up("anisotropic", {"rho_s": [0.002] * 3, "alpha": [0.01, 0.004], "tangent_rad": 0.02}, rho_s=[0.4] * 3, alpha=[0.28, 0.07], tangent=[0.8, 0.6, 0.0]),
               "print": up("textured", texture={"7": "texture-7.exr"}), "shelf": copy.deepcopy(groups["wall"]), "books": copy.deepcopy(groups["wall"]) | {"pixels": 0}}
    before = {name: 0.14 for name in ("glass", "brass", "tin", "steel", "print")} | {"wall": 0.004, "card": 0.01, "shelf": 0.02}
    fit["ladder"] |= {"diffuse": before, "end": before | {name: 0.003 for name in ("glass", "brass", "tin", "steel", "print", "shelf")}, "rounds": 4,
                      "rays": {"camera rays to mirrors": 40782, "rays in lobes": 3210600, "mirrored lamps": 1},
                      "rungs": {name: groups[name]["ladder"]["rung"] for name in ("glass", "brass", "tin", "steel", "print")}}
    parts.textures = {"print": {7: ladder_page.thumbnail(texture())}}
    deviation = lambda truth, *z: {"truth": truth, "value": truth, "absolute": [0.01] * len(truth), "relative": [0.1] * len(truth), "in_sigmas": list(z)}
    parts.comparison["groups"] |= {"brass": {"kind": ["coloured_mirror", "mirror"], "rho_s": deviation([0.91, 0.8, 0.5], 5.0, 0.1, 0.1)},
                                   "steel": {"kind": ["glossy", "glossy"], "rho_s": deviation([0.4] * 3, 0.2, 0.2, 0.2), "alpha": deviation([0.28, 0.07], 1.0, None),
                                             "tangent": {"truth": [0.8, 0.6, 0.0], "value": [0.8, 0.6, 0.0], "degrees": [1.25], "sigma": 1.1, "in_sigmas": [1.1]}}}
    parts.comparison["textures"] = {"print": {"rmse": 0.021, "pixels": 1253}}
    return parts


SECTIONS = ("Difference", "Materials", "How each surface reflects", "Light and camera", "Transfer models compared", "What each pixel shows", "Convergence", "Time", "Warnings", "How it was made")


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


@pytest.mark.parametrize("make", [everything, climbed])
@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, 1e-300])
def test_numbers_of_any_kind(bad, make):
    """No file of ours holds such a number; yet a page with NaN on it would be the last to say so."""
    parts = make()
    for name in ("materials", "scores", "comparison", "reports"):
        setattr(parts, name, _walk(getattr(parts, name), lambda v: bad if isinstance(v, float) else v))
    sane(page.build(parts))
    if not np.isfinite(bad):
        parts.photograph = np.full_like(parts.photograph, bad)
        parts.depth = np.full(parts.depth.shape, bad)
        sane(page.build(parts))


@pytest.mark.parametrize("make", [everything, climbed])
def test_text_is_escaped(make):
    parts = make()
    for name in ("materials", "scores", "comparison", "reports", "legend"):
        value = _walk(getattr(parts, name), lambda v: NASTY if isinstance(v, str) and v not in ("gamma", "converged", "lamps") else v)
        if name in ("materials", "scores", "comparison"):
            value["groups"] = {NASTY + k: v for k, v in value["groups"].items()}
            parts.textures = {NASTY + k: v for k, v in (parts.textures or {}).items()}
        if name == "reports":
            value = {k + NASTY if k != "fit" else k: v for k, v in value.items()}
            for key, names in value["fit"]["ladder"].items():
                if isinstance(names, dict):
                    value["fit"]["ladder"][key] = {NASTY + k: v for k, v in names.items()}
        setattr(parts, name, value)
    parts.scene, parts.plan = NASTY, [(NASTY, NASTY)]
    seen = sane(page.build(parts))
    assert NASTY in seen


# ---- the ladder ----

def ladder_of(parts):
    """The section alone: its HTML and its visible text, on one line."""
    found = re.search(r'<section id="ladder">.*?</section>', page.build(parts), re.DOTALL)
    return (found[0], " ".join(sane(f"<style></style><script></script>{found[0]}").split())) if found else ("", "")


def test_where_nothing_climbs_it_cost_nothing():
    text, seen = ladder_of(everything())
    assert "The threshold is 1.25 % of full scale beyond noise. Every group is diffuse within the threshold; no mirror buffer, no lobe and no texture was computed (0 rays)." in seen
    assert "card 1.00 %" in seen and "wall 0.40 %" in seen and 'width:80%' in text and "<article>" not in text and "What that cost" not in seen
    assert "not diffuse" not in page.verdict(everything())[2]


def test_every_rung_is_shown_with_what_it_found():
    text, seen = ladder_of(climbed())
    for words in ("5 of 11 groups climbed. Once that is in the balance, shelf is diffuse within the threshold.", "glass perfect mirror", "brass coloured mirror in truth mirror", "tin glossy",
                  "steel glossy, anisotropic", "print textured", "14.0 % → 0.30 %", "1 all light, as the word says", "R 0.9000 ± 0.0020 truth 0.9100 5.0 σ", "0.3000 ± 0.0020",
                  "x 0.2800 ± 0.0100 truth 0.2800 1.0 σ", "y 0.0700 ± 0.0040 truth 0.0700 +0.0100", "(0.80, 0.60, 0.00) ± 1.15° truth (0.80, 0.60, 0.00) 1.2° off",
                  "Off by 13.9 % beyond noise as diffuse; ρₛ = 0.9, 0.8, 0.5 is not 1.", "facet 7, 0.6 × 0.2 m, 50 % of it told by the photograph",
                  "The albedo is off the truth by 2.1 % rms, over the 1,253 pixels that show it.", "shelf 2.0 % → 0.30 %", "Seen only by way of a mirror, and taken for diffuse: books.",
                  "rays in lobes 3,210,600", "camera rays to mirrors 40,782", "mirrored lamps 1"):
        assert words in seen, (words, seen)
    assert text.count("<article>") == 5 and text.count('class="reached"') == 5 and 'class="off">5.0 σ' in text
    assert "not diffuse: 1 mirror, 1 coloured mirror, 2 glossy, 1 textured;" in page.verdict(climbed())[2]


@pytest.mark.parametrize("told, words", [
    ({"surfaces": {"wall": "diffuse"}}, "No group climbed; no mirror buffer, no lobe and no texture was computed (0 rays)."), ({"reference": {"wall": [0.7, 0.6, 0.5]}}, "given as a reference")])
def test_what_scene_yaml_says_is_not_called_a_finding(told, words):
    parts = everything()
    parts.reports["fit"]["arguments"] |= told
    parts.reports["fit"]["ladder"]["diffuse"]["wall"] = 0.05
    text, seen = ladder_of(parts)
    assert words in seen and 'class="over"' in text and "Every group is diffuse" not in seen
    assert ("named diffuse in scene.yaml" in seen) is ("surfaces" in told)


def test_what_no_rung_explains_is_said_with_its_price():
    parts = everything()
    parts.reports["fit"]["ladder"] |= {"diffuse": {"wall": 0.015, "card": 0.001}, "end": {"wall": 0.015, "card": 0.001}, "rays": {"rays in lobes": 77}, "rungs": {}}
    text, seen = ladder_of(parts)
    assert "No group climbed: no mirror, lobe or texture explains what wall lacks." in seen and "rays in lobes 77" in seen and "0 rays" not in seen


def test_a_mirror_without_the_report_of_the_fit():
    """materials.json may be given: what it says is shown, what nobody measured is not."""
    parts = climbed()
    parts.reports = {}
    text, seen = ladder_of(parts)
    assert "5 of 11 groups climbed." in seen and "threshold" not in seen and "0 rays" not in seen and "What that cost" not in seen
    parts = everything()
    del parts.reports["fit"]["ladder"]                        # method: paper
    assert ladder_of(parts) == ("", "")


def test_a_mirror_is_not_taken_for_a_reference():
    """Both have a rho_d of which nothing is uncertain."""
    seen = sane(page.build(climbed()))
    assert "coloured mirror, identified" in seen and seen.count("given as a reference") == 1


def test_a_thumbnail_stands_as_the_facet_is_seen_from_its_front():
    thumb = ladder_page.thumbnail(texture(nu=120, nv=40), largest=60)
    picture = thumb["picture"].astype(int)
    assert picture.shape == (20, 60, 3) and thumb["size_m"] == pytest.approx([0.6, 0.2]) and thumb["known"] == pytest.approx(0.5)
    assert (np.diff(picture[..., 0], axis=1) >= 0).all() and picture[0, -1, 0] > 250 and picture[0, 0, 0] < 30             # axis 0 to the right
    assert (np.diff(picture[..., 1], axis=0) <= 0).all() and picture[0, 0, 1] > 240 and picture[-1, 0, 1] < 50             # axis 1 upwards
    one = textures.Texture(0, np.full((1, 1, 1), 0.5, np.float32), *(np.ones((1, 1), np.float32),) * 3, np.full(1, 0.5), np.zeros((3, 3)), 0)
    assert ladder_page.thumbnail(one)["picture"].shape[2] == 3                                                             # one channel, and no size


def test_large_albums_show_the_largest():
    parts = climbed()
    parts.textures = {"print": {f: ladder_page.thumbnail(texture(f)) | {"size_m": [f, 1.0]} for f in range(1, 10)}}
    text, seen = ladder_of(parts)
    assert text.count("<figure>") == 6 and "facet 9, 9 × 1 m" in seen and "facet 3," not in seen and "3 smaller ones are not shown." in seen


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


def test_textures_are_read_from_beside_the_materials(run, outputs):
    parts = climbed()
    textures.write(outputs, texture())
    (outputs / "materials.json").write_text(json.dumps(parts.materials))
    (outputs / "fit.report.json").write_text(json.dumps(parts.reports["fit"]))
    result = run(*command(outputs, materials=outputs / "materials.json", reports=[outputs / "fit.report.json"]))
    assert result.returncode == 0, result.stderr
    text = (outputs / "report.html").read_text(encoding="utf-8")
    assert "facet 7, 0.6 × 0.2 m" in sane(text) and 'class="albums"' in text
    assert str(outputs / "texture-7.exr") in json.loads((outputs / "report.report.json").read_text())["inputs"]


def test_a_texture_that_is_not_there_is_one_line(refuses, outputs):
    (outputs / "materials.json").write_text(json.dumps(climbed().materials))
    assert refuses(*command(outputs, materials=outputs / "materials.json")) == [f"report.py: {outputs}/texture-7.json: there is no such file"]
    assert not (outputs / "report.html").exists()


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
