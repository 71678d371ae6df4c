"""Poses and facets of pairs that nobody tuned on: are they right, and do their sigmas know how wrong they are?

    $ python -m tests.bench.unseen_pairs --out /tmp/pairs --cast 1:61 --objects 1:61 --wrong 1:21
    $ python -m tests.bench.unseen_pairs --out /tmp/pairs --rooms pair-904 pair-912        # path-traced; needs Mitsuba

cast        random rooms, drawn by our own rays without shadows (tests/helpers/cast_rooms.py)
objects     CAD objects before a texture that no model has (tests/helpers/objects.py)
wrong       the same, with the model of another object: to be refused
rooms       pairs of lib/synthetic/random_pairs.py, path-traced once into OUT/rooms

The whole vision half runs: regions, surfaces, matches, facets, recognition. OUT/pairs.jsonl has a line for each pair
and is gone on with; the table is of all its lines. A pose is wrong if it is outside its 99.9 % ellipsoid and more than
1 degree or 2 % of the distance off. Facets: lib/verdict/vision_errors.py. Truth is read to score, and by nothing else.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
import numpy as np  # noqa: E402  after the number of threads

from lib.buffers import index_buffer  # noqa: E402
from lib.core import artefact  # noqa: E402
from lib.given import cameras  # noqa: E402
from lib.given import model as models  # noqa: E402
from lib.verdict.vision_errors import CHI2_3, CHI2_3_999, facet_errors  # noqa: E402
from lib.vision import creases, facets_file, matching, necks, segmentation, surfaces  # noqa: E402
from lib.vision.corners import answer  # noqa: E402
from lib.vision.facets import planes  # noqa: E402
from lib.vision.recognition import recognise  # noqa: E402
from lib.vision.refinement import rig  # noqa: E402
from tests.helpers import cast_rooms, jpegs, objects  # noqa: E402
from tests.helpers.facet_trials import pose_error  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
MITSUBA = ROOT / ".venv-scenes" / "bin" / "python"
PASSES = ("--gather", "--spp", "36", "--passes", "2", "--variant", "llvm_ad_rgb")
CHI2_6, CHI2_6_999 = 12.59, 22.46  # 95, 99.9 % of chi-square with 6 degrees of freedom
IN_VIEW = 0.01  # of the picture: a plane that counts as seen
THREE = 0.2  # least singular value of three unit normals that are not parallel


def traced(name, out):
    """(model, full model, sides, posed) of a path-traced pair, made if it is not there."""
    folder = out / "rooms" / name
    if not (folder / "truth" / "materials.json").exists():
        command = [MITSUBA, ROOT / "stages" / "synthesise.py", "--scene", name, "--out", folder, *PASSES]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    model = models.load(folder / "model.obj")
    sides = [rig.Side.read(folder / f"{s}.cameramodel", folder / f"{s}.png") for s in ("left", "right")]
    return model, model, sides, cameras.read_cameramodel(folder / "truth" / "left.posed.cameramodel")


def pair_of(kind, name, out):
    """(given model, full model, sides, posed left Camera)"""
    if kind == "rooms":
        return traced(name, out)
    with tempfile.TemporaryDirectory() as folder:
        if kind == "cast":
            pair = cast_rooms.room_pair(name, Path(folder))
            return pair.model, pair.model, pair.sides, pair.posed
        pair = objects.object_pair(int(name), Path(folder))
        given = pair.given if kind == "objects" else objects.object_pair(int(name) + 5000, Path(folder)).given
        return given, pair.full, pair.sides, pair.posed


def front_half(pair, photographs):
    """(two label images, Reconstruction) of two Photographs at `lambda: auto`. pair : matching.Stereo"""
    pictures, values = [x.display for x in photographs], matching.photographs(*photographs)
    weight = segmentation.auto_lambda(*pictures)
    labels = []
    for photograph, picture in zip(photographs, pictures, strict=True):
        regions = segmentation.segment(picture, weight)
        joined = surfaces.surfaces(picture, regions, compressed=photograph.blocks is not None)
        labels.append(np.ascontiguousarray(necks.cut(creases.cut(picture, joined))))
    matches = matching.match(pair, *labels, *values)
    ringing = [x.ringing for x in photographs]
    return labels, planes.reconstruct(pair, labels, values, matches.left, matches.right, ringing=ringing)


def as_written(found):
    """(SceneFacets, [Facet]) of a Reconstruction, as the next stages and the comparison read them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "facets.json"
        artefact.write_json(path, facets_file.describe(found.facets, found.refused, "m"))
        return facets_file.read_scene(path), facets_file.record.read(path, facets_file.Facets).facets


def measured(kind, name, out, jpeg):
    """One pair: a row as a dict."""
    given, full, sides, posed = pair_of(kind, name, out)
    if jpeg:
        sides = [rig.Side(s.camera, jpegs.stored(s.photograph.values, jpeg)) for s in sides]
    begin = time.process_time()
    labels, found = front_half(matching.stereo(*(s.camera for s in sides)), [s.photograph for s in sides])
    sides = [rig.Side(s.camera, s.photograph, x) for s, x in zip(sides, labels, strict=True)]
    row = {"kind": kind, "name": str(name), "cpu_facets_s": time.process_time() - begin}
    scene, facets = as_written(found)
    told = answer.answer(scene, given, sides)
    row |= {"cpu_s": time.process_time() - begin, "why": told.why, "status": told.result and told.result.status}
    index = index_buffer.draw(full, posed)
    compared = facet_errors(facets, posed.T_cam_world, full, index.facet + 1, sides[0].surfaces)
    row["facets"] = [
        (f.area, f.wrong, f.loose, bool(f.pure), f.deviation.chi2, f.deviation.angle_deg) for f in compared
    ]
    row["three_planes"] = three_planes(given, full, index.facet, posed)
    row["covered"] = sum(f.area for f in compared) / index.facet.size
    if not told.why:
        row |= score(told.result, posed, float(np.median(index.depth[index.depth > 0])))
    return row


def score(result, posed, depth):
    """Errors of the pose, or of the equal one that is nearest to the truth."""
    own = result.cameras[0].T_cam_world
    equal = [cameras.matrix_from_rt(o["rt_cam_world"]) for o in result.ambiguous if result.status == "symmetric"]
    T = min([own, *equal], key=lambda T: np.linalg.norm(T @ np.linalg.inv(posed.T_cam_world) - np.eye(4)))
    turn, move = pose_error(T, posed, depth)
    e = cameras.rt_from_matrix(posed.T_cam_world @ np.linalg.inv(T))
    chi2 = float(e @ np.linalg.pinv(result.covariance) @ e)
    far = turn > 1 or move > 0.02 * depth
    return {"deg": turn, "mm": 1000 * move, "chi2": chi2, "wrong": bool(far and chi2 > CHI2_6_999)}


def three_planes(given, full, facet, posed):
    """Three planes of the given model that are not parallel are in view."""
    count = np.bincount(facet[facet >= 0].ravel(), minlength=full.n_facets)
    names = np.array(full.objects)[full.facet_object]
    seen = [f for f in np.flatnonzero(count > IN_VIEW * facet.size) if names[f] in given.objects]
    if len(seen) < 3:
        return False
    return bool(np.linalg.svd(np.array([full.facet_normal[f] for f in seen]))[1][2] > THREE)


def table(rows):
    """Lines of text, for each kind of pair."""
    for kind in dict.fromkeys(r["kind"] for r in rows):
        some = [r for r in rows if r["kind"] == kind]
        answered = [r for r in some if not r["why"] and r["status"] in ("unique", "symmetric")]
        if kind == "wrong":
            yield f"{kind}: {len(some)} pairings, {len(answered)} answered (wanted: none)"
            continue
        yield _of_poses(kind, some, answered)
        yield _of_facets(some)


def _of_poses(kind, some, answered):
    rich = [r for r in some if r["three_planes"]]
    share = np.mean([r in answered for r in rich]) if rich else np.nan
    inside = np.mean([r["chi2"] <= CHI2_6 for r in answered]) if answered else np.nan
    return (
        f"{kind}: {len(some)} pairs, {len(answered)} answered; of {len(rich)} with three planes {100 * share:.0f} % "
        f"(90 wanted); wrong poses {sum(r['wrong'] for r in answered)} (0); {100 * inside:.0f} % in the 95 % "
        f"ellipsoid (88 to 98); mm {_of(answered, 'mm')}; deg {_of(answered, 'deg')}; CPU s {_of(some, 'cpu_s')}"
    )


def _of_facets(some):
    facets = [f for r in some for f in r["facets"]]
    chi2 = np.array([f[4] for f in facets if f[3]])
    share = lambda which, among: [100 * w for r in some if (w := _share(r["facets"], which, among)) is not None]
    wrong = share(lambda f: f[1] and not f[2], lambda f: not f[2])
    loose = share(lambda f: f[2], lambda f: True)
    return (
        f"   {len(facets)} facets: {100 * np.mean(chi2 <= CHI2_3):.0f} % in the 95 % ellipsoid (88 to 98), "
        f"{100 * np.mean(chi2 <= CHI2_3_999):.1f} in the 99.9 %; wrong area {np.median(wrong):.0f} % in the median "
        f"(10), {np.quantile(wrong, 0.95):.0f} % at 95 % (25); loose area {np.median(loose):.0f} %, mean "
        f"{np.mean(loose):.0f} %; covered {100 * np.median([r['covered'] for r in some]):.0f} %"
    )


def _of(rows, key):
    values = sorted(r[key] for r in rows)
    return f"{np.median(values):.3g} (at most {values[-1]:.3g})" if values else "-"


def _share(facets, which, among):
    area = sum(f[0] for f in facets if among(f))
    return sum(f[0] for f in facets if which(f)) / area if area else None


def _numbers(word):
    first, last = map(int, word.split(":"))
    return list(range(first, last))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rooms", nargs="+", default=[], metavar="pair-SEED")
    for kind in ("cast", "objects", "wrong"):
        parser.add_argument(f"--{kind}", type=_numbers, default=[], metavar="FIRST:END", help="seeds")
    parser.add_argument("--jpeg", type=int, metavar="QUALITY", help="the photographs were stored as JPEGs")
    opt = parser.parse_args()
    out = opt.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    log = out / "pairs.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    done = {(r["kind"], r["name"]) for r in rows}
    planes.warm_up()
    surfaces.warm_up()
    recognise.warm_up()
    for kind in ("rooms", "cast", "objects", "wrong"):
        for name in getattr(opt, kind):
            if (kind, str(name)) in done:
                continue
            row = measured(kind, name, out, opt.jpeg)
            rows.append(row)
            with open(log, "a") as file:
                file.write(json.dumps(row) + "\n")
            said = row["why"] or f"{row['status']} {row['mm']:.2f} mm {row['deg']:.3f} deg chi2 {row['chi2']:.1f}"
            print(kind, name, said, f"{row['cpu_s']:.1f} s", file=sys.stderr, flush=True)
    print("\n".join(table(rows)))


if __name__ == "__main__":
    main()
