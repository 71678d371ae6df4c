"""Surfaces: borders without a step are none, and those with one stay."""

import json

import numpy as np
import pytest

from lib.given import image
from lib.vision import creases, necks, segmentation
from lib.vision.surfaces import noise_of_steps, surfaces
from tests.helpers import jpegs

H, W = 90, 120
Y, X = np.mgrid[:H, :W]


def picture(light, *, noise=0.004, seed=0, channels=3):
    tint = np.array([1, 0.9, 0.8])[:channels]
    return light[..., None] * tint + np.random.default_rng(seed).normal(0, noise, (*light.shape, channels))


def bands(light, number):
    """Regions cut along levels of the light, labels from 1."""
    return 1 + np.digitize(light, np.linspace(light.min(), light.max(), number + 1)[1:-1])


def connected(labels):
    return segmentation.kernels.components(np.ascontiguousarray(labels, np.int32))[0] + 1


def largest(labels):
    """Share of the picture that its largest surface covers."""
    return np.bincount(labels.ravel()).max() / labels.size


def spot(brightest=0.4):
    """Light of a lamp near a wall."""
    return 0.3 + brightest * np.exp(-((X - 40) ** 2 + (Y - 50) ** 2) / 9000)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("seed", range(3))
def test_levels_of_shading_are_one_surface(channels, seed):
    light = spot()
    found = surfaces(picture(light, seed=seed, channels=channels), connected(bands(light, 7)))
    assert largest(found) > 0.99  # corners of a few pixels have no side to compare


@pytest.mark.parametrize("step", [0.03, 0.1])
def test_a_step_stays(step):
    """Two walls under one shading: the isophotes cross the border between them."""
    light = spot() + step * (X > 70)
    labels = connected(bands(spot(), 6) * 2 + (X > 70))
    found = surfaces(picture(light), labels)
    left, right = found[:, :70], found[:, 71:]
    assert largest(left) > 0.98 and largest(right) > 0.98 and not np.isin(left, right).any()


@pytest.mark.parametrize(("quality", "spread"), [(None, 1.0), (100, 1.2), (95, 1.35), (75, 2.5)])
def test_what_steps_of_noise_spread(quality, spread):
    seen = picture(np.full((400, 400), 0.5), noise=0.01)
    if quality:
        seen = jpegs.stored(seen, quality).values
    assert noise_of_steps(seen) == pytest.approx(spread, rel=0.2)
    assert (noise_of_steps(np.full((400, 400, 3), 0.5)) == 1).all()  # one value has no noise


def test_blotches_of_jpeg_are_no_borders():
    y, x = np.mgrid[:240, :320]
    light = 0.3 + 0.4 * np.exp(-((x - 100) ** 2 + (y - 130) ** 2) / 60000)
    seen = jpegs.stored(picture(light, noise=0.01), 95).values
    regions = segmentation.segment(seen, segmentation.auto_lambda(seen))
    assert largest(surfaces(seen, regions, compressed=True)) > 0.95 > 0.6 > largest(surfaces(seen, regions))


def test_a_step_that_is_only_noise_is_none():
    light = np.full((H, W), 0.5)
    found = surfaces(picture(light, noise=0.01), connected(1 + (X > 60) + 2 * (Y > 45)))
    assert (found == 1).all()


def test_a_surface_bears_the_smallest_label_of_its_regions():
    light = spot() + 0.2 * (Y > 60)
    regions = segmentation.segment(picture(light), 0.002)
    found = surfaces(picture(light), regions)
    assert found.dtype == np.int32 and len(np.unique(found)) < len(np.unique(regions))
    assert all(regions[found == k].min() == k for k in np.unique(found))
    assert all(len(np.unique(found[regions == k])) == 1 for k in np.unique(regions))
    assert connected(found).max() == len(np.unique(found))


def test_one_region():
    assert (surfaces(picture(spot()), np.ones((H, W), int)) == 1).all()


def test_a_photograph_is_cut_where_it_has_steps():
    """From the segmentation at the noise's lambda: two walls, a floor and a poster, and nothing else of any size.

    A border lies where the noise happens to step: one picture in ten may cut a plane in two.
    """
    wall = np.where(X < 60, 0.45 + 0.002 * X, 0.75 - 0.002 * X) + spot(0.15) - 0.3
    light = np.where(Y > 65, 0.2 + 0.001 * X, wall)
    light = np.where((X > 80) & (X < 105) & (Y > 20) & (Y < 45), 0.3 + spot(0.1) - 0.3, light)
    numbers = []
    for seed in range(10):
        seen = picture(light, seed=seed)
        found = surfaces(seen, segmentation.segment(seen, segmentation.auto_lambda(seen)))
        numbers.append((np.bincount(found.ravel()) > 0.02 * H * W).sum())
        parts = found[:60, :55], found[:60, 65:78], found[25:40, 85:100], found[70:85, 10:110]
        main = [np.bincount(part.ravel()).argmax() for part in parts]
        assert len(set(main)) == 4
    assert max(numbers) <= 5 and numbers.count(4) >= 9


# ---- creases ----

ROWS, COLUMNS = np.mgrid[:240, :320]


def room(corner=150):
    """(labels of ceiling 1, walls 2 and floor 3; whether a pixel is right of the crease between the walls)."""
    ceiling = np.where(
        corner > COLUMNS, 30 + 30 * COLUMNS / corner, 60 - 40 * (COLUMNS - corner) / np.maximum(320 - corner, 1e-9)
    )
    floor = 250 - ceiling
    return 2 - (ceiling > ROWS) + (floor < ROWS), corner <= COLUMNS


def lit(labels, walls, noise, seed=0):
    """Display values (240, 320, 3): walls as given, a brighter ceiling, a darker floor."""
    light = np.where(labels == 2, walls, np.where(labels == 1, 0.9, 0.2))
    return light[..., None] * [1, 0.9, 0.8] + np.random.default_rng(seed).normal(0, noise, (240, 320, 3))


@pytest.mark.parametrize("noise", [0.0, 0.002, 0.008])
@pytest.mark.parametrize("corner", [90, 150, 230])
def test_walls_are_cut_where_their_light_bends(corner, noise):
    """No step, a kink of .006 per px: the crease to a pixel, and the larger wall keeps the label."""
    labels, right = room(corner)
    found = creases.cut(lit(labels, 0.4 + 0.003 * np.abs(COLUMNS - corner), noise), labels)
    assert (found[labels != 2] == labels[labels != 2]).all()
    assert set(np.unique(found)) == {1, 2, 3, 4}
    larger = right if corner < 160 else ~right
    expected = np.where(larger, 2, 4)
    near = np.abs(COLUMNS - corner) <= 1
    assert (found == expected)[(labels == 2) & ~near].all()


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_a_lit_wall_is_not_cut(seed, noise):
    """A lamp's spot is curved, not bent; nor is noise."""
    labels, _ = room()
    spot = 0.3 + 0.4 * np.exp(-((COLUMNS - 200) ** 2 + (ROWS - 120) ** 2) / 6000)
    assert (creases.cut(lit(labels, spot, noise, seed), labels) == labels).all()
    assert (creases.cut(lit(labels, 0.5 + 0 * spot, noise, seed), labels) == labels).all()


def test_an_edge_of_light_is_no_crease():
    """It bends the light as a crease does, but runs from the middle of one side to that of another."""
    labels, _ = room(320)
    edge = 120 - 0.2 * COLUMNS
    assert (creases.cut(lit(labels, 0.4 + 0.003 * np.maximum(edge - ROWS, 0), 0.002), labels) == labels).all()


def test_a_crease_that_something_hides_in_part_is_cut_behind_it():
    labels, right = room()
    labels = np.where((np.abs(COLUMNS - 150) < 12) & (np.abs(ROWS - 150) < 12), 7, labels)
    found = creases.cut(lit(labels, 0.4 + 0.003 * np.abs(COLUMNS - 150), 0.002), labels)
    assert set(np.unique(found)) == {1, 2, 3, 7, 8}
    near = np.abs(COLUMNS - 150) <= 1
    assert (found == np.where(right, 2, 8))[(labels == 2) & ~near].all()


# ---- the stage ----


@pytest.fixture
def files(tmp_path):
    """Two photographs with a step and an isophote, and their regions."""
    for side, seed in (("left", 1), ("right", 2)):
        light = spot() + 0.2 * (X > 70)
        image.write_png16(tmp_path / f"{side}.png", np.round(picture(light, seed=seed) * 60000).astype(np.uint16))
        image.write_png16(tmp_path / f"{side}.regions.png", connected(bands(spot(), 6) * 2 + (X > 70)))
    return tmp_path


def words(folder, sides=("", "-right"), names=("photograph", "regions", "surfaces")):
    side = {"": "left", "-right": "right"}
    file = {"photograph": "png", "regions": "regions.png", "surfaces": "surfaces.png"}
    return [w for s in sides for name in names for w in (f"--{name}{s}", folder / f"{side[s]}.{file[name]}")]


@pytest.mark.scene
def test_stage_joins_both_sides(run, files):
    done = run("stages/surfaces.py", *words(files), "--report", files / "r.json")
    assert done.returncode == 0, done.stderr
    number = json.loads((files / "r.json").read_text())["surfaces"]
    for side in ("left", "right"):
        found, regions = (image.read_labels(files / f"{side}.{kind}.png") for kind in ("surfaces", "regions"))
        assert len(np.unique(found)) == number[side] < len(np.unique(regions)) / 2
        assert largest(found[:, :70]) > 0.98 and largest(found[:, 71:]) > 0.98


def test_stage_takes_one_photograph(run, files):
    assert run("stages/surfaces.py", *words(files, ("",))).returncode == 0
    assert (files / "left.surfaces.png").exists() and not (files / "right.surfaces.png").exists()


def test_stage_refuses_regions_of_another_picture(refuses, files):
    image.write_png16(files / "right.regions.png", np.ones((H, W - 1), np.uint16))
    (line,) = refuses("stages/surfaces.py", *words(files))
    assert "right.regions.png" in line and f"{W - 1} x {H}" in line and not (files / "left.surfaces.png").exists()


def test_stage_refuses_half_a_pair(refuses, files):
    (line,) = refuses("stages/surfaces.py", *words(files, ("",)), *words(files, ("-right",), ("photograph",)))
    assert "--regions-right" in line


# ---- necks ----


def squares(width, gap=2):
    """Label 1, and two squares of label 2 beside each other, `gap` px apart, joined by a bar `width` px high."""
    labels = np.ones((60, 90), np.int32)
    labels[15:45, 10:40] = labels[15:45, 40 + gap : 70 + gap] = 2
    labels[30 : 30 + width, 40 : 40 + gap] = 2
    return labels


@pytest.mark.parametrize("width", [1, 2, 4])
@pytest.mark.parametrize("gap", [1, 2, 6])
def test_what_hangs_together_by_few_pixels_is_cut(width, gap):
    labels = squares(width, gap)
    found = necks.cut(labels)
    assert (found[labels == 1] == 1).all() and set(np.unique(found)) == {1, 2, 3}
    assert len({found[30, 20], found[30, 55 + gap]}) == 2
    assert len(np.unique(found[15:45, 10:40])) == 1 or width > 1  # the cut is in the neck
    assert connected(found).max() == 3


def test_corners_that_touch_in_the_blur_are_cut():
    """Of a chessboard's black squares, one pixel across each corner: every square is one surface."""
    tile = np.add.outer(np.arange(80) // 20, np.arange(100) // 20) % 2
    labels = connected(tile)  # each square its own, and the black ones 2
    labels[tile == 1] = 2
    for y in range(20, 80, 20):
        for x in range(20, 100, 20):
            labels[y - 1 : y + 1, x - 1 : x + 1] = 2
    found = necks.cut(labels)
    inside = [found[20 * r + 8 : 20 * r + 12, 20 * c + 8 : 20 * c + 12] for r in range(4) for c in range(5)]
    assert all(len(np.unique(x)) == 1 for x in inside) and len({int(x[0, 0]) for x in inside}) == 20


@pytest.mark.parametrize("width", [6, 12])
def test_a_broad_bar_is_no_neck(width):
    labels = squares(width, 6)
    assert (necks.cut(labels) == labels).all()


def test_a_spur_is_no_part():
    """A pole of 3 px on a square, and a knob of 8 px at its end."""
    labels = np.ones((60, 90), np.int32)
    labels[15:45, 10:40], labels[29:32, 40:70], labels[26:34, 70:78] = 2, 2, 2
    assert (necks.cut(labels) == labels).all()
