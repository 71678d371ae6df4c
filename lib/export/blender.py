"""A script for Blender: scene.py, which builds the scene from scene.json beside it, with a copy of the photograph.

The script is blender_process.py, whose head says how light is meant. Blender's z is the scene's up.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from lib.core import artefact
from lib.export.scene import Scene, rows_from_top
from lib.given import image


def write(folder, scene: Scene, watt_per_unit):
    """scene.py, scene.json, the photograph and textures, into a folder. watt_per_unit : W/m2 of an emittance of 1.0"""
    R = scene.turn("z")
    photograph = f"photograph{scene.photograph.suffix}"
    shutil.copyfile(scene.photograph, folder / photograph)
    shutil.copyfile(Path(__file__).with_name("blender_process.py"), folder / "scene.py")
    looks, pieces = {}, []
    for piece in scene.pieces:
        texture = piece.texture
        name = piece.look.name if texture is None else f"{piece.look.name} {texture.facet}"
        if name not in looks:
            looks[name] = _look(piece.look, R, folder, texture)
        parts = {"points": (piece.corners.reshape(-1, 3) @ R.T).tolist(), "uv": piece.uv.reshape(-1, 2).tolist()}
        pieces.append({"name": piece.name, "object": piece.object, "look": name, **parts})
    content = {
        "name": "anasyn",
        "watt_per_unit": watt_per_unit,
        "photograph": photograph,
        "camera": _camera(scene.camera, R),
        "glow": scene.glow,
        "looks": looks,
        "pieces": pieces,
    }
    artefact.write_json(folder / "scene.json", content)


def _look(look, R, folder, texture):
    turned = lambda v: None if v is None else (R @ v).tolist()
    throw = None if look.throw is None else [*turned(look.throw[:3]), float(look.throw[3])]
    file = None
    if texture is not None:
        file = f"texture-{texture.facet}.exr"
        image.write_exr(folder / file, rows_from_top(texture))
    return {
        "rho_d": look.rho_d,
        "rho_s": look.beckmann,
        "alpha": look.alpha,
        "tangent": turned(look.tangent),
        "emittance": look.emittance,
        "throw": throw,
        "texture": file,
        "exact": look.exact,
    }


def _camera(camera, R):
    """Blender's camera looks along -z, y is up."""
    T = np.eye(4)
    T[:3, :3] = R @ camera.T_cam_world[:3, :3].T @ np.diag([1.0, -1.0, -1.0])
    T[:3, 3] = R @ camera.centre
    return {"K": camera.K, "size": [camera.width, camera.height], "T_world_cam": T}
