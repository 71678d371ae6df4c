"""§2.1, equation 2.1: the energy itself, pictures with a known minimum, laws at the extremes, the peers' energies."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from lib.given import image
from lib.vision import segmentation
from lib.vision.surfaces import surfaces
from tests.bench import segment_bench

HERE = Path(__file__).resolve().parent


@pytest.fixture(scope="module")
def astronaut():
    return segment_bench.picture(256)


def parts(labels):
    """4-connected parts of equal label, counted by another library."""
    import cv2

    return sum(
        cv2.connectedComponents((labels == k).astype(np.uint8), connectivity=4)[0] - 1 for k in np.unique(labels)
    )


def plain_energy(picture, labels, weight):
    """Equation 2.1 as one reads it."""
    error = sum(((picture[labels == k] - picture[labels == k].mean(0)) ** 2).sum() for k in np.unique(labels))
    return error + weight * ((labels[:, 1:] != labels[:, :-1]).sum() + (labels[1:] != labels[:-1]).sum())


def well_formed(labels, shape):
    n = labels.max()
    assert labels.shape == shape and np.array_equal(np.unique(labels), np.arange(1, n + 1))
    if n < 500:
        assert parts(labels) == n
    return n


def noise(shape, sigma, seed=0):
    return 0.5 + sigma * np.random.default_rng(seed).standard_normal(shape)


def exact_line(z, weight):
    """The least energy of one line: dynamic programming without pruning."""
    n = len(z)
    S, Q = np.vstack([np.zeros(z.shape[1]), np.cumsum(z, 0)]), np.r_[0, np.cumsum((z**2).sum(1))]
    B = [-weight]
    for r in range(1, n + 1):
        l = np.arange(r)
        B.append(min(np.array(B) + weight + Q[r] - Q[l] - ((S[r] - S[l]) ** 2).sum(1) / (r - l)))
    return B[-1]


def every_partition(picture, weight):
    """The least energy over all partitions of a few pixels into connected regions."""
    H, W, _ = picture.shape
    pairs = [((y, x), (y, x + 1)) for y in range(H) for x in range(W - 1)] + [
        ((y, x), (y + 1, x)) for y in range(H - 1) for x in range(W)
    ]
    best = np.inf
    for cut in range(2 ** len(pairs)):
        labels = np.arange(H * W).reshape(H, W)
        for k, (p, q) in enumerate(pairs):
            if not cut >> k & 1 and labels[p] != labels[q]:
                labels[labels == labels[p]] = labels[q]
        best = min(best, plain_energy(picture, labels, weight))
    return best


# -- the energy


@pytest.mark.parametrize("channels", [1, 3])
def test_energy_is_equation_2_1(channels):
    rng = np.random.default_rng(1)
    picture, labels = rng.random((13, 17, channels)), rng.integers(1, 6, (13, 17))
    assert segmentation.energy(picture, labels, 0.3) == pytest.approx(plain_energy(picture, labels, 0.3), rel=1e-12)


@pytest.mark.parametrize("weight", [0.001, 0.03, 0.2, 1.0])
def test_labels_are_connected_and_count_from_one(astronaut, weight):
    well_formed(segmentation.segment(astronaut[:120, 40:140], weight), (120, 100))


@pytest.mark.scene
def test_small_pictures_near_the_least_of_all_partitions():
    """Six or eight pixels of noise: nearly always exact, never more than a quarter above, never below."""
    exact = 0
    for seed in range(30):
        picture = np.random.default_rng(seed).random(((2, 3, 1), (3, 2, 3), (2, 4, 1))[seed % 3])
        weight = 0.03 * (1 + seed % 4)
        ratio = segmentation.energy(picture, segmentation.segment(picture, weight), weight) / every_partition(
            picture, weight
        )
        assert 1 - 1e-9 < ratio < 1.25
        exact += ratio < 1 + 1e-9
    assert exact >= 24


# -- minima that are known


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("weight", [0.01, 0.2])
def test_two_tones_exactly(channels, weight):
    """A disc, an L and a line on a ground: the tones differ by 0.4 or more; every part is large against lambda."""
    y, x = np.mgrid[:80, :100]
    truth = ((y - 30) ** 2 + (x - 30) ** 2 < 18**2).astype(int)
    truth[50:75, 60:70] = truth[65:75, 60:95] = 2
    truth[:, 85:88][:60] = 3
    picture = np.repeat(np.array([0.1, 0.5, 0.9, 0.6])[truth][..., None], channels, 2)
    labels = segmentation.segment(picture, weight)
    assert labels.max() == 4
    assert all(len(np.unique(labels[truth == k])) == 1 for k in range(4))
    assert segmentation.energy(picture, labels, weight) == pytest.approx(
        plain_energy(picture, truth, weight), rel=1e-12
    )


@pytest.mark.parametrize("side", [4, 10, 25])
def test_a_square_stays_while_it_pays(side):
    """A square of side l and contrast d on a large ground is a region while C l^2 d^2 (1 - l^2 / N) > 4 l lambda."""
    d, n = 0.2, 96
    picture = np.full((n, n, 3), 0.4)
    picture[40 : 40 + side, 30 : 30 + side] += d
    limit = 3 * side * d**2 * (1 - side**2 / n**2) / 4
    assert segmentation.segment(picture, 0.98 * limit).max() == 2
    assert segmentation.segment(picture, 1.02 * limit).max() == 1


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (1, 300), (300, 1)])
@pytest.mark.parametrize("channels", [1, 3])
def test_one_row_or_column_is_exact(shape, channels):
    rng = np.random.default_rng(3)
    line = np.repeat(rng.random((30, channels)), 10, 0)[: max(shape)] + 0.1 * rng.standard_normal(
        (max(shape), channels)
    )
    picture = line.reshape(*shape, channels)
    for weight in (0.001, 0.05, 0.7, 20.0):
        labels = segmentation.segment(picture, weight)
        well_formed(labels, shape)
        assert segmentation.energy(picture, labels, weight) == pytest.approx(exact_line(line, weight), abs=1e-10)


# -- extremes


@pytest.mark.parametrize("weight", [0.0, 1e-9, 0.05, 1e300])
@pytest.mark.parametrize("value", [0.0, 0.37, 1.0])
def test_a_flat_picture_is_one_region_of_energy_zero(weight, value):
    labels = segmentation.segment(np.full((40, 50, 3), value), weight)
    assert (labels == 1).all() and segmentation.energy(np.full((40, 50, 3), value), labels, weight) < 1e-20


def test_lambda_zero_is_every_constant_area():
    rng = np.random.default_rng(5)
    picture = rng.integers(0, 3, (60, 70, 1)) / 2
    labels = segmentation.segment(picture, 0)
    assert well_formed(labels, (60, 70)) == parts((2 * picture[..., 0]).astype(int))
    assert segmentation.energy(picture, labels, 0) < 1e-20


def test_lambda_tends_to_zero():
    """Below what any merge costs the answer is that of lambda 0, for ten thousand regions of a chessboard of noise."""
    picture = np.kron(np.random.default_rng(6).permutation(10000).reshape(100, 100) / 10000.0, np.ones((2, 2)))[
        ..., None
    ]
    zero, small = (segmentation.segment(picture, weight) for weight in (0, 1e-10))
    assert zero.max() == 10000 and np.array_equal(zero, small)


def test_lambda_infinite_is_one_region(astronaut):
    for weight in (astronaut.size, 1e300):
        labels = segmentation.segment(astronaut, weight)
        assert labels.max() == 1
        assert segmentation.energy(astronaut, labels, weight) == pytest.approx(
            ((astronaut - astronaut.mean((0, 1))) ** 2).sum(), rel=1e-12
        )


@pytest.mark.scene
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("sigma", [0.002, 0.02, 0.2])
def test_pure_noise_is_one_region(channels, sigma):
    """At the lambda that noise asks for, whatever its strength; and the strength is found."""
    for seed in range(3):
        picture = noise((200, 240, channels), sigma, seed)
        assert segmentation.noise(picture) == pytest.approx(sigma, rel=0.03)
        assert segmentation.segment(picture, segmentation.auto_lambda(picture)).max() == 1


def test_pure_noise_ends_at_any_lambda():
    picture = noise((100, 100, 3), 0.3)
    number = [well_formed(segmentation.segment(picture, weight), (100, 100)) for weight in (1e-6, 1e-3, 0.1, 0.5, 1, 3)]
    assert number[0] == 10000 and number[-1] == 1 and number == sorted(number, reverse=True)


# -- laws


@pytest.mark.scene
def test_energy_rises_with_lambda_and_regions_fall(astronaut):
    """The least energy rises with lambda and is concave.

    Ours is near enough to the least for the first and, within 1 %, for the second.
    """
    weights = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 20, 100]
    energy, count = [], []
    for weight in weights:
        labels = segmentation.segment(astronaut, weight)
        energy.append(segmentation.energy(astronaut, labels, weight))
        count.append(labels.max())
    assert energy == sorted(energy) and count == sorted(count, reverse=True)
    for k in range(1, len(weights) - 1):
        (a, b, c), (E, F, G) = weights[k - 1 : k + 2], energy[k - 1 : k + 2]
        assert 0.99 * (E + (G - E) * (b - a) / (c - a)) < F


def test_merging_gives_the_path_in_one_run(astronaut):
    """Nested partitions; what one run gives at a lambda is what a run up to that lambda alone gives."""
    weights = [0.02, 0.2, 2.0]
    path = list(segmentation.merging(astronaut, weights))
    for fine, coarse in pairwise(path):
        assert len(np.unique(fine.astype(np.int64) * 10**6 + coarse)) == fine.max()
    (alone,) = segmentation.merging(astronaut, weights[1:2])
    assert segmentation.energy(astronaut, alone, 0.2) == pytest.approx(
        segmentation.energy(astronaut, path[1], 0.2), rel=0.005
    )
    for weight, labels in zip(weights, path, strict=True):
        assert segmentation.energy(astronaut, segmentation.segment(astronaut, weight), weight) < segmentation.energy(
            astronaut, labels, weight
        )


def test_every_step_lowers_the_energy(astronaut):
    steps = []
    segmentation.segment(
        astronaut, 0.1, trace=lambda step, labels: steps.append((step, segmentation.energy(astronaut, labels, 0.1)))
    )
    assert [step for step, _ in steps[:3]] == ["start", "merged", "moved"]
    assert all(after <= before for (_, before), (_, after) in pairwise(steps))


@pytest.mark.scene
def test_transposing_mirroring_offset_and_scale(astronaut):
    """The energy of the transpose, of the mirror image and of the picture plus a constant: the same within 0.5 %.

    Of s times the picture with s^2 lambda: s^2 times as much, within 0.2 %.
    """

    def found(picture, weight):
        return segmentation.energy(picture, segmentation.segment(picture, weight), weight)

    for weight in (0.05, 0.5):
        E = found(astronaut, weight)
        assert found(astronaut.transpose(1, 0, 2), weight) == pytest.approx(E, rel=0.005)
        assert found(astronaut[:, ::-1], weight) == pytest.approx(E, rel=0.005)
        assert found(astronaut / 2, weight / 4) == pytest.approx(E / 4, rel=0.002)
        assert found(astronaut + 1, weight) == pytest.approx(E, rel=0.005)


def test_grey_is_one_channel(astronaut):
    """Three equal channels at 3 lambda are one channel at lambda."""
    grey = astronaut[..., :1]
    E = segmentation.energy(grey, segmentation.segment(grey, 0.05), 0.05)
    three = np.repeat(grey, 3, 2)
    assert segmentation.energy(three, segmentation.segment(three, 0.15), 0.15) == pytest.approx(3 * E, rel=0.002)


# -- lambda: auto


def test_noise_is_seen_through_shading_and_edges():
    y, x = np.mgrid[:200, :300] / 300
    picture = 0.3 + 0.4 * x * y + 0.2 * ((x * 7).astype(int) % 2)
    picture = picture[..., None] + noise((200, 300, 3), 0.01) - 0.5
    assert segmentation.noise(picture) == pytest.approx(0.01, rel=0.1)


def test_texture_that_fills_the_picture_is_one_region():
    """Blocks of 8 x 8 pixels of random grey: what white noise is to pixels."""
    picture = np.repeat(np.repeat(noise((40, 50, 3), 0.1), 8, 0), 8, 1)
    assert segmentation.segment(picture, segmentation.auto_lambda(picture)).max() == 1
    assert segmentation.segment(picture, 0.0624).max() > 100  # what shading alone would ask for


def test_auto_keeps_facets_and_leaves_shading_to_surfaces():
    """A square a 24th of the side: faint or strong it is a surface; a ramp over it cuts off its ends at most, where
    the step beyond is seen too."""
    n = 480
    for contrast, ramp in ((0.07, 0.0), (0.05, 0.0), (0.02, 0.0), (0.09, 0.1)):
        picture = np.full((n, n, 3), 0.3)
        side = n // 24
        picture[100 : 100 + side, 200 : 200 + side] += contrast + ramp * np.linspace(-0.5, 0.5, side)[:, None]
        regions = segmentation.segment(picture, segmentation.auto_lambda(picture))
        found = surfaces(picture, regions)
        inside = found[100 : 100 + side, 200 : 200 + side]
        assert np.bincount(inside.ravel()).max() > (0.75 if ramp else 0.99) * side**2
        assert not np.isin(inside, found[:100]).any() and (found[:100] == found[-1, -1]).all()


# -- against the peers


@pytest.mark.outside
@pytest.mark.parametrize("side", [256, 512])
def test_energy_against_pottslab(side):
    """At most Pottslab's energy, with room to spare (measured with pottslab 1.0.1, anisotropic, default settings)."""
    picture = segment_bench.picture(side)
    for weight, peer in segment_bench.POTTSLAB[side].items():
        labels = segmentation.segment(picture, weight)
        assert segmentation.energy(picture, labels, weight) < 0.985 * peer


# -- the stage


@pytest.fixture
def pair(tmp_path, astronaut):
    for name, picture in (("left", astronaut), ("right", astronaut[:, ::-1])):
        image.write_png8(tmp_path / f"{name}.png", np.round(picture * 255).astype(np.uint8))
    return tmp_path


@pytest.mark.scene
def test_stage_writes_both_sides_and_an_exact_report(run, pair):
    done = run(
        "stages/segment.py",
        "--photograph",
        pair / "left.png",
        "--photograph-right",
        pair / "right.png",
        "--lambda",
        "auto",
        "--regions",
        pair / "left.regions.png",
        "--regions-right",
        pair / "right.regions.png",
        "--report",
        pair / "r.json",
    )
    assert done.returncode == 0, done.stderr
    report = json.loads((pair / "r.json").read_text())
    pictures = {side: image.read_photograph(pair / f"{side}.png").values for side in ("left", "right")}
    assert report["lambda"] == pytest.approx(segmentation.auto_lambda(*pictures.values()))
    assert {t["side"] for t in report["trace"]} == {"left", "right"}
    for side, picture in pictures.items():
        labels = image.read_labels(pair / f"{side}.regions.png")
        assert well_formed(labels, picture.shape[:2]) == report["regions"][side]
        assert report["energy"][side] == pytest.approx(plain_energy(picture, labels, report["lambda"]), rel=1e-9)


def test_stage_writes_a_tiff_where_sixteen_bits_end(run, tmp_path):
    values = np.random.default_rng(0).permutation(300 * 300).reshape(300, 300) % 65536
    image.write_png16(tmp_path / "left.png", values)
    assert (
        run(
            "stages/segment.py",
            "--photograph",
            tmp_path / "left.png",
            "--lambda",
            "0",
            "--regions",
            tmp_path / "left.regions.png",
        ).returncode
        == 0
    )
    labels = image.read_labels(tmp_path / "left.regions.tif")
    assert labels.max() > 65535 and np.array_equal(labels, image.read_labels(tmp_path / "left.regions.png"))
    assert (
        run(
            "stages/segment.py",
            "--photograph",
            tmp_path / "left.png",
            "--lambda",
            "1e9",
            "--regions",
            tmp_path / "left.regions.png",
        ).returncode
        == 0
    )
    assert (image.read_labels(tmp_path / "left.regions.png") == 1).all() and not (
        tmp_path / "left.regions.tif"
    ).exists()


def test_stage_shows_linear_light_as_display_values(run, tmp_path):
    light = np.full((30, 40, 3), 0.2, np.float32)
    light[5:20, 5:20] = 0.6
    light[20:, 30:] = 50.0  # a lamp: 1 as displayed, and nothing beyond
    image.write_exr(tmp_path / "left.exr", light)
    assert (
        run(
            "stages/segment.py",
            "--photograph",
            tmp_path / "left.exr",
            "--lambda",
            "0.05",
            "--regions",
            tmp_path / "regions.png",
            "--report",
            tmp_path / "r.json",
        ).returncode
        == 0
    )
    assert len(np.unique(image.read_labels(tmp_path / "regions.png"))) == 3
    assert json.loads((tmp_path / "r.json").read_text())["energy"]["left"] == pytest.approx(0.05 * (60 + 20), abs=1e-6)


@pytest.mark.parametrize("value", ["-1", "nan", "much"])
def test_stage_refuses_a_bad_lambda(refuses, pair, value):
    (line,) = refuses(
        "stages/segment.py",
        "--photograph",
        pair / "left.png",
        f"--lambda={value}",
        "--regions",
        pair / "left.regions.png",
    )
    assert "--lambda" in line and value in line and not (pair / "left.regions.png").exists()


def test_stage_refuses_half_a_pair(refuses, pair):
    (line,) = refuses(
        "stages/segment.py",
        "--photograph",
        pair / "left.png",
        "--photograph-right",
        pair / "right.png",
        "--regions",
        pair / "left.regions.png",
    )
    assert "--photograph-right" in line
