"""Textures, the last rung of the ladder (section 5 of the paper asks for them): an albedo map for each facet, in the facet's own plane.

The photograph's linear values divided by the irradiance of each pixel are albedos, seen in perspective. `albedo_maps` resamples them
into a grid of texels over the facet's bounding rectangle: every texel takes the mean of the pixels around its place in the photograph
under a tent of one pixel, or of one texel where that is larger. So nothing is blurred by more than a pixel and there are no holes,
however glancing the view: there a pixel is spread over the many texels that it covers.

Where the photograph says little, the group's constant m stays. The texture varies about m with the variance tau^2, which its pixels
tell (their variance less their noise); the best linear estimate of a texel whose mean a has noise of variance s^2 is then

    m + k (a - m),        k = tau^2 / (tau^2 + s^2),        and tau^2 (1 - k) of its variance is left.

A texel d pixels away from the next usable pixel (the border of a facet, a saturated spot) takes the value from there as far as the texture is
correlated over that distance, m + k c(d) (a - m), with tau^2 (1 - k c^2) left, and beyond REACH pixels it has the constant. A surface without texture
is all constant, and so is one whose noise drowns it. What is finer than a pixel no photograph tells: about half of what neighbouring pixels
do not share, tau^2 (1 - c(1)) / 2, is left in any case.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import image
from lib.light.surface import Surface
from lib.picture import albedo_maps_kernels as kernels

FINER = 2.0  # texels to the side of a pixel of middle size: bilinear look-ups then lose little of what a pixel shows
MOST = 2048  # texels to a side, at most
DROWNED = 1e3  # noise variances against the texture's: beyond, a pixel says nothing
UNSEEN = 12**-0.5  # spread of what no pixel shows: anything between 0 and 1
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class AlbedoMap:
    """The albedo of one facet, the same on both its sides. Texel (i, j) has its centre at u = (i + 1/2) / nu of the bounding
    rectangle's axis 0 and v = (j + 1/2) / nv of its axis 1 (surface.Surface: origin, axes, size)."""

    facet: int  # from 0
    albedo: np.ndarray  # (nu, nv, C) float32 in [0, 1]
    known: (
        np.ndarray
    )  # (nu, nv) float32 in [0, 1]: share of the texture's variance that the photograph tells; 0: the constant
    sigma: np.ndarray  # (nu, nv) float32, standard deviation, quadratic mean of the channels
    inside: np.ndarray  # (nu, nv) float32 in [0, 1]: share of the texel that lies in the facet
    constant: np.ndarray  # (C,) the group's
    corners: np.ndarray  # (3, 3) m, model's frame: the rectangle's corner (u, v) = (0, 0), then (1, 0), then (0, 1)
    clipped: int  # texels in the facet whose albedo lay outside [0, 1]


def albedo_maps(
    surface: Surface, camera, facet, usable, linear, irradiance, noise, constant, wanted, *, finer=FINER, most=MOST
) -> dict:
    """{facet number: Texture} of the wanted facets, which belong to one group.

    facet : (H, W) int, -1 = nothing;  usable : (H, W) bool, shows that facet alone, neither black nor saturated
    linear : (H, W, C) the photograph, camera-referred;  irradiance : (H, W, C) so that linear = albedo * irradiance
    noise : standard deviation of `linear`, a number, (H, W) or (H, W, C);  constant : (C,) the group's mean reflectance
    finer : texels to the side of a pixel of middle size;  most : texels to a side at most

    A pixel without light in a channel says nothing about that channel. No value is ever NaN.
    """
    facet = np.asarray(facet)
    linear, irradiance = np.asarray(linear, float), np.asarray(irradiance, float)
    noise = np.asarray(noise, float)
    noise = np.broadcast_to(noise[..., None] if noise.ndim == 2 else noise, linear.shape)
    constant = np.clip(np.broadcast_to(np.asarray(constant, float), linear.shape[2:]), 0, 1)
    start, order = _by_facet(surface)
    return {
        int(f): _of_facet(
            surface,
            camera,
            int(f),
            facet == f,
            usable,
            linear,
            irradiance,
            noise,
            constant,
            order[start[f] : start[f + 1]],
            finer,
            most,
        )
        for f in wanted
    }


def _of_facet(surface, camera, f, shown, usable, linear, irradiance, noise, constant, triangles, finer, most):
    H = homography(surface, camera, f)
    used = shown & usable
    window = _window(used)
    light, value, sigma = irradiance[window], linear[window], noise[window]
    lit = used[window][..., None] & (light > 0) & np.isfinite(value) & np.isfinite(light) & np.isfinite(sigma)
    a = np.divide(value, light, out=np.zeros(light.shape), where=lit)
    variance = np.divide(sigma, light, out=np.full(light.shape, np.inf), where=lit) ** 2
    lit &= np.isfinite(variance) & (np.abs(a) < 1e6)
    tau2 = np.array(
        [_own_variance(a[lit[..., c], c] - constant[c], variance[lit[..., c], c]) for c in range(len(constant))]
    )
    lit &= variance < DROWNED * np.maximum(tau2, TINY)
    variance[~lit] = np.inf
    correlation = np.stack(
        [_correlation(a[..., c] - constant[c], variance[..., c], tau2[c]) for c in range(len(constant))]
    )
    nu, nv = _grid(H, surface.size[f], used if used.any() else shown, finer, most)
    du, dv = surface.size[f] / (nu, nv)
    albedo, known, left = (
        np.empty((nu, nv, len(constant)), np.float32),
        np.empty((nu, nv), np.float32),
        np.empty((nu, nv), np.float32),
    )
    near = _distance(lit.any(axis=2))
    kernels.resample(
        H, du, dv, window[1].start, window[0].start, a, variance, near, constant, tau2, correlation, albedo, known, left
    )
    uv = np.einsum("tcj,aj->tca", surface.corners[triangles] - surface.origin[f], surface.axes[f]) / np.maximum(
        surface.size[f], 1e-300
    )
    inside = kernels.inside_share(uv, nu, nv)
    outside = ((albedo < 0) | (albedo > 1)).any(axis=2)
    local = surface.local
    corners = (
        surface.origin[f]
        + np.stack([np.zeros(3), surface.size[f, 0] * surface.axes[f, 0], surface.size[f, 1] * surface.axes[f, 1]])
    ) * local.diagonal + local.centre
    return AlbedoMap(
        f,
        np.clip(albedo, 0, 1),
        known,
        np.sqrt(left),
        inside,
        constant.copy(),
        corners,
        int((outside & (inside > 0)).sum()),
    )


def _by_facet(surface):
    order = np.argsort(surface.facet, kind="stable")
    return np.searchsorted(surface.facet[order], np.arange(len(surface.normal) + 1)), order


def homography(surface: Surface, camera, f):
    """(3, 3): of (u, v, 1) in a facet's plane, local lengths from its origin along its axes, to pixels (x w, y w, w); w > 0 in front of the camera."""
    eye = surface.local.points(camera.centre)
    return camera.K @ camera.T_cam_world[:3, :3] @ np.stack([*surface.axes[f], surface.origin[f] - eye], axis=1)


def _window(used):
    """Slices of rows and columns around the used pixels, with the margin that their texture may reach over."""
    if not used.any():
        return slice(0, 0), slice(0, 0)
    rows, columns = np.flatnonzero(used.any(axis=1)), np.flatnonzero(used.any(axis=0))
    return tuple(
        slice(max(0, int(at[0]) - kernels.REACH - 1), int(at[-1]) + kernels.REACH + 2) for at in (rows, columns)
    )


def _own_variance(off, variance, iterations=30):
    """tau^2 of deviations (n,) from the constant whose noise has these variances: the pixels' mean, weighted as it is best for that tau^2."""
    if len(off) == 0:
        return UNSEEN**2
    tau2 = 0.01
    for _ in range(iterations):
        w = (tau2 + variance + TINY) ** -2
        before, tau2 = tau2, max(0.0, float((w * (off**2 - variance)).sum() / w.sum()))
        if abs(tau2 - before) <= 1e-4 * tau2:
            break
    return tau2


def _correlation(off, variance, tau2):
    """(REACH + 2,) correlation of the texture at distances of 0, 1, ... pixels, never rising; the noise of two pixels has none."""
    result = np.zeros(kernels.REACH + 2)
    result[0] = 1.0
    weight = 1 / (tau2 + variance + TINY)  # 0 where unknown
    for d in range(1, kernels.REACH + 2):
        products = weights = 0.0
        for one, other in ((np.s_[:, d:], np.s_[:, :-d]), (np.s_[d:], np.s_[:-d])):
            w = weight[one] * weight[other]
            products += (w * off[one] * off[other]).sum()
            weights += w.sum()
        result[d] = products / (weights * tau2) if weights * tau2 > 0 else 0.0
    return np.minimum.accumulate(np.clip(result, 0, 1))


def _grid(H, size, pixels, finer, most):
    """(nu, nv): so many texels that one step along either axis is 1 / finer pixels long in the photograph, half-way through the pixels."""
    y, x = np.nonzero(pixels)
    if len(y) == 0 or abs(np.linalg.det(H)) < 1e-12 * np.prod(np.linalg.norm(H, axis=0)):
        return 1, 1
    u, v, w = np.linalg.solve(H, np.stack([x, y, np.ones(len(x))]).astype(float))
    scale = H[2, 0] * u + H[2, 1] * v + H[2, 2] * w
    good = scale * w > 0
    if not good.any():
        return 1, 1
    steps = [
        np.median(np.hypot(H[0, a] - x[good] * H[2, a], H[1, a] - y[good] * H[2, a]) * np.abs(w / scale)[good])
        for a in (0, 1)
    ]  # px per length
    return tuple(int(np.clip(np.ceil(finer * s * length), 1, most)) for s, length in zip(steps, size))


def _distance(known):
    """(h, w) float32: pixels from each pixel to the next known one."""
    from scipy.ndimage import distance_transform_edt

    return (
        distance_transform_edt(~known).astype(np.float32) if known.any() else np.full(known.shape, np.inf, np.float32)
    )


# -- reading a texture


def lookup(texture: AlbedoMap, surface: Surface, p, side=None):
    """Albedo (M, C) at places p (M, 3), local, on the texture's facet: bilinear between texels' centres, constant beyond the outermost.

    side : (M,), where given, must be the facet's front or back: they reflect alike
    """
    f = texture.facet
    if side is not None and (np.asarray(side) // 2 != f).any():
        raise ValueError(f"lookup: not all sides are those of facet {f}")
    uv = (
        (np.nan_to_num(np.asarray(p, float), posinf=0, neginf=0) - surface.origin[f])
        @ surface.axes[f].T
        / np.maximum(surface.size[f], 1e-300)
    )
    return kernels.bilinear_many(np.ascontiguousarray(texture.albedo), uv)


def mean(texture: AlbedoMap):
    """(C,) area mean of the albedo over the facet."""
    w = texture.inside.astype(float)
    if not w.sum() > 0:  # a sliver between the points of all texels
        w = np.ones(w.shape)
    return np.einsum("ij,ijc->c", w, texture.albedo.astype(float)) / w.sum()


# -- texture-<facet>.exr and what lies beside it


def paths(folder, facet):
    """The four files of a texture: the albedo, known / sigma / inside, the picture to look at, its place."""
    return tuple(
        os.path.join(os.fspath(folder), f"texture-{facet}{end}") for end in (".exr", ".known.exr", ".png", ".json")
    )


def _picture(grid):
    """Texels as a picture: seen from the facet's front axis 0 runs to the right and axis 1 upwards, so that row 0 is the end of axis 1."""
    return np.swapaxes(grid, 0, 1)[::-1]


def _texels(picture):
    return np.ascontiguousarray(np.swapaxes(picture, 0, 1)[:, ::-1], np.float32)


def write(folder, texture: AlbedoMap):
    """texture-<facet>.exr (linear albedo; Y, or R G B), .known.exr (R known, G sigma, B inside), .png (8-bit, sRGB-coded, to look at) and
    .json (where it lies). All of them or none; returns the path of the first."""
    from lib.given.transfer import Transfer

    nu, nv = texture.known.shape
    origin, along_u, along_v = texture.corners
    place = {
        "facet": texture.facet,
        "frame": "model",
        "unit": "m",
        "seen_from": "front",
        "corners": {
            "top_left": along_v,
            "top_right": along_u + along_v - origin,
            "bottom_left": origin,
            "bottom_right": along_u,
        },
        "width": nu,
        "height": nv,
        "constant": texture.constant,
        "mean": mean(texture),
        "clipped": texture.clipped,
    }
    names = paths(folder, texture.facet)
    with artefact.writing_all(*names) as (exr, known, png, json):
        image.write_exr(exr, _picture(texture.albedo))
        image.write_exr(known, _picture(np.stack([texture.known, texture.sigma, texture.inside], axis=2)))
        image.write_png8(
            png, np.rint(255 * Transfer("srgb").display(_picture(texture.albedo).astype(float))).astype(np.uint8)
        )
        artefact.write_json(json, place)
    return names[0]


def read(path) -> AlbedoMap:
    """The texture whose albedo is at path, texture-<facet>.exr, checked."""
    path = os.fspath(path)
    stem = path[: -len(".exr")] if path.endswith(".exr") else path
    place = artefact.read_json(stem + ".json")
    albedo, more = image.read_exr(path), image.read_exr(stem + ".known.exr")
    albedo = albedo[..., None] if albedo.ndim == 2 else albedo
    try:
        facet, size, clipped = int(place["facet"]), (int(place["height"]), int(place["width"])), int(place["clipped"])
        corners = np.array(
            [place["corners"][name] for name in ("bottom_left", "bottom_right", "top_left")], float
        ).reshape(3, 3)
        constant = np.array(place["constant"], float).reshape(albedo.shape[2])
    except (KeyError, TypeError, ValueError) as error:
        raise BadInput(f"{stem}.json: {error}: not the place of a texture") from None
    if albedo.shape[:2] != size or more.shape != (*size, 3):
        raise BadInput(
            f"{path}: {albedo.shape[:2]} texels, {stem}.known.exr: {more.shape[:2]}, but {stem}.json says {size}"
        )
    for name, values, high in ((path, albedo, 1), (stem + ".known.exr", more, np.inf)):
        if not (np.isfinite(values) & (values >= 0) & (values <= high)).all():
            raise BadInput(f"{name}: a value is not finite or outside [0, {high}]")
    return AlbedoMap(facet, _texels(albedo), *(_texels(more[..., k]) for k in range(3)), constant, corners, clipped)
