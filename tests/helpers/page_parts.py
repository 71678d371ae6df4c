"""What a page is made of, by hand: JSON as in the files, so that a test can change any of it; `parts_of` reads it."""

import copy

import numpy as np

from lib.core import record
from lib.given.kinds import ORDER
from lib.given.materials import Materials
from lib.picture.albedo_maps import AlbedoMap
from lib.verdict import records, stage_reports
from lib.verdict.comparison import Comparison
from lib.verdict.page import ladder
from lib.verdict.page.parts import Parts

RECORDS = {"legend": records.Legend, "materials": Materials, "scores": records.Scores, "comparison": Comparison}


def parts_of(files) -> Parts:
    """files : {field of Parts: its value, or JSON of its file}"""
    read = {name: record.of(files[name], f"{name}.json", cls) for name, cls in RECORDS.items() if name in files}
    reports = {stage: stage_reports.of(content, stage) for stage, content in files.get("reports", {}).items()}
    return Parts(**{**files, **read, "reports": reports})


def pictures(height=48, width=64, channels=3):
    """Photograph, re-rendering, index buffers of three groups."""
    rng = np.random.default_rng(1)
    slope = np.linspace(0.1, 0.9, width)[None, :, None]
    photograph = np.clip(slope + 0.02 * rng.standard_normal((height, width, channels)), 0, 1)
    labels = np.ones((height, width), np.int32)
    labels[:, width // 2 :] = 2
    labels[:5] = 3
    labels[:2, :2] = 0
    return {
        "photograph": photograph,
        "rendered": np.clip(photograph + 0.01, 0, 1),
        **dict.fromkeys(("group", "object", "facet"), labels),
        "hidden": labels == 2,
        "trusted": labels == 1,
        "depth": labels * 1.5,
        "legend": {"groups": ["wall", "card", "lamp"], "objects": ["a", "b", "c"], "facets": []},
    }


def group(rho, **more):
    """Of materials.json."""
    return {
        "kind": "diffuse",
        "rho_d": rho,
        "rho_s": [0, 0, 0],
        "alpha": None,
        "tangent": None,
        "texture": None,
        "assumed": None,
        "sigma": {"rho_d": [0.001, 0.002, 0.003]},
        "pixels": 900,
        "error": 0.004,
        "identified": True,
    } | more


def materials():
    """A group of each state, a given and an unknown lamp."""
    return {
        "status": "converged",
        "groups": {
            "wall": group([0.7, 0.6, 0.5]),
            "card": group([0.5] * 3, sigma={"rho_d": [0, 0, 0]}),
            "back": group(None, identified=False, assumed=[0.4, 0.41, 0.42], pixels=0, error=None, sigma=None),
            "dark": group(None, identified=False, pixels=30, error=None, sigma=None),
        },
        "scale": "lamps",
        "image": {"rmse": 0.003, "iterations": 4},
        "lamps": {
            "lamp": {"emittance": [4, 4, 4], "sigma": None},
            "spot": {"emittance": [2, 2, 2], "sigma": {"emittance": [0.1, 0.1, 0.1]}},
        },
        "transfer": {"kind": "gamma", "gamma": 2.004, "sigma": 0.003},
    }


def comparison():
    """The wall is off by 10 sigma in R, and black in truth in B."""
    wall = {
        "truth": [0.71, 0.6, 0.0],
        "value": [0.7, 0.6, 0.5],
        "sigma": [0.001, 0.002, 0.003],
        "absolute": [-0.01, 0, 0.5],
        "relative": [-0.014, 0, None],
        "in_sigmas": [-10, 0, None],
    }
    spot = {"truth": [2.1, 2.0, 2.0], "value": [2, 2, 2], "sigma": [0.1, 0.1, 0.1], "relative": [-0.05, 0, 0]}
    return {
        "groups": {"wall": {"pixels": 900, "given": False, "identified": True, "counted": True, "rho_d": wall}},
        "transfer": {"value": {}, "truth": {"kind": "gamma", "gamma": 2.0, "sigma": None}},
        "lamps": {"spot": {"given": False} | spot},
        "errors": [
            {"stage": "fit", "name": "reflectance.mean_relative", "value": 0.002, "unit": "1", "against": "truth"},
            {"stage": "fit", "name": "reflectance.max_absolute", "value": 0.01, "unit": "1", "against": "truth"},
        ],
    }


def reports():
    """Of three stages: nothing climbs the ladder."""
    apart = {"imports_s": 0.5, "imports_wall_s": 0.6, "compile_s": 1.0, "compile_wall_s": 1.1}
    point = {"cpu_s": 1.0, "rmse": 0.1}
    trace = [
        {
            "cpu_s": t,
            "wall_s": t,
            "iteration": i,
            "image_rmse": 0.2 / (i + 1) ** 3,
            "gamma": 2 + 0.1 / (i + 1),
            "places": i,
        }
        for i, t in enumerate((0.0, 0.1, 0.5, 0.9))
    ]
    return {
        "index": {"status": "complete", "cpu_s": 0.3, "wall_s": 0.4, "warnings": ["a facet is not planar"]},
        "fit": {
            "status": "converged",
            **{"cpu_s": 0.9, "wall_s": 0.5, "peak_mb": 300},
            **apart,
            "errors": [
                {"name": "image.rmse", "value": 0.003, "unit": "display", "against": "photograph"},
                {"name": "empty", "value": None, "unit": None, "against": None},
            ],
            "trace": trace,
            "arguments": {"lamps": {"lamp": [4, 4, 4]}, "materials": "m.json", "report": None},
            "versions": {"numpy": "2.0"},
            "inputs": {"gather.npz": "0" * 64},
            "ladder": {"threshold": 0.0125, "diffuse": {"wall": 0.004, "card": 0.01}, "rays": {}, "rounds": 0},
        },
        "render": {
            "status": "complete",
            **{"cpu_s": 3, "wall_s": 2, "peak_mb": 100},
            "trace": [point],
            "transfer_models": [
                {"kind": "gamma", "rmse": 0.004, "rmse_refitted": 0.003, "note": "own"},
                {"kind": "histogram", "rmse": 0.01, "note": ""},
            ],
        },
    }


def everything(**options):
    """A page with every section of the photometric half."""
    return {
        "scene": "attic",
        **pictures(**options),
        "materials": materials(),
        "scores": {
            "rmse": 0.007,
            "ciede2000": 0.4,
            "groups": {"wall": {"rmse": 0.01, "ciede2000": 1}, "card": {"rmse": None, "ciede2000": None}},
        },
        "comparison": comparison(),
        "reports": reports(),
        "plan": [("segment", "no goal needs it")],
    }


# ---- a page where groups climbed the ladder ----


def texture(facet=7, nu=4, nv=2):
    """0.6 m wide and 0.2 m high, brighter to the right in R and upwards in G; the photograph tells its right half."""
    u, v = (np.arange(n, dtype=float) / (n - 1) for n in (nu, nv))
    channels = [np.broadcast_to(u[:, None], (nu, nv)), np.broadcast_to(v, (nu, nv)), np.zeros((nu, nv))]
    ones = np.ones((nu, nv), np.float32)
    return AlbedoMap(
        facet,
        np.stack(channels, axis=2).astype(np.float32),
        np.where(u[:, None] < 0.5, 0, ones).astype(np.float32),
        0 * ones,
        ones,
        np.full(3, 0.4),
        np.array([[1, 1, 1], [1.6, 1, 1], [1, 1, 1.2]]),
        0,
    )


def _up(rung, sigma=None):
    """A group of materials.json that climbed to a rung."""
    below = ORDER[1 : ORDER.index(rung) + 1]
    why = "off by 0.1387 beyond noise as diffuse; rho_s = 0.9, 0.8, 0.5 is not 1"
    tried = [{"rung": r, "excess": 0.1 / (i + 1), "diffuse": 0.14} for i, r in enumerate(below)]
    return group(
        [0.7, 0.6, 0.5],
        kind="glossy" if rung == "anisotropic" else rung,
        sigma={"rho_d": [0.001] * 3} | (sigma or {}),
        ladder={"rung": rung, "why": why, "tried": tried},
    )


def _deviation(truth, *in_sigmas):
    n = len(truth)
    off = {"absolute": [0.01] * n, "relative": [0.1] * n, "in_sigmas": list(in_sigmas)}
    return {"truth": truth, "value": truth, "sigma": None, **off}


def climbed():
    """Everything, and a group on each kind of rung; the shelf lacked only the light of the mirror."""
    files = everything()
    groups, fit = files["materials"]["groups"], files["reports"]["fit"]
    black = {"rho_d": [0, 0, 0]}
    groups |= {
        "glass": _up("mirror", black | {"rho_s": [0, 0, 0]}) | {"rho_d": [0.0] * 3, "rho_s": [1.0, 1.0, 1.0]},
        "brass": _up("coloured_mirror", black | {"rho_s": [0.002, 0.003, 0.004]})
        | {"rho_d": [0.0] * 3, "rho_s": [0.9, 0.8, 0.5]},
        "tin": _up("glossy", {"rho_s": [0.002] * 3, "alpha": [0.001] * 2})
        | {"rho_s": [0.3] * 3, "alpha": [0.05, 0.05]},
        "steel": _up("anisotropic", {"rho_s": [0.002] * 3, "alpha": [0.01, 0.004], "tangent_rad": 0.02})
        | {"rho_s": [0.4] * 3, "alpha": [0.28, 0.07], "tangent": [0.8, 0.6, 0.0]},
        "print": _up("textured") | {"texture": {"7": "texture-7.exr"}},
        "shelf": copy.deepcopy(groups["wall"]),
        "books": copy.deepcopy(groups["wall"]) | {"pixels": 0},
    }
    names = ("glass", "brass", "tin", "steel", "print")
    before = {name: 0.14 for name in names} | {"wall": 0.004, "card": 0.01, "shelf": 0.02}
    fit["ladder"] |= {
        "diffuse": before,
        "end": before | {name: 0.003 for name in (*names, "shelf")},
        "rounds": 4,
        "rays": {"camera rays to mirrors": 40782, "rays in lobes": 3210600, "mirrored lamps": 1},
        "rungs": {name: groups[name]["ladder"]["rung"] for name in names},
    }
    files["thumbnails"] = {"print": {7: ladder.thumbnail(texture())}}
    direction = [0.8, 0.6, 0.0]
    turn = {"truth": direction, "value": direction, "degrees": [1.25], "sigma": 1.1, "in_sigmas": [1.1]}
    files["comparison"]["groups"] |= {
        "brass": {"kind": ["coloured_mirror", "mirror"], "rho_s": _deviation([0.91, 0.8, 0.5], 5.0, 0.1, 0.1)},
        "steel": {
            "kind": ["glossy", "glossy"],
            "rho_s": _deviation([0.4] * 3, 0.2, 0.2, 0.2),
            "alpha": _deviation([0.28, 0.07], 1.0, None),
            "tangent": turn,
        },
    }
    files["comparison"]["textures"] = {"print": {"rmse": 0.021, "pixels": 1253}}
    return files
