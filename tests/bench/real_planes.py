"""Facets of real photographs at `lambda: auto`: chessboards against their corners, Middlebury against its disparities.

    $ python -m tests.bench.real_planes

Boards: all facets on the board joined by their covariances, against the plane through the triangulated corners, and
the share of the board that facets cover. Middlebury: disparity of the facets' pixels, px, and how many are covered.
"""

from pathlib import Path

import numpy as np

from lib.given import cameras, image
from lib.verdict.vision_errors import disparity
from lib.vision import matching
from tests.bench.unseen_pairs import as_written, front_half
from tests.helpers import real_boards

DATA = Path(__file__).resolve().parents[2] / "data"
ON = 0.8  # of a facet's pixels on the board: it is the board's


def boards():
    """Lines of text."""
    rows = []
    for x in real_boards.board_pairs():
        labels, found = front_half(x.pair, [image.Photograph(v, 8, False, v.shape[2]) for v in x.values])
        board = x.labels[0] == 2
        share = lambda f, labels=labels, board=board: board[labels[0] == f.left_label].mean()
        mine = [f for f in found.facets if share(f) > ON]
        if not mine:
            yield f"board {x.name}: no facet"
            continue
        information = [np.linalg.inv(f.covariance) for f in mine]
        m = np.linalg.solve(sum(information), sum(w @ f.m for w, f in zip(information, mine, strict=True)))
        cosine = m @ x.true / np.linalg.norm(m) / np.linalg.norm(x.true)
        covered = np.isin(labels[0], [f.left_label for f in mine])[board].mean()
        rows.append((np.degrees(np.arccos(min(cosine, 1))), covered))
        yield f"board {x.name}: {len(mine)} facets, {rows[-1][0]:.3f} degrees, covers {100 * covered:.0f} %"
    angle, covered = np.array(rows).T
    yield (
        f"{(angle < 0.5).sum()} of 13 boards within .5 degree, median {np.median(angle):.3f}, worst {angle.max():.3f}; "
        f"covered {100 * covered.min():.0f} to {100 * covered.max():.0f} %, median {100 * np.median(covered):.0f} %"
    )


def middlebury(scene):
    """A line of text."""
    folder = DATA / scene
    sides = [cameras.read_cameramodel(folder / f"{s}.cameramodel") for s in ("left", "right")]
    pictures = [image.read_photograph(folder / f"{s}.png") for s in ("left", "right")]
    labels, found = front_half(matching.stereo(*sides), pictures)
    truth = image.read_photograph(folder / "truth" / "disparity.png").values[..., 0] * 255 / 8
    true = np.where(truth > 0, truth, np.nan)
    errors = {name: value for name, value, _ in disparity(as_written(found)[1], *sides, labels[0], true)}
    return f"{scene}: " + ", ".join(f"{name.split('.')[1]} {value:.3f}" for name, value in errors.items())


def main():
    for line in boards():
        print(line, flush=True)
    for scene in ("venus", "sawtooth"):
        print(middlebury(scene), flush=True)


if __name__ == "__main__":
    main()
