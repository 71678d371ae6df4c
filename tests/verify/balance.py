"""The light balance, eq. 3.2: by hand, furnaces, flux, and where almost no light is lost."""

from functools import cache

import numpy as np

from lib.light import adapt, form_factors, radiosity
from lib.light import balance as balance_
from lib.light import lamps as lamps_
from lib.light.factors_file import FormFactors
from tests.helpers import rooms, truths
from tests.verify.factors import furnished, model
from tests.verify.walks import Found, near, refused, walk

PART = "light balance"
LOSSES = [1.0, 0.5, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6]


@walk(PART, "cube of six patches", law="closed form, one patch a face", at=["all .5", "six unlike"])
def cube(name):
    rho, truth = truths.CUBES[name != "all .5"]
    s = radiosity.solve(np.eye(6)[0], rho, truths.CUBE, tolerance=1e-12)
    return near(s.B, truth, 2e-8, iterations=s.iterations)


@walk(PART, "furnace", law="E / (1 - rho); error <= residual / (1 - rho)", axis="1 - rho", at=LOSSES)
def furnace(loss):
    F = truths.closed_box(60, seed=1)
    s = radiosity.solve(np.ones(60), np.full(60, 1 - loss), F, tolerance=1e-9)
    return near(s.B * loss, 1.0, (s.residual + 1e-12) * (1 + 1e-6) + 1e-9, iterations=s.iterations)


@walk(PART, "rho = 1", law="refused where light is never lost", at=["closed", "one absorbs", "open"], short=[0, 1])
def white(name):
    F, rho = truths.closed_box(12, seed=4), np.ones(12)
    if name == "closed":
        return refused(lambda: radiosity.solve(np.ones(12), rho, F), "no balance exists")
    F, rho = (0.9 * F, rho) if name == "open" else (F, np.where(np.arange(12) == 5, 0.5, rho))
    s = radiosity.solve(np.eye(12)[0], rho, F, tolerance=1e-10)
    truth = np.linalg.solve(np.eye(12) - rho[:, None] * F, np.eye(12)[0])
    return near(s.B, truth, s.bound * (1 + 1e-9) + 1e-12, iterations=s.iterations)


@walk(PART, "solvers", law="all end at elimination's answer", at=[*radiosity.METHODS])
def solvers(method):
    F, A = truths.closed_box(60, seed=2, area=True)
    rng = np.random.default_rng(3)
    E, rho = np.eye(60)[7], rng.uniform(0, 0.95, 60)
    s = radiosity.solve(E, rho, F, method=method, tolerance=1e-9, area=A, max_iterations=100_000)
    truth = np.linalg.solve(np.eye(60) - rho[:, None] * F, E)
    return near(s.B, truth, s.bound * (1 + 1e-9) + 1e-13, iterations=s.iterations)


@walk(PART, "emitters far apart in power", law="light adds", axis="ratio", at=[1.0, 1e3, 1e6, 1e9])
def powers(ratio):
    F, A = truths.closed_box(40, seed=7, area=True)
    rho = np.random.default_rng(1).uniform(0, 0.8, 40)
    strong, weak = ratio * np.eye(40)[3], np.eye(40)[9]
    go = lambda E: radiosity.solve(E, rho, F, tolerance=1e-14).B
    return near(go(strong + weak), go(strong) + go(weak), 1e-11, relative=True)


@walk(
    PART,
    "lamps far apart in size",
    law="all flux arrives, after all reflections",
    axis="area ratio",
    at=[1.0, 1e-2, 1e-4, 1e-6],
)
def sizes(ratio):
    """rho = .5 everywhere, and the lamps are as strong as they are small: flux / (1 - rho) of each."""
    a = np.sqrt(ratio)
    spot = rooms.panel("spot", (2.8, 0.5, 2.4), (2.8, 0.5 + a, 2.4), (2.8 + a, 0.5 + a, 2.4), (2.8 + a, 0.5, 2.4))
    s = model(rooms.room() | rooms.LAMP | spot, ("lamp", "spot"))
    m = rooms.patches(s, 300)
    emitters = lamps_.emitters(s, ["lamp", "spot"])
    D = lamps_.patch_direct(s, m, emitters, 2, n_points=64, n_samples=16) * [1, 1 / ratio]
    F = form_factors.rays(s, m, n_rays=256).matrix()
    B = radiosity.solve(0.5 * D, np.full(len(m), 0.5), F, tolerance=1e-8)
    light = (m.area[:, None] * (D + F @ B.B)).sum(axis=0) * s.local.diagonal**2
    return near(light, 2.0, 4e-3, relative=True, iterations=B.iterations)


@walk(
    PART,
    "closed room",
    law="mean illuminance Phi / (S (1 - rho)) (CIE 171's test 5.8)",
    axis="rho",
    at=[0.0, 0.3, 0.6, 0.9, 0.99],
)
def closed_room(rho):
    s, m, rows = furnished("a table on the floor")
    A = m.area * rows.exposed
    lamp = (s.group[m.side // 2] == s.groups.index("lamp")) & (m.side % 2 == 0)
    D = lamps_.patch_direct(s, m, lamps_.emitters(s, ["lamp"]), 1, n_points=64, n_samples=16)[:, 0]
    solution = radiosity.solve(rho * D, np.full(len(m), rho), rows.matrix(), tolerance=1e-8)
    light = (A * (D + rows.matrix() @ solution.B)).sum()
    return near(light * (1 - rho) / A[lamp].sum(), 1.0, 2.5e-3, iterations=solution.iterations)


@walk(PART, "View3D's total exchange", law="what the L-shaped room absorbs after all reflections", at=["L-shaped room"])
def exchange(_):
    """Rows: what surface i emits and j absorbs, as a share of i's own black emission, at rho .1."""
    areas, printed = truths.view3d("pinney-bean-test-4")
    F = truths.view3d("pinney-bean-test-4-f3a")[1]
    rho = np.full(8, 0.1)
    found = np.stack(
        [
            0.9
            * (
                F
                @ radiosity.solve(
                    0.9 * np.eye(8)[j], rho, F / np.maximum(F.sum(axis=1, keepdims=True), 1), tolerance=1e-12
                ).B
            )
            for j in range(8)
        ],
        axis=1,
    )
    return near(found, printed, 2e-4, note="its own factors are good to some 1e-5")


@walk(PART, "black room and dark room", law="E, and 0, exactly", at=["black", "dark"])
def dark(name):
    F, E = truths.closed_box(8), np.arange(8.0)
    s = radiosity.solve(E, np.zeros(8), F) if name == "black" else radiosity.solve(0 * E, np.full(8, 0.9), F)
    return near(s.B, E if name == "black" else 0 * E, 0.0, iterations=s.iterations)


# ---- gaps, where the sub-cell correction once gained light ----

GAPS = [30.0, 10.0, 3.0, 1.0, 0.1, 0.01, 0.001]


@cache
def board(mm):
    """Factors of a room with a board so far before its wall, cut small beside it."""
    solid = rooms.solid("board", mm / 1000, 0.8, 0.8, mm / 1000 + 0.02, 2.2, 1.8)
    s = model(rooms.room() | rooms.LAMP | solid)
    m = adapt.build(s, patches=600, max_level=3, contrast=0.05, emitters=lamps_.emitters(s, ["lamp"]))
    rows = form_factors.rays(s, m, n_rays=256)
    D = lamps_.patch_direct(s, m, lamps_.emitters(s, ["lamp"]), 1, n_points=16)
    return FormFactors(m, rows, D, ("lamp",), s.group[m.side // 2], s.groups, np.ones(len(s.groups)), 1.0)


@walk(PART, "a board before a wall", law="no eigenvalue of F exceeds its largest row sum", axis="gap, mm", at=GAPS)
def contractive(mm):
    factors = board(mm)
    F = factors.rows.matrix().astype(float)
    radius = balance_.spectral_radius(F @ factors.subcell.astype(float))
    limit = float(F.sum(axis=1).max())
    return Found(radius, limit, max(radius - limit, 0.0), 2e-4, None, f"{len(factors.mesh)} patches")


@walk(
    PART,
    "the balance beside gaps",
    law="the residual told is the true one; solved where it is below 1e-4",
    axis="1 - rho",
    at=[0.5, 0.1, 1e-2, 1e-3],
)
def residual(loss):
    """Elimination's light is the yardstick."""
    factors = board(3.0)
    F = [balance_.stored(factors.rows.matrix() @ factors.subcell)]
    rho = 1 - loss
    source = (rho * factors.lamp_factor).astype(np.float32)
    found = balance_.reflected(F, rho, source, tolerance=1e-5)
    A = np.asarray(F[0], float)
    exact = np.linalg.solve(np.eye(len(A)) - rho * A, source.astype(float))
    true = np.linalg.norm(source + rho * A @ found.b - found.b) / np.linalg.norm(source)
    # light that is large beside its source has single precision's rounding in its residual
    rounding = 4 * np.finfo(np.float32).eps * np.linalg.norm(found.b) / np.linalg.norm(source)
    told = abs(true - found.residual) <= 0.1 * true + rounding
    error = float(np.abs(found.b - exact).max() / np.abs(exact).max())
    if balance_.unsolved(found.residual):  # then fit and render are not converged, and say so
        return Found(true, found.residual, 0.0 if told else 1.0, 0.0, found.iterations, "told not to be solved")
    bound = 30 * max(found.residual, 1e-6) / loss if told else 0.0
    return Found(true, found.residual, error, bound, found.iterations, "value, truth: residual found, residual told")
