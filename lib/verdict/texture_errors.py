"""The albedo of textured groups against the true pictures of truth/textures.json, pixel by pixel."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import cameras, image, model
from lib.given.materials import Materials
from lib.light import surface as surfaces
from lib.picture import albedo_maps


class PlacedPicture(NamedTuple):
    """A picture that lies in space.

    origin : m, the outer corner of pixel [0, 0];  axes : m, the whole length of row 0 and of column 0 from there
    """

    picture: np.ndarray  # (h, w, C)
    origin: np.ndarray  # (3,)
    axes: np.ndarray  # (2, 3)


def read_true_textures(path):
    """{group: PlacedPicture} of truth/textures.json. BadInput: a texture without its place."""
    table = artefact.read_json(path)
    result = {}
    for group, entry in table.items() if isinstance(table, dict) else [("", table)]:
        try:
            place = np.array([entry[key] for key in ("origin", "u", "v")], float).reshape(3, 3)
            file = Path(path).parent / entry["file"]
        except (KeyError, TypeError, ValueError):
            raise BadInput(f"{path}: {group}: has not file, origin, u and v of a texture") from None
        picture = image.read_exr(file)
        result[group] = PlacedPicture(picture if picture.ndim == 3 else picture[..., None], place[0], place[1:])
    return result


def bilinear(placed: PlacedPicture, p):
    """(M, C) of a picture at places p (M, 3) m: bilinear between centres of pixels, constant beyond.

    >>> two = PlacedPicture(np.array([[[0.2], [0.6]]]), np.zeros(3), np.array([[2.0, 0, 0], [0, 1, 0]]))   # 2 m x 1 m
    >>> bilinear(two, np.array([[0.5, 0.3, 0], [1, 0.9, 0], [7, 0, 0]])).round(9).ravel()
    array([0.2, 0.4, 0.6])
    """
    from scipy.ndimage import map_coordinates

    h, w, C = placed.picture.shape
    s, t = np.linalg.pinv(placed.axes.T) @ (p - placed.origin).T
    at = [t * h - 0.5, s * w - 0.5]
    channels = [np.asarray(placed.picture[..., c], float) for c in range(C)]
    return np.stack([map_coordinates(channel, at, order=1, mode="nearest") for channel in channels], axis=1)


def albedos(world, camera, facet, materials: Materials, maps, true_textures):
    """{group: (ours (M, 3), truth (M, 3))} at all pixels that show a group of which truth has the texture.

    facet : (H, W) model facet + 1;  maps : {facet: AlbedoMap} as found; on other facets the group's rho_d counts
    true_textures : {group: PlacedPicture}
    """
    surface = surfaces.surface(world)
    shown = facet.reshape(-1).astype(np.int64) - 1
    result = {}
    for name in [name for name in true_textures if name in world.groups]:
        group = materials.groups.get(name)
        pixel = np.flatnonzero((shown >= 0) & (surface.group[np.maximum(shown, 0)] == world.groups.index(name)))
        if group is None or group.rho_d is None or not len(pixel):
            continue
        p, _ = surfaces.backproject(surface, camera, shown[pixel], pixel)
        ours = np.tile(np.array(group.rho_d, float), (len(pixel), 1))
        for f in maps.keys() & {*shown[pixel].tolist()}:
            ours[shown[pixel] == f] = albedo_maps.lookup(maps[f], surface, p[shown[pixel] == f])
        true = bilinear(true_textures[name], p * surface.local.diagonal + surface.local.centre)
        result[name] = ours, np.broadcast_to(true, ours.shape)
    return result


def read_albedos(model_path, camera_path, found, map_files, truth_path):
    """`albedos` of files. found : Answers;  map_files : {group: {facet: file}} as found;  truth_path : textures.json"""
    maps = {facet: albedo_maps.read(path) for files in map_files.values() for facet, path in files.items()}
    world, camera = model.load(model_path), cameras.read_cameramodel(camera_path)
    return albedos(world, camera, found.facet, found.materials, maps, read_true_textures(truth_path))
