"""What a run says of itself: how long each stage will take, by the last run or by a shipped scene; and its last lines.

    $ python -m lib.planning.progress build/office --began 1700000000 --title office --page build/office/report.html

Only the standard library: this runs at every `make`.
"""

import argparse
import time
from pathlib import Path

from lib.core import artefact
from lib.core.stage import BadInput
from lib.core.words import about
from lib.planning import gallery, next_steps

# Seconds of a run on two cores, 640 x 480 px, without compiling; what grows with the photograph, and what does not
TYPICAL = {
    **{"edges": (2, 0), "index": (1, 1), "formfactors": (6, 0), "gather": (4, 1), "fit": (4, 1), "coverage": (1, 1)},
    **{"render": (8, 5)},
    **{"compare": (1, 0), "report": (3, 2), "calibrate": (20, 0), "segment": (2, 2), "surfaces": (1, 1)},
    **{"match": (1, 1), "reconstruct": (1, 2), "recognise": (1, 2), "orient": (4, 2), "undistort": (1, 0)},
}
ELSE = (2, 1)
PHOTOMETRY = ("edges", "index", "formfactors", "gather", "fit", "coverage", "render", "compare", "report")
SIZE = 640 * 480


def seconds(stage, report, pixels=None) -> float:
    """Expected on the clock, without compiling: what the last run took, else what is typical of so many pixels."""
    try:
        last = _read(report)
        return float(last["waited_s"]) - float(last.get("compile_wall_s") or 0)
    except (TypeError, KeyError, ValueError):
        return typical([stage], pixels)


def typical(stages, pixels=None) -> float:
    """Seconds of stages on a photograph of so many pixels, by the shipped scenes."""
    of = [TYPICAL.get(stage, ELSE) for stage in stages]
    return sum(fixed + growing * (pixels or SIZE) / SIZE for fixed, growing in of)


def _read(path):
    try:
        found = artefact.read_json(path)
        return found if isinstance(found, dict) else {}
    except BadInput:
        return {}


def summary(build, title, page, began, stages) -> str:
    """The last line: status where it is not `converged`, error, materials, warnings, seconds, and where to look.

    The error is the rms of the re-rendering against the photograph, of full scale.
    """
    build = Path(build)
    reports = [_read(build / f"{name}.report.json") for name in stages]
    words = list(dict.fromkeys(_status(r) for r in reports if r.get("status") in SAID))
    rmse = _read(build / "rendered.json").get("rmse") if "render" in stages else None
    if isinstance(rmse, float):
        words.append(f"{100 * rmse:.2f} %")
    groups = _read(build / "materials.json").get("groups") if "fit" in stages else None
    if isinstance(groups, dict) and groups:
        known = sum(bool(isinstance(g, dict) and g.get("identified")) for g in groups.values())
        words.append(f"{known} of {len(groups)} materials")
    if "check" in stages:
        doubts = sum(bool(f.get("doubt")) for f in _read(build / "check.json").get("findings", []))
        words.append(f"{doubts} doubt{'s' * (doubts != 1)}")
    if noisy := list(dict.fromkeys(group for r in reports for group in r.get("noisy", []))):
        words.append(f"noise on {', '.join(noisy)}")
    warnings = sum(len(r.get("warnings", [])) for r in reports)
    words.append(f"{warnings} warning{'s' * (warnings != 1)}")
    if notes := sum(len(r.get("notes") or []) for r in reports):
        words.append(f"{notes} note{'s' * (notes != 1)}")
    words.append(f"{time.time() - began:.0f} s")
    place = Path(page).resolve().as_uri() if page.endswith(".html") else page
    return f"{title}: {', '.join(words)}: {place}"


SAID = ("not converged", "approximate", "does not fit", "nothing seen", "ambiguous", "symmetric")


def _status(report):
    """As it is said: `approximate, to about 4 %`."""
    status, to = report["status"], report.get("to")
    return f"{status}, {about(to)}" if status == "approximate" and isinstance(to, float) else status


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("build")
    parser.add_argument("--began", type=float, required=True)
    parser.add_argument("--title", required=True)
    parser.add_argument("--page", required=True)
    parser.add_argument("--stages", nargs="*", default=[])
    opt = parser.parse_args()
    gallery.write(Path(opt.build).parent)
    for line in next_steps.steps(next_steps.read(opt.build, opt.title, opt.stages)):
        print(f"- {line}")
    print(summary(opt.build, opt.title, opt.page, opt.began, opt.stages))


if __name__ == "__main__":
    main()
