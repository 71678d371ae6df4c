"""Albedo maps of a checkered panel.

Against the true pattern, by law (units, noise, no holes), at the edge, and their files.
"""

import dataclasses
import json

import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import image
from lib.given.cameras import Camera
from lib.light import surface as surfaces
from lib.light.surface import backproject
from lib.picture import albedo_maps as textures
from lib.picture import albedo_maps_kernels as kernels
from tests.helpers import rooms
from tests.helpers.views import FRONT, SQUARE, look

GRAZING = ((0.5, -1.8, 0.4), (0.5, 0.5, 0))  # the middle is seen at 80 degrees from its normal
CELL = 0.1


def parity(xy):
    return np.floor(xy / CELL).sum(axis=-1) % 2


def checker(xy):
    """Two channels of checks on a slope, one of a slope alone. (..., 2) m -> (..., 3)"""
    a = 0.3 + 0.3 * parity(xy) + 0.2 * xy[..., 0]
    return np.stack([a, 0.8 * a, 0.5 + 0.3 * xy[..., 1]], axis=-1)


def on_floor(camera, q):
    """Where rays through q (..., 2) px meet z = 0: (..., 2) m."""
    v = camera.rays(q.reshape(-1, 2))
    return (camera.centre + v * (-camera.centre[2] / v[:, 2])[:, None])[:, :2].reshape(q.shape)


@dataclasses.dataclass
class Shot:
    surface: surfaces.Surface
    camera: Camera
    facet: np.ndarray
    usable: np.ndarray
    albedo: np.ndarray
    irradiance: np.ndarray
    constant: np.ndarray

    def map(self, noise=1e-4, linear=None, usable=None, constant=None, irradiance=None, wanted=(0,), **options):
        light = self.irradiance if irradiance is None else irradiance
        maps = textures.albedo_maps(
            self.surface,
            self.camera,
            self.facet,
            self.usable if usable is None else usable,
            self.albedo * light if linear is None else linear,
            light,
            noise,
            self.constant if constant is None else constant,
            wanted,
            **options,
        )
        assert list(maps) == list(wanted)
        for t in maps.values():
            assert all(np.isfinite(x).all() for x in (t.albedo, t.known, t.sigma, t.inside))
            assert (
                t.albedo.min() >= 0
                and t.albedo.max() <= 1
                and t.known.min() >= 0
                and t.known.max() <= 1
                and t.sigma.min() >= 0
            )
        return maps[wanted[0]]


def shoot(folder, view=FRONT, size=(128, 128), focal=120.0, pattern=checker, sub=8):
    """The exact picture of the square under uneven light, sub x sub rays a pixel.

    Pixels that show more than the panel are not usable.
    """
    surface = rooms.surface(folder / "model.obj", SQUARE)
    camera = look(*view, size, focal)
    albedo = np.zeros((size[1], size[0], pattern(np.zeros(2)).shape[-1]))
    whole, some = np.ones(albedo.shape[:2], bool), np.zeros(albedo.shape[:2], bool)
    for dx in (np.arange(sub) + 0.5) / sub - 0.5:
        for dy in (np.arange(sub) + 0.5) / sub - 0.5:
            xy = on_floor(camera, camera.pixels() + (dx, dy))
            hit = ((xy >= 0) & (xy <= 1)).all(axis=-1)
            albedo += pattern(xy) / sub**2
            whole &= hit
            some |= hit
    irradiance = np.broadcast_to(0.4 + 0.5 * camera.pixels()[..., :1] / size[0], albedo.shape)
    return Shot(
        surface,
        camera,
        np.where(some, 0, -1),
        whole,
        albedo,
        irradiance,
        albedo[whole if whole.any() else some].mean(axis=0),
    )


def places(shot, t):
    """Local places and model's x, y of all texels, (nu, nv, 3), (nu, nv, 2)."""
    s = shot.surface
    u, v = (((np.arange(n) + 0.5) / n) for n in t.known.shape)
    p = s.origin[0] + u[:, None, None] * s.size[0, 0] * s.axes[0, 0] + v[:, None] * s.size[0, 1] * s.axes[0, 1]
    return p, (p * s.local.diagonal + s.local.centre)[..., :2]


@pytest.fixture(scope="module")
def front(tmp_path_factory):
    return shoot(tmp_path_factory.mktemp("front"))


@pytest.fixture(scope="module")
def grazing(tmp_path_factory):
    return shoot(tmp_path_factory.mktemp("grazing"), GRAZING, (384, 128), 600.0, sub=6)


# -- against the true pattern


def test_error_falls_with_resolution(front, tmp_path):
    """Inside the checks the albedo is there at once; edges, a pixel wide, are a share of all texels that halves."""
    shots = [shoot(tmp_path, size=(48, 48), focal=45.0), front, shoot(tmp_path, size=(320, 320), focal=300.0, sub=4)]
    errors = []
    for shot in shots:
        t = shot.map()
        error = t.albedo - checker(places(shot, t)[1])
        errors.append(np.abs(error).mean())
        assert np.sqrt((error[..., 2] ** 2).mean()) < 3e-3  # the slope, which has no edges
        assert np.median(np.abs(error)) < 2e-3
        assert textures.mean(t) == pytest.approx(checker(places(shot, t)[1]).reshape(-1, 3).mean(axis=0), abs=1e-3)
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.5 * errors[1] and 1e-4 < errors[2] < 0.01


@pytest.mark.parametrize("name", ["front", "grazing"])
def test_no_holes_and_no_blur_beyond_a_pixel(name, request):
    """Where the photograph shows one check only within a pixel and a half around, the texel has that check's albedo.

    Every texel has an albedo of its own.
    """
    shot = request.getfixturevalue(name)
    t = shot.map()
    p, xy = places(shot, t)
    q = shot.camera.project(np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=2))
    around = np.stack(
        [
            parity(on_floor(shot.camera, q + (dx, dy)))
            for dx in np.linspace(-1.6, 1.6, 9)
            for dy in np.linspace(-1.6, 1.6, 9)
        ]
    )
    plain = (around == parity(xy)).all(axis=0)
    step = int(np.ceil(2 * max(t.known.shape) / 100))
    plain[:step], plain[-step:], plain[:, :step], plain[:, -step:] = (
        False,
        False,
        False,
        False,
    )  # the rim, continued from its neighbours
    assert plain.mean() > 0.15
    error = np.abs(t.albedo - checker(xy))[plain]
    assert error.max() < 0.012  # the slope over a pixel and a half is 0.01 at most
    assert t.known.min() > 0.3


def test_the_photograph_comes_back(front, grazing):
    """Looked up where its pixels are, a texture gives them again: two texels to a pixel lose less than one."""
    for shot in (front, grazing):
        pixel = np.flatnonzero(shot.usable)
        p, side = backproject(shot.surface, shot.camera, np.zeros(len(pixel), int), pixel)
        errors = [
            np.sqrt(
                np.mean((textures.lookup(shot.map(finer=finer), shot.surface, p, side) - shot.albedo[shot.usable]) ** 2)
            )
            for finer in (1, 2, 4)
        ]
        assert errors[0] > errors[1] > errors[2] and errors[1] < 0.013


def test_homography_is_backprojection(grazing):
    pixel = np.flatnonzero(grazing.usable)[::97]
    s = grazing.surface
    p, _ = backproject(s, grazing.camera, np.zeros(len(pixel), int), pixel)
    uv = (p - s.origin[0]) @ s.axes[0].T
    x, y, w = textures.homography(s, grazing.camera, 0) @ np.column_stack([uv, np.ones(len(uv))]).T
    assert (w > 0).all()
    assert np.column_stack([x / w, y / w]) == pytest.approx(np.column_stack([pixel % 384, pixel // 384]), abs=1e-6)


# -- by law


@pytest.mark.parametrize("relative", [0.03, 0.3])
def test_noise(front, relative):
    """Noise of 3 % goes into sigma, which is true.

    With noise of 30 %, texels are drawn to the constant and come out better than the photograph.
    """
    rng = np.random.default_rng(1)
    linear = front.albedo * front.irradiance
    noise = relative * linear.mean(axis=2)
    t = front.map(noise=noise, linear=linear + noise[..., None] * rng.normal(size=linear.shape))
    error = t.albedo - checker(places(front, t)[1])
    rms = np.sqrt((error**2).mean())
    assert 0.7 < rms / np.sqrt((t.sigma**2).mean()) < 1.3
    assert rms < (0.045 if relative < 0.1 else relative * 0.5)
    assert textures.mean(t) == pytest.approx(
        front.constant, abs=0.001 if relative < 0.1 else 0.02
    )  # bright pixels are noisier here: they count less


def test_noise_that_is_not_told_looks_like_texture_and_what_is_told_does_not(tmp_path):
    """A surface without texture is its constant, however noisy the photograph."""
    plain = shoot(tmp_path, pattern=lambda xy: np.full((*xy.shape[:-1], 3), 0.5), sub=1)
    linear = plain.albedo * plain.irradiance + 0.03 * np.random.default_rng(2).normal(size=plain.albedo.shape)
    t = plain.map(noise=0.03, linear=linear)
    assert np.abs(t.albedo - 0.5).max() < 0.01 and np.abs(t.albedo - 0.5).mean() < 1e-3
    assert plain.map(noise=0.003, linear=linear).albedo.std() > 0.03


def test_shading_is_divided_out(front):
    """The same albedo under other light; and a lamp of one colour tells one channel alone."""
    t = front.map()
    other = front.map(irradiance=np.broadcast_to(0.1 + front.camera.pixels()[..., 1:] / 40, front.albedo.shape))
    assert np.abs(other.albedo - t.albedo).max() < 1e-3
    red = front.map(irradiance=front.irradiance * [1.0, 0, 0])
    assert np.abs(red.albedo[..., 0] - t.albedo[..., 0]).max() < 1e-6
    assert np.abs(red.albedo[..., 1:] - front.constant[1:]).max() < 1e-6
    assert (red.known < 0.34).all() and np.median(red.known) > 0.25


def test_deep_shadow_does_no_harm(front):
    """Light so weak that noise drowns what it shows: the constant, also beside well lit pixels, and no pale rim."""
    light = front.irradiance * np.where(front.camera.pixels()[..., :1] > 64, 1e-4, 1.0)
    linear = front.albedo * light + 1e-3 * np.random.default_rng(3).normal(size=light.shape)
    t = front.map(noise=1e-3, linear=linear, irradiance=light)
    p, xy = places(front, t)
    x = front.camera.project(np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=2))[..., 0]
    assert np.abs(t.albedo[x > 72] - front.constant).max() < 1e-6 and t.known[x > 72].max() == 0
    lit = np.abs(t.albedo - checker(xy))[x < 63].mean()
    assert lit < 0.02 and t.known[x < 60].min() > 0.5


def test_units_do_not_matter(front, tmp_path):
    """Millimetres, or a thousand kilometres from the origin: the same texels."""
    t = front.map()
    for scale, offset in ((1000.0, 0.0), (1e-3, 0.0), (1.0, 1e6)):
        moved = rooms.surface(tmp_path / "moved.obj", SQUARE, scale=scale, offset=(offset, 0, 0))
        T = front.camera.T_cam_world.copy()
        T[:3, 3] = -T[:3, :3] @ (front.camera.centre * scale + (offset, 0, 0))
        camera = Camera(front.camera.K, front.camera.width, front.camera.height, T)
        other = dataclasses.replace(front, surface=moved, camera=camera).map()
        assert other.albedo.shape == t.albedo.shape
        assert np.abs(other.albedo - t.albedo).max() < (1e-4 if offset else 1e-6)
        assert other.corners == pytest.approx(t.corners * scale + (offset, 0, 0), abs=1e-8 * max(scale, offset))


def test_both_sides_and_seen_from_behind(tmp_path):
    """A panel is one texture: from below the same texels as from above."""
    above, below = (shoot(tmp_path, ((0.5, 0.5, z), (0.5, 0.5001, 0))) for z in (1.1, -1.1))
    a, b = above.map(), below.map()
    assert a.albedo.shape == b.albedo.shape and np.abs(a.albedo - b.albedo).mean() < 0.01
    p, _ = places(above, a)
    p = p.reshape(-1, 3)[::50]
    assert (
        textures.lookup(a, above.surface, p, np.zeros(len(p), int))
        == textures.lookup(a, above.surface, p, np.ones(len(p), int))
    ).all()
    with pytest.raises(ValueError):
        textures.lookup(a, above.surface, p, np.full(len(p), 2))


# -- where the data are poor


def test_occluded_half_has_the_constant(front):
    hidden = front.camera.pixels()[..., 0] > 64
    linear = np.where(hidden[..., None], 77.0, front.albedo * front.irradiance)
    constant = np.array([0.45, 0.35, 0.62])
    t = front.map(usable=front.usable & ~hidden, linear=linear, constant=constant)
    _, xy = places(front, t)
    x = front.camera.project(np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=2))[..., 0]
    far = x > 64 + kernels.REACH + 1.01
    assert far.any() and np.abs(t.albedo[far] - constant).max() < 1e-6 and t.known[far].max() == 0
    whole = front.map(constant=constant)
    seen = x < 62
    change = np.abs(t.albedo - whole.albedo)[seen]
    assert (
        np.median(change) < 1e-6 and change.max() < 0.01
    )  # at the panel's rim, continued by what the half says of its correlation
    between = ~far & ~seen  # it fades from one to the other
    t_known = [t.known[between & (np.abs(x - at) < 0.5)].mean() for at in (64, 66, 68, 70)]
    assert all(np.diff(t_known) < 0)
    spread = np.sqrt(((checker(xy) - constant) ** 2)[far].mean())
    assert np.sqrt((t.sigma[far] ** 2).mean()) == pytest.approx(
        spread, rel=0.35
    )  # the hidden half varies more than the seen one


def test_saturated_spot_is_filled_from_around(front):
    """A highlight three pixels wide: the texture goes on; nothing of the clipped values gets in."""
    q = front.camera.pixels()
    spot = np.abs(q - (40, 71)).max(axis=-1) <= 1
    t, whole = (
        front.map(usable=front.usable & ~spot, linear=np.where(spot[..., None], 1.0, front.albedo * front.irradiance)),
        front.map(),
    )
    change = np.abs(t.albedo - whole.albedo)
    _, xy = places(front, t)
    away = (
        np.abs(front.camera.project(np.concatenate([xy, np.zeros((*xy.shape[:2], 1))], axis=2)) - (40, 71)).max(axis=-1)
        > 2.01
    )
    assert change[away].max() < 1e-3 and 0 < change[~away].max() < 0.3
    assert np.abs(change[~away][:, 2]).max() < 0.02  # the slope goes on through it
    assert t.known[~away].min() < whole.known[~away].min()


def test_nothing_usable(front):
    constant = np.array([0.2, 0.3, 0.4])
    for t in (
        front.map(usable=np.zeros_like(front.usable), constant=constant),
        front.map(irradiance=np.zeros_like(front.irradiance), constant=constant),
        front.map(linear=np.full(front.albedo.shape, np.nan), constant=constant),
        front.map(noise=np.inf, constant=constant),
    ):
        assert (
            np.abs(t.albedo - constant).max() < 1e-6 and not t.known.any() and t.sigma == pytest.approx(textures.UNSEEN)
        )
        assert t.clipped == 0 and textures.mean(t) == pytest.approx(constant)


def test_a_facet_of_one_pixel(front):
    """Its pixel where it is, the constant elsewhere; and a facet that no pixel shows is one texel of it."""
    one = np.zeros_like(front.usable)
    one[64, 40] = True
    t = front.map(usable=one)
    at = on_floor(front.camera, np.array([40.0, 64.0]))
    p = front.surface.local.points([[*at, 0.0]])
    assert textures.lookup(t, front.surface, p)[0] == pytest.approx(front.albedo[64, 40], abs=0.05)
    assert (t.known > 0).mean() < 0.01
    small = dataclasses.replace(front, facet=np.where(one, 0, -1))
    assert small.map().albedo.shape == t.albedo.shape
    none = dataclasses.replace(front, facet=np.full_like(front.facet, -1)).map()
    assert none.albedo.shape == (1, 1, 3) and none.albedo[0, 0] == pytest.approx(front.constant)


def test_a_far_facet_is_one_texel(tmp_path):
    """The whole panel in less than a pixel."""
    shot = shoot(tmp_path, ((0.5, 0.5, 400), (0.5, 0.5001, 0)), size=(9, 9), focal=100.0, sub=8)
    usable = np.zeros_like(shot.usable)
    usable[4, 4] = True
    t = dataclasses.replace(shot, constant=np.full(3, 0.5)).map(
        usable=usable, linear=np.full((9, 9, 3), 0.3) * shot.irradiance
    )
    assert t.albedo.shape == (1, 1, 3) and t.albedo[0, 0] == pytest.approx(0.3, abs=0.02)


def test_a_facet_edge_on_or_behind_the_camera(front, tmp_path):
    for eye, target in (((0.5, -1, 0), (0.5, 1, 0)), ((0.5, 0.5, 1), (0.5, 0.6, 3))):
        blind = dataclasses.replace(front, camera=look(eye, target, (128, 128), 120.0))
        t = blind.map()  # pixels say that they show it: they cannot
        assert np.abs(t.albedo - front.constant).max() < 0.5
        t = blind.map(usable=np.zeros_like(front.usable))
        assert np.abs(t.albedo - front.constant).max() < 1e-6


def test_a_camera_on_the_panel(tmp_path):
    """Texels from below the feet to the horizon, some behind the camera: those that the photograph shows are known."""
    shot = shoot(tmp_path, ((0.5, 0.3, 0.05), (0.5, 1.0, 0.03)), size=(96, 64), focal=60.0)
    sky = ~np.isfinite(shot.albedo).all(axis=2) | (shot.facet < 0)
    t = shot.map(usable=shot.usable & ~sky)
    _, xy = places(shot, t)
    assert (
        t.known[xy[..., 1] < 0.29].max() == 0
        and t.known[(np.abs(xy[..., 0] - 0.5) < 0.1) & (xy[..., 1] > 0.5) & (xy[..., 1] < 0.9)].min() > 0.2
    )
    error = np.abs(t.albedo - checker(xy))[..., 2]
    assert error[t.known > 0.4].max() < 0.05


def test_albedos_outside_the_unit_interval_are_clipped_and_counted(front):
    bright = front.map(linear=front.albedo * front.irradiance * 1.5)
    assert 0 < bright.clipped < bright.known.size and bright.albedo.max() == 1
    assert front.map().clipped == 0


def test_one_channel(front):
    grey = dataclasses.replace(
        front, albedo=front.albedo[..., :1], irradiance=front.irradiance[..., :1], constant=front.constant[:1]
    )
    assert grey.map().albedo == pytest.approx(front.map().albedo[..., :1], abs=1e-6)


def test_many_facets_at_once_and_a_size_limit(tmp_path):
    """A box: each side its own map in its own frame, in the order asked for."""
    surface = rooms.surface(tmp_path / "box.obj", rooms.solid("box", 0, 0, 0, 1, 1, 1))
    camera = look((3, 2.5, 2.2), (0.5, 0.5, 0.5), (160, 120), 200.0)
    v = camera.rays(camera.pixels().reshape(-1, 2)).astype(np.float32)
    rays = np.hstack([np.broadcast_to(surface.local.points(camera.centre), v.shape).astype(np.float32), v])
    triangle, _ = surface.caster.closest(rays)
    facet = np.where(triangle >= 0, surface.facet[triangle], -1).reshape(120, 160)
    p, _ = backproject(surface, camera, np.maximum(facet, 0).ravel(), np.arange(facet.size))
    world = (p * surface.local.diagonal + surface.local.centre).reshape(120, 160, 3)
    albedo = 0.2 + 0.6 * np.clip(world, 0, 1) * [1, 0.5, 0.25]
    wanted = [int(f) for f in np.flatnonzero(np.bincount(facet[facet >= 0]) > 50)][::-1]
    assert len(wanted) == 3
    maps = textures.albedo_maps(
        surface,
        camera,
        facet,
        facet >= 0,
        albedo,
        np.ones_like(albedo),
        1e-4,
        albedo[facet >= 0].mean(axis=0),
        wanted,
        most=40,
    )
    assert list(maps) == wanted
    for f, t in maps.items():
        assert max(t.known.shape) == 40 and t.facet == f
        inner = facet == f
        back = textures.lookup(t, surface, p[inner.ravel()])
        assert np.abs(back - albedo[inner]).max() < 0.03 and np.abs(back - albedo[inner]).mean() < 0.004
        assert np.linalg.norm(t.corners[1:] - t.corners[0], axis=1) == pytest.approx([1, 1], abs=1e-3)


# -- reading


def a_texture(nu=5, nv=3, C=3, facet=7):
    rng = np.random.default_rng(nu + 10 * nv)
    return textures.AlbedoMap(
        facet,
        rng.random((nu, nv, C), np.float32),
        rng.random((nu, nv), np.float32),
        rng.random((nu, nv), np.float32),
        np.ones((nu, nv), np.float32),
        rng.random(C),
        np.array([[1e6 + 0.1, 2, 3], [1e6 + 2.1, 2, 3], [1e6 + 0.1, 4.5, 3]]),
        4,
    )


def test_lookup_by_hand(front):
    s = front.surface
    at = lambda *uv: s.origin[0] + np.array(uv) * s.size[0] @ s.axes[0]
    t = dataclasses.replace(a_texture(2, 2, 1, facet=0), albedo=np.array([[[0.0], [0.2]], [[0.4], [1.0]]], np.float32))
    value = lambda *uv: textures.lookup(t, s, at(*uv)[None])[0, 0]
    assert [value(0.25, 0.25), value(0.25, 0.75), value(0.75, 0.25), value(0.75, 0.75)] == pytest.approx(
        [0, 0.2, 0.4, 1.0], abs=1e-6
    )
    assert value(0.5, 0.5) == pytest.approx(0.4) and value(0.5, 0.25) == pytest.approx(0.2)
    assert [value(-3, 0), value(0, 9), value(1.0, 1.0)] == pytest.approx([0, 0.2, 1.0], abs=1e-6)
    assert np.isfinite(textures.lookup(t, s, [[np.nan, 0, 0], [np.inf, 0, 0]])).all()
    assert textures.lookup(t, s, np.zeros((0, 3))).shape == (0, 1)
    one = dataclasses.replace(t, albedo=np.full((1, 1, 1), 0.3, np.float32))
    assert textures.lookup(one, s, at(0.9, 0.1)[None]) == pytest.approx(0.3)


def test_mean_of_a_triangle(tmp_path):
    """The mean of a slope over a triangle is its value at the centroid: the rest of the rectangle does not count."""
    surface = rooms.surface(tmp_path / "triangle.obj", rooms.panel("panel", (0, 0, 0), (1, 0, 0), (0, 1, 0)))
    camera = look(*FRONT, (128, 128), 100.0)
    xy = on_floor(camera, camera.pixels())
    inside = (xy > 0).all(axis=-1) & (xy.sum(axis=-1) < 1)
    albedo = np.where(inside, 0.1 + 0.5 * xy[..., 0], 0.0)[..., None]
    t = textures.albedo_maps(
        surface, camera, np.where(inside, 0, -1), inside, albedo, np.ones_like(albedo), 1e-4, [0.27], [0]
    )[0]
    assert textures.mean(t) == pytest.approx(0.1 + 0.5 / 3, abs=2e-3)
    assert t.inside.mean() * np.prod(surface.size[0]) * surface.local.diagonal**2 == pytest.approx(0.5, rel=2e-3)


# -- files


@pytest.mark.parametrize("shape", [(5, 3, 3), (5, 3, 1), (1, 1, 3), (64, 200, 1)])
def test_round_trip(tmp_path, shape):
    t = a_texture(*shape)
    path = textures.write(tmp_path / "new", t)
    assert path == str(tmp_path / "new" / "texture-7.exr")
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == [
        "texture-7.exr",
        "texture-7.json",
        "texture-7.known.exr",
        "texture-7.png",
    ]
    back = textures.read(path)
    for field in dataclasses.fields(t):
        assert np.array_equal(getattr(back, field.name), getattr(t, field.name)), field.name
    assert back.albedo.dtype == np.float32


def test_found_again_after_writing(front, tmp_path):
    t = front.map()
    back = textures.read(textures.write(tmp_path, t))
    p = places(front, t)[0].reshape(-1, 3)[::7]
    assert (textures.lookup(back, front.surface, p) == textures.lookup(t, front.surface, p)).all()


def test_the_picture_shows_the_panel_as_its_front_is_seen(front, tmp_path):
    """The corners of the picture and of the JSON beside it are the model's: the albedo there is the pattern's."""
    slope = dataclasses.replace(
        front,
        albedo=np.stack(
            [
                0.1 + 0.4 * on_floor(front.camera, front.camera.pixels())[..., 0],
                0.1 + 0.4 * on_floor(front.camera, front.camera.pixels())[..., 1],
                np.full((128, 128), 0.5),
            ],
            axis=-1,
        ),
    )
    path = textures.write(tmp_path, slope.map())
    picture = image.read_exr(path)
    shown = image.read_photograph(path.replace(".exr", ".png")).values
    place = json.loads((tmp_path / "texture-0.json").read_text())
    corner = {name: np.array(p) for name, p in place["corners"].items()}
    assert place["unit"] == "m" and picture.shape == (place["height"], place["width"], 3)
    for name, texel in (
        ("top_left", (0, 0)),
        ("top_right", (0, -1)),
        ("bottom_left", (-1, 0)),
        ("bottom_right", (-1, -1)),
    ):
        assert picture[texel][:2] == pytest.approx(0.1 + 0.4 * corner[name][:2], abs=0.01)
        assert shown[texel][0] == pytest.approx(1.055 * picture[texel][0] ** (1 / 2.4) - 0.055, abs=0.003)
    right, up = corner["bottom_right"] - corner["bottom_left"], corner["top_left"] - corner["bottom_left"]
    assert np.cross(right, up)[2] > 0  # towards us, as the panel's normal


def test_a_file_is_whole_or_absent(tmp_path):
    t = a_texture()
    with pytest.raises(ValueError):
        textures.write(tmp_path, dataclasses.replace(t, constant=np.array([np.nan, 0, 0])))
    assert list(tmp_path.iterdir()) == []


def test_damaged_files_are_refused(tmp_path):
    t = a_texture()
    path = textures.write(tmp_path, t)
    good = (tmp_path / "texture-7.json").read_text()
    with pytest.raises(BadInput, match="no such file"):
        textures.read(tmp_path / "texture-8.exr")
    for bad in (
        good.replace('"facet": 7', '"facet": null'),
        good.replace('"top_left"', '"top"'),
        good.replace('"width": 5', '"width": 6'),
        "{",
    ):
        assert bad != good
        (tmp_path / "texture-7.json").write_text(bad)
        with pytest.raises(BadInput, match="texture-7"):
            textures.read(path)
    (tmp_path / "texture-7.json").write_text(good)
    image.write_exr(path, np.full((3, 5, 3), 1.5))
    with pytest.raises(BadInput, match="outside"):
        textures.read(path)
