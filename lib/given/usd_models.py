"""Models in USD (usda, usdc, usdz) as an OBJ with its materials, where USD's own package, usd-core, is installed."""

from __future__ import annotations

import numpy as np

from lib.core.stage import BadInput

WITHOUT = (
    "is a USD file, and its package is not installed: .venv/bin/python -m pip install usd-core, or export OBJ or GLB"
)


def read(path) -> tuple[list, dict, list]:
    """([(object, group, points (V, 3) m, faces)], {group: emits}, lines to say) of the meshes that are shown.

    Points stand in the stage's own axes, in metres by its metersPerUnit. A group is the material that is bound to a
    mesh or to a subset of its faces; lights of USD's own, which have no faces, are named in a line.
    BadInput: no package, a file that it cannot open, shapes that are no meshes, no faces
    """
    try:
        from pxr import Tf, Usd, UsdGeom, UsdLux
    except ImportError:
        raise BadInput(f"{path}: {WITHOUT}") from None
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise BadInput(f"{path}: not readable: {' '.join(str(error).split())[:200]}") from None
    metres, parts, emits, left, lights = UsdGeom.GetStageMetersPerUnit(stage), [], {}, [], []
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.IsA(UsdGeom.Imageable) and UsdGeom.Imageable(prim).ComputeVisibility() == "invisible":
            continue
        if prim.IsA(UsdGeom.Mesh):
            parts += _of_mesh(UsdGeom.Mesh(prim), metres, emits)
        elif prim.IsA(UsdGeom.Gprim):
            left.append(f"{prim.GetName()} ({prim.GetTypeName()})")
        elif prim.HasAPI(UsdLux.LightAPI):
            lights.append(prim.GetName())
    if left:
        raise BadInput(f"{path}: shapes that are not read: {', '.join(left[:5])}; make meshes of them")
    if not parts:
        raise BadInput(f"{path}: has no mesh")
    up = str(UsdGeom.GetStageUpAxis(stage)).lower()
    said = [f"USD, {metres:g} m to its unit: written in metres", *([f"its up axis is {up}"] if up != "z" else [])]
    said += [f"lights without faces are left out, draw them: {', '.join(lights[:5])}"] if lights else []
    return parts, emits, said


def _of_mesh(mesh, metres, emits):
    """Parts of one mesh, one for each material."""
    from pxr import Usd, UsdGeom, UsdShade

    T = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))  # rows: p' = (p, 1) T
    points = np.array(mesh.GetPointsAttr().Get() or np.zeros((0, 3)), float).reshape(-1, 3)
    points = metres * (points @ T[:3, :3] + T[3, :3])
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], int)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], int)
    where, name = str(mesh.GetPath()), mesh.GetPrim().GetName()
    if counts.sum() != len(corners) or len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
        raise BadInput(f"{where}: faceVertexIndices do not belong to its {len(counts)} faces and {len(points)} points")
    turned = (mesh.GetOrientationAttr().Get() == "leftHanded") != (np.linalg.det(T[:3, :3]) < 0)
    faces = [tuple(face)[::-1] if turned else tuple(face) for face in np.split(corners, np.cumsum(counts)[:-1])]
    group_of = np.full(len(faces), _material(UsdShade.MaterialBindingAPI(mesh), name, emits), object)
    for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
        bound = UsdShade.MaterialBindingAPI(subset).ComputeBoundMaterial()[0]
        if bound:
            group_of[np.array(subset.GetIndicesAttr().Get(), int)] = _named(bound, emits)
    some = [face for face, count in zip(faces, counts, strict=True) if count >= 3]
    names = group_of[counts >= 3]
    parts = []
    for group in dict.fromkeys(names):
        own = [face for face, of in zip(some, names, strict=True) if of == group]
        used, index = np.unique(np.concatenate(own), return_inverse=True)
        split = np.split(index, np.cumsum([len(face) for face in own])[:-1])
        parts.append((name, group, points[used], [tuple(face) for face in split]))
    return parts


def _material(binding, name, emits):
    bound = binding.ComputeBoundMaterial()[0]
    return _named(bound, emits) if bound else name


def _named(material, emits):
    """Its name; notes whether one of its shaders emits."""
    from pxr import UsdShade

    name = material.GetPrim().GetName()
    for prim in material.GetPrim().GetChildren():
        shader = UsdShade.Shader(prim)
        for key in ("emissiveColor", "emission_color", "emission"):
            value = shader.GetInput(key).Get() if shader and shader.GetInput(key) else None
            if value is not None and np.any(np.array(value, float) > 0):
                emits[name] = True
    return name
