"""USD as text: scene.usda, and pictures of textures beside it. Written without USD's own package.

Each material is there twice. As UsdPreviewSurface, which every program reads: diffuseColor = rho_d, specularColor =
rho_s (of a mirror too, at roughness 0), roughness = the root of the mean alpha; it turns white at grazing angles and
knows no tangent. And as OpenPBR by MaterialX (`outputs:mtlx:surface`): no specular on a diffuse surface; a mirror is
metal; a lobe has the index of refraction that gives max(rho_s) straight on, its two alphas and its tangent. Both have
GGX in place of Ward's lobe, see microfacet.py. `userProperties:exact` holds the exact values.

Light is the linear image value, pi x radiance, so that 1.0 is the photograph's white. Lamps are lambertian and glow on
their front. The camera keeps the principal point by its aperture's offset.
"""

from __future__ import annotations

import json
import re

import numpy as np

from lib.export.scene import Scene, rows_from_top
from lib.given import image
from lib.given.transfer import srgb_from_linear

FILM_MM = 36.0  # width of the camera's aperture; the focal length is in proportion
PREVIEW, OPEN_PBR = "UsdPreviewSurface", "ND_open_pbr_surface_surfaceshader"
_OUT = {"preview": "rgb", "open_pbr": "out"}  # of the shader that reads a texture for each


def write(folder, scene: Scene):
    """scene.usda and textures, into a folder."""
    axis = scene.up if scene.up in ("y", "z") else "z"
    names = _Names()
    root = _Prim("Xform", "scene")
    root.transform(scene.turn(axis), np.zeros(3))
    looks = root.child("Scope", "looks")
    paths, objects = {}, {}
    for piece in scene.pieces:
        key = (piece.look.name, piece.texture and piece.texture.facet)
        if key not in paths:
            name = names.free(piece.look.name)
            paths[key] = f"/scene/looks/{name}"
            _material(looks.child("Material", name, displayName=piece.look.name), paths[key], piece, folder)
        if piece.object not in objects:
            objects[piece.object] = root.child("Xform", names.free(piece.object), displayName=piece.object)
        _mesh(objects[piece.object].child("Mesh", names.free(piece.name)), piece, paths[key])
    _camera(root.child("Camera", names.free("photograph")), scene.camera)
    if scene.glow.any():
        dome = root.child("DomeLight", names.free("outside"))
        dome.set("color3f inputs:color", _vector(scene.glow))
        dome.set("float inputs:intensity", "1")
    head = f'#usda 1.0\n(\n    defaultPrim = "scene"\n    metersPerUnit = 1\n    upAxis = "{axis.upper()}"\n'
    head += '    doc = "Written by anasyn. Light is the linear image value, pi x radiance"\n)\n\n'
    (folder / "scene.usda").write_text(head + "\n".join(root.lines()) + "\n", encoding="utf-8")


class _Prim:
    """A prim with its attributes and children, as lines of text."""

    def __init__(self, kind, name, **metadata):
        self.kind, self.name, self.metadata, self.body, self.children = kind, name, metadata, [], []

    def child(self, kind, name, **metadata):
        self.children.append(_Prim(kind, name, **metadata))
        return self.children[-1]

    def set(self, attribute, value):
        self.body.append(f"{attribute} = {value}")

    def transform(self, R, t):
        """p_parent = R p + t; USD multiplies rows."""
        rows = np.vstack([np.column_stack([R.T, np.zeros(3)]), [*t, 1]])
        self.set("matrix4d xformOp:transform", f"({', '.join(_vector(row) for row in rows)})")
        self.set("uniform token[] xformOpOrder", '["xformOp:transform"]')

    def lines(self, indent=""):
        told = "".join(f"{key} = {json.dumps(value)}" for key, value in self.metadata.items())
        yield f'{indent}def {self.kind} "{self.name}"' + (f" ({told})" if told else "")
        yield indent + "{"
        for line in self.body:
            yield f"{indent}    {line}"
        for child in self.children:
            yield from child.lines(indent + "    ")
        yield indent + "}"


class _Names:
    """Identifiers that were not used before."""

    def __init__(self):
        self.used = {"scene", "looks"}

    def free(self, name):
        word = re.sub(r"[^A-Za-z0-9_]", "_", name)
        word = word if word[:1].isalpha() else f"_{word}"
        wanted, n = word, 1
        while word in self.used:
            n += 1
            word = f"{wanted}_{n}"
        self.used.add(word)
        return word


def _material(prim, path, piece, folder):
    look = piece.look
    prim.set("custom string userProperties:exact", json.dumps(json.dumps(look.exact)))
    prim.set("token outputs:surface.connect", f"<{path}/preview.outputs:surface>")
    prim.set("token outputs:mtlx:surface.connect", f"<{path}/open_pbr.outputs:surface>")
    file = None if piece.texture is None else _texture(folder, piece.texture)
    inputs = {
        "preview": (PREVIEW, _preview(look), "diffuseColor"),
        "open_pbr": (OPEN_PBR, _open_pbr(look), "base_color"),
    }
    for name, (kind, values, colour) in inputs.items():
        shader = prim.child("Shader", name)
        shader.set("uniform token info:id", f'"{kind}"')
        shader.body.append("token outputs:surface")
        if file:
            shader.set(f"color3f inputs:{colour}.connect", f"<{path}/{name}_picture.outputs:{_OUT[name]}>")
            values = {key: value for key, value in values.items() if key != f"color3f {colour}"}
            _picture(prim, name, path, file)
        for key, value in values.items():
            kind, _, attribute = key.partition(" ")
            shader.set(f"{kind} inputs:{attribute}", value)


def _preview(look):
    """Inputs of UsdPreviewSurface: {"type name": value}."""
    width = 1.0 if look.alpha is None else float(np.sqrt(np.sqrt(np.prod(look.alpha))))
    found = {
        "color3f diffuseColor": _vector(look.rho_d),
        "int useSpecularWorkflow": "1",
        "color3f specularColor": _vector(look.rho_s),
        "float roughness": repr(0.0 if look.is_mirror else min(width, 1.0)),
    }
    if look.emittance is not None:
        found["color3f emissiveColor"] = _vector(look.emittance)
    return found


def _open_pbr(look):
    """Inputs of OpenPBR's surface."""
    if look.is_mirror:
        found = {
            "color3f base_color": _vector(look.rho_s),
            "float base_metalness": "1",
            "float specular_roughness": "0",
        }
    elif look.alpha is None:
        found = {"color3f base_color": _vector(look.rho_d), "float specular_weight": "0"}
    else:
        share = float(min(look.rho_s.max(), 0.999))
        wide, narrow = map(float, look.alpha)
        root = np.sqrt(share)
        found = {
            "color3f base_color": _vector(np.clip(look.rho_d / (1 - share), 0, 1)),
            "color3f specular_color": _vector(look.rho_s / max(share, 1e-9)),
            "float specular_ior": repr(float((1 + root) / (1 - root))),
            # alpha_t = r^2 sqrt(2 / (1 + (1 - a)^2)), alpha_b = (1 - a) alpha_t
            "float specular_roughness": repr(float(min(np.sqrt(np.hypot(wide, narrow) / np.sqrt(2)), 1.0))),
            "float specular_roughness_anisotropy": repr(1 - narrow / wide),
        }
        if look.tangent is not None:
            found["vector3f geometry_tangent"] = _vector(look.tangent)
    if look.emittance is not None:
        strength = max(float(look.emittance.max()), 1e-9)
        found["float emission_luminance"] = repr(strength)
        found["color3f emission_color"] = _vector(look.emittance / strength)
    return {"float base_diffuse_roughness": "0", **found}


def _texture(folder, texture):
    """The name of a texture's picture, which is written."""
    name = f"texture-{texture.facet}.png"
    shown = np.rint(255 * srgb_from_linear(np.clip(rows_from_top(texture).astype(float), 0, 1)))
    image.write_png8(folder / name, shown.astype(np.uint8))
    return name


def _picture(prim, name, path, file):
    """The shaders that read a texture for one of the two surfaces."""
    shader = prim.child("Shader", f"{name}_picture")
    if name == "open_pbr":
        shader.set("uniform token info:id", '"ND_image_color3"')
        shader.set("asset inputs:file", f'@./{file}@ (colorSpace = "srgb_texture")')
        shader.body.append("color3f outputs:out")
        return
    shader.set("uniform token info:id", '"UsdUVTexture"')
    shader.set("asset inputs:file", f"@./{file}@")
    shader.set("token inputs:sourceColorSpace", '"sRGB"')
    shader.set("token inputs:wrapS", '"clamp"')
    shader.set("token inputs:wrapT", '"clamp"')
    shader.set("float2 inputs:st.connect", f"<{path}/st.outputs:result>")
    shader.body.append("float3 outputs:rgb")
    reader = prim.child("Shader", "st")
    reader.set("uniform token info:id", '"UsdPrimvarReader_float2"')
    reader.set("string inputs:varname", '"st"')
    reader.body.append("float2 outputs:result")


def _mesh(prim, piece, material):
    p = piece.corners.reshape(-1, 3)
    prim.metadata = {"prepend apiSchemas": ["MaterialBindingAPI"]}
    prim.set("uniform token subdivisionScheme", '"none"')
    prim.set("uniform bool doubleSided", str(int(piece.look.emittance is None)))
    prim.set("int[] faceVertexCounts", f"[{', '.join(['3'] * (len(p) // 3))}]")
    prim.set("int[] faceVertexIndices", f"[{', '.join(map(str, range(len(p))))}]")
    prim.set("point3f[] points", _vectors(p))
    prim.set("normal3f[] normals", _vectors(np.repeat(piece.normal, 3, axis=0)))
    prim.set("float3[] extent", _vectors([p.min(axis=0), p.max(axis=0)]))
    prim.set("color3f[] primvars:displayColor", _vectors([piece.look.rho_d]))
    prim.set("texCoord2f[] primvars:st", _vectors(piece.uv.reshape(-1, 2)) + ' (interpolation = "vertex")')
    prim.set("rel material:binding", f"<{material}>")


def _camera(prim, camera):
    W, H, K = camera.width, camera.height, camera.K
    focal = FILM_MM * K[0, 0] / W
    high = focal * H / K[1, 1]
    prim.transform(camera.T_cam_world[:3, :3].T @ np.diag([1.0, -1.0, -1.0]), camera.centre)  # looks along -z, y is up
    values = {
        "focalLength": focal,
        "horizontalAperture": FILM_MM,
        "verticalAperture": high,
        "horizontalApertureOffset": FILM_MM * ((W - 1) / 2 - K[0, 2]) / W,
        "verticalApertureOffset": high * (K[1, 2] - (H - 1) / 2) / H,
    }
    for name, value in values.items():
        prim.set(f"float {name}", repr(float(value)))
    prim.set("float2 clippingRange", "(0.001, 10000)")


def _vector(values):
    return f"({', '.join(repr(float(v)) for v in values)})"


def _vectors(rows):
    return f"[{', '.join(map(_vector, rows))}]"
