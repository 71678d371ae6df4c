"""lib/light/glints.py: a lamp's light by way of a glossy plane to a place, against the integral over plane and lamp."""

import numpy as np
import pytest

from lib.light import chains, form_factors, glints, specular, ward
from lib.light import lamps as lamps_
from lib.light import ward_kernels as kernels
from lib.picture import ray_light, texels
from tests.helpers import rooms
from tests.helpers.small_scenes import closed_room, finish, midpoints, rectangle, side_of, surface

LAMP = rectangle((1, 1, 1.5), (0, 0.6, 0), (0.6, 0, 0))  # shines on the floor of a room of 4 x 3 x 2.5
SCREEN = rectangle((0.5, 1.25, 0.4), (0.5, 0, 0), (0, 0.8, 0))


def lit(alpha, *more, tangent=(1, 0, 0)):
    """(surface, light map of black walls, emitters, E) over a floor that is glossy alone."""
    s = surface([(n, q) for n, q in closed_room() if n != "lamp"] + [("lamp", LAMP), *more], ["lamp"])
    E, lamps, mesh = np.ones((1, 1)), lamps_.emitters(s, ["lamp"]), rooms.patches(s, 60)
    spec, one = finish(s, bottom=(*alpha, tangent)), np.ones((1, 1))
    ways = specular.SpecularLight(spec, chains.Chains(1), one, lamps, E, lamps, E, 0)
    nothing = np.zeros((len(mesh), 1)), np.ones(len(mesh)), np.zeros((len(s.normal), 1))
    return s, texels.light_map(s, mesh, lamps, E, *nothing, ways=ways, n_rays=0), lamps, E


def light(scene, p, side, n, places=16, seed=3):
    """(places,) irradiance at the place p metres, by n rays each, and half the difference of their halves."""
    s, shown, lamps, E = scene
    at, k = s.local.points(np.repeat([p], places, axis=0)), np.arange(places)
    total, half, _ = ray_light.gathered_light(
        s, shown, lamps, E, at, k, k + 1, np.full(places, side_of(s, side)), n, seed
    )
    return total[:, 0], half[:, 0]


def exact(p, normal, alpha, n_floor=700, n_lamp=5, around=1.3):
    """The irradiance by quadrature over lamp and floor: nothing stands on the way. alpha along x and along y"""
    total = 0.0
    for x in midpoints(LAMP, n_lamp)[0]:
        middle = p[:2] + (x - p)[:2] * p[2] / (p[2] + x[2])  # where the floor mirrors x
        corner = (middle[0] - around, middle[1] - around, 0)
        y, area = midpoints(rectangle(corner, (2 * around, 0, 0), (0, 2 * around, 0)), n_floor)
        to_x, to_p = x - y, p - y
        far, near = (np.linalg.norm(v, axis=1, keepdims=True) for v in (to_x, to_p))
        f = ward.values(kernels.BOUNDED, *alpha, to_x / far, to_p / near)
        way = (to_x / far)[:, 2] ** 2 * abs((to_p / near) @ normal) * (to_p / near)[:, 2] / (far * near)[:, 0] ** 2
        within = (y[:, :2] > 0).all(axis=1) & (y[:, 0] < 4) & (y[:, 1] < 3)
        total += (f * way * within).sum() * area * 0.36 / n_lamp**2 / np.pi
    return total


@pytest.mark.parametrize("alpha", [(0.02, 0.02), (0.05, 0.05), (0.2, 0.2), (0.2, 0.05)])
def test_a_floor_takes_a_lamp_to_the_ceiling(alpha):
    """The mean is the integral, and the spread is a few percent where gathering rays alone have 40 and more."""
    p = np.array([3.2, 2.2, 2.45])
    found, _ = light(lit(alpha), p, "top", 256, places=64)
    wanted = exact(p, np.array([0, 0, -1.0]), alpha)
    assert wanted > 1e-3 and found.mean() == pytest.approx(wanted, rel=0.01)
    assert found.std() < 0.06 * wanted


def test_the_same_light_whether_it_is_sought_or_met(monkeypatch):
    """With a screen that takes a part of it, before a wall near the floor: many gathering rays alone tell the same."""
    scene, p = lit((0.1, 0.1), ("screen", SCREEN)), np.array([0.0, 1.2, 0.7])
    sought, half = light(scene, p, "west", 512, places=64)
    free, _ = light(lit((0.1, 0.1)), p, "west", 512, places=64)
    monkeypatch.setattr(glints, "LARGE", 2.0)  # no plane is large enough
    met, _ = light(scene, p, "west", 1 << 14, places=64)
    error = np.hypot(met.std() / 8, sought.std() / 8)
    assert sought.mean() == pytest.approx(met.mean(), abs=4 * error) and error < 0.02 * met.mean()
    assert met.mean() < 0.9 * free.mean()
    assert sought.std() < 4 * met.std()  # from a 32nd of the rays
    assert np.sqrt((half**2).mean()) > 0.5 * sought.std()  # the noise is told


@pytest.mark.parametrize("alpha", [0.02, 0.1])
def test_the_fit_seeks_a_floors_light_as_well(alpha):
    """Rows of elements with few and with many rays: the mean is the integral, and the spread is told. By gathering rays
    alone 512 of them had half their light of alpha .03 as noise, and gamma went from 2.2 to 2.5 with it."""
    s, _, emitters, _ = lit((alpha, alpha))
    p, places = np.array([3.2, 2.2, 2.45]), 48
    spec, at = finish(s, bottom=alpha), s.local.points(np.repeat([p], places, axis=0))
    shot, side = np.repeat([64, 512], places // 2), np.full(places, side_of(s, "top"))
    normal = np.repeat([-s.normal[side[0] // 2] if side[0] % 2 else s.normal[side[0] // 2]], places, axis=0)
    mesh, start = rooms.patches(s, 60), np.arange(places + 1)
    ray_start, make = form_factors.from_points(s, at, start, side, shot)
    begin, of = specular.from_rays(s, mesh, make), specular.Places(start, at, normal)
    found = specular.rows(
        s, mesh, spec, chains.Chains(1), emitters, 1, ray_start, begin, places=of, spread=True, complete=0
    )
    D, apart = (sum(part.values())[:, 0] for part in (found.D, found.D_spread))
    wanted = exact(p, np.array([0, 0, -1.0]), (alpha, alpha))
    for some, rel, spread in ((shot == 64, 0.04, 0.15), (shot == 512, 0.01, 0.04)):
        assert D[some].mean() == pytest.approx(wanted, rel=rel) and D[some].std() < spread * wanted
        assert 0.4 < np.sqrt((apart[some] ** 2).mean()) / D[some].std() < 3


def test_patches_have_it_too(monkeypatch):
    """Their light by way of the floor, patch by patch, is that of thirty-two times the rays alone."""
    s, _, emitters, _ = lit((0.1, 0.1))
    mesh, spec = rooms.patches(s, 200), finish(s, bottom=0.1)
    ways = lambda n: specular.transport(s, mesh, spec, chains.Chains(1), emitters, 1, n_rays=n)
    D = sum(ways(512).D.values())[:, 0]
    monkeypatch.setattr(glints, "LARGE", 2.0)  # no plane is large enough
    met = sum(ways(1 << 14).D.values())[:, 0]
    assert met.max() > 1e-3 and np.sqrt(((D - met) ** 2).mean()) < 0.05 * met.max()
    assert D.sum() == pytest.approx(met.sum(), rel=0.015)
