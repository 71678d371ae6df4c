"""What the photograph shows and the model has not."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from lib.analysis.answer import disagreements, strangers
from lib.given.materials import Why

CORNERS = np.array([[60, 40], [110, 35], [112, 90], [58, 95]])  # of a thing, x, y px


def picture_of(seen, owner=None, shadows=False):
    """A _Picture that knows what is seen, (H, W, C) display, and the facet of each pixel."""
    picture = object.__new__(strangers._Picture)
    picture.owner = np.zeros(seen.shape[:2], int) if owner is None else owner
    picture.pixel, picture.seen = np.arange(picture.owner.size), seen.reshape(-1, seen.shape[2])
    picture.view, picture.facet = type("View", (), {"shape": seen.shape[:2]}), picture.owner.reshape(-1)
    picture._are_shadows = lambda some, far, factors: np.full(len(some), shadows)
    return picture


def floor_with_a_thing(blur=0):
    """(H, W, 1): brighter than the floor above, and darker below, as a crate is before a floor of its own brightness"""
    y, x = np.mgrid[:140, :200]
    mask = cv2.fillConvexPoly(np.zeros(y.shape, np.uint8), CORNERS, 1)
    light = 0.5 + 0.0005 * x + mask * 0.1 * np.tanh((65 - y) / 8)
    return (cv2.GaussianBlur(light, (0, 0), blur) if blur else light)[..., None]


def test_a_thing_that_is_no_brighter_on_the_whole_is_known_by_its_outline():
    ((mine, pixels, middle, closed),) = picture_of(floor_with_a_thing()).outlined(None)
    area = cv2.contourArea(CORNERS)
    assert pixels == mine.sum() and abs(pixels / area - 1) < 0.15 and closed > 0.9
    assert np.linalg.norm(middle - CORNERS.mean(axis=0)) < 8


@pytest.mark.parametrize("why", ["soft", "shadows", "edge", "small", "noise"])
def test_what_else_may_draw_a_line_is_no_thing(why):
    """A soft shadow, one with edges that the lamps throw, an edge of the model there, a few pixels of dirt, grain."""
    seen, owner = floor_with_a_thing(blur=5 if why == "soft" else 0), np.zeros((140, 200), int)
    if why == "edge":
        cv2.fillConvexPoly(drawn := np.zeros((140, 200), np.uint8), CORNERS + 2, 1)
        owner = drawn.astype(int)
    if why == "small":
        seen = np.full((140, 200, 1), 0.5)
        seen[70:76, 90:96] += 0.2
    if why == "noise":
        seen = np.random.default_rng(5).normal(0.5, 0.05, seen.shape)
    assert picture_of(seen, owner, why == "shadows").outlined(None) == []


@pytest.mark.parametrize("blur", [0, 6])
def test_a_thing_stands_before_two_surfaces_where_its_sharp_outline_goes_on_over_the_second(blur):
    """A crate of which a twentieth hides a stool behind it (room-1001); soft shadows cross borders, too."""
    mine = np.zeros((140, 200), bool)
    mine[30:120, 40:120] = True
    owner = np.zeros(mine.shape, int)
    owner[10:80, 115:160] = 1  # seen beyond its right border, and 5 px of it are hidden
    light = 0.4 + 0.2 * mine.astype(float)
    light = cv2.GaussianBlur(light, (0, 0), blur) if blur else light
    picture = picture_of(light[..., None], owner)
    assert strangers._is_of_one(owner[mine])
    assert picture.is_before_several(mine, owner) == (blur == 0)
    assert not picture.is_before_several(mine, np.zeros_like(owner))


@pytest.mark.parametrize("blocks", [True, False])
def test_a_jpeg_that_was_stored_anew_is_named_before_things_that_its_blocks_look_like(blocks):
    """office at quality 30, stored as PNG, was said to lack three objects; nothing is said where all fits."""
    photograph = SimpleNamespace(lost_tables=blocks)
    proved, seen = Why("lamp_power", "lamp", "", 80.0), Why("object_missing", None, "", None)
    why = disagreements.of_the_file([proved, Why("unknown", None, "", None), seen], photograph)
    assert [w.cause for w in why] == ["lamp_power", *(["noise"] if blocks else ["unknown"]), "object_missing"]
    assert disagreements.of_the_file([], photograph) == []
