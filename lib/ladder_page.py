"""The section of report.html that shows the reflectance ladder: how each surface reflects, and what its error asked for.

`section(parts)` takes page.Parts: what `fit` says of the climb in its report, the groups of materials.json, thumbnails of
textures (`thumbnail`), and the truth where `compare` knew it. Groups that climbed get a row each; those that stayed diffuse
a bar each, which ends at the threshold.
"""
from __future__ import annotations

import math
import re

import numpy as np

from lib.page import CHANNELS, _bytes8, _finite, _n, _section, css, display_function, esc, fixed, number, percent, plain, pm, uri

RUNGS = ("diffuse", "mirror", "coloured_mirror", "glossy", "anisotropic", "textured")
WORDS = {"mirror": "perfect mirror", "anisotropic": "glossy, anisotropic"}
MIRRORS = ("mirror", "coloured_mirror")
MOST = 6                                         # textures shown of a group, the largest facets first


def word(rung):
    return WORDS.get(rung) or plain(rung)


def sheen(group):
    """CSS background that tells a surface which is not diffuse from one that is, its own colour apart; None for a diffuse one."""
    kind, rho_s = group.get("kind"), group.get("rho_s") or (0, 0, 0)
    tint = css(_bytes8(np.array([min(max(v, 0), 1) if _finite(v) else 0 for v in rho_s]) ** 0.45))
    if kind in MIRRORS:
        return f"linear-gradient(135deg, #7d8790 0 18%, {tint} 40%, #aab3ba 52%, {tint} 66%, #6f7880 90%)"
    if kind != "glossy":
        return None
    wide, high = (_n(100 * min(max(3 * a, 0.12), 0.9)) if _finite(a) else "40" for a in group.get("alpha") or (0.1, 0.1))
    return f"radial-gradient(ellipse {wide}% {high}% at 40% 36%, rgba(255,255,255,.95), rgba(255,255,255,0))"


def counts(materials):
    """Of the groups that are not diffuse how many are what; "" where all are.

    >>> counts({"groups": {"a": {"kind": "mirror"}, "b": {"kind": "glossy"}, "c": {"kind": "glossy"}, "d": {"kind": "diffuse"}}})
    '1 mirror, 2 glossy'
    """
    kinds = [g.get("kind") for g in ((materials or {}).get("groups") or {}).values()]
    found = [(kinds.count(k), plain(k) + "s" * (k in MIRRORS and kinds.count(k) > 1)) for k in RUNGS[1:]]
    return ", ".join(f"{n} {what}" for n, what in found if n)


def thumbnail(texture, largest=240):
    """A texture as the page shows it: {"picture": (h, w, 3) uint8 in the proportions of the facet, "size_m", "known"}."""
    import cv2

    a, b, c = texture.corners
    size = np.linalg.norm(b - a), np.linalg.norm(c - a)
    shape = np.maximum(1, np.round(largest * np.array(size) / max(*size, 1e-12))).astype(int)
    seen = np.ascontiguousarray(np.swapaxes(texture.albedo, 0, 1)[::-1], np.float32)
    seen = np.broadcast_to(seen, (*seen.shape[:2], 3))
    small = cv2.resize(np.ascontiguousarray(seen), tuple(int(n) for n in shape), interpolation=cv2.INTER_AREA)
    known = float((texture.known * texture.inside).sum() / max(texture.inside.sum(), 1e-12))
    return {"picture": _bytes8(display_function({"kind": "srgb"})(small.reshape(*shape[::-1], 3))), "size_m": [float(s) for s in size], "known": known}


# ---- small pictures ----

def stairs(rung, tried):
    """The ladder as six steps: the one that was reached is full, those that were tried and left are outlines; what was never tried is faint."""
    step, width, height = 15, 92, 34
    out = [f'<svg class="stairs" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" aria-label="{esc(word(rung))}">']
    for i, name in enumerate(RUNGS):
        high = 5 + 5 * i
        kind = "reached" if name == rung else "tried" if name in tried else "passed"
        out.append(f'<rect class="{kind}" x="{step * i + 1}" y="{height - 1 - high}" width="{step - 4}" height="{high}" rx="2"/>')
    return "".join(out) + "</svg>"


def _range(values):
    """Decimal exponents that hold all values, at least two apart."""
    logs = [math.log10(v) for v in values if _finite(v) and v > 1e-12]
    low, high = (math.floor(min(logs)), math.ceil(max(logs) + 1e-9)) if logs else (-3, -1)
    return max(low, high - 5), max(high, low + 2)


def track(before, after, threshold, low, high):
    """A group's error on a logarithmic line: a ring for it as diffuse, a dot for it in the end, a tick at the threshold."""
    width, height = 190, 20
    X = lambda v: 7 + (min(max(math.log10(max(v, 1e-12)), low), high) - low) / (high - low) * (width - 14)
    out = [f'<svg class="track" viewBox="0 0 {width} {height}" width="{width}" height="{height}" aria-hidden="true"><line class="grid" x1="7" x2="{width - 7}" y1="10" y2="10"/>']
    if _finite(threshold) and threshold > 0:
        out.append(f'<line class="limit" x1="{_n(X(threshold))}" x2="{_n(X(threshold))}" y1="2" y2="18"/>')
    if _finite(before) and _finite(after):
        out.append(f'<line class="way" x1="{_n(X(before))}" x2="{_n(X(after))}" y1="10" y2="10"/>')
    out += [f'<circle class="{kind}" cx="{_n(X(v))}" cy="10" r="4.5"/>' for kind, v in (("ring", before), ("end", after)) if _finite(v)]
    return "".join(out) + "</svg>"


# ---- what was found ----

def _verdict(deviation, i):
    """The truth of one number, and how far off it is."""
    truth = (deviation.get("truth") or ())[i:i + 1]
    if not truth or not _finite(truth[0]):
        return ""
    off, z = ((deviation.get(key) or (None,) * 3)[i] for key in ("absolute", "in_sigmas"))
    said = f"{fixed(abs(z), 1)} σ" if _finite(z) else fixed(off, 4, True) if _finite(off) else ""
    return f'<small>truth {fixed(truth[0], 4)} <span class="{"off" if _finite(z) and abs(z) > 3 else "ok" if _finite(z) else "muted"}">{said}</span></small>'


def _sigma(value, decimals=4, unit=""):
    return f' <span class="muted">± {fixed(value, decimals) if value >= 0.5 * 10 ** -decimals else "&lt;" + fixed(10 ** -decimals, decimals)}{unit}</span>' if _finite(value) and value > 0 else ""


def _values(label, values, sigma, deviation, names=CHANNELS):
    """A line of numbers with their sigma and truth; one where all are equal."""
    if not values or not all(map(_finite, values)):
        return ""
    once = len({*map(str, values)}) == 1 and len({*map(str, deviation.get("truth") or (0,))}) == 1
    cells = "".join(f'<span>{"" if once else f"<i>{names[i]}</i>"}<b>{fixed(v, 4)}</b>{_sigma(s)}{_verdict(deviation, i)}</span>'
                    for i, (v, s) in enumerate(zip(values, sigma or (None,) * len(values))) if not (once and i))
    return f"<dt>{label}</dt><dd>{cells}</dd>"


def _direction(tangent, sigma_rad, deviation):
    if not tangent or not all(map(_finite, tangent)):
        return ""
    sigma = _sigma(math.degrees(sigma_rad), 2, "°") if _finite(sigma_rad) else ""
    off, z = ((deviation.get(key) or (None,))[0] for key in ("degrees", "in_sigmas"))
    truth = deviation.get("truth")
    against = f'<small>truth ({", ".join(fixed(v, 2) for v in truth)}) <span class="{"off" if _finite(z) and z > 3 else "ok"}">{number(off, 2)}° off</span></small>' if truth and _finite(off) else ""
    return f'<dt>x along</dt><dd><span class="wide3"><b>({", ".join(fixed(v, 2) for v in tangent)})</b>{sigma}{against}</span></dd>'


def _parameters(group, known):
    """rho_s, alpha and tangent of a group that has them."""
    sigma, kind, alpha = group.get("sigma") or {}, group.get("kind"), group.get("alpha")
    out = ""
    if kind == "mirror" and group.get("rho_s") == [1.0, 1.0, 1.0]:
        out += "<dt>ρ<sub>s</sub></dt><dd><span class=wide3><b>1</b> <span class=muted>all light, as the word says</span></span></dd>"
    elif kind in MIRRORS or kind == "glossy":
        out += _values("ρ<sub>s</sub>", group.get("rho_s"), sigma.get("rho_s"), known.get("rho_s") or {})
    out += _values("α", alpha, sigma.get("alpha"), known.get("alpha") or {}, ("x", "y"))
    out += _direction(group.get("tangent"), sigma.get("tangent_rad"), known.get("tangent") or {})
    return f"<dl class=shape>{out}</dl>" if out else ""


def _largest(thumbs):
    """[(facet, thumbnail)], the largest facets first."""
    return sorted(thumbs.items(), key=lambda item: -math.prod(item[1]["size_m"]))


def _pictures(name, thumbs, known):
    """The textures of a group, the largest facets first."""
    if not thumbs:
        return ""
    thumbs = _largest(thumbs)
    figures = ""
    for facet, t in thumbs[:MOST]:
        seen = f", {percent(t['known'], 0)} of it told by the photograph" if t["known"] < 0.95 else ""
        figures += (f'<figure><img src="{uri(t["picture"], photo=True)}" alt="Albedo of a facet of {esc(name)}" loading="lazy">'
                    f'<figcaption>facet {facet}, {number(t["size_m"][0], 2)} × {number(t["size_m"][1], 2)} m{seen}</figcaption></figure>')
    more = f"<p class=note>{len(thumbs) - MOST} smaller ones are not shown.</p>" if len(thumbs) > MOST else ""
    off = f'<p class=note>The albedo is off the truth by {percent(known["rmse"])} rms, over the {number(known.get("pixels"))} pixels that show it.</p>' if _finite(known.get("rmse")) else ""
    return f'<div class="albums">{figures}</div>{more}{off}'


def _row(parts, name, group, rung, errors, limits):
    ladder = group.get("ladder") or {}
    before, after, threshold = errors
    tried = {"diffuse", *(str(t.get("rung")) for t in ladder.get("tried") or [] if isinstance(t, dict))}
    if rung == "textured" and "given" not in str(ladder.get("why")):     # only then: what neither a mirror nor a lobe explains
        tried |= {"mirror", "coloured_mirror", "glossy"}
    album = (parts.textures or {}).get(name) or {}
    known = ((parts.comparison or {}).get("groups") or {}).get(name) or {}
    T = display_function((parts.materials or {}).get("transfer"), parts.linear)
    rho = group.get("rho_d")
    base = css(_bytes8(T(np.array(rho, float)))) if rho and all(map(_finite, rho)) else "var(--plain-bg)"
    shine = sheen(group)
    truth = known.get("kind") or ()
    wrong = f'<small><span class="pill warn">in truth {esc(plain(truth[1]))}</span></small>' if len(truth) == 2 and truth[0] != truth[1] else ""
    said = f'<b>{percent(before)}</b> <i>→</i> <b class="{"off" if _finite(threshold) and _finite(after) and after > threshold else "ok"}">{percent(after)}</b>'
    why = re.sub(r"\b\d\.\d{4}\b", lambda m: percent(float(m[0])), str(ladder.get("why") or ""))     # errors have four decimals there
    why = why.replace("rho_s", "ρₛ").replace("_", " ")
    reason = f"<p class=note>{esc(why[:1].upper() + why[1:])}.</p>" if why else ""
    ball = f'<i class="ball" style="background:{f"{shine}, {base}" if shine else base}"></i>'
    if album:
        ball = f'<img class="ball" src="{uri(_largest(album)[0][1]["picture"], photo=True)}" alt="">'
    return (f'<article>{ball}'
            f'<div class="who"><h3>{esc(name)}<small>{esc(word(rung))}</small></h3>{wrong}{stairs(rung, tried)}</div>'
            f'<div class="error">{track(before, after, threshold, *limits)}<p>{said}</p></div>{_parameters(group, known) or "<div></div>"}'
            f'<div class="reason">{reason}'
            f'{_pictures(name, album, ((parts.comparison or {}).get("textures") or {}).get(name) or {})}</div></article>')


# ---- the section ----

def _stay(rows, threshold):
    """Those that stayed diffuse, a bar each: how much of the threshold its error takes up."""
    def bar(name, before, after, remark):
        now = after if _finite(after) else before
        share = min(1.0, now / threshold) if _finite(threshold) and threshold > 0 else 0
        over = _finite(threshold) and now > threshold
        was = f"{percent(before)} → " if _finite(after) and _finite(before) and before > threshold >= after else ""
        said = f"<small>{esc(remark)}</small>" if remark else ""
        return (f'<li><span>{esc(name)}</span><span class="num">{was}<b{" class=off" if over else ""}>{percent(now)}</b></span>'
                f'<i class="{"over" if over else ""}"><u style="width:{_n(100 * share)}%"></u></i>{said}</li>')

    return f'<ul class="stay">{"".join(bar(*row) for row in sorted(rows, key=lambda r: -(r[2] if _finite(r[2]) else r[1])))}</ul>' if rows else ""


def _rays(rays):
    rays = {what: n for what, n in rays.items() if _finite(n) and n > 0}
    if not rays:
        return ""
    most = max((n for what, n in rays.items() if "ray" in what), default=1)
    body = "".join(f'<tr><th scope=row>{esc(plain(what))}</th><td class=num>{number(int(n))}</td>'
                   f'<td class=meter>{f"""<i style="width:{_n(100 * n / most)}%"></i>""" if "ray" in what else ""}</td></tr>' for what, n in sorted(rays.items(), key=lambda item: -item[1]))
    return f"<h3>What that cost</h3><table class=plain><tbody>{body}</tbody></table>"


def section(parts):
    """How each surface reflects; "" where no ladder was climbed or left standing."""
    materials, fit = parts.materials or {}, parts.reports.get("fit") or {} if parts.reports else {}
    ladder = fit.get("ladder") if isinstance(fit.get("ladder"), dict) else {}
    lamps = materials.get("lamps") or {}
    groups = {n: g for n, g in (materials.get("groups") or {}).items() if n not in lamps}
    rungs = {n: (g.get("ladder") or {}).get("rung") or (g.get("kind") if g.get("kind") != "glossy" or not g.get("tangent") else "anisotropic") or "diffuse" for n, g in groups.items()}
    rungs |= {n: r for n, r in (ladder.get("rungs") or {}).items() if n in groups}
    climbed = {n: r for n, r in rungs.items() if r != "diffuse" and groups[n].get("identified")}
    if not ladder and not climbed:
        return ""
    threshold, diffuse, end, rays = ladder.get("threshold"), ladder.get("diffuse") or {}, ladder.get("end") or {}, ladder.get("rays") or {}
    total = sum(n for what, n in rays.items() if "ray" in what and _finite(n))
    named = (fit.get("arguments") or {}).get("surfaces") or {}
    reference = (fit.get("arguments") or {}).get("reference") or {}
    limits = _range([threshold, *(v for n in climbed for v in (diffuse.get(n), end.get(n)))])
    rows = "".join(_row(parts, n, groups[n], r, (diffuse.get(n), end.get(n), threshold), limits)
                   for n, r in sorted(climbed.items(), key=lambda item: -(groups[item[0]].get("pixels") or 0)))

    def remark(name):
        now = end.get(name, diffuse[name])
        over = _finite(now) and _finite(threshold) and now > threshold
        return "named diffuse in scene.yaml" if over and named.get(name) == "diffuse" else "given as a reference" if over and name in reference else "no rung explains it" if over else ""

    stay = [(n, diffuse[n], end.get(n), remark(n)) for n in groups if n in diffuse and n not in climbed and _finite(diffuse[n])]
    beyond = [row for row in stay if row[3]]
    helped = [n for n, before, after, _ in stay if _finite(after) and _finite(threshold) and before > threshold >= after]
    limit = f"{percent(threshold)} of full scale beyond noise".replace(" %", "\u00a0%")
    lead = ("Diffuse, unless the photograph says otherwise: a group climbs the ladder (perfect mirror, coloured mirror, glossy, anisotropic, textured) only as far as its error demands. "
            + (f"The threshold is {limit}. " if _finite(threshold) else ""))
    if climbed:
        lead += f"{len(climbed)} of {len(groups)} group{'s' * (len(groups) != 1)} climbed."
        if helped:
            lead += f" Once that is in the balance, {_list(helped)} {'is' if len(helped) == 1 else 'are'} diffuse within the threshold."
        right = {e["name"]: e["value"] for e in (parts.comparison or {}).get("errors") or []}.get("kinds.right")
        lead += " In truth, too, every group is what it was found to be." if right == 1 else ""
    elif not total:
        every = "Every group is diffuse within the threshold" if not beyond else "No group climbed"
        lead += f"{every}; no mirror buffer, no lobe and no texture was computed (0 rays)."
    else:
        lead += f"No group climbed: no mirror, lobe or texture explains what {_list([row[0] for row in beyond])} lack{'s' * (len(beyond) == 1)}." if beyond else "No group climbed."
    # groups of which there are too few pixels for a judgement, and those that only a mirror shows
    mirrored = [n for n, g in groups.items() if n not in diffuse and n not in climbed and g.get("identified") and not g.get("pixels")] if climbed else []
    few = [n for n, g in groups.items() if n not in diffuse and n not in climbed and g.get("identified") and g.get("pixels")] if diffuse else []
    notes = "".join(f"<p class=note>{text}: {', '.join(map(esc, names))}.</p>" for text, names in (("Seen only by way of a mirror, and taken for diffuse", mirrored), ("Too few pixels to judge, taken for diffuse", few)) if names)
    keys = ('<p class="keys"><span><i class="key full"></i>reached</span><span><i class="key hollow"></i>tried</span><span><i class="key faint"></i>never tried</span>'
            '<span><i class="key round"></i>error as diffuse</span><span><i class="key disc"></i>error in the end</span>' + ('<span><i class="key bar"></i>threshold</span>' if _finite(threshold) else "") + "</p>") if rows else ""
    left = (f'<h3>{"Diffuse" if rows else "Diffuse, all of them" if not beyond else "Diffuse"}</h3>' + _stay(stay, threshold) + notes) if stay or notes else ""
    foot = f'<div class="two even">{f"<div>{left}</div>" if left else ""}{f"<div>{cost}</div>" if (cost := _rays(rays)) else ""}</div>' if left and rays else left
    return _section("How each surface reflects", (f'<div class="climbs">{rows}</div>{keys}' if rows else "") + foot, lead, name="ladder")


def _list(names):
    """
    >>> _list(["a"]), _list(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    names = [esc(n) for n in names]
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else "".join(names)


STYLE = """
.climbs article{display:grid;grid-template-columns:58px 150px 196px minmax(0,1fr);gap:6px 24px;align-items:center;padding:18px 0;border-top:1px solid var(--line)}
.ball{width:58px;height:58px;object-fit:cover;border-radius:50%;box-shadow:inset 0 0 0 1px rgba(128,128,128,.35)}
.who h3{margin:0 0 4px}.who h3 small{display:block;font-weight:400}
.error p{margin:2px 0 0;font-size:14px}.error i{color:var(--muted);font-style:normal}
.reason{grid-column:2/-1}.reason .note{max-width:none;margin:0}
.stairs .passed{fill:var(--line)}.stairs .tried{fill:none;stroke:var(--muted);stroke-width:1}.stairs .reached{fill:var(--accent)}
.track .limit{stroke:var(--c2);stroke-width:1.5;stroke-dasharray:3 2}.track .way{stroke:var(--accent);stroke-width:2;opacity:.35}
.track .ring{fill:var(--paper);stroke:var(--accent);stroke-width:1.8}.track .end{fill:var(--accent)}
.shape{display:grid;grid-template-columns:52px minmax(0,1fr);gap:4px 6px;margin:0;font-size:14.5px;align-items:baseline}
.shape dt{color:var(--muted);font-size:14px}.shape dd{margin:0;display:grid;grid-template-columns:repeat(3,minmax(0,1fr));gap:2px 14px}.wide3{grid-column:1/-1}
.shape i{color:var(--muted);font-style:normal;font-size:12.5px;margin-right:6px}.shape b{font-weight:600}.shape small{display:block;font-size:12.5px}
.albums{display:flex;flex-wrap:wrap;gap:18px;margin:12px 0 6px}.albums figure{width:160px}.albums img{max-height:200px;object-fit:contain;object-position:left top;background:none;border-radius:4px}
.key.full{background:var(--accent)}.key.hollow{background:none;border:1px solid var(--muted)}.key.round{background:none;border:2px solid var(--accent);border-radius:50%}
.key.disc{background:var(--accent);border-radius:50%}.key.bar{background:none;border-left:2px dashed var(--c2);border-radius:0;width:2px}
.climbs+.keys{border-top:1px solid var(--line);padding-top:14px;margin:0 0 30px}
.stay{list-style:none;margin:0;padding:0;display:grid;grid-template-columns:repeat(auto-fill,minmax(200px,1fr));gap:12px 32px;font-size:14.5px}
.stay li{display:grid;align-content:start;grid-template-columns:minmax(0,1fr) auto;gap:3px 10px;overflow-wrap:anywhere}
.stay i{grid-column:1/-1;height:5px;border-radius:3px;background:var(--plain-bg);overflow:hidden}.stay u{display:block;height:100%;background:var(--accent);opacity:.75}
.stay .over u{background:var(--bad)}.stay small{grid-column:1/-1;font-size:12.5px}.stay b{font-weight:600}
@media (max-width:860px){.climbs article{grid-template-columns:58px minmax(0,1fr);gap:10px 18px}.error,.shape{grid-column:2}}
@media (max-width:520px){.shape dd{grid-template-columns:minmax(0,1fr)}.error,.shape,.reason{grid-column:1/-1}}
"""
