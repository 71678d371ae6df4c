"""The pictures of README and docs, made anew of built scenes and of the curves of `make bench`.

    $ python -m tests.bench.figures                       which there are, and what each is made of
    $ make office && python -m tests.bench.figures office           docs/office.jpg, of build/office
    $ python -m tests.bench fit && python -m tests.bench.figures fit    docs/fit.png, of build/bench/fit.png

Each says what it lacks, with the command that makes it. docs/decisions/figures.md has the list.
"""

import argparse
import shutil
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.given import image

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "data"
QUALITY = 88  # of JPEGs


class Figure(NamedTuple):
    """make : of the folder of builds, the picture (H, W, 3) uint8 or the path of one;  of : files it is made of, there
    by : the command that makes these"""

    file: str
    make: object
    of: tuple
    by: str


class Lacking(Exception):
    """A figure whose files are not there."""


def shown(path):
    """(H, W, 3) float, display values in [0, 1] of a picture."""
    values = image.read_photograph(path).display
    return np.repeat(values, 3, axis=2) if values.shape[2] == 1 else values


def sized(values, width):
    """The picture at that width."""
    import cv2

    height = round(values.shape[0] * width / values.shape[1])
    return np.atleast_3d(cv2.resize(values.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA))


def row(pictures, width, gap=0):
    """Side by side, each at that width, white between."""
    pictures = [sized(values, width) for values in pictures]
    between = np.ones((pictures[0].shape[0], gap, 3))
    parts = [part for picture in pictures for part in (between, picture)][1:]
    return np.hstack([part for part in parts if part.shape[1]])


# ---- one function for each ----


def office(build):
    """Photograph, re-rendering, difference x 16."""
    photograph, rendered = shown(DATA / "office/left.png"), shown(build / "office/rendered.png")
    return row([photograph, rendered, np.clip(0.5 + 16 * (rendered - photograph), 0, 1)], 480)


def office_stereo(build):
    """The model over both photographs, from the recovered pose."""
    from lib.buffers import edges, first_look, index_buffer
    from lib.given import cameras
    from lib.given import model as models

    model, pictures = models.load(DATA / "office-stereo/model.obj"), []
    for side in ("left", "right"):
        camera = cameras.read_cameramodel(build / f"office-stereo/{side}.posed.cameramodel")
        photograph = image.read_photograph(build / f"office-stereo/{side}.pinhole.png")
        index = index_buffer.draw(model, camera)
        segments = edges.wireframe(model, camera, index.facet, index.depth)
        pictures.append(first_look.over(photograph, segments) / 255)
    return row(pictures, 800)


LADDER = ("office-mirror", "desk-glossy", "two-mirrors", "poster")


def ladder(build):
    """Photographs above, re-renderings below."""
    above = row([shown(DATA / f"{scene}/left.png") for scene in LADDER], 400)
    return np.vstack([above, row([shown(build / f"{scene}/rendered.png") for scene in LADDER], 400)])


def board(build):
    """The chessboard as photographed, and with what was put on it."""
    left = next(DATA.glob("opencv-board/left.*"))
    return row([shown(left), shown(build / "opencv-board/augmented.on-the-board.png")], 640)


def walk(build):
    """The tutorial's photograph, the model over it, the re-rendering."""
    files = (DATA / "office/left.png", build / "study/check.png", build / "study/rendered.png")
    return row([shown(path) for path in files], 560, gap=8)


def walk_augment(build):
    return row([shown(build / f"study/augmented.{name}.png") for name in ("egg", "red-floor")], 640, gap=8)


def walk_picks(_):
    """The tutorial's picks, numbered as in the file."""
    import cv2

    picture = np.ascontiguousarray(np.round(255 * sized(shown(DATA / "office/left.png"), 1280)).astype(np.uint8))
    picks = np.genfromtxt(ROOT / "docs/tutorial/points.csv", delimiter=",", skip_header=1, usecols=(0, 1))
    for number, pick in enumerate(picks, 1):
        x, y = np.round(2 * pick + 0.5).astype(int)
        for colour, width in (((0, 0, 0), 4), ((255, 170, 0), 2)):
            cv2.circle(picture, (x, y), 12, colour, width, cv2.LINE_AA)
            beside = (x + 16 if x < 1200 else x - 40, max(y - 12, 24))
            cv2.putText(picture, str(number), beside, cv2.FONT_HERSHEY_SIMPLEX, 0.9, colour, width, cv2.LINE_AA)
    return sized(picture / 255, 768)


def page(build):
    """The first screen of the demo's page in Chromium, 1280 px wide."""
    import base64

    import cv2

    from tests.helpers.browser import Browser, chromium

    if chromium() is None:
        raise Lacking("Chromium is not installed: apt-get install chromium")
    with tempfile.TemporaryDirectory() as profile, Browser(profile) as browser:
        tab = browser.open(build / "office-stereo/report.html", 1280)
        data = base64.b64decode(tab.call("Page.captureScreenshot", format="png")["data"])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1] / 255


def exports(build):
    """Our own picture of office, Mitsuba's and Cycles' of the exported scene, through the photograph's curve."""
    from lib.given import cameras, materials
    from tests.helpers import consumers

    folder, pictures = build / "office", [shown(build / "office/rendered.png")]
    camera = cameras.read_cameramodel(DATA / "office/left.posed.cameramodel")
    T = materials.read(folder / "materials.json").transfer.function
    for kind, samples in (("mitsuba", 256), ("blender", 96)):
        if consumers.absent(consumers.RENDERERS[kind]):
            raise Lacking(f"{kind} is not installed: make .venv-exports/ready")
        linear = consumers.ask(kind, folder / "exports" / kind, camera.width, camera.height, samples)
        pictures.append(T.display(np.clip(linear, 0, 1)))
    return row(pictures, 480, gap=8)


def copied(path):
    return lambda build: build / path


BENCH = "python -m tests.bench {}"
AUGMENT = "augment_truth and augment_bench of tests/bench, by their heads, OUT = build/bench"
FIGURES = {
    "page": Figure("page.jpg", page, ("office-stereo/report.html",), "make"),
    "office": Figure("office.jpg", office, ("office/rendered.png",), "make office"),
    "office-stereo": Figure(
        "office-stereo.jpg",
        office_stereo,
        ("office-stereo/left.posed.cameramodel", "office-stereo/right.posed.cameramodel"),
        "make office-stereo",
    ),
    "ladder": Figure("ladder.jpg", ladder, tuple(f"{s}/rendered.png" for s in LADDER), f"make {' '.join(LADDER)}"),
    "walk": Figure("walk.jpg", walk, ("study/check.png", "study/rendered.png"), "docs/tutorial.md"),
    "walk-picks": Figure("walk-picks.jpg", walk_picks, (), ""),
    "walk-augment": Figure(
        "walk-augment.jpg",
        walk_augment,
        ("study/augmented.egg.png", "study/augmented.red-floor.png"),
        "docs/tutorial.md",
    ),
    "augment-board": Figure(
        "augment-board.jpg", board, ("opencv-board/augmented.on-the-board.png",), "make opencv-board"
    ),
    "augment": Figure("augment.jpg", copied("bench/office.jpg"), ("bench/office.jpg",), AUGMENT),
    "augment-mirror": Figure(
        "augment-mirror.jpg", copied("bench/office-mirror.jpg"), ("bench/office-mirror.jpg",), AUGMENT
    ),
    "exports": Figure("exports.jpg", exports, ("office/exports/mitsuba/scene.xml",), "make office office/export"),
    "fit": Figure("fit.png", copied("bench/fit.png"), ("bench/fit.png",), BENCH.format("fit")),
    "segment": Figure("segment.png", copied("bench/segment.png"), ("bench/segment.png",), BENCH.format("segment")),
    "recognise": Figure(
        "recognise.png", copied("bench/recognise.png"), ("bench/recognise.png",), BENCH.format("recognise")
    ),
    "rungs": Figure("rungs.png", copied("bench/ladder.png"), ("bench/ladder.png",), BENCH.format("ladder")),
}


def make(figure, build, out):
    """Writes one; Lacking where something is not there."""
    for file in figure.of:
        if not (build / file).is_file():
            raise Lacking(f"{build / file} is not there: {figure.by}")
    made = figure.make(build)
    if isinstance(made, Path):
        shutil.copyfile(made, out / figure.file)
        return
    import cv2

    values = np.rint(255 * np.clip(made, 0, 1)).astype(np.uint8)[..., ::-1]
    cv2.imwrite(str(out / figure.file), values, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", choices=[*FIGURES, []], metavar="name", help=", ".join(FIGURES))
    parser.add_argument("--build", type=Path, default=ROOT / "build")
    parser.add_argument("--out", type=Path, default=ROOT / "docs")
    opt = parser.parse_args()
    if not opt.names:
        for name, figure in FIGURES.items():
            print(f"{name:15} docs/{figure.file:18} {figure.by}")
    lacking = 0
    for name in opt.names:
        try:
            make(FIGURES[name], opt.build, opt.out)
            print(opt.out / FIGURES[name].file)
        except Lacking as why:
            lacking += 1
            print(f"{name}: {why}", file=sys.stderr)
    return 1 if lacking else 0


if __name__ == "__main__":
    sys.exit(main())
