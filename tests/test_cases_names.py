"""Names of groups that mean something to YAML, to a terminal or to nobody: a scene is made, and is read again."""

import json
import struct
from pathlib import Path

import pytest

from lib.given import model as models
from lib.given import new_scene
from lib.planning import files as quick
from lib.planning import folder
from lib.planning import scene as scenes
from lib.planning.pipeline import read_pipeline

BASE = Path(__file__).parent / "data" / "cases" / "base"
PIPELINE = Path(__file__).parents[1] / "pipeline.yaml"
NAMES = ["yes", "null", "1.0", "007", "2024-01-01", "#", "wall #1", "a: b", "- x", "{x}", "?", "=", "<<", "*a", "'q'"]
NAMES += ['a"b', "a\\b", "\U0001f4a1", "灯", "-", "x" * 3000, "a\u0085b", "a\u2028b", "a\x7fb", "\ufefflamp", "\ufffe"]


def scene_of(tmp_path, model):
    """(the scene as planning reads it, the model's groups)"""
    folder = tmp_path / "scene"
    folder.mkdir()
    new_scene.make(folder, model, BASE / "room.png", BASE / "room.cameramodel")
    scene = scenes.read(folder, read_pipeline(PIPELINE))
    return scene, models.load(next(folder.glob("model.[og]*"))).groups


@pytest.mark.parametrize("turn", [lambda x, y, z: (x, z, -y), lambda x, y, z: (x, -z, y)], ids=["y up", "z up"])
def test_a_model_of_other_axes_than_the_camera_s_is_said(tmp_path, turn):
    """Blender's exports of glTF and OBJ have y up, its camera z: check spoke of open walls alone."""
    lines = []
    for line in (BASE / "room.obj").read_text().splitlines():
        word, *rest = line.split()
        lines.append(" ".join([word, *(str(x) for x in turn(*map(float, rest)))]) if word == "v" else line)
    (tmp_path / "a.obj").write_text("\n".join(lines))
    for name, model in (("turned", tmp_path / "a.obj"), ("right", BASE / "room.obj")):
        (tmp_path / name).mkdir()
        said = new_scene.make(tmp_path / name, model, BASE / "room.png", BASE / "room.cameramodel")
        found = [line for line in said if "outside the model's box, and inside it if the model had" in line]
        assert len(found) == (name == "turned") and all("export the model with the camera's axes" in x for x in found)


@pytest.mark.parametrize(("longest", "unit"), [(500, "cm"), (5000, "mm"), (2000, "cm"), (50, None)])
def test_the_likelier_unit_of_a_room(tmp_path, longest, unit):
    """The base room is 5 m long: drawn in mm it was taken for 50 m, drawn in cm."""
    lines = []
    for line in (BASE / "room.obj").read_text().splitlines():
        word, *rest = line.split()
        lines.append(" ".join([word, *(str(float(x) * longest / 5) for x in rest)]) if word == "v" else line)
    (tmp_path / "a.obj").write_text("\n".join(lines))
    (tmp_path / "s").mkdir()
    said = new_scene.make(tmp_path / "s", tmp_path / "a.obj", BASE / "room.png")
    hints = [line for line in said if line.startswith("perhaps write model: {unit")]
    assert [line.split()[4].strip("}") for line in hints] == ([unit] if unit else [])


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name[:20]))
def test_a_lamp_of_any_name_is_read_again(tmp_path, name):
    text = (BASE / "room.obj").read_text().replace("usemtl lamp", f"usemtl {name}").replace("room.mtl", "a.mtl")
    (tmp_path / "a.obj").write_text(text, encoding="utf-8")
    (tmp_path / "a.mtl").write_text(f"newmtl {name}\nKe 1 1 1\n", encoding="utf-8")
    scene, groups = scene_of(tmp_path, tmp_path / "a.obj")
    assert scene.lamps == {name: "unknown"} and groups[-1] == name


@pytest.mark.parametrize("name", [*NAMES, " ", "\ud83d"], ids=lambda name: ascii(name[:20]))
def test_a_wall_of_any_name_that_no_lamp_is(tmp_path, name):
    """Names without a letter were a traceback; half a letter, which JSON may tell, is a question mark."""
    points = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
    gltf = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(points)}],
        "bufferViews": [{"buffer": 0, "byteLength": len(points)}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "materials": [{"name": name}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "nodes": [{"name": name, "mesh": 0}],
    }
    words = json.dumps(gltf).encode()
    words += b" " * (-len(words) % 4)
    body = struct.pack("<I4s", len(words), b"JSON") + words + struct.pack("<I4s", len(points), b"BIN\0") + points
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)
    scene, groups = scene_of(tmp_path, tmp_path / "a.glb")
    name = name.replace("\ud83d", "?")
    assert groups == (name,) and set(scene.lamps) <= {name}


def test_an_object_of_another_format_is_no_silence(tmp_path):
    """objects/chair.ply was passed over: the room was fitted without its chair."""
    (tmp_path / "objects").mkdir()
    for name in ("chair.ply", "table.GLB", "lamp.obj", "lamp.mtl", "notes.txt"):
        (tmp_path / "objects" / name).touch()
    assert [p.name for p in quick.unread_objects(tmp_path / "objects")] == ["chair.ply", "table.GLB"]
    (tmp_path / "scene.yaml").write_text("lamps: {}")
    problems = list(folder.folder_problems(scenes.read(tmp_path, read_pipeline(PIPELINE))))
    assert any("chair.ply: is not read: objects/ takes .obj and .glb: export it so" in line for line in problems)
