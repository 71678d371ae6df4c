"""Models in other formats, made what a scene's folder may hold: OBJ and GLB stay as they are, glTF becomes one GLB,
PLY and STL an OBJ of one group, shapes of a Mitsuba scene and meshes of USD an OBJ with a group for each material.
"""

from __future__ import annotations

import re
from pathlib import Path

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import files_beside, gltf_file, mesh_files, mitsuba_models, obj_text, strangers_files, usd_models
from lib.given.formats import LeftOut

ONE_GROUP = "surface"
MOST_LIBRARIES = 500  # names of an OBJ that are looked for
DAMAGE = (ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError)  # what odd JSON raises


def convert(path) -> tuple[dict, list]:
    """({name in the scene's folder: content}, lines to say).  BadInput: a format that is not read, a damaged file."""
    path = Path(path)
    content = bounded.content(path)
    kind = strangers_files.kind_of(content)
    if kind is None and path.suffix.lower() == ".stl":
        kind = "an STL file"  # one that ends too early has not the length that tells it
    if kind == "a GLB file":
        return _of_glb(path, content)
    if kind == "a glTF file":
        packed, said = _packed(path, content)
        return {"model.glb": packed}, ["glTF and its buffers were packed into model.glb", *said]
    if kind in ("a PLY file", "an STL file"):
        points, faces, said = mesh_files.read(path, content, "ply" if kind == "a PLY file" else "stl")
        text = mesh_files.obj([(ONE_GROUP, ONE_GROUP, points, faces)])
        return {"model.obj": text}, [f"{kind} has no materials: everything is one group, {ONE_GROUP}", *said]
    if kind == "a Mitsuba scene":
        return _with_lamps(*mitsuba_models.read(path, content))
    if kind == "a USD file" or path.suffix.lower() == ".usdz":
        return _with_lamps(*usd_models.read(path))
    if kind:
        raise BadInput(f"{path}: is {kind}: {strangers_files.way_out(kind)}")
    return _of_obj(path, content)


def _with_lamps(parts, emits, said):
    """An OBJ and its materials, which say who emits."""
    lamps = "".join(f"newmtl {group}\nKe 1 1 1\n" for group in emits)
    return {"model.obj": b"mtllib model.mtl\n" + mesh_files.obj(parts), "model.mtl": lamps.encode()}, said


def emitters(files) -> list[str]:
    """Groups whose material says that it emits: Ke or map_Ke of an .mtl, emissiveFactor of a GLB."""
    found = []
    for name, content in files.items():
        if name.endswith(".mtl"):
            found += obj_text.emitting(content)
        elif name.endswith(".glb"):
            try:
                found += gltf_file.emitting(gltf_file.of_glb(name, content)[0])
            except (BadInput, *DAMAGE):
                pass
    return list(dict.fromkeys(found))


# ---- OBJ ----

LIBRARY = re.compile(r"^[ \t]*(mtllib[ \t](?!model\.mtl$)[^\n]*)$", re.M)


def _of_obj(path, content):
    """The OBJ, and all its libraries in one: no file of a stranger's takes a name that means something in a scene."""
    text = obj_text.decoded(content)
    rests = [line.split(None, 1)[1:] for _, line in obj_text.lines(text) if line.split(None, 1)[0] == "mtllib"]
    named = dict.fromkeys(name for rest in rests if rest for name in _split(rest[0].strip()))
    if sum(len(name.split()) for name in named) > MOST_LIBRARIES:
        raise BadInput(f"{path}: mtllib: more than {MOST_LIBRARIES} names")
    parts, said = {}, []
    for name in _names(path.parent, named):
        file, line = _library(path, name)
        if line:
            said.append(line)
        elif file not in parts:
            parts[file] = obj_text.decoded(bounded.content(file, bounded.LARGEST_TEXT))
    if obj_text.is_library(content) and not obj_text.names(content, "fo?"):
        raise BadInput(f"{path}: is a library of materials (.mtl): give the .obj that names it")
    if (unit := obj_text.unit(content)) not in (None, "m"):
        said.append(f"a comment tells lengths in {unit}: if that is so, write model: {{unit: {unit}}}")
    if not rests:
        return {"model.obj": content}, said
    text = LIBRARY.sub(r"# \1", LIBRARY.sub("mtllib model.mtl", text, count=1) if parts else text)
    files = {"model.obj": text.encode()}
    if parts:
        files["model.mtl"] = "\n".join(parts.values()).encode()
        known = set(obj_text.described(files["model.mtl"]))
        if unknown := [name for name in obj_text.names(content, "usemtl") if name not in known]:
            more = f" and {len(unknown) - 5} more" if len(unknown) > 5 else ""
            named = ", ".join(f"{name:.80}" for name in unknown[:5])
            said.append(
                f"materials that no library describes, so that nothing is known of what they emit: {named}{more}"
            )
        if doubled := obj_text.doubled(files["model.mtl"]):
            said.append(
                f"materials that the libraries describe twice, otherwise, are one group: {', '.join(doubled[:5])}"
            )
        if clear := obj_text.clear(files["model.mtl"]):
            said.append(f"materials that let light through are taken for opaque ones: {', '.join(clear[:5])}")
        left = LeftOut()
        left.add("material picture", obj_text.pictures(files["model.mtl"]))
        said += filter(None, [left.line()])
    return files, said


def _names(folder, named):
    """A name with blanks that is not there may be several names."""
    for name in named:
        words = name.split()
        several = len(words) > 1 and not files_beside.find(folder, name)
        yield from words if several and any(files_beside.find(folder, word) for word in words) else [name]


def _library(path, name):
    """(the library's path, None), or (None, a line that says why it is not read)."""
    last = re.split(r"[/\\]", name)[-1]
    found = files_beside.find(path.parent, name) or files_beside.find(path.parent, last)
    if found is None and bounded.lies_outside(name.replace("\\", "/")) or name[1:2] == ":" and found is None:
        return None, f"mtllib {name:.80} lies outside the model's folder and is ignored"
    if found is None:
        return None, f"mtllib {name:.80}: there is no such file beside the model: what its materials emit is not known"
    try:
        if obj_text.is_library(bounded.content(found, bounded.LARGEST_TEXT)):
            return found, None
    except BadInput as bad:
        return None, f"mtllib {name:.80} is left out: {bad.problems[0].removeprefix(f'{found}: ')}"
    return None, f"mtllib {name:.80} is no library of materials and is left out"


def _split(words):
    """Names of libraries: quoted, or parted where one ends in .mtl, or a single one with blanks in it.

    >>> _split('a.mtl my room.mtl "b c.mtl"'), _split("one two"), _split(r"C:\\x\\room.mtl")
    (['a.mtl', 'my room.mtl', 'b c.mtl'], ['one two'], ['C:\\\\x\\\\room.mtl'])
    """
    found = re.findall(r'"([^"]+)"|(\S.*?\.mtl)(?=\s|$)|(\S.*)$', words, re.I)
    return [next(filter(None, parts)).strip() for parts in found]


# ---- glTF ----


def _of_glb(path, content):
    """As it is; buffers that lie beside it are packed into it."""
    try:
        gltf, binary, _ = gltf_file.of_glb(path, content)
        gltf_file.check(path, gltf)
        if gltf_file.is_one_file(gltf):
            return {"model.glb": content}, _pictures(gltf)
        said = _pictures(gltf)
        return {"model.glb": gltf_file.packed(path, gltf, binary)}, [
            "buffers beside it were packed into model.glb",
            *said,
        ]
    except DAMAGE as error:
        raise BadInput(f"{path}: not readable glTF: {type(error).__name__}: {error}") from None


def _pictures(gltf):
    """A copy in a scene's folder may be without them: said once, here."""
    left = LeftOut()
    left.add("material picture", len(gltf.get("images") or ()))
    return [line for line in [left.line()] if line]


def _packed(path, content):
    """(a GLB of a .gltf and its buffers, which lie beside it or in it, lines to say)"""
    try:
        gltf = gltf_file.table(path, content)
        gltf_file.check(path, gltf)
        return gltf_file.packed(path, gltf), _pictures(gltf)
    except DAMAGE as error:
        raise BadInput(f"{path}: not readable glTF: {type(error).__name__}: {error}") from None
