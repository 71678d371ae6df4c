"""The true pictures of augment_cases.py, by Mitsuba in the environment of `make scenes`:

    $ .venv-scenes/bin/python -m tests.bench.augment_truth OUT/ office [egg ...]      OUT/office.egg.npz

Each holds `linear` (H, W, 3), the mean of all passes, and `noise` (H, W, 3), its standard error; unless the camera is
another, also `change` and `change_noise`, the same of what the change has changed: both scenes take the same random
numbers, so paths that do not meet what is new say nothing but 0.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from lib.given.model import changes
from lib.synthetic import recipes
from lib.synthetic.geometry import Polygon
from lib.synthetic.mirrored_lamps import tracer
from lib.synthetic.mitsuba_scene import mitsuba_scene
from lib.synthetic.optics import look
from lib.synthetic.recipe import Surface
from tests.bench.augment_cases import CASES, FILES, VIEW

SPP, PASSES, ROULETTE = 64, 16, 6


def polygons_of(text, name, groups):
    """Polygons of an OBJ file's text. groups : group of the file -> name of its own"""
    vertices, group, out = [], None, []
    for line in text.splitlines():
        word, *rest = line.split()
        if word == "v":
            vertices.append([float(x) for x in rest])
        elif word == "usemtl":
            group = groups[rest[0]]
        elif word == "f":
            out.append(Polygon(name, group, np.array([vertices[int(i) - 1] for i in rest])))
    return out


def turned(angles):
    """Rz Ry Rx."""
    out = np.eye(3)
    for axis, angle in enumerate(angles):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        R = np.eye(3)
        R[i, i] = R[j, j] = np.cos(angle)
        R[j, i], R[i, j] = np.sin(angle), -np.sin(angle)
        out = R @ out
    return out


def changed(recipe, entry):
    """(recipe with the change, further shapes for Mitsuba)."""
    polygons = [p for p in recipe.polygons if p.object not in entry.get("remove", [])]
    shift = entry.get("move", {})
    polygons = [replace(p, points=p.points + np.array(shift[p.object])) if p.object in shift else p for p in polygons]
    materials, surfaces, lamps = dict(recipe.materials), dict(recipe.surfaces), dict(recipe.lamps)
    for group, material in entry.get("change", {}).items():
        if material.get("kind") == "mirror":
            polygons = _front_alone(polygons, group)
            materials = materials | {f"{group} edge": (0.0, 0.0, 0.0)}
        materials, surfaces = _of(material, group, materials, surfaces)
    lamps |= {name: tuple(E) for name, E in entry.get("lamps", {}).items()}
    more = {}
    if thing := entry.get("add"):
        material, turn = thing["material"], turned(thing.get("rotate", [0, 0, 0]))
        at, scale = np.array(thing["at"], float), thing.get("scale", 1.0)
        if "file" in thing:
            new = polygons_of(FILES[thing["file"]], "added", {"lamp": "added", "box": "added"})
            polygons += [replace(p, points=at + scale * p.points @ turn.T) for p in new]
            if "emittance" in material:
                lamps["added"] = tuple(material["emittance"])
            else:
                materials, surfaces = _of(material, "added", materials, surfaces)
        else:
            axes = np.array(thing.get("ellipsoid") or 3 * [thing["sphere"]], float)
            bsdf = {"type": "conductor", "material": "none"}
            if material["kind"] == "diffuse":
                bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": material["rho_d"]}}
            more["added"] = {"axes": axes, "turn": turn, "at": at, "bsdf": {"type": "twosided", "bsdf": bsdf}}
    if "camera" in entry:
        recipe = replace(recipe, T_cam_world=look(np.array(VIEW["eye"]), np.array(VIEW["at"])))
    made = replace(recipe, polygons=tuple(polygons), materials=materials, surfaces=surfaces, lamps=lamps)
    return made, more


def _front_alone(polygons, group):
    """The largest polygon of a board keeps its group, for a mirror is one polygon; its edges, hidden by a frame, do
    not."""
    front = max((p for p in polygons if p.group == group), key=Polygon.area)
    return [replace(p, group=f"{group} edge") if p.group == group and p is not front else p for p in polygons]


def ellipsoid(mi, path, axes, turn, at, bsdf):
    """Mitsuba's sphere, or a fine mesh with the ellipsoid's own normals, for which Mitsuba has no shape."""
    T = np.eye(4)
    T[:3, 3] = at
    if np.ptp(axes) == 0:
        T[:3, :3] = turn * axes
        return {"type": "sphere", "to_world": mi.ScalarTransform4f(T.tolist()), "bsdf": bsdf}
    unit = changes.ellipsoid([1, 1, 1], "egg", finer=6)
    p, n = at + (unit.vertices * axes) @ turn.T, (unit.vertices / axes) @ turn.T
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    head = ["ply", "format ascii 1.0", f"element vertex {len(p)}"]
    head += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    head += [f"element face {len(unit.triangles)}", "property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(f"{x:.9g}" for x in row) for row in np.hstack([p, n])]
    path.write_text("\n".join(head + rows + [f"3 {a} {b} {c}" for a, b, c in unit.triangles]) + "\n")
    return {"type": "ply", "filename": str(path), "bsdf": bsdf}


def _of(material, group, materials, surfaces):
    if material.get("kind") == "mirror":
        return materials | {group: (0.0, 0.0, 0.0)}, surfaces | {group: Surface("mirror", (1, 1, 1))}
    surfaces = {name: surface for name, surface in surfaces.items() if name != group}
    if material.get("kind") == "glossy":
        surfaces[group] = Surface("glossy", tuple(material["rho_s"]), tuple(material["alpha"]))
    return materials | {group: tuple(material["rho_d"])}, surfaces


def passes(mi, recipe, more, spp=SPP, n=PASSES):
    """(n, H, W, 3) independent pictures, linear; the same seeds whatever the recipe."""
    with tempfile.TemporaryDirectory() as folder:
        shapes = {name: ellipsoid(mi, Path(folder) / f"{name}.ply", **shape) for name, shape in more.items()}
        scene = mitsuba_scene(mi, recipe, Path(folder), ROULETTE, more=shapes)
        integrator = tracer(mi, recipe, scene, ROULETTE)
        one = lambda seed: np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed), np.float32)
        return np.stack([one(seed)[..., :3] * np.pi for seed in range(n)])


def mean_and_error(pictures):
    return pictures.mean(axis=0, dtype=float), pictures.std(axis=0, ddof=1, dtype=float) / np.sqrt(len(pictures))


def main(out, scene, names):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    before = None
    for name in names or CASES[scene]:
        recipe, more = changed(recipes.make(scene), CASES[scene][name])
        after = passes(mi, recipe, more)
        arrays = dict(zip(("linear", "noise"), mean_and_error(after), strict=True))
        if "camera" not in CASES[scene][name]:
            before = passes(mi, recipes.make(scene), {}) if before is None else before
            arrays |= dict(zip(("change", "change_noise"), mean_and_error(after - before), strict=True))
        path = Path(out) / f"{scene}.{name}.npz"
        np.savez_compressed(path, **{key: values.astype(np.float32) for key, values in arrays.items()})
        print(path, flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
