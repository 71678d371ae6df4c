"""White rooms with narrow gaps, fitted from many gammas: one answer, within its sigma?

    $ python -m tests.bench.starts --rooms white-3-1701 white-shelves-1701 --out /tmp/starts

A room is made as tests/bench/strangers.py makes it.  `make` runs once for each start; only the fit is run again then.
OUT/starts.jsonl has a line for each room: the spectral radius of the corrected F beside its largest row sum, the spread
of the reflectances over the starts in sigmas, and their errors.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from tests.bench.strangers import COUNTED_PX, ROOT, room

STARTS = (1.0, 1.3, 1.6, 1.9, 2.2, 2.5, 2.8, 3.3, 4.0, 5.0)


def answered(name, kind, starts, out):
    """One room as a dict."""
    from lib.synthetic import deviations

    scene = f"{name}-{kind}-starts"
    folder, build = out / "scenes" / scene, out / "build" / scene
    deviations.deviate(room(name, out), folder, kind, 1)
    facts = (folder / "scene.yaml").read_text()
    truth = json.loads((folder / "truth" / "materials.json").read_text())
    counted = [g for g, e in truth["groups"].items() if e.get("pixels", 0) >= COUNTED_PX and g not in truth["lamps"]]
    true = np.array([truth["groups"][g]["rho_d"] for g in counted])
    rho, sigma, status = [], [], []
    for start in starts:
        (folder / "scene.yaml").write_text(f"{facts}goals: [materials.json]\nparams: {{fit: {{gamma: {start}}}}}\n")
        command = ["make", f"DATA={out / 'scenes'}", f"BUILD={out / 'build'}", scene]
        subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
        found = json.loads((build / "materials.json").read_text())
        entries = [found["groups"][g] for g in counted]
        status.append(found["status"])
        rho.append([e["rho_d"] or [np.nan] * 3 for e in entries])
        sigma.append([e["sigma"]["rho_d"] or [np.nan] * 3 for e in entries])
    rho, sigma = np.array(rho), np.array(sigma)
    report = json.loads((build / "formfactors.report.json").read_text())
    told = {e["name"]: e["value"] for e in report["errors"]}
    return {
        "room": name,
        "kind": kind,
        "status": status,
        "radius": told["balance.spectral_radius"],
        "row_sum": 1 + told["row_sum.max_excess"],
        "spread_in_sigmas": float(np.max(np.ptp(rho, axis=0) / sigma.min(axis=0))),
        "mean_error": float(np.mean(np.abs(rho / true - 1))),
        "worst_in_sigmas": float(np.max(np.abs(rho - true) / sigma)),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="+", required=True)
    parser.add_argument("--kind", default="exact", help="of lib/synthetic/deviations.py")
    parser.add_argument("--starts", nargs="+", type=float, default=STARTS)
    parser.add_argument("--out", type=Path, required=True)
    opt = parser.parse_args()
    out = opt.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    for name in opt.rooms:
        row = answered(name, opt.kind, opt.starts, out)
        with open(out / "starts.jsonl", "a") as file:
            file.write(json.dumps(row) + "\n")
        print(*(f"{k} {v}" for k, v in row.items()), sep="  ", file=sys.stderr)


if __name__ == "__main__":
    main()
