"""Binary glTF 2.0, and how its materials stand for ours.

diffuse     baseColor = rho_d, metallic 0, KHR_materials_specular: specular 0
mirror      baseColor = rho_s, metallic 1, roughness 0. Schlick's term turns a coloured one white at grazing angles
lobe        alone: metallic 1, baseColor = rho_s. Over a diffuse part: KHR_materials_ior gives max(rho_s) straight on,
            specularColor = rho_s / max(rho_s), baseColor = rho_d / (1 - max(rho_s)), for glTF takes the lobe's light
            from below it. roughness = sqrt(alpha_y), KHR_materials_anisotropy: strength^2 = (alpha_x - alpha_y) /
            (1 - alpha_y). GGX instead of Ward's lobe, see microfacet.py, and Schlick's term; an alpha above 1 is 1
textured    baseColorTexture, sRGB-coded in 8 bits
lamp        emissive = emittance, the linear image value (pi x radiance), by KHR_materials_emissive_strength.
            Lambertian; its front alone is drawn

`extras` of each material hold the exact values, those of the camera the pixels' matrix: glTF's camera looks along the
axis of its picture, so that a shifted principal point is lost. The root node turns the model's up to glTF's y.
"""

from __future__ import annotations

import numpy as np

from lib.core.stage import BadInput
from lib.export.scene import Look, Scene, rows_from_top
from lib.given.transfer import srgb_from_linear

SPECULAR, IOR, ANISOTROPY = "KHR_materials_specular", "KHR_materials_ior", "KHR_materials_anisotropy"
STRENGTH = "KHR_materials_emissive_strength"
FLOAT, ARRAY_BUFFER = 5126, 34962
NEAR_M = 0.01
MOST = 0.9999  # of a lobe straight on, over a diffuse part


def write(path, scene: Scene):
    """One .glb with everything in it. Positions are single precision about the model's middle."""
    import pygltflib as gl

    build = _Build(gl)
    materials = {}
    p = np.concatenate([piece.corners.reshape(-1, 3) for piece in scene.pieces])
    middle = (p.min(axis=0) + p.max(axis=0)) / 2
    primitives = {}
    for piece in scene.pieces:
        key = (piece.look.name, piece.texture and piece.texture.facet)
        if key not in materials:
            materials[key] = build.material(piece.look, piece.texture)
        primitives.setdefault(piece.object, []).append(build.primitive(piece, middle, materials[key]))
    gltf = build.gltf
    for name, parts in primitives.items():
        gltf.meshes.append(gl.Mesh(name=name, primitives=parts))
        gltf.nodes.append(gl.Node(name=name, mesh=len(gltf.meshes) - 1, translation=middle.tolist()))
    root = gl.Node(name="scene", children=list(range(len(gltf.nodes))), rotation=_quaternion(scene.turn("y")))
    gltf.nodes += [root, build.camera(scene)]
    gltf.scenes, gltf.scene = [gl.Scene(nodes=[len(gltf.nodes) - 2, len(gltf.nodes) - 1])], 0
    gltf.extensionsUsed = sorted({name for m in gltf.materials for name in m.extensions})
    gltf.extras = {"light": "emissive is the linear image value, pi x radiance; 1.0 is the photograph's white"}
    gltf.buffers = [gl.Buffer(byteLength=len(build.binary))]
    gltf.set_binary_blob(bytes(build.binary))
    if not gltf.save_binary(str(path)):
        raise OSError(f"{path}: cannot be written as glTF")


class _Build:
    """A file that grows. Each method adds what it is called after; numbers are indices."""

    def __init__(self, gl):
        self.gl, self.binary = gl, bytearray()
        self.gltf = gl.GLTF2(asset=gl.Asset(generator="anasyn"))

    def stored(self, content, target=None) -> int:
        """The buffer view of bytes."""
        self.binary.extend(bytes(-len(self.binary) % 4))
        at = len(self.binary)
        self.binary.extend(content)
        self.gltf.bufferViews.append(
            self.gl.BufferView(buffer=0, byteOffset=at, byteLength=len(content), target=target)
        )
        return len(self.gltf.bufferViews) - 1

    def accessor(self, values, kind, bounds=False) -> int:
        values = np.ascontiguousarray(values, "<f4")
        more = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()} if bounds else {}
        view = self.stored(values.tobytes(), ARRAY_BUFFER)
        self.gltf.accessors.append(
            self.gl.Accessor(bufferView=view, componentType=FLOAT, count=len(values), type=kind, **more)
        )
        return len(self.gltf.accessors) - 1

    def primitive(self, piece, middle, material):
        each = lambda values: np.repeat(values, 3, axis=0)
        attributes = self.gl.Attributes(
            POSITION=self.accessor(piece.corners.reshape(-1, 3) - middle, "VEC3", bounds=True),
            NORMAL=self.accessor(each(piece.normal), "VEC3"),
        )
        if piece.texture is not None:
            uv = piece.uv.reshape(-1, 2)
            attributes.TEXCOORD_0 = self.accessor(np.column_stack([uv[:, 0], 1 - uv[:, 1]]), "VEC2")
        if piece.look.anisotropic:
            t = each(piece.tangents)
            attributes.TANGENT = self.accessor(np.column_stack([t, np.ones(len(t))]), "VEC4")
        return self.gl.Primitive(attributes=attributes, material=material)

    def material(self, look: Look, texture) -> int:
        gl, name = self.gl, look.name
        pbr, extensions = _mapped(look)
        extras = {"exact": look.exact}
        emissive = [0.0, 0.0, 0.0]
        if look.emittance is not None:
            strength = max(float(look.emittance.max()), 1e-9)
            emissive = (look.emittance / strength).tolist()
            extensions[STRENGTH] = {"emissiveStrength": strength}
        material = gl.PbrMetallicRoughness(**pbr)
        if texture is not None:
            name = f"{name} {texture.facet}"
            extras["facet"] = texture.facet
            material.baseColorFactor = [1.0, 1.0, 1.0, 1.0]
            material.baseColorTexture = gl.TextureInfo(index=self.texture(texture))
        self.gltf.materials.append(
            gl.Material(
                name=name,
                pbrMetallicRoughness=material,
                emissiveFactor=emissive,
                doubleSided=look.emittance is None,
                alphaCutoff=None,
                extensions=extensions,
                extras=extras,
            )
        )
        return len(self.gltf.materials) - 1

    def texture(self, texture) -> int:
        import cv2

        shown = np.rint(255 * srgb_from_linear(np.clip(rows_from_top(texture).astype(float), 0, 1))).astype(np.uint8)
        ok, code = cv2.imencode(".png", np.ascontiguousarray(shown[..., ::-1]))
        if not ok:
            raise OSError(f"texture {texture.facet}: cannot be written as PNG")
        gl, gltf = self.gl, self.gltf
        if not gltf.samplers:
            gltf.samplers.append(gl.Sampler(wrapS=gl.CLAMP_TO_EDGE, wrapT=gl.CLAMP_TO_EDGE))
        gltf.images.append(gl.Image(bufferView=self.stored(code.tobytes()), mimeType="image/png"))
        gltf.textures.append(gl.Texture(sampler=0, source=len(gltf.images) - 1))
        return len(gltf.textures) - 1

    def camera(self, scene):
        """Its node, which is no child of the root: trimesh 5.2 overlooks the turn of a camera's parents."""
        gl, camera = self.gl, scene.camera
        fx, fy = camera.K[0, 0], camera.K[1, 1]
        lens = gl.Perspective(
            yfov=float(2 * np.arctan(camera.height / (2 * fy))),
            aspectRatio=float(camera.width / fx / (camera.height / fy)),
            znear=NEAR_M,
        )
        shift = camera.K[:2, 2] - [(camera.width - 1) / 2, (camera.height - 1) / 2]
        extras = {
            "K": camera.K.tolist(),
            "size": [camera.width, camera.height],
            "pixel_0_0": "centre of the top left pixel",
            "shift_px": shift.tolist(),
        }
        self.gltf.cameras.append(gl.Camera(name="photograph", type="perspective", perspective=lens, extras=extras))
        up = scene.turn("y")
        turn = up @ camera.T_cam_world[:3, :3].T @ np.diag([1.0, -1.0, -1.0])  # glTF looks along -z, y is up
        centre = (up @ camera.centre).tolist()
        return gl.Node(name="photograph", camera=0, rotation=_quaternion(turn), translation=centre)


def _quaternion(R):
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(R).as_quat().tolist()


def _mapped(look):
    """(pbrMetallicRoughness, extensions) of a look, by the table above."""
    colour = lambda values: [*np.clip(values, 0, 1).tolist(), 1.0]
    if look.is_mirror:
        return {"baseColorFactor": colour(look.rho_s), "metallicFactor": 1.0, "roughnessFactor": 0.0}, {}
    if look.alpha is None:
        even = {"baseColorFactor": colour(look.rho_d), "metallicFactor": 0.0, "roughnessFactor": 1.0}
        return even, {SPECULAR: {"specularFactor": 0.0}}
    wide, narrow = np.minimum(look.alpha, 1.0)
    pbr = {"roughnessFactor": float(np.sqrt(narrow))}
    if look.rho_d.any():
        share = min(float(look.rho_s.max()), MOST)
        pbr |= {"baseColorFactor": colour(look.rho_d / (1 - share)), "metallicFactor": 0.0}
        tint = look.rho_s / share if share else np.zeros(3)
        root = np.sqrt(share)
        extensions = {SPECULAR: {"specularFactor": 1.0, "specularColorFactor": tint.tolist()}}
        extensions[IOR] = {"ior": float((1 + root) / (1 - root))}
    else:
        pbr, extensions = pbr | {"baseColorFactor": colour(look.rho_s), "metallicFactor": 1.0}, {}
    if look.anisotropic and narrow < 1:
        extensions[ANISOTROPY] = {"anisotropyStrength": float(np.sqrt((wide - narrow) / (1 - narrow)))}
    return pbr, extensions


def read_looks(path) -> dict:
    """{material: (rho_d, rho_s, alpha or None, emittance or None)} of a .glb, by the table above and without `extras`.

    BadInput: it is no glTF.
    """
    import pygltflib

    try:
        gltf = pygltflib.GLTF2().load_binary(str(path))
    except Exception as error:  # whatever the package meets in bytes that are none
        raise BadInput(f"{path}: not a readable GLB: {type(error).__name__}: {error}") from None
    return {material.name: _unmapped(material) for material in gltf.materials}


def _unmapped(material):
    pbr, extensions = material.pbrMetallicRoughness, material.extensions
    base, none = np.array(pbr.baseColorFactor[:3]), np.zeros(3)
    emissive = np.array(material.emissiveFactor) * extensions.get(STRENGTH, {}).get("emissiveStrength", 1.0)
    light = emissive if emissive.any() else None
    narrow = pbr.roughnessFactor**2
    stretch = extensions.get(ANISOTROPY, {}).get("anisotropyStrength", 0.0) ** 2
    alpha = np.array([narrow + stretch * (1 - narrow), narrow])
    if pbr.metallicFactor == 1:
        return none, base, alpha if narrow else None, light
    specular = extensions.get(SPECULAR, {})
    if specular.get("specularFactor", 1.0) == 0:
        return base, none, None, light
    ior = extensions.get(IOR, {}).get("ior", 1.5)
    share = ((ior - 1) / (ior + 1)) ** 2
    return base * (1 - share), share * np.array(specular.get("specularColorFactor", [1.0, 1.0, 1.0])), alpha, light
