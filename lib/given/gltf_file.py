"""glTF 2 without NumPy: the container, the buffers, the names of groups, and which extensions are understood.

gltf, binary, spare = of_glb(path, content)
check(path, gltf)                       # version, extensions that the file requires
groups(gltf)                            # a name for each material, no two alike
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from pathlib import Path
from urllib.parse import unquote, unquote_to_bytes

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import files_beside

VISIBILITY, INSTANCING, LIGHTS = "KHR_node_visibility", "EXT_mesh_gpu_instancing", "KHR_lights_punctual"
READ = {VISIBILITY, INSTANCING, LIGHTS, "KHR_mesh_quantization", "KHR_materials_variants"}
# What these say is of colours, pictures, lamps without faces, or words: nothing of it moves a vertex.
LOOKS = ("KHR_materials_", "EXT_materials_", "ADOBE_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_")
LOOKS += ("KHR_lights_", "EXT_lights_", "MSFT_packing_", "KHR_xmp", "KHR_animation_pointer")
PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
UNPACK = "`gltf-transform copy IN.glb OUT.glb` writes it uncompressed"


def of_glb(path, content) -> tuple[dict, bytes, int]:
    """(the JSON, the binary chunk, how many bytes stand behind the file's end). BadInput: damaged, not glTF 2"""
    try:
        magic, version, total = struct.unpack_from("<4sII", content)
    except struct.error:
        raise BadInput(f"{path}: not a readable GLB: {len(content)} bytes") from None
    if magic != b"glTF":
        raise BadInput(f"{path}: not a readable GLB: it begins with {magic!r}")
    if version != 2:
        raise BadInput(f"{path}: version: glTF {version} instead of 2: export it as glTF 2.0")
    if total > len(content):
        raise BadInput(f"{path}: truncated: {total} bytes are announced, {len(content)} are there")
    chunks, at = {}, 12
    while at + 8 <= total:
        length, kind = struct.unpack_from("<I4s", content, at)
        if at + 8 + length > total:
            raise BadInput(f"{path}: truncated: a chunk of {length} bytes, {total - at - 8} are there")
        chunks.setdefault(kind, content[at + 8 : at + 8 + length])
        at += 8 + length
    if b"JSON" not in chunks:
        raise BadInput(f"{path}: not a readable GLB: it has no chunk of JSON")
    return table(path, chunks[b"JSON"].rstrip(b"\0 ")), chunks.get(b"BIN\0", b""), len(content) - total


def table(path, content) -> dict:
    """The JSON of a .gltf or a GLB. BadInput: it is no table"""
    gltf = bounded.json_of(path, content)
    if not isinstance(gltf, dict):
        raise BadInput(f"{path}: not readable glTF: the JSON is no table")
    return gltf


def check(path, gltf):
    """BadInput: another version, or an extension that the file requires and that is not understood."""
    asset = gltf.get("asset")
    asset = asset if isinstance(asset, dict) else {}
    version = str(asset.get("minVersion") or asset.get("version") or "2.0")
    if version not in ("2.0", "2") or isinstance(gltf.get("meshes"), dict):
        told = "1" if isinstance(gltf.get("meshes"), dict) else f"{version:.20}"
        raise BadInput(f"{path}: version: glTF {told} instead of 2: export it as glTF 2.0")
    wanted = [name for name in _names(gltf, "extensionsRequired") if not _understood(name)]
    if packed := [name for name in wanted if name in PACKED]:
        raise BadInput(f"{path}: extensionsRequired: {', '.join(packed)} is not read: {UNPACK}")
    if wanted:
        raise BadInput(
            f"{path}: extensionsRequired: {', '.join(f'{name:.80}' for name in wanted[:5])}: not known here: export "
            "it without, or through Blender"
        )


def not_understood(gltf) -> list[str]:
    """Extensions that the file uses and does not require, and that are not read."""
    return [name for name in _names(gltf, "extensionsUsed") if not _understood(name)]


def _names(gltf, key):
    return list(dict.fromkeys(map(str, gltf.get(key) or ())))


def _understood(name):
    return name in READ or name.startswith(LOOKS)


def own(gltf) -> bool:
    """Written by this project: then nodes of one name are one object, and extras tell the order."""
    return isinstance(gltf.get("asset"), dict) and gltf["asset"].get("generator") == "anasyn"


# ---- materials ----


def groups(gltf) -> list[str]:
    """A name for each material, no two alike: the second "Paint" is "Paint.2".

    >>> groups({"materials": [{"name": "Paint"}, {}, {"name": "Paint"}, {"name": "Paint.2"}]})
    ['Paint', 'material 1', 'Paint.3', 'Paint.2']
    """
    return apart([written(m.get("name")) or f"material {k}" for k, m in enumerate(gltf.get("materials") or ())])


def written(name) -> str:
    """A name as text that a file can hold: JSON may tell half a letter. Empty where it is none.

    >>> written("Paint"), written(None), written("\\ud83d")
    ('Paint', '', '?')
    """
    return "" if name is None else str(name).encode("utf-8", "replace").decode()


def apart(names) -> list[str]:
    """The names, each but the first of its like with a number behind it."""
    taken, used, numbers, made = set(names), set(), {}, []
    for name in names:
        new = name
        while new in used or (new != name and new in taken):
            numbers[name] = numbers.get(name, 1) + 1
            new = f"{name}.{numbers[name]}"
        used.add(new)
        made.append(new)
    return made


def emitting(gltf) -> list[str]:
    """Groups whose material emits."""
    named = zip(groups(gltf), gltf.get("materials") or (), strict=True)
    return [name for name, material in named if any(material.get("emissiveFactor") or ()) and _strength(material) != 0]


def _strength(material):
    return ((material.get("extensions") or {}).get("KHR_materials_emissive_strength") or {}).get("emissiveStrength", 1)


def clear(gltf) -> list[str]:
    """Groups whose material lets light through."""
    made = []
    for name, material in zip(groups(gltf), gltf.get("materials") or (), strict=True):
        more = material.get("extensions") or {}
        through = (more.get("KHR_materials_transmission") or {}).get("transmissionFactor", 0)
        through = through or (more.get("KHR_materials_diffuse_transmission") or {}).get("diffuseTransmissionFactor", 0)
        colour = (material.get("pbrMetallicRoughness") or {}).get("baseColorFactor") or (1, 1, 1, 1)
        if through or (material.get("alphaMode") == "BLEND" and colour[3] < 1):
            made.append(name)
    return made


# ---- buffers ----


def inline(uri) -> bytes:
    """The bytes of a data: address, of Base64 or percent-encoded. ValueError: damaged

    >>> inline("data:application/octet-stream;base64,AAE%3D"), inline("data:,%00a")
    (b'\\x00\\x01', b'\\x00a')
    """
    head, comma, words = uri.partition(",")
    if not comma:
        raise ValueError("a data: address without a comma")
    if head.lower().endswith(";base64"):
        try:
            return base64.b64decode(unquote(words))
        except binascii.Error as error:
            raise ValueError(f"Base64: {error}") from None
    return unquote_to_bytes(words)


def buffers(path, gltf, binary, beside=False) -> list[bytes]:
    """The bytes of each buffer. BadInput: fewer than announced, or (without `beside`) in another file

    binary : the GLB's own;  beside : are files beside the path read, too
    """
    made = []
    for k, buffer in enumerate(gltf.get("buffers") or ()):
        uri, where = buffer.get("uri"), f"{path}: buffers[{k}]"
        if uri is None and k:
            raise BadInput(f"{where}: has no data: {UNPACK}")  # a place for what an extension would unpack
        elif uri is None:
            data = binary
        elif uri[:5].lower() == "data:":
            data = inline(uri)
        elif beside:
            data = bounded.content(file_of(path, uri))
        else:
            raise BadInput(f"{where}: uri: {uri:.80} is another file: make new-scene MODEL=... packs it into one")
        if uri is not None and len(data) < buffer["byteLength"]:  # of the file's own, accessors are looked at
            raise BadInput(f"{where}: truncated: {buffer['byteLength']} bytes are announced, {len(data)} are there")
        made.append(data)
    return made


def file_of(path, uri):
    """The file beside a .gltf that an address names: percent-encoded, as the standard says, or as it stands.

    BadInput: outside the model's folder, or not there
    """
    path = Path(path)
    for name in dict.fromkeys((unquote(uri), uri)):
        if found := files_beside.find(path.parent, name):
            return found
    if "://" in uri or bounded.lies_outside(unquote(uri)) or bounded.lies_outside(unquote(uri).replace("\\", "/")):
        raise BadInput(f"{path}: {uri:.80} lies outside the model's folder")
    return path.parent / unquote(uri)  # reading it says that it is not there


def is_one_file(gltf) -> bool:
    """Whether all buffers are in the file."""
    return all(b.get("uri") is None or b["uri"][:5].lower() == "data:" for b in gltf.get("buffers") or ())


def packed(path, gltf, binary=b"") -> bytes:
    """A GLB of a glTF whose buffers lie beside it or in it. Pictures are left out."""
    joined, starts = bytearray(), []
    for data, buffer in zip(buffers(path, gltf, binary, beside=True), gltf.get("buffers") or (), strict=True):
        starts.append(len(joined))
        joined += data[: buffer["byteLength"]]
        joined += bytes(-len(joined) % 4)
    for view in gltf.get("bufferViews") or ():
        view["byteOffset"] = view.get("byteOffset", 0) + starts[view.get("buffer", 0)]
        view["buffer"] = 0
    gltf = {key: value for key, value in gltf.items() if key not in ("images", "textures", "samplers")}
    gltf["buffers"] = [{"byteLength": len(joined)}]
    if "materials" in gltf:
        gltf["materials"] = _without_pictures(gltf["materials"])
    return _chunks(json.dumps(gltf).encode(), bytes(joined))


def _without_pictures(value):
    """A material's JSON without what points to textures."""
    if isinstance(value, list):
        return [_without_pictures(item) for item in value]
    if isinstance(value, dict):
        return {key: _without_pictures(item) for key, item in value.items() if not key.endswith("Texture")}
    return value


def _chunks(words, binary):
    parts = [(b"JSON", words + b" " * (-len(words) % 4)), (b"BIN\0", binary)]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in parts)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
