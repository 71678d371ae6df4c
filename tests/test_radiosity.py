"""The light balance: by hand, by law (furnace, flux, the bound), and at the edge (rho = 1, black, open, one patch)."""

import functools

import numpy as np
import pytest
from scipy.sparse import csr_array

from lib.light import radiosity
from lib.light.corrected import Corrected, product
from tests.helpers.truths import CUBE, CUBES, closed_box

METHODS = [dict(method=m) for m in radiosity.METHODS] + [
    dict(method="progressive", overshoot=True),
    dict(method="progressive", ambient=True),
]
NAMES = ["-".join(str(v) if k == "method" else k for k, v in m.items()) for m in METHODS]
every_method = pytest.mark.parametrize("how", METHODS, ids=NAMES)
every_store = pytest.mark.parametrize(
    "store",
    [np.asarray, np.float32, csr_array, lambda F: csr_array(np.float32(F))],
    ids=["float64", "float32", "csr64", "csr32"],
)


# ---- by hand ----


@pytest.mark.scene
@every_method
@every_store
def test_two_patches(how, store):
    """One lamp, one grey wall, each seeing only the other: B = (1, rho), and back again where the lamp reflects too."""
    F = store(np.array([[0.0, 1], [1, 0]]))
    s = radiosity.solve(np.array([1.0, 0]), np.array([0, 0.5]), F, tolerance=1e-12, **how)
    assert s.converged and np.allclose(s.B, [1, 0.5], atol=1e-12)
    s = radiosity.solve(np.array([1.0, 0]), np.array([0.5, 0.5]), F, tolerance=1e-12, **how)
    assert np.allclose(s.B, [1 / 0.75, 0.5 / 0.75], atol=1e-11)


@every_method
@pytest.mark.parametrize("rho, expected", CUBES, ids=["grey", "six"])
def test_cube_of_six_patches(how, rho, expected):
    """docs/decisions/closed-forms.md: a cube of one patch per face, one of them E = 1."""
    s = radiosity.solve(np.eye(6)[0], rho, CUBE, tolerance=1e-12, **how)
    assert np.allclose(s.B, expected, rtol=0, atol=2e-8)


def test_southwell_and_progressive_by_hand():
    """Three shots. From (8, 2, 0), F = 1/2 to each of the others, rho = 1/2: patch 0 shoots 8, and so on."""
    F = (np.ones((3, 3)) - np.eye(3)) / 2
    E, rho = np.array([8.0, 2, 0]), np.full(3, 0.5)
    seen = []
    radiosity.solve(E, rho, F, method="progressive", max_iterations=2, callback=lambda k, B: seen.append(B))
    assert np.allclose(seen, [[8, 4, 2], [9, 4, 3]])  # 8 leaves 2 with each; then patch 1 has 4 to shoot
    seen.clear()
    radiosity.solve(E, rho, F, method="southwell", max_iterations=2, callback=lambda k, B: seen.append(B))
    assert np.allclose(seen, [[8, 0, 0], [8, 4, 0]])  # only what was sent


# ---- by law ----


@every_method
@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.99, 1 - 1e-4, 1 - 1e-6, 1 - 1e-8])
def test_furnace(how, rho):
    """Everything glows and reflects alike, so B = E (1 + rho + rho^2 + ...) = E / (1 - rho).

    The residual is not the error: near rho = 1 a small residual still allows an error 1 / (1 - rho) times as
    large, and the bound must hold even so, converged or not.
    """
    s = radiosity.solve(np.ones(6), np.full(6, rho), closed_box(6, seed=1), tolerance=1e-9, max_iterations=500, **how)
    exact = 1 / (1 - rho)
    assert np.max(np.abs(s.B - exact)) <= (s.residual + 1e-12) * exact * (1 + 1e-6)
    assert s.residual * exact == pytest.approx(s.bound, rel=1e-6)
    if how["method"] in ("krylov", "direct"):
        assert np.max(np.abs(s.B / exact - 1)) < 1e-6


@every_method
@every_store
@pytest.mark.parametrize("top", [0.3, 0.9, 0.99])
def test_against_elimination(how, store, top):
    """Any closed room: residual as stated, error within the bound, the answer of elimination within the tolerance."""
    rng = np.random.default_rng(3)
    F, A = closed_box(40, seed=2, area=True)
    F = np.float32(F) if "32" in str(store(F).dtype) else F
    E, rho = rng.random((40, 3)) * (rng.random(40) < 0.2)[:, None], rng.uniform(0, top, (40, 3))
    # rows that rounding carries beyond 1 are scaled back
    used = rho / np.maximum(F.astype(float).sum(axis=1), 1)[:, None]
    exact = np.stack([np.linalg.solve(np.eye(40) - used[:, c, None] * F, E[:, c]) for c in range(3)], axis=1)
    s = radiosity.solve(E, rho, store(F), tolerance=1e-7, area=A, max_iterations=30_000, **how)
    assert s.converged and s.B.shape == (40, 3)
    residual = np.abs(E + used * (np.asarray(F, float) @ s.B) - s.B).max()
    assert s.residual == pytest.approx(residual, rel=1e-3, abs=2e-15)
    assert np.abs(s.B - exact).max() <= s.bound * (1 + 1e-9) + 1e-13
    assert s.residual <= 1.01e-7 * E.max()
    iterations, cpu, wall, _ = zip(*s.trace, strict=True)
    assert list(iterations) == sorted(iterations)
    assert all(list(clock) == sorted(clock) and min(clock) >= 0 for clock in (cpu, wall))


@every_method
def test_flux_balance(how):
    """Closed room, everything reflects rho: mean illuminance = Phi / (S (1 - rho)); and light in = light absorbed."""
    F, A = closed_box(30, seed=5, area=True)
    E = np.zeros(30)
    E[4] = 7.0
    for rho in (0.2, 0.8):
        s = radiosity.solve(E, np.full(30, rho), F, tolerance=1e-11, area=A, max_iterations=100_000, **how)
        illuminance = (A * (F @ s.B)).sum() / A.sum()
        assert illuminance == pytest.approx(A[4] * 7 / (A.sum() * (1 - rho)), rel=1e-9)
    rho = np.random.default_rng(0).uniform(0, 0.9, 30)
    s = radiosity.solve(E, rho, F, tolerance=1e-12, area=A, max_iterations=100_000, **how)
    assert (A * (1 - rho) * (F @ s.B)).sum() == pytest.approx(A[4] * 7, rel=1e-9)


@every_method
def test_scale_and_superposition(how):
    """Light adds, and a million times the light is the same picture: emitters 1e6 apart keep their digits."""
    F, A = closed_box(25, seed=7, area=True)
    rho = np.random.default_rng(1).uniform(0, 0.8, 25)
    strong, weak = np.eye(25)[3] * 1e6, np.eye(25)[9]
    go = lambda E: radiosity.solve(E, rho, F, tolerance=1e-14, area=A, max_iterations=50_000, **how).B
    assert np.allclose(go(strong + weak), go(strong) + go(weak), rtol=1e-11)
    assert np.allclose(go(strong), go(strong / 1e6) * 1e6, rtol=1e-11)
    both = radiosity.solve(
        np.stack([strong, weak], axis=1), rho, F, tolerance=1e-13, area=A, max_iterations=50_000, **how
    )
    assert np.allclose(both.B[:, 1], go(weak), rtol=1e-10), "a channel is judged by its own lamp"


# ---- at the edge ----


@every_method
def test_one_patch(how):
    """N = 1: alone in the dark it keeps its own light; as the inside of a ball it is the furnace."""
    assert pytest.approx([2]) == radiosity.solve(np.array([2.0]), np.array([0.7]), np.zeros((1, 1)), **how).B
    assert (
        pytest.approx([8])
        == radiosity.solve(np.array([2.0]), np.array([0.75]), np.ones((1, 1)), tolerance=1e-10, **how).B
    )
    assert pytest.approx([2]) == radiosity.solve(np.array([2.0]), np.array([1.0]), np.zeros((1, 1)), **how).B, (
        "rho = 1 in the open"
    )
    with pytest.raises(ValueError, match="no balance"):
        radiosity.solve(np.array([2.0]), np.array([1.0]), np.ones((1, 1)), **how)


@every_method
def test_black_and_dark_rooms(how):
    F = closed_box(8)
    E = np.arange(8.0)
    s = radiosity.solve(E, np.zeros(8), F, **how)
    assert np.array_equal(s.B, E) and s.residual == 0 == s.bound and s.converged
    s = radiosity.solve(np.zeros(8), np.full(8, 0.9), F, **how)
    assert np.array_equal(s.B, np.zeros(8)) and s.converged


@every_method
@every_store
def test_white_walls_that_lose_their_light(how, store):
    """rho = 1 has a balance where light can leave: the bound is no longer residual / (1 - rho), and still holds."""
    F = closed_box(12, seed=4)
    rho = np.ones(12)
    rho[5] = 0.5  # one absorbing patch in a white room
    E = np.eye(12)[0]
    F = np.float32(F) if "32" in str(store(F).dtype) else F
    sums = np.maximum(F.astype(float).sum(axis=1), 1)
    exact = np.linalg.solve(np.eye(12) - (rho / sums)[:, None] * F, E)
    s = radiosity.solve(E, rho, store(F), tolerance=1e-8, max_iterations=100_000, **how)
    assert s.converged and np.isfinite(s.bound)
    assert np.abs(s.B - exact).max() <= s.bound * (1 + 1e-9) + 1e-12
    s = radiosity.solve(
        E, np.ones(12), store(0.9 * F), tolerance=1e-10, max_iterations=100_000, **how
    )  # a room with windows
    assert (
        np.isfinite(s.bound)
        and np.abs(s.B - np.linalg.solve(np.eye(12) - 0.9 * F, E)).max() <= s.bound * (1 + 1e-9) + 1e-12
    )


@every_store
def test_no_balance_is_refused(store):
    """Light that is never lost: one line, whichever component it is in. The other component may be ordinary."""
    F = np.zeros((10, 10))
    F[:6, :6], F[6:, 6:] = closed_box(6), closed_box(4)
    rho = np.full(10, 0.5)
    rho[6:] = 1
    E = np.eye(10)[0]
    s = radiosity.solve(E, rho, store(F))  # the white room next door is dark, and stays dark
    assert (s.B[6:] == 0).all() and s.converged and np.isfinite(s.bound)
    with pytest.raises(ValueError, match="no balance exists: patch 7 emits") as caught:
        radiosity.solve(E + np.eye(10)[7], rho, store(F))
    assert "\n" not in str(caught.value)
    rho[8] = 1 - 1e-6  # a trace of soot, and there is one
    s = radiosity.solve(E + np.eye(10)[7], rho, store(F), tolerance=1e-10)
    assert s.B[6:].min() > 1e3 and np.isfinite(s.bound)


@pytest.mark.parametrize(
    "change, message",
    [
        (dict(rho=[0.5, 1.2]), "rho = 1.2 of patch 1 is outside"),
        (dict(rho=[-0.1, 0.5]), "rho = -0.1 of patch 0"),
        (dict(rho=[0.5, np.nan]), "rho = nan of patch 1"),
        (dict(E=[np.nan, 0]), "E of patch 0 is not finite"),
        (dict(E=[0, np.inf]), "E of patch 1 is not finite"),
        (dict(E=[1.0, 0, 0], rho=[0.5] * 3), "3 patches, F for 2"),
        (dict(F=[[0, 1.1], [1, 0]]), "row 0 of F sums to 1.1"),
        (dict(F=[[0, -1e-3], [1, 0]]), "negative or not a number"),
        (dict(F=[[0, np.nan], [1, 0]]), "negative or not a number"),
        (dict(F=np.zeros((2, 3))), "not that of a square"),
        (dict(method="magic"), "is not one of krylov"),
        (dict(method="progressive", area=[1.0, 0]), "area: one positive"),
        (dict(method="progressive", patch=[0]), "patch: 1 numbers for 2"),
    ],
)
def test_refusals(change, message):
    """Each in one line."""
    given = dict(E=[1.0, 0], rho=[0.5, 0.5], F=[[0, 1], [1, 0]]) | change
    E, rho, F = (np.array(given.pop(k), float) for k in ("E", "rho", "F"))
    with pytest.raises(ValueError, match=message) as caught:
        radiosity.solve(E, rho, F, **given)
    assert "\n" not in str(caught.value)


# ---- figure 3.9: the hierarchy, the ambient term, overshooting ----


def test_patches_shoot_and_elements_receive():
    """Elements of one patch that receive alike: the hierarchy is exact, with a quarter of the shots."""
    F4, A4 = closed_box(10, seed=9, area=True)
    F = np.repeat(np.repeat(F4, 4, axis=0), 4, axis=1) / 4  # each patch cut into four like elements
    patch, area = np.repeat(np.arange(10), 4), np.repeat(A4, 4) / 4
    rho, E = np.repeat(np.linspace(0, 0.8, 10), 4), np.repeat(np.eye(10)[2], 4)
    exact = np.linalg.solve(np.eye(40) - rho[:, None] * F, E)
    one = radiosity.solve(E, rho, F, method="progressive", area=area, patch=patch, tolerance=1e-8)
    all_ = radiosity.solve(E, rho, F, method="progressive", area=area, tolerance=1e-8)
    assert one.converged and np.allclose(one.B, exact, atol=1e-7) and np.allclose(all_.B, exact, atol=1e-7)
    assert one.iterations < 0.35 * all_.iterations
    assert np.allclose(
        radiosity.solve(E, rho, csr_array(F), method="progressive", area=area, patch=patch, tolerance=1e-8).B,
        one.B,
        atol=1e-9,
    )


def test_elements_keep_their_own_light():
    """Elements that receive unlike light differ though they shoot as one.

    The residual says how much that costs, and the bound holds.
    """
    F, A = closed_box(40, seed=10, area=True)
    patch = np.arange(40) // 4
    rho, E = np.full(40, 0.6), np.repeat(np.eye(10)[2], 4)
    exact = np.linalg.solve(np.eye(40) - rho[:, None] * F, E)
    s = radiosity.solve(E, rho, F, method="progressive", area=A, patch=patch, tolerance=1e-10, max_iterations=100_000)
    assert s.converged and s.residual > 1e-3 and np.abs(s.B - exact).max() <= s.bound
    constant = (A * exact).reshape(10, 4).sum(axis=1) / A.reshape(10, 4).sum(axis=1)
    assert np.abs(s.B - exact).max() < 0.5 * np.abs(constant[patch] - exact).max()


def test_ambient_term_and_overshooting_help():
    """Shots until the mean error is 2 %: the ambient term is there almost at once, overshooting in half the shots.

    All end alike.
    """
    F, A = closed_box(200, seed=11, area=True)
    E = np.eye(200)[0]
    rho = np.full(200, 0.8)
    exact = np.linalg.solve(np.eye(200) - rho[:, None] * F, E)
    shots = {}
    for name, extra in (("plain", {}), ("ambient", dict(ambient=True)), ("overshoot", dict(overshoot=True))):
        error = []
        s = radiosity.solve(
            E,
            rho,
            F,
            method="progressive",
            area=A,
            tolerance=1e-8,
            max_iterations=200_000,
            callback=lambda k, B, error=error: error.append((A * np.abs(B - exact)).sum() / (A * exact).sum()),
            **extra,
        )
        assert s.converged and np.abs(s.B - exact).max() < 1e-7, name
        shots[name] = int(np.argmax(np.array(error) < 0.02))
    assert shots["ambient"] < 0.2 * shots["plain"] and shots["overshoot"] < 0.6 * shots["plain"], shots


@every_method
def test_a_picture_per_iteration(how):
    """The callback sees every iteration; progressive refinement only ever gets brighter (without the ambient term)."""
    F, A = closed_box(20, seed=12, area=True)
    E, rho = np.eye(20)[1], np.full(20, 0.7)
    seen = []
    s = radiosity.solve(E, rho, F, area=A, tolerance=1e-6, callback=lambda k, B: seen.append((k, B)), **how)
    assert all(b.shape == (20,) for _, b in seen) and np.allclose(seen[-1][1], s.B, atol=1e-5)
    assert [k for k, _ in seen] == sorted(k for k, _ in seen) and seen[-1][0] == s.iterations
    assert np.isfinite([step.residual for step in s.trace]).all()
    if how == dict(method="progressive"):
        assert (np.diff([b for _, b in seen], axis=0) >= 0).all()


def test_warm_start_and_reuse():
    """A slightly different rho from the last answer takes fewer iterations; Factors are prepared once."""
    F = radiosity.Factors(closed_box(100, seed=13))
    rng = np.random.default_rng(2)
    E, rho = rng.random(100), rng.uniform(0.2, 0.8, 100)
    for method in ("krylov", "gauss_seidel", "jacobi"):
        cold = radiosity.solve(E, rho, F, method=method)
        warm = radiosity.solve(E, rho * 1.001, F, method=method, x0=cold.B)
        assert warm.converged and warm.iterations < cold.iterations
        assert np.allclose(warm.B, radiosity.solve(E, rho * 1.001, F, method="direct").B, atol=1e-5)


# ---- GMRES itself ----


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_gmres_columns_of_unlike_difficulty(kind):
    """Zero, solved at once, easy and hard columns side by side: each to its own tolerance, nothing blows up."""
    F = closed_box(60, seed=14).astype(kind)
    rho = np.stack([np.full(60, r) for r in (0.5, 0.0, 0.3, 0.95)], axis=1).astype(kind)
    b = np.random.default_rng(4).random((60, 4)).astype(kind)
    b[:, 0] = 0
    x, residual, n = radiosity.gmres(lambda X: X - rho * (F @ X), b, tolerance=1e-5)
    assert residual <= 1e-5 and x.dtype == kind and (x[:, 0] == 0).all() and np.allclose(x[:, 1], b[:, 1], rtol=1e-5)
    left = np.linalg.norm(b - (x - rho * (F @ x)), axis=0) / np.maximum(np.linalg.norm(b, axis=0), 1e-30)
    assert left.max() <= 1.1e-5
    y, _, more = radiosity.gmres(lambda X: X - rho * (F @ X), b, tolerance=1e-5, x0=x)
    assert more == 0 and np.array_equal(x, y)
    assert radiosity.gmres(lambda X: X - rho * (F @ X), b, tolerance=1e-5, max_iterations=2)[2] == 2


@pytest.mark.parametrize("power", [1e-30, 1e-23, 1e-10, 1e20])
def test_gmres_of_any_power(power):
    """Twice the light, twice the radiosity: squares of 1e-23 vanish in float32, and the answer was infinite."""
    F, b = closed_box(6, seed=1).astype(np.float32), np.eye(6, 2, dtype=np.float32)
    x, residual, _ = radiosity.gmres(lambda X: X - np.float32(0.5) * (F @ X), b, tolerance=1e-5)
    y, *_ = radiosity.gmres(lambda X: X - np.float32(0.5) * (F @ X), b * np.float32(power), tolerance=1e-5)
    assert residual <= 1e-5 and np.allclose(y / np.float32(power), x, rtol=1e-5)


@pytest.mark.parametrize("columns", [1, 2, 3, 4, 9])
@pytest.mark.parametrize("precision", [np.float32, np.float64])
def test_sparse_products_are_those_of_dense_ones(columns, precision):
    """Rows without an entry, with one and with many; rows times a correction are their product."""
    random = np.random.default_rng(columns)
    rows, correction = (random.random(shape) * (random.random(shape) < 0.3) for shape in ((7, 12), (12, 12)))
    rows[0], rows[1, 1:] = 0, 0
    X = random.random((12, columns)).astype(precision)
    sparse = [csr_array(A.astype(precision)) for A in (rows, correction)]
    close = functools.partial(np.testing.assert_allclose, rtol=1e-5 if precision == np.float32 else 1e-12)
    close(product(sparse[0], X), rows @ X)
    both = Corrected(*sparse)
    close(both @ X, rows @ correction @ X)
    close(both.toarray(), rows @ correction)
    assert (both @ X).dtype == precision
