"""The sections of report.html that show the vision half (figures 2.2 to 2.8): lenses, regions, matches, facets, pose.

`sections(vision, width)` takes what there is (`Vision`, each of which may be None); a picture appears only when its data exist.
Lines over photographs are inline SVG in the pixels of the photograph, so they stay sharp at any size.
"""
from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from lib.page import _bytes8, _figure, _finite, _section, _smaller, colours, css, esc, fixed, number, paint, percent, uri

SIDES = ("left", "right")


@dataclass
class Vision:
    """Of the two sides, in the pixels of the pinhole photographs:

    photographs : {side: (H, W, C) display values}        regions : {side: (H, W) labels from 1}
    cameras : {side: Camera} in the pair's frame          wires : [{"title", "left", "right": (S, 2, 2) px}], linear step first
    matches : [(left label, right label, similarity)]     facets, pose, calibration, orientation : as in their files
    facet_names : names of the model's facets, as in legend.json: "object, group"
    """
    photographs: dict = field(default_factory=dict)
    regions: dict = field(default_factory=dict)
    cameras: dict = field(default_factory=dict)
    wires: list = field(default_factory=list)
    matches: list = None
    facets: dict = None
    pose: dict = None
    calibration: dict = None
    orientation: dict = None
    facet_names: list = field(default_factory=list)


def see(*, model=None, cameras, pose=None, **files):
    """Vision from what was read; the model names the facets and is drawn from each pose of the trace."""
    vision = Vision(cameras=cameras, pose=pose, **files)
    if model:
        vision.facet_names = [f"{model.objects[o]}, {model.groups[g]}" for o, g in zip(model.facet_object, model.facet_group)]
        if pose and len(cameras) == 2:
            vision.wires = wires(model, cameras, pose)
    return vision


def sentence(vision):
    """What the vision half found, for the head of a page without photometry; empty where it found nothing."""
    facets = len((vision.facets or {}).get("facets") or [])
    said = [f"{len(vision.matches)} regions matched"] if vision.matches is not None else []
    said += [f"{facets} facets reconstructed"] if vision.facets else []
    said += [f"camera found to {number(pose_sigma(vision.pose)[1], 2)} mm (1 σ)"] if pose_sigma(vision.pose) else []
    said += [f"lenses: {vision.calibration['verdict'].split('; ')[0]}"] if (vision.calibration or {}).get("verdict") else []
    return ("; ".join(said)[:1].upper() + "; ".join(said)[1:] + ".") if said else ""


def sections(vision, width):
    width = min(width, 960)
    return "".join(part for part in (_lenses(vision), _regions(vision, width), _facets(vision, width), _pose(vision, width)))


def wires(model, cameras, pose, most=6):
    """The trace of a pose as wireframes (Vision.wires); of a long one the first, the last and some between.

    cameras : {side: Camera} in the pair's frame
    """
    from lib import index_buffer
    from lib.cameras import matrix_from_rt

    steps = [step for step in pose.get("trace") or [] if step.get("rt_cam_world")]
    if not steps or steps[-1]["rt_cam_world"] != pose["rt_cam_world"]:
        steps.append({"step": "result", "rt_cam_world": pose["rt_cam_world"]})
    keep = sorted({round(i) for i in np.linspace(0, len(steps) - 1, most)})
    drawn = []
    for number_, step in ((i, steps[i]) for i in keep):
        error = step.get("error_px")
        wire = {"title": {"linear": "after the linear step", "result": "result"}.get(step.get("step"), f"after iteration {step.get('iteration', number_)}") + (f": {number(error, 2)} px" if _finite(error) else "")}
        T_left = matrix_from_rt(step["rt_cam_world"])
        size = step.get("scale", pose.get("scale")) or 1.0                 # metres per unit of the pair
        for side in SIDES:
            T = cameras[side].T_cam_world @ np.linalg.inv(cameras["left"].T_cam_world)
            T[:3, 3] *= size
            camera = replace(cameras[side], T_cam_world=T @ T_left)
            buffer = index_buffer.reference(model, camera)
            wire[side] = index_buffer.wireframe(model, camera, buffer.facet, buffer.depth)
        drawn.append(wire)
    return drawn


# ---- lines over a photograph ----

def _over(photograph, lines, width, *, closed=False, labels=(), colour="#fff"):
    """A photograph with lines over it, as HTML; lines : [(n, 2) px]."""
    H, W = photograph.shape[:2]
    path = "".join("M" + "L".join(f"{x + 0.5:.1f} {y + 0.5:.1f}" for x, y in line) + ("Z" if closed else "") for line in lines)
    texts = "".join(f'<text x="{x + 0.5:.1f}" y="{y + 0.5:.1f}">{esc(t)}</text>' for (x, y), t in labels)
    return (f'<div class="over-photo"><img src="{uri(_smaller(_bytes8(photograph), width), photo=True)}" alt="" loading="lazy">'
            f'<svg viewBox="0 0 {W} {H}" aria-hidden="true"><path class="casing" d="{path}"/><path style="stroke:{colour}" d="{path}"/>{texts}</svg></div>')


def _captioned(body, caption):
    return f"<figure>{body}<figcaption>{caption}</figcaption></figure>"


# ---- the sections ----

def _lenses(vision):
    """What the lenses and the relative pose are good for, in words; how uncertain a pixel is across each picture."""
    body, c, o = "", vision.calibration, vision.orientation
    if c:
        rows, maps = [], []
        for side in SIDES:
            camera = (c.get("cameras") or {}).get(side)
            if not isinstance(camera, dict):
                continue
            views = f'{camera["boards"]} boards, {camera["corners"]} corners, {camera.get("outliers", 0)} of them outliers' if "boards" in camera else ""
            cells = "".join(f'<td class=num data-label="{label}">{number(camera.get(key), digits)}</td>'
                            for key, label, digits in (("fx", "fx, px", 5), ("fy", "fy, px", 5), ("cx", "cx, px", 5), ("cy", "cy, px", 5), ("rms", "reprojection, px", 2)))
            rows.append(f'<tr><th scope=row>{side}</th><td data-label="lens">{esc(camera.get("lens", "").removeprefix("LENSMODEL_"))}</td>{cells}<td class="remark">{esc(views)}</td></tr>')
            maps.append(_uncertain(camera, side))
        heads = "".join(f"<th scope=col class=num>{h}</th>" for h in ("f<sub>x</sub>, px", "f<sub>y</sub>, px", "c<sub>x</sub>, px", "c<sub>y</sub>, px", "Reprojection, px"))
        verdict, *reasons = (c.get("verdict") or "").split("; ")
        body += (f"<p class=verdict>{esc(verdict[:1].upper() + verdict[1:])}.</p>" if verdict else "") + (
            f"<ul class=plainlist>{''.join(f'<li>{esc(reason[:1].upper() + reason[1:])}.</li>' for reason in reasons)}</ul>" if reasons else "") + (
            f'<div class="scroll"><table class="cards"><thead><tr><th scope=col></th><th scope=col>Lens</th>{heads}<th scope=col></th></tr></thead><tbody>{"".join(rows)}</tbody></table></div>' if rows else "")
        pair = c.get("pair") or {}
        if _finite(pair.get("baseline_m")):
            sigma = f" ± {number(1000 * pair['baseline_sigma_m'], 2)}" if _finite(pair.get("baseline_sigma_m")) else ""
            angle = f", axes {number(pair['angle_deg'], 3)}° apart" if _finite(pair.get("angle_deg")) else ""
            body += f"<p>The cameras stand {number(1000 * pair['baseline_m'], 5)}{sigma} mm apart{angle}.</p>"
        maps = [m for m in maps if m]
        body += (f'<div class="two even">{"".join(maps)}</div>' + _scale()) if maps else ""
    if o:
        facts = [f"{number(o.get('inliers'))} point matches"] if _finite(o.get("inliers")) else []
        facts += [f"{number(o['rms_px'], 2)} px rms"] if _finite(o.get("rms_px")) else []
        facts += [f"axes {number(o['angle_deg'], 3)}° apart"] if _finite(o.get("angle_deg")) else []
        body += f"<p>Relative pose from the photographs alone, up to scale: {', '.join(facts)}. The unit of length is the baseline; the model gives the scale.</p>"
    return _section("Lenses", body)


LOW_PX, HIGH_PX = 0.01, 10.0          # ends of the scale of uncertainty, logarithmic
RAMP = np.array([[226, 240, 239], [150, 205, 200], [240, 206, 130], [222, 120, 60], [130, 30, 40]], float)


def _ramp(sigma):
    """Uncertainty in pixels (any shape) as colours; unknown is grey."""
    known = np.isfinite(sigma)
    at = np.clip(np.log(np.where(known, sigma, 1) / LOW_PX) / np.log(HIGH_PX / LOW_PX), 0, 1) * (len(RAMP) - 1)
    low = np.minimum(at.astype(int), len(RAMP) - 2)
    t = (at - low)[..., None]
    return np.where(known[..., None], RAMP[low] * (1 - t) + RAMP[low + 1] * t, 128).astype(np.uint8)


def _uncertain(camera, side):
    """One sigma of a projected point at the scene's distance, over the picture."""
    u = camera.get("uncertainty") or {}
    if not u.get("sigma_px"):
        return ""
    grid = np.array([[np.nan if v is None else v for v in row] for row in u["sigma_px"]], float)
    W, H = camera["size"]
    high = max(1, round(480 * H / W / len(grid)))
    picture = np.repeat(np.repeat(_ramp(grid), high, axis=0), max(1, round(480 / grid.shape[1])), axis=1)
    return _figure(uri(picture), f"<b>{side.capitalize()}</b>: one σ of a projected point {number(u.get('distance_m'), 2)} m away; {number(u.get('centre_px'), 2)} px at most over the middle of the picture", f"Uncertainty of the {side} lens")


def _scale():
    stops = ", ".join(css(c) for c in RAMP)
    return (f'<div class="scale" style="max-width:480px"><i style="background:linear-gradient(90deg, {stops})"></i><p><span>{number(LOW_PX)} px</span>'
            f'<span>{number(float(np.sqrt(LOW_PX * HIGH_PX)), 2)} px</span><span>{number(HIGH_PX)} px or more</span></p></div>')


def _regions(vision, width):
    """Figures 2.2 and 2.3: every region a colour; then matched regions in the same colour, the others black."""
    there = [s for s in SIDES if vision.regions.get(s) is not None]
    if not there:
        return ""
    figures = [_figure(uri(_smaller(paint(vision.regions[s]), width, nearest=True)), f"<b>{s.capitalize()}</b>: {number(int(vision.regions[s].max(initial=0)), 6)} regions", f"Regions of the {s} photograph") for s in there]
    body = f'<div class="two even">{"".join(figures)}</div>'
    if vision.matches is not None and len(there) == 2:
        palette = np.concatenate([np.zeros((1, 3), np.uint8), colours(len(vision.matches))])
        for i, side in enumerate(SIDES):
            labels = vision.regions[side]
            of = np.zeros(int(labels.max(initial=0)) + 1, int)
            for n, match in enumerate(vision.matches):
                if 0 < match[i] < len(of):
                    of[match[i]] = n + 1
            share = (of[labels] > 0).mean() if labels.size else 0
            figures[i] = _figure(uri(_smaller(palette[of[labels]], width, nearest=True)), f"<b>{side.capitalize()}</b>: {percent(float(share), 0)} of the picture is matched", f"Matched regions of the {side} photograph")
        body += f'<h3>Matches</h3><p class=note>The {len(vision.matches)} matched pairs in the same colour; black has no partner.</p><div class="two even">{"".join(figures)}</div>'
    return _section("Regions", body, "Pieces of one colour, found by the energy of eq. 2.1, and which of them are the same in both photographs.")


def _project(camera, frame, points):
    """(n, 3) m in the left camera's frame -> (n, 2) px of camera; frame : the left camera in the pair's frame."""
    T = np.linalg.inv(frame.T_cam_world)
    return camera.project(np.asarray(points, float) @ T[:3, :3].T + T[:3, 3])


def _facets(vision, width):
    """Figure 2.4: the reconstructed facets, reprojected on both photographs; their distance and how well it is known."""
    facets = (vision.facets or {}).get("facets")
    if not facets:
        return ""
    unit = {"m": "m", "baseline": "baselines"}.get(vision.facets.get("unit"), "")
    figures = []
    for side in SIDES:
        if side in vision.cameras and "left" in vision.cameras and vision.photographs.get(side) is not None:
            rings = [_project(vision.cameras[side], vision.cameras["left"], f["polygon"]) for f in facets]
            keep = [np.isfinite(r).all() for r in rings]
            names = [(tuple(r.mean(0)), f["left_label"]) for r, f, k in zip(rings, facets, keep) if k]
            figures.append(_captioned(_over(vision.photographs[side], [r for r, k in zip(rings, keep) if k], width, closed=True, labels=names), f"<b>{side.capitalize()}</b>"))
    matched = {m["left_label"]: m.get("facet") for m in (vision.pose or {}).get("matches") or [] if isinstance(m, dict) and "left_label" in m}
    rows = []
    for f in facets:
        n, d = np.asarray(f["plane"]["n"], float), f["plane"]["d"]
        centre = np.mean(np.asarray(f["polygon"], float), axis=0)
        ray = centre / centre[2] if centre[2] else centre
        sigma = float(np.sqrt(max(ray @ np.asarray(f["covariance"], float) @ ray, 0)) * centre[2] ** 2) if f.get("covariance") is not None else None
        model = matched.get(f["left_label"])
        name = vision.facet_names[model] if isinstance(model, int) and 0 <= model < len(vision.facet_names) else ("–" if model is None else f"facet {model}")
        rows.append(f'<tr><th scope=row>{esc(f["left_label"])}</th><td class=num data-label="distance">{fixed(float(centre[2]), 3)}</td><td class=num data-label="sigma">{number(sigma, 2)}</td>'
                    f'<td class=num data-label="overlap">{percent(f.get("overlap"), 0)}</td><td data-label="facet of the model">{esc(name)}</td></tr>')
    table = (f'<details{" open" if len(rows) <= 12 else ""}><summary>Facets ({len(rows)})</summary><div class="scroll"><table class="cards"><thead><tr><th scope=col>Region</th><th scope=col class=num>Distance, {unit}</th>'
             f'<th scope=col class=num>σ of it</th><th scope=col class=num>Overlap</th><th scope=col>Facet of the model</th></tr></thead><tbody>{"".join(rows)}</tbody></table></div></details>')
    return _section("Facets in space", f'<div class="two even">{"".join(figures)}</div>' + table,
                    "The plane of each matched region, such that it mirrors the left region on the right one. Distances are taken at the middle of the facet, along the left camera’s axis.")


def pose_sigma(pose):
    """(degrees, mm): one sigma of the camera's direction and place, or None where the pose does not say."""
    if not (pose or {}).get("covariance"):
        return None
    s = np.sqrt(np.maximum(np.diag(np.asarray(pose["covariance"], float)), 0))
    return float(np.degrees(np.linalg.norm(s[:3]))), float(1000 * np.linalg.norm(s[3:]))


def _pose(vision, width):
    """Figures 2.6 to 2.8: the model over both photographs, after the linear step and after each iteration."""
    pose = vision.pose
    if not pose:
        return ""
    said = []
    if (sigma := pose_sigma(pose)):
        said.append(f"known to {number(sigma[0], 2)}° and {number(sigma[1], 2)} mm (1 σ)")
    said.append(f"{len(pose.get('matches') or [])} facets matched")
    others = pose.get("ambiguous") or []
    if others:
        said.append(f"{len(others)} other pose{'s' * (len(others) != 1)} would explain the facets as well")
    body = f"<p class=verdict>{esc(('; '.join(said)).capitalize())}.</p>"
    sides = [s for s in SIDES if vision.photographs.get(s) is not None]
    if vision.wires and sides:
        last = vision.wires[-1]
        body += '<div class="two even">' + "".join(_captioned(_over(vision.photographs[s], last[s], width, colour="#ffe14d"), f"<b>{s.capitalize()}</b>, {esc(last['title'])}") for s in sides) + "</div>"
        steps = [_captioned(_over(vision.photographs[s], wire[s], min(width, 480)), f"{s.capitalize()}, {esc(wire['title'])}") for wire in vision.wires[:-1] for s in sides]
        body += f'<h3>How it got there</h3><div class="two even">{"".join(steps)}</div>' if steps else ""
    return _section("Where the camera is", body, "The part of the model that each camera sees, drawn over its photograph.")


STYLE = """
.over-photo{position:relative;line-height:0}
.over-photo svg{position:absolute;inset:0;width:100%;height:100%;border-radius:8px}
.over-photo path{fill:none;stroke-width:1.5px;vector-effect:non-scaling-stroke;stroke-linecap:round}
.over-photo .casing{stroke:#000;stroke-opacity:.45;stroke-width:3px}
figure~h3,.two+h3,.plainlist+.scroll,.scroll+p{margin-top:26px}
.verdict+.two,.verdict+.scroll{margin-top:18px}
.over-photo text{fill:#fff;font-size:11px;text-anchor:middle;dominant-baseline:middle;paint-order:stroke;stroke:#000;stroke-width:2.5px;stroke-opacity:.6}
"""
