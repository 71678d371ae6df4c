"""Textures, the last rung of the ladder (§5 asks for them): an albedo map for each facet, in the facet's own plane.

The photograph's linear values divided by the irradiance of each pixel are albedos, seen in perspective. `albedo_maps`
resamples them into a grid of texels over the facet's bounding rectangle. Every texel takes the mean of the pixels
around its place in the photograph, under a tent of one pixel, or of one texel where that is larger. So nothing is
blurred by more than a pixel, and there are no holes: at a glancing view a pixel is spread over the many texels that it
covers.

Where the photograph says little, the group's constant m stays. The texture varies about m with the variance tau^2,
which its pixels tell: their variance less their noise. The best linear estimate of a texel whose mean a has noise of
variance s^2 is then

    m + k (a - m),        k = tau^2 / (tau^2 + s^2),        and tau^2 (1 - k) of its variance is left.

A texel d pixels away from the next usable pixel (the border of a facet, a saturated spot) takes the value from there as
far as the texture is correlated over that distance: m + k c(d) (a - m), with tau^2 (1 - k c^2) left. Beyond REACH
pixels it has the constant. A surface without texture is all constant, and so is one whose noise drowns it. What is
finer than a pixel no photograph tells: about half of what neighbouring pixels do not share, tau^2 (1 - c(1)) / 2, is
left in any case.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import image
from lib.given.transfer import srgb_from_linear
from lib.light.surface import Surface
from lib.picture import albedo_maps_kernels as kernels
from lib.picture.albedo_maps_kernels import Grid, Prior, Samples

FINER = 2.0  # texels to the side of a pixel of middle size: bilinear look-ups then lose little of what a pixel shows
MOST = 2048  # texels to a side, at most
DROWNED = 1e3  # noise variances against the texture's: beyond, a pixel says nothing
UNSEEN = 12**-0.5  # spread of what no pixel shows: anything between 0 and 1
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class AlbedoMap:
    """The albedo of one facet, the same on both its sides.

    Texel (i, j) has its centre at u = (i + 1/2) / nu of the bounding rectangle's axis 0 and v = (j + 1/2) / nv of its
    axis 1 (surface.Surface: origin, axes, size).
    """

    facet: int  # from 0
    albedo: np.ndarray  # (nu, nv, C) float32 in [0, 1]
    # (nu, nv) float32 in [0, 1]: share of the texture's variance that the photograph tells; 0: the constant
    known: np.ndarray
    sigma: np.ndarray  # (nu, nv) float32, standard deviation, quadratic mean of the channels
    inside: np.ndarray  # (nu, nv) float32 in [0, 1]: share of the texel that lies in the facet
    constant: np.ndarray  # (C,) the group's
    corners: np.ndarray  # (3, 3) m, model's frame: the rectangle's corner (u, v) = (0, 0), then (1, 0), then (0, 1)
    clipped: int  # texels in the facet whose albedo lay outside [0, 1]


def albedo_maps(
    surface: Surface, camera, facet, usable, linear, irradiance, noise, constant, wanted, *, finer=FINER, most=MOST
) -> dict:
    """{facet number: AlbedoMap} of the wanted facets, which belong to one group.

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
    photograph = _Lit(linear, irradiance, noise)
    return {
        int(f): _of_facet(surface, camera, int(f), facet == f, usable, photograph, constant, finer, most)
        for f in wanted
    }


class _Lit(NamedTuple):
    """The photograph and its light, all (H, W, C)."""

    linear: np.ndarray
    irradiance: np.ndarray
    noise: np.ndarray


def _of_facet(surface, camera, f, shown, usable, photograph, constant, finer, most):
    H = homography(surface, camera, f)
    used = shown & usable
    window = _window(used)
    samples, prior = _samples(used[window], _Lit(*(values[window] for values in photograph)), constant)
    nu, nv = _grid(H, surface.size[f], used if used.any() else shown, finer, most)
    du, dv = surface.size[f] / (nu, nv)
    grid = Grid(H, nu, nv, du, dv, window[1].start, window[0].start)
    albedo, known, left = kernels.resample(grid, samples, prior)
    flat = np.einsum("tcj,aj->tca", surface.corners[surface.facet == f] - surface.origin[f], surface.axes[f])
    inside = kernels.inside_share(flat / np.maximum(surface.size[f], 1e-300), nu, nv)
    outside = ((albedo < 0) | (albedo > 1)).any(axis=2)
    clipped = int((outside & (inside > 0)).sum())
    corners = _rectangle(surface, f)
    return AlbedoMap(f, np.clip(albedo, 0, 1), known, np.sqrt(left), inside, constant.copy(), corners, clipped)


def _samples(used, photograph: _Lit, constant):
    """Samples, and the Prior that they tell.  used : (h, w) bool"""
    value, light, sigma = photograph
    lit = used[..., None] & (light > 0) & np.isfinite(value) & np.isfinite(light) & np.isfinite(sigma)
    a = np.divide(value, light, out=np.zeros(light.shape), where=lit)
    variance = np.divide(sigma, light, out=np.full(light.shape, np.inf), where=lit) ** 2
    lit &= np.isfinite(variance) & (np.abs(a) < 1e6)
    channels = range(len(constant))
    tau2 = np.array([_own_variance(a[lit[..., c], c] - constant[c], variance[lit[..., c], c]) for c in channels])
    lit &= variance < DROWNED * np.maximum(tau2, TINY)
    variance[~lit] = np.inf
    correlation = np.stack([_correlation(a[..., c] - constant[c], variance[..., c], tau2[c]) for c in channels])
    return Samples(a, variance, _distance(lit.any(axis=2))), Prior(constant, tau2, correlation)


def _rectangle(surface, f):
    """(3, 3) m, model's frame: AlbedoMap.corners."""
    along = surface.size[f, :, None] * surface.axes[f]
    corners = surface.origin[f] + np.stack([np.zeros(3), along[0], along[1]])
    return corners * surface.local.diagonal + surface.local.centre


def homography(surface: Surface, camera, f):
    """(3, 3): of (u, v, 1) in a facet's plane to pixels (x w, y w, w); w > 0 in front of the camera.

    u, v : local lengths from the facet's origin along its axes
    """
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
    """tau^2 of deviations (n,) from the constant, whose noise has these variances.

    The mean over the pixels, weighted as is best for that tau^2.
    """
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
    """(REACH + 2,) correlation of the texture at distances of 0, 1, ... pixels, never rising.

    The noise of two pixels is not correlated.
    """
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
    """(nu, nv): so many texels that a step along either axis is 1 / finer pixels long, for the median of the pixels."""
    y, x = np.nonzero(pixels)
    if len(y) == 0 or abs(np.linalg.det(H)) < 1e-12 * np.prod(np.linalg.norm(H, axis=0)):
        return 1, 1
    u, v, w = np.linalg.solve(H, np.stack([x, y, np.ones(len(x))]).astype(float))
    scale = H[2, 0] * u + H[2, 1] * v + H[2, 2] * w
    good = scale * w > 0
    if not good.any():
        return 1, 1
    pixels_per_length = [
        np.median(np.hypot(H[0, a] - x[good] * H[2, a], H[1, a] - y[good] * H[2, a]) * np.abs(w / scale)[good])
        for a in (0, 1)
    ]
    return tuple(
        int(np.clip(np.ceil(finer * px * length), 1, most)) for px, length in zip(pixels_per_length, size, strict=True)
    )


def _distance(known):
    """(h, w) float32: pixels from each pixel to the next known one."""
    from scipy.ndimage import distance_transform_edt

    if not known.any():
        return np.full(known.shape, np.inf, np.float32)
    return distance_transform_edt(~known).astype(np.float32)


# ---- reading a texture ----


def lookup(texture: AlbedoMap, surface: Surface, p, side=None):
    """Albedo (M, C) at places p (M, 3), local, on the texture's facet.

    Bilinear between the centres of texels, constant beyond the outermost.
    side : (M,), where given, must be the facet's front or back, which reflect alike; else ValueError
    """
    f = texture.facet
    if side is not None and (np.asarray(side) // 2 != f).any():
        raise ValueError(f"lookup: not all sides are those of facet {f}")
    p = np.nan_to_num(np.asarray(p, float), posinf=0, neginf=0)
    uv = (p - surface.origin[f]) @ surface.axes[f].T / np.maximum(surface.size[f], 1e-300)
    return kernels.bilinear_many(np.ascontiguousarray(texture.albedo), uv)


def mean(texture: AlbedoMap):
    """(C,) area mean of the albedo over the facet."""
    w = texture.inside.astype(float)
    if not w.sum() > 0:  # a sliver between the points of all texels
        w = np.ones(w.shape)
    return np.einsum("ij,ijc->c", w, texture.albedo.astype(float)) / w.sum()


def unseen(texture: AlbedoMap):
    """(C,) standard deviation of the mean, since of a share of the facet the photograph tells nothing.

    That share is one place or a few (what stands before it, a margin), so it is off as one texel might be.
    """
    told = texture.inside * texture.known.astype(float)
    if not told.sum() > 0:
        return np.zeros(texture.albedo.shape[2])
    average = lambda values: np.einsum("ij,ijc->c", told, values) / told.sum()
    spread = np.sqrt(average((texture.albedo - average(texture.albedo)) ** 2))
    return spread * (1 - told.sum() / texture.inside.sum())


def painted(surface: Surface, f, picture) -> AlbedoMap:
    """A picture (H, W, C) of reflectances in [0, 1] that fills the facet's bounding rectangle.

    It is seen from the facet's front, its top towards +z, or towards +y where the facet is level.
    """
    n, frame = surface.normal[f], surface.axes[f]
    up = np.array([0.0, 0.0, 1.0]) if abs(n[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    # the sides of the rectangle that run most to the right and up
    along = frame @ np.column_stack([np.cross(up, n), up])
    turned = abs(along[0, 0]) < abs(along[1, 0])
    across, upward = (1, 0) if turned else (0, 1)
    values = np.asarray(picture, np.float32)[::-1]  # rows go upwards
    values = values[:, ::-1] if along[across, 0] < 0 else values
    values = values[::-1] if along[upward, 1] < 0 else values
    albedo = np.ascontiguousarray(values if turned else np.swapaxes(values, 0, 1))
    one = np.ones(albedo.shape[:2], np.float32)
    flat = np.einsum("tcj,aj->tca", surface.corners[surface.facet == f] - surface.origin[f], frame)
    inside = kernels.inside_share(flat / np.maximum(surface.size[f], 1e-300), *one.shape)
    constant = albedo.astype(float).mean(axis=(0, 1))
    return AlbedoMap(f, albedo, one, 0 * one, inside, constant, _rectangle(surface, f), 0)


# ---- texture-<facet>.exr and what lies beside it ----


def paths(folder, facet):
    """The four files of a texture: the albedo, known / sigma / inside, the picture to look at, its place."""
    ends = (".exr", ".known.exr", ".png", ".json")
    return tuple(os.path.join(os.fspath(folder), f"texture-{facet}{end}") for end in ends)


def _picture(grid):
    """Texels as a picture, seen from the facet's front: axis 0 runs to the right, axis 1 upwards. Row 0 ends axis 1."""
    return np.swapaxes(grid, 0, 1)[::-1]


def _texels(picture):
    return np.ascontiguousarray(np.swapaxes(picture, 0, 1)[:, ::-1], np.float32)


def write(folder, texture: AlbedoMap):
    """Write a texture's four files, all or none; returns the path of the first.

    texture-<facet>.exr     linear albedo; Y, or R G B
    ... .known.exr          R known, G sigma, B inside
    ... .png                8-bit, sRGB-coded, to look at
    ... .json               where it lies
    """
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
        shown = srgb_from_linear(np.clip(_picture(texture.albedo).astype(float), 0, 1))
        image.write_png8(png, np.rint(255 * shown).astype(np.uint8))
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
