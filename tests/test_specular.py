"""lib/light/specular.py, and what the inverse problem makes of it: light by way of mirrors and lobes.

By hand (a mirrored lamp, facing mirrors), by law (furnaces, energy, invariance), by difference (quadrature, finite
differences, brute force), at the edge (mirrors that see nothing, rooms of mirrors).
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from lib.analysis.fit import gauss_newton, transport
from lib.analysis.fit import mixture as mixture_
from lib.analysis.fit import problem as problem_
from lib.analysis.fit.equations import Equations, Layout, Unknowns
from lib.analysis.seen import receivers
from lib.given.rays_kernels import OFFSET
from lib.given.transfer import Transfer
from lib.light import (
    chains as chains_,
)
from lib.light import (
    form_factors,
    mirror_view,
    paths,
    specular,
    specular_lamps,
    ward,
)
from lib.light import (
    lamps as lamps_,
)
from lib.light import (
    surface as surfaces,
)
from lib.light import (
    ward_kernels as kernels,
)
from tests.helpers import rooms
from tests.helpers.small_scenes import (
    closed_room,
    elements,
    factor,
    finish,
    midpoints,
    rectangle,
    side_of,
    surface,
    views,
)
from tests.helpers.views import look

UP = np.array([0, 0, 1.0])


def mirrored(s, spec, lamps, p, side, n_samples=256, chains=None, **options):
    """Factors (R, emitters) of points p (R, 3) metres to the mirrored lamps."""
    chains = chains or chains_.Chains(len(spec))
    images, way, complete = specular_lamps.mirrored_lamps(s, spec, chains, lamps, **options)
    one = [replace(lamp, lamp=k) for k, lamp in enumerate(images)]
    p = s.local.points(np.atleast_2d(p))
    F = (
        lamps_.direct(
            s,
            one,
            p,
            surfaces.side_normals(s),
            np.broadcast_to(side, len(p)).astype(np.int32),
            len(one),
            n_samples=n_samples,
        )
        if one
        else np.zeros((len(p), 0))
    )
    return F, images, way, complete


# ---- a floor under a mirror, beside it a lamp that shines upwards ----

LAMP = rectangle((1.5, -0.5, 1), (1, 0, 0), (0, 1, 0))
IMAGE = rectangle((1.5, -0.5, 3), (1, 0, 0), (0, 1, 0))
FLOOR = np.array([[0, 0, 0], [0.7, -0.4, 0], [-2, 1.5, 0], [2.8, 2.8, 0]])


def under_a_mirror(half, *more):
    """The mirror is a square of 2 half beside 2 half, 2 above the floor."""
    return surface(
        [
            ("floor", rectangle((-3, -3, 0), (6, 0, 0), (0, 6, 0))),
            ("mirror", rectangle((-half, -half, 2), (0, 2 * half, 0), (2 * half, 0, 0))),
            ("lamp", LAMP),
            *more,
        ],
        ["lamp"],
    )


def through(p, corners, opening, n=400):
    """Form factor from p on the floor to a parallelogram as far as the square `opening` (z, half) shows it.

    By brute force.
    """
    q, area = midpoints(corners, n)
    v = q - p
    at = p + v * ((opening[0] - p[2]) / v[:, 2])[:, None]
    return ((abs(at[:, :2]) < opening[1]).all(axis=1) * v[:, 2] ** 2 / (np.pi * (v**2).sum(axis=1) ** 2)).sum() * area


def test_a_large_mirror_shows_the_whole_lamp():
    """The factor of the mirrored polygon, to rounding."""
    s = under_a_mirror(8)
    F, images, way, complete = mirrored(
        s, finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"]), FLOOR, side_of(s, "floor")
    )
    assert len(images) == 1 and complete and way.tolist() == [1]
    assert F[:, 0] == pytest.approx([factor(p, UP, IMAGE) for p in FLOOR], abs=1e-9)


def test_a_small_mirror_clips_it():
    s = under_a_mirror(1)
    p = np.array([[x, 0.1, 0] for x in (-1.5, -1, -0.6, -0.3, 0)])
    F, *_ = mirrored(
        s, finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"]), p, side_of(s, "floor"), n_samples=4096
    )
    exact = [through(q, IMAGE, (2, 1)) for q in p]
    assert F[:, 0] == pytest.approx(exact, abs=0.01 * max(exact)) and exact[-1] == F[-1, 0] == 0


@pytest.mark.parametrize(
    "screen", [rectangle((-3, -3, 0.5), (6, 0, 0), (0, 6, 0)), rectangle((1.3, -0.6, 1.1), (1.3, 0, 0), (0, 1.2, 0))]
)
def test_something_stands_on_the_way(screen):
    """Before the mirror, or behind it between mirror and lamp: nothing arrives, neither of the image nor by rays."""
    s = under_a_mirror(8, ("screen", screen))
    spec, lamps = finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"])
    F, *_ = mirrored(s, spec, lamps, FLOOR[:1], side_of(s, "floor"))
    rows, _ = elements(s, rooms.patches(s, 60), spec, lamps, FLOOR[:1], side_of(s, "floor"), 1 << 12, complete=0)
    assert F[0, 0] == 0 and sum(D.sum() for D in rows.D.values()) == 0


def test_both_sides_of_one_polygon():
    """A mirror that hangs down between two halves of a room, under a lamp that reaches into both.

    Each half sees its own part of the lamp mirrored.
    """
    s = surface(
        [
            ("floor", rectangle((-3, -3, 0), (6, 0, 0), (0, 6, 0))),
            ("mirror", rectangle((0, -6, 0.2), (0, 12, 0), (0, 0, 2.8))),
            ("lamp", rectangle((-0.5, -0.5, 3), (0, 1, 0), (2, 0, 0))),
        ],
        ["lamp"],
    )
    p = np.array([[1.0, 0.2, 0], [-1.0, 0.2, 0], [2.5, -1, 0], [-2.5, -1, 0]])
    F, images, *_ = mirrored(
        s, finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"]), p, side_of(s, "floor"), n_samples=4096
    )
    image = lambda q: (
        [(-x, y, 3) for x, y in ((0, -0.5), (1.5, -0.5), (1.5, 0.5), (0, 0.5))]
        if q[0] > 0
        else [(x, y, 3) for x, y in ((0, -0.5), (0.5, -0.5), (0.5, 0.5), (0, 0.5))]
    )
    # below the mirror's edge, 0.2 above the floor, nothing of the image is hidden from these places
    assert len(images) == 1 and F[:, 0] == pytest.approx([factor(q, UP, image(q)) for q in p], rel=0.01)


@pytest.mark.scene
@pytest.mark.parametrize("how, options", [("mirror", {"complete": 0}), (0.005, {})])
def test_rays_and_a_sharp_lobe_find_the_mirrored_lamp(how, options):
    """What is not left to images: rays that go on at the mirror, or a lobe as sharp as one.

    Within the sampling error of 2^17 rays.
    """
    s = under_a_mirror(8)
    rows, chains = elements(
        s,
        rooms.patches(s, 60),
        finish(s, mirror=how),
        lamps_.emitters(s, ["lamp"]),
        FLOOR[:2],
        side_of(s, "floor"),
        1 << 17,
        **options,
    )
    exact = np.array([factor(p, UP, IMAGE) for p in FLOOR[:2]])
    assert chains.count == [(0,), (1,)] and rows.D[1][:, 0] == pytest.approx(
        exact, rel=4 / np.sqrt(exact.min() * 2**17)
    )


def test_elements_one_by_one_are_the_elements_together(monkeypatch):
    """Rays are traced in chunks of elements; what each element gets is its own."""
    s = under_a_mirror(8)
    words = rooms.patches(s, 60), finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"]), FLOOR, side_of(s, "floor")
    together, _ = elements(s, *words, 1 << 10, complete=0)
    monkeypatch.setattr(specular, "chunks", lambda ray_start: ((k, k + 1) for k in range(len(ray_start) - 1)))
    alone, _ = elements(s, *words, 1 << 10, complete=0)
    assert len(FLOOR) > 1 and together.D[1].any()
    assert all(np.allclose(alone.D[k], D) for k, D in together.D.items())
    assert all(abs(alone.F[k] - F).sum() < 1e-6 for k, F in together.F.items())


def test_mirrors_of_many_facets_leave_their_lamps_to_the_rays():
    """A curved mirror would make an image in each of its facets."""
    s = under_a_mirror(
        8, *[("mirror", rectangle((9 + 0.1 * k, 0, 3), (0, 1, 0), (0.1, 0, 0.001 * k))) for k in range(70)]
    )
    spec = chains_.Finish((s.groups.index("mirror"),), np.array([chains_.MIRROR]), np.zeros((1, 2)), np.zeros((1, 3)))
    images, way, complete = specular_lamps.mirrored_lamps(s, spec, chains_.Chains(1), lamps_.emitters(s, ["lamp"]))
    assert images == [] and len(way) == 0 and not complete


# ---- facing mirrors ----


def facing(height=10.0, depth=2.0):
    """Two mirrors, x = 0 and x = 1, that face each other, and a floor below."""
    return surface(
        [
            ("left", rectangle((0, 0, 0), (0, depth, 0), (0, 0, height))),
            ("right", rectangle((1, 0, 0), (0, 0, height), (0, depth, 0))),
            ("floor", rectangle((0.05, 0, -0.1), (0.9, 0, 0), (0, depth, 0))),
        ]
    )


def test_rays_between_facing_mirrors():
    """A ray that climbs by z a crossing meets (height - start) / z mirrors in turn.

    Its light is the product of their rho_s.
    """
    s = facing()
    spec, chains = finish(s, left="mirror", right="mirror"), chains_.Chains(2)
    climbs = np.array([0.33, 0.41, 0.77, 1.3, 4.1, 9.0, 25.0])
    v = np.stack([np.ones(7), np.zeros(7), climbs], axis=1)
    start = np.column_stack([np.full(7, 0.5), np.full(7, 1.0), np.full(7, 0.1)])
    rays = np.hstack([s.local.points(start), v / np.linalg.norm(v, axis=1, keepdims=True)]).astype(np.float32)
    triangle, t = s.caster.closest(rays)
    number, chain = np.zeros(7, int), np.zeros(7, int)
    for met in paths.follow(s, spec, chains, paths.first_met(rays, triangle, t)):
        assert (
            np.isfinite(met.rays).all()
            and (met.weight == 1).all()
            and np.isinf(met.lobe).all()
            and not met.glossy.any()
        )
        number[met.source] += 1
        chain[met.source] = met.chain
    n = np.floor((10 - 0.1) / climbs + 0.5).astype(int)
    assert number.tolist() == n.tolist()
    assert chains.counts[chain].tolist() == [[k // 2, k - k // 2] for k in n]
    assert chains.power(np.array([[0.9], [0.5]]))[chain, 0] == pytest.approx(0.9 ** (n // 2) * 0.5 ** (n - n // 2))


def test_a_ray_for_ever_between_mirrors_ends():
    s = facing()
    rays = np.hstack([s.local.points([[0.5, 1, 5]]), [[1.0, 0, 0]]]).astype(np.float32)
    met = list(
        paths.follow(
            s,
            finish(s, left="mirror", right="mirror"),
            chains_.Chains(2),
            paths.first_met(rays, *s.caster.closest(rays)),
            depth=20,
        )
    )
    assert len(met) == 20 and met[-1].source.tolist() == [0]


@pytest.fixture(scope="module")
def corridor():
    """A closed room of 4 x 3 x 2.5 whose east and west walls are mirrors, and rows of two places on its floor."""
    s = surface(closed_room())
    mesh = rooms.patches(s, 80)
    p, side, n = np.array([[1.3, 1.1, 0], [0.4, 2.2, 0]]), side_of(s, "bottom"), 1 << 14
    spec = finish(s, west="mirror", east="mirror")
    rows, chains = elements(s, mesh, spec, NO_LAMP(s), p, side, n)
    first = form_factors.gather(
        s, mesh, s.local.points(p), np.arange(3), np.full(2, side), np.full(2, n), seed=3
    ).matrix()
    plain = ~np.isin(s.group[mesh.side // 2], spec.groups)
    return s, spec, p, rows, chains, first, plain


def NO_LAMP(s):
    """An emitter that shines upwards far above the room's ceiling."""
    corners = np.array([[[0, 0, 9.0], [1, 0, 9], [0, 1, 9]]])
    return [lamps_.Emitter(0, corners, np.array([[0, 0, 1.0]]), np.ones(1))]


def shown(rows, chains, first, columns, rho_s):
    """Sums over the chains of the rows' sums over some patches."""
    power = chains.power(np.array(rho_s, float)[:, None])[:, 0]
    return first[:, columns].sum(axis=1) + sum(power[k] * F[:, columns].sum(axis=1) for k, F in rows.F.items())


def test_furnace_of_facing_mirrors(corridor):
    """Every diffuse side has radiosity 1, and so has what arrives, but for what is in mirrors after DEPTH crossings.

    That would have to reach the mirrored wall at DEPTH rooms' distance, of factor A / (pi d^2) at most.
    """
    s, spec, p, rows, chains, first, plain = corridor
    d = 4.0 * (paths.DEPTH - 1)
    missing = 2 * 3.0 * 2.5 / (np.pi * d * d)
    total = shown(rows, chains, first, plain, [1, 1])
    assert ((total <= 1 + 1e-6) & (total >= 1 - missing - 4 / 2**14)).all()


@pytest.mark.parametrize("rho_s", [(0.8, 0.8), (0.9, 0.4), (0.0, 1.0)])
def test_series_of_facing_mirrors(corridor, rho_s):
    """By unfolding: the share of rays that meet k mirrors at least is the factor P_k of the wall mirrored k - 1 times.

    They go on with the product of the rho_s. Sum = 1 - P_1 + sum_k rho ... (P_k - P_k+1).
    """
    s, spec, p, rows, chains, first, plain = corridor
    exact = []
    for q in p:
        total = 1.0
        for start in (0, 1):  # towards west first, towards east first
            x = [4.0 * k + 4 if start else -4.0 * k for k in range(60)]
            P = np.array([factor(q, UP, [(a, 0, 0), (a, 3, 0), (a, 3, 2.5), (a, 0, 2.5)]) for a in x])
            product = np.cumprod([rho_s[(start + k) % 2] for k in range(59)])
            total += -P[0] + (product * (P[:-1] - P[1:])).sum()
        exact.append(total)
    assert shown(rows, chains, first, plain, rho_s) == pytest.approx(exact, abs=2e-3)


def test_images_in_facing_mirrors():
    """A lamp between them is there again to the depth, once for each crossing and way.

    Each image has the factor of its polygon through the mirror's frame.
    """
    s = surface(
        [
            ("left", rectangle((0, -5, 0), (0, 10, 0), (0, 0, 10))),
            ("right", rectangle((2, -5, 0), (0, 0, 10), (0, 10, 0))),
            ("floor", rectangle((0, -5, 0), (2, 0, 0), (0, 10, 0))),
            ("lamp", rectangle((0.6, -0.5, 3), (0, 1, 0), (0.6, 0, 0))),
        ],
        ["lamp"],
    )
    p = np.array([[1.5, 0.3, 0]])
    chains = chains_.Chains(2)
    F, images, way, complete = mirrored(
        s,
        finish(s, left="mirror", right="mirror"),
        lamps_.emitters(s, ["lamp"]),
        p,
        side_of(s, "floor"),
        chains=chains,
        depth=4,
    )
    assert complete and sorted(chains.counts[way].tolist()) == sorted(
        [[k // 2, k - k // 2] for k in range(1, 5)] + [[k - k // 2, k // 2] for k in range(1, 5)]
    )
    by_order = {}
    for k, image in zip(chains.counts[way].sum(axis=1), images, strict=True):
        x = (image.corners[..., 0] * s.local.diagonal + s.local.centre[0]).ravel()
        by_order.setdefault(int(k), []).append((round(x.min(), 6), round(x.max(), 6)))
    assert sorted(by_order[1]) == [(-1.2, -0.6), (2.8, 3.4)] and sorted(by_order[2]) == [(-3.4, -2.8), (4.6, 5.2)]
    for f, image in zip(F[0], images, strict=True):
        x = image.corners[..., 0] * s.local.diagonal + s.local.centre[0]
        exact = factor(p[0], UP, [(x.min(), -0.5, 3), (x.min(), 0.5, 3), (x.max(), 0.5, 3), (x.max(), -0.5, 3)])
        assert f == pytest.approx(exact, rel=1e-6)


# ---- mirrors at the edge ----


def test_a_mirror_that_sees_nothing():
    """It looks away from all there is: no image, no light, and what shows it shows nothing."""
    s = surface(
        [
            ("floor", rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0))),
            ("mirror", rectangle((-1, 0, 1), (0, 1, 0), (0.3, 0, 3))),
            ("lamp", rectangle((3, 0, 1), (0, 1, 0), (1, 0, 0))),
        ],
        ["lamp"],
    )
    spec, lamps = finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"])
    p = np.array([[0.5, 0.5, 0]])
    rows, _ = elements(s, rooms.patches(s, 30), spec, lamps, p, side_of(s, "floor"), 4096, complete=0)
    assert sum(F.sum() for F in rows.F.values()) == 0 and sum(D.sum() for D in rows.D.values()) == 0
    F, *_ = mirrored(s, spec, lamps, p, side_of(s, "floor"))
    assert (F == 0).all()
    above = p + [0, 0, 0.01]
    there = np.array([[-0.85, 0.5, 2.5]]) - above
    view = mirror_view.through_mirrors(
        s, spec, chains_.Chains(1), np.hstack([s.local.points(above), there / np.linalg.norm(there)]).astype(np.float32)
    )
    assert view.facet.tolist() == [-1] and np.isfinite(view.p).all()


def test_a_mirror_that_sees_only_itself():
    """A box of mirrors, lit by nothing: rays go round in it until the count runs out, and find nothing."""
    s = surface([("mirror", corners) for _, corners in closed_room(1, 1, 1)])
    spec, chains = (
        chains_.Finish((0,), np.array([chains_.MIRROR]), np.zeros((1, 2)), np.zeros((1, 3))),
        chains_.Chains(1),
    )
    v = np.random.default_rng(0).normal(size=(200, 3))
    rays = np.hstack(
        [np.tile(s.local.points([0.4, 0.5, 0.6]), (200, 1)), v / np.linalg.norm(v, axis=1, keepdims=True)]
    ).astype(np.float32)
    met = list(paths.follow(s, spec, chains, paths.first_met(rays, *s.caster.closest(rays))))
    assert len(met) == paths.DEPTH and len(chains) == paths.DEPTH + 1
    assert len(met[-1]) >= 198  # a ray may slip through an edge, where float32 ends
    view = mirror_view.through_mirrors(s, spec, chains_.Chains(1), rays)
    assert (view.facet == -1).all() and np.isfinite(view.p).all()


@pytest.mark.parametrize(
    "walls", [("west", "east", "south", "north"), ("bottom", "top", "west", "east", "south", "north")]
)
def test_a_room_of_mirrors_ends(walls):
    """Every wall is a mirror of its own group: the chains are many, yet not more than the rays' pieces.

    None is lost on a table between the walls: what arrives is 1 at most.
    """
    s = surface(closed_room() + [("table", rectangle((1, 1, 0.7), (1, 0, 0), (0, 1, 0)))])
    mesh, spec = rooms.patches(s, 60), finish(s, **dict.fromkeys(walls, "mirror"))
    rows, chains = elements(s, mesh, spec, NO_LAMP(s), [[1.4, 1.6, 0.7]], side_of(s, "table"), 512)
    assert len(chains) <= 512 * paths.DEPTH + 1 and chains.counts.sum(axis=1).max() <= paths.DEPTH
    plain = ~np.isin(s.group[mesh.side // 2], spec.groups)
    assert sum(F[:, plain].sum() for F in rows.F.values()) <= 1 + 1e-6


FOUR_WALLS = (("west", "east", "south", "north"), 0.02)


@pytest.mark.parametrize(
    "walls, within",
    [
        (("west",), 0.004),
        (("west", "east"), 0.01),
        (("west", "south"), 0.004),
        (("west", "south", "east"), 0.01),
        FOUR_WALLS,
    ],
)
def test_all_light_of_a_lamp_ends_somewhere(walls, within):
    """In a closed room with perfect mirrors every lumen of the lamp ends on a diffuse side.

    So the sum of area times factor is the lamp's area.
    """
    s = surface(closed_room() + [("lamp", rectangle((1.5, 1, 2.4), (0, 1, 0), (1, 0, 0)))], ["lamp"])
    lamps, mesh, spec = lamps_.emitters(s, ["lamp"]), rooms.patches(s, 60), finish(s, **dict.fromkeys(walls, "mirror"))
    ways = specular.transport(
        s, mesh, spec, chains_.Chains(len(walls)), lamps, 1, n_rays=64 if len(walls) < 4 else 1024
    )
    factors = lamps_.patch_direct(s, mesh, lamps, 1, n_points=64) + sum(ways.D.values())
    plain = ~np.isin(s.group[mesh.side // 2], spec.groups)
    assert (mesh.area * factors[:, 0])[plain].sum() == pytest.approx(specular_lamps.lamp_areas(lamps)[0], rel=within)


def test_what_is_still_on_its_way_is_counted():
    """Six mirrors and a small table: most rays find nothing else."""
    s = surface(closed_room() + [("table", rectangle((1, 1, 0.7), (0.1, 0, 0), (0, 0.1, 0)))])
    spec = finish(s, **dict.fromkeys(("bottom", "top", "west", "east", "south", "north"), "mirror"))
    rows, _ = elements(s, rooms.patches(s, 30), spec, NO_LAMP(s), [[1.04, 1.06, 0.7]], side_of(s, "table"), 256)
    assert rows.lost > 0.5


def test_no_lamps_at_all(corridor):
    """Light of the patches alone."""
    s, spec, p, rows, chains, *_ = corridor
    again, _ = elements(s, rooms.patches(s, 80), spec, [], p, side_of(s, "bottom"), 256)
    assert again.D == {} and len(again.F) > 2


# ---- gloss ----


@pytest.fixture(scope="module")
def hall():
    s = surface(closed_room())
    return s, rooms.patches(s, 80)


@pytest.mark.parametrize("alpha", [0.01, 0.1, 0.6])
def test_furnace_with_a_glossy_wall(hall, alpha):
    """Every side has radiosity 1: a lobe shows its albedo, at every angle.

    The mean of n samples of weights up to 2 is that close.
    """
    s, mesh = hall
    angles, n = np.radians([0, 30, 60, 75, 85]), 4096
    wall = side_of(s, "west") // 2
    v = -np.stack([np.cos(angles), np.sin(angles), np.zeros(5)], axis=1)
    rows, chains = views(s, mesh, finish(s, west=alpha), NO_LAMP(s), np.repeat([[0, 1.5, 1.2]], 5, axis=0), wall, v, n)
    assert chains.count == [(0,), (1,)]
    assert np.asarray(rows.F[1].sum(axis=1)).ravel() == pytest.approx(
        ward.albedo(kernels.BOUNDED, alpha, alpha, angles), abs=4 * 0.5 / n**0.75
    )


def test_furnace_with_a_brushed_wall(hall):
    """alpha_x along the tangent: turned by a right angle, the albedos of the two directions change places."""
    s, mesh = hall
    tilt = np.radians(70)
    along, across = -np.array([[np.cos(tilt), np.sin(tilt), 0], [np.cos(tilt), 0, np.sin(tilt)]])
    long = ward.albedo(kernels.BOUNDED, 0.5, 0.05, tilt, np.array([0, np.pi / 2]))
    for tangent, exact in (((0, 1, 0), long), ((0, 0, 1), long[::-1])):
        rows, _ = views(
            s,
            mesh,
            finish(s, west=(0.5, 0.05, tangent)),
            NO_LAMP(s),
            np.repeat([[0, 1.5, 1.2]], 2, axis=0),
            side_of(s, "west") // 2,
            np.stack([along, across]),
            4096,
        )
        assert np.asarray(rows.F[1].sum(axis=1)).ravel() == pytest.approx(exact, abs=4e-3)
    assert abs(long[0] - long[1]) > 0.05


@pytest.mark.parametrize("alpha", [0.05, 0.3])
def test_the_sampling_error_of_specular_ways_is_known(alpha):
    """A ceiling above a glossy floor and a lamp, 400 tiles at one place that differ in their rays alone; four places.

    The spread of two sets of rays is that of the tiles, and asking for it changes the light by no more than rounding.
    The tiles of a place share one sequence: at single places their mean is off by up to 5 of its standard errors, and
    the spread by .4.
    """
    s = surface(
        [(n, q) for n, q in closed_room() if n != "lamp"]
        + [("lamp", rectangle((1, 1, 1.5), (0, 0.6, 0), (0.6, 0, 0)))],
        ["lamp"],
    )
    mesh, spec, lamps = rooms.patches(s, 60), finish(s, bottom=alpha), lamps_.emitters(s, ["lamp"])
    off = []
    for place in ((1.6, 1.2, 2.4), (1.3, 1.4, 2.4), (1.9, 0.9, 2.4), (1.5, 1.7, 2.4)):
        how = s, mesh, spec, lamps, np.repeat([place], 400, axis=0), side_of(s, "top"), 256
        (rows, _), (plain, _) = elements(*how, spread=True), elements(*how)
        b = np.linspace(0.2, 1, len(mesh))
        for one, other, apart in (
            (rows.F[1] @ b, plain.F[1] @ b, rows.F_spread[1] @ b),
            (rows.D[1][:, 0], plain.D[1][:, 0], rows.D_spread[1][:, 0]),
        ):
            assert one == pytest.approx(other, rel=1e-5) and one.mean() > 0
            off.append((apart.mean() / (one.std() / 20), np.sqrt((apart**2).mean()) / one.std()))
        assert not plain.F_spread and not plain.D_spread
    bias, spread = np.moveaxis(np.reshape(off, (4, 2, 2)).mean(axis=0), -1, 0)
    assert np.abs(bias).max() < 4 and spread == pytest.approx([1, 1], abs=0.3)


OVER = rectangle((0.5, -0.3, 1.5), (0, 0.6, 0), (0.6, 0, 0))  # a lamp over a glossy floor


def lit_floor(*more):
    return surface([("floor", rectangle((-4, -4, 0), (8, 0, 0), (0, 8, 0))), ("lamp", OVER), *more], ["lamp"])


def seen_from(angle, beside):
    """The place on the floor that mirrors the lamp's middle at this angle, moved aside, and the view's direction."""
    v = np.array([np.sin(angle), 0, -np.cos(angle)])
    return np.array([0.8 - 1.5 * np.tan(angle) + beside, 0, 0]), v


def quadrature(p, v, corners, alpha, n=600):
    """The lamp in the lobe, per rho_s and emittance: f cos over its solid angle."""
    q, area = midpoints(corners, n)
    w = q - p
    r2 = (w**2).sum(axis=1)
    w /= np.sqrt(r2)[:, None]
    return float((ward.values(kernels.BOUNDED, alpha, alpha, w, -v) * w[:, 2] * abs(w[:, 2]) / r2).sum() * area)


@pytest.mark.parametrize("alpha", [0.01, 0.03, 0.1, 0.3, 0.6])
@pytest.mark.parametrize("angle, beside", [(20, 0), (60, 0), (60, 0.35)])
def test_a_lamp_in_a_lobe(alpha, angle, beside):
    """Rays to the lamp and rays of the lobe together (balance heuristic) are the integral of f cos over the lamp.

    Their noise is within the heuristic's bound: variance of the better way alone + mean^2 / 2 n (Veach, theorem 9.2).
    It is 7 % at most, where one way alone has up to 110 %, and the other 45 %.
    """
    s, n, places = lit_floor(), 64, 64
    lamps, spec = lamps_.emitters(s, ["lamp"]), finish(s, floor=alpha)
    p, v = seen_from(np.radians(angle), beside)
    rows, _ = views(
        s, rooms.patches(s, 20), spec, lamps, np.repeat([p], places, axis=0), side_of(s, "floor") // 2, v, n
    )
    both, exact = rows.D[1][:, 0], quadrature(p, v, OVER, alpha)
    by_lobe, by_lamp = one_way(s, spec, lamps, p, v, n, places, alpha)
    assert by_lobe.mean() == pytest.approx(exact, abs=4 * by_lobe.std() / np.sqrt(places) + 1e-3 * exact)
    assert both.mean() == pytest.approx(exact, rel=0.01)
    assert both.std() <= np.sqrt(min(by_lobe.std(), by_lamp.std()) ** 2 + exact**2 / (2 * n))
    assert both.std() < 0.07 * exact


def one_way(s, spec, lamps, p, v, n, places, alpha):
    """(places,) the lamp's light by rays of the lobe alone, and by as many rays to the lamp alone."""
    start, facet = np.arange(places + 1), side_of(s, "floor") // 2
    begin = specular.from_views(
        s,
        start * n,
        start,
        s.local.points(np.repeat([p], places, axis=0)),
        np.full(places, facet),
        np.broadcast_to(v, (places, 3)),
        np.zeros(places, int),
    )
    i = np.arange(places * n)
    by_lobe = np.zeros(places * n)
    chains = chains_.Chains(1)
    for end in paths.follow(s, spec, chains, begin(0, places)[0]):
        which, share = specular_lamps.lamp_found(
            s, lamps, replace(end, lobe=np.full(len(end), np.inf)), chains, paths.DEPTH
        )
        by_lobe[end.source[which >= 0]] += share[which >= 0]
    a, b = (0.5 + 0.7548776662466927 * i) % 1, (0.5 + 0.5698402909980532 * i) % 1
    w = np.array(OVER[0]) + a[:, None] * (OVER[1] - OVER[0]) + b[:, None] * (OVER[3] - OVER[0]) - p
    r2 = (w**2).sum(axis=1)
    w /= np.sqrt(r2)[:, None]
    by_lamp = ward.values(kernels.BOUNDED, alpha, alpha, w, -v) * w[:, 2] * w[:, 2] / r2 * 0.36
    return [np.bincount(i // n, values, places) / n for values in (by_lobe, by_lamp)]


def test_a_lobe_finds_the_lamp_in_a_mirror():
    """A glossy floor under a large mirror, the lamp's front away from it.

    What is seen is the lobe of the mirrored lamp, times the mirror's rho_s.
    """
    s = surface(
        [
            ("floor", rectangle((-4, -4, 0), (8, 0, 0), (0, 8, 0))),
            ("mirror", rectangle((-8, -8, 1.5), (0, 16, 0), (16, 0, 0))),
            ("lamp", rectangle((0.5, -0.3, 1), (0.6, 0, 0), (0, 0.6, 0))),
        ],
        ["lamp"],
    )
    p, v = np.array([-1.5, 0, 0]), np.array([np.sin(0.8), 0, -np.cos(0.8)])
    for alpha in (0.05, 0.2):
        spec = finish(s, floor=alpha, mirror="mirror")
        rows, chains = views(
            s,
            rooms.patches(s, 20),
            spec,
            lamps_.emitters(s, ["lamp"]),
            np.repeat([p], 16, axis=0),
            side_of(s, "floor") // 2,
            v,
            4096,
        )
        k = chains.count.index((1, 1))
        exact = quadrature(p, v, rectangle((0.5, -0.3, 2), (0.6, 0, 0), (0, 0.6, 0)), alpha)
        assert (
            rows.D[k][:, 0].mean() == pytest.approx(exact, rel=0.02) and rows.D.get(1, np.zeros(1)).sum() == 0
        )  # never at once


def test_the_ceiling_of_a_cube_is_a_lamp_and_its_walls_are_not():
    """Where a room is as high as wide, the middles of other walls' triangles are made of the same numbers."""
    s = surface(closed_room(1, 1, 1), ["top"])
    (lamp,) = lamps_.emitters(s, ["top"])
    assert [s.groups[s.group[f]] for f in lamp.facets] == ["top"]


# ---- chains and their sums ----


def test_chains_count_and_join():
    chains = chains_.Chains(3)
    k = chains.then(np.zeros(4, int), np.array([0, 2, 2, 1]))
    k = chains.then(k, np.array([0, 2, 0, 0]))
    assert chains.counts[k].tolist() == [[2, 0, 0], [0, 0, 2], [1, 0, 1], [1, 1, 0]]
    assert chains.joined(k[0], k[1]) == chains.number((2, 0, 2)) and chains.joined(0, k[3]) == k[3]
    assert chains.then(np.array([k[3]]), np.array([2])) == chains.number((1, 1, 1))  # in whatever order they are met
    assert chains.count[0] == (0, 0, 0) and len(set(chains.count)) == len(chains)


@pytest.mark.parametrize("rho_s", [[[0.3, 0.9], [1.0, 0.5]], [[0.0, 1.0], [0.7, 0.0]]])
def test_powers_of_chains(rho_s):
    """By hand, and derivatives by central differences, at 0 and 1 too."""
    chains = chains_.Chains(2)
    for count in ((1, 0), (0, 1), (2, 1), (0, 3), (4, 4)):
        chains.number(count)
    rho_s = np.array(rho_s)
    power = chains.power(rho_s)
    assert power[0].tolist() == [1, 1] and power[3] == pytest.approx(rho_s[0] ** 2 * rho_s[1])
    h = 1e-6
    for m in (0, 1):
        d = np.zeros((2, 2))
        d[m] = h
        assert chains.slope(rho_s, m) == pytest.approx(
            (chains.power(rho_s + d) - chains.power(rho_s - d)) / (2 * h), abs=1e-8
        )


def sparse(rng, rows, columns, share=0.3, sort=True):
    """float32 CSR, its entries in any order within a row unless sorted, as products of SciPy leave them."""
    A = csr_array((rng.random((rows, columns)) * (rng.random((rows, columns)) < share)).astype(np.float32))
    if not sort:
        for i in range(rows):
            a, b = A.indptr[i], A.indptr[i + 1]
            order = rng.permutation(b - a)
            A.indices[a:b], A.data[a:b] = A.indices[a:b][order], A.data[a:b][order]
        A.has_sorted_indices = False
    return A


@pytest.mark.parametrize("with_base", [True, False])
@pytest.mark.parametrize("sort", [True, False])
def test_a_mixture_is_the_plain_sum_and_leaves_its_parts_alone(with_base, sort):
    """Parts that share their index arrays, or have them unsorted.

    A fixed bug sorted shared indices in place, away from their values.
    """
    rng = np.random.default_rng(1)
    base = sparse(rng, 7, 9, sort=sort)
    one = sparse(rng, 7, 9, sort=sort)
    parts = {
        1: one,
        3: csr_array((one.data * 2, one.indices, one.indptr), shape=one.shape),
        4: sparse(rng, 7, 9, 0.1, sort=sort),
    }
    before = {
        k: (A.toarray(), A.indices.copy(), A.data.copy(), A.indptr.copy()) for k, A in (*parts.items(), (0, base))
    }
    mixture = mixture_.Mixture(base if with_base else None, parts)
    for power in (np.array([1, 0.5, 0, 0.25, 2]), np.zeros(5), np.ones(5)):
        mixed = mixture.at(power)
        plain = (base.toarray() if with_base else 0) + sum(power[k] * before[k][0] for k in parts)
        assert mixed.toarray() == pytest.approx(plain, rel=1e-6, abs=1e-7)
    for k, A in (*parts.items(), (0, base)):
        dense, *arrays = before[k]
        assert all(np.array_equal(x, y) for x, y in zip(arrays, (A.indices, A.data, A.indptr), strict=True))
        assert np.array_equal(dense, A.toarray())


def test_a_mixture_of_nothing():
    assert isinstance(mixture_.Mixture(None, {}).at(np.ones(1)), int)
    A = np.arange(6.0).reshape(2, 3)
    assert mixture_.Mixture(A, {}).at(np.ones(1)) is A or np.array_equal(mixture_.Mixture(A, {}).at(np.ones(1)), A)
    assert mixture_.Mixture(None, {2: A}).at(np.array([0, 0, 0.5])) == pytest.approx(A / 2)


# ---- the inverse problem ----


def problem(C=3, seed=0, tiles=40, doubts=()):
    """Six patches, a lamp, a mirror (group 5) and a glossy group (4) with random ways.

    Not a scene, but all of the equations.
    """
    rng = np.random.default_rng(seed)
    N, T = 12, 5 * tiles
    patch_group = np.arange(N) // 2
    chains = chains_.Chains(2)
    ways = [chains.number(c) for c in ((1, 0), (0, 1), (1, 1), (2, 0))]
    some = lambda rows, scale: {k: csr_array(sparse(rng, rows, N).toarray() * np.float32(scale)) for k in ways}
    light = lambda rows, scale: {k: scale * rng.random((rows, 1)) for k in ways[:2]}
    lobe = np.zeros(T, bool)
    lobe[-tiles:] = True
    only = lambda parts: {
        k: csr_array(A.toarray() * lobe[:, None]) if hasattr(A, "toarray") else A * lobe[:, None]
        for k, A in parts.items()
    }
    tile_group = np.repeat([0, 1, 2, 3, 4], tiles)
    tile_chain = np.where((np.arange(T) % 3 == 0) & ~lobe, ways[1], 0).astype(np.int32)
    shapes = [
        problem_.ShapeStep(0, "alpha_x", only(some(T, 0.02)), only(light(T, 0.02))),
        problem_.ShapeStep(0, "turn", only(some(T, 0.02)), {}),
    ]
    spec = problem_.SpecularTerms(
        (4, 5),
        chains,
        some(N, 0.05),
        light(N, 0.05),
        some(T, 0.05),
        light(T, 0.05),
        tile_chain,
        only(some(T, 0.05)),
        only(light(T, 0.3)),
        np.full((2, C), np.nan),
        shapes,
    )
    rho = np.full((7, C), np.nan)
    rho[6], rho[5] = 0, 0
    return problem_.Problem(
        F=csr_array(sparse(rng, N, N).toarray() * np.float32(0.2)),
        D=0.2 * rng.random((N, 1)),
        patch_group=patch_group,
        area=np.ones(N),
        G=csr_array(sparse(rng, T, N).toarray() * np.float32(0.2)),
        G_plain=csr_array(sparse(rng, T, N).toarray() * np.float32(0.2)),
        D_tile=0.1 + 0.2 * rng.random((T, 1)),
        tile_group=tile_group,
        tile_object=np.zeros(T, int),
        start=np.arange(T + 1) * 4,
        pixels=np.full((4 * T, C), 0.5),
        groups=("a", "b", "c", "d", "gloss", "mirror", "lamp"),
        lamps=("lamp",),
        emittance=np.full((1, C), np.nan),
        rho=rho,
        transfer=Transfer("gamma", 2.2),
        fit_transfer=True,
        group_area=np.ones(7),
        specular=spec,
    )


def linearised(p, rho_s, bend):
    rng = np.random.default_rng(5)
    C = p.channels
    rho = np.where(np.isnan(p.rho), 0.2 + 0.6 * rng.random((7, C)), p.rho)
    layout = Layout.of(p)
    at = Unknowns(
        rho, 1.3 + 0.2 * rng.random((1, C)), Transfer("gamma", 2.1), np.array(rho_s, float), np.array(bend, float)
    )
    return Equations(p, transport.TileLight(p), layout, at), layout


def check_derivatives(at, layout, p):
    theta, J = layout.pack(at.state), at.jacobian
    assert layout.size == len(theta) == J.shape[1]
    for step in (1e-2, 1e-3):
        for k in range(layout.size):
            d = np.zeros(layout.size)
            d[k] = step * max(abs(theta[k]), 0.1)
            there, back = (
                Equations(
                    p, transport.TileLight(p), layout, layout.unpack(theta + sign * d, at.state)
                ).residual.reshape(-1)
                for sign in (1, -1)
            )
            slope = (there - back) / (2 * d[k])
            # the block solve stops at 3e-3, single precision carries 1e-6 / step, central differences err by step^2
            assert np.abs(J[:, k] - slope).max() <= (4e-3 + 2 * step**2 * 10) * np.abs(slope).max() + 5e-6 / d[k], (
                step,
                k,
            )


@pytest.mark.parametrize(
    "C, rho_s", [(1, [[0.4], [0.8]]), (3, [[0.4, 0.3, 0.2], [0.9, 0.8, 0.7]]), (3, [[0.4, 0.4, 0.4], [0.8, 0.8, 0.8]])]
)
def test_derivatives_of_the_whole_specular_problem(C, rho_s):
    """rho_d, E, rho_s, shapes of lobes and gamma against central differences.

    One matrix serves all channels where rho_s is grey.
    """
    p = problem(C)
    at, layout = linearised(p, rho_s, np.zeros(2))
    assert len(layout.rho_s) == 2 * C and len(layout.bend) == 2 and layout.transfer == 1
    check_derivatives(at, layout, p)


def test_derivatives_where_lobes_are_bent():
    p = problem(1)
    check_derivatives(*linearised(p, [[0.4], [0.8]], [0.3, -0.3]), p)


def test_no_specular_light_is_the_diffuse_problem():
    """rho_s = 0: chains bring nothing.

    The picture is that of the diffuse problem, but for what mirrors show, which is black.
    """
    p = problem(1)
    at, _ = linearised(p, [[0.0], [0.0]], np.zeros(2))
    plain = replace(p, specular=None)
    diffuse = transport.TileLight(plain).render(at.state.rho, at.state.E, 2.1)
    at_once = p.specular.tile_chain == 0
    assert at.state.B[at_once] == pytest.approx(diffuse.B[at_once], rel=1e-4) and (at.state.B[~at_once] == 0).all()


def test_the_right_answer_is_found_again():
    """A photograph of the problem's own light: all parameters together, from a start that is off by a fifth."""
    p = problem(3, tiles=60)
    true = [[0.4, 0.3, 0.2], [0.9, 0.8, 0.7]]
    at, layout = linearised(p, true, np.zeros(2))
    shade = np.clip(at.state.B, 1e-6, 1)
    assert at.state.B.max() < 1
    p = replace(
        p,
        pixels=np.repeat(shade ** (1 / 2.1), 4, axis=0),
        rho=np.where(np.arange(7)[:, None] == 0, at.state.rho, p.rho),
    )
    rho = np.where(np.isnan(p.rho), at.state.rho * 0.8, p.rho)
    start = Unknowns(rho, at.state.E * 1.2, Transfer("gamma", 2.3), np.array(true) * 0.8)
    result = gauss_newton.gauss_newton(p, start=start, max_iterations=60)
    assert result.converged and np.abs(result.state.bend).max() < 2e-3
    assert result.state.rho_s == pytest.approx(np.array(true), abs=2e-3) and result.state.gamma == pytest.approx(
        2.1, abs=2e-3
    )
    seen = np.arange(5)
    assert result.state.rho[seen] == pytest.approx(at.state.rho[seen], abs=2e-3)


# ---- invariances ----


@pytest.mark.parametrize("placed", [dict(offset=(1e6, -1e6, 1e6)), dict(scale=1e-3), dict(scale=1e4)])
def test_same_light_in_millimetres_and_far_away(placed):
    """Chains, factors and images do not depend on where the room stands and how large it is."""
    polygons = closed_room() + [
        ("lamp", rectangle((1.5, 1, 2.4), (0, 1, 0), (1, 0, 0))),
        ("desk", rectangle((0.6, 0.4, 0.7), (1, 0, 0), (0, 1, 0))),
    ]
    kinds = dict(west="mirror", south="mirror", desk=(0.3, 0.1, (1, 0, 0)))
    found = []
    for here in ({}, placed):
        s = surface(polygons, ["lamp"], **here)
        spec, lamps, m = finish(s, **kinds), lamps_.emitters(s, ["lamp"]), rooms.patches(s, 60)
        chains = chains_.Chains(3)
        p = np.array([[3.1, 2.2, 0], [2.0, 0.7, 0]]) * here.get("scale", 1) + here.get("offset", 0)
        F, images, way, _ = mirrored(s, spec, lamps, p, side_of(s, "bottom"), chains=chains)
        rows, _ = elements(s, m, spec, lamps, p, side_of(s, "bottom"), 4096, chains=chains)
        found.append((len(m), F, way, chains.count, rows))
    (n0, F0, way0, count0, rows0), (n1, F1, way1, count1, rows1) = found
    assert n0 == n1 and way0.tolist() == way1.tolist() and count0 == count1 and rows0.F.keys() == rows1.F.keys()
    assert pytest.approx(F0, abs=2e-4) == F1
    assert sum(abs((rows0.F[k] - rows1.F[k]).toarray()).sum() for k in rows0.F) < 0.01
    assert all(rows1.D[k] == pytest.approx(rows0.D[k], abs=5e-4) for k in rows0.D)


# ---- what a mirror shows ----


def brute(polygons, eye, v, mirrors, depth=64):
    """The first polygon that is no mirror on each ray's way, and how often each mirror was met.

    In double precision, polygon by polygon.
    """
    n = len(v)
    p, v = np.tile(eye, (n, 1)), v.copy()
    end, count, places = np.full(n, -1), np.zeros((n, len(mirrors)), int), np.zeros((n, 3))
    live = np.arange(n)
    for _ in range(depth + 1):
        t, hit, normals = np.full(len(live), np.inf), np.full(len(live), -1), []
        for f, (_, corners) in enumerate(polygons):
            o, a, b = corners[0], corners[1] - corners[0], corners[3] - corners[0]
            normals.append(np.cross(a, b) / np.linalg.norm(np.cross(a, b)))
            with np.errstate(divide="ignore", invalid="ignore"):
                s = ((o - p[live]) @ normals[-1]) / (v[live] @ normals[-1])
                q = p[live] + s[:, None] * v[live] - o
                inside = (s > 1e-9) & (q @ a >= 0) & (q @ a <= a @ a) & (q @ b >= 0) & (q @ b <= b @ b) & (s < t)
            t[inside], hit[inside] = s[inside], f
        live, t, hit = live[hit >= 0], t[hit >= 0], hit[hit >= 0]
        p[live] += t[:, None] * v[live]
        of = np.array([mirrors.index(polygons[f][0]) if polygons[f][0] in mirrors else -1 for f in hit], int)
        end[live[of < 0]], places[live[of < 0]] = hit[of < 0], p[live[of < 0]]
        live, of, normal = live[of >= 0], of[of >= 0], np.array(normals)[hit[of >= 0]]
        count[live, of] += 1
        v[live] -= 2 * (v[live] * normal).sum(axis=1, keepdims=True) * normal
    return end, count, places


@pytest.mark.parametrize(
    "mirrors, missing",
    [
        (("west",), ()),
        (("west", "south"), ()),
        (("west", "east"), ("north",)),
        (("west", "east", "top"), ("north", "bottom")),
    ],
)
def test_the_virtual_index_buffer(mirrors, missing):
    """What each pixel shows in mirrors is the reflected camera's view, but for rays within float32 of an edge.

    One mirror, a mirror in a mirror, facing ones; closed rooms and open ones. Nothing there: -1; never a NaN.
    """
    polygons = [(g, [np.array(x, float) for x in c]) for g, c in closed_room() if g not in missing] + [
        ("desk", rectangle((0.6, 0.4, 0.7), (1, 0, 0), (0, 1, 0)))
    ]
    s = surface(polygons)
    spec, chains = finish(s, **dict.fromkeys(mirrors, "mirror"), desk=0.2), chains_.Chains(len(mirrors) + 1)
    camera = look((2.2, 2.3, 1.6), (0.3, 0.9, 1.1), size=(64, 48), focal=30.0)
    v = camera.rays(camera.pixels().reshape(-1, 2))
    rays = np.hstack([np.broadcast_to(s.local.points(camera.centre), v.shape), v]).astype(np.float32)
    view = mirror_view.through_mirrors(s, spec, chains, rays)
    end, count, places = brute(polygons, camera.centre, v, mirrors)
    assert np.isfinite(view.p).all() and np.isfinite(view.direction).all()
    same = (view.facet == end) & ((end < 0) | (chains.counts[view.chain][:, : len(mirrors)] == count).all(axis=1))
    assert same.mean() > 0.995 and (chains.counts[view.chain][:, -1] == 0).all()
    there = same & (end >= 0)
    apart = np.linalg.norm(view.p[there] - s.local.points(places[there]), axis=1)
    assert (apart < 10 * OFFSET * (1 + count[there].sum(axis=1))).all()  # each mirror lifts the ray's start by OFFSET
    assert np.linalg.norm(view.direction, axis=1) == pytest.approx(1, abs=1e-5)
    inward = (view.direction[there] * s.normal[end[there]]).sum(axis=1) > 0
    assert (view.side[there] == 2 * end[there] + inward).all()
    assert (end < 0).any() == (view.facet < 0).any() or (end < 0).mean() < 0.005


def test_a_few_of_each_set_lie_evenly():
    start, chosen = receivers.few(np.array([0, 10, 13]), 4)
    assert start.tolist() == [0, 4, 7] and chosen.tolist() == [0, 2, 5, 7, 10, 11, 12]
