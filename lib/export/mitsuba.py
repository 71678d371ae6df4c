"""A scene of Mitsuba 3: scene.xml, meshes/ and textures/ beside it.

    mitsuba -m llvm_ad_rgb scene.xml -D spp=1024        # an EXR of radiance; times pi it is the linear image value

Radiance is emittance / pi. Surfaces are two-sided, lamps emit on their front. A mirror is a conductor without Fresnel
factor, Ward's lobe a rough one of Beckmann's microfacets with the same alphas and nearly the same reflectance, see
microfacet.py; its tangent is the direction of u. Square pixels; the principal point is kept.
"""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np

from lib.export import ply
from lib.export.scene import Scene, rows_from_top
from lib.given import image

DEEPEST = -1  # bounces: as many as Russian roulette leaves
ROULETTE = 24
HEAD = " Written by anasyn. Times pi, radiance is the linear image value: 1.0 is the photograph's white. "


def write(folder, scene: Scene):
    """scene.xml and what it names, into a folder."""
    for name in ("meshes", "textures"):
        (folder / name).mkdir()
    root = ElementTree.Element("scene", version="3.0.0")
    root.append(ElementTree.Comment(HEAD))
    _values(root, "default", spp=256)
    integrator = _plugin(root, "integrator", "path")
    _values(integrator, "integer", max_depth=DEEPEST, rr_depth=ROULETTE)
    _sensor(root, scene.camera)
    if scene.glow.any():
        _colour(_plugin(root, "emitter", "constant"), "radiance", scene.glow / np.pi, None)
    looks = {}
    for k, piece in enumerate(scene.pieces):
        key = (piece.look.name, piece.texture and piece.texture.facet)
        if key not in looks:
            looks[key] = f"look-{len(looks)}"
            root.append(ElementTree.Comment(f" {_comment(piece.look.name)}: {piece.look.kind} "))
            _bsdf(root, piece.look, looks[key], folder, piece.texture)
        ply.write(folder / f"meshes/{k}.ply", piece)
        root.append(ElementTree.Comment(f" {_comment(piece.name)} "))
        shape = _plugin(root, "shape", "ply", id=f"piece-{k}")
        _values(shape, "string", filename=f"meshes/{k}.ply")
        _values(shape, "boolean", face_normals="true")
        ElementTree.SubElement(shape, "ref", id=looks[key])
        if piece.look.emittance is not None:
            _colour(_plugin(shape, "emitter", "area"), "radiance", piece.look.emittance / np.pi, None)
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(folder / "scene.xml", encoding="utf-8", xml_declaration=True)


def _sensor(root, camera):
    W, H, K = camera.width, camera.height, camera.K
    sensor = _plugin(root, "sensor", "perspective")
    _values(sensor, "string", fov_axis="x")
    far = float(np.linalg.norm(camera.centre) + 1e4)
    _values(sensor, "float", fov=2 * np.degrees(np.arctan(W / (2 * K[0, 0]))), near_clip=1e-3, far_clip=far)
    # ours is the centre of the top left pixel, Mitsuba's film begins at its corner
    offsets = {"x": 0.5 - (K[0, 2] + 0.5) / W, "y": 0.5 - (K[1, 2] + 0.5) / H}
    _values(sensor, "float", **{f"principal_point_offset_{axis}": value for axis, value in offsets.items()})
    T = np.linalg.inv(camera.T_cam_world) @ np.diag([-1.0, -1.0, 1.0, 1.0])  # x to the left, y up
    transform = ElementTree.SubElement(sensor, "transform", name="to_world")
    ElementTree.SubElement(transform, "matrix", value=" ".join(map(repr, T.ravel().tolist())))
    film = _plugin(sensor, "film", "hdrfilm")
    _values(film, "integer", width=W, height=H)
    _values(film, "string", pixel_format="rgb", component_format="float32")
    _plugin(film, "rfilter", "box")
    _values(_plugin(sensor, "sampler", "independent"), "integer", sample_count="$spp")


def _bsdf(root, look, name, folder, texture):
    """Of a look: diffuse, specular or a blend of both, whose shares divide their reflectances."""
    both = _plugin(root, "bsdf", "twosided", id=name)
    share = _share(look)
    if share == 0:
        diffuse = _plugin(both, "bsdf", "diffuse")
        if texture is None:
            _colour(diffuse, "reflectance", look.rho_d, folder)
        else:
            file = f"textures/{texture.facet}.exr"
            image.write_exr(folder / file, rows_from_top(texture)[::-1])  # its first row is at v = 0
            _bitmap(diffuse, "reflectance", file)
        return
    parent = both
    if share < 1:
        parent = _plugin(both, "bsdf", "blendbsdf")
        _values(parent, "float", weight=share)
        _colour(_plugin(parent, "bsdf", "diffuse"), "reflectance", look.rho_d / (1 - share), folder)
    conductor = _plugin(parent, "bsdf", "conductor" if look.is_mirror else "roughconductor")
    _values(conductor, "string", material="none")
    if not look.is_mirror:
        _values(conductor, "string", distribution="beckmann")
        _values(conductor, "float", alpha_u=look.alpha[0], alpha_v=look.alpha[1])
    _colour(conductor, "specular_reflectance", look.beckmann / share, folder)


def _share(look):
    """Of the specular part in a blend, so that neither part reflects more than all where that can be."""
    if not look.rho_s.any():
        return 0.0
    if not look.rho_d.any():
        return 1.0
    return float(look.beckmann.max() / (look.beckmann.max() + look.rho_d.max()))


def _plugin(parent, tag, kind, **more):
    return ElementTree.SubElement(parent, tag, type=kind, **more)


def _values(parent, tag, **values):
    for name, value in values.items():
        text = repr(float(value)) if tag == "float" else str(value)
        ElementTree.SubElement(parent, tag, name=name, value=text)


def _colour(parent, name, values, folder):
    """An rgb; a reflectance above 1, which Mitsuba refuses as one, is a picture of one pixel."""
    if folder is None or np.max(values) <= 1:
        text = ", ".join(repr(float(v)) for v in values)
        ElementTree.SubElement(parent, "rgb", name=name, value=text)
        return
    file = f"textures/colour-{len(list((folder / 'textures').iterdir()))}.exr"
    image.write_exr(folder / file, np.reshape(values, (1, 1, 3)))
    _bitmap(parent, name, file)


def _bitmap(parent, name, file):
    texture = ElementTree.SubElement(parent, "texture", type="bitmap", name=name)
    _values(texture, "string", filename=file, filter_type="bilinear", wrap_mode="clamp")
    _values(texture, "boolean", raw="true")


def _comment(text):
    return text.replace("--", "- -")
