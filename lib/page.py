"""report.html: one page that shows a scene's result, for people; nothing in it comes from the network.

`build` takes what there is (`Parts`, each of which may be None) and returns the page; a section appears only when its data exist.
Every text from a file is escaped, every number goes through `number` or `_n`, so neither a NaN nor an infinity reaches the page.
Plots are inline SVG, drawn by `_plot`; pictures are data URIs, made smaller until the page keeps its size.
"""
from __future__ import annotations

import base64
import html
import math
from dataclasses import dataclass, field

import numpy as np

LIMIT_BYTES = 6_000_000
WIDTHS_PX = (1600, 1280, 960, 720, 480, 320)       # tried in this order until the page is small enough
CHANNELS = ("R", "G", "B")


@dataclass
class Parts:
    """photograph, rendered : (H, W, C) display values in [0, 1], C = 1 or 3        linear : the photograph is an EXR
    group, object, facet : (H, W) int, index + 1;  hidden, trusted : (H, W) bool;  depth : (H, W) metres, 0 = nothing
    reports : {stage: report};  plan : [(stage, why it was left out)];  the others as in their files
    """
    scene: str = "scene"
    photograph: object = None
    linear: bool = False
    rendered: object = None
    group: object = None
    object: object = None
    facet: object = None
    hidden: object = None
    trusted: object = None
    depth: object = None
    legend: dict = None
    materials: dict = None
    scores: dict = None
    comparison: dict = None
    reports: dict = field(default_factory=dict)
    plan: list = field(default_factory=list)
    textures: dict = None                            # {group: {facet: ladder_page.thumbnail}}
    vision: object = None                            # vision_page.Vision


# ---- text ----

def esc(value):
    return html.escape(str(value), quote=True)


def _finite(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def number(value, digits=3):
    """Significant digits, no exponent where people would not expect one; a dash where there is no number.

    >>> number(0.0123456), number(12345.6), number(2.0), number(0), number(None), number(float("nan")), number(1.2e-7)
    ('0.0123', '12,346', '2', '0', '–', '–', '1.2·10⁻⁷')
    """
    if not _finite(value):
        return "–"
    if value == 0:
        return "0"
    if isinstance(value, int) or abs(value) >= 10 ** (digits + 1):
        return f"{value:,.0f}" if abs(value) < 1e15 else _power(value, digits)
    if abs(value) < 1e-4:
        return _power(value, digits)
    text = f"{value:.{max(0, digits - 1 - math.floor(math.log10(abs(value))))}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def _power(value, digits=3):
    exponent = math.floor(math.log10(abs(value)))
    mantissa = f"{value / 10.0 ** exponent:.{digits - 1}f}".rstrip("0").rstrip(".")
    raised = str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"10{raised}" if mantissa == "1" else f"{mantissa}·10{raised}"


def fixed(value, decimals, sign=False):
    """
    >>> fixed(0.71234, 3), fixed(-0.0204, 1, sign=True), fixed(None, 2)
    ('0.712', '−0.0', '–')
    """
    return f"{value:{'+' if sign else ''}.{decimals}f}".replace("-", "−") if _finite(value) else "–"


def percent(value, decimals=None, sign=False):
    """
    >>> percent(0.00704), percent(0.25), percent(1.0), percent(-0.011, 1, True)
    ('0.70 %', '25 %', '100 %', '−1.1 %')
    """
    if not _finite(value):
        return "–"
    p = 100 * value
    if decimals is None:
        decimals = 0 if abs(p) >= 20 else 1 if abs(p) >= 2 else 2
    return fixed(p, decimals, sign) + " %"


def pm(value, sigma, decimals=4):
    """
    >>> pm(2.004, 0.003, 3), pm(2.0, None, 2), pm(0.5, 1e-6, 3)
    ('2.004 ± 0.003', '2.00', '0.500 ± <0.001')
    """
    if not _finite(sigma) or not _finite(value):
        return fixed(value, decimals)
    return f"{fixed(value, decimals)} ± {fixed(sigma, decimals) if sigma >= 0.5 * 10 ** -decimals or sigma == 0 else '<' + fixed(10 ** -decimals, decimals)}"


def plain(name):
    """An error's or a stage's name in words.

    >>> plain("image_rmse"), plain("reflectance.max_absolute")
    ('image rmse', 'reflectance: max absolute')
    """
    return str(name).replace(".", ": ").replace("_", " ")


def _n(value):
    """A coordinate in an SVG."""
    return f"{value:.2f}".rstrip("0").rstrip(".") if math.isfinite(value) else "0"


# ---- pictures ----

def _bytes8(values):
    return (np.clip(np.nan_to_num(values), 0, 1) * 255 + 0.5).astype(np.uint8)


def _smaller(values, width, nearest=False):
    import cv2

    scale = width / max(values.shape[:2])
    if scale >= 1:
        return values
    size = tuple(max(1, round(n * scale)) for n in values.shape[1::-1])
    return cv2.resize(values, size, interpolation=cv2.INTER_NEAREST if nearest else cv2.INTER_AREA)


def uri(values, *, photo=False):
    """A data URI of an 8-bit picture (H, W) or (H, W, 3): JPEG for photographs, PNG for flat colours."""
    import cv2

    if values.ndim == 3:
        values = values[..., 0] if values.shape[2] == 1 else values[..., ::-1]
    kind, options = ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, 90]) if photo else ("png", [cv2.IMWRITE_PNG_COMPRESSION, 9])
    ok, code = cv2.imencode(f".{kind}", np.ascontiguousarray(values), options)
    if not ok:
        raise OSError("a picture of the page cannot be encoded")
    return f"data:image/{kind};base64,{base64.b64encode(code.tobytes()).decode()}"


def colours(n):
    """n quiet colours, neighbours in the list far apart: hues a golden angle apart, three lightnesses (Oklab).  (n, 3) uint8."""
    i = np.arange(n)
    hue, L, C = 2.3999632 * i + 4.1, np.array([0.70, 0.56, 0.83])[i % 3], np.array([0.105, 0.11, 0.085])[i % 3]
    lab = np.stack([L, C * np.cos(hue), C * np.sin(hue)])
    lms = (np.array([[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]) @ lab) ** 3
    linear = np.array([[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965], [-0.0041960863, -0.7034186147, 1.7076147010]]) @ lms
    return _bytes8(display_function({"kind": "srgb"})(linear).T)


def paint(labels):
    """Labels (index + 1) in colours; nothing is white."""
    n = int(labels.max(initial=0))
    return np.concatenate([np.full((1, 3), 255, np.uint8), colours(n)])[labels]


def css(rgb):
    """
    >>> css([255, 0, 128])
    '#ff0080'
    """
    return "#" + "".join(f"{int(c):02x}" for c in rgb)


def _three(values):
    return np.broadcast_to(values, (*values.shape[:2], 3)) if values.shape[2] == 1 else values


def difference(photograph, rendered):
    """(largest signed deviation over the channels (H, W), half the width of its scale: 1, 2 or 5 times a power of ten)."""
    delta = np.nan_to_num(rendered - photograph, posinf=1, neginf=-1)
    signed = np.take_along_axis(delta, np.abs(delta).argmax(axis=2)[..., None], axis=2)[..., 0]
    typical = max(float(np.percentile(np.abs(signed), 98)), 1e-3)
    power = 10.0 ** math.floor(math.log10(typical))
    return signed, next((m * power for m in (1, 2, 5, 10) if m * power >= typical * (1 - 1e-9)), 10 * power)


# rendered darker: blue; brighter: orange; the middle is grey, so that it shows on dark and on light
SCALE = np.array([[20, 60, 140], [66, 133, 204], [150, 190, 222], [236, 236, 233], [240, 189, 140], [214, 120, 44], [140, 58, 10]], float)


def diverging(values, half):
    at = (np.clip(values / half, -1, 1) + 1) / 2 * (len(SCALE) - 1)
    low = np.minimum(at.astype(int), len(SCALE) - 2)
    t = (at - low)[..., None]
    return (SCALE[low] * (1 - t) + SCALE[low + 1] * t + 0.5).astype(np.uint8)


# ---- transfer functions ----

def display_function(transfer, linear_photograph=False):
    """T as a function of arrays, from materials.json's `transfer`; gamma 2.2 where the file does not fix one."""
    transfer = transfer or {}
    kind = transfer.get("kind")
    if kind == "curve" and transfer.get("linear") and transfer.get("display"):
        return lambda B: np.interp(B, transfer["linear"], transfer["display"])
    if kind == "srgb":
        return lambda B: np.where(np.clip(B, 0, 1) <= 0.0031308, 12.92 * np.clip(B, 0, 1), 1.055 * np.clip(B, 1e-9, 1) ** (1 / 2.4) - 0.055)
    if kind == "linear" and not linear_photograph:
        return lambda B: np.clip(B, 0, 1)
    gamma = transfer.get("gamma")
    gamma = gamma if kind == "gamma" and _finite(gamma) and gamma > 0 else 2.2
    return lambda B: np.clip(B, 0, 1) ** (1 / gamma)


# ---- plots ----

def _ticks(low, high, log):
    """(value, label) between low and high (log: decimal exponents); about four to seven."""
    if log:
        span = high - low
        if span < 0.5:
            return [(math.log10(v), label) for v, label in _ticks(10 ** low, 10 ** high, False) if v > 0]
        factors = (1, 2, 5) if span < 1.6 else (1, 3) if span < 2.5 else (1,)
        step = max(1, math.ceil(span / 7))
        found = [m * 10.0 ** e for e in range(math.floor(low) - 1, math.ceil(high) + 1) for m in factors if e % step == 0 or span < 2.5]
        return [(math.log10(v), number(v, 2)) for v in found if low - 1e-9 <= math.log10(v) <= high + 1e-9]
    span = high - low
    step = 10.0 ** math.floor(math.log10(span / 4))
    step *= next((m for m in (1, 2, 5, 10) if span / (m * step) <= 6), 10)
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return [(v, fixed(v, decimals)) for v in step * np.arange(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _plot(series, *, x, y, title, logx=False, logy=False, xlim=None, ylim=None, bands=(), dots=True, width=460, height=300, keys=None):
    """Inline SVG.  series : [(name, xs, ys, css class)]; on a log axis points at or below 0 are left out.  "" where nothing is left."""
    def clean(xs, ys):
        return [(float(a), float(b)) for a, b in zip(xs, ys)
                if _finite(a) and _finite(b) and (a > 0 or not logx) and (b > 0 or not logy)]

    fx, fy = (math.log10 if log else float for log in (logx, logy))
    lines = [(name, [(fx(a), fy(b)) for a, b in clean(xs, ys)], kind) for name, xs, ys, kind in series]
    lines = [line for line in lines if line[1]]
    if not lines:
        return ""

    def limits(given, i, log):
        if given:
            return given
        values = [p[i] for _, points, _ in lines for p in points]
        low, high = min(values), max(values)
        pad = max(0.06 * (high - low), 0.15 if log else 1e-3 * max(abs(high), abs(low), 1e-6))
        return low - pad, high + pad

    (x0, x1), (y0, y1) = limits(xlim, 0, logx), limits(ylim, 1, logy)
    left, right, top, bottom = 66, 14, 12, 46
    X = lambda v: left + (v - x0) / (x1 - x0) * (width - left - right)
    Y = lambda v: height - bottom - (v - y0) / (y1 - y0) * (height - top - bottom)
    out = [f'<svg class="plot" viewBox="0 0 {width} {height}" role="img" aria-label="{esc(title)}">']
    for v, label in _ticks(x0, x1, logx):
        out.append(f'<line class="grid" x1="{_n(X(v))}" x2="{_n(X(v))}" y1="{top}" y2="{height - bottom}"/><text x="{_n(X(v))}" y="{height - bottom + 17}" text-anchor="middle">{esc(label)}</text>')
    for v, label in _ticks(y0, y1, logy):
        out.append(f'<line class="grid" x1="{left}" x2="{width - right}" y1="{_n(Y(v))}" y2="{_n(Y(v))}"/><text x="{left - 8}" y="{_n(Y(v) + 4)}" text-anchor="end">{esc(label)}</text>')
    out.append(f'<text class="label" x="{_n((left + width - right) / 2)}" y="{height - 8}" text-anchor="middle">{esc(x)}</text>'
               f'<text class="label" x="14" y="{_n((top + height - bottom) / 2)}" text-anchor="middle" transform="rotate(-90 14 {_n((top + height - bottom) / 2)})">{esc(y)}</text>')
    for xs, lows, highs in bands:
        path = [f"{_n(X(fx(a)))},{_n(Y(fy(b)))}" for a, b in [*zip(xs, lows), *reversed(list(zip(xs, highs)))]]
        out.append(f'<polygon class="band" points="{" ".join(path)}"/>')
    for name, points, kind in lines:
        out.append(f'<polyline class="line {kind}" points="{" ".join(f"{_n(X(a))},{_n(Y(b))}" for a, b in points)}"/>')
        if dots and kind != "faint":
            out += [f'<circle class="dot {kind}" cx="{_n(X(a))}" cy="{_n(Y(b))}" r="3.2"/>' for a, b in points]
    out.append("</svg>")
    if keys is None:
        keys = len(lines) > 1
    if keys:
        out.append('<p class="keys">' + "".join(f'<span><i class="key {kind}"></i>{esc(name)}</span>' for name, _, kind in lines) + "</p>")
    return "".join(out)


def _dots(value, sigma, truth, channels):
    """A group's reflectance on a line from 0 to 1: dot, bar of 3 sigma, tick at the truth, per channel."""
    width, row = 112, 12
    height = row * len(channels) + 2
    X = lambda v: 5 + min(max(v, 0), 1) * (width - 10)
    out = [f'<svg class="spread" viewBox="0 0 {width} {height}" width="{width}" height="{height}" aria-hidden="true">']
    for v in (0, 0.25, 0.5, 0.75, 1):
        out.append(f'<line class="grid" x1="{_n(X(v))}" x2="{_n(X(v))}" y1="0" y2="{height}"/>')
    for i, c in enumerate(channels):
        y = row * (i + 0.5) + 1
        name = "grey" if len(channels) == 1 else "rgb"[c]
        if sigma and _finite(sigma[c]):
            out.append(f'<line class="bar3 {name}" x1="{_n(X(value[c] - 3 * sigma[c]))}" x2="{_n(X(value[c] + 3 * sigma[c]))}" y1="{_n(y)}" y2="{_n(y)}"/>')
        if truth and _finite(truth[c]):
            out.append(f'<line class="true" x1="{_n(X(truth[c]))}" x2="{_n(X(truth[c]))}" y1="{_n(y - 5)}" y2="{_n(y + 5)}"/>')
        out.append(f'<circle class="dot {name}" cx="{_n(X(value[c]))}" cy="{_n(y)}" r="2.8"/>')
    return "".join(out) + "</svg>"


# ---- sections ----

def _section(title, body, lead="", name=None):
    name = name or "".join(c if c.isalnum() else "-" for c in title.lower())
    return f'<section id="{esc(name)}"><h2>{esc(title)}</h2>{f"<p class=lead>{lead}</p>" if lead else ""}{body}</section>' if body else ""


def _figure(data, caption, alt):
    return f'<figure><img src="{data}" alt="{esc(alt)}" loading="lazy"><figcaption>{caption}</figcaption></figure>'


def _errors(parts):
    return {e["name"]: e["value"] for e in (parts.comparison or {}).get("errors") or []}


def _identified(parts):
    """(identified, all) groups of materials.json that are no lamps."""
    lamps = (parts.materials or {}).get("lamps") or {}
    groups = {n: g for n, g in ((parts.materials or {}).get("groups") or {}).items() if n not in lamps}
    return sum(bool(g.get("identified")) for g in groups.values()), len(groups)


def _rmse(parts):
    """(RMSE, against what) of the picture, else of the fit."""
    if _finite((parts.scores or {}).get("rmse")):
        return parts.scores["rmse"], "the whole picture"
    image = (parts.materials or {}).get("image") or {}
    return (image["rmse"], "the pixels used") if _finite(image.get("rmse")) else (None, None)


def _without_sigma(materials):
    return "not determined" if materials.get("status") == "nothing seen" else "given"


def verdict(parts):
    """(css class, badge, sentence in plain words)."""
    materials = parts.materials or {}
    status = materials.get("status") or next((r.get("status") for r in reversed(list(parts.reports.values())) if r.get("status")), None)
    weak = [s for s, r in parts.reports.items() if r.get("status") == "not converged"]
    if status == "not converged" or weak:
        badge = ("warn", "Not converged")
    elif status in ("converged", "complete"):
        badge = ("good", status.capitalize())
    else:
        badge = ("bad", str(status).capitalize()) if status else ("warn", "Nothing to report")
    said = []
    rmse, where = _rmse(parts)
    if status == "nothing seen":
        said.append("No pixel of the photograph can be used: nothing below is a finding")
    elif rmse is not None:
        subject = "Re-rendering agrees" if parts.scores else "Fitted light agrees"
        said.append(f"{subject} with the photograph to {percent(rmse)} of full scale")
    known, every = _identified(parts)
    if every:
        said.append(f"{known} of {every} group{'s' * (every != 1)} identified")
    if other := _ladder().counts(materials):
        said.append(f"not diffuse: {other}")
    transfer = materials.get("transfer") or {}
    if transfer.get("kind") == "gamma" and _finite(transfer.get("gamma")):
        gamma = pm(transfer["gamma"], transfer.get("sigma"), 3)
        said.append(f"gamma {gamma}" if transfer.get("sigma") else f"gamma {gamma} ({_without_sigma(materials)})")
    seen = _vision().sentence(parts.vision) if parts.vision and not said else ""
    sentence = "; ".join(said) + "." if said else seen or "No photometry was asked for, or none has been done yet."
    error = _errors(parts).get("reflectance.mean_relative")
    if _finite(error):
        sentence += f" Against the known truth, reflectances are off by {percent(error)} on average."
    misfit = (parts.reports.get("fit") or {}).get("misfit")
    if _finite(misfit) and misfit > 4:
        sentence += f" It differs {misfit:.0f} times more than noise explains: a lamp, the model, the pose or the transfer function is not as given."
        badge = ("warn", "Does not fit") if badge[0] == "good" else badge
    others = len((getattr(parts.vision, "pose", None) or {}).get("ambiguous") or [])
    if others:
        sentence += f" The pose is ambiguous: {others} other{'s' * (others != 1)} would explain the photographs as well, and all figures are of the first."
        badge = ("warn", "Ambiguous")
    if weak:
        sentence += f" Not converged: {', '.join(weak)}."
    return *badge, sentence


def _facts(parts):
    facts, errors = [], _errors(parts)
    rmse, where = _rmse(parts)
    if rmse is not None:
        facts.append(("Agreement with the photograph", percent(rmse), f"RMSE of display values over {where}"))
    if _finite((parts.scores or {}).get("ciede2000")):
        facts.append(("Colour difference", number(parts.scores["ciede2000"], 2), "CIEDE2000, mean; about 1 is just noticeable"))
    known, every = _identified(parts)
    if every:
        facts.append(("Groups identified", f"{known} of {every}", "materials that the photograph itself determines"))
    if _finite(errors.get("reflectance.mean_relative")):
        facts.append(("Reflectance error", percent(errors["reflectance.mean_relative"]),
                      f"mean against truth; at most {number(errors.get('reflectance.max_absolute'), 2)} absolute; {percent(errors.get('reflectance.within_3_sigma'), 0)} within 3 σ"))
    if parts.vision and (sigma := _vision().pose_sigma(parts.vision.pose)):
        true = f"; {number(errors['pose.centre_mm'], 2)} mm off the truth" if _finite(errors.get("pose.centre_mm")) else ""
        facts.append(("Camera found to", f"{number(sigma[1], 2)} mm", f"and {number(sigma[0], 2)}°, 1 σ{true}"))
    times = [r["cpu_s"] for r in parts.reports.values() if _finite(r.get("cpu_s"))]
    if times:
        upto = list(parts.reports)
        fit = sum(parts.reports[s].get("cpu_s") or 0 for s in upto[:upto.index("fit") + 1]) if "fit" in upto else None
        facts.append(("Computing time", f"{fixed(fit if fit is not None else sum(times), 1)} s",
                      f"of CPU, up to the reflectances; {fixed(sum(times), 1)} s with the pictures" if fit is not None else "of CPU, all stages"))
    return "<dl class=facts>" + "".join(f"<div><dt>{esc(k)}</dt><dd>{esc(v)}<small>{esc(n)}</small></dd></div>" for k, v, n in facts) + "</dl>" if facts else ""


def _hero(parts, width):
    photo, again = (_smaller(_bytes8(v), width) if v is not None else None for v in (parts.photograph, parts.rendered))
    facts = _facts(parts)
    if photo is not None and again is not None and photo.shape[:2] == again.shape[:2]:
        h, w = photo.shape[:2]
        picture = f"""<figure class="compare"><div class="pair" style="aspect-ratio:{w}/{h}">
<img src="{uri(photo, photo=True)}" alt="The photograph" draggable="false">
<img class="over" src="{uri(again, photo=True)}" alt="The re-rendering" draggable="false">
<span class="tag left">Photograph</span><span class="tag right">Re-rendering</span>
<div class="rule"><i></i></div>
<input type="range" min="0" max="100" step="1" value="50" aria-label="How much of the photograph is shown, in per cent"></div>
<figcaption>Left of the line the photograph, right of it the scene rendered from what was recovered. Drag, or use the arrow keys.</figcaption></figure>"""
    elif photo is not None:
        picture = _figure(uri(photo, photo=True), "The photograph", "The photograph")
    elif again is not None:
        picture = _figure(uri(again, photo=True), "The re-rendering", "The re-rendering")
    else:
        picture = ""
    return f'<div class="hero{"" if picture and facts else " one"}">{picture}{facts}</div>' if picture or facts else ""


def _difference(parts, width):
    a, b = parts.photograph, parts.rendered
    if a is None or b is None or a.shape[:2] != b.shape[:2]:
        return ""
    a, b = (_three(v) for v in (a, b)) if a.shape[2] != b.shape[2] else (a, b)
    signed, half = difference(a, b)
    low, middle, high = (float(np.percentile(np.abs(signed), q)) for q in (50, 95, 99))
    stops = ", ".join(css(c) for c in SCALE)
    scale = (f'<div class="scale"><i style="background:linear-gradient(90deg, {stops})"></i><p><span>−{number(100 * half)} %<br>re-rendering darker</span>'
             f'<span>equal</span><span>+{number(100 * half)} %<br>brighter</span></p></div>')
    picture = _figure(uri(_smaller(diverging(signed, half), width)), "Per pixel, the channel that differs most.", "Re-rendering minus photograph, in colours")
    worst = sorted(((n, s["rmse"]) for n, s in ((parts.scores or {}).get("groups") or {}).items() if _finite((s or {}).get("rmse"))), key=lambda v: -v[1])[:6]
    bars = "".join(f'<tr><th scope=row>{esc(n)}</th><td class=num>{percent(v)}</td><td class=meter><i style="width:{_n(100 * v / worst[0][1])}%"></i></td></tr>' for n, v in worst if worst[0][1] > 0)
    table = f"<h3>Where it differs most</h3><table class=plain><tbody>{bars}</tbody></table>" if bars else ""
    lead = f"Half of the pixels agree to {percent(low)} of full scale, 95 % to {percent(middle)}, 99 % to {percent(high)}."
    return _section("Difference", f'<div class="two">{picture}<div>{scale}{table}</div></div>', lead)


def _status_words(group):
    if group.get("identified"):
        sigma = (group.get("sigma") or {}).get("rho_d")
        return ("plain", "given as a reference") if sigma and not any(sigma) and "mirror" not in str(group.get("kind")) else ("good", "identified")
    pixels = group.get("pixels") or 0
    why = "never seen" if not pixels else f"none of its {number(pixels)} pixels can be trusted"
    return ("warn", f"{why}; assumed from the other groups") if group.get("assumed") else ("warn", f"{why}; no value")


def _assumed(group):
    value = group.get("assumed")
    return value.get("rho_d") if isinstance(value, dict) else value


def _grey(materials):
    values = [_assumed(g) or g.get("rho_d") for g in materials["groups"].values()]
    return bool(values) and all(v is None or v[0] == v[1] == v[2] for v in values)


def _materials(parts):
    materials = parts.materials
    if not materials or not materials.get("groups"):
        return ""
    T = display_function(materials.get("transfer"), parts.linear)
    truths = (parts.comparison or {}).get("groups") or {}
    lamps = materials.get("lamps") or {}
    channels = (0,) if _grey(materials) else (0, 1, 2)
    heads = "".join(f'<th scope=col class="num">ρ{"" if len(channels) == 1 else f" {CHANNELS[c]}"}</th>' for c in channels)
    rows, off = [], 0
    for name, g in sorted(materials["groups"].items(), key=lambda item: -(item[1].get("pixels") or 0)):
        if name in lamps:
            continue
        value = g.get("rho_d") or _assumed(g)
        own = g.get("rho_d") is not None
        sigma = (g.get("sigma") or {}).get("rho_d") if own else None
        against = (truths.get(name) or {}).get("rho_d") or {}
        shine = _ladder().sheen(g)
        swatch = (f'<i class="swatch" style="background:{shine + ", " if shine else ""}{css(_bytes8(T(np.array(value, float))))}"></i>' if value else '<i class="swatch none"></i>')
        cells = ""
        for c in channels:
            inner = f'<b>{fixed(value[c], 4)}</b>' if value else "–"
            if value and not own:
                inner = f'<span class=muted>{fixed(value[c], 3)}</span>'
            if sigma and _finite(sigma[c]) and sigma[c] > 0:
                inner += f' <span class=muted>± {fixed(sigma[c], 4) if sigma[c] >= 5e-5 else "&lt;0.0001"}</span>'
            if _finite((against.get("truth") or (None,) * 3)[c]):
                z = (against.get("in_sigmas") or (None,) * 3)[c]
                relative, absolute = ((against.get(k) or (None,) * 3)[c] for k in ("relative", "absolute"))
                out = _finite(z) and abs(z) > 3
                off += out
                verdict_ = "" if not own or absolute is None else (f' <span class="{"off" if out else "ok" if _finite(z) else "muted"}">'
                                                                   f'{percent(relative, 2 if abs(relative) < 0.1 else 1, True) if _finite(relative) else fixed(absolute, 4, True)}'
                                                                   f'{f", {fixed(abs(z), 1)} σ" if _finite(z) else ""}</span>')
                inner += f'<small>truth {fixed(against["truth"][c], 4)}{verdict_}</small>'
            cells += f'<td class="num" data-label="ρ{"" if len(channels) == 1 else f" {CHANNELS[c]}"}">{inner}</td>'
        kind, words = _status_words(g)
        status = f'<small><span class="pill {kind}">{esc(words)}</span></small>' if kind == "warn" else ""
        words = f'{plain(g.get("kind") or "kind unknown")}{f", {words}" if kind != "warn" else ""}'
        pixels = g.get("pixels")
        spread = _dots(value, sigma, against.get("truth"), channels) if own else ""
        rows.append(f'<tr><td class="first">{swatch}</td><th scope=row>{esc(name)}<small>{esc(words)}</small>{status}</th>{cells}'
                    f'<td class="wide">{spread}</td><td class="num" data-label="pixels">{number(pixels)}</td>'
                    f'<td class="num" data-label="display error">{percent(g.get("error"))}</td></tr>')
    head = (f'<tr><th></th><th scope=col>Group</th>{heads}<th scope=col class="wide">0 &nbsp;…&nbsp; 1</th><th scope=col class="num">Pixels</th>'
            f'<th scope=col class="num">Display error</th></tr>')
    known, every = _identified(parts)
    has_truth = any((t.get("rho_d") or {}).get("truth") for t in truths.values())
    shiny = bool(_ladder().counts(materials))
    lead = (f"Share of the light that each material reflects{' diffusely' * shiny}, per channel, with its standard deviation. The swatch is the material in full light, as this camera shows it."
            + " Mirrors, gloss and textures: the next section." * shiny)
    if has_truth and known:
        lead += " Below each value the truth and the deviation from it; " + (
            f'<span class="off">{off} channel{"s" * (off != 1)}</span> lie{"s" * (off == 1)} beyond 3 σ.' if off else '<span class="ok">every channel lies within 3 σ.</span>')
    return _section("Materials", f'<div class="scroll"><table class="cards">{f"<thead>{head}</thead>"}<tbody>{"".join(rows)}</tbody></table></div>', lead)


SCALE_WORDS = {"lamps": "The lamps’ given emittance fixes the scale of all reflectances.", "reference": "The reference groups fix the scale of all reflectances.",
               "interreflection": "No lamp and no reference was given: only the light between the surfaces fixes the scale, and the standard deviations contain that.",
               "convention": "No lamp and no reference was given, and nothing in the picture fixes the scale: by convention the lamp’s emittance is 1. Reflectances are relative."}


def _light(parts):
    materials = parts.materials or {}
    lamps = materials.get("lamps") or {}
    boxes = []
    if lamps:
        known = (parts.comparison or {}).get("lamps") or {}
        rows = ""
        grey = all(v.get("emittance") is None or len(set(v["emittance"])) == 1 for v in lamps.values())
        for name, lamp in lamps.items():
            value, sigma, against = lamp.get("emittance"), lamp.get("sigma"), known.get(name) or {}
            cells = ""
            for c in (0,) if grey else (0, 1, 2):
                inner = f'<b>{number(value[c], 4)}</b>' if value else "–"
                if value and sigma and _finite(sigma[c]):
                    inner += f' <span class=muted>± {number(sigma[c], 2)}</span>'
                relative = (against.get("relative") or (None,) * 3)[c]
                if sigma and _finite(relative):
                    out = _finite(sigma[c]) and sigma[c] > 0 and abs(value[c] - against["truth"][c]) > 3 * sigma[c]
                    inner += f'<small>truth {number(against["truth"][c], 4)} <span class="{"off" if out else "ok"}">{percent(relative, 2, True)}</span></small>'
                cells += f'<td class="num" data-label="{"E" if grey else f"E {CHANNELS[c]}"}">{inner}</td>'
            words = "estimated" if sigma else "by convention" if materials.get("scale") == "convention" else "given"
            rows += f'<tr><th scope=row>{esc(name)}</th>{cells}<td data-label="status"><span class="pill plain">{words}</span></td></tr>'
        heads = '<th scope=col class="num">E</th>' if grey else "".join(f'<th scope=col class="num">E {c}</th>' for c in CHANNELS)
        boxes.append(f'<div><h3>Lamps</h3><div class="scroll"><table class="cards"><thead><tr><th scope=col>Group</th>{heads}<th scope=col>Emittance</th></tr></thead><tbody>{rows}</tbody></table></div>'
                     f'<p class=note>{esc(SCALE_WORDS.get(materials.get("scale"), ""))} 1 is the light at which the sensor is full.</p></div>')
    transfer = materials.get("transfer") or {}
    if transfer.get("kind"):
        boxes.append(f"<div><h3>The camera’s transfer function</h3>{_transfer(parts, transfer)}</div>")
    return _section("Light and camera", f'<div class="two even">{"".join(boxes)}</div>' if boxes else "")


def _transfer(parts, transfer):
    B = np.linspace(0, 1, 81)
    T = display_function(transfer)
    series, bands, words = [("no transfer", [0, 1], [0, 1], "faint")], [], esc(plain(transfer["kind"]))
    truth = ((parts.comparison or {}).get("transfer") or {}).get("truth")
    if transfer["kind"] == "gamma" and _finite(transfer.get("gamma")):
        gamma, sigma = transfer["gamma"], transfer.get("sigma")
        words = f"γ = <b>{esc(pm(gamma, sigma, 3))}</b>" + ("" if sigma else f" ({_without_sigma(parts.materials or {})})")
        if truth and _finite(truth.get("gamma")):
            words += f', truth {fixed(truth["gamma"], 3)}'
        if _finite(sigma) and 0 < 3 * sigma < gamma:
            bands.append((B, B ** (1 / (gamma - 3 * sigma)), B ** (1 / (gamma + 3 * sigma))))
    if transfer["kind"] == "linear" and (truth or transfer).get("kind") == "linear":
        return "<p class=note>Linear: what is displayed is the light itself, nothing to find.</p>"
    series.append(("found", B, T(B), "a"))
    if truth and truth.get("kind") in ("gamma", "linear", "srgb", "curve"):
        series.append(("truth", B, display_function(truth)(B), "dash"))
    return _plot(series, x="light at the sensor", y="displayed value", title="The camera's transfer function", xlim=(0, 1), ylim=(0, 1), bands=bands, dots=False,
                 height=320) + f"<p class=note>{words}{'; the band is 3 σ wide on either side' if bands else ''}</p>"


def _buffers(parts, width):
    width = min(width, 960)
    large, figures, names = [], [], (parts.legend or {}).get("groups") or []
    h_w = next((v.shape[:2] for v in (parts.group, parts.object, parts.facet, parts.trusted, parts.hidden, parts.depth) if v is not None), None)
    if h_w is None:
        return ""
    legend = ""
    if parts.group is not None:
        count = np.bincount(parts.group.ravel(), minlength=len(names) + 1)
        seen = [i for i in np.argsort(-count[1:], kind="stable") if count[i + 1] > 0] if names else []
        palette = colours(len(count) - 1)
        legend = "<p class=keys>" + "".join(f'<span><i class=key style="background:{css(palette[i])}"></i>{esc(names[i]) if i < len(names) else i + 1}'
                                            f'<em>{percent(count[i + 1] / parts.group.size, 1)}</em></span>' for i in seen[:40]) + "</p>"
        large.append(_figure(uri(_smaller(paint(parts.group), width, nearest=True)), "<b>Groups</b>: what shares one material", "Group index buffer"))
    for key, name, words in (("object", "Objects", "things of the model"), ("facet", "Facets", "flat parts; light varies smoothly within one")):
        value = getattr(parts, key)
        if value is not None:
            figures.append(_figure(uri(_smaller(paint(value), width, nearest=True)), f"<b>{name}</b>: {len(np.unique(value[value > 0])):,} seen; {words}", f"{name} index buffer"))
    if parts.hidden is not None:
        lines = _smaller((~parts.hidden.astype(bool)).astype(np.uint8) * 255, width)
        figures.append(_figure(uri(lines), "<b>Hidden surfaces removed</b>: the edges that remain visible", "Visible edges of the model"))
    if parts.trusted is not None:
        share = float(np.mean(parts.trusted))
        caption = f"<b>Trusted pixels</b>: {percent(share)} of the picture"
        if parts.photograph is not None and parts.photograph.shape[:2] == parts.trusted.shape:
            base = _three(parts.photograph)
            grey = base.mean(axis=2, keepdims=True)
            over = np.where(parts.trusted.astype(bool)[..., None], base * 0.72 + np.array([0.0, 0.28, 0.20]), grey * 0.38 + 0.06)
            large.append(_figure(uri(_smaller(_bytes8(over), width), photo=True), caption + ", tinted; the others do not take part", "Trusted pixels over the photograph"))
        else:
            large.append(_figure(uri(_smaller(parts.trusted.astype(np.uint8) * 255, width, nearest=True)), caption, "Trusted pixels"))
    if parts.depth is not None and (np.isfinite(parts.depth) & (parts.depth > 0)).any():
        some = (parts.depth > 0) & np.isfinite(parts.depth)
        near, far = float(parts.depth[some].min()), float(parts.depth[some].max())
        shade = np.where(some, 1 - 0.9 * (np.where(some, parts.depth, near) - near) / max(far - near, 1e-12), 0)
        figures.append(_figure(uri(_smaller(_bytes8(shade), width), photo=True), f"<b>Depth</b>: {number(near)} m (bright) to {number(far)} m", "Depth"))
    return _section("What each pixel shows", (f'<div class="two even">{"".join(large)}</div>' if large else "") + legend + (f'<div class="grid4">{"".join(figures)}</div>' if figures else ""), "The model drawn from the camera’s place, beside the photograph.")


def _convergence(parts):
    plots = []
    for stage, report in parts.reports.items():
        trace = [t for t in report.get("trace") or [] if isinstance(t, dict) and _finite(t.get("cpu_s"))]
        if len(trace) < 2:
            continue
        first = min((t["cpu_s"] for t in trace if t["cpu_s"] > 0), default=1e-3)
        seconds = [max(t["cpu_s"], first) for t in trace]
        keys = [k for k in dict.fromkeys(k for t in trace for k in t) if k not in ("cpu_s", "wall_s", "iteration")]
        # whole numbers are counts (places, patches), not errors
        keys = [k for k in keys if any(isinstance(t.get(k), float) for t in trace)]
        errors = [k for k in keys if "gamma" not in k][:6]
        figure = _plot([(plain(k), seconds, [t.get(k) for t in trace], "abcdef"[i]) for i, k in enumerate(errors)], x="CPU seconds", y="error" if len(errors) != 1 else plain(errors[0]),
                       title=f"{stage}: error against CPU time", logx=True, logy=True)
        if figure:
            plots.append(f"<div><h3>{esc(stage)}</h3>{figure}</div>")
        for k in keys:
            if "gamma" in k and len({t.get(k) for t in trace}) > 1:
                figure = _plot([(plain(k), seconds, [t.get(k) for t in trace], "a")], x="CPU seconds", y=plain(k), title=f"{stage}: {plain(k)} against CPU time", logx=True)
                plots += [f"<div><h3>{esc(stage)}: {esc(plain(k))}</h3>{figure}</div>"] if figure else []
    return _section("Convergence", f'<div class="two even">{"".join(plots)}</div>' if plots else "",
                    "What each stage can see of its error while it works; measuring it is not timed. A small residual alone is no proof of the reflectances.")


MODEL_WORDS = {"gamma": "gamma", "srgb": "sRGB", "linear": "linear", "linear_per_group": "linear, per group", "histogram": "histogram",
               "histogram_per_group": "histogram, per group", "curve": "curve"}


def _models(parts):
    rows = next((r["transfer_models"] for stage in ("render", "fit") if (r := parts.reports.get(stage) or {}) and isinstance(r.get("transfer_models"), list)), None)
    rows = [r for r in rows or [] if isinstance(r, dict)]
    if not rows:
        return ""
    again = any(_finite(r.get("rmse_rescaled")) for r in rows)
    body = "".join(f'<tr><th scope=row>{esc(MODEL_WORDS.get(r.get("kind"), plain(r.get("kind"))))}</th><td class=num data-label="RMSE">{percent(r.get("rmse"))}</td>'
                   + (f'<td class=num data-label="reflectances refitted">{percent(r.get("rmse_rescaled"))}</td>' if again else "")
                   + f'<td class="remark">{esc(r.get("note") or "")}</td></tr>' for r in rows)
    heads = "<th scope=col class=num>Reflectances refitted</th>" if again else ""
    return _section("Transfer models compared", f'<div class="scroll"><table class="cards"><thead><tr><th scope=col>Model</th><th scope=col class=num>RMSE</th>{heads}<th scope=col>Note</th></tr></thead>'
                    f"<tbody>{body}</tbody></table></div>", "The same light shown through other transfer functions, and how far each picture stays from the photograph.")


def _times(parts):
    rows, total = [], {"cpu_s": 0.0, "wall_s": 0.0, "imports_s": 0.0, "compile_s": 0.0}
    longest = max((r.get("cpu_s") or 0 for r in parts.reports.values()), default=0) or 1
    for stage, r in parts.reports.items():
        for k in total:
            total[k] += r.get(k) if _finite(r.get(k)) else 0
        status = r.get("status") or "–"
        kind = {"converged": "good", "complete": "plain"}.get(status, "warn")
        cells = "".join(f'<td class=num data-label="{label}">{fixed(r.get(k), 2)}</td>' for k, label in (("cpu_s", "CPU s"), ("wall_s", "clock s"), ("imports_s", "imports s"), ("compile_s", "compilation s")))
        rows.append(f'<tr><th scope=row>{esc(stage)}</th>{cells}<td class=num data-label="peak MB">{number(round(r["peak_mb"])) if _finite(r.get("peak_mb")) else "–"}</td>'
                    f'<td class="meter wide"><i style="width:{_n(100 * (r.get("cpu_s") or 0) / longest)}%"></i></td><td data-label="status"><span class="pill {kind}">{esc(status)}</span></td></tr>')
    if not rows:
        return ""
    sums = "".join(f'<td class=num data-label="{label}">{fixed(total[k], 2)}</td>' for k, label in (("cpu_s", "CPU s"), ("wall_s", "clock s"), ("imports_s", "imports s"), ("compile_s", "compilation s")))
    head = "".join(f"<th scope=col class=num>{h}</th>" for h in ("CPU s", "Clock s", "Imports s", "Compilation s", "Peak MB"))
    return _section("Time", f'<div class="scroll"><table class="cards"><thead><tr><th scope=col>Stage</th>{head}<th class="wide"></th><th scope=col>Status</th></tr></thead><tbody>{"".join(rows)}</tbody>'
                    f'<tfoot><tr><th scope=row>all</th>{sums}<td></td><td class="wide"></td><td></td></tr></tfoot></table></div>', "Imports and compilation (kept after the first run) are listed apart and count in neither of the first two columns.")


def _stage_errors(parts):
    rows = [(stage, e) for stage, r in parts.reports.items() for e in r.get("errors") or [] if isinstance(e, dict)]
    rows += [(e.get("stage") or "", e) for e in (parts.comparison or {}).get("errors") or []]
    if not rows:
        return ""
    body = "".join(f'<tr><td data-label="stage">{esc(stage)}</td><th scope=row>{esc(plain(e.get("name")))}</th><td class=num data-label="value">{number(e.get("value"), 3)}</td>'
                   f'<td data-label="unit">{esc("" if e.get("unit") in (None, "1") else e["unit"])}</td><td data-label="against">{esc(e.get("against") or "")}</td></tr>' for stage, e in rows)
    return (f'<details><summary>All errors, with their yardsticks ({len(rows)})</summary><div class="scroll"><table class="cards"><thead><tr><th scope=col>Stage</th><th scope=col>Error</th>'
            f"<th scope=col class=num>Value</th><th scope=col>Unit</th><th scope=col>Against</th></tr></thead><tbody>{body}</tbody></table></div></details>")


def _warnings(parts):
    items = [f"<li><b>{esc(stage)}</b> {esc(text)}</li>" for stage, r in parts.reports.items() for text in r.get("warnings") or []]
    return _section("Warnings", f"<ul class=warnings>{''.join(items)}</ul>" if items else "")


def _made(parts):
    blocks = []
    for stage, r in parts.reports.items():
        arguments = {k: v for k, v in (r.get("arguments") or {}).items() if v is not None}
        pairs = "".join(f"<dt>{esc(k)}</dt><dd>{esc(v if isinstance(v, str) else _json(v))}</dd>" for k, v in arguments.items())
        sums = "".join(f"<dt>{esc(p)}</dt><dd><code>{esc(s)}</code></dd>" for p, s in (r.get("inputs") or {}).items())
        versions = ", ".join(f"{esc(k)} {esc(v)}" for k, v in (r.get("versions") or {}).items())
        blocks.append(f"<h3>{esc(stage)}</h3><dl class=pairs>{pairs}</dl>" + (f"<h4>Inputs (SHA-256)</h4><dl class=pairs>{sums}</dl>" if sums else "")
                      + (f"<p class=note>{versions}</p>" if versions else ""))
    made = f"<details><summary>Arguments, versions, inputs of every stage</summary>{''.join(blocks)}</details>" if blocks else ""
    out = "".join(f"<li><b>{esc(stage)}</b> {esc(why)}</li>" for stage, why in parts.plan)
    out = f"<h3>Left out</h3><p class=note>What this scene does not need is not run.</p><ul class=plainlist>{out}</ul>" if out else ""
    chain = " <i>→</i> ".join(esc(s) for s in parts.reports)
    return _section("How it was made", (f"<p class=chain>{chain}</p>" if chain else "") + _stage_errors(parts) + made + out)


def _json(value):
    import json
    return json.dumps(value, ensure_ascii=False)


# ---- the page ----

STYLE = """
:root{color-scheme:light dark;--paper:#fbfbf9;--card:#fff;--ink:#1d1f21;--muted:#6c7075;--line:#e3e3de;--accent:#0b6b6b;
--good:#1f7a4a;--good-bg:#e4f3ea;--warn:#8a5a00;--warn-bg:#fbf0d9;--bad:#b3261e;--bad-bg:#fbe6e4;--r:#c43d3d;--g:#2b8a57;--b:#3a6cc8;--plain-bg:#eeeeea;
--a:#0b6b6b;--c2:#c4622d;--c3:#5a55b5;--c4:#a3741a;--c5:#b0417c;--c6:#4d7a2b}
@media (prefers-color-scheme:dark){:root{--paper:#15171a;--card:#1c1f23;--ink:#e8e9ea;--muted:#9aa0a6;--line:#30343a;--accent:#5cc4bf;
--good:#6fcf97;--good-bg:#173324;--warn:#e6b455;--warn-bg:#392c10;--bad:#f28b82;--bad-bg:#40201d;--r:#ef7a7a;--g:#6ccb97;--b:#85aef5;--plain-bg:#2a2e33;
--a:#5cc4bf;--c2:#f0955f;--c3:#a9a4f5;--c4:#dcb15a;--c5:#ec8fc0;--c6:#a3cf7d}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%;scroll-behavior:smooth}
body{margin:0;background:var(--paper);color:var(--ink);font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif;font-variant-numeric:tabular-nums}
main,header,footer{max-width:1120px;margin:0 auto;padding:0 24px}
header{padding-top:48px;padding-bottom:24px}
.eyebrow{margin:0;color:var(--muted);font-size:14px}
h1{font-size:clamp(30px,5vw,44px);line-height:1.1;letter-spacing:-.02em;margin:6px 0 14px;font-weight:650;overflow-wrap:anywhere;display:flex;gap:14px;align-items:center;flex-wrap:wrap}
.verdict{font-size:clamp(17px,2.2vw,20px);line-height:1.5;max-width:62ch;margin:0}
h2{font-size:24px;letter-spacing:-.01em;margin:0 0 6px;font-weight:650}
h3{font-size:16px;margin:0 0 10px;font-weight:650}
h4{font-size:14px;margin:14px 0 4px;color:var(--muted);font-weight:600}
section{padding:36px 0 8px;border-top:1px solid var(--line);margin-top:40px}
.lead{color:var(--muted);max-width:74ch;margin:0 0 22px}
.note,small{color:var(--muted);font-size:13.5px}
.note{margin:8px 0 0;max-width:64ch}
.muted{color:var(--muted)}.ok{color:var(--good)}.off{color:var(--bad);font-weight:600}
.badge,.pill{display:inline-block;border-radius:999px;font-weight:600;white-space:nowrap}
.badge{font-size:14px;padding:4px 13px;letter-spacing:0;line-height:1.5}
.pill{font-size:12.5px;padding:2px 10px;white-space:normal;border-radius:11px;line-height:1.4}
.good{color:var(--good);background:var(--good-bg)}.warn{color:var(--warn);background:var(--warn-bg)}.bad{color:var(--bad);background:var(--bad-bg)}.pill.plain{color:var(--muted);background:var(--plain-bg)}
figure{margin:0}
img{display:block;width:100%;height:auto;border-radius:8px;background:var(--plain-bg)}
figcaption{color:var(--muted);font-size:13.5px;margin-top:8px}
figcaption b{color:var(--ink);font-weight:600}
.hero{display:grid;grid-template-columns:minmax(0,1fr) 284px;gap:36px;align-items:start}
.hero.one{grid-template-columns:minmax(0,1fr)}
.hero.one .facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(200px,1fr));gap:0 28px}
.facts{margin:0}
.facts div{padding:13px 0;border-bottom:1px solid var(--line)}
.facts div:first-child{padding-top:0}
.facts dt{color:var(--muted);font-size:14px}
.facts dd{margin:0;font-size:26px;font-weight:650;letter-spacing:-.01em;line-height:1.25}
.facts small{display:block;font-weight:400;letter-spacing:0;line-height:1.4;margin-top:2px}
.pair{position:relative;border-radius:10px;overflow:hidden;touch-action:pan-y;cursor:ew-resize;user-select:none;-webkit-user-select:none;--at:50%;background:var(--plain-bg)}
.pair img{position:absolute;inset:0;width:100%;height:100%;border-radius:0;pointer-events:none}
.pair .over{clip-path:inset(0 0 0 var(--at))}
.pair .tag{position:absolute;bottom:12px;background:rgba(0,0,0,.62);color:#fff;font-size:12.5px;padding:3px 11px;border-radius:999px;pointer-events:none}
.tag.left{left:12px}.tag.right{right:12px}
.rule{position:absolute;top:0;bottom:0;left:var(--at);width:2px;margin-left:-1px;background:#fff;box-shadow:0 0 4px rgba(0,0,0,.5);pointer-events:none}
.rule i{position:absolute;top:50%;left:50%;width:40px;height:40px;margin:-20px 0 0 -20px;border-radius:50%;background:#fff;box-shadow:0 1px 6px rgba(0,0,0,.45)}
.rule i:before,.rule i:after{content:"";position:absolute;top:14px;border:6px solid transparent}
.rule i:before{left:5px;border-right-color:#333;border-left-width:0;left:9px}.rule i:after{right:9px;border-left-color:#333;border-right-width:0}
.pair input{position:absolute;inset:0;width:100%;height:100%;margin:0;opacity:0;cursor:ew-resize;pointer-events:none}
.pair:has(input:focus-visible){outline:3px solid var(--accent);outline-offset:3px}
.two{display:grid;grid-template-columns:minmax(0,2fr) minmax(0,1fr);gap:36px}
.two.even{grid-template-columns:repeat(2,minmax(0,1fr));gap:36px 48px}
.grid4{display:grid;grid-template-columns:repeat(auto-fit,minmax(220px,1fr));gap:24px;margin-top:28px}
.scale i{display:block;height:14px;border-radius:4px;margin-top:4px}
.scale p{display:flex;justify-content:space-between;margin:6px 0 26px;font-size:13.5px;color:var(--muted);line-height:1.35}
.scale span:last-child{text-align:right}
.keys{display:flex;flex-wrap:wrap;gap:6px 18px;margin:16px 0 0;font-size:14px}
.keys span{display:inline-flex;align-items:center;gap:7px}
.keys em{font-style:normal;color:var(--muted);font-size:13px}
.key{width:13px;height:13px;border-radius:4px;display:inline-block;background:var(--a)}
.scroll{overflow-x:auto}
table{border-collapse:collapse;width:100%;font-size:14.5px}
th{font-weight:600;text-align:left}
thead th{color:var(--muted);font-size:13px;font-weight:500;padding:0 12px 8px 0;vertical-align:bottom}
tbody td,tbody th,tfoot td,tfoot th{padding:11px 11px 11px 0;border-top:1px solid var(--line);vertical-align:middle}
tfoot td,tfoot th{font-weight:600}
td small,th small{display:block;font-weight:400;white-space:nowrap;font-size:12.5px}
td b{font-weight:600}
.num{text-align:right;white-space:nowrap}
.plain td,.plain th{padding:6px 12px 6px 0}
.meter{width:36%;min-width:70px}
.meter i{display:block;height:7px;border-radius:4px;background:var(--accent);opacity:.75;min-width:1px}
.swatch{display:block;width:38px;height:38px;border-radius:8px;box-shadow:inset 0 0 0 1px rgba(128,128,128,.35)}
.swatch.none{background:repeating-linear-gradient(45deg,var(--line) 0 4px,transparent 4px 8px)}
.first{width:50px}
th small .pill{margin-top:4px}
.spread{display:block}
svg text{fill:var(--muted);font-size:12px}
svg .label{fill:var(--ink);font-size:12.5px}
.plot{display:block;width:100%;max-width:480px;height:auto}
.grid{stroke:var(--line);stroke-width:1}
.line{fill:none;stroke:var(--a);stroke-width:2;stroke-linejoin:round}
.dot{fill:var(--a)}
.band{fill:var(--a);opacity:.22}
.line.faint{stroke:var(--line);stroke-width:1.5}.key.faint{background:var(--line)}
.line.dash{stroke:var(--c2);stroke-dasharray:5 4}.key.dash{background:var(--c2)}
.line.b{stroke:var(--c2)}.dot.b,.key.b{fill:var(--c2);background:var(--c2)}.line.c{stroke:var(--c3)}.dot.c,.key.c{fill:var(--c3);background:var(--c3)}
.line.d{stroke:var(--c4)}.dot.d,.key.d{fill:var(--c4);background:var(--c4)}.line.e{stroke:var(--c5)}.dot.e,.key.e{fill:var(--c5);background:var(--c5)}
.line.f{stroke:var(--c6)}.dot.f,.key.f{fill:var(--c6);background:var(--c6)}
.spread .dot.r{fill:var(--r)}.spread .dot.g{fill:var(--g)}.spread .dot.b{fill:var(--b)}.spread .dot.grey{fill:var(--ink)}
.bar3{stroke-width:4;stroke-linecap:round;opacity:.35}.bar3.r{stroke:var(--r)}.bar3.g{stroke:var(--g)}.bar3.b{stroke:var(--b)}.bar3.grey{stroke:var(--ink)}
.true{stroke:var(--ink);stroke-width:1.5}
details{border-top:1px solid var(--line);padding:12px 0}
summary{cursor:pointer;font-weight:600}
details[open] summary{margin-bottom:14px}
details h3{margin-top:22px}
.pairs{display:grid;grid-template-columns:minmax(110px,max-content) minmax(0,1fr);gap:2px 20px;margin:0;font-size:13.5px}
.pairs dt{color:var(--muted);overflow-wrap:anywhere}.pairs dd{margin:0;overflow-wrap:anywhere}
code{font:12.5px ui-monospace,SFMono-Regular,Menlo,Consolas,monospace}
.chain{font-weight:600}.chain i{color:var(--muted);font-style:normal;font-weight:400}
.warnings,.plainlist{margin:0;padding-left:18px}.warnings li,.plainlist li{margin:4px 0}
details~h3{margin-top:22px}
footer{color:var(--muted);font-size:13.5px;padding-top:36px;padding-bottom:56px}
@media (max-width:860px){.hero,.two,.two.even{grid-template-columns:minmax(0,1fr);gap:28px}.hero .facts{display:grid;grid-template-columns:repeat(auto-fit,minmax(200px,1fr));gap:0 28px}.facts div:first-child{padding-top:13px}}
@media (max-width:1060px){.wide{display:none}}
@media (max-width:700px){main,header,footer{padding-left:16px;padding-right:16px}header{padding-top:28px}section{margin-top:28px;padding-top:26px}
.grid4{grid-template-columns:repeat(2,minmax(0,1fr));gap:16px}
.cards thead{display:none}
.cards,.cards tbody,.cards tfoot,.cards tr,.cards td,.cards th{display:block;width:auto}
.cards tr{position:relative;border-top:1px solid var(--line);padding:12px 0}
.cards td,.cards th{border:0;padding:2px 0;text-align:left;white-space:normal}
.cards th small{display:inline;margin-left:8px}
.cards td[data-label]{display:flex;justify-content:space-between;gap:16px;text-align:right}
.cards td[data-label]:before{content:attr(data-label);color:var(--muted);font-size:13.5px;flex:none}
.cards td[data-label] small{display:block;white-space:normal}
.cards td.num[data-label]{display:block;padding-left:84px;position:relative;min-height:1.6em}
.cards td.num[data-label]:before{position:absolute;left:0}
.cards .remark{color:var(--muted);font-size:13.5px}
.cards td:empty,.cards .wide{display:none}
.cards .first{position:absolute;right:0;top:12px;width:auto}
.cards .first+th{min-height:40px;padding-right:56px}}
@media print{body{background:#fff}section{break-inside:avoid}.rule i{display:none}}
"""

SCRIPT = """
for (const pair of document.querySelectorAll('.pair')) {
  const input = pair.querySelector('input');
  const show = () => pair.style.setProperty('--at', input.value + '%');
  const move = event => {
    const box = pair.getBoundingClientRect();
    input.value = Math.max(0, Math.min(100, 100 * (event.clientX - box.left) / box.width));
    show();
  };
  input.step = 'any';
  input.addEventListener('input', show);
  input.addEventListener('keydown', event => {
    const step = {ArrowLeft: -2, ArrowDown: -2, ArrowRight: 2, ArrowUp: 2, PageDown: -20, PageUp: 20}[event.key];
    if (step === undefined) return;
    event.preventDefault();
    input.value = Number(input.value) + step;
    show();
  });
  pair.addEventListener('pointerdown', event => { if (event.button) return; pair.setPointerCapture(event.pointerId); input.focus({preventScroll: true}); move(event); });
  pair.addEventListener('pointermove', event => { if (pair.hasPointerCapture(event.pointerId)) move(event); });
  show();
}
"""


def build(parts, limit_bytes=LIMIT_BYTES):
    """The page as a string, of at most limit_bytes (as long as the smallest pictures allow it)."""
    for width in WIDTHS_PX:
        text = _build(parts, width)
        if len(text.encode()) <= limit_bytes:
            break
    return text


def _vision():
    from lib import vision_page                      # which imports this module
    return vision_page


def _ladder():
    from lib import ladder_page                      # likewise
    return ladder_page


def _build(parts, width):
    kind, badge, sentence = verdict(parts)
    about = "geometry from two photographs" if parts.vision and not parts.materials else "materials and light from one photograph" if not parts.vision else "geometry, materials and light from two photographs"
    seeing = _vision().sections(parts.vision, width) if parts.vision else ""
    ladder = _ladder().section(parts)
    body = "".join([_hero(parts, width), _difference(parts, width), _materials(parts), ladder, _light(parts), _models(parts), seeing, _buffers(parts, width), _convergence(parts),
                    _times(parts), _warnings(parts), _made(parts)])
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<title>{esc(parts.scene)}: {about}</title>
<style>{STYLE}{_vision().STYLE if seeing else ''}{_ladder().STYLE if ladder else ''}</style>
</head>
<body>
<header><p class="eyebrow">{about[0].upper() + about[1:]}</p><h1>{esc(parts.scene)} <span class="badge {kind}">{esc(badge)}</span></h1><p class="verdict">{esc(sentence)}</p></header>
<main>{body}</main>
<footer>Made by anasyn. This page is one file and loads nothing from the network.</footer>
<script>{SCRIPT}</script>
</body>
</html>
"""
