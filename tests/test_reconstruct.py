"""§2.3 Reconstruction: planes of exact pairs against their predicted covariance, real planes, laws and extremes."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lib.given import cameras, image
from lib.given.cameras import Camera
from lib.vision import matching
from lib.vision.facets import (
    borders,
    contours,
    dense,
    folds,
    intensities,
    junctions,
    overlap,
    overlap_kernels,
    profiles,
    sides,
    uncertainty,
)
from lib.vision.facets import contours_kernels as kernels
from lib.vision.facets import planes as facets
from lib.vision.facets.contours_kernels import Border
from tests.helpers import jpegs, pairs, real_boards
from tests.helpers.pairs import parallel

DATA = Path(__file__).resolve().parents[1] / "data"
CHI2_95 = 7.815  # 3 degrees of freedom


def reconstructed(Q, sigma=0.01, seed=0):
    """{left label: Facet}, refused; the matches are the true ones."""
    both = np.intersect1d(*[np.unique(x) for x in Q.labels])
    found, refused, _ = facets.reconstruct(
        matching.stereo(Q.left, Q.right), Q.labels, Q.noisy(sigma, np.random.default_rng(seed)), both, both
    )
    return {x.left_label: x for x in found}, {x.left_label: x.why for x in refused}


def chi2(facet, m):
    e = facet.m - m
    return float(e @ np.linalg.solve(facet.covariance, e))


def angle_deg(m, true):
    return float(np.degrees(np.arccos(np.clip(m @ true / np.linalg.norm(m) / np.linalg.norm(true), -1, 1))))


# -- the covariance is honest


@pytest.mark.scene
@pytest.mark.parametrize("count", [30, pytest.param(100, marks=pytest.mark.slow)])
def test_coverage_of_true_regions(count):
    """Scenes of 6 exact quadrilaterals: of 95 % regions, 90 to 98 % hold the truth.

    Each scene has its own planes, camera and noise.
    """
    inside = []
    for seed in range(count):
        Q = pairs.quads(seed)
        found, _ = reconstructed(Q, sigma=(0.003, 0.01, 0.03)[seed % 3], seed=seed)
        inside += [chi2(x, Q.m[label]) < CHI2_95 for label, x in found.items() if label < 7]
    assert len(inside) > 5.7 * count
    assert 0.90 <= np.mean(inside) <= 0.98


def test_a_side_that_is_not_the_facets_is_in_sigma():
    """Six sides with .02 px of noise; one of them .5 px off, which the residuals of the other five hardly show."""
    random = np.random.default_rng(0)
    part = np.repeat(np.arange(6), 30)
    angle = np.radians(30 + 60 * part)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    uv = 40 * normal + random.uniform(-20, 20, len(part))[:, None] * normal[:, ::-1] * [-1, 1]
    rows = np.zeros((len(part), kernels.COLUMNS))
    rows[:, 0], rows[:, 1], rows[:, 2] = -(normal[:, :1] * np.column_stack([uv, np.ones(len(uv))])).T / 0.02
    rows[:, kernels.PART], rows[:, kernels.SIGMA] = part, 0.02
    rows[:, kernels.WEIGHT], rows[:, kernels.RESIDUAL] = 1, random.normal(size=len(part))
    for off, wider in ((0.0, (1, 3)), (0.5, (100, 1e4))):
        moved = rows.copy()
        moved[part == 0, kernels.RESIDUAL] += off / 0.02
        x = contours.measured_at(np.zeros(3), np.zeros(2), 40.0, moved, 6)
        covariance = np.linalg.inv(x.A)
        step = -covariance @ x.b
        held = uncertainty.held_by_sides(x, 0.0, covariance, step)
        ratio = np.linalg.eigvals(np.linalg.solve(covariance, held)).real
        assert ratio.min() > 1 - 1e-9 and wider[0] <= ratio.max() <= wider[1]
        assert step @ np.linalg.solve(held, step) < CHI2_95


def test_a_strip_that_one_photograph_shows_makes_a_side_unsure():
    """An upright side at 40 px on the left and 36 on the right; on the left another face of 1 px lies beside it.

    The place of the side is then .75 px off, and nothing but the colours across it shows that.
    """
    pair, _, _ = matching.toy()
    n, c = 20, pair.left.K[0, 2]
    step = lambda at: np.where(np.arange(64) < at, 0.8, 0.2) * np.ones((40, 1))
    rows = np.zeros((n, kernels.COLUMNS))
    rows[:, kernels.NORMAL_U] = rows[:, kernels.SIGMA] = rows[:, kernels.WEIGHT] = 1
    rows[:, kernels.U], rows[:, kernels.V] = 39.5 - c, np.arange(10, 30) - c
    x = contours.measured_at(np.array([0, 0, 4.0]), np.zeros(2), 20.0, rows, 1)
    left, right = step(40), step(36)
    assert profiles.unlike(pair, [left[..., None], right[..., None]], (0.002, 0.002), x) == [0]
    left[:, 40] = 0.65
    rows[:, kernels.U] += 0.75
    x = contours.measured_at(np.array([0, 0, 4.75]), np.zeros(2), 20.0, rows, 1)
    (off,) = profiles.unlike(pair, [left[..., None], right[..., None]], (0.002, 0.002), x)
    assert 0.25 < off < 1.5


def two_upright_sides(off_px=0.0):
    """Rows of two sides 80 px apart that face left and right, on a plane that faces the cameras at 0 px; the right one
    is off by so much, and the plane that holds both."""
    random = np.random.default_rng(0)
    part = np.repeat([0, 1], 40)
    nu, u, v = np.where(part, 1.0, -1.0), np.where(part, 40.0, -40.0), random.uniform(-30, 30, 80)
    rows = np.zeros((80, kernels.COLUMNS))
    rows[:, :3] = -(nu * np.stack([u, v, np.ones(80)])).T / 0.05
    rows[:, kernels.PART], rows[:, kernels.SIGMA], rows[:, kernels.WEIGHT] = part, 0.05, 1
    rows[:, kernels.NORMAL_U], rows[:, kernels.U], rows[:, kernels.V] = nu, u, v
    rows[:, kernels.RESIDUAL] = random.normal(size=80)
    plane = np.array([off_px / 80, 0, off_px / 2])
    return contours.measured_at(plane, np.zeros(2), 40.0, rows, 2), plane


def test_a_facet_between_a_wall_and_what_hides_it_does_not_know_its_tilt():
    """Its right side is a nearer thing's: the plane through both sides is 12 px off there, and agrees with both.

    Its borders are doubted; the truth is then inside the ellipsoid. It was outside by tens of sigma.
    """
    x, plane = two_upright_sides(12.0)
    own = np.linalg.inv(x.A)
    step = -own @ x.b
    e = plane * [40, 40, 1] + step
    assert e @ np.linalg.solve(own, e) > 1e4
    added = uncertainty.turned_about_the_rest(x, plane, np.ones(4, bool))
    assert e @ np.linalg.solve(own + added, e) < CHI2_95


def test_a_facet_of_which_no_border_is_doubted_keeps_its_tilt():
    x, plane = two_upright_sides(12.0)
    assert not uncertainty.turned_about_the_rest(x, plane, np.zeros(4, bool)).any()
    assert not uncertainty.turned_about_the_rest(x, plane, np.array([False, False, True, True])).any()
    told = replace(x, texture=(plane, np.eye(3)))
    assert not uncertainty.turned_about_the_rest(told, plane, np.ones(4, bool)).any()


@pytest.mark.parametrize(
    ("floor", "leg_goes_on", "doubted"),
    [((0.2, 0.5, 0.3), True, True), ((0.2, 0.5, 0.3), False, False), ((0.45, 0.42, 0.4), True, False)],
)
def test_a_side_that_goes_on_past_the_corner_is_of_what_hides_the_region(floor, leg_goes_on, doubted):
    """A wall, a leg to its right and a floor below both. A floor of the wall's own colour, darker, is its shadow."""
    pair, _, _ = matching.toy()
    picture = np.empty((40, 64, 3), np.float32)
    picture[:] = (0.65, 0.607, 0.578)
    picture[25:] = floor
    picture[: 40 if leg_goes_on else 25, 40:] = (0.5, 0.2, 0.2)
    labels = np.ones((40, 64), int)
    labels[25:], labels[:25, 40:] = 2, 3
    rows = np.zeros((20, kernels.COLUMNS))
    rows[:, kernels.NORMAL_U] = rows[:, kernels.SIGMA] = rows[:, kernels.WEIGHT] = 1
    c = pair.left.K[:2, 2]
    rows[:, kernels.U], rows[:, kernels.V] = 39.5 - c[0], np.arange(4, 24) - c[1]
    borders = np.ones(20, int)
    go_on = junctions.go_on(pair, labels, picture, 1, 0.002, rows, borders)
    assert list(go_on) == [False, doubted, False, False]


def test_a_side_that_nothing_checks_is_less_sure():
    """Of two sides each tells its own place alone; of eight in all directions none tells much alone."""
    x, plane = two_upright_sides()
    sigma = np.full(2, 0.05)
    covariance = np.linalg.inv(uncertainty.with_sides(x, sigma).A)
    wider = np.linalg.eigvals(np.linalg.solve(covariance, uncertainty.unchecked(x, sigma))).real
    assert 1 < wider.max() <= uncertainty.TAIL + 1e-9
    assert not uncertainty.unchecked(x, np.zeros(2)).any()
    side = np.repeat(np.arange(8), 10)
    angle = np.radians(45 * side + 20)
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    uv = 40 * normal + np.tile(np.linspace(-15, 15, 10), 8)[:, None] * normal[:, ::-1] * [-1, 1]
    rows = np.zeros((80, kernels.COLUMNS))
    rows[:, :3] = -normal[:, :1] * np.column_stack([uv, np.ones(80)]) / 0.05
    rows[:, kernels.PART], rows[:, kernels.SIGMA], rows[:, kernels.WEIGHT] = side, 0.05, 1
    x = contours.measured_at(plane, np.zeros(2), 40.0, rows, 8)
    sigma = np.full(8, 0.05)
    covariance = np.linalg.inv(uncertainty.with_sides(x, sigma).A)
    wider = np.linalg.eigvals(np.linalg.solve(covariance, uncertainty.unchecked(x, sigma))).real
    assert wider.max() < 0.5


@pytest.mark.scene
@pytest.mark.parametrize(("quality", "least"), [(95, 0.93), (75, 0.9)])
@pytest.mark.slow
def test_coverage_in_jpegs(quality, least):
    """Exact quadrilaterals, stored as JPEGs: borders are as unsure as what rings beside them (75: .89 without)."""
    inside = []
    for seed in range(24):
        Q = pairs.quads(seed)
        taken = [jpegs.stored(v, quality) for v in Q.noisy((0.003, 0.01)[seed % 2], np.random.default_rng(seed))]
        both = np.intersect1d(*[np.unique(x) for x in Q.labels])
        found, _, _ = facets.reconstruct(
            matching.stereo(Q.left, Q.right),
            Q.labels,
            matching.photographs(*taken),
            both,
            both,
            ringing=[x.ringing for x in taken],
        )
        inside += [chi2(x, Q.m[x.left_label]) < CHI2_95 for x in found if x.left_label < 7]
    assert len(inside) > 130 and least <= np.mean(inside) <= 0.99


def test_upright_sides_may_be_off_farther_than_level_ones():
    """What lies behind them differs between the photographs: path-traced pairs' upright sides were off three times as
    far."""
    x, _ = two_upright_sides()
    assert np.allclose(uncertainty.asides(x), np.sqrt(1 + uncertainty.ASIDE**2))
    level = x.rows.copy()
    level[:, kernels.NORMAL_U] = 0
    assert np.allclose(uncertainty.asides(replace(x, rows=level)), 1)


@pytest.mark.slow
def test_coverage_of_texture():
    """A textured plane whose region has no visible border: the intensities alone, without bias, and as honest."""
    inside, error = [], []
    for seed in range(40):
        Q = pairs.textured(seed)
        found, refused, _ = facets.reconstruct(
            matching.stereo(Q.left, Q.right),
            Q.labels,
            Q.noisy(0.01, np.random.default_rng(seed)),
            np.array([1]),
            np.array([1]),
        )
        inside.append(chi2(found[0], Q.m[1]) < CHI2_95)
        error.append((found[0].m - Q.m[1])[2] / Q.m[1, 2])
    assert 0.85 <= np.mean(inside) <= 0.99  # 40 trials: 0.95 +- 0.034
    assert abs(np.mean(error)) < 3 * np.std(error) / np.sqrt(40) + 2e-5


@pytest.mark.slow
def test_baseline_towards_zero():
    """Sigma of m is that of the disparity over f baseline: facet by facet it grows like 1 / baseline.

    It still tells the truth, until the facet is refused because its direction is no longer known.
    """
    sigma, count = {}, {}
    for baseline in (0.4, 0.1, 0.025):
        inside = []
        for seed in range(15):
            Q = pairs.quads(seed, baseline=baseline)
            found, refused = reconstructed(Q, seed=seed)
            inside += [chi2(x, Q.m[label]) < CHI2_95 for label, x in found.items() if label < 7]
            sigma |= {
                (baseline, seed, label): baseline * np.sqrt(np.trace(x.covariance))
                for label, x in found.items()
                if label < 7
            }
        count[baseline] = len(inside)
        assert np.mean(inside) > 0.86
    for baseline in (0.1, 0.025):
        ratio = [
            s / sigma[0.4, seed, label]
            for (b, seed, label), s in sigma.items()
            if b == baseline and (0.4, seed, label) in sigma
        ]
        assert 0.75 < np.median(ratio) < 1.35
    assert count[0.4] >= count[0.1] >= count[0.025]


def test_metres_or_millimetres():
    """A law: cameras in millimetres give m / 1000 and covariance / 1e6, and refuse the same."""
    Q = pairs.quads(4)
    found, refused = reconstructed(Q)
    T = Q.right.T_cam_world.copy()
    T[:3, 3] *= 1000
    far = pairs.Quads(Q.left, Camera(Q.right.K, Q.right.width, Q.right.height, T), Q.values, Q.labels, Q.m / 1000)
    found_mm, refused_mm = reconstructed(far)
    assert found.keys() == found_mm.keys() and refused == refused_mm
    for label, x in found.items():
        np.testing.assert_allclose(found_mm[label].m, x.m / 1000, rtol=1e-9)
        np.testing.assert_allclose(found_mm[label].covariance, x.covariance / 1e6, rtol=1e-7)
        np.testing.assert_allclose(found_mm[label].polygon, x.polygon * 1000, rtol=1e-9)


def test_the_slope_of_the_contours_by_difference():
    """Coefficients of (a, b, c) against finite differences of the residual: fixed correspondences, two step sizes."""
    Q = pairs.quads(1)
    pair = matching.stereo(Q.left, Q.right)
    pictures = zip(Q.labels, Q.values, ("left", "right"), strict=True)
    left, right = (borders.borders(pair, l, v, [2], side, 0.003).of(2) for l, v, side in pictures)
    m = pair.R_rect_left @ Q.m[2] * pair.baseline
    plane = np.array([m[0], m[1], m[2] * pair.f_px])
    part = np.zeros(len(left.uv), int)

    def rows(p):
        out = np.empty((len(part), kernels.COLUMNS))
        n = kernels.contour_rows(p, (0.0, 0.0), 4.0, 1.0, left, part, right, out)
        return out[:n]

    base = rows(plane)
    for k, step in ((0, 1e-6), (0, 1e-7), (1, 1e-6), (2, 1e-4), (2, 1e-5)):
        moved = rows(plane + np.eye(3)[k] * step)
        assert len(moved) == len(base)
        np.testing.assert_allclose(
            (moved[:, kernels.RESIDUAL] - base[:, kernels.RESIDUAL]) / step,
            base[:, k],
            rtol=1e-3,
            atol=1e-3 * np.abs(base[:, k]).max(),
        )


def test_pictures_without_noise():
    """Exact pictures: planes to 0.05 degree and 0.05 % of depth, no NaN, and a covariance that is still not zero."""
    Q = pairs.quads(7)
    found, _, _ = facets.reconstruct(
        matching.stereo(Q.left, Q.right), Q.labels, Q.values, np.arange(1, 7), np.arange(1, 7)
    )
    assert len(found) == 6
    for x in found:
        assert angle_deg(x.m, Q.m[x.left_label]) < 0.05
        assert np.linalg.norm(x.m) == pytest.approx(np.linalg.norm(Q.m[x.left_label]), rel=5e-4)
        assert np.linalg.eigvalsh(x.covariance)[0] > 0


# -- real pictures


@pytest.mark.outside
def test_chessboards():
    """The 13 real pairs, calibrated with OpenCV here: within 0.5 degree and 0.5 % of depth.

    The board's plane from its region, against the plane through its triangulated corners (measured: 0.12 degree,
    0.11 %).
    """
    boards = real_boards.board_pairs()
    assert len(boards) == 13
    worst = np.zeros(2)
    for x in boards:
        matches = matching.match(x.pair, *x.labels, *x.values)
        assert 2 in matches.left
        found, refused, _ = facets.reconstruct(x.pair, x.labels, x.values, matches.left, matches.right)
        (facet,) = [f for f in found if f.left_label == 2]
        depth = (x.middle @ x.true) / (x.middle @ facet.m)
        worst = np.maximum(worst, [angle_deg(facet.m, x.true), abs(depth - 1)])
    assert worst[0] < 0.5 and worst[1] < 0.005


@pytest.mark.outside
@pytest.mark.parametrize("scene", ["venus", pytest.param("sawtooth", marks=pytest.mark.slow)])
def test_middlebury(scene, run, tmp_path):
    """From the photographs through the stages: the facets' disparity errors, and how much they cover."""
    folder = DATA / scene
    of = lambda what, left, right: [f"--{what}", left, f"--{what}-right", right]
    photographs = of("photograph", folder / "left.png", folder / "right.png")
    regions = of("regions", tmp_path / "lr.png", tmp_path / "rr.png")
    surfaces = of("surfaces", tmp_path / "l.png", tmp_path / "r.png")
    more = [
        *photographs,
        *surfaces,
        "--camera",
        folder / "left.cameramodel",
        "--camera-right",
        folder / "right.cameramodel",
        "--matches",
        tmp_path / "m.csv",
    ]
    for stage in (
        ["stages/segment.py", *photographs, *regions],
        ["stages/surfaces.py", *photographs, *regions, *surfaces],
        ["stages/match.py", *more],
        [
            "stages/reconstruct.py",
            *(*more, "--facets", tmp_path / "facets.json", "--mesh", tmp_path / "facets.ply"),
            *("--report", tmp_path / "r.json"),
        ],
    ):
        result = run(*stage)
        assert result.returncode == 0, result.stderr
    camera, other = (cameras.read_cameramodel(folder / f"{s}.cameramodel") for s in ("left", "right"))
    labels = image.read_labels(tmp_path / "l.png")
    truth = image.read_photograph(folder / "truth" / "disparity.png").values[..., 0] * 255 / 8
    error, covered = [], 0
    found = json.loads((tmp_path / "facets.json").read_text())["facets"]
    check_trace(json.loads((tmp_path / "r.json").read_text()), planes=len(found))
    for x in found:
        here = labels == x["left_label"]
        m = np.array(x["plane"]["n"]) / x["plane"]["d"]
        disparity = (
            camera.K[0, 0] * np.linalg.norm(other.centre - camera.centre) * camera.directions(camera.pixels()[here]) @ m
        )
        error.append(np.abs(disparity - truth[here])[truth[here] > 0])
        covered += here.sum()
    error = np.concatenate(error)
    assert covered / labels.size >= 0.40
    assert np.median(error) <= 0.1 and (error > 1).mean() <= 0.05
    assert {x["by"] for x in found} == {"contour", "texture", "both"}


# -- at the edge


def band(labels_of, shift=6, size=(120, 160)):
    """A parallel pair of a scene whose labels are those of labels_of(v, u), everything `shift` pixels apart."""
    left, right = parallel(size[1], size[0], 150.0, 0.1)
    y, x = np.mgrid[: size[0], : size[1]]
    labels = tuple(labels_of(y, x + s).astype(np.int32) for s in (0, shift))
    values = tuple(np.array([0.2, 0.5, 0.8, 0.35])[l][..., None] for l in labels)
    return pairs.Quads(left, right, values, labels, np.zeros((4, 3)))


def test_borders_along_the_epipolar_lines():
    """A band across the picture: its borders say nothing of its distance, so it is refused, and says why."""
    Q = band(lambda y, x: 1 + ((y >= 40) & (y < 80)))
    found, refused = reconstructed(Q)
    assert 2 not in found
    assert refused[2].startswith("condition") or "border" in refused[2] or "rows" in refused[2]


def test_region_at_the_picture_border():
    """Cut by the left border: that side is no border of the facet.

    The other three give the plane where they can, and it is the right one.
    """
    Q = band(lambda y, x: 1 + ((y >= 30 + 0.1 * x) & (y < 80 - 0.1 * x) & (x < 90)))
    found, refused = reconstructed(Q)
    if 2 in found:
        v = Q.left.directions(np.array([[85.0, 55]]))[0]
        assert 150 * 0.1 * (found[2].m @ v) == pytest.approx(6.0, abs=0.3)
    else:
        assert refused[2]


def test_infinitely_far():
    """Disparity 0: 1 / distance is 0 within its sigma, and no plane is claimed."""
    Q = band(lambda y, x: 1 + ((y >= 40) & (y < 80) & (x >= 50) & (x < 110)), shift=0)
    found, refused = reconstructed(Q)
    assert not found and refused


def test_through_a_camera_centre():
    """A region that is a line in the right picture lies in a plane through the right camera: refused."""
    Q = pairs.quads(0)
    labels = [x.copy() for x in Q.labels]
    y, x = np.nonzero(labels[1] == 1)
    labels[1][labels[1] == 1] = 7
    labels[1][y.min() : y.max() + 1, x.mean().astype(int)] = 1
    found, refused, _ = facets.reconstruct(
        matching.stereo(Q.left, Q.right), labels, Q.values, np.array([1]), np.array([1])
    )
    assert not found and refused[0].why


def test_a_wrong_pair_is_refused():
    """Quadrilaterals of other shapes do not cover each other, whatever the plane."""
    Q = pairs.quads(0)
    found, refused, _ = facets.reconstruct(
        matching.stereo(Q.left, Q.right), Q.labels, Q.values, np.array([1, 2]), np.array([3, 6])
    )
    assert not found and len(refused) == 2


def test_nothing_to_reconstruct():
    Q = pairs.quads(0)
    assert facets.reconstruct(
        matching.stereo(Q.left, Q.right), Q.labels, Q.values, np.array([], int), np.array([], int)
    )[:2] == ([], [])


def test_noise_of_a_resampled_picture():
    """Noise that neighbours share is noise all the same."""
    import cv2

    rng = np.random.default_rng(0)
    white = 0.5 + rng.normal(0, 0.02, (200, 300, 1))
    one = np.ones((200, 300), int)
    assert borders.noise(white, one) == pytest.approx(0.02, rel=0.05)
    soft = cv2.GaussianBlur(white, (0, 0), 0.7)[..., None]
    assert borders.noise(soft, one) == pytest.approx(soft.std(), rel=0.1)
    assert borders.noise(np.full((20, 20, 1), 0.5), np.ones((20, 20), int)) > 0


def test_noise_is_no_texture():
    """Two pictures of noise alone: no plane is read out of them."""
    rng = np.random.default_rng(0)
    Q = pairs.textured(0)
    values = [0.5 + rng.normal(0, 0.05, v.shape) for v in Q.values]
    found, refused, _ = facets.reconstruct(
        matching.stereo(Q.left, Q.right), Q.labels, values, np.array([1]), np.array([1])
    )
    assert not found or chi2(found[0], Q.m[1]) < 3 * CHI2_95  # what the outline alone says may stand


# -- dense stereo


def levels_of(Q, values):
    """(Stereo, views, coarse level) of a pair."""
    pair = matching.stereo(Q.left, Q.right)
    sigma = borders.noise(values[0], Q.labels[0])
    return pair, matching.views(pair, Q.labels, values), intensities.smoothed_levels(pair, values, sigma)[0]


@pytest.mark.parametrize("seed", range(3))
def test_dense_stereo_finds_a_textured_plane(seed):
    """Without any start, to the tenth of a pixel that whole-pixel matching leaves, and within its own sigma."""
    Q = pairs.textured(seed)
    values = Q.noisy(0.005, np.random.default_rng(seed))
    pair, views, level = levels_of(Q, values)
    pixels = np.flatnonzero(Q.labels[0].ravel() == 1)
    shown = dense.textured(level, pixels)
    assert len(shown) > 0.5 * len(pixels)
    uv0 = np.array([views[0].u.ravel()[pixels].mean(), views[0].v.ravel()[pixels].mean()])
    true = np.linalg.inv(facets._m_from_disparity(pair, uv0)) @ Q.m[1]
    all_of_it = dense.disparities(pair, views, values, (0, 2 * true[2]))
    found = all_of_it.plane(shown, uv0, 40.0, np.random.default_rng(0))
    assert found.apart(true) < 0.25
    e = (found.plane - true) * [40, 40, 1]
    assert e @ found.A @ e < 3 * CHI2_95
    assert found.apart(found.plane + [0, 0, 2.0]) == pytest.approx(2)
    level = intensities.smoothed_levels(pair, values, 0.005)[0]
    alike = lambda plane: intensities.alike(views, pair.f_px, level, 1, pixels, plane, uv0)
    assert alike(found.plane) == pytest.approx(1, abs=0.15) and alike(found.plane + [0, 0, 6]) < 0.5


def test_two_planes_are_not_one():
    """Disparities of a fold: neither half has seven tenths of the pixels."""
    v, u = np.mgrid[:80, :120].astype(float)
    folded = dense.Disparities(u, v, 20 + 0.3 * np.abs(u - 60))
    pixels, rng = np.arange(u.size), np.random.default_rng(0)
    assert folded.plane(pixels, (60.0, 40.0), 40.0, rng) is None
    flat = dense.Disparities(u, v, np.where(u < 20, np.nan, 20 + 0.1 * u + 0.05 * v))
    np.testing.assert_allclose(flat.plane(pixels, (60.0, 40.0), 40.0, rng).plane, [0.1, 0.05, 28], atol=1e-9)
    assert flat.plane(pixels[:50], (60.0, 40.0), 40.0, rng) is None  # too few
    hardly = dense.Disparities(u, v, np.where(u < 60, np.nan, 20.0))
    assert hardly.plane(pixels, (60.0, 40.0), 40.0, rng) is None  # half of them have none


@pytest.mark.parametrize("steep", [0.05, 0.6])
def test_light_and_noise_are_no_texture(steep):
    """A lamp's pool of light over a wall, however steep, and noise: nothing to match. Stripes are."""
    Q = pairs.textured(0)
    height, width = Q.labels[0].shape
    y, x = np.mgrid[:height, :width] / width
    light = 0.2 + steep * (x - 0.3) ** 3 + steep * np.exp(-((x - 0.5) ** 2 + (y - 0.4) ** 2) / 0.3)
    rng = np.random.default_rng(0)
    wall = lambda extra: [np.ascontiguousarray((light + extra + rng.normal(0, 0.01, light.shape))[..., None])] * 2
    pixels = np.flatnonzero(Q.labels[0].ravel() == 1)
    _, _, level = levels_of(Q, wall(0))
    assert len(dense.textured(level, pixels)) == 0
    _, _, level = levels_of(Q, wall(0.1 * np.sin(60 * x)))
    assert len(dense.textured(level, pixels)) > 0.3 * len(pixels)


def test_noise_is_that_of_plain_tiles():
    """A picture textured on eight parts of ten; one that is plain; one that is black or white on half."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:240, :320]
    labels, white = np.ones((240, 320), int), 0.5 + rng.normal(0, 0.01, (240, 320, 1))
    texture = white + np.where(x < 256, 0.2 * np.sin(x / 1.5) * np.sin(y / 1.7), 0)[..., None]
    noise = borders.noise(texture, labels)
    assert noise > 0.03
    assert borders.noise_without_texture(texture, labels, noise) == pytest.approx(0.01, rel=0.15)
    plain = borders.noise(white, labels)
    assert 0.85 * plain < borders.noise_without_texture(white, labels, plain) <= plain
    clipped = np.where(x[..., None] < 160, 1.0, white)
    assert borders.noise_without_texture(clipped, labels, plain) == pytest.approx(0.01, rel=0.15)
    assert borders.noise_without_texture(white[:40, :40], labels[:40, :40], plain) == plain  # too few tiles


def test_texture_outvotes_a_false_outline():
    """A printed picture's edge that moves with another disparity in the right photograph: the texture's plane wins."""
    Q = pairs.textured(1, contrast=0.3)
    values = Q.noisy(0.004, np.random.default_rng(0))
    frame = lambda label: label == 1
    shifted = [Q.labels[0], np.where(np.roll(frame(Q.labels[1]), 3, 1), 1, 2).astype(np.int32)]
    for v, label in zip(values, shifted, strict=True):  # a bright line drawn along the region's border
        edge = cv2_edge(frame(label))
        v[edge] = 1.0
    pair = matching.stereo(Q.left, Q.right)
    (found,), _, _ = facets.reconstruct(pair, shifted, values, np.array([1]), np.array([1]))
    assert found.by == "texture" and angle_deg(found.m, Q.m[1]) < 1
    assert np.linalg.norm(found.m) == pytest.approx(np.linalg.norm(Q.m[1]), rel=5e-3)


def cv2_edge(mask):
    """(H, W) bool: a line of 3 px just outside a region."""
    import cv2

    return (cv2.dilate(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0) & ~mask


# -- from outside


def check_trace(report, planes):
    """The contract of `trace`: clocks that run, within the report's time; borders get no farther apart on the way."""
    trace = report["trace"]
    assert [t["step"] for t in trace] == ["outline", "contours", "texture", "texture", "sides"]
    assert [t["iteration"] for t in trace] == list(range(len(trace)))
    for clock in ("cpu_s", "wall_s"):
        times = [t[clock] for t in trace]
        assert times == sorted(times) and times[0] > 0 and times[-1] <= report[clock]
    assert trace[1]["wall_s"] > trace[0]["wall_s"]
    assert all(t["planes"] >= planes for t in trace)
    assert trace[-1]["borders_apart_px"] <= 1.1 * trace[0]["borders_apart_px"] < 1


@pytest.mark.parametrize("edge", [39.5, 39.8, 40.2])
@pytest.mark.parametrize("sliver", [0, 1, 2])
def test_a_border_with_a_sliver_on_it_is_where_the_inner_colour_ends(edge, sliver):
    """A board's edge or a contact shadow, `sliver` px wide, between two colours: the border of the left one."""
    start = np.arange(80) - 0.5  # of each pixel
    share = lambda a, b: np.clip(np.minimum(start + 1, b) - np.maximum(start, a), 0, 1)
    row = 0.6 * share(-1, edge) + 0.2 * share(edge, edge + sliver) + 0.4 * share(edge + sliver, 90)
    noise = np.random.default_rng(sliver).normal(0, 0.004, (60, 80, 3))
    values = np.repeat(row[None], 60, 0)[..., None] * [1, 0.9, 0.8] + noise
    ends = [40, 40 + sliver]
    labels = np.repeat(1 + np.digitize(np.arange(80), ends).astype(np.int32)[None], 60, 0)
    pair = matching.stereo(*parallel(80, 60, 100.0, 0.1))
    found = borders.borders(pair, labels, values, [1], "left", 0.004)
    q, sigma = found.of_photograph(1)
    assert len(q) > 45 and np.abs(q[:, 0] - edge).max() < 0.4
    assert (np.abs(q[:, 0] - edge) < 4 * sigma + 0.03).mean() > 0.95


def test_a_border_that_hardly_shows_says_little():
    """An isophote: the labels change where the picture hardly does."""
    values = np.repeat((0.3 + 0.002 * np.arange(80))[None], 60, 0)[..., None].repeat(3, 2)
    values = values + np.random.default_rng(0).normal(0, 0.004, values.shape)
    labels = np.repeat(1 + (np.arange(80) >= 40).astype(np.int32)[None], 60, 0)
    pair = matching.stereo(*parallel(80, 60, 100.0, 0.1))
    assert (borders.borders(pair, labels, values, [1], "left", 0.004).sigma > 0.4).all()


@pytest.mark.parametrize("apart, bend, share", [(0.0, 0.0, 0.0), (6.0, 0.0, 0.0), (6.0, 0.5, 0.25)])
def test_ends_of_rows_on_another_plane_are_counted(apart, bend, share):
    """The left ends of a region's rows lie on one plane, the right ones on another that is `apart` px nearer.

    One line is no plane, for what hides a region has one; two are.
    """
    row = np.arange(100)
    left = np.column_stack([20 + 0.3 * row, 90 - 0.2 * row - bend * np.maximum(row - 50, 0)])
    disparity = 10 + 0.05 * left + 0.02 * row[:, None] + [0, apart]
    region = lambda ends: matching.RegionArrays(
        *(np.array([100]), np.zeros((1, 1)), np.zeros((1, 2)), np.array([0]), np.array([99]), np.zeros(1, bool)),
        *(np.array([0, 100]), ends, np.ones(ends.shape, bool), np.zeros(1, np.int64), np.array([0, 1])),
    )
    plane = 0.05, 0.02, 10 - 0.01
    found = matching.another_plane(region(left), region(left - disparity), 0, 0, plane)
    assert found == pytest.approx(share, abs=0.05)  # what is within 2 px of a line goes to it


def outlined(lines, plane, ahead, noise, rng):
    """Borders of a region in both pictures, and the sides of their points: (left, right, part).

    lines : (u, v) of the start and of the end of each side, on the left;  plane : (a, b, c) of its disparity at (0, 0)
    ahead : px that each side has more disparity than the plane
    """
    sides = []
    for k, (start, end) in enumerate(np.asarray(lines, float)):
        t = np.linspace(0.02, 0.98, int(np.hypot(*(end - start))))
        left = start + t[:, None] * (end - start)
        right = left - np.column_stack([left @ plane[:2] + plane[2] + ahead[k], 0 * t])
        for uv in (left, right):
            along = uv[-1] - uv[0]
            normal = np.array([along[1], -along[0]]) / np.hypot(*along)
            sides.append((uv + rng.normal(0, noise, (len(t), 1)) * normal, np.tile(normal, (len(t), 1)), len(t) * [k]))
    pictures = []
    for mine in (sides[::2], sides[1::2]):
        uv, normal, part = (np.concatenate(x) for x in zip(*mine, strict=True))
        order = np.argsort(uv[:, 1])
        border = Border(uv[order], normal[order], np.full(len(uv), 0.05), np.zeros(len(uv)))
        pictures.append((border, part[order]))
    return pictures


# A floor: the walls behind it, the long upright edges of a box, its foot, and a board's edge on the left.
FLOOR = (
    [(0, 60), (90, 20)],
    [(90, 20), (150, 40)],
    [(150, 40), (150, 140)],
    [(150, 140), (120, 150)],
    [(0, 150), (0, 60)],
)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_a_floor_is_found_behind_what_hides_it(seed, noise):
    """The longest sides, upright ones of a box and a board, lie on a plane of their own, and the fit starts there."""
    plane = np.array([0.03, 0.21, 14.0])
    (left, part), (right, part_right) = outlined(FLOOR, plane, [0, 0, 17, 0, 12], noise, np.random.default_rng(seed))
    lines = sides.lines(left, right, part, part_right, (0.0, 0.0))
    hidden = np.array([0.05, 0.0, 38.0])
    starts = lines.starts(hidden, left, 60.0)
    assert len(starts) == 2 and starts[0] is hidden
    assert lines.score(starts[1][None])[0] > lines.score(hidden[None])[0] + 0.2
    off = np.column_stack([left.uv, np.ones(len(left.uv))]) @ (starts[1] - plane)
    assert np.abs(off).max() < 30 * noise  # a start: two lines, prolonged over the floor


def test_a_start_that_most_of_the_outline_agrees_with_is_kept():
    plane = np.array([0.03, 0.21, 14.0])
    (left, part), (right, part_right) = outlined(FLOOR, plane, 5 * [0], 0.0, np.random.default_rng(0))
    lines = sides.lines(left, right, part, part_right, (0.0, 0.0))
    assert lines.starts(plane, left, 60.0) == [plane]


def test_sides_that_do_not_meet_are_no_lines():
    (left, part), (right, _) = outlined([[(0, 0), (0, 50)]], [0, 0, 9], [0], 0.0, np.random.default_rng(0))
    low = right._replace(uv=right.uv + [0, 80])  # other rows
    behind = right._replace(uv=right.uv + [20, 0])  # disparity -11
    other_way = right._replace(normal=-right.normal)
    for far in (low, behind, other_way):
        assert sides.lines(left, far, part, part, (0.0, 0.0)) is None
    few = Border(*(x[:3] for x in left))
    assert sides.lines(few, right, part[:3], part, (0.0, 0.0)) is None


def test_a_facet_whose_tilt_is_hardly_known_is_loose():
    m = np.array([0.1, 0, 0.5])
    n = m / np.linalg.norm(m)
    across = np.eye(3) - np.outer(n, n)
    facet = lambda degrees: facets.Facet(
        1, 1, m, across * (np.radians(degrees) * np.linalg.norm(m)) ** 2 + 0.01 * np.outer(n, n), None, 1, 0, "contour"
    )
    assert facet(4.1).loose and not facet(3.9).loose


@pytest.mark.scene
def test_stage_writes_the_contract(run, pair_files, tmp_path):  # noqa: F811
    Q = pairs.quads(2)
    words = [*pair_files(Q), "--matches", tmp_path / "matches.csv"]
    run("stages/match.py", *words)
    orientation = tmp_path / "orientation.json"
    for unit, more in (("m", []), ("baseline", ["--orientation", orientation])):
        orientation.write_text(json.dumps({"unit": "baseline"}))
        result = run(
            "stages/reconstruct.py",
            *words,
            "--facets",
            tmp_path / "facets.json",
            "--mesh",
            tmp_path / "facets.ply",
            "--report",
            tmp_path / "r.json",
            *more,
        )
        assert result.returncode == 0, result.stderr
        content = json.loads((tmp_path / "facets.json").read_text())
        assert content["frame"] == "left" and content["unit"] == unit
        assert len(content["facets"]) == 6
        for x in content["facets"]:
            n, d, polygon = np.array(x["plane"]["n"]), x["plane"]["d"], np.array(x["polygon"])
            assert np.linalg.norm(n) == pytest.approx(1) and d < 0
            np.testing.assert_allclose(polygon @ n, d, rtol=1e-9)
            assert len(polygon) == 4 and (polygon[:, 2] > 0).all()
            C = np.array(x["covariance"])
            np.testing.assert_allclose(C, C.T, rtol=1e-6, atol=1e-15)
            assert np.linalg.eigvalsh(C)[0] > 0 and 0.6 <= x["overlap"] <= 1
            assert angle_deg(n / d, Q.m[x["left_label"]]) < 1
            assert x["by"] in ("contour", "both") and x["loose"] is False
    report = json.loads((tmp_path / "r.json").read_text())
    check_trace(report, planes=6)
    assert report["facets"] == 6 and report["timings"]["reconstruct"]["wall_s"] <= report["wall_s"]
    import trimesh

    mesh = trimesh.load(tmp_path / "facets.ply", process=False)
    assert len(mesh.faces) == 2 * 6 and len(mesh.vertices) == 4 * 6


def test_polygon_corners_to_a_fraction_of_a_pixel():
    """The outline's corners, projected back, against the extent and the area of the exact region."""
    Q = pairs.quads(5)
    found, _ = reconstructed(Q, sigma=0.005)
    for label, x in found.items():
        if label == 7:
            continue
        q = Q.left.project(x.polygon)
        assert len(q) == 4
        inside = Q.labels[0] == label
        ys, xs = np.nonzero(inside)
        assert abs(q[:, 0].min() - xs.min() + 0.5) < 1.2 and abs(q[:, 1].max() - ys.max() - 0.5) < 1.2
        area = 0.5 * abs(np.sum(q[:, 0] * np.roll(q[:, 1], -1) - q[:, 1] * np.roll(q[:, 0], -1)))
        assert area == pytest.approx(inside.sum(), rel=0.004)  # an outline through pixel centres would miss 1.5 %


@pytest.mark.scene
def test_stage_refuses(refuses, pair_files, files_under, tmp_path):  # noqa: F811
    Q = pairs.quads(2)
    words = [
        *pair_files(Q),
        "--matches",
        tmp_path / "matches.csv",
        "--facets",
        tmp_path / "facets.json",
        "--mesh",
        tmp_path / "facets.ply",
    ]
    (line,) = refuses("stages/reconstruct.py", *words)
    assert "matches.csv" in line
    (tmp_path / "matches.csv").write_text("left_label,right_label,similarity\n1,99,0.9\n")
    before = files_under(tmp_path)
    (line,) = refuses("stages/reconstruct.py", *words)
    assert "99" in line and files_under(tmp_path) == before
    cameras.write_cameramodel(tmp_path / "right.cameramodel", Q.left)
    (tmp_path / "matches.csv").write_text("left_label,right_label,similarity\n1,1,0.9\n")
    (line,) = refuses("stages/reconstruct.py", *words)
    assert "same centre" in line


@pytest.mark.parametrize(("quality", "warned"), [(95, 0), (85, 2)])
def test_stage_warns_of_strong_jpegs(run, pair_files, tmp_path, quality, warned):
    Q = pairs.quads(2)
    words = [*pair_files(Q), "--matches", tmp_path / "matches.csv"]
    for side, values in zip(("left", "right"), Q.noisy(0.01, np.random.default_rng(0)), strict=True):
        jpegs.write(tmp_path / f"{side}.jpg", values, quality)
    words = [w.with_suffix(".jpg") if w in (tmp_path / "left.png", tmp_path / "right.png") else w for w in words]
    assert run("stages/match.py", *words).returncode == 0
    names = {"facets": "facets.json", "mesh": "facets.ply", "report": "r.json"}
    words += [w for option, name in names.items() for w in (f"--{option}", tmp_path / name)]
    assert run("stages/reconstruct.py", *words).returncode == 0
    warnings = json.loads((tmp_path / "r.json").read_text())["warnings"]
    assert len(warnings) == warned and all("of white at edges" in w for w in warnings)


def test_stage_traces_pairs_that_give_no_plane(run, pair_files, tmp_path):
    """A report is JSON: where no borders meet, how far they are apart is null."""
    Q = band(lambda y, x: 1 + ((y >= 40) & (y < 80)))
    words = [*pair_files(Q), "--matches", tmp_path / "matches.csv"]
    (tmp_path / "matches.csv").write_text("left_label,right_label,similarity\n2,2,0.9\n")
    result = run(
        "stages/reconstruct.py",
        *(
            *words,
            "--facets",
            tmp_path / "facets.json",
            "--mesh",
            tmp_path / "facets.ply",
            "--report",
            tmp_path / "r.json",
        ),
    )
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["status"] == "nothing reconstructed" and len(report["trace"]) == 5
    assert report["trace"][-1]["planes"] == 0 and report["trace"][-1]["borders_apart_px"] is None


def held_by(part, uv, normal):
    """Measured of border points (n, 2) on sides (n,), their normals (n, 2), each placed to .02 px."""
    rows = np.zeros((len(part), kernels.COLUMNS))
    rows[:, 0], rows[:, 1], rows[:, 2] = -(normal[:, :1] * np.column_stack([uv, np.ones(len(uv))])).T / 0.02
    rows[:, kernels.PART], rows[:, kernels.SIGMA], rows[:, kernels.WEIGHT] = part, 0.02, 1
    rows[:, kernels.U], rows[:, kernels.V] = uv.T
    return contours.measured_at(np.zeros(3), np.zeros(2), 40.0, rows, int(part.max()) + 1)


def test_one_line_holds_no_plane():
    """A wall's upper border in three pieces: 374, 16 and 52 points that lie within .1 px of a line told a ceiling."""
    random = np.random.default_rng(0)
    t, part = random.uniform(0, 500, 442), np.repeat([0, 1, 2], [374, 16, 52])
    normal = np.tile([-0.43, 0.9], (442, 1))
    line = np.column_stack([t, 0.48 * t + random.normal(0, 0.1, 442)])
    assert uncertainty.in_one_line(held_by(part, line, normal))
    assert not uncertainty.in_one_line(held_by(part, line + [0, 60] * (part == 2)[:, None], normal))


def test_sides_of_a_hole_hold_no_plane():
    """A lamp before a ceiling: its four sides tell where the lamp is. Beside the ceiling's own they may count."""
    part, t = np.repeat(np.arange(8), 40), np.tile(np.linspace(-1, 1, 40), 8)
    reach = np.where(part < 4, 30, 100)[:, None]
    normal = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]])[part % 4]
    x = held_by(part, reach * (normal + t[:, None] * normal[:, ::-1]), normal)
    lamp = held_by(part[:160], x.rows[:160, [kernels.U, kernels.V]], normal[:160])
    assert uncertainty.rests_on_holes(lamp, np.ones(4, bool))
    assert not uncertainty.rests_on_holes(x, np.arange(8) < 4)
    assert not uncertainty.rests_on_holes(x, np.zeros(8, bool))


def test_sides_of_holes_are_told():
    labels = np.ones((60, 80), int)
    labels[20:40, 30:50] = 2
    labels[:, 70:] = 3
    hole = contours.in_holes(labels, 1)
    assert hole.any() and not hole.all() and not contours.in_holes(labels, 2).any()
    q = np.array([[29.5, 30.0], [69.5, 30.0]])
    assert hole[contours.parts(labels, 1, q)].tolist() == [True, False]


def test_folds_are_sought_beyond_the_best_planes():
    """Two walls of which one has most of the outline: the other's plane, by itself, is far down the list."""
    first, second = folds._pairs(np.r_[0.5, np.linspace(0.6, 0, 199)])
    tried = set(zip(first.tolist(), second.tolist(), strict=True))
    assert {(0, 1), (0, 199), (38, 39), (4, 199)} <= tried and (100, 150) not in tried


def test_what_an_edge_of_the_picture_cuts_off_is_enclosed():
    """A lamp at the picture's upper edge is; the floor below, which touches three edges, is not."""
    labels = np.ones((60, 80), int)
    labels[:12, 30:50] = 2
    labels[45:] = 3
    hole = contours.in_holes(labels, 1)
    q = np.array([[29.5, 6.0], [40.0, 11.5], [40.0, 44.5]])
    assert hole[contours.parts(labels, 1, q)].tolist() == [True, True, False]


# -- the paper's way


def carried(Q, label):
    """(Stereo, arguments of mutual_overlap after the plane, true plane, arguments of overlap_plane) of one label."""
    pair = matching.stereo(Q.left, Q.right)
    views = matching.views(pair, Q.labels, Q.values)
    regions = [matching.regions(view) for view in views]
    uv0 = tuple(regions[0].centre[label - 1])
    both = (
        overlap.carried(regions[0], views[0], views[1], label, label, uv0),
        overlap.carried(regions[1], views[1], views[0], label, label, uv0),
    )
    true = np.linalg.inv(facets._m_from_disparity(pair, uv0)) @ Q.m[label]
    return pair, (uv0, *both, pair.f_px), true, (regions, views, uv0)


def test_mutual_overlap_by_hand():
    """A square on a plane across the axes, 4 px of disparity: all of it overlaps; 2 px off, (16 - 2) / (16 + 2) px."""
    left, right = parallel(64, 64, 100.0, 0.1)
    labels = np.ones((64, 64), np.int32)
    labels[20:36, 30:46] = 2
    labels = (labels, np.roll(labels, -4, 1))
    values = tuple(x[..., None] / 2.0 for x in labels)
    Q = pairs.Quads(left, right, values, labels, np.array([[0, 0, 0], [0, 0, 0.4], [0, 0, 0.4]]))
    _, given, true, _ = carried(Q, 2)
    np.testing.assert_allclose(true, [0, 0, 4])
    assert overlap_kernels.mutual_overlap(true, *given) == pytest.approx(1)
    for off in (-2.0, 2.0):
        assert overlap_kernels.mutual_overlap(true + [0, 0, off], *given) == pytest.approx(14 / 18)
    assert overlap_kernels.mutual_overlap(true + [0, 0, 1.5], *given) == pytest.approx(14.5 / 17.5)
    assert overlap_kernels.mutual_overlap(true + [0, 0, 30], *given) == 0
    assert overlap_kernels.mutual_overlap(np.array([0.95, 0, 4]), *given) == 0  # near the right camera's centre


@pytest.mark.parametrize("seed", range(4))
def test_the_maximum_of_the_overlap(seed):
    """From the ends of rows and from the truth the same maximum; none of the truth's neighbours overlaps more."""
    Q = pairs.quads(seed)
    for label in range(1, 7):
        pair, given, true, (regions, views, uv0) = carried(Q, label)
        start, _, _ = matching.outline_plane(*regions, label - 1, label - 1)
        start = start + [0, 0, start[0] * uv0[0] + start[1] * uv0[1]]
        (plane, value), (_, again) = (
            overlap.overlap_plane(regions, views, label, label, [begin], uv0, pair.f_px, 60.0, 200)
            for begin in (start, true)
        )
        assert value == pytest.approx(again, abs=3e-4)
        assert value >= overlap_kernels.mutual_overlap(true, *given)
        unit = np.array([60, 60, 1.0])
        for step in np.random.default_rng(seed).normal(0, 0.5, (20, 3)):
            assert overlap_kernels.mutual_overlap(true + step / unit, *given) <= value + 1e-9
        assert np.abs((plane - true) * unit).max() < 0.8  # whole pixels


@pytest.mark.slow
def test_overlap_and_least_squares_find_the_same_planes():
    """The paper's way within its own sigma; sub-pixel borders are ten times as near."""
    errors = {}
    for method in facets.METHODS:
        chi, errors[method] = [], []
        for seed in range(6):
            Q = pairs.quads(seed)
            both = np.arange(1, 7)
            pair, values = matching.stereo(Q.left, Q.right), Q.noisy(0.01, np.random.default_rng(seed))
            found = facets.reconstruct(pair, Q.labels, values, both, both, method=method).facets
            assert len(found) >= 5
            chi += [chi2(x, Q.m[x.left_label]) for x in found]
            errors[method] += [np.linalg.norm(x.m - Q.m[x.left_label]) / np.linalg.norm(x.m) for x in found]
        assert np.median(chi) < 4
    assert np.median(errors["overlap"]) < 0.03
    assert np.median(errors["least-squares"]) < np.median(errors["overlap"]) / 5


def test_stage_takes_the_papers_way(run, refuses, pair_files, tmp_path):
    Q = pairs.quads(2)
    words = [*pair_files(Q), "--matches", tmp_path / "matches.csv"]
    run("stages/match.py", *words)
    words += ["--facets", tmp_path / "facets.json", "--mesh", tmp_path / "facets.ply", "--report", tmp_path / "r.json"]
    (line,) = refuses("stages/reconstruct.py", *words, "--method", "mirror")
    assert "mirror" in line and not (tmp_path / "facets.json").exists()
    result = run("stages/reconstruct.py", *words, "--method", "overlap")
    assert result.returncode == 0, result.stderr
    found = json.loads((tmp_path / "facets.json").read_text())["facets"]
    assert len(found) >= 5 and {x["by"] for x in found} == {"contour"}
    assert [x["step"] for x in json.loads((tmp_path / "r.json").read_text())["trace"]] == [
        "outline",
        "overlap",
        "sides",
    ]


def silhouette(disparity):
    """(sight, plane of its upright sides, Lines) of a box seen at its edge: six corners (u, v), their disparity, px."""
    import cv2

    corners = np.array([[20, 22], [50, 10], [80, 22], [80, 80], [50, 95], [20, 80.0]])
    labels, outlines = np.zeros((2, 110, 100), np.int32), [corners, corners - np.outer(disparity, [1, 0])]
    for picture, outline in zip(labels, outlines, strict=True):
        cv2.fillPoly(picture, [np.rint(16 * outline).astype(np.int32)], 1, shift=4)
    found = []
    for outline in outlines:
        to = np.roll(outline, -1, 0)
        length = np.hypot(*(to - outline).T)
        normal = np.column_stack([(to - outline)[:, 1], (outline - to)[:, 0]]) / length[:, None]
        rows = np.sort(np.column_stack([outline[:, 1], to[:, 1]]))
        found.append(sides.Sides(np.arange(6), (outline + to) / 2, normal, rows, length))
    v, u = np.mgrid[:110, :100].astype(float)
    order = [np.flatnonzero(picture) for picture in labels]
    sight = SimpleNamespace(
        pair=SimpleNamespace(photograph=lambda uv, side: uv),
        views=[SimpleNamespace(u=u, v=v, labels=picture) for picture in labels],
        regions=[SimpleNamespace(order=pixels, first=[0, len(pixels)]) for pixels in order],
    )
    return sight, np.array([0, 0, 5.0]), sides.Lines.of(*found, (50.0, 50.0))


@pytest.mark.parametrize("nearer", [0.0, 3.0, 6.0, -3.0])
def test_two_planes_that_meet_inside(nearer):
    """A box's edge that nothing shows, or a room's corner: the plane through the upright sides is not the region's."""
    sight, plane, lines = silhouette(np.array([5, 5 + nearer, 5, 5, 5 + nearer, 5]))
    assert folds.folded(sight, 1, 1, plane, (50.0, 50.0), 30.0, lines) == (nearer != 0)
