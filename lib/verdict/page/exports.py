"""Downloads of the exported scene, and the scene itself in space, to be turned with the mouse.

The view is trimesh's own HTML viewer, which the package ships whole (three.js, 0.7 MB); nothing comes from the network.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.given.transfer import srgb_from_linear
from lib.verdict.page.html import render
from lib.verdict.page.parts import Parts

LARGEST_BYTES = 2_000_000  # of a model that is shown within the page
LAMP, GLOW = 0.3, 0.5  # shares of a colour: in the light of the viewer's lamp, which is 1.75, and on its own
WORDS = {
    "gltf": "glTF 2.0, for viewers and most 3-D programs",
    "mitsuba": "Mitsuba 3",
    "radiance": "Radiance; view.vf beside it is the photograph's view",
    "usd": "USD, materials as UsdPreviewSurface and OpenPBR",
    "colmap": "COLMAP's sparse model, cameras.txt, images.txt and points3D.txt",
    "blender": "Blender: run scene.py, which takes what lies beside it",
}


class Download(NamedTuple):
    """address : from the page;  words : what it is;  lost : what this kind cannot hold, lines"""

    kind: str
    address: str
    words: str
    lost: list


def exports_section(parts: Parts):
    """Links to what was exported, and the view of its glTF; "" where nothing was."""
    if not parts.exports:
        return ""
    report = parts.reports.get("export")
    losses = report.losses if report else {}
    downloads = [Download(kind, path, WORDS[kind], losses.get(kind, [])) for kind, path in parts.exports.items()]
    return render("exports.html", downloads=downloads, view=parts.view)


def viewer(path) -> str | None:
    """The HTML of the viewer for a .glb, from the photograph's place; None where the file is too large for a page.

    trimesh's viewer has one lamp, which shines from the eye towards the origin, and shows linear values as they are. So
    the middle of the scene is moved to the origin, and colours are sRGB-coded, a part of each as its own glow.
    """
    if Path(path).stat().st_size > LARGEST_BYTES:
        return None
    import trimesh
    from trimesh.viewer.notebook import scene_to_html

    loaded = trimesh.load_scene(path)
    shown = trimesh.Scene(camera=loaded.camera, camera_transform=loaded.camera_transform)
    for number, node in enumerate(loaded.graph.nodes_geometry):
        T, name = loaded.graph[node]
        mesh = loaded.geometry[name]
        mesh.visual.material = _lit(mesh.visual.material)
        shown.add_geometry(mesh, node_name=f"piece {number}", geom_name=f"piece {number}", transform=T)
    shown.apply_transform(trimesh.transformations.translation_matrix(-shown.bounds.mean(axis=0)))
    return scene_to_html(shown)


def _lit(material):
    """What trimesh's viewer shows of a material: its colour, in part by the lamp, in part on its own."""
    from trimesh.visual.material import PBRMaterial

    shown = np.clip(srgb_from_linear(np.asarray(material.baseColorFactor[:3], float) / 255), 0, 1)
    glow = np.maximum(0.0 if material.emissiveFactor is None else material.emissiveFactor, GLOW * shown)
    return PBRMaterial(
        baseColorFactor=[*(LAMP * shown), 1.0],
        baseColorTexture=material.baseColorTexture,
        emissiveTexture=material.baseColorTexture,
        emissiveFactor=glow,
        metallicFactor=0.0,
        roughnessFactor=1.0,
        doubleSided=True,
    )
