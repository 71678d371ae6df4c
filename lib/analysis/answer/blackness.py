"""Groups that are black where light falls on them: black as they are, or mirrors that show the dark.

Their pixels tell no reflectance, but no grey surface is that black. What a mirror throws into the room others show:
both are tried, and the rest of the photograph judges.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.analysis.answer.task import Task
from lib.analysis.causes.candidates import enough

MOSTLY_BLACK = 0.9  # A group is black if so much of its pixels is.
LEAST_SHARE = 0.002  # A smaller share of the picture throws little light.
MOST_TRIED = 3  # Groups that are tried as mirrors, the largest first.


def groups(task: Task) -> list:
    """Numbers of the groups that are black where the picture shows them and not told, the largest first."""
    problem, visible = task.problem, task.found.visible
    told = {problem.groups.index(name) for name in task.surfaces} | problem.known_groups
    dark = [g for g in np.flatnonzero((visible > 0) & ~problem.seen_groups) if g not in told]
    if not dark or not task.can_look:
        return []
    view = task.view()
    counted = np.where(view.facet >= 0, np.asarray(view.model.facet_group)[view.facet], -1)
    black = view.photograph.black
    share = {g: black[counted == g].mean() for g in dark if (counted == g).mean() >= LEAST_SHARE}
    found = [g for g, part in share.items() if part >= MOSTLY_BLACK]
    return sorted(found, key=lambda g: -visible[g])


def solved(task: Task, dark, solve):
    """The Answer of `solve` with these groups black, or mirrors where that explains enough more.

    solve : (task) -> Answer.  Where it is not clear which, every sigma contains the other.
    """
    black = np.isin(np.arange(len(task.problem.groups)), dark)
    surfaces = task.surfaces
    best = solve(_with(task, black, surfaces))
    for g in dark[:MOST_TRIED]:
        if best.refined is not None:
            break  # all is made again
        name = task.problem.groups[g]
        as_mirror = surfaces | {name: "coloured_mirror"}
        other = solve(_with(task, black, as_mirror))
        if other.refined is not None:
            return other
        if other.climb is None:
            continue  # something else is wrong, and was named before any mirror was traced
        gain, least = other.nats - best.nats, enough(best.problem)
        if other.why and not best.why:
            gain = -least
        elif best.why and not other.why:
            gain = max(gain, least)
        if gain >= least:
            place = other.climb.places[g]
            place.given, place.blind = False, True
            place.why = f"black where light falls on it; as a mirror it explains the others by {gain:.0f} nats more"
            other.warnings.append(f"group {name!r} is not identified: {place.why}; its own pixels show nothing")
            best, surfaces = other, as_mirror
        elif gain > -least and _contain(best, other):
            best.warnings.append(f"group {name!r} is black or a mirror that shows the dark: every sigma contains both")
    return best


def _with(task: Task, black, surfaces) -> Task:
    """The task with these groups black and these kinds told, also where it looks around an open model."""
    around = task.around and (lambda: _with(task.around(), black, surfaces))
    return replace(task, problem=replace(task.problem, black=black), surfaces=surfaces, around=around)


def _contain(answer, other) -> bool:
    """Widen the answer's sigmas by what the other answer has otherwise; whether that is more than they were."""
    one, two, much = answer.result, other.result, False
    for name, change in (("sigma_rho", two.state.rho - one.state.rho), ("sigma_E", two.state.E - one.state.E)):
        sigma = getattr(one, name)
        if sigma is not None:
            much |= bool((np.abs(change) > sigma)[np.isfinite(sigma) & (sigma > 0)].any())
            setattr(one, name, np.hypot(sigma, change))
    if one.sigma_gamma is not None and two.sigma_gamma is not None:
        one.cov_transfer[0, 0] += (two.state.gamma - one.state.gamma) ** 2
    return much
