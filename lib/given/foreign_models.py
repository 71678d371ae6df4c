"""Models in other formats, made what a scene's folder may hold: OBJ and GLB stay as they are, glTF becomes one GLB,
PLY and STL an OBJ of one group, shapes of a Mitsuba scene and meshes of USD an OBJ with a group for each material.
"""

from __future__ import annotations

import base64
import json
import struct
from pathlib import Path

import numpy as np

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import mesh_files, mitsuba_models, strangers_files, usd_models

ONE_GROUP = "surface"


def convert(path) -> tuple[dict, list]:
    """({name in the scene's folder: content}, lines to say).  BadInput: a format that is not read, a damaged file."""
    path = Path(path)
    content = bounded.content(path)
    kind = strangers_files.kind_of(content)
    if kind == "a GLB file":
        return {"model.glb": content}, []
    if kind == "a glTF file":
        return {"model.glb": _packed(path, content)}, ["glTF and its buffers were packed into model.glb"]
    if kind in ("a PLY file", "an STL file"):
        text = _of_trimesh(path, kind)
        return {"model.obj": text}, [f"{kind} has no materials: everything is one group, {ONE_GROUP}"]
    if kind == "a Mitsuba scene":
        return _with_lamps(*mitsuba_models.read(path, content))
    if kind == "a USD file" or path.suffix.lower() == ".usdz":
        return _with_lamps(*usd_models.read(path))
    if kind:
        raise BadInput(f"{path}: is {kind}: {strangers_files.way_out(kind)}")
    files, said = {"model.obj": content}, []
    for name in _libraries(content):
        beside = path.parent / name
        if beside.parent != path.parent or name in ("", ".", ".."):
            said.append(f"mtllib {name:.80} lies outside the model's folder and is ignored")
        elif beside.is_file() and name not in files:
            files[name] = bounded.content(beside, bounded.LARGEST_TEXT)
    return files, said


def _with_lamps(parts, emits, said):
    """An OBJ and its materials, which say who emits."""
    lamps = "".join(f"newmtl {group}\nKe 1 1 1\n" for group in emits)
    return {"model.obj": b"mtllib model.mtl\n" + mesh_files.obj(parts), "model.mtl": lamps.encode()}, said


def _libraries(content):
    """Names of the .mtl files of an OBJ; what lies elsewhere is not needed."""
    rows = [line.split(None, 1) for line in content.decode("utf-8", "replace").splitlines()]
    return list(dict.fromkeys(row[1].strip() for row in rows if len(row) == 2 and row[0] == "mtllib"))


def emitters(files) -> list[str]:
    """Groups whose material says that it emits: Ke of an .mtl, emissiveFactor of a GLB."""
    found = []
    for name, content in files.items():
        if name.endswith(".mtl"):
            group = None
            for line in content.decode("utf-8", "replace").splitlines():
                word, _, rest = line.strip().partition(" ")
                if word == "newmtl":
                    group = rest.strip()
                elif word == "Ke" and any(float(v) > 0 for v in rest.split()[:3] if _number(v)):
                    found.append(group)
        elif name.endswith(".glb"):
            try:
                length = int.from_bytes(content[12:16], "little")
                for material in bounded.json_of(name, content[20 : 20 + length]).get("materials", []):
                    if any(material.get("emissiveFactor", [])):
                        found.append(material.get("name"))
            except (BadInput, AttributeError, TypeError):
                pass
    return [name for name in dict.fromkeys(found) if name]


def _number(text):
    try:
        return np.isfinite(float(text))
    except ValueError:
        return False


# ---- glTF ----


def _packed(path, content):
    """A GLB of a .gltf and its buffers, which lie beside it or in it."""
    try:
        gltf = bounded.json_of(path, content)
        binary, starts = bytearray(), []
        for buffer in gltf.get("buffers", []):
            starts.append(len(binary))
            uri = buffer.pop("uri")
            inline = uri.startswith("data:")
            data = base64.b64decode(uri.partition(",")[2]) if inline else bounded.content(mesh_files.beside(path, uri))
            binary += data[: buffer["byteLength"]] + bytes(-buffer["byteLength"] % 4)
        for view in gltf.get("bufferViews", []):
            view["byteOffset"] = view.get("byteOffset", 0) + starts[view.get("buffer", 0)]
            view["buffer"] = 0
        gltf["buffers"] = [{"byteLength": len(binary)}]
        for key in ("images", "textures"):  # pictures are not read, and may lie elsewhere
            gltf.pop(key, None)
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError) as error:
        raise BadInput(f"{path}: not readable glTF: {type(error).__name__}: {error}") from None
    words = json.dumps(gltf).encode()
    parts = [(b"JSON", words + b" " * (-len(words) % 4)), (b"BIN\0", bytes(binary))]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in parts)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


# ---- PLY, STL ----


def _of_trimesh(path, kind):
    points, faces = mesh_files.mesh(path, "ply" if kind == "a PLY file" else "stl")
    return mesh_files.obj([(ONE_GROUP, ONE_GROUP, points, faces)])
