"""§2.2 Matching: pairs with known regions, the laws of the rectified frame, and the extremes."""

import csv
import json

import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import cameras, image
from lib.given.cameras import Camera
from lib.vision import matching
from lib.vision import matching_kernels as kernels
from lib.vision.matches import read_matched_labels
from tests.helpers import pairs
from tests.helpers.growth import growth
from tests.helpers.pairs import parallel


def found(Q, sigma=0.01, seed=0, **options):
    return matching.match(
        matching.stereo(Q.left, Q.right), *Q.labels, *Q.noisy(sigma, np.random.default_rng(seed)), **options
    )


# -- the rectified frame


def test_a_plane_is_a_linear_disparity():
    """By hand: both cameras see points of a plane in one rectified row, f_px baseline m . x_rect apart."""
    rng = np.random.default_rng(1)
    for seed in range(5):
        Q = pairs.quads(seed)
        pair = matching.stereo(Q.left, Q.right)
        q = rng.uniform(50, 300, (40, 2))
        v = Q.left.directions(q)
        m = Q.m[1 + seed]
        p = v / (v @ m)[:, None]
        left, right = pair.rectified(q, "left"), pair.rectified(Q.right.project(p), "right")
        np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-9)
        abc = pair.baseline * (pair.R_rect_left @ m) * [1, 1, pair.f_px]
        np.testing.assert_allclose(left[:, 0] - right[:, 0], np.column_stack([left, np.ones(40)]) @ abc, atol=1e-9)
        np.testing.assert_allclose(pair.photograph(left, "left"), q, atol=1e-9)


def test_no_baseline_is_no_pair():
    left, _ = parallel(64, 48, 50.0, 0.1)
    with pytest.raises(ValueError, match="same centre"):
        matching.stereo(left, left)


# -- matching


@pytest.mark.scene
@pytest.mark.parametrize(
    "options",
    [
        {},
        {"grey": True},
        *(pytest.param(o, marks=pytest.mark.slow) for o in ({"baseline": 0.35}, {"angle_deg": 10.0})),
        {"tilt": 1.3},
    ],
    ids=["colour", "grey", "parallel", "10 degrees", "steep"],
)
def test_every_quadrilateral_finds_its_own(options):
    """15 scenes: no wrong pair, and nearly all of them found; best first; one to one.

    The wall behind them reaches beyond the picture on all sides: it has no outline of its own.
    """
    total = 0
    for seed in range(15):
        matches = found(pairs.quads(seed, **options))
        assert (matches.left == matches.right).all()
        assert (np.diff(matches.similarity) <= 0).all()
        assert len(set(matches.left)) == len(matches.left)
        total += len(matches.left)
    assert total >= 0.95 * 15 * 6


@pytest.mark.scene
def test_office_no_wrong_pair():
    """True regions of a furnished room: what is matched is right; what covers most of the picture is matched."""
    P = pairs.office(seed=1, samples=4)
    matches = found(P)
    assert (P.facet_of[0][matches.left] == P.facet_of[1][matches.right]).all()
    assert len(matches.left) >= 30
    assert matching.share(P.labels[0], matches.left) > 0.8


def test_left_and_right_exchanged():
    """A law: the pair seen the other way round has the same matches."""
    for seed in range(5):
        Q = pairs.quads(seed)
        values = Q.noisy(0.01, np.random.default_rng(0))
        one = matching.match(matching.stereo(Q.left, Q.right), *Q.labels, *values)
        two = matching.match(matching.stereo(Q.right, Q.left), *Q.labels[::-1], *values[::-1])
        assert set(zip(one.left, one.right, strict=True)) == set(zip(two.right, two.left, strict=True))


def test_identical_photographs_of_parallel_cameras_match_nothing():
    """Disparity 0 is infinitely far away: no plane in front of the cameras."""
    Q = pairs.quads(0, baseline=0.3)
    matches = matching.match(matching.stereo(Q.left, Q.right), Q.labels[0], Q.labels[0], Q.values[0], Q.values[0])
    assert len(matches.left) == 0
    assert all(label in sum(matches.refused_left.values(), []) for label in range(1, 8))


def test_equal_twins_are_ambiguous():
    """Two equal squares side by side on a wall: either could be either's partner, so neither is matched."""
    left, right = parallel(200, 120, 150.0, 0.1)
    labels = np.ones((120, 200), np.int32)
    labels[40:80, 60:90], labels[40:80, 110:140] = 2, 3
    values = np.where(labels > 1, 0.7, 0.3)[..., None]
    shifted = np.roll(labels, -5, 1)
    matches = matching.match(matching.stereo(left, right), labels, shifted, values, np.roll(values, -5, 1))
    assert not {2, 3} & set(matches.left) or (matches.left == matches.right).all()
    assert "ambiguous" in matches.refused_left or "not mutual" in matches.refused_left


def chessboard(disparity, columns=9, rows=6, square=14):
    """A board 80 px from the left: its squares alone have labels, 1 .. rows x columns, row by row; two colours."""
    labels = np.zeros((rows * square + 40, columns * square + 160), np.int32)
    values = np.full((*labels.shape, 1), 0.4)
    tile = np.add.outer(columns * np.arange(rows), np.arange(columns)).repeat(square, 0).repeat(square, 1)
    board = slice(20, 20 + rows * square), slice(80, 80 + columns * square)
    labels[board], values[board] = tile + 1, np.where((tile // columns + tile % columns) % 2, 0.85, 0.15)[..., None]
    both = [labels, np.roll(labels, -disparity, 1)], [values, np.roll(values, -disparity, 1)]
    return matching.stereo(*parallel(*labels.shape[::-1], 200.0, 0.1)), *both


@pytest.mark.parametrize("disparity", [5, 28, 33, 61])
def test_a_chessboard_is_told_by_its_ends(disparity):
    """Each square is like every second one, and looked for where it would lie 28 px nearer or farther as well."""
    pair, labels, values = chessboard(disparity)
    matches = matching.match(pair, *labels, *values)
    assert (matches.left == matches.right).all() and len(matches.left) == 54


def test_a_chessboard_in_another_exposure():
    """A factor of .8 is .17 of a white square: more than colours may differ, but all of them differ by it."""
    pair, labels, values = chessboard(33)
    matches = matching.match(pair, *labels, values[0], 0.8 * values[1] * np.linspace(0.97, 1.03, 286)[:, None])
    assert (matches.left == matches.right).all() and len(matches.left) == 54


def test_a_square_without_a_partner_takes_no_other():
    """Two neighbours on the left, the next but one on the right: each would be the other's only candidate."""
    pair, labels, values = chessboard(33)
    gone = labels[1] == 20
    labels[1][gone], values[1][gone] = 0, 0.4
    labels[0][labels[0] == 22], labels[1][labels[1] == 20] = 0, 0
    matches = matching.match(pair, *labels, *values)
    assert (matches.left == matches.right).all() and 20 not in matches.left and len(matches.left) > 48


def test_each_region_is_matched_or_refused_once():
    Q = pairs.quads(3)
    matches = found(Q, smallest=2500)
    named = list(matches.left) + sum(matches.refused_left.values(), [])
    assert sorted(named) == sorted(set(np.unique(Q.labels[0])) - {0})
    assert set(matches.refused_left) <= set(kernels.REASONS)


def test_one_region():
    """The whole picture is one region: it has no outline of its own, and nothing is claimed."""
    left, right = parallel(64, 48, 50.0, 0.1)
    one = np.ones((48, 64), np.int32)
    matches = matching.match(
        matching.stereo(left, right), one, one, np.full((48, 64, 1), 0.5), np.full((48, 64, 1), 0.5)
    )
    assert len(matches.left) == 0 and matches.refused_left


def test_nothing_labelled():
    left, right = parallel(64, 48, 50.0, 0.1)
    none, grey = np.zeros((48, 64), np.int32), np.full((48, 64, 1), 0.5)
    matches = matching.match(matching.stereo(left, right), none, none, grey, grey)
    assert len(matches.left) == 0 and not matches.refused_left


def tiles(side):
    """side x side tiles of random colour, 12 x 10 px each, 7 px apart: labels and values of both pictures."""
    height, width = 10 * side, 12 * side
    tile = (np.arange(height)[:, None] // 10) * side + np.arange(width)[None] // 12
    colour = np.random.default_rng(0).uniform(0, 1, (side * side, 3))
    labels = [np.zeros((height, width + 7), np.int32), np.zeros((height, width + 7), np.int32)]
    labels[0][:, 7:], labels[1][:, :width] = tile + 1, tile + 1
    return labels, [np.where(x[..., None] > 0, colour[np.maximum(x - 1, 0)], 0.0) for x in labels]


def match_tiles(labels, values):
    height, width = labels[0].shape
    return matching.match(matching.stereo(*parallel(width, height, 900.0, 0.1)), *labels, *values)


def test_ten_thousand_regions():
    """None wrong; and four times as many regions cost eight times as much at most, for the rows are twice as long.

    All pairs of a picture would cost sixteen times as much.
    """
    found = match_tiles(*tiles(100))
    assert (found.left == found.right).all()
    assert len(found.left) > 5000
    few, many = tiles(25), tiles(50)
    assert growth(lambda: match_tiles(*few), lambda: match_tiles(*many)) < 13


def test_forward_motion_is_refused_region_by_region():
    """The right camera stands before the left one: what lies along the baseline cannot be rectified, and is said so."""
    K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    T = np.eye(4)
    T[2, 3] = -0.2
    labels = np.ones((48, 64), np.int32)
    labels[15:33, 22:42] = 2
    values = labels[..., None] / 3.0
    matches = matching.match(
        matching.stereo(Camera(K, 64, 48, np.eye(4)), Camera(K, 64, 48, T)), labels, labels, values, values
    )
    assert len(matches.left) == 0


# -- from outside


def test_stage_writes_the_contract(run, pair_files, tmp_path):
    Q = pairs.quads(2)
    result = run(
        "stages/match.py", *pair_files(Q), "--matches", tmp_path / "matches.csv", "--report", tmp_path / "r.json"
    )
    assert result.returncode == 0, result.stderr
    with open(tmp_path / "matches.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["left_label", "right_label", "similarity"]
    assert all(r["left_label"] == r["right_label"] for r in rows)
    similarity = [float(r["similarity"]) for r in rows]
    assert similarity == sorted(similarity, reverse=True) and 0 < min(similarity) <= max(similarity) <= 1
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["matched"] == len(rows) and report["surfaces"] == {"left": 7, "right": 7}
    l, r = read_matched_labels(tmp_path / "matches.csv", *Q.labels)
    assert (l == r).all() and len(l) == len(rows)


@pytest.mark.scene
def test_stage_refuses(refuses, run, pair_files, files_under, tmp_path):
    Q = pairs.quads(2)
    words = pair_files(Q)
    out = tmp_path / "matches.csv"
    # the same centre
    good = (tmp_path / "right.cameramodel").read_text()
    cameras.write_cameramodel(tmp_path / "right.cameramodel", Q.left)
    before = files_under(tmp_path)
    (line,) = refuses("stages/match.py", *words, "--matches", out)
    assert "same centre" in line and "extrinsics" in line
    assert files_under(tmp_path) == before
    (tmp_path / "right.cameramodel").write_text(good)
    # labels of another size
    image.write_png16(tmp_path / "right.surfaces.png", Q.labels[1][:-1])
    (line,) = refuses("stages/match.py", *words, "--matches", out)
    assert "right.surfaces.png" in line and "480 x 359" in line
    (line,) = refuses("stages/match.py", *words, "--matches", out, "--similarity", "1.5")
    assert "--similarity" in line
    assert not out.exists()


@pytest.mark.parametrize(
    "content,word",
    [
        ("a,b,c\n", "header"),
        ("left_label,right_label,similarity\n1,x,0.5\n", "line 2"),
        ("left_label,right_label,similarity\n99,1,0.5\n", "99"),
        ("left_label,right_label,similarity\n1,1,0.9\n1,2,0.8\n", "twice"),
        ("", "header"),
    ],
)
def test_matches_that_cannot_be_read(tmp_path, content, word):
    path = tmp_path / "matches.csv"
    path.write_text(content)
    labels = np.array([[1, 2], [1, 2]])
    with pytest.raises(BadInput, match=word):
        read_matched_labels(path, labels, labels)
