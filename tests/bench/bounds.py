"""The bounds of tests/expected, from a run:  python -m tests.bench.bounds [--anew] build/SCENE ...

The rule. An error may become twice that of the run, and no better than a quarter of it: then somebody stopped looking,
or the bounds are to be tightened. FLOORS says what an error counts as at the least: processors round differently, and
below it nobody asks. Of shares that should be 1 what is missing may double (at least .05). Counts stay as they are.
A bound is never loosened: where a run breaks the old ones, or would widen them, the old ones stay and that is said.
`--anew` forgets them, and the change that does so says why. Comments and the choice of errors stay; a scene without a
file gets all that its scorecard has of FLOORS, SHARES and COUNTS.
"""

import argparse
import math
import sys
from pathlib import Path

from lib.verdict import scorecard

ROOT = Path(__file__).resolve().parents[2]
EXPECTED = ROOT / "tests/expected"
TIMES, BETTER = 2.0, 4.0  # what an error of the run may become, and how much smaller it may be
MISSING = 0.05  # of a share that should be 1
SHARES = ("reflectance.within_3_sigma", "mirror.within_3_sigma", "disparity.covered")
COUNTS = (
    "reflectance.groups",
    "reflectance.unidentified",
    "reflectance.only_in_mirror_groups",
    "kinds.groups",
    "kinds.right",
)
FLOORS = {
    "reflectance.mean_relative": 5e-4,
    "reflectance.max_absolute": 5e-4,
    "reflectance.only_in_mirror": 5e-4,
    "reflectance.median_sigma": 1e-4,
    "mirror.rho_s": 5e-4,
    "glossy.rho_s": 5e-4,
    "glossy.rho_d": 5e-4,
    "glossy.alpha": 5e-4,
    "glossy.tangent": 0.02,  # degrees
    "texture.rmse": 5e-4,
    "texture.rho_d": 5e-4,
    "lamp.aim_deg": 0.05,
    "lamp.exponent": 5e-3,
    "gamma.absolute": 1e-3,
    "render.rmse": 5e-4,
    "flux": 5e-4,
    "index.differ": 5e-5,
    "row_sum.max_excess": 5e-7,
    "row_sum.largest_opening": 5e-4,
    "pose.angle_deg": 2e-3,
    "pose.centre_mm": 0.2,
    "pose.vertices_px": 0.01,
    "pose.vertices_max_px": 0.02,
    "pose.in_sigmas": 1.0,
    "facets.compared": 0,
    "lens.left.projection_px": 0.01,
    "lens.right.projection_px": 0.01,
    "lens.left.focal_relative": 5e-4,
    "lens.right.focal_relative": 5e-4,
    "pair.baseline_relative": 1e-4,
    "pair.angle_deg": 2e-3,
    "disparity.median_px": 0.01,
    "disparity.bad_1px": 5e-3,
    "rms_left": 0.01,
    "rms_right": 0.01,
    "uncertainty_left": 0.01,
}


def bounds(error, value):
    """(low, high) for an error that a run has, to two digits.

    >>> bounds("reflectance.mean_relative", 0.00081), bounds("gamma.absolute", 5e-5), bounds("kinds.groups", 16)
    ((0.0002, 0.0017), (0.0, 0.002), (16, 16))
    >>> bounds("reflectance.within_3_sigma", 1.0), bounds("reflectance.within_3_sigma", 0.96)
    ((0.95, 1.0), (0.92, 1.0))
    """
    if error in COUNTS:
        return value, value
    if error in SHARES:
        return _two_digits(1 - max(TIMES * (1 - value), MISSING), math.floor), 1.0
    floor = FLOORS[error]
    low = _two_digits(value / BETTER, math.floor) if value > floor else 0.0
    return low, _two_digits(TIMES * max(value, floor), math.ceil)


def _two_digits(value, towards):
    if not value:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - 1)
    return float(f"{towards(round(value / unit, 6)) * unit:.2g}")


def tightened(error, value, low, high):
    """((low, high), why the old bounds stay or "").

    >>> tightened("render.rmse", 0.005, 0.0026, 0.0073), tightened("render.rmse", 0.01, 0.0026, 0.0073)
    (((0.0026, 0.0073), ''), ((0.0026, 0.0073), 'render.rmse = 0.01 is not in [0.0026, 0.0073]'))
    """
    if not low <= value <= high:
        return (low, high), f"{error} = {value:g} is not in [{low:g}, {high:g}]"
    new = bounds(error, value)
    return (max(low, new[0]), min(high, new[1])), ""


def values(build):
    """{error: the largest of its values} of a scene's scorecard."""
    found = {}
    for row in scorecard.read_table(build / "scorecard.csv", scorecard.COLUMNS):
        if row["error"] and row["value"]:
            found[row["error"]] = max(float(row["value"]), found.get(row["error"], -math.inf))
    return found


def write(build, anew):
    """tests/expected/<scene>.csv of a scene's build folder; what is said."""
    path, found, said = EXPECTED / f"{build.name}.csv", values(build), []
    old, comments = {}, []
    if path.exists():
        rows = scorecard.read_table(path, ("error", "low", "high"))
        old = {row["error"]: (float(row["low"]), float(row["high"])) for row in rows}
        comments = [line for line in path.read_text().splitlines() if line.startswith("#")]
    lines = []
    for error in old or [e for e in found if e in FLOORS or e in SHARES or e in COUNTS]:
        if error not in found:
            said.append(f"{build.name}: {error}: missing in the scorecard")
            low, high = old[error]
        elif anew or error not in old:
            low, high = bounds(error, found[error])
        else:
            (low, high), why = tightened(error, found[error], *old[error])
            said += [f"{build.name}: {why}: kept"] if why else []
        lines.append(f"{error},{low:g},{high:g}")
    path.write_text("\n".join(["error,low,high", *comments, *lines]) + "\n")
    return said


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", nargs="+", type=Path, help="build folders of scenes")
    parser.add_argument("--anew", action="store_true", help="forget the bounds that are there")
    opt = parser.parse_args()
    said = [line for build in opt.build for line in write(build, opt.anew)]
    for line in said:
        print(line, file=sys.stderr)
    sys.exit(1 if said else 0)


if __name__ == "__main__":
    main()
