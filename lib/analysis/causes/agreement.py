"""Whether photograph and given facts agree, and what is likeliest wrong where they do not.

A fit of some hundred numbers converges on anything. What it finds means something only if the light it rests on
explains the photograph to its noise, and if no fact that scene.yaml tells would better be another.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.causes import glow, responses
from lib.analysis.causes.candidates import Candidate, enough
from lib.analysis.fit.equations import Equations, Unknowns
from lib.analysis.fit.evidence import evidence, promised
from lib.analysis.fit.facts import USUAL_GAMMA
from lib.analysis.fit.gauss_newton import gauss_newton
from lib.analysis.fit.problem import CauseTerms, Problem, Result, display_residual
from lib.analysis.fit.uncertainty import doubts, widen
from lib.analysis.seen.gather import Gathered
from lib.given import jpeg
from lib.given.materials import Why
from lib.given.transfer import Transfer
from lib.given.transfer_kinds import OF_PICTURE
from lib.given.white_level import TWELVE_BITS

FITS = 1.2  # error that neighbouring tiles have in common, in what noise explains: exact scenes have .2 to .45, a pose
# 2 px off has 1.3 to 2.6, a lamp 12 cm off 4 to 8
DOUBT = 0.4  # of the same, from which it is worth while to look further
OFF = 0.02  # relative difference of a lamp from what is told that is worth a word
SURE = 3  # standard deviations of the same, where they are known
COLOURED = 0.5  # of how far it is off in the mean, by which its channels differ: another colour, not power alone
SETTLES = 0.3  # of the tiles' typical residual: what leaves no more is all that is wrong
TOLD_TO = 0.1  # standard deviation of a gamma that is told, before anything is seen
CLEARLY = 2.0  # times what is enough, where mirrors or lobes leave an error: right gammas were beaten by 1.65 of it
ON_BOUNDS = 1 / 3  # share of the groups whose reflectance is 0 or 1, from which nothing found is believed


def fits(result: Result) -> bool:
    """What is left is noise: neighbouring tiles have little of it in common."""
    return result.correlated <= FITS


def in_doubt(result: Result) -> bool:
    """The geometry may not be as given."""
    return result.correlated >= DOUBT


def disagreements(problem: Problem, result: Result, found: Gathered, asked, rivals) -> list[Why]:
    """What is likeliest wrong with the given facts, the likeliest first; [] where photograph and facts agree.

    asked : transfer, as in scene.yaml;  rivals : {kind: nats} of other transfer functions
    """
    if not len(problem.tile_group) or result.at is None:
        return []
    if why := _range(found):
        return why  # all else that might be wrong would only bend to it
    why = transfer_told(problem, asked, rivals) or _another_gamma(problem, result, asked)
    why += lamps(problem, result)
    why += references(problem, result)
    if problem.specular is None and not fits(result):
        why += _open_model(problem, result)
    why.sort(key=lambda w: -(w.evidence_nats or np.inf))
    if not why and not fits(result):
        text = (
            f"the re-rendering differs from the photograph by {result.correlated:.1f} times what noise explains, alike"
            " over whole surfaces: the pose, the place of a lamp or of an object, or a material is not as given, or the"
            " picture's contrast was changed from place to place (HDR, clarity)"
        )
        why = [Why("unknown", None, text, None)]
    return why or _on_bounds(problem, result)


def joined(why, displaced) -> list[Why]:
    """Both lists, the likeliest first; what is displaced tells what was unknown."""
    why = [w for w in why if w.cause != "unknown" or not displaced]
    return sorted([*why, *displaced], key=lambda w: -(w.evidence_nats or np.inf))


def of_the_file(why, photograph) -> list[Why]:
    """With what was done to the photograph, where its pixels tell.

    It stands behind what the light proves, and before what is only seen: blocks of a JPEG look like things.
    """
    if not why or not photograph.lost_tables:
        return why
    text = f"the photograph was a JPEG, and its blocks may be all that is wrong: {jpeg.NO_TABLES}"
    proved = [w for w in why if w.evidence_nats is not None]
    seen = [w for w in why if w.evidence_nats is None and w.cause != "unknown"]
    return [*proved, Why("noise", None, text, None), *seen]


def out_of_range(found: Gathered) -> bool:
    """The photograph's values are so small that they must be meant for another range."""
    return not found.linear and len(found.pixels) > 0 and found.pixels.max() <= TWELVE_BITS + 1e-9


def _range(found: Gathered):
    if not out_of_range(found):
        return []
    largest = found.pixels.max()
    text = (
        f"the photograph uses {largest:.1%} of its range at most: 12-bit data in a 16-bit file must be multiplied by 16"
    )
    return [Why("range", None, text, None)]


def transfer_told(problem, asked, rivals) -> list[Why]:
    """A transfer function that scene.yaml tells, where another fits far better."""
    if asked in (None, "auto", *OF_PICTURE) or not rivals:
        return []
    most = max(rivals.values())
    if most < enough(problem):
        return []
    near = [kind for kind, nats in rivals.items() if nats > most - enough(problem)]
    kind = min(near, key=lambda kind: kind == "curve")  # the simplest of those that are as good
    text = f"the transfer function {kind} fits better than {_named(asked)} by {rivals[kind]:.0f} nats"
    return [Why("transfer", None, text, float(rivals[kind]))]


def _another_gamma(problem, result, asked) -> list[Why]:
    """A gamma that fits better than what is told: one number is found where a free curve promises too little for nine.

    Right gammas are beaten by -8 to 0 nats; by up to 7 beside mirrors and lobes, and by 17 where these leave an error.
    """
    if not _is_told(asked):
        return []
    found, gain, least = _free_gamma(problem, result)
    if gain < least:
        return []
    text = f"gamma {found.result.state.gamma:.3g} fits better than {_named(asked)} by {gain:.0f} nats"
    return [Why("transfer", None, text, float(gain))]


def doubt_told(problem, result, asked):
    """A transfer function that is told is believed to TOLD_TO of a gamma, as far as the picture does not tell: gamma
    2.4 told for 2.2 beside a mirror, 9 % off, was 45 sigma off and green, since no other fitted better; sRGB told for a
    gamma of 2.4 in dim light 15 %, 56 sigma.

    Where a free one fits better, by less than names it, sigma holds as large a part of what it would change:
    mirrored-2371 told 2.49 for 2.53 was 14 nats worse, of 23, and 19 sigma off.
    """
    if not _is_told(asked) or result.sigma_rho is None:
        return
    widen(problem, result, _as_told(problem, result))
    found, gain, least = _free_gamma(problem, result)
    if gain > 0:
        doubt(result, found.result.state, min(np.sqrt(gain / least), 1.0))  # nats grow as the square of what is wrong


def _as_told(problem, result) -> CauseTerms:
    """How far a told function may be off: another gamma, or as much of an exponent; what is said to be sRGB may be a
    gamma."""
    B, transfer = result.state.B, result.state.transfer
    if transfer.kind == "gamma":
        by_gamma = display_residual(replace(problem, fit_transfer=True), B, transfer)[2]
        return CauseTerms(("transfer",), by_gamma, np.array([TOLD_TO]))
    shown = np.clip(transfer.bare.display(transfer.mixed(B)), 1e-6, 1)
    by_exponent = (shown * np.log(shown))[..., None]
    terms = CauseTerms(("transfer",), by_exponent, np.array([TOLD_TO / USUAL_GAMMA]))
    return terms.beside(responses.doubted(problem, result.state))


def doubt(result: Result, other, share=1.0):
    """Sigma of the values that were found holds a share of what another explanation's State has for them."""
    for name in ("rho", "E", "rho_s", "bend"):
        sigma, values = getattr(result, f"sigma_{name}"), getattr(result.state, name)
        if sigma is not None and values is not None:
            off = share * (getattr(other, name) - values)
            setattr(result, f"sigma_{name}", np.where(sigma > 0, np.hypot(sigma, off), sigma))


def _is_told(asked):
    return asked not in (None, "auto", "linear", *OF_PICTURE)


def _free_gamma(problem, result):
    """(Candidate with a gamma that is free, the nats by which it is better, the nats that name it)"""
    state = result.state
    free = replace(problem, transfer=Transfer("gamma", USUAL_GAMMA), fit_transfer=True, doubted=None)
    start = Unknowns(state.rho, state.E, free.transfer, state.rho_s)
    found = result.once("free_gamma", lambda: Candidate.of(free, start=start))
    is_bent = problem.specular is not None and found.evidence.discrepancy > 0
    least = (CLEARLY if is_bent else 1) * enough(problem, 1)
    return found, found.evidence.nats - evidence(problem, result.at).nats, least


def _named(asked):
    if not isinstance(asked, dict):
        return asked
    return f"the curve of {asked['curve']}" if "curve" in asked else f"gamma {asked['gamma']:g}"


def references(problem, result) -> list[Why]:
    """Reflectances that are told, where others fit far better: a told group climbs no rung and has no sigma."""
    return result.once("references", lambda: _references(problem, result))


def _references(problem, result):
    told = references_told(problem)
    if not told:
        return []
    free, gain, least = _free_references(problem, result)
    if gain < least:
        return []
    found = gauss_newton(free.problem, start=free.start)
    return references_of(problem, found, gain) if fits(found) else []  # else something else is wrong


def _free_references(problem, result):
    """(Candidate with other reflectances of told groups, the nats by which it is better, the nats that name them)"""
    here = Candidate(problem, result, evidence(problem, result.at))
    free = result.once("free_references", lambda: with_references_freed(here))
    numbers = len(references_told(problem)) * result.state.rho.shape[1]
    return free, free.evidence.nats - here.evidence.nats, enough(problem, numbers)


def doubt_references(problem, result):
    """Where other reflectances of told groups fit better, by less than names them, sigma holds as large a part of what
    they would change: .72 told for .7 was 18 sigma off and green."""
    if not references_told(problem) or result.sigma_rho is None:
        return
    free, gain, least = _free_references(problem, result)
    if gain > 0:
        doubt(result, free.result.state, min(np.sqrt(gain / least), 1.0))


def references_told(problem) -> list[int]:
    """Groups that tiles show, whose diffuse reflectance is told."""
    specular = () if problem.specular is None else problem.specular.groups
    told = problem.known_groups & set(np.flatnonzero(problem.seen_groups))
    return sorted(g for g in told if problem.groups[g] not in problem.lamps and g not in specular)


def with_references_freed(first: Candidate) -> Candidate:
    """The fit with other reflectances of the groups that are told, and the same causes."""
    rho = first.problem.rho.copy()
    rho[references_told(first.problem)] = np.nan
    return Candidate.of(replace(first.problem, rho=rho), first.taken, start=first.start)


def references_of(problem, found: Result, nats) -> list[Why]:
    """Reflectances that are told and differ from those of a fit in which they were free."""
    told = references_told(problem)
    off = np.abs(found.state.rho[told] - problem.rho[told])
    unsure = 0.0 if found.sigma_rho is None else found.sigma_rho[told]
    far = (off > np.maximum(OFF * problem.rho[told], SURE * unsure)).any(axis=1)
    return [_reference(problem, g, found.state.rho[g], nats) for g, is_far in zip(told, far, strict=True) if is_far]


def _reference(problem, g, rho, gain):
    name = problem.groups[g]
    numbers = lambda values: ", ".join(f"{v:.3g}" for v in values)
    text = (
        f"reference.{name}: {numbers(rho)} fits the photograph better by {gain:.0f} nats than {numbers(problem.rho[g])}"
        ": is it a linear share of the light, not the value of a colour picker?"
    )
    return Why("group_wrong", name, text, float(gain))


def lamps(problem, result) -> list[Why]:
    """Emittances that are told, where others fit far better."""
    return lamps_told(problem, result)[0]


def lamps_told(problem, result) -> tuple[list[Why], bool]:
    """The same, and whether other emittances are all that is wrong."""
    return result.once("lamps_told", lambda: _lamps_told(problem, result))


def _lamps_told(problem, result):
    if not are_told(problem):
        return [], False
    state, nats = result.state, evidence(problem, result.at).nats
    if _freed_by_one_step(problem, result.at) - nats < enough(problem):
        return [], False
    free = Candidate.of(freed(problem), start=Unknowns(state.rho, state.E, state.transfer, state.rho_s))
    gain = free.evidence.nats - nats
    if gain < enough(problem):
        return [], False
    little = free.typical < SETTLES * float(np.median(np.abs(result.tile_residual)))
    # that a camera may mix colours, which was not taken, is no doubt of lamps: either is not as told
    function, _ = doubts(free.problem.doubted)
    found = gauss_newton(replace(free.problem, doubted=function), start=free.start)
    return lamps_of(problem, found, gain), little and fits(found)


def lamps_behind_curve(problem, result, given: Candidate) -> list[Why]:
    """Emittances that are told, where others beside a plain gamma explain as much as the curve that was taken.

    given : under the given facts, before mirrors and lobes have climbed: the diffuse fit asks the same, but cannot
    tell while they are off
    """
    if result.state.transfer.kind != "curve" or not problem.fit_transfer or not are_told(problem):
        return []
    gamma, state = given.result.state.transfer, result.state
    plain = replace(freed(problem), transfer=replace(gamma, matrix=problem.transfer.matrix), doubted=None)
    free = Candidate.of(plain, start=Unknowns(state.rho, state.E, plain.transfer, state.rho_s))
    gain = free.evidence.nats - evidence(problem, result.at).nats
    if gain < -enough(problem):
        return []
    found = gauss_newton(plain, start=free.start)
    return lamps_of(problem, found, gain, ("curve",)) if fits(found) else []


def lamps_of(problem, found: Result, nats, spared=()) -> list[Why]:
    """Emittances that are told and differ from those of a fit in which they were free.

    spared : causes that these make needless
    """
    told = np.maximum(problem.emittance, 1e-12)
    ratio, unsure = found.state.E / told, 0.0 if found.sigma_E is None else found.sigma_E / told
    far = (np.abs(ratio - 1) > np.maximum(OFF, SURE * unsure)).any(axis=1)
    return [_lamp(problem.lamps[k], ratio[k], nats, spared) for k in np.flatnonzero(problem.own_lamps & far)]


def are_told(problem) -> bool:
    """The emittances of all lamps are."""
    return bool(problem.own_lamps.any()) and not np.isnan(problem.emittance[problem.own_lamps]).any()


def freed(problem) -> Problem:
    """With the emittances of all lamps unknown."""
    return replace(problem, emittance=np.where(problem.own_lamps[:, None], np.nan, problem.emittance))


def _lamp(name, ratio, gain, spared):
    uneven = np.ptp(ratio) > OFF * ratio.mean()
    coloured = uneven and np.ptp(ratio) > COLOURED * abs(ratio.mean() - 1)
    said = ", ".join(f"{v:.3g}" for v in ratio) if uneven else f"{ratio.mean():.3g}"
    better = f"fits the photograph better by {gain:.0f} nats"
    if spared:
        better = f"explains the photograph without {' and '.join(spared)}"
    text = f"lamp {name!r}: {said} times its emittance {better}"
    return Why("lamp_colour" if coloured else "lamp_power", name, text, float(gain))


def with_lamps_freed(first: Candidate) -> Candidate:
    """The fit with lamps of any emittance and the same causes."""
    return first.once("freed", lambda c: Candidate.of(freed(c.problem), c.taken, start=c.start))


def doubt_srgb(given: Candidate | None, best: Candidate, result: Result):
    """Where sRGB was taken under told lamps, and a gamma and other lamps explain as much, sigma holds what these
    change: lamps told .94 of what they were looked like sRGB in a white room, 12 sigma off and green.

    given, best : of Explained
    """
    if given is None or best.kind != "srgb" or given.kind != "gamma" or not are_told(given.problem):
        return
    if promise_of_lamps(given) < enough(given.problem):
        return
    free = with_lamps_freed(given)
    if free.evidence.nats > best.evidence.nats - enough(given.problem):
        doubt(result, free.result.state)


def promise_of_lamps(found: Candidate) -> float:
    """Nats that one step brings in which the emittances that are told are free."""
    by_one_step = lambda found: _freed_by_one_step(found.problem, found.result.at) - found.evidence.nats
    return found.once("lamps", by_one_step)


def _freed_by_one_step(problem, at: Equations):
    """Nats after one step from `at` with free lamps."""
    return promised(problem, at, at.by_told_lamps()).nats


def _open_model(problem, result):
    """Light that comes back through the openings of the model, evenly."""
    if not glow.is_dark(problem):
        return []
    gain = glow.promise(Candidate(problem, result, evidence(problem, result.at)))
    if gain < enough(problem):
        return []
    opening = problem.D[:, ~problem.own_lamps].max()
    text = (
        f"the model is open ({opening:.0%} of the light of a patch leaves it), and light from outside would"
        f" explain the photograph better by {gain:.0f} nats: a wall or a window is missing"
    )
    return [Why("open_model", None, text, float(gain))]


def _on_bounds(problem, result):
    free = problem.seen_groups & np.isnan(problem.rho).any(axis=1)
    if problem.specular is not None:
        free[list(problem.specular.groups)] = False
    at = free & ((result.state.rho > 0.9995) | (result.state.rho < 1e-6)).any(axis=1)
    if at.sum() <= max(ON_BOUNDS * free.sum(), 1):
        return []
    text = (
        f"the reflectances of {at.sum()} of {free.sum()} groups lie on their bounds: the lamps or the scale are not so"
    )
    return [Why("unknown", None, text, None)]
