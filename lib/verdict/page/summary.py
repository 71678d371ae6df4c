"""The head of the page: the verdict in plain words, the main figures, the photograph beside the re-rendering."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.core import words
from lib.verdict.page import ladder, vision
from lib.verdict.page.html import finite, fixed, number, percent, plural, pm, render
from lib.verdict.page.parts import Parts
from lib.verdict.page.pictures import photo_uri

MISFIT = 4  # times the noise: from there on what was given is not as the photograph has it


class Verdict(NamedTuple):
    """kind : the CSS class of the badge"""

    kind: str
    badge: str
    sentence: str


class Fact(NamedTuple):
    """One of the main figures."""

    name: str
    value: str
    note: str


# ---- the verdict ----


def verdict(parts: Parts) -> Verdict:
    """What came out, in one word and in a few sentences."""
    weak = [stage for stage, report in parts.reports.items() if report.status == "not converged"]
    kind, badge = _badge(_status(parts), weak, parts.materials.to if parts.materials else None)
    said = _first_sentence(parts)
    error = parts.compared.error("reflectance.mean_relative")
    if finite(error):
        said += f" Against the known truth, reflectances are off by {percent(error)} on average."
    misfit = parts.reports["fit"].misfit if "fit" in parts.reports else None
    if parts.materials and parts.materials.why:
        said += " " + " ".join(f"{why.text[:1].upper()}{why.text[1:]}." for why in parts.materials.why)
    elif finite(misfit) and misfit > MISFIT:
        said += (
            f" It differs {misfit:.0f} times more than noise explains: a lamp, the model, the pose or the transfer"
            " function is not as given."
        )
        kind, badge = ("warn", "Does not fit") if kind == "good" else (kind, badge)
    others = parts.vision.pose.others if parts.vision and parts.vision.pose else 0
    if others:
        said += (
            f" The pose is ambiguous: {others} {plural(others, 'other')} would explain the photographs as well, and all"
            " figures are of the first."
        )
        kind, badge = "warn", "Ambiguous"
    if weak:
        said += f" Not converged: {', '.join(weak)}."
    return Verdict(kind, badge, said)


def _status(parts: Parts):
    """Of the materials, else of the last stage that says one."""
    if parts.materials and parts.materials.status:
        return parts.materials.status
    return next((report.status for report in reversed(parts.reports.values()) if report.status), None)


def _badge(status, weak, to=None):
    if status == "does not fit":
        return "bad", "Does not fit"
    if status == "approximate":
        return "warn", f"Approximate, {words.about(to)}" if finite(to) else "Approximate"
    if status == "not converged" or weak:
        return "warn", "Not converged"
    if status in ("converged", "complete", "unique"):
        return "good", status.capitalize()
    return ("bad", status.capitalize()) if status else ("warn", "Nothing to report")


def _first_sentence(parts: Parts):
    said = _photometry(parts)
    if said:
        return "; ".join(said) + "."
    seen = vision.summary(parts.vision) if parts.vision else ""
    return seen or "No photometry was asked for, or none has been done yet."


def _photometry(parts: Parts):
    """What the materials come to, in parts of a sentence."""
    said = []
    rmse, _ = agreement(parts)
    if parts.materials and parts.materials.status == "nothing seen":
        said.append("No pixel of the photograph can be used: nothing below is a finding")
    elif rmse is not None:
        subject = "Re-rendering differs" if parts.scores else "Fitted light differs"
        said.append(f"{subject} from the photograph by {percent(rmse)} of full scale")
    if every := len(parts.groups):
        said.append(f"{_identified(parts)} of {every} {plural(every, 'group')} identified")
    if other := ladder.counts(parts.materials):
        said.append(f"not diffuse: {other}")
    if parts.materials:
        said += [_taken(cause) for cause in parts.materials.explained]
    if parts.transfer.kind == "gamma" and finite(parts.transfer.gamma):
        gamma = pm(parts.transfer.gamma, parts.transfer.sigma, 3)
        said.append(f"gamma {gamma}" + ("" if parts.transfer.sigma else f" ({without_sigma(parts)})"))
    return said


def _taken(cause):
    """A cause in words: what was put right, how far it was off, and what speaks for it."""
    values, name = cause.values or {}, cause.cause.replace("_", " ")
    far = lambda key, part=slice(None): float(np.linalg.norm(np.array(values[key], float)[part]))
    if "rt_world_object" in values:
        turn = np.degrees(far("rt_world_object", slice(3)))
        said = f"object {cause.subject!r}" + (f" turned by {turn:.1f} degrees" if turn > 0.05 else " moved")
        said += "" if turn > 0.05 else f" by {1000 * far('rt_world_object', slice(3, 6)):.0f} mm"
    elif "offset_m" in values:
        said = f"lamp {cause.subject!r} moved by {1000 * far('offset_m'):.0f} mm"
    elif "rt_correction" in values:
        turn, move = np.degrees(far("rt_correction", slice(3))), 1000 * far("rt_correction", slice(3, 6))
        said = f"camera turned by {turn:.2f} degrees and moved by {move:.0f} mm"
    elif "aim" in values:
        aim = ", ".join(f"{v:.2f}" for v in values["aim"])
        said = f"lamp {cause.subject!r} throws its light in a lobe, cos^{values['exponent']:.2f} about ({aim})"
    elif "matrix" in values:
        said = "the camera mixes colours before its response"
    elif "radiosity" in values:
        glow = ", ".join(f"{v:.2g}" for v in values["radiosity"])
        said = f"the model is open, and light from outside comes in (radiosity {glow})"
    elif "offset_px" in values:
        said = f"principal point moved by {far('offset_px'):.2f} px"
    else:
        said = f"{name} taken into account"
    return f"{said} ({cause.evidence_nats:.0f} nats)" if finite(cause.evidence_nats) else said


def _identified(parts: Parts):
    return sum(bool(group.identified) for group in parts.groups.values())


def without_sigma(parts: Parts):
    """What a value is that has no sigma."""
    status = parts.materials.status if parts.materials else None
    if status == "does not fit" and parts.transfer.asked:
        return "no finding"
    return "not determined" if status == "nothing seen" else "given"


def agreement(parts: Parts):
    """(RMSE, over what) of the picture, else of the fit; (None, None) where nothing was measured."""
    if parts.scores and finite(parts.scores.rmse):
        return parts.scores.rmse, "the whole picture"
    if parts.materials and finite(parts.materials.image.rmse):
        return parts.materials.image.rmse, "the pixels used"
    return None, None


# ---- the main figures ----


def facts(parts: Parts):
    """[Fact] for the column beside the pictures."""
    found = []
    rmse, where = agreement(parts)
    if rmse is not None:
        found.append(Fact("Difference to the photograph", percent(rmse), f"RMSE of display values over {where}"))
    if parts.scores and finite(parts.scores.ciede2000):
        note = "CIEDE2000, mean; about 1 is just noticeable"
        found.append(Fact("Colour difference", number(parts.scores.ciede2000, 2), note))
    if every := len(parts.groups):
        note = "materials that the photograph itself determines"
        found.append(Fact("Groups identified", f"{_identified(parts)} of {every}", note))
    return found + _reflectance_error(parts) + _pose_error(parts) + _time(parts)


def _reflectance_error(parts: Parts):
    error = parts.compared.error
    if not finite(error("reflectance.mean_relative")):
        return []
    note = (
        f"mean against truth; at most {number(error('reflectance.max_absolute'), 2)} absolute;"
        f" {percent(error('reflectance.within_3_sigma'), 0)} within 3 σ"
    )
    return [Fact("Reflectance error", percent(error("reflectance.mean_relative")), note)]


def _pose_error(parts: Parts):
    sigma = vision.pose_sigma(parts.vision.pose) if parts.vision else None
    if not sigma:
        return []
    off = parts.compared.error("pose.centre_mm")
    against = f"; {number(off, 2)} mm off the truth" if finite(off) else ""
    return [Fact("Camera found to", f"{number(sigma.mm, 2)} mm", f"and {number(sigma.degrees, 2)}°, 1 σ{against}")]


def _time(parts: Parts):
    """Counted CPU time, and what a user waits."""
    stages = list(parts.reports)
    if not any(finite(report.cpu_s) for report in parts.reports.values()):
        return []

    def cpu_s(some):
        return fixed(sum(parts.reports[stage].cpu_s or 0 for stage in some), 1)

    waited = fixed(sum(report.waited_s for report in parts.reports.values()), 1)
    clock = f"; {waited} s on the clock with imports and compilation"
    if "fit" not in stages:
        return [Fact("Computing time", f"{cpu_s(stages)} s", "of CPU, all stages" + clock)]
    note = f"of CPU, up to the reflectances; {cpu_s(stages)} s with the pictures" + clock
    return [Fact("Computing time", f"{cpu_s(stages[: stages.index('fit') + 1])} s", note)]


# ---- the pictures ----


def hero(parts: Parts, width):
    """The photograph and the re-rendering over each other, and the main figures."""
    photo, again = parts.photograph, parts.rendered
    pair = photo is not None and again is not None and photo.shape[:2] == again.shape[:2]
    return render(
        "hero.html",
        photograph=None if photo is None else photo_uri(photo, width),
        rendered=photo_uri(again, width) if again is not None and (pair or photo is None) else None,
        shape=photo.shape[:2] if pair else None,
        facts=facts(parts),
    )


def about(parts: Parts):
    """What the page is about, in small letters above its title."""
    if not parts.vision:
        return "materials and light from one photograph"
    return f"geometry{', materials and light' if parts.materials else ''} from two photographs"
