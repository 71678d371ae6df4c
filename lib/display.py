"""§4.3 From the linear picture to the displayed one, and how far it is from the photograph.

    shown = Finish(transfer, photograph.values, group, pure)(B)      # any transfer of scene.yaml
    rmse(shown, photograph), ciede2000(shown, photograph)

`gamma`, `linear` and `srgb` are functions of B alone. The paper's other candidates look at the photograph and are
applied to the finished picture only, after reflectances fitted as under `linear`: `linear_per_group` (figure 4.4,
right), `histogram` and `histogram_per_group` (figure 4.5).
"""
from __future__ import annotations

import numpy as np

from lib.transfer import Transfer

KINDS = ("gamma", "linear", "srgb", "linear_per_group", "histogram", "histogram_per_group")


def finished(B, kind, photograph, group, pure, gamma=1.0):
    """Display values in [0, 1], (H, W, C).

    B : (H, W, C) linear;  photograph : (H, W, C) display;  group : (H, W) int, -1 = nothing
    pure : (H, W) bool, pixels that show one facet: they alone say what a group's values are
    """
    if kind == "linear":
        return np.clip(B, 0, 1)
    if kind in ("gamma", "srgb"):
        return Transfer(kind, gamma).display(B)
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
    synthetic, real = np.sort(synthetic), np.sort(real)
    level = 0.5 * (np.searchsorted(synthetic, values, "left") + np.searchsorted(synthetic, values, "right")) / len(synthetic)
    return np.interp(level, (np.arange(len(real)) + 0.5) / len(real), real)


def rmse(a, b):
    """Root mean square over pixels and channels; 0 for no pixels."""
    return float(np.sqrt(np.mean((a - b) ** 2))) if a.size else 0.0


def ciede2000(a, b):
    """(...,) colour difference of display values read as sRGB, (..., C) in [0, 1]; grey is three equal channels."""
    import warnings
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")                  # it grumbles about optional packages
        import colour
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
    total = [np.bincount(group[group >= 0], values[group >= 0], len(groups)) / np.maximum(number, 1) for values in (square, difference)]
    return {"rmse": rmse(shown, photograph), "ciede2000": float(difference.mean()),
            "groups": {name: {"rmse": float(np.sqrt(total[0][g])), "ciede2000": float(total[1][g])} for g, name in enumerate(groups) if number[g]}}


def transfer_models(B, photograph, group, pure, kind, gamma, fitted):
    """What each transfer function of the paper leaves (figures 4.4-4.6): a list of {kind, rmse, rmse_rescaled, note}.

    The linear picture B is the same in every row. `rmse_rescaled` is what remains after each group's radiosities were
    multiplied by the factor (per channel) that suits that transfer best: the reflectances fitted again at fixed light.
    kind, gamma : of the fit;  fitted : (H, W) bool, pixels that count (no lamps)
    """
    own = f"the reflectances' own transfer: {kind}" + (f", gamma {gamma:.4g}" if kind == "gamma" else "")
    other = f"reflectances fitted under {kind}, not under this"
    given = kind if kind in ("gamma", "srgb") else "linear"
    rows = []
    best = gamma if kind == "gamma" else _best_gamma(B, photograph, fitted)
    candidates = [("gamma", best, f"gamma {best:.4g}"), ("gamma", 2.2, "given gamma 2.2"), *((k, 1.0, "") for k in KINDS[1:])]
    for name, g, text in candidates:
        if name in ("gamma", "srgb", "linear"):
            text = "; ".join(t for t in (text, own if name == given and (name != "gamma" or g == gamma) else other) if t)
        else:
            text = {"linear_per_group": "[min, max] of each group and channel taken to the photograph's",
                    "histogram": "one T = E2^-1(E1(B)) for all channels", "histogram_per_group": "T = E2^-1(E1(B)) per group and channel"}[name]
            text += f"; {other}" if given != "linear" else ""
        row = {"kind": name, "rmse": rmse(finished(B, name, photograph, group, pure, g), photograph), "note": text}
        if name in ("gamma", "srgb", "linear"):
            row["rmse_rescaled"] = rmse(finished(_suited(B, name, g, photograph, group, fitted), name, photograph, group, pure, g), photograph)
        rows.append(row)
    return rows


def _suited(B, kind, gamma, photograph, group, fitted):
    """B with each group scaled, per channel, for the least squares of the display values: a few Gauss-Newton steps on ln scale."""
    result = B.copy()
    for g in np.unique(group[fitted]):
        mine = (group == g) & fitted
        some = slice(None, None, max(1, int(mine.sum()) // 2000))
        for c in range(B.shape[2]):
            b, want, s = B[mine, c][some], photograph[mine, c][some], 0.0
            show = lambda s: finished(b * np.exp(s), kind, None, None, None, gamma)
            for _ in range(8):
                slope = (show(s + 1e-4) - show(s - 1e-4)) / 2e-4
                step = ((want - show(s)) * slope).sum() / max((slope ** 2).sum(), 1e-12)
                s += np.clip(step, -1, 1)
                if abs(step) < 1e-4:
                    break
            result[group == g, c] *= np.exp(s)
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
