"""§4.3 From the linear picture to the displayed one, and how far it is from the photograph.

    shown = finished(B, transfer, photograph, group, pure)      # any transfer of scene.yaml
    rmse(shown, photograph), ciede2000(shown, photograph)

Functions of B alone are `transfer_kinds.OF_LIGHT`. The paper's other candidates look at the photograph and are
applied to the finished picture only, after reflectances fitted as under `linear`: `linear_per_group` (figure 4.4,
right), `histogram` and `histogram_per_group` (figure 4.5).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lib.core import packages
from lib.given.transfer import CURVES, Transfer
from lib.given.transfer_kinds import KINDS

LEAST_PX = 200  # of a group whose rendering is judged
APART = 0.02  # display, median over a group: .004 at most on fourteen shipped scenes
# reflectances are fitted under these as they are, under the others as under `linear`
AS_FITTED = ("gamma", "curve", *CURVES)
NOTES = {
    "linear_per_group": "[min, max] of each group and channel taken to the photograph's",
    "histogram": "one T = E2^-1(E1(B)) for all channels",
    "histogram_per_group": "T = E2^-1(E1(B)) per group and channel",
}


def finished(B, transfer: Transfer, photograph=None, group=None, pure=None):
    """Display values in [0, 1], (H, W, C).

    B : (H, W, C) linear, any shape where the function is one of light alone;  transfer : of any of KINDS
    photograph : (H, W, C) display;  group : (H, W) int, -1 = nothing
    pure : (H, W) bool, pixels that show one facet: they alone say what a group's values are
    """
    kind = transfer.kind
    if kind == "linear":
        return np.clip(B, 0, 1)
    if kind in AS_FITTED:
        return transfer.display(B)
    if kind == "histogram":
        # one function for the picture, all channels together: the camera has one transfer function
        return _matched(B.ravel(), B.ravel(), photograph.ravel()).reshape(B.shape)
    one = _rescaled if kind == "linear_per_group" else _matched
    result = np.clip(B, 0, 1)
    for g in np.unique(group[group >= 0]):
        mine = group == g
        judged = mine & pure if (mine & pure).any() else mine
        for c in range(B.shape[2]):
            result[mine, c] = one(B[mine, c], B[judged, c], photograph[judged, c])
    return np.clip(result, 0, 1)


def _rescaled(values, synthetic, real):
    """The linear map that takes [min, max] of the synthetic values to that of the real ones."""
    low, high = synthetic.min(), synthetic.max()
    if high <= low:
        return np.full_like(values, real.mean())
    return real.min() + (values - low) * (real.max() - real.min()) / (high - low)


def _matched(values, synthetic, real):
    """The increasing map that gives the synthetic values the distribution of the real ones.

    §4.3.2 prints T = E1 o E2^-1 with the distribution functions E1 of the radiosities and E2 of the photograph, and
    reads it from left to right: first E1, then E2^-1. As composition of functions that is T = E2^-1(E1(B)).
    """
    step = max(1, len(real) // 150_000)
    step += step % 3 == 0  # not always the same channel
    x, y = (np.quantile(v[::step], np.linspace(0, 1, 1025)) for v in (synthetic, real))
    x, first, number = np.unique(x, return_index=True, return_counts=True)  # one value, many levels: their middle
    return np.interp(values, x, np.add.reduceat(y, first) / number)


def rmse(a, b):
    """Root mean square over pixels and channels; 0 for no pixels."""
    return float(np.sqrt(np.mean((a - b) ** 2))) if a.size else 0.0


def ciede2000(a, b):
    """(...,) colour difference of display values read as sRGB, (..., C) in [0, 1]; grey is three equal channels."""
    colour = packages.colour()
    lab = []
    for values in (a, b):
        values = np.broadcast_to(values, (*values.shape[:-1], 3)) if values.shape[-1] == 1 else values
        lab.append(colour.XYZ_to_Lab(colour.sRGB_to_XYZ(values)))
    return colour.delta_E(lab[0], lab[1], method="CIE 2000")


def scores(shown, photograph, group, groups):
    """{"rmse", "ciede2000", "groups": {name: {"rmse", "ciede2000"}}}: of all pixels, and of each group that is seen."""
    difference = ciede2000(shown, photograph)
    square = ((shown - photograph) ** 2).mean(axis=2)
    number = np.bincount(group[group >= 0], minlength=len(groups))
    total = [
        np.bincount(group[group >= 0], values[group >= 0], len(groups)) / np.maximum(number, 1)
        for values in (square, difference)
    ]
    return {
        "rmse": rmse(shown, photograph),
        "ciede2000": float(difference.mean()),
        "groups": {
            name: {"rmse": float(np.sqrt(total[0][g])), "ciede2000": float(total[1][g])}
            for g, name in enumerate(groups)
            if number[g]
        },
    }


def unlike(shown, photograph, group, counted, fitted) -> list[str]:
    """Lines on groups whose rendering is darker or brighter as a whole than the fit said: it proves them wrong.

    shown, photograph : (H, W, C) display;  group : (H, W) names or None;  counted : (H, W) bool
    fitted : {group: display RMSE} of the fit's own light
    """
    said = []
    for name, error in fitted.items():
        mine = counted & (group == name)
        if mine.sum() < LEAST_PX:
            continue
        off = np.median((shown - photograph)[mine], axis=0)
        if np.abs(off).max() > max(APART, 3 * error):
            much, way = np.abs(off).max(), "darker" if off[np.abs(off).argmax()] < 0 else "brighter"
            said.append(
                f"group {name!r} is {much:.3f} (display) {way} in the re-rendering than in the photograph, where"
                f" the fit left {error:.3f}: its values are not proved"
            )
    return said


def transfer_models(B, photograph, group, pure, transfer: Transfer, fitted):
    """What each transfer function of the paper leaves (figures 4.4-4.6): a list of {kind, rmse, rmse_refitted, note}.

    transfer : of the fit;  fitted : (H, W) bool, pixels that count (no lamps)

    `rmse` is of the same linear picture B in every row. `rmse_refitted` is after each group's radiosities were
    multiplied by the factor (per channel) that suits that transfer best: its reflectances fitted again, at fixed light.
    For the candidates that look at the photograph that factor is the one for `linear`, as the paper has it.
    """
    B, transfer = transfer.mixed(B), transfer.bare
    own = _under(transfer.kind)
    best = transfer.gamma if transfer.kind == "gamma" else _best_gamma(B, photograph, fitted)
    samples = _samples(B, photograph, group, fitted)
    candidates = [(Transfer("gamma", best), f"gamma {best:.4g}"), (Transfer("gamma", 2.2), "given gamma 2.2")]
    candidates += [(Transfer(name), NOTES.get(name, "")) for name in KINDS if name not in ("gamma", "curve")]
    candidates += [(transfer, "")] * (transfer.kind == "curve")
    rows, refitted = [], {}
    for candidate, note in candidates:
        under = candidate if candidate.kind in AS_FITTED else Transfer("linear")
        if under not in refitted:
            refitted[under] = B * _factors(samples, under)[np.maximum(group, 0)]
        error = lambda picture, T=candidate: rmse(finished(picture, T, photograph, group, pure), photograph)
        under = _under(candidate.kind)
        other = under != own or (candidate.kind == "gamma" and candidate.gamma != transfer.gamma)
        how = f"reflectances fitted under {own}, refitted under {under}" if other else "the transfer of the fit"
        rows.append(
            {
                "kind": candidate.kind,
                "rmse": error(B),
                "rmse_refitted": error(refitted[candidate if candidate.kind in AS_FITTED else Transfer("linear")]),
                "note": f"{note}; {how}" if note else how,
            }
        )
    return rows


def _under(kind):
    """The transfer function under which reflectances are fitted for a kind."""
    return kind if kind in AS_FITTED else "linear"


class Sample(NamedTuple):
    """Pixels of one group: B and photograph (n, C)."""

    B: np.ndarray
    photograph: np.ndarray


def _samples(B, photograph, group, fitted, most=2000):
    """[Sample] of each group up to the last that is seen, of at most about so many pixels each."""
    y, x = np.nonzero(fitted)
    order = np.argsort(group[y, x], kind="stable")
    y, x = y[order], x[order]
    start = np.searchsorted(group[y, x], np.arange(int(group.max(initial=0)) + 2))
    chosen = [slice(a, b, max(1, (b - a) // most)) for a, b in zip(start[:-1], start[1:], strict=True)]
    return [Sample(B[y[s], x[s]], photograph[y[s], x[s]]) for s in chosen]


def _factors(samples, transfer: Transfer):
    """(G, C) factors of the groups' radiosities for the least squares of the display values.

    Gauss-Newton on their logarithms.
    """
    result = np.ones((len(samples), samples[0].B.shape[1]))
    for g, (B, want) in enumerate(samples):
        if not len(B):
            continue
        log = np.zeros(B.shape[1])
        for _ in range(8):
            low, high = (finished(B * np.exp(log + h), transfer) for h in (-1e-4, 1e-4))
            slope = (high - low) / 2e-4
            towards = ((want - (low + high) / 2) * slope).sum(axis=0) / np.maximum((slope**2).sum(axis=0), 1e-12)
            step = np.clip(towards, -1, 1)
            log += step
            if np.abs(step).max() < 1e-4:
                break
        result[g] = np.exp(log)
    return result


def _best_gamma(B, photograph, fitted):
    """The gamma in [0.2, 8] of the least squares (eq. 4.1) on a sample of the pixels."""
    from scipy.optimize import minimize_scalar

    b, want = B[fitted], photograph[fitted]
    some = slice(None, None, max(1, len(b) // 20000))
    b, want = np.clip(b[some], 0, 1), want[some]
    if not len(b):
        return 2.2
    cost = lambda log: float(((b ** np.exp(-log) - want) ** 2).mean())
    return float(np.exp(minimize_scalar(cost, bounds=(np.log(0.2), np.log(8)), method="bounded").x))
