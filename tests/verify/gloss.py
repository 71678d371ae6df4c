"""Mirrors and Ward's lobes: mirrored lamps, facing mirrors, albedos, Radiance's values."""

from functools import cache

import numpy as np

from lib.light import chains as chains_
from lib.light import form_factors, paths, specular_lamps, ward
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light import ward_kernels as kernels
from tests.helpers import rooms, truths
from tests.helpers.small_scenes import closed_room, elements, factor, finish, rectangle, side_of, surface, views
from tests.verify.walks import Found, near, walk

UP = np.array([0, 0, 1.0])
FORMS = {kernels.WARD: "Ward 1992", kernels.DUER: "Ward-Duer", kernels.BOUNDED: "bounded"}


# ---- mirrors ----


@walk(
    "mirrors",
    "a lamp in a mirror",
    law="the factor of the mirrored polygon",
    axis="half a mirror's side, m",
    at=[50.0, 20.0, 10.0, 5.0],
)
def mirrored(half):
    s = surface(
        [
            ("floor", rectangle((-3, -3, 0), (6, 0, 0), (0, 6, 0))),
            ("mirror", rectangle((-half, -half, 2), (0, 2 * half, 0), (2 * half, 0, 0))),
            ("lamp", rectangle((1.5, -0.5, 1), (1, 0, 0), (0, 1, 0))),
        ],
        ["lamp"],
    )
    chains = chains_.Chains(1)
    images, _, _ = specular_lamps.mirrored_lamps(s, finish(s, mirror="mirror"), chains, lamps_.emitters(s, ["lamp"]))
    p = np.array([[0, 0, 0], [0.7, -0.4, 0], [-2, 1.5, 0.0]])
    side = np.full(len(p), side_of(s, "floor"), np.int32)
    normals = surfaces.side_normals(s)
    F = lamps_.direct(s, images, s.local.points(p), normals, side, 1, n_samples=64)[:, 0]
    image = rectangle((1.5, -0.5, 3), (1, 0, 0), (0, 1, 0))
    return near(F, [factor(q, UP, image) for q in p], 1e-7)


@cache
def corridor():
    """Two places on the floor of a room of 4 x 3 x 2.5 m whose east and west walls are mirrors."""
    s = surface(closed_room())
    mesh = rooms.patches(s, 80)
    p, side, n = np.array([[1.3, 1.1, 0], [0.4, 2.2, 0]]), side_of(s, "bottom"), 1 << 13
    spec = finish(s, west="mirror", east="mirror")
    far = [lamps_.Emitter(0, np.array([[[0, 0, 9.0], [1, 0, 9], [0, 1, 9]]]), UP[None], np.ones(1))]
    rows, chains = elements(s, mesh, spec, far, p, side, n)
    first = form_factors.gather(s, mesh, s.local.points(p), np.arange(3), np.full(2, side), np.full(2, n), seed=3)
    plain = ~np.isin(s.group[mesh.side // 2], spec.groups)
    return p, rows, chains, first.matrix()[:, plain].sum(axis=1), plain


@walk("mirrors", "facing mirrors", law="the unfolded series", axis="rho_s", at=[0.0, 0.5, 0.8, 0.9, 0.99, 1.0])
def facing(rho):
    p, rows, chains, first, plain = corridor()
    power = chains.power(np.full((2, 1), rho))[:, 0]
    found = first + sum(power[k] * F[:, plain].sum(axis=1) for k, F in rows.F.items())
    truth = []
    for q in p:
        total = 1.0
        for start in (0, 1):  # towards west first, towards east first
            x = [4.0 * k + 4 if start else -4.0 * k for k in range(60)]
            P = np.array([factor(q, UP, [(a, 0, 0), (a, 3, 0), (a, 3, 2.5), (a, 0, 2.5)]) for a in x])
            total += -P[0] + (rho ** np.arange(1, 60) * (P[:-1] - P[1:])).sum()
        truth.append(total)
    missing = 2 * 3.0 * 2.5 / (np.pi * (4.0 * (paths.DEPTH - 1)) ** 2)  # still on its way where paths end
    return near(found, truth, 2e-3 + missing * rho**paths.DEPTH)


@walk(
    "mirrors",
    "mirrors alone",
    law="light goes round, is counted out, and finds nothing",
    at=["a box of mirrors", "looks away"],
)
def alone(name):
    if name == "a box of mirrors":
        s = surface([("mirror", corners) for _, corners in closed_room(1, 1, 1)])
        spec = chains_.Finish((0,), np.array([chains_.MIRROR]), np.zeros((1, 2)), np.zeros((1, 3)))
        v = np.random.default_rng(0).normal(size=(200, 3))
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        rays = np.hstack([np.tile(s.local.points([0.4, 0.5, 0.6]), (200, 1)), v]).astype(np.float32)
        met = list(paths.follow(s, spec, chains_.Chains(1), paths.first_met(rays, *s.caster.closest(rays))))
        return near(len(met), paths.DEPTH, 0.0, iterations=len(met))
    s = surface(
        [
            ("floor", rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0))),
            ("mirror", rectangle((-1, 0, 1), (0, 1, 0), (0.3, 0, 3))),
            ("lamp", rectangle((3, 0, 1), (0, 1, 0), (1, 0, 0))),
        ],
        ["lamp"],
    )
    spec, lamps = finish(s, mirror="mirror"), lamps_.emitters(s, ["lamp"])
    rows, _ = elements(s, rooms.patches(s, 30), spec, lamps, [[0.5, 0.5, 0]], side_of(s, "floor"), 4096, complete=0)
    light = sum(F.sum() for F in rows.F.values()) + sum(D.sum() for D in rows.D.values())
    return near(light, 0.0, 0.0)


# ---- Ward ----


@walk(
    "Ward's lobes",
    "albedos",
    law="the three forms, at 0, 45, 75 and 89 degrees",
    at=[f"{FORMS[f]}, alpha {a}" for a, f, _ in truths.ALBEDOS],
)
def albedos(name):
    alpha, form, table = next(row for row in truths.ALBEDOS if name == f"{FORMS[row[1]]}, alpha {row[0]}")
    return near(ward.albedo(form, alpha, alpha, np.radians(truths.ANGLES)), table, 5.01e-4)


@walk(
    "Ward's lobes",
    "albedo along the normal",
    law="closed form of the bounded form",
    axis="alpha",
    at=[0.01, 0.05, 0.1, 0.3, 0.6, 1.0],
)
def along_the_normal(alpha):
    end = 1 / alpha**2
    exact = (1 - np.exp(-end)) - alpha**2 * (1 - (1 + end) * np.exp(-end))
    return near(ward.albedo(kernels.BOUNDED, alpha, alpha, 0.0), exact, 1e-7)


@walk("Ward's lobes", "Radiance", law="what rtrace renders; in far tails 4.2e-6 of the exponent", at=["40 values"])
def radiance(_):
    worst = Found(0.0, 0.0, 0.0, 1.0)
    for rho, alpha, i, o, seen, *_ in truths.radiance_rows():
        if seen:  # five lie below what rtrace traces
            h = i + o
            far = (h[0] ** 2 + h[1] ** 2) / (h[2] * alpha) ** 2
            found = near(
                rho * ward.values(kernels.BOUNDED, alpha, alpha, i, o), seen, max(1e-5, 4.2e-6 * far), relative=True
            )
            worst = max(worst, found, key=lambda f: f.error / f.bound)
    return worst


@walk(
    "Ward's lobes",
    "energy towards grazing",
    law="the bounded form never gains",
    axis="90 - degrees",
    at=[45.0, 10.0, 1.0, 0.1, 0.01],
)
def grazing(below):
    alphas = (0.02, 0.1, 0.3, 0.6, 1.0)
    most = max(float(ward.albedo(kernels.BOUNDED, a, a, np.radians(90 - below))) for a in alphas)
    return Found(most, 1.0, max(most - 1, 0.0), 1e-6)


@walk(
    "Ward's lobes",
    "furnace with a glossy wall",
    law="what a lobe shows is its albedo, where all else has B = 1",
    axis="alpha",
    at=[0.01, 0.03, 0.1, 0.3, 0.6],
)
def glossy(alpha):
    s = surface(closed_room())
    spec = finish(s, bottom=alpha)
    angles = np.radians([0, 45, 75])
    towards = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], axis=1)  # from the eye to the wall
    p = np.full((3, 3), [1.3, 1.1, 0.0])
    mesh = rooms.patches(s, 80)
    far = [lamps_.Emitter(0, np.array([[[0, 0, 9.0], [1, 0, 9], [0, 1, 9]]]), UP[None], np.ones(1))]
    facet = side_of(s, "bottom") // 2
    rows, chains = views(s, mesh, spec, far, p, facet, towards, 1 << 13)
    power = chains.power(np.ones((1, 1)))[:, 0]
    found = sum(power[k] * F.sum(axis=1) for k, F in rows.F.items())
    return near(found, ward.albedo(kernels.BOUNDED, alpha, alpha, angles), 5e-3)
