"""Who notices?  A shipped scene with one thing wrong, run by make: what was refused, said, taken or out of bounds.

    $ python -m tests.bench.checks OUT [wrong ...]

Told: what `materials.json` has as status and names, and the lines that stages wrote; a cause that it found and put
right counts as noticed.  Score: rows of the scorecard outside tests/expected/office.csv (only who knows the truth sees
these).  OUT/checks.jsonl has a line for each, and is gone on with.
"""

import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from tests.helpers.changed_scenes import clean, obj
from tests.verify.transformed import Drawing

ROOT = Path(__file__).resolve().parents[2]
SCENE = "office"


def told(text):
    def change(folder):
        (folder / "scene.yaml").write_text(text)

    return change


def half_radiance(folder):
    """The photograph of half the light, all else as it was."""
    import cv2

    gamma = json.loads((folder / "truth/materials.json").read_text())["transfer"]["gamma"]
    picture = cv2.imread(str(folder / "left.png"), cv2.IMREAD_UNCHANGED)
    cv2.imwrite(str(folder / "left.png"), np.round(picture * 0.5 ** (1 / gamma)).astype(picture.dtype))


def flipped(thing):
    """An object's polygons the other way round."""

    def turn(line, of):
        return "f " + " ".join(line.split()[:0:-1]) if line.startswith("f ") and thing in ("all", of) else line

    return lambda folder: obj(folder, turn)


def swapped(one, other):
    """Two groups' names, wherever they stand in the model."""
    names = {f"usemtl {one}": f"usemtl {other}", f"usemtl {other}": f"usemtl {one}"}
    return lambda folder: obj(folder, lambda line, _: names.get(line, line))


def camera_off(px):
    """Turned about its own vertical axis, as far as moves the picture's middle by px."""
    from scipy.spatial.transform import Rotation

    from lib.given import cameras

    def change(folder):
        from dataclasses import replace

        path = folder / "left.posed.cameramodel"
        camera = cameras.read_cameramodel(path)
        T = camera.T_cam_world.copy()
        T[:3] = Rotation.from_rotvec([0, px / camera.K[0, 0], 0]).as_matrix() @ T[:3]
        cameras.write_cameramodel(path, replace(camera, T_cam_world=T))

    return change


def one_facet(group, other):
    """The largest facet of one group gets the name of another that the model has."""

    def change(folder):
        drawing = Drawing.read(folder)
        area = [np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])) * (g == group) for _, g, p in drawing.polygons]
        k = int(np.argmax(area))
        thing, _, corners = drawing.polygons[k]
        drawing.polygons[k] = (thing, other, corners)
        drawing.write(folder)

    return change


LAMP = "lamps: {lamp: [28, 26.88, 24.64]}\n"
WRONG = {
    "nothing": lambda folder: None,
    "wrong gamma (2.2 told for 2.0)": told(LAMP + "transfer: {gamma: 2.2}\n"),
    "doubled lamp": told("lamps: {lamp: [56, 53.76, 49.28]}\n"),
    "half radiance": half_radiance,
    "flipped normals, all": flipped("all"),
    "flipped normals, one object": flipped("cabinet"),
    "swapped groups": swapped("floor", "ceiling"),
    "camera off by 2 px": camera_off(2.0),
    "one facet of a wrong group": one_facet("wall", "board"),
}


def table(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def run(name, folder):
    """A row of one wrong thing."""
    shutil.rmtree(folder, ignore_errors=True)
    given, build = folder / "data" / SCENE, folder / "build" / SCENE
    shutil.copytree(ROOT / "data" / SCENE, given)
    WRONG[name](given)
    with open(given / "scene.yaml", "a") as facts:
        facts.write('goals: ["materials.json", "rendered.exr", "scorecard.csv"]\n')
    words = ["make", f"DATA={folder}/data", f"BUILD={folder}/build", SCENE]
    made = subprocess.run(words, cwd=ROOT, env=clean(), capture_output=True, text=True)
    said = [line for line in made.stderr.splitlines() if "make" not in line.split(":")[0]]
    row = {"wrong": name, "exit": made.returncode, "said": said}
    if made.returncode:
        return row
    found = json.loads((build / "materials.json").read_text())
    row |= {"status": found["status"], "causes": [e["cause"] for e in found.get("explained") or []]}
    row["why"] = [w["cause"] for w in found.get("why") or []]
    row["unidentified"] = sum(not g["identified"] for g in found["groups"].values())
    score = {r["error"]: float(r["value"]) for r in table(build / "scorecard.csv") if r["value"]}
    bounds = table(ROOT / "tests" / "expected" / f"{SCENE}.csv")
    row["out"] = [
        f"{b['error']} {score.get(b['error'], float('nan')):.3g}"
        for b in bounds
        if not float(b["low"]) <= score.get(b["error"], float("nan")) <= float(b["high"])
    ]
    return row


def main(out, *names):
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    path = out / "checks.jsonl"
    rows = {r["wrong"]: r for r in map(json.loads, path.read_text().splitlines())} if path.exists() else {}
    for name in names or WRONG:
        if name not in rows:
            rows[name] = run(name, out / "run")
            with open(path, "a") as file:
                file.write(json.dumps(rows[name]) + "\n")
    for r in rows.values():
        print(
            f"{r['wrong']}: exit {r['exit']} {r.get('status', '')}",
            *(f"    {k}: {r[k]}" for k in list(r)[2:]),
            sep="\n",
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
