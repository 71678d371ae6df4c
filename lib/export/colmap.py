"""COLMAP's sparse model as text: the photograph's camera, and the model's vertices as points that no image observes."""

from __future__ import annotations

import numpy as np

from lib.export.scene import Scene
from lib.given import frames
from lib.given.transfer import srgb_from_linear


def write(folder, scene: Scene):
    """cameras.txt, images.txt, points3D.txt (and COLMAP's own rigs.txt, frames.txt) into a folder.

    Pixels count from the corner of the top left one. Colours are diffuse reflectances, sRGB-coded. Tracks are empty:
    nobody has looked whether a vertex can be seen.
    """
    import pycolmap

    camera = scene.camera
    K = frames.K_colmap_from_ours(camera.K)
    lens = pycolmap.Camera(
        model="PINHOLE",
        width=camera.width,
        height=camera.height,
        params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
        camera_id=1,
    )
    T = camera.T_cam_world
    found = pycolmap.Reconstruction()
    found.add_camera_with_trivial_rig(lens)
    image = pycolmap.Image(name=scene.photograph.name, camera_id=1, image_id=1)
    found.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3]))
    for p, colour in zip(*_points(scene), strict=True):
        found.add_point3D(p, pycolmap.Track(), colour)
    found.write_text(str(folder))


def _points(scene):
    """(N, 3) m: the model's vertices, each once, and (N, 3) uint8 colours of a group that has them."""
    model = scene.model
    used, first = np.unique(model.triangles, return_index=True)
    p, one = np.unique(model.vertices[used], axis=0, return_index=True)
    group = model.facet_group[model.triangle_facet[first[one] // 3]]
    rho = np.array([scene.looks[name].rho_d for name in model.groups])
    return p, np.rint(255 * srgb_from_linear(rho[group])).astype(np.uint8)
