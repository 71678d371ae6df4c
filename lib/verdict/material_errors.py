"""What was found of the materials against what is true. Used by the comparison alone.

A residual is not an error: a re-rendering may agree with the photograph to 0.5 % while its reflectances are 17 % off
(docs/decisions/gamma-valley.md). So both are listed. The names of errors are stable: the bounds in
tests/expected/<scene>.csv refer to them.

    reflectance.mean_relative     mean |rho / rho* - 1| over channels of the counted groups
    reflectance.max_relative, reflectance.max_absolute
    reflectance.within_3_sigma    share of the channels with |rho - rho*| <= 3 sigma; a channel without sigma is outside
    reflectance.median_sigma
    reflectance.unidentified      counted groups without a value of their own
    reflectance.groups            counted groups
    small.<...>                   the same over groups too small to be counted
    reflectance.only_in_mirror    mean |rho / rho* - 1| of the diffuse groups that only mirrors show
    reflectance.only_in_mirror_groups      how many they are
    kinds.right, kinds.groups     share of the groups of KIND_PX or more whose kind is the true one; how many they are
    mirror.rho_s                  largest |rho_s - rho_s*| of mirrors, coloured ones too
    glossy.rho_d, glossy.rho_s    largest absolute error
    glossy.alpha                  largest relative error, along both axes
    glossy.tangent                largest angle, up to sign
    mirror.within_3_sigma, glossy.within_3_sigma       share of those numbers
    texture.rmse                  of the albedo at the pixels that show a textured group
    texture.rho_d                 largest error of a group's mean
    gamma.absolute, gamma.in_sigmas
    lamp.mean_relative, lamp.max_relative              of the lamps that were unknown
    lamp.aim_deg, lamp.exponent                        largest angle, largest relative error of the lamps' lobes

Counted is a diffuse group with at least ENOUGH_PX pixels in truth's group image that is neither a lamp nor given as a
reference. Truth says what a group is: a mirror that is found to be diffuse counts among the mirrors. Where truth and
result are all diffuse there are no kinds.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

from lib.given.kinds import LOBES, MIRRORS
from lib.given.materials import Group, Materials
from lib.verdict.comparison import (
    ENOUGH_PX,
    Comparison,
    Deviation,
    ErrorAgainst,
    GroupComparison,
    LampComparison,
    TextureComparison,
    TransferComparison,
    Turn,
)

KIND_PX = 200  # of a group whose kind is judged
EVEN = 1.15  # alpha_x / alpha_y below which a lobe has no direction to speak of
CHANNELS = ("rho_d", "rho_s")
VALUES = (*CHANNELS, "alpha")  # what a group has numbers of


class Given(NamedTuple):
    """What scene.yaml told the fit, so that it is no finding: names of groups, names of lamps, {group: kind}."""

    references: frozenset
    lamps: frozenset
    surfaces: dict


def what_was_given(found: Materials, arguments: dict) -> Given:
    """arguments : of the fit's report; where it does not say, a sigma of zero or none marks what was given"""
    references, lamps = arguments.get("reference"), arguments.get("lamps")
    if not isinstance(references, dict):
        references = [name for name, group in found.groups.items() if _looks_given(group)]
    if isinstance(lamps, dict):
        known = [name for name in found.lamps if lamps.get(name) != "unknown"]
    else:
        known = [name for name, lamp in found.lamps.items() if not (lamp.sigma and lamp.sigma.emittance)]
    return Given(frozenset(references), frozenset(known), arguments.get("surfaces") or {})


def _looks_given(group: Group):
    return group.rho_d is not None and not group.is_mirror and group.sigma.rho_d == (0, 0, 0)


def compare(found: Materials, truth: Materials, pixels, given: Given, albedo=None):
    """(errors, Comparison with groups, kinds, textures, transfer and lamps).

    pixels : {group: pixels in truth's group image};  albedo : {group: (ours (M, 3), truth (M, 3))}, or None
    """
    groups = compare_groups(found, truth, pixels, given.references)
    kinds, errors_of_kinds = compare_kinds(groups, given.surfaces)
    textures, errors_of_textures = compare_textures(albedo or {}, groups)
    transfer, errors_of_transfer = compare_transfer(found, truth)
    lamps, errors_of_lamps = compare_lamps(found, truth, given.lamps)
    errors = [
        *summary([g for g in groups.values() if g.counted], "reflectance"),
        *summary([g for g in groups.values() if _is_small(g)], "small"),
        *only_in_mirrors(found, groups),
        *errors_of_kinds,
        *not_diffuse(groups),
        *errors_of_textures,
        *errors_of_transfer,
        *errors_of_lamps,
    ]
    details = Comparison(groups=groups, kinds=kinds, textures=textures, transfer=transfer, lamps=lamps)
    return [_against_truth(*error) for error in errors], details


def _against_truth(name, value, unit="1"):
    return ErrorAgainst("fit", name, value, unit, "truth")


# ---- groups ----


def compare_groups(found: Materials, truth: Materials, pixels, references=(), enough_px=ENOUGH_PX):
    """{group: GroupComparison} for every group of truth that is no lamp.

    >>> from lib.given.materials import Sigma
    >>> wall = Group(rho_d=(0.5, 0.5, 0.4), sigma=Sigma(rho_d=(0.01, 0.001, 0.01)))
    >>> truth = Materials(groups={"wall": Group(rho_d=(0.5, 0.51, 0.4))})
    >>> c = compare_groups(Materials(groups={"wall": wall}), truth, {"wall": 900})["wall"]
    >>> c.counted, [round(r, 4) for r in c.rho_d.relative], [round(s) for s in c.rho_d.in_sigmas]
    (True, [0.0, -0.0196, 0.0], [0, -10, 0])
    """
    lamps = truth.lamps.keys() | found.lamps.keys()
    return {
        name: _compare_group(
            found.groups.get(name, Group()), true, int(pixels.get(name, 0)), name in references, enough_px
        )
        for name, true in truth.groups.items()
        if name not in lamps and true.rho_d is not None
    }


def _compare_group(found: Group, true: Group, pixels, given, enough_px):
    kind = true.kind or "diffuse"
    result = GroupComparison(
        pixels=pixels,
        given=given,
        identified=found.identified is not False and found.rho_d is not None,
        counted=pixels >= enough_px and not given and kind == "diffuse",
        kind=(found.kind or "diffuse", kind),
    )
    values = {key: (getattr(found, key), getattr(true, key), getattr(found.sigma, key)) for key in VALUES}
    deviations = {
        key: Deviation.of(value, true_value, sigma)
        for key, (value, true_value, sigma) in values.items()
        if true_value is not None and (key == "rho_d" or any(true_value) or any(value or ()))
    }
    if true.tangent and true.alpha and true.alpha[0] > EVEN * true.alpha[1]:
        deviations["tangent"] = Turn.of(found.tangent, true.tangent, found.sigma.tangent_rad)
    return replace(result, **deviations)


def _is_small(g: GroupComparison):
    return not g.counted and not g.given and g.pixels > 0 and g.kind[1] == "diffuse"


def summary(groups, prefix):
    """[(name, value, unit)]: the errors over some groups; none where there are no groups."""
    if not groups:
        return []
    known = _found_reflectances(groups)
    absolute, relative = sizes(c.absolute for c in known), sizes(c.relative for c in known)
    sigma = sizes(c.sigma for c in known)
    errors = []
    if relative:
        errors += [("mean_relative", sum(relative) / len(relative), "1"), ("max_relative", max(relative), "1")]
    if absolute:
        errors += [
            ("max_absolute", max(absolute), "1"),
            ("within_3_sigma", share_within([s for c in known for s in c.in_sigmas]), "1"),
        ]
    if sigma:
        errors.append(("median_sigma", median(sigma), "1"))
    errors += [
        ("unidentified", sum(not g.identified for g in groups), "groups"),
        ("groups", len(groups), "groups"),
    ]
    return [(f"{prefix}.{name}", value, unit) for name, value, unit in errors]


def _found_reflectances(groups):
    """[Deviation] of rho_d and rho_s."""
    both = [c for g in groups if g.identified for c in (g.rho_d, g.rho_s)]
    return [c for c in both if c and c.value is not None]


def sizes(deviations):
    """The absolute values of many numbers, those that are None left out.

    >>> sizes([(1, -2), None, (None,)])
    [1, 2]
    """
    return [abs(v) for values in deviations for v in values or () if v is not None]


def share_within(in_sigmas, limit=3):
    """Share of the deviations of at most so many sigmas; one without sigma is outside.

    >>> share_within([1, -3, 4, None])
    0.5
    """
    return sum(s is not None and abs(s) <= limit + 1e-9 for s in in_sigmas) / len(in_sigmas)


def median(values):
    """
    >>> median([3, 1, 2]), median([1, 2])
    (2, 1.5)
    """
    values = sorted(values)
    middle = len(values) // 2
    return values[middle] if len(values) % 2 else (values[middle - 1] + values[middle]) / 2


def only_in_mirrors(found: Materials, groups):
    """Errors of the diffuse groups that the camera sees only by way of a mirror, and whose reflectance is found."""
    if not any(g.is_mirror for g in found.groups.values()):
        return []
    members = [g for g in groups.values() if g.is_judged and g.pixels == 0 and g.kind[1] == "diffuse"]
    relative = sizes(g.rho_d.relative for g in members)
    if not relative:
        return []
    return [
        ("reflectance.only_in_mirror", sum(relative) / len(relative)),
        ("reflectance.only_in_mirror_groups", len(members), "groups"),
    ]


# ---- kinds, mirrors, lobes, textures ----


def compare_kinds(groups, named):
    """({group: (found, true)} of the wrong ones or None, errors): is each group what it is?

    Not asked of groups whose kind scene.yaml names, nor where all is diffuse, in truth and as found.
    """
    judged = {n: g.kind for n, g in groups.items() if g.is_judged and g.pixels >= KIND_PX and n not in named}
    if not {kind for pair in judged.values() for kind in pair} - {"diffuse"}:
        return None, []
    wrong = {name: pair for name, pair in judged.items() if pair[0] != pair[1]}
    return wrong, [("kinds.right", 1 - len(wrong) / len(judged)), ("kinds.groups", len(judged), "groups")]


def not_diffuse(groups):
    """Of mirrors and of glossy groups: the largest error of each kind of number; how many lie within their sigma."""
    judged = [g for g in groups.values() if g.is_judged and g.pixels >= KIND_PX]
    errors = []
    for prefix, kinds, keys in (
        ("mirror", MIRRORS, ("rho_s",)),
        *((kind, (kind,), ("rho_d", "rho_s", "alpha", "tangent")) for kind in LOBES),
    ):
        members = [g for g in judged if g.kind[1] in kinds]
        for key in keys:
            how, unit = {"alpha": ("relative", "1"), "tangent": ("degrees", "deg")}.get(key, ("absolute", "1"))
            deviations = [getattr(g, key) for g in members]
            errors += _worst(f"{prefix}.{key}", [getattr(d, how) for d in deviations if d], unit)
        in_sigmas = [s for g in members for key in keys for s in _once(getattr(g, key))]
        if in_sigmas:
            errors.append((f"{prefix}.within_3_sigma", share_within(in_sigmas)))
    return errors


def _worst(name, deviations, unit="1"):
    """The largest of many deviations; no error where there are none."""
    found = sizes(deviations)
    return [(name, max(found), unit)] if found else []


def _once(deviation):
    """Its in_sigmas; alpha counts once where the lobe is round both in truth and as found."""
    in_sigmas = (deviation and deviation.in_sigmas) or ()
    round_lobe = len(in_sigmas) == 2 and all(len({*alpha}) == 1 for alpha in (deviation.truth, deviation.value))
    return in_sigmas[:1] if round_lobe else in_sigmas


def compare_textures(albedo, groups):
    """({group: TextureComparison} or None, errors): RMSE over all pixels that show textured groups."""
    squares = {
        name: (float(((ours - true) ** 2).mean()), len(ours)) for name, (ours, true) in albedo.items() if name in groups
    }
    if not squares:
        return None, []
    textures = {name: TextureComparison(math.sqrt(square), n) for name, (square, n) in squares.items()}
    rmse = math.sqrt(sum(square * n for square, n in squares.values()) / sum(n for _, n in squares.values()))
    means = [groups[name].rho_d.absolute for name in squares]
    return textures, [("texture.rmse", rmse), *_worst("texture.rho_d", means)]


# ---- transfer function and lamps ----


def compare_transfer(found: Materials, truth: Materials):
    """(TransferComparison or None, errors)."""
    ours, true = found.transfer, truth.transfer
    errors = []
    if ours.kind == true.kind == "gamma":
        error = ours.gamma - true.gamma
        errors.append(("gamma.absolute", abs(error)))
        if ours.sigma:
            errors.append(("gamma.in_sigmas", abs(error) / ours.sigma, "sigma"))
    return (TransferComparison(ours, true) if true.kind else None), errors


def compare_lamps(found: Materials, truth: Materials, known):
    """({lamp: LampComparison} or None, errors over the lamps that were not known)."""
    entries, relative = {}, []
    for name, true in truth.lamps.items():
        ours = found.lamps.get(name)
        value, sigma = (ours.emittance, ours.sigma and ours.sigma.emittance) if ours else (None, None)
        off = None
        if value and true.emittance:
            off = tuple(v / t - 1 if t else None for v, t in zip(value, true.emittance, strict=True))
        entries[name] = LampComparison(name in known, value, true.emittance, sigma, off)
        if off and name not in known:
            relative += [abs(r) for r in off if r is not None]
    errors = (
        [("lamp.mean_relative", sum(relative) / len(relative)), ("lamp.max_relative", max(relative))]
        if relative
        else []
    )
    return entries or None, [*errors, *_lobes(found, truth)]


def _lobes(found: Materials, truth: Materials):
    """Errors of lobes that both know."""
    both = [(found.lobes[name], true) for name, true in truth.lobes.items() if name in found.lobes]
    if not both:
        return []
    angle = max(math.degrees(math.acos(min(1.0, float(ours[:3] @ true[:3])))) for ours, true in both)
    exponent = max(float(abs(ours[3] / true[3] - 1)) for ours, true in both if true[3] > 0)
    return [("lamp.aim_deg", angle, "deg"), ("lamp.exponent", exponent)]
