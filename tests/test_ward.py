"""Ward's BRDF: by hand and by peers (Radiance, published albedos), by law (reciprocity, energy, sampling).

And by difference, and at the edge.
"""

import numpy as np
import pytest
from numba import njit

from lib.light import ward
from lib.light import ward_kernels as kernels
from tests.helpers.truths import ALBEDOS, ANGLES, direction, radiance_rows

ALPHAS = [(0.3, 0.3), (0.6, 0.2), (0.05, 0.15), (0.1, 0.01)]
EYES = [(0, 0), (45, 20), (75, 200), (89, 110)]


def sphere(n, seed, upper=True):
    v = np.random.default_rng(seed).normal(size=(n, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    if upper:
        v[:, 2] = abs(v[:, 2])
    return v


# ---- by hand, by peers ----


@pytest.mark.parametrize("alpha,form,table", ALBEDOS)
def test_albedos_of_the_design(alpha, form, table):
    """docs/decisions/ward-forms.md, at 0, 45, 75 and 89 degrees, as printed.

    One of them, 1 - 0.05^2 = .9975, lies between two.
    """
    assert ward.albedo(form, alpha, alpha, np.radians(ANGLES)) == pytest.approx(table, abs=5.01e-4)


def test_albedo_along_the_normal():
    """The bounded weight 2 cos_i / (1 + cos_i) is 1 - tan^2 h there.

    tan^2 h = alpha^2 t with t of density exp(-t), up to 1 / alpha^2.
    """
    for alpha in (0.05, 0.3, 0.6):
        end = 1 / alpha**2
        exact = (1 - np.exp(-end)) - alpha**2 * (1 - (1 + end) * np.exp(-end))
        assert ward.albedo(kernels.BOUNDED, alpha, alpha, 0.0) == pytest.approx(exact, abs=1e-8)


def test_radiance():
    """Radiance renders the bounded form: to 1e-5 in the lobe.

    In its far tails, where the exponent is large, the exponent agrees to 4e-6.
    """
    rows = radiance_rows()
    assert len(rows) == 45
    seen = 0
    for rho, alpha, i, o, radiance, of_1992, bounded in rows:
        f = rho * ward.values(kernels.BOUNDED, alpha, alpha, i, o)
        assert f == pytest.approx(bounded, rel=5e-6)
        assert rho * ward.values(kernels.WARD, alpha, alpha, i, o) == pytest.approx(of_1992, rel=5e-6)
        if radiance:  # five lie below what rtrace traces
            h = i + o
            e = (h[0] ** 2 + h[1] ** 2) / (h[2] * alpha) ** 2
            assert f == pytest.approx(radiance, rel=max(1e-5, 4.2e-6 * e))
            seen += 1
    assert seen == 40


def test_the_lobe_follows_the_tangent():
    """A long alpha along x spreads the light along x."""
    along, across = direction(30, 0), direction(30, 90)
    up = direction(0, 0)
    assert ward.values(kernels.BOUNDED, 0.5, 0.1, along, up) > 100 * ward.values(kernels.BOUNDED, 0.5, 0.1, across, up)


# ---- by law ----


@pytest.mark.parametrize("form", range(3))
def test_reciprocity(form):
    i, o = sphere(500, 1), sphere(500, 2)
    for ax, ay in ALPHAS:
        assert ward.values(form, ax, ay, i, o) == pytest.approx(ward.values(form, ax, ay, o, i), rel=1e-12, abs=1e-300)


def test_the_bounded_form_never_gains_energy():
    worst = max(
        ward.albedo(
            kernels.BOUNDED, ax, ax * ratio, np.radians([0, 20, 40, 60, 75, 85, 88, 89, 89.9, 89.99]), phi
        ).max()
        for ax in (0.01, 0.03, 0.1, 0.2, 0.3, 0.45, 0.6)
        for ratio in (1, 0.2)
        for phi in (0, 0.8, np.pi / 2)
    )
    assert 0.99 < worst <= 1
    assert ward.albedo(kernels.DUER, 0.3, 0.3, np.radians(89)) > 4


@pytest.mark.scene
@pytest.mark.parametrize("theta,phi", EYES)
@pytest.mark.parametrize("ax,ay", ALPHAS)
def test_the_density_is_that_of_the_samples(ax, ay, theta, phi):
    """Counts of samples in cells of the half vector's slopes, above the horizon, against the integrated density."""
    n = 100_000
    rng = np.random.default_rng(3)
    o = direction(theta, phi)
    i = ward.samples(ax, ay, o, rng.random(n), rng.random(n))
    assert abs(np.linalg.norm(i, axis=1) - 1).max() < 1e-9
    # cells in the deviates (r cos, r sin) that i's half vector came from: fine where the lobe is
    cells, fine, reach = 8, 24, 3.0
    h = i + o
    above = i[:, 2] > kernels.HORIZON
    p, q = (h[:, d] / np.where(above, h[:, 2], 1) / a for d, a in ((0, ax), (1, ay)))
    edges = np.linspace(-reach, reach, cells + 1)
    found = np.histogram2d(p[above], q[above], [edges, edges])[0]
    t = -reach + (np.arange(cells * fine) + 0.5) * 2 * reach / (cells * fine)
    p, q = (x.ravel() for x in np.meshgrid(t * ax, t * ay, indexing="ij"))
    # of a slope's cell: solid angle of h is cos^3, and turning h turns i by 4 (o.h)
    squared = 1 + p * p + q * q
    dot = (o[0] * p + o[1] * q + o[2]) / np.sqrt(squared)
    m = np.stack([p, q, np.ones_like(p)], axis=1) / np.sqrt(squared)[:, None]
    mirrored = 2 * dot[:, None] * m - o
    density = (
        ward.pdfs(ax, ay, mirrored, o) * 4 * abs(dot) * squared**-1.5 * ax * ay * (mirrored[:, 2] > kernels.HORIZON)
    )
    expected = n * (density * (2 * reach / (cells * fine)) ** 2).reshape(cells, fine, cells, fine).sum(axis=(1, 3))
    whole = ((mirrored[:, 2] > kernels.HORIZON).reshape(cells, fine, cells, fine).all(axis=(1, 3))) & (
        expected > 20
    )  # the horizon cuts the others
    chi2 = ((found - expected)[whole] ** 2 / expected[whole]).sum()
    assert whole.sum() > 10 and abs(chi2 - whole.sum()) < 5 * np.sqrt(2 * whole.sum())


def test_the_density_is_one_over_the_sphere():
    """Integrated over directions, not half vectors; the part near -o, where it has no bound, is left out and small."""
    n = 1200
    z = -1 + (np.arange(n) + 0.5) * 2 / n
    azimuth = (np.arange(n) + 0.5) * 2 * np.pi / n
    z, azimuth = (x.ravel() for x in np.meshgrid(z, azimuth, indexing="ij"))
    i = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    for ax, ay, theta, tolerance in ((0.3, 0.3, 0, 1e-4), (0.3, 0.15, 40, 1e-4), (0.6, 0.3, 60, 2e-2)):
        assert ward.pdfs(ax, ay, i, direction(theta, 30)).sum() * 4 * np.pi / n**2 == pytest.approx(1, abs=tolerance)


@pytest.mark.parametrize("form", range(3))
@pytest.mark.parametrize("ax,ay", ALPHAS)
def test_weights(form, ax, ay):
    """weight = f cos / density, and its mean is the albedo."""
    n = 256
    u, v = (x.ravel() for x in np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n))
    for theta, phi in EYES:
        o = direction(theta, phi)
        i = ward.samples(ax, ay, o, u, v)
        w = ward.weights(form, ax, ay, i, o)
        density = ward.pdfs(ax, ay, i, o)
        some = (density > 0) & (i[:, 2] > kernels.HORIZON)
        np.testing.assert_allclose(
            w[some], (ward.values(form, ax, ay, i, o) * i[:, 2])[some] / density[some], rtol=1e-9
        )
        assert (w[~some & (i[:, 2] <= 0)] == 0).all()
        albedo = ward.albedo(form, ax, ay, np.radians(theta), np.radians(phi))
        assert w.mean() == pytest.approx(albedo, rel=4e-3)
        if form == kernels.BOUNDED:
            assert w.max() <= 2


def test_albedo_is_the_integral_over_directions():
    """The slow plain way: f cos_i over the hemisphere."""
    z = (np.arange(800) + 0.5) / 800
    azimuth = (np.arange(1600) + 0.5) * 2 * np.pi / 1600
    z, azimuth = (x.ravel() for x in np.meshgrid(z, azimuth, indexing="ij"))
    i = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)
    for form in range(3):
        for theta, phi in ((0, 0), (50, 30), (75, 100)):
            f = ward.values(form, 0.4, 0.2, i, direction(theta, phi))
            assert ward.albedo(form, 0.4, 0.2, np.radians(theta), np.radians(phi)) == pytest.approx(
                (f * z).mean() * 2 * np.pi, abs=1e-4
            )


def test_turning_everything_turns_nothing():
    """f for a turned tangent is f of directions turned back; half a turn of the tangent is none."""
    i, o = sphere(200, 4), sphere(200, 5)
    c, s = np.cos(0.7), np.sin(0.7)
    back = lambda w: np.stack([c * w[:, 0] + s * w[:, 1], c * w[:, 1] - s * w[:, 0], w[:, 2]], axis=1)
    assert ward.values(kernels.BOUNDED, 0.3, 0.3, back(i), back(o)) == pytest.approx(
        ward.values(kernels.BOUNDED, 0.3, 0.3, i, o), rel=1e-9
    )
    half = np.array([-1, -1, 1])
    assert ward.values(kernels.BOUNDED, 0.4, 0.1, i * half, o * half) == pytest.approx(
        ward.values(kernels.BOUNDED, 0.4, 0.1, i, o), rel=1e-12
    )


# ---- by difference ----


@pytest.mark.parametrize("form", range(3))
@pytest.mark.parametrize("step", [1e-4, 1e-5])
def test_derivatives(form, step):
    o = sphere(300, 6)
    rng = np.random.default_rng(7)
    for ax, ay in ALPHAS:
        i = np.array([ward.samples(ax, ay, w, *rng.random(2)) for w in o])
        some = i[:, 2] > 0.01
        i, eye = i[some], o[some]

        def log_f(a, b, phi=0.0, pair=(i, eye)):
            c, s = np.cos(phi), np.sin(phi)
            turned = [np.stack([c * w[:, 0] + s * w[:, 1], c * w[:, 1] - s * w[:, 0], w[:, 2]], axis=1) for w in pair]
            return np.log(ward.values(form, a, b, *turned))

        exact = ward.d_log_values(form, ax, ay, i, eye)
        h = step * min(ax, ay)
        numeric = np.stack(
            [
                (log_f(ax + h, ay) - log_f(ax - h, ay)),
                (log_f(ax, ay + h) - log_f(ax, ay - h)),
                (log_f(ax, ay, h) - log_f(ax, ay, -h)),
            ],
            axis=1,
        ) / (2 * h)
        assert numeric == pytest.approx(exact, rel=1e-5, abs=1e-4 / min(ax, ay))


def test_frames():
    rng = np.random.default_rng(8)
    for _ in range(200):
        n, t = rng.normal(size=(2, 3))
        n /= np.linalg.norm(n)
        for tangent in (t, 1e-200 * t, 1e200 * t):
            x, y = kernels.frame(n, tangent)
            assert np.array([x, y, n]) @ np.array([x, y, n]).T == pytest.approx(np.eye(3), abs=1e-12)
            assert np.cross(x, y) == pytest.approx(n, abs=1e-12)
            assert np.dot(x, t) > 0 and np.dot(y, t) == pytest.approx(0, abs=1e-12)
    for n in np.vstack([np.eye(3), -np.eye(3), direction(30, 40)[None]]):
        for tangent in (np.zeros(3), n, -5 * n, n + 1e-9, np.full(3, np.nan), np.array([np.inf, 0, 0])):
            x, y = kernels.frame(n, tangent)
            assert np.array([x, y, n]) @ np.array([x, y, n]).T == pytest.approx(np.eye(3), abs=1e-9)


# ---- at the edge ----


@pytest.mark.parametrize("form", range(3))
def test_everything_is_finite(form):
    """alpha from 1e-3 to 1, the horizon from both sides, retro-reflection, i = -o, and random numbers of 0 and 1."""
    tilts = [0, 1e-9, 45, 89, 89.9999, 90 - 1e-7, 90 - 1e-12, 90, 90 + 1e-12, 90 + 1e-7, 135, 180]
    some = np.concatenate([direction(theta, np.array([0.0, 37, 90, 180])) for theta in tilts])
    i, o = (x.reshape(-1, 3) for x in np.broadcast_arrays(some[:, None], some[None]))
    below = (i[:, 2] <= 0) | (o[:, 2] <= 0)
    for ax in (1e-3, 0.03, 1.0):
        for ay in (1e-3, 0.03, 1.0):
            f, w, d = (kernel(form, ax, ay, i, o) for kernel in (ward.values, ward.weights, ward.d_log_values))
            for x in (
                f,
                w,
                d,
                ward.pdfs(ax, ay, i, o),
                ward.pdfs(ax, ay, -o, o),
                ward.values(form, ax, ay, o, o),
                ward.values(form, ax, ay, -o, o),
            ):
                assert np.isfinite(x).all()
            assert (f >= 0).all() and (f[below] == 0).all() and (w[below] == 0).all()
            for eye in some:
                assert np.isfinite(ward.samples(ax, ay, eye, [0, 0, 0.5, 1, 1e-320], [0, 1, 0.25, 0.5, 0.125])).all()
            assert np.isfinite(ward.albedo(form, ax, ay, np.radians([0, 89.9, 90 - 1e-6, 90, 100]))).all()


@pytest.mark.parametrize(
    "form,exact",
    [(kernels.BOUNDED, lambda c: 1 / c**2), (kernels.WARD, lambda c: 1 / c), (kernels.DUER, lambda c: 1 / c**2)],
)
def test_in_the_mirror_and_straight_back(form, exact):
    """In the mirror's direction e = 0; straight back h = 2 o and tan h is that of o."""
    for alpha in (0.001, 0.1, 1.0):
        for theta in (0.0, 60, 89.99):
            o = direction(theta, 20)
            c = np.cos(np.radians(theta))
            peak = exact(c) / (4 * np.pi * alpha**2)
            assert ward.values(form, alpha, alpha, o * [-1, -1, 1], o) == pytest.approx(peak, rel=1e-9)
            back = peak * np.exp(-((np.tan(np.radians(theta)) / alpha) ** 2)) / (c**2 if form == kernels.BOUNDED else 1)
            assert ward.values(form, alpha, alpha, o, o) == pytest.approx(back, rel=1e-6, abs=1e-200)


def test_a_narrow_lobe_is_a_mirror():
    o = direction(50, 10)
    i = ward.samples(1e-3, 1e-3, o, [0.1, 0.5, 0.9], [0.1, 0.4, 0.7])
    assert i == pytest.approx(np.broadcast_to(o * [-1, -1, 1], (3, 3)), abs=0.01)
    assert ward.weights(kernels.BOUNDED, 1e-3, 1e-3, i, o) == pytest.approx(1, abs=0.01)
    assert ward.albedo(kernels.BOUNDED, 1e-3, 1e-3, np.radians(50)) == pytest.approx(1, abs=1e-4)


def test_kernels_are_for_kernels():
    @njit
    def kernel(form, n):
        x, y = kernels.frame(n, np.array([1.0, 0.0, 0.0]))
        i = kernels.sample(0.2, 0.1, 0.0, 0.6, 0.8, 0.3, 0.7)
        d = kernels.d_log_value(form, 0.2, 0.1, i[0], i[1], i[2], 0.0, 0.6, 0.8)
        return (
            (
                kernels.value(form, 0.2, 0.1, i[0], i[1], i[2], 0.0, 0.6, 0.8)
                * i[2]
                / kernels.pdf(0.2, 0.1, i[0], i[1], i[2], 0.0, 0.6, 0.8)
                - kernels.weight(form, 0.2, 0.1, i[0], i[1], i[2], 0.0, 0.6, 0.8)
            ),
            x[0] + y[1],
            d[0],
        )

    difference, two, _ = kernel(kernels.BOUNDED, np.array([0.0, 0.0, 1.0]))
    assert abs(difference) < 1e-12 and two == 2
