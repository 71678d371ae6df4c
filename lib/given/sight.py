"""Whether a camera can see a model at all, and if not, which mistake of the pose would explain it."""

from __future__ import annotations

import numpy as np

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera axes, and Blender's: y up, looking along -z
INVERSE = "is it camera-to-world? extrinsics are world-to-camera"
UPRIGHT = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # a model with y up to one with z up
EXPORT = "export the model with the camera's axes (Blender: glTF without +Y Up; OBJ with Forward Y, Up Z)"
LYING = "or has the model another axis up than the camera takes, and is to be turned?"
RAYS = 12, 9  # across and down
MOST = 20_000  # triangles that the rays are tried on; larger models are left alone
LENGTHS = {"mm": 1e-3, "cm": 1e-2}  # units of a translation, where the model is in metres


def unseen(lens, model) -> str | None:
    """One line where no pixel can show the model and a common mistake of the pose explains it, None else.

    A camera that shows nothing for another reason has its answer, `nothing seen`. lens : lenses.Lens
    """
    T = lens.T_cam_ref
    if can_see(lens, T, model):
        inverse = np.linalg.inv(T)
        if inside(T, model) or not inside(inverse, model) or fronts(lens, T, model) or not fronts(lens, inverse, model):
            return None
        upright = T @ UPRIGHT
        may_lie = inside(upright, model) and fronts(lens, upright, model)
        return f"the camera sees the backs of faces alone, from outside: {INVERSE}{f'; {LYING}' if may_lie else ''}"
    others = {
        INVERSE: np.linalg.inv(T),
        "does it look along -z? x right, y down, z forward": FLIP @ T,
        f"{INVERSE}, and look along z": FLIP @ np.linalg.inv(T),
    }
    others |= {f"is its translation in {unit}? metres are needed": _scaled(T, s) for unit, s in LENGTHS.items()}
    shares = {hint: (inside(other, model), _shown(lens, other, model)) for hint, other in others.items()}
    best = max(shares, key=shares.get)
    return f"no pixel can show the model: {best}" if shares[best][1] > 0 else None


def lying(lens, model) -> str | None:
    """One line where a camera outside the model's box stands inside it, seeing fronts, if one of the two were turned.

    It may be chance: this is a word when a scene is made, and refuses nothing.
    """
    T = lens.T_cam_ref
    for turned, axes in ((T @ UPRIGHT, "y up, and the camera z up"), (T @ UPRIGHT.T, "z up, and the camera y up")):
        if not inside(T, model) and inside(turned, model) and fronts(lens, turned, model):
            return f"it stands outside the model's box, and inside it if the model had {axes}: {EXPORT}"
    return None


def _shown(lens, T_cam_world, model) -> float:
    """The share of the model's corners that lie in the picture of a pinhole, or before any other lens."""
    p = model.vertices[np.unique(model.triangles)] @ T_cam_world[:3, :3].T + T_cam_world[:3, 3]
    x, y = ((p[:, k] / np.where(p[:, 2] > 0, p[:, 2], np.nan)) for k in (0, 1))
    if lens.model != "LENSMODEL_PINHOLE":
        return float(np.isfinite(x).mean())
    fx, fy, cx, cy = lens.intrinsics[:4]
    across, down = np.abs(fx * x + cx - (lens.width - 1) / 2), np.abs(fy * y + cy - (lens.height - 1) / 2)
    return float(((across < lens.width / 2) & (down < lens.height / 2)).mean())


def _scaled(T, scale):
    T = T.copy()
    T[:3, 3] *= scale
    return T


def inside(T_cam_world, model) -> bool:
    """Does the camera stand within the model's box?"""
    centre = -T_cam_world[:3, :3].T @ T_cam_world[:3, 3]
    p = model.vertices[np.unique(model.triangles)]
    return bool(((centre >= p.min(axis=0)) & (centre <= p.max(axis=0))).all())


def fronts(lens, T_cam_world, model) -> bool:
    """Does one of a few rays of a pinhole camera meet the front of a face first? True where that is not looked at."""
    if lens.model != "LENSMODEL_PINHOLE" or len(model.triangles) > MOST:
        return True
    x, y = (((np.arange(n) + 0.5) / n * size - 0.5) for n, size in zip(RAYS, (lens.width, lens.height), strict=True))
    fx, fy, cx, cy = lens.intrinsics[:4]
    v = np.stack([*(a.ravel() for a in np.meshgrid((x - cx) / fx, (y - cy) / fy)), np.ones(RAYS[0] * RAYS[1])], 1)
    p = (model.vertices @ T_cam_world[:3, :3].T + T_cam_world[:3, 3])[model.triangles]
    n = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    for ray in v:
        with np.errstate(divide="ignore", invalid="ignore"):
            z = np.einsum("ti,ti->t", n, p[:, 0]) / (n @ ray)
            hit = z[:, None] * ray
            sides = [np.einsum("ti,ti->t", np.cross(p[:, (k + 1) % 3] - p[:, k], hit - p[:, k]), n) for k in range(3)]
        z = np.where((z > 0) & (np.min(sides, axis=0) >= 0), z, np.inf)
        first = int(np.argmin(z))
        if np.isfinite(z[first]) and n[first] @ ray < 0:
            return True
    return False


def can_see(lens, T_cam_world, model) -> bool:
    """Is some triangle not wholly on the outer side of one plane of the picture's pyramid? Never False by mistake.

    For a lens that is no pinhole the pyramid is all that lies before the camera.
    """
    R, t = T_cam_world[:3, :3], T_cam_world[:3, 3]
    p = (model.vertices @ R.T + t)[model.triangles]
    planes = [np.array([0, 0, 1.0])]
    if lens.model == "LENSMODEL_PINHOLE":
        fx, fy, cx, cy = lens.intrinsics[:4]
        planes += [np.array([fx, 0, cx + 0.5]), np.array([-fx, 0, lens.width - 0.5 - cx])]
        planes += [np.array([0, fy, cy + 0.5]), np.array([0, -fy, lens.height - 0.5 - cy])]
    out = np.zeros(len(p), bool)
    for plane in planes:
        out |= ((p @ plane) <= 0).all(axis=1)
    return not out.all()
