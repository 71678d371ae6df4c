"""A model as binary glTF 2, from which lib/given/model reads the same facets, objects and groups in the same order."""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path

import numpy as np

from lib.core import artefact
from lib.given import model as models
from lib.given.model.glb import REMAINDER
from lib.given.model.mesh import Model

FLOAT, UNSIGNED = 5126, 5125


def write_glb(path, model: Model):
    """Whole or absent. Positions are single precision about the model's middle: 0.1 um in a room of 2 m.

    What that leaves of a position stands in an attribute of our own, which other programs skip.
    """
    owner = np.column_stack([model.facet_object, model.facet_group])[model.triangle_facet]
    first = np.flatnonzero(np.any(np.diff(owner, axis=0, prepend=-1), axis=1))
    middle = (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2
    binary, views, accessors, nodes, meshes = bytearray(), [], [], [], []

    def stored(array, kind, width, **more):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes})
        binary.extend(array.tobytes())
        accessors.append(
            {"bufferView": len(views) - 1, "componentType": kind, "count": len(array), "type": width} | more
        )
        return len(accessors) - 1

    for start, end in zip(first, [*first[1:], len(owner)], strict=True):
        used, index = np.unique(model.triangles[start:end], return_inverse=True)
        exact = model.vertices[used] - middle
        points = exact.astype("<f4")
        box = {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
        position = stored(points, FLOAT, "VEC3", **box)
        remainder = stored((exact - points).astype("<f4"), FLOAT, "VEC3")
        indices = stored(index.astype("<u4").reshape(-1), UNSIGNED, "SCALAR")
        attributes = {"POSITION": position, REMAINDER: remainder}
        primitive = {"attributes": attributes, "indices": indices, "material": int(owner[start, 1])}
        meshes.append({"primitives": [primitive]})
        name = model.objects[owner[start, 0]]
        nodes.append({"name": name, "mesh": len(meshes) - 1, "translation": middle.tolist()})
    gltf = {
        "asset": {"version": "2.0", "generator": "anasyn"},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "meshes": meshes,
        "materials": [{"name": name} for name in model.groups],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
        "extras": {"objects": list(model.objects), "groups": list(model.groups)} | _more(model),
    }
    with artefact.writing(path) as partial:
        Path(partial).write_bytes(_chunks(json.dumps(gltf).encode(), bytes(binary)))


def _more(model):
    """What is said of the file that the model was read from, and facets without triangles: of objects that are not
    there, and whose names and numbers are kept."""
    none = np.setdiff1d(np.arange(model.n_facets), model.triangle_facet)
    rows = [[int(f), int(model.facet_object[f]), int(model.facet_group[f])] for f in none]
    return ({"absent": rows} if rows else {}) | ({"notes": list(model.notes)} if model.notes else {})


def _chunks(words, binary):
    parts = [(b"JSON", words + b" " * (-len(words) % 4)), (b"BIN\0", binary + bytes(-len(binary) % 4))]
    body = b"".join(struct.pack("<I4s", len(content), kind) + content for kind, content in parts)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def keeps_parts(model: Model) -> bool:
    """Whether a file of the model is read with the same facets, objects and groups, and as closed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.glb"
        write_glb(path, model)
        return same_parts(models.load(path), model)


def same_parts(a: Model, b: Model) -> bool:
    """Facets, objects and groups bear the same numbers, and the same objects close."""
    facets = lambda m: (m.objects, m.groups, m.facet_object.tolist(), m.facet_group.tolist())
    alike = facets(a) == facets(b) and a.closed_objects.tolist() == b.closed_objects.tolist()
    return alike and bool((np.einsum("ij,ij->i", a.facet_normal, b.facet_normal) > 0.999).all())
