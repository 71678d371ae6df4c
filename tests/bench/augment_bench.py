"""Changed photographs against Mitsuba's picture of the changed scene, and CPU time against making all anew.

    $ python -m tests.bench.augment_bench OUT/ TRUTH/ [scene ...]      OUT/augment.csv, OUT/<scene>.<case>.png

TRUTH/ holds what augment_truth.py writes. The scenes must have been made (build/<scene>). `rmse` is of display values over
the whole picture, `noise` that of the truth's own path tracing, `apart` their difference in squares, `identical` the
share of pixels whose true change is below a quarter step that are the photograph's to the last bit: of those pixels
whose true change the truth's noise lets tell.
"""

import csv
import json
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from lib.buffers import index_buffer  # noqa: E402
from lib.given import cameras, image, materials  # noqa: E402
from lib.light import adapt, form_factors, outside  # noqa: E402
from lib.light import lamps as lamps_  # noqa: E402
from lib.light import surface as surfaces  # noqa: E402
from lib.picture import augmented, rendering  # noqa: E402
from lib.picture.subject import Quality  # noqa: E402
from lib.synthetic.optics import look  # noqa: E402
from tests.bench.augment_cases import CASES, FILES, VIEW  # noqa: E402

QUALITY = Quality(lobe_rays=128)
STEP = 1 / 255


def files_of(scene, build):
    """{option: path} of a made scene."""
    data, made = ROOT / "data" / scene, Path(build) / scene
    files = {"model": data / "model.obj", "camera": data / "left.posed.cameramodel", "photograph": data / "left.png"}
    files |= {name: made / f"{name}.{end}" for name, end in (("facet", "png"), ("materials", "json"))}
    files |= {name: made / f"{name}.npz" for name in ("formfactors", "coverage")}
    if (made / "specular.npz").is_file():
        files["specular"] = made / "specular.npz"
    return {name: str(path) for name, path in files.items()}


def entry_of(scene, case, folder):
    """The entry of a case, its files written into a folder."""
    entry = {"name": case, **json.loads(json.dumps(CASES[scene][case]))}
    for name, text in FILES.items():
        (folder / name).write_text(text)
    if "file" in entry.get("add", {}):
        entry["add"]["file"] = str(folder / entry["add"]["file"])
    if "camera" in entry:
        own = cameras.read_cameramodel(ROOT / "data" / scene / "left.posed.cameramodel")
        T = look(np.array(VIEW["eye"]), np.array(VIEW["at"]))
        entry["camera"] = str(folder / f"{scene}.{entry['camera']}")
        cameras.write_cameramodel(entry["camera"], cameras.Camera(own.K, own.width, own.height, T))
    return entry


def anew(scene):
    """CPU seconds of making the changed scene's picture from its model: form factors, index buffers, rendering."""
    began = time.process_time()
    subject, lamps = scene.changed, scene.changed.factors.own_lamps
    surfaces._kept.clear()
    surface = surfaces.surface(subject.view.model, lamps)
    emitters = lamps_.emitters(surface, lamps)
    mesh = adapt.build(surface, patches=300, max_level=5, contrast=0.01, emitters=emitters)
    form_factors.rays(surface, mesh, n_rays=512)
    lamps_.patch_direct(surface, mesh, emitters, len(lamps), n_points=32)
    view, pieces = augmented.seen(subject.view.model, subject.view.camera, subject.view.photograph)
    rendering.render(subject, QUALITY)
    return time.process_time() - began


def display(linear, gamma):
    return np.clip(linear, 0, 1) ** (1 / gamma)


def measured(scene, case, out, truth, build="build"):
    """A row of the table."""
    files = files_of(scene, build)
    entry = entry_of(scene, case, out)
    began = time.process_time()
    read = augmented.read(entry, files)
    made = augmented.picture(read, QUALITY)
    row = {"scene": scene, "case": case, "cpu_s": time.process_time() - began, "anew_s": anew(read)}
    image.write_png8(out / f"{scene}.{case}.png", made.values)
    path = truth / f"{scene}.{case}.npz"
    if not path.is_file():
        return row
    gamma = materials.read(ROOT / "data" / scene / "truth" / "materials.json").transfer.gamma
    true, noise = (np.load(path)[key].astype(float) for key in ("linear", "noise"))
    shown = display(true, gamma)
    values = made.values / 255
    error = values - shown
    sigma = noise * np.maximum(true, 1e-4) ** (1 / gamma - 1) / gamma * (true < 1)
    row |= {"rmse": rms(error), "noise": rms(sigma)}
    row["apart"] = np.sqrt(max(row["rmse"] ** 2 - row["noise"] ** 2, 0))
    if "camera" not in entry:
        before = image.read_photograph(files["photograph"]).values
        row["photograph"] = rms(before - shown)
        new = (read.recovered.facet != read.changed.facet) & (read.changed.facet >= 0)
        row["on_new"] = rms(error[new]) if new.any() else None
    image.write_png8(
        out / f"{scene}.{case}.side.png",
        np.rint(255 * np.clip(np.hstack([values, shown, 0.5 + 5 * error]), 0, 1)).astype(np.uint8),
    )
    return row


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def main(out, truth, *scenes, build="build"):
    out, truth = Path(out), Path(truth)
    out.mkdir(parents=True, exist_ok=True)
    rendering.warm_up(3, shiny=True)
    rows = []
    for scene in scenes or CASES:
        for case in CASES[scene]:
            rows.append(measured(scene, case, out, truth, build))
            print({k: round(v, 4) if isinstance(v, float) else v for k, v in rows[-1].items()}, flush=True)
    keys = list(dict.fromkeys(key for row in rows for key in row))
    with open(out / "augment.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, keys)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
