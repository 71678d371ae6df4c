"""Changed photographs against Mitsuba's picture of the changed scene, and CPU time against making all anew.

    $ python -m tests.bench.augment_bench OUT/ TRUTH/ BUILD/ [scene ...]      OUT/augment.csv, OUT/<scene>.<case>.png

TRUTH/ holds what augment_truth.py writes. The scenes must have been made into BUILD/. `rmse` is of display values over
the whole picture, `noise` that of the truth's own path tracing, `apart` their difference in squares; `told`,
`identical`, `elsewhere` and `missed` say how the photograph is kept where nothing changes, see `kept`.
"""

import csv
import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from lib.given import cameras, image, materials  # noqa: E402
from lib.given.model import glb_writer  # noqa: E402
from lib.given.model.parts import only  # noqa: E402
from lib.light import adapt, form_factors  # noqa: E402
from lib.light import lamps as lamps_  # noqa: E402
from lib.light import surface as surfaces  # noqa: E402
from lib.picture import augmented, changes, differential, rendering  # noqa: E402
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
    """CPU seconds of making the changed scene's picture from its model (form factors, index buffers, rendering), and of
    that and the picture of the scene as it was, of which the difference is made."""
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
    one = time.process_time() - began
    rendering.render(scene.recovered, QUALITY)
    return one, time.process_time() - began


def display(linear, gamma):
    return np.clip(linear, 0, 1) ** (1 / gamma)


def measured(scene, case, out, truth, build):
    """A row of the table."""
    files = files_of(scene, build)
    entry = entry_of(scene, case, out)
    began = time.process_time()
    read = augmented.read(entry, files)
    made = augmented.picture(read, QUALITY)
    row = {"scene": scene, "case": case, "cpu_s": time.process_time() - began}
    row |= dict(zip(("one_anew_s", "both_anew_s"), anew(read), strict=True))
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
    row["apart"] = float(np.sqrt(max(row["rmse"] ** 2 - row["noise"] ** 2, 0)))
    if "camera" not in entry:
        before = image.read_photograph(files["photograph"]).values
        row["photograph"] = rms(before - shown)
        new = (read.recovered.facet != read.changed.facet) & (read.changed.facet >= 0)
        row["on_new"] = rms(error[new]) if new.any() else None
        with np.load(path) as file:
            row |= kept(made.values, before, true, file["change"], file["change_noise"], gamma)
    image.write_png8(
        out / f"{scene}.{case}.side.png",
        np.rint(255 * np.clip(np.hstack([values, shown, 0.5 + 5 * error]), 0, 1)).astype(np.uint8),
    )
    return row


def kept(values, photograph, true, change, noise, gamma):
    """How the photograph is kept where the true change is below a quarter step, told by at least two of its errors.

    values : (H, W, 3) of 255;  true, change, noise : linear, after the change, its size and standard error
    told : such pixels, a share of all;  identical : to the last bit, a share of those
    elsewhere : the largest change of ours there, in steps: nothing should change by as much as one
    missed : the largest true change, less three of its errors, of pixels that we left as they were, in steps
    """
    apart = np.abs(display(true, gamma) - display(true - change, gamma))
    slope = np.maximum(np.minimum(true, true - change), 1e-4) ** (1 / gamma - 1) / gamma
    told = (apart + 2 * slope * noise < STEP / 4).all(axis=2)
    ours = np.abs(values - np.rint(255 * photograph)).max(axis=2)[told]
    left = (values == np.rint(255 * photograph)).all(axis=2)
    missed = ((apart - 3 * slope * noise) / STEP).max(axis=2)[left]
    row = {"told": told.mean(), "identical": (ours == 0).mean() if len(ours) else np.nan}
    row |= {"elsewhere": ours.max(initial=0), "missed": missed.max(initial=0)}
    return {key: float(value) for key, value in row.items()}


def reinserted(scene, objects, out, build):
    """Objects of the photograph taken out of it, and put back into what is left: the errors against the photograph.

    Two steps, each of which sees only the picture and the model before it: `off` are the display RMSE over the objects'
    pixels, over those that their absence changed beside them (shadow, bounced light), and over the rest.
    """
    files = files_of(scene, build)
    gone = augmented.read({"name": "gone", "remove": objects}, files)
    empty = augmented.picture(gone, QUALITY)
    photograph = gone.recovered.view.photograph
    left = replace(photograph, values=empty.values / 255)
    room = differential.as_drawn(gone.recovered, gone.changed)
    room = replace(room, view=replace(room.view, photograph=left))
    found, model = materials.read(files["materials"]), room.view.model
    things = []
    for name in objects:
        thing = only(gone.recovered.view.model, [name])
        path = out / f"{name}.glb"
        glb_writer.write_glb(path, thing)
        of = {g: {"kind": found.groups[g].kind, "rho_d": list(found.groups[g].rho_d)} for g in thing.groups}
        things.append({"file": str(path), "at": [0, 0, 0], "material": of})
    change = changes.apply({"add": things}, files["materials"], found, model, room.factors.own_lamps)
    view, pieces = augmented.seen(change.model, room.view.camera, left)
    back = changes.subject(change, room, room.factors, view, pieces, files["materials"])
    pair = differential.renderings(room, back, QUALITY)
    linear, _ = differential.composed(left, pair, room.transfer)
    error = np.round(255 * differential.shown(linear, room.transfer)) / 255 - photograph.values
    own = np.isin(gone.recovered.surface.object[gone.recovered.facet], [model.objects.index(n) for n in objects])
    beside = (np.abs(left.values - photograph.values).max(axis=2) > 1.5 * STEP) & ~own
    image.write_png8(out / f"{scene}.empty.png", empty.values)
    image.write_png8(out / f"{scene}.back.png", np.round(255 * (error + photograph.values)).astype(np.uint8))
    return {
        "own": rms(error[own]),
        "beside": rms(error[beside]),
        "rest": rms(error[~own & ~beside]),
        "px": int(own.sum()),
        "px_beside": int(beside.sum()),
    }


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def gallery(out, scene, path, cases=("viewpoint", "egg", "mirror", "painted", "lamp", "removed")):
    """A picture of the cases that have a truth: ours above, Mitsuba's below, at half the size."""
    import cv2

    columns = []
    for case in cases:
        if (out / f"{scene}.{case}.side.png").is_file():
            values = image.read_photograph(out / f"{scene}.{case}.side.png").values
            own, true, _ = np.split(values, 3, axis=1)
            both = np.vstack([own, true])
            columns.append(cv2.resize(both, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    if columns:
        cv2.imwrite(
            str(path), np.rint(255 * np.hstack(columns)[..., ::-1]).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 88]
        )


RAYS = (16, 64, 256, 1024)


def curves(out, cases=("egg", "removed", "moved", "night")):
    """For `make bench`: error against CPU time over the number of rays; yardstick: the most, with fourfold shadow rays.

    Writes OUT/augment.csv and OUT/augment.png.
    """
    import matplotlib.pyplot as plt

    build = out / "augment"
    subprocess.run(["make", "-s", f"BUILD={build}", "office"], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    rendering.warm_up(3, shiny=True)
    files, rows = files_of("office", build), []
    for case in cases:
        read = augmented.read(entry_of("office", case, build), files)
        best = augmented.picture(read, replace(QUALITY, n_rays=RAYS[-1], shadow_rays=256, tolerance=0.0025)).linear
        for rays in RAYS:
            began = time.process_time()
            made = augmented.picture(read, replace(QUALITY, n_rays=rays))
            spent = time.process_time() - began
            T = read.recovered.transfer
            error = rms(differential.shown(made.linear, T) - differential.shown(best, T))
            rows.append((case, rays, spent, error, made.facts["changed_pixels"]))
            print("   ", *rows[-1], flush=True)
    with open(out / "augment.csv", "w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("case", "rays", "cpu_s", "rmse", "changed_pixels"), *rows])
    figure, axes = plt.subplots(figsize=(6, 4.6))
    for case in cases:
        own = [row for row in rows if row[0] == case]
        axes.plot([row[2] for row in own], [row[3] for row in own], "o-", label=case)
    axes.set(xlabel="CPU s", ylabel="display RMSE against many rays", yscale="log", title="office, changed")
    axes.legend(fontsize=7)
    figure.savefig(out / "augment.png", dpi=110)
    plt.close(figure)


def main(out, truth, build, *scenes):
    out, truth = Path(out), Path(truth)
    out.mkdir(parents=True, exist_ok=True)
    rendering.warm_up(3, shiny=True)
    rows = []
    for scene in scenes or CASES:
        for case in CASES[scene]:
            rows.append(measured(scene, case, out, truth, build))
            print({k: round(v, 4) if isinstance(v, float) else v for k, v in rows[-1].items()}, flush=True)
        gallery(out, scene, out / f"{scene}.jpg")
    keys = list(dict.fromkeys(key for row in rows for key in row))
    with open(out / "augment.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, keys)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
