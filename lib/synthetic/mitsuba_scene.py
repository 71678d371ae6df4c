"""A recipe as a scene of Mitsuba 3, which is independent of everything else here.

Mitsuba (`mi`, its variant set) is passed in.  Linear image value = pi x radiance, so an emittance E is radiance E / pi.
"""

import numpy as np

from lib.synthetic.ward_bsdf import register_ward

MAX_DEPTH = 120  # bounces; Russian roulette is unbiased, and what lies beyond is less than 0.9^120 = 3e-6


def mitsuba_scene(mi, recipe, folder, roulette, window=None, more=None):
    """The recipe as a Mitsuba scene: one mesh per group, written into `folder`.

    roulette : bounces before Russian roulette
    window : x0, y0, x1, y1 px of the picture; None is all of it
    more : {name: shape} that no recipe has, as Mitsuba's dictionaries
    """
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": roulette},
        "sensor": _sensor(mi, recipe, window),
    }
    room = recipe.pair.room if recipe.pair else ""  # no light comes from the other rooms of a stereo scene's model
    for i, group in enumerate(recipe.groups):
        polygons = [p for p in recipe.polygons if p.group == group and p.object.startswith(room)]
        if not polygons:
            continue
        shape = mesh(folder / f"{i}.ply", polygons, bsdf_of(mi, recipe, group), recipe.surface(group).texture)
        if group in recipe.lamps:
            radiance = [float(x) / np.pi for x in recipe.lamps[group]]
            shape["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
        scene[f"group{i}"] = shape
    return mi.load_dict(scene | (more or {}), optimize=False)  # optimised, identical materials would collapse into one


def _sensor(mi, recipe, window):
    """The recipe's camera and film."""
    W, H = recipe.size
    f, cx, cy = recipe.K[0, 0], recipe.K[0, 2], recipe.K[1, 2]
    film = {
        "type": "hdrfilm",
        "width": W,
        "height": H,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    if window is not None:
        x0, y0, x1, y1 = window
        film |= {"crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
    T_world_cam = np.linalg.inv(recipe.T_cam_world)
    return {
        "type": "perspective",
        "near_clip": 1e-3,
        "far_clip": 1e3,
        "fov_axis": "x",
        "fov": float(2 * np.degrees(np.arctan(W / (2 * f)))),
        # Mitsuba's camera has x left and y up; its film covers [0, W], ours [-0.5, W - 0.5].
        "to_world": mi.ScalarTransform4f((T_world_cam @ np.diag([-1.0, -1.0, 1.0, 1.0])).tolist()),
        "principal_point_offset_x": float(0.5 - (cx + 0.5) / W),
        "principal_point_offset_y": float(0.5 - (cy + 0.5) / H),
        "film": film,
        "sampler": {"type": "independent"},
    }


def bsdf_of(mi, recipe, group) -> dict:
    """The group's BSDF, the same on both sides."""
    rgb = lambda values: {"type": "rgb", "value": [float(x) for x in values]}
    surface, rho_d = recipe.surface(group), recipe.rho_d(group)
    if surface.kind == "glossy":
        register_ward(mi)
        return {
            "type": "ward",
            "rho_d": list(map(float, rho_d)),
            "rho_s": list(map(float, surface.rho_s)),
            "alpha": [*map(float, surface.alpha), 0.0],
            "tangent": list(map(float, surface.tangent or (0, 0, 0))),
        }
    if surface.kind == "textured":
        # bilinear between pixel centres, as the recipe says; `raw`: numbers, not colours
        reflectance = {
            "type": "bitmap",
            "bitmap": mi.Bitmap(surface.texture.image.astype("float32")),
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
        }
        bsdf = {"type": "diffuse", "reflectance": reflectance}
    elif surface.kind in ("mirror", "coloured_mirror"):
        # material none: no Fresnel factor
        bsdf = {"type": "conductor", "material": "none", "specular_reflectance": rgb(surface.rho_s)}
    else:
        bsdf = {"type": "diffuse", "reflectance": rgb(rho_d)}
    return {"type": "twosided", "bsdf": bsdf}


def mesh(path, polygons, bsdf, texture=None) -> dict:
    """A Mitsuba shape of polygons, written to `path`."""
    write_ply(path, polygons, texture)
    return {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": bsdf}


def write_ply(path, polygons, texture=None):
    """Convex polygons as fans; corners are not shared between polygons, so that normals stay flat.

    With a texture each corner has (s, t): 0 to 1 along its columns and its rows, as Mitsuba's bitmaps have it.
    """
    vertices, faces = [], []
    for polygon in polygons:
        first = len(vertices)
        vertices += list(polygon.points)
        faces += [(first, first + i, first + i + 1) for i in range(1, len(polygon.points) - 1)]
    st = []
    if texture:
        frame = np.linalg.pinv(np.column_stack([texture.u, texture.v]))
        vertices = [np.r_[p, frame @ (p - texture.origin)] for p in vertices]
        st = ["property float s", "property float t"]
    lines = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(vertices)}",
        "property float x",
        "property float y",
        "property float z",
        *st,
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    lines += [" ".join(f"{x:.9g}" for x in v) for v in vertices] + [" ".join(map(str, (3, *f))) for f in faces]
    path.write_text("\n".join(lines) + "\n")
