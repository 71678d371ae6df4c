"""What came out against what is true: the scorecard, and its two-sided bounds.

`against_truth` needs no file of another stage; whatever is missing is left out.  A residual is not an error: a re-rendering may
agree with the photograph to 0.5 % while its reflectances are 17 % off (gamma and rho share a valley), so both are listed.

Names of errors are stable (tests/expected/<scene>.csv refers to them):

    reflectance.mean_relative     mean |rho / rho* - 1| over channels of the counted groups
    reflectance.max_relative, reflectance.max_absolute
    reflectance.within_3_sigma    share of the channels with |rho - rho*| <= 3 sigma; a channel without sigma is outside
    reflectance.median_sigma
    reflectance.unidentified      counted groups without a value of their own
    reflectance.groups            counted groups
    small.<...>                   the same over groups too small to be counted
    reflectance.only_in_mirror    mean |rho / rho* - 1| of the diffuse groups that are seen in mirrors alone; ..._groups: how many
    kinds.right, kinds.groups     share of the groups of 200 pixels or more whose kind is the true one; how many they are
    mirror.rho_s                  largest |rho_s - rho_s*| of mirrors, coloured ones too
    glossy.rho_d, glossy.rho_s    largest absolute; glossy.alpha: largest relative, along both axes; glossy.tangent: largest angle, up to sign
    mirror.within_3_sigma, glossy.within_3_sigma       share of those numbers
    texture.rmse, texture.rho_d   of the albedo at the pixels that show a textured group; largest error of a group's mean
    gamma.absolute, gamma.in_sigmas          lamp.mean_relative, lamp.max_relative (lamps that were unknown)
    index.differ, index.differ_all           share of pixels of another group: away from edges, and of all
    object.differ, object.differ_all         depth.median_relative
    render.rmse, render.ciede2000            against the photograph, from rendered.json

Counted is a diffuse group with at least 500 pixels in truth's group image that is neither a lamp nor given as a reference.  What a
group is, truth says: a mirror found to be diffuse counts among the mirrors.  Where truth and result are all diffuse there are no kinds.
"""
from __future__ import annotations

import csv
import math
from pathlib import Path

from lib import artefact
from lib.stage import BadInput

ENOUGH_PX = 500
KIND_PX = 200                                   # of a group whose kind is judged
EVEN = 1.15                                     # alpha_x / alpha_y below which a lobe has no direction to speak of
MIRRORS = ("mirror", "coloured_mirror")
COLUMNS = ("scene", "stage", "error", "value", "unit", "against", "wall_s", "cpu_s", "peak_mb", "status")
CHANNELS = ("rho_d", "rho_s")
SIZES = {**dict.fromkeys(CHANNELS, 3), "alpha": 2}


# ---- what is read ----

def read_materials(path):
    """materials.json or truth's.  BadInput names file, group, field and value."""
    materials = artefact.read_json(path)
    problems = []

    def number(value):
        return isinstance(value, (int, float)) and not isinstance(value, bool)

    def numbers(where, value, n=3):
        if value is not None and not (isinstance(value, list) and len(value) == n and all(map(number, value))):
            problems.append(f"{path}: {where} = {value!r} is neither null nor {'three' if n == 3 else 'two'} numbers")

    if not isinstance(materials, dict) or not isinstance(materials.get("groups"), dict):
        raise BadInput(f"{path}: groups: missing, or not a table of groups")
    for field in ("groups", "lamps"):
        for name, entry in (materials.get(field) or {}).items():
            if not isinstance(entry, dict):
                problems.append(f"{path}: {field}.{name} = {entry!r} is not a table")
                continue
            for key, n in (*SIZES.items(), ("emittance", 3), ("tangent", 3)):
                numbers(f"{field}.{name}.{key}", entry.get(key), n)
            if not isinstance(entry.get("kind"), str | None):
                problems.append(f"{path}: {field}.{name}.kind = {entry['kind']!r} is neither null nor a word")
            for key in ("texture", "ladder"):
                if entry.get(key) is not None and not isinstance(entry[key], dict):
                    problems.append(f"{path}: {field}.{name}.{key} = {entry[key]!r} is neither null nor a table")
            sigma = entry.get("sigma")
            if field == "lamps":
                numbers(f"{field}.{name}.sigma", sigma)
            elif sigma is not None and not isinstance(sigma, dict):
                problems.append(f"{path}: {field}.{name}.sigma = {sigma!r} is not a table")
            else:
                for key, n in SIZES.items():
                    numbers(f"{field}.{name}.sigma.{key}", (sigma or {}).get(key), n)
                if (turn := (sigma or {}).get("tangent_rad")) is not None and not number(turn):
                    problems.append(f"{path}: {field}.{name}.sigma.tangent_rad = {turn!r} is neither null nor a number")
    if problems:
        raise BadInput(*problems)
    return materials


def texture_files(path, materials):
    """{group: {facet: file}} of materials.json at path: their names are as seen from its folder.  BadInput: a facet that is no number."""
    result, problems = {}, []
    for name, entry in materials["groups"].items():
        for facet, file in (entry.get("texture") or {}).items():
            if facet.isdecimal() and isinstance(file, str):
                result.setdefault(name, {})[int(facet)] = Path(path).parent / file
            else:
                problems.append(f"{path}: groups.{name}.texture.{facet} = {file!r} is not a facet's number and a file")
    if problems:
        raise BadInput(*problems)
    return result


def read_reports(paths):
    """{stage: report}, in the given order; the stage is the file's name without `.report.json`."""
    return {Path(path).name.removesuffix(".report.json"): artefact.read_json(path) for path in paths}


def read_legend(path):
    legend = artefact.read_json(path)
    for key in ("groups", "objects"):
        if not (isinstance(legend, dict) and isinstance(legend.get(key), list) and all(isinstance(n, str) for n in legend[key])):
            raise BadInput(f"{path}: {key}: missing, or not a list of names")
    return legend


# ---- reflectances ----

def given(materials, reports):
    """(reference groups, given lamps): what the fit was told, so that it is no finding.

    The fit's report says what it was told.  Without it, a sigma of zero or none marks what was given.
    """
    told = ((reports.get("fit") or {}).get("arguments") or {})
    reference = set(told["reference"] or ()) if isinstance(told.get("reference"), dict) else {
        name for name, g in materials["groups"].items()
        if g.get("rho_d") is not None and g.get("kind") not in MIRRORS and (g.get("sigma") or {}).get("rho_d") == [0, 0, 0]}
    lamps = told.get("lamps")
    known = {name for name, lamp in (materials.get("lamps") or {}).items()
             if (lamps.get(name) != "unknown" if isinstance(lamps, dict) else not lamp.get("sigma"))}
    return reference, known


def reflectances(materials, truth, pixels, reference=(), enough_px=ENOUGH_PX):
    """{group: comparison} for every group of truth that is no lamp.

    pixels : {group: pixels in truth's group image}

    >>> wall = {"rho_d": [0.5, 0.5, 0.4], "sigma": {"rho_d": [0.01, 0.001, 0.01]}, "identified": True}
    >>> true = {"rho_d": [0.5, 0.51, 0.4]}
    >>> c = reflectances({"groups": {"wall": wall}}, {"groups": {"wall": true}}, {"wall": 900})["wall"]
    >>> c["counted"], [round(r, 4) for r in c["rho_d"]["relative"]], [round(s) for s in c["rho_d"]["in_sigmas"]]
    (True, [0.0, -0.0196, 0.0], [0, -10, 0])
    """
    lamps = set(truth.get("lamps") or ()) | set(materials.get("lamps") or ())
    result = {}
    for name, true in truth["groups"].items():
        if name in lamps or true.get("rho_d") is None:
            continue
        found = materials["groups"].get(name) or {}
        n = int(pixels.get(name, 0))
        kind = true.get("kind") or "diffuse"
        entry = {"pixels": n, "given": name in reference, "identified": bool(found.get("identified", True)) and found.get("rho_d") is not None,
                 "counted": n >= enough_px and name not in reference and kind == "diffuse", "kind": [found.get("kind") or "diffuse", kind]}
        sigma = found.get("sigma") or {}
        for key in SIZES:
            value, true_value = found.get(key), true.get(key)
            if true_value is None or (key != "rho_d" and not any(true_value) and not any(value or ())):
                continue
            entry[key] = _deviation(value, true_value, sigma.get(key))
        if true.get("tangent") and true.get("alpha") and true["alpha"][0] > EVEN * true["alpha"][1]:
            entry["tangent"] = _turn(found.get("tangent"), true["tangent"], sigma.get("tangent_rad"))
        result[name] = entry
    return result


def _deviation(value, truth, sigma):
    """What compare.json says of some numbers, in truth and as they were found (None: they were not)."""
    if value is None:
        return {"truth": truth}
    absolute = [a - b for a, b in zip(value, truth)]
    return {"truth": truth, "value": value, "sigma": sigma, "absolute": absolute, "relative": [d / t if t else None for d, t in zip(absolute, truth)],
            "in_sigmas": [d / s if s else (0.0 if d == 0 else None) for d, s in zip(absolute, sigma or (None,) * len(truth))]}


def _turn(value, truth, sigma_rad):
    """The same of a direction up to its sign; either may be of any length.

    >>> _turn([0, -1, 0], [0, 1, 0], None)["degrees"], round(_turn([1, 1, 0], [1, 0, 0], math.radians(15))["in_sigmas"][0], 9)
    ([0.0], 3.0)
    """
    if not value or not any(value):
        return {"truth": truth}
    (x, y, z), (u, v, w) = value, truth
    cross = math.hypot(y * w - z * v, z * u - x * w, x * v - y * u)
    degrees = math.degrees(math.atan2(cross, abs(x * u + y * v + z * w)))
    sigma = None if sigma_rad is None else math.degrees(sigma_rad)
    return {"truth": truth, "value": value, "degrees": [degrees], "sigma": sigma, "in_sigmas": [degrees / sigma if sigma else None]}


def _summary(groups, prefix):
    """Errors over the groups of `reflectances` that take part."""
    known = [g[key] for g in groups for key in CHANNELS if "value" in g.get(key, ()) and g["identified"]]
    absolute = [abs(d) for c in known for d in c["absolute"]]
    relative = [abs(r) for c in known for r in c["relative"] if r is not None]
    z = [s for c in known for s in c["in_sigmas"]]
    sigma = [s for c in known for s in c["sigma"] or ()]
    errors = []
    if relative:
        errors += [("mean_relative", sum(relative) / len(relative)), ("max_relative", max(relative))]
    if absolute:
        errors += [("max_absolute", max(absolute)), ("within_3_sigma", sum(s is not None and abs(s) <= 3 + 1e-9 for s in z) / len(z))]
    if sigma:
        errors.append(("median_sigma", median(sigma)))
    errors += [("unidentified", sum(not g["identified"] for g in groups)), ("groups", len(groups))]
    return [(f"{prefix}.{name}", value, "groups" if name in ("unidentified", "groups") else "1") for name, value in errors]


# ---- the ladder: kinds, mirrors, lobes, textures ----

def _kinds(groups, named, add, details):
    """Is each group what it is?  Not asked of groups whose kind scene.yaml names, nor where all is diffuse, in truth and as found."""
    judged = {n: g["kind"] for n, g in groups.items() if g["identified"] and not g["given"] and g["pixels"] >= KIND_PX and n not in named}
    if {kind for pair in judged.values() for kind in pair} - {"diffuse"}:
        details["kinds"] = {n: pair for n, pair in judged.items() if pair[0] != pair[1]}
        add("fit", "kinds.right", 1 - len(details["kinds"]) / len(judged))
        add("fit", "kinds.groups", len(judged), "groups")


def _shares(groups, add):
    """Of mirrors and glossy groups: the largest error of each kind of number, and how many lie within their sigma."""
    def worst(key, how):
        return max((abs(v) for g in members for v in g.get(key, {}).get(how, ()) if v is not None), default=None)

    for prefix, kinds, keys in (("mirror", MIRRORS, ("rho_s",)), ("glossy", ("glossy",), ("rho_d", "rho_s", "alpha", "tangent"))):
        members = [g for g in groups.values() if g["kind"][1] in kinds and g["identified"] and not g["given"] and g["pixels"] >= KIND_PX]
        for key in keys:
            how, unit = {"alpha": ("relative", "1"), "tangent": ("degrees", "deg")}.get(key, ("absolute", "1"))
            add("fit", f"{prefix}.{key}", worst(key, how), unit)
        z = [s for g in members for key in keys for s in _once(g.get(key, {}))]
        if z:
            add("fit", f"{prefix}.within_3_sigma", sum(s is not None and abs(s) <= 3 + 1e-9 for s in z) / len(z))


def _once(deviation):
    """Its in_sigmas; of a round lobe that is round in truth too, alpha once."""
    z = deviation.get("in_sigmas", [])
    pairs = list(zip(deviation["truth"], deviation["value"])) if len(z) == 2 else ()
    return z[:1] if pairs and pairs[0] == pairs[1] else z


def _only_in_mirrors(materials, groups, add):
    """The diffuse groups that the camera does not see, and whose reflectance is found all the same: where there is a mirror, by way of it."""
    if not any(g.get("kind") in MIRRORS for g in materials["groups"].values()):
        return
    members = [g for g in groups.values() if g["identified"] and not g["given"] and g["pixels"] == 0 and g["kind"][1] == "diffuse"]
    relative = [abs(r) for g in members for r in g["rho_d"]["relative"] if r is not None]
    if relative:
        add("fit", "reflectance.only_in_mirror", sum(relative) / len(relative))
        add("fit", "reflectance.only_in_mirror_groups", len(members), "groups")


def read_textures(path):
    """{group: (image (h, w, C), origin (3,), axes (2, 3))} of truth/textures.json: the outer corner of pixel [0, 0], m, and the
    whole length of row 0 and of column 0 from there."""
    import numpy as np
    from lib import image

    result = {}
    table = artefact.read_json(path)
    for group, entry in (table.items() if isinstance(table, dict) else [("", table)]):
        try:
            place = np.array([entry[key] for key in ("origin", "u", "v")], float).reshape(3, 3)
            file = Path(path).parent / entry["file"]
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"{path}: {group}: has not file, origin, u and v of a texture") from None
        picture = image.read_exr(file)
        result[group] = picture if picture.ndim == 3 else picture[..., None], place[0], place[1:]
    return result


def bilinear(picture, origin, axes, p):
    """(M, C) of a picture that lies in space (`read_textures`) at places p (M, 3): bilinear between centres of pixels, constant beyond.

    >>> import numpy as np
    >>> two = np.array([[[0.2], [0.6]]])                                     # one row of two pixels, 2 m long and 1 m high
    >>> bilinear(two, np.zeros(3), np.array([[2.0, 0, 0], [0, 1, 0]]), np.array([[0.5, 0.3, 0], [1, 0.9, 0], [7, 0, 0]])).round(9).ravel()
    array([0.2, 0.4, 0.6])
    """
    import numpy as np
    from scipy.ndimage import map_coordinates

    h, w, C = picture.shape
    s, t = np.linalg.pinv(axes.T) @ (p - origin).T
    at = [t * h - 0.5, s * w - 0.5]
    return np.stack([map_coordinates(np.asarray(picture[..., c], float), at, order=1, mode="nearest") for c in range(C)], axis=1)


def albedos(model, camera, facet, materials, textures, true_textures):
    """{group: (ours (M, 3), truth (M, 3))} at all pixels that show a group of which truth has the texture.

    facet : (H, W) model facet + 1;  textures : {facet: textures.Texture} as found: of other facets the group's rho_d counts
    true_textures : {group: ...} from `read_textures`
    """
    import numpy as np
    from lib import gather, mesh, textures as found

    surface = mesh.surface(model)
    shown = facet.reshape(-1).astype(np.int64) - 1
    result = {}
    for name in true_textures.keys() & {*model.groups}:
        constant = (materials["groups"].get(name) or {}).get("rho_d")
        pixel = np.flatnonzero((shown >= 0) & (surface.group[np.maximum(shown, 0)] == model.groups.index(name)))
        if constant is None or not len(pixel):
            continue
        p, _ = gather.backproject(surface, camera, shown[pixel], pixel)
        ours = np.tile(np.array(constant, float), (len(pixel), 1))
        for f in textures.keys() & {*shown[pixel].tolist()}:
            ours[shown[pixel] == f] = found.lookup(textures[f], surface, p[shown[pixel] == f])
        true = bilinear(*true_textures[name], p * surface.local.diagonal + surface.local.centre)
        result[name] = ours, np.broadcast_to(true, ours.shape)
    return result


def _textures(albedo, groups, add, details):
    """RMSE over all pixels that show textured groups; per group beside it."""
    squares = {n: (float(((ours - true) ** 2).mean()), len(ours)) for n, (ours, true) in (albedo or {}).items() if n in groups}
    if squares:
        details["textures"] = {n: {"rmse": math.sqrt(s), "pixels": m} for n, (s, m) in squares.items()}
        add("fit", "texture.rmse", math.sqrt(sum(s * m for s, m in squares.values()) / sum(m for _, m in squares.values())))
        add("fit", "texture.rho_d", max((abs(d) for n in squares for d in groups[n]["rho_d"].get("absolute", ())), default=None))


def median(values):
    """
    >>> median([3, 1, 2]), median([1, 2])
    (2, 1.5)
    """
    values = sorted(values)
    middle = len(values) // 2
    return values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2


# ---- index buffers ----

def count_pixels(labels, names):
    """{name: pixels} of an image of index + 1."""
    import numpy as np

    counts = np.bincount(labels.ravel(), minlength=len(names) + 1)
    return {name: int(counts[i + 1]) for i, name in enumerate(names)}


def differ(labels, names, true_labels, true_names):
    """(share of pixels of another name away from truth's edges, share of all pixels).

    An edge is where a pixel and one of its eight neighbours differ in truth; both of them lie at it.
    The first is None where every pixel lies at an edge.
    """
    import numpy as np

    ids = {name: i for i, name in enumerate(dict.fromkeys([*names, *true_names]), start=1)}
    ours, true = (np.array([0, *(ids[n] for n in which)])[image] for which, image in ((names, labels), (true_names, true_labels)))
    edge = np.zeros(true.shape, bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, true.shape[0] - dy), slice(max(0, -dx), true.shape[1] - max(0, dx)))
        b = (slice(dy, None), slice(max(0, dx), true.shape[1] + min(0, dx)))
        step = true[a] != true[b]
        edge[a] |= step
        edge[b] |= step
    other = ours != true
    inside = ~edge
    return (float(other[inside].mean()) if inside.any() else None), float(other.mean())


# ---- all of it ----

def against_truth(*, materials=None, reports=None, truth=None, images=None, true_images=None, legend=None, true_legend=None, scores=None,
                  albedo=None):
    """(errors [{stage, name, value, unit, against}], details for compare.json) from what there is.

    images, true_images : {"group", "object": (H, W) int; "depth": (H, W) float};  albedo : from `albedos`
    """
    reports, images, true_images = reports or {}, images or {}, true_images or {}
    errors, details = [], {}

    def add(stage, name, value, unit="1", against="truth"):
        if value is not None:
            errors.append({"stage": stage, "name": name, "value": value, "unit": unit, "against": against})

    true_names = true_legend or legend
    pixels = {}
    if "group" in true_images and true_names:
        pixels = count_pixels(true_images["group"], true_names["groups"])
    elif "group" in images and legend:
        pixels = count_pixels(images["group"], legend["groups"])
    if materials and truth:
        reference, known_lamps = given(materials, reports)
        groups = details["groups"] = reflectances(materials, truth, pixels, reference)
        for prefix, members in (("reflectance", [g for g in groups.values() if g["counted"]]),
                                ("small", [g for g in groups.values() if not g["counted"] and not g["given"] and g["pixels"] > 0 and g["kind"][1] == "diffuse"])):
            if members:
                for name, value, unit in _summary(members, prefix):
                    add("fit", name, value, unit)
        _only_in_mirrors(materials, groups, add)
        _kinds(groups, ((reports.get("fit") or {}).get("arguments") or {}).get("surfaces") or (), add, details)
        _shares(groups, add)
        _textures(albedo, groups, add, details)
        _transfer(materials, truth, add, details)
        _lamps(materials, truth, known_lamps, add, details)
    if legend and true_names:
        for kind, error in (("group", "index"), ("object", "object")):
            if kind in images and kind in true_images and set(true_names[kind + "s"]) and images[kind].shape == true_images[kind].shape:
                inner, every = differ(images[kind], legend[kind + "s"], true_images[kind], true_names[kind + "s"])
                add("index", f"{error}.differ", inner)
                add("index", f"{error}.differ_all", every)
    if "depth" in images and "depth" in true_images and images["depth"].shape == true_images["depth"].shape:
        a, b = images["depth"], true_images["depth"]
        both = (a > 0) & (b > 0)
        if both.any():
            add("index", "depth.median_relative", median(list(abs(a[both] / b[both] - 1))))
    for key, unit in (("rmse", "1"), ("ciede2000", "CIEDE2000")):
        if isinstance((scores or {}).get(key), (int, float)):
            add("render", f"render.{key}", scores[key], unit, "photograph")
    return errors, details


def _transfer(materials, truth, add, details):
    found, true = (m.get("transfer") or {} for m in (materials, truth))
    if true.get("kind"):
        details["transfer"] = {"value": found, "truth": true}
    if found.get("kind") == true.get("kind") == "gamma":
        error = found["gamma"] - true["gamma"]
        add("fit", "gamma.absolute", abs(error))
        if found.get("sigma"):
            add("fit", "gamma.in_sigmas", abs(error) / found["sigma"], "sigma")


def _lamps(materials, truth, known, add, details):
    entries, relative = {}, []
    for name, true in (truth.get("lamps") or {}).items():
        found = (materials.get("lamps") or {}).get(name) or {}
        value, true_value = found.get("emittance"), true.get("emittance")
        entries[name] = {"given": name in known, "value": value, "truth": true_value, "sigma": found.get("sigma")}
        if value and true_value:
            entries[name]["relative"] = [v / t - 1 if t else None for v, t in zip(value, true_value)]
            if name not in known:
                relative += [abs(r) for r in entries[name]["relative"] if r is not None]
    if entries:
        details["lamps"] = entries
    if relative:
        add("fit", "lamp.mean_relative", sum(relative) / len(relative))
        add("fit", "lamp.max_relative", max(relative))


# ---- the scorecard ----

def _text(value):
    """
    >>> _text(0.1 + 0.2), _text(None), _text(True), _text("a")
    ('0.3', '', '1', 'a')
    """
    if value is None:
        return ""
    return format(value, ".9g") if isinstance(value, (int, float)) else str(value)


def scorecard(scene, reports, errors):
    """Rows of scorecard.csv: per stage, its own errors and those against truth beside its times; one row where it has none.

    Ends with the CPU time of all stages up to the fit, and of all.
    """
    rows = []
    stages = list(dict.fromkeys([*reports, *(e["stage"] for e in errors)]))
    for stage in stages:
        report = reports.get(stage) or {}
        mine = [*(report.get("errors") or []), *(e for e in errors if e["stage"] == stage)]
        for error in mine or [{}]:
            rows.append({"scene": scene, "stage": stage, "error": error.get("name"), "value": error.get("value"), "unit": error.get("unit"),
                         "against": error.get("against"), **{k: report.get(k) for k in ("wall_s", "cpu_s", "peak_mb", "status")}})
    for name, until in (("time.until_fit", "fit"), ("time.all", None)):
        if until is None or until in reports:
            part = [reports[s] for s in (stages[:stages.index(until) + 1] if until else stages) if s in reports]
            if part:
                total = {k: sum(p.get(k) or 0 for p in part) for k in ("wall_s", "cpu_s")}
                rows.append({"scene": scene, "stage": "total", "error": name, "value": total["cpu_s"], "unit": "s", "against": None,
                             **total, "peak_mb": max(p.get("peak_mb") or 0 for p in part), "status": None})
    return rows


def write_scorecard(path, rows):
    """To a path as it is (the caller sees to it that the file is whole or absent)."""
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([_text(row.get(column)) for column in COLUMNS] for row in rows)


def read_table(path, columns):
    """The rows of a CSV file with these columns, as dicts.  BadInput names file, line and column."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            reader = csv.DictReader((line for line in file if not line.startswith("#")), strict=True)
            rows = list(reader)
    except FileNotFoundError:
        raise BadInput(f"{path}: there is no such file") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not a readable CSV file: {error}") from None
    missing = [c for c in columns if c not in (reader.fieldnames or ())]
    if missing:
        raise BadInput(*(f"{path}: {c}: the column is missing" for c in missing))
    return rows


def check(scorecard, expected):
    """The bounds that a scorecard breaks, one line each; empty if it keeps them all.

    scorecard : path of scorecard.csv          expected : path of a CSV file `error,low,high`

    An error is named as in the scorecard, or as `stage/error` where several stages have one of that name; else every row of that
    name must keep the bounds.  Both bounds belong to the range, both must be there: too good usually means that somebody stopped
    looking.  An error that is missing or has no value breaks them too.
    """
    rows = read_table(scorecard, COLUMNS)
    violations = []
    for bound in read_table(expected, ("error", "low", "high")):
        name = (bound["error"] or "").strip()
        try:
            low, high = float(bound["low"]), float(bound["high"])
        except (TypeError, ValueError):
            low = high = math.nan
        if not low <= high or not (math.isfinite(low) and math.isfinite(high)):
            violations.append(f"{expected}: {name}: low = {bound['low']}, high = {bound['high']}: is not a range")
            continue
        found = [row for row in rows if name in (row["error"], f"{row['stage']}/{row['error']}")]
        if not found:
            violations.append(f"{scorecard}: {name}: missing; it must lie in [{low:g}, {high:g}]")
        for row in found:
            try:
                value = float(row["value"])
            except ValueError:
                value = math.nan
            if not low <= value <= high:
                how = "is above" if value > high else "is below (too good?)" if value < low else "is not in"
                violations.append(f"{scorecard}: {row['stage']}/{row['error']} = {row['value'] or 'nothing'} {how} [{low:g}, {high:g}]")
    return violations
