"""Light from outside of models that are open: what leaves, where, and what a photograph tells of what comes in."""

import json

import numpy as np
import pytest

from lib.analysis.causes import glow
from lib.analysis.fit import facts
from lib.analysis.seen import gather
from lib.buffers import index_buffer
from lib.given import image, materials, model
from lib.given.view import View
from lib.light import factors_file, form_factors, outside
from lib.light.factors_file import OUTSIDE
from tests.helpers import rooms
from tests.helpers.boxes import look
from tests.helpers.changed_scenes import deviated, obj


def open_room(folder, without="south"):
    """(Surface, FormFactors) of a room of 4 x 3 x 2.5 m with a hanging lamp, without one wall."""
    objects = rooms.room() | rooms.LAMP
    objects["room"] = [face for face in objects["room"] if face[0] != without]
    s = rooms.surface(folder / "model.obj", objects)
    m = rooms.patches(s, 150)
    rows = form_factors.rays(s, m, n_rays=1024)
    lamp = np.ones((len(m), 1))
    area = np.ones(len(s.groups))
    return s, factors_file.FormFactors(m, rows, lamp, ("lamp",), s.group[m.side // 2], s.groups, area, 1.0)


def test_a_closed_room_has_no_outside(tmp_path):
    s, factors = open_room(tmp_path, without=None)
    assert outside.with_outside(factors, lambda: s) is factors


def test_what_leaves_is_what_the_missing_wall_would_have_caught(tmp_path):
    """Against the rays of the closed room that meet that wall."""
    s, factors = open_room(tmp_path)
    lit = outside.with_outside(factors, lambda: s)
    assert lit.lamps == ("lamp", *OUTSIDE) and lit.own_lamps == ("lamp",) and list(lit.lamp_groups[1:]) == [-1] * 10
    (tmp_path / "closed").mkdir()
    whole, closed = open_room(tmp_path / "closed", without=None)
    wall = closed.patch_group == whole.groups.index("south")
    sides = {name: [k for k, g in enumerate(x.groups) if g == name][0] for name in ("bottom", "north") for x in (s,)}
    for name, g in sides.items():
        mine, theirs = lit.patch_group == g, closed.patch_group == whole.groups.index(name)
        met = closed.rows.matrix()[:, wall].sum(axis=1)
        a = np.average(lit.lamp_factor[mine, 1], weights=factors.area[mine])
        assert a == pytest.approx(np.average(met[theirs], weights=closed.area[theirs]), rel=0.03)


def test_where_rays_leave(tmp_path):
    """The south is -y, low in y: seen from the middle of the room by its ends."""
    s, factors = open_room(tmp_path)
    around = outside.with_outside(factors, lambda: s).outside
    corners = s.corners.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, half = (low + high) / 2, (high - low) / 2
    aims = np.array([[0, -1, 0], [1, -1, 0], [0, -1, 1], [-0.5, -1, 0.25]]) * half
    rays = np.hstack([np.broadcast_to(middle, aims.shape), aims / np.linalg.norm(aims, axis=1, keepdims=True)])
    assert np.allclose(around.at(rays), aims / half, atol=0.02)
    assert abs(around.middle[0]) < 0.05 and around.middle[1] == pytest.approx(-1, abs=0.02)
    bright = outside.Glow(around, np.array([[2.0], [1.0], *[[0.0]] * 8]))
    assert bright.light(rays)[:, 0] == pytest.approx(2 + (aims / half)[:, 0] - around.middle[0], abs=0.02)
    assert (outside.Glow(around, np.array([[0.0], [1.0], *[[0.0]] * 8])).light(rays) >= 0).all()


def test_both_halves_of_the_rays_tell_of_the_openings(tmp_path):
    s, factors = open_room(tmp_path)
    lit = outside.with_outside(factors, lambda: s)
    one, other = outside.halves(lit, lit.lamp_factor, factors.rows)
    share, column = outside.openings(factors.rows) > 0, lit.outside.first
    assert np.allclose((one + other)[share, column], 0, atol=0.02) and 1e-4 < np.abs(one[share, column]).mean() < 0.02
    assert outside.halves(factors, factors.lamp_factor, factors.rows) == ()
    kept = gather.with_outside(lambda: None, open_room(tmp_path, without=None)[1])
    assert len(kept) == 1


def test_of_an_outside_counts_what_arrives_and_of_an_even_lamp_what_leaves(tmp_path):
    s, factors = open_room(tmp_path)
    lit = outside.with_outside(factors, lambda: s)
    assert factors.uneven == [] and lit.uneven == list(range(1, 11))


def test_what_comes_in_is_unsure_where_it_arrives_and_nowhere_else(tmp_path):
    """What no polynomial tells of: its mean over the tiles is taken off, and it is a share of what arrives."""
    s, factors = open_room(tmp_path)
    lit = outside.with_outside(factors, lambda: s)
    K = np.array([[30.0, 0, 19.5], [0, 30, 14.5], [0, 0, 1]])
    camera = look((2, 0.2, 1.2), (2, 3, 1.0), K, 40, 30)
    world = model.load(tmp_path / "model.obj")
    facet = index_buffer.reference(world, camera).facet
    shot = image.Photograph(np.full((30, 40, 1), 0.5), 8, False, 1)
    view = View(camera, world, shot, facet)
    found = gather.gathered(view, s, factors, facet >= 0, gather.Sampling(64, 256))
    lit, found = gather.with_outside(lambda: view, factors, found)
    column = lit.outside.first
    changes = glow.unsure(view, lit, found)
    assert len(changes)
    for dD, dD_tile in changes:
        assert (np.abs(dD[:, column]) <= 10 * glow.BEYOND * lit.lamp_factor[:, column] + 1e-6).all()
        assert dD_tile[:, column].any() and abs(dD_tile[:, column].sum()) < 1e-6
        assert not np.delete(dD, column, axis=1).any()
    told = facts.problem_of(lit, found, lamps={"lamp": [3.0]}, reference={}, transfer="linear")
    assert told.emittance[:, 0].tolist() == [3.0, *[0.0] * 10]  # dark, until it is taken for a cause


def test_a_file_without_a_glow_is_black_outside(tmp_path):
    (tmp_path / "m.json").write_text(json.dumps({"groups": {}}))
    assert not materials.read(tmp_path / "m.json").outside.any()


# ---- whole runs ----


@pytest.mark.scene
@pytest.mark.parametrize("name, least", [("office", 0.012), ("office-mirror", 0.02)])
@pytest.mark.slow
def test_a_wall_behind_the_camera_is_not_missed(tmp_path, name, least):
    """Its light is found, and the picture shows it in the mirror. Black outside, the reflectances were 10 to 50 % off.

    least : RMSE of the picture
    """

    def without_wall(folder):
        obj(folder, lambda line, thing: None if (thing, line) == ("walls", "f 4 6 5 1") else line)

    build, found, off = deviated(tmp_path, without_wall, name, until="render")
    assert found["status"] == "converged" and [c["cause"] for c in found["explained"]] == ["glow"]
    assert off < 6
    cause = found["explained"][0]
    light, sigma = np.array(cause["values"]["radiosity"]), np.array(cause["sigma"]["radiosity"])
    assert (light > 0.02).all() and (sigma > 0).all() and (sigma < light).all()
    assert json.loads((build / "rendered.json").read_text())["rmse"] < least
    truth = json.loads((tmp_path / "data" / name / "truth/materials.json").read_text())["groups"]
    for group in ("floor", "wall", "ceiling"):
        mine = np.array(found["groups"][group]["rho_d"])
        assert np.abs(mine / truth[group]["rho_d"] - 1).max() < 0.02


@pytest.mark.scene
def test_without_leave_the_missing_wall_is_named(tmp_path):
    def without_wall(folder):
        obj(folder, lambda line, thing: None if (thing, line) == ("walls", "f 4 6 5 1") else line)
        with open(folder / "scene.yaml", "a") as file:
            file.write("\nexplain: [curve, vignetting]\ngoals: [materials.json]\n")

    _, found, off = deviated(tmp_path, without_wall, "flat-grey")
    assert found["status"] in ("approximate", "does not fit") and off < 3
    assert "open_model" in [why["cause"] for why in found["why"]]
