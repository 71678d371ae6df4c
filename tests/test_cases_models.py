"""Intact models of ordinary tools that were misread once: OBJ and MTL, glTF, PLY, STL. Each with the right value.

Files in tests/data/cases are the cases of the issue; those in tests/data/writers were written by the tools themselves.
"""

import base64
import json
import os
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest

from lib.core import artefact, bounded
from lib.core.stage import BadInput
from lib.given import foreign_models, mesh_files, strangers_files
from lib.given import model as models
from lib.given.model.glb_writer import write_glb
from lib.planning import files as quick
from tests.helpers import confined

DATA = Path(__file__).parent / "data"
CASES, BLENDER, PACKED = DATA / "cases", DATA / "writers" / "blender", DATA / "writers" / "gltf-transform"


@pytest.fixture
def new(tmp_path):
    """new(path) -> (model as a scene would have it, all lines said of it, groups that emit)"""

    def call(path, bare=None):
        files, said = foreign_models.convert(path)
        folder = tmp_path / "scene"
        folder.mkdir(exist_ok=True)
        for name, content in files.items():
            (folder / name).write_bytes(content)
        model = models.load(folder / next(iter(files)), bare=bare)
        return model, [*said, *model.notes, *model.warnings], foreign_models.emitters(files)

    return call


@pytest.fixture
def base():
    return models.load(CASES / "base" / "room.obj")


def area_of(model):
    """{group: m2}"""
    sums = np.bincount(model.facet_group, model.facet_area(), len(model.groups))
    return dict(zip(model.groups, sums.round(4).tolist(), strict=True))


def box(model):
    p = model.corners().reshape(-1, 3)
    return np.round([p.min(axis=0), p.max(axis=0)], 3).tolist()


def refusal(path):
    with pytest.raises(BadInput) as refused:
        model = foreign_models.convert(path)[0]
        folder = Path(path).parent / "refused"
        folder.mkdir()
        for name, content in model.items():
            (folder / name).write_bytes(content)
        models.load(folder / next(iter(model)))
    (line,) = refused.value.problems
    return line


# ---- the cases ----


def test_case_12_normalized_positions(new, base):
    """Integers over 32767: the room is 5 m long, not 163,838."""
    model, said, _ = new(CASES / "12-glb-normalized-positions" / "norm.glb")
    assert box(model) == box(base) == [[0, 0, 0], [4, 5, 2.5]] and said == []
    assert area_of(model) == pytest.approx(area_of(base), abs=2e-3)


def test_case_14_materials_of_one_name(new, base):
    """Two groups each, by the order of the file; the quick look of planning knows the same names."""
    path = CASES / "14-glb-same-material-name" / "dup.glb"
    model, said, _ = new(path)
    assert model.groups == ("Material", "ceiling", "wall", "back", "Paint", "Paint.2", "crate", "Material.2", "lamp")
    assert said == ["materials of one name are groups of their own: Paint.2, Material.2"]
    assert list(area_of(model).values()) == list(area_of(base).values())
    assert quick.model_groups(path) == set(model.groups)


def test_case_15_percent_encoded_names(new, base):
    model, said, _ = new(CASES / "15-gltf-percent-encoded-uri" / "my room.gltf")
    assert area_of(model) == area_of(base) and said == ["glTF and its buffers were packed into model.glb"]


def test_case_17_lights_without_faces(new, base):
    model, said, emits = new(CASES / "17-glb-punctual-lights" / "punct.glb")
    assert said == ["lights without faces are left out, draw them: Light"] and emits == []
    assert "lamp" not in model.groups and len(model.groups) == 8


def test_case_18_hidden_nodes(new, base):
    model, said, _ = new(CASES / "18-glb-hidden-node" / "hidden.glb")
    assert said == ["1 hidden node: not read"]
    assert area_of(model) == {group: area for group, area in area_of(base).items() if group != "crate"}


def test_case_20_a_comment_ends_with_its_line(new, base):
    model, said, _ = new(CASES / "20-obj-comment-ends-in-backslash" / "bs.obj")
    unknown = "materials that no library describes, so that nothing is known of what they emit: lamp"
    assert area_of(model) == area_of(base) and box(model) == box(base) and said == [unknown]


@pytest.mark.parametrize("name", ["abspath", "quoted", "twolibs", "winpath"])
def test_case_21_libraries_by_any_name(new, name):
    _, said, emits = new(CASES / "21-obj-mtllib-not-found-unsaid" / f"{name}.obj")
    assert emits == ["X7"]
    missing = "mtllib colours.mtl: there is no such file beside the model: what its materials emit is not known"
    assert said == ([missing] if name == "twolibs" else [])


@pytest.mark.parametrize(("name", "said"), [("trail", ["2 spare bytes: not read"]), ("up", [])])
def test_case_27_stl(new, base, name, said):
    model, lines, _ = new(CASES / "27-stl-not-recognised" / f"{name}.stl")
    assert lines == ["an STL file has no materials: everything is one group, surface", *said]
    assert np.isclose(model.facet_area().sum(), base.facet_area().sum()) and box(model) == box(base)


def test_case_44_no_picture_is_looked_for(new, capfd):
    model, said, _ = new(CASES / "44-ply-texture-comment" / "s.ply")
    assert area_of(model) == {"surface": 0.5} and len(said) == 1
    assert capfd.readouterr() == ("", "")


# ---- libraries of materials ----

OBJ = "mtllib {}\no a\nusemtl glow\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
MTL = b"newmtl glow\nKe\t1 1 1\n"


@pytest.mark.parametrize("name", ["materials.json", "left.png", "pose.csv", "scene.yaml", "left.cameramodel"])
def test_only_libraries_are_taken_and_under_a_name_of_our_own(tmp_path, name):
    """Nothing of a stranger's lands beside the scene's files: neither what is no library, nor one with such a name."""
    (tmp_path / "a.obj").write_text(OBJ.format(name))
    (tmp_path / name).write_text("{}")
    files, said = foreign_models.convert(tmp_path / "a.obj")
    assert list(files) == ["model.obj"] and said == [f"mtllib {name} is no library of materials and is left out"]
    assert b"\nmtllib" not in b"\n" + files["model.obj"]
    (tmp_path / name).write_bytes(MTL)
    files, said = foreign_models.convert(tmp_path / "a.obj")
    assert list(files) == ["model.obj", "model.mtl"] and said == []
    assert files["model.obj"].startswith(b"mtllib model.mtl\no a\n") and foreign_models.emitters(files) == ["glow"]


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("my room.mtl", "my room.mtl"),
        ('"my room.mtl" ', "my room.mtl"),
        ("other.mtl my room.mtl", "my room.mtl"),
        ("one two", "two"),
        ("./parts/room.mtl", "parts/room.mtl"),
        (r"parts\room.mtl", "parts/room.mtl"),
        (r"\\server\share\room.mtl", "room.mtl"),
        ("/home/somebody/room.mtl", "room.mtl"),
        ("../room.mtl", "room.mtl"),
        ("ROOM.MTL", "room.mtl"),
        ("W\u00e4nde.mtl", "Wa\u0308nde.mtl"),  # composed, and not: as macOS writes it
        ("room.mtl\r", "room.mtl"),
    ],
)
def test_libraries_are_found(tmp_path, line, name):
    (tmp_path / "a.obj").write_bytes(OBJ.format(line).encode())
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_bytes(MTL)
    assert foreign_models.emitters(foreign_models.convert(tmp_path / "a.obj")[0]) == ["glow"]


def test_materials_and_pictures_of_a_library_are_counted(new, tmp_path):
    """`usemtl Glow` is no `glow` of the library, nor is one with a comment behind it."""
    text = OBJ.format("a.mtl") + "usemtl Glow\nf 1 3 2\nusemtl glow # 2\nf 2 3 1\n"
    (tmp_path / "a.obj").write_text("# File units = inches\n" + text)
    (tmp_path / "a.mtl").write_bytes(MTL + b"map_Kd x.png\nmap_Bump -bm 1 y.png\nnewmtl b\nmap_Kd x.png\n")
    _, said, emits = new(tmp_path / "a.obj")
    assert emits == ["glow"] and said[:3] == [
        "a comment tells lengths in in: if that is so, write model: {unit: in}",
        "materials that no library describes, so that nothing is known of what they emit: Glow, glow # 2",
        "2 material pictures: not read",
    ]


def test_a_library_is_no_model(tmp_path):
    (tmp_path / "a.mtl").write_bytes(MTL)
    with pytest.raises(BadInput, match=r"a.mtl: is a library of materials \(.mtl\): give the .obj that names it"):
        foreign_models.convert(tmp_path / "a.mtl")


def test_letters_of_windows(new, tmp_path):
    """An OBJ and an MTL in Latin-1: reader, library and the quick look agree on names."""
    (tmp_path / "a.obj").write_bytes(OBJ.format("a.mtl").replace("glow", "W\u00e4nde").encode("latin-1"))
    (tmp_path / "a.mtl").write_bytes(b"newmtl W\xe4nde\nmap_Ke glow.png\nd 0.4\n")
    model, said, emits = new(tmp_path / "a.obj")
    assert model.groups == ("W\u00e4nde",) and emits == ["W\u00e4nde"]
    assert said == ["materials that let light through are taken for opaque ones: W\u00e4nde"]
    assert quick.model_groups(tmp_path / "scene" / "model.obj") == {"W\u00e4nde"}
    (tmp_path / "model.obj").write_bytes((tmp_path / "a.obj").read_bytes())
    assert quick.model_groups(tmp_path / "model.obj") == {"W\u00e4nde"}


def test_one_name_in_two_libraries(new, tmp_path):
    """An OBJ cannot tell them apart: they are one group, and a line says so."""
    (tmp_path / "a.obj").write_text(OBJ.format("a.mtl b.mtl"))
    (tmp_path / "a.mtl").write_text("newmtl glow\nKd 1 0 0\n")
    (tmp_path / "b.mtl").write_text("newmtl glow\nKd 0 0 1\n")
    assert new(tmp_path / "a.obj")[1] == ["materials that the libraries describe twice, otherwise, are one group: glow"]


# ---- OBJ ----


def test_blender_s_obj(new):
    model, said, emits = new(BLENDER / "room.obj")
    assert said == ["48 line elements: not read"] and emits == ["Glow"]
    assert area_of(model) == {"W\u00e4nde": 59.0, "Wood": 4.0, "Glow": 1.0} and box(model) == [[0, 0, 0], [4, 3, 2.5]]


SQUARE = "usemtl a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
SURFACE = "vp 0 0\ncstype bspline\ndeg 1 1\nsurf 0 1 0 1 1 2 4 3\nparm u 0 0 1 1\nparm v 0 0 1 1\nend\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("f 1 2 3 4\n" + SURFACE + "curv 0 1 1 2\np 1 2\nl 1 2\n", "1 free-form surface, 1 free-form curve, 1 point"),
        ("fo 1/1/1 2 3 4\n", None),  # the old name of a face
        ("csh touch was-run\nf 1 2 3 4\n", "1 command (csh): not read"),
        ("v 1 1 1 0.5\nf 1 2 3 4\n", "1 vertex weight: not read"),
        ("v 1 1 1 1\nv 0 0 0 255 0 0 # C:\\\nf 1 2 3 4\n", None),
        ("o C:\\rooms\\\nf 1 2 3 4 \\\n\n", None),
        ("f 1 2 \\\n 3 4\n#\\\n# a \\\n", None),
        ("begin\nf 1 2 3 4\n", "1 unknown statement: not read"),
        ("\tf\t1\t2\t3\t4\n", None),
    ],
)
def test_statements_of_obj(new, tmp_path, text, said, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.obj").write_text(SQUARE + text)
    model, lines, _ = new(tmp_path / "a.obj")
    assert model.facet_area().tolist() == [1] and model.facet_normal.tolist() == [[0, 0, 1]]
    assert not (tmp_path / "was-run").exists()
    assert lines == [] if said is None else (len(lines) == 1 and lines[0].startswith(said)), lines


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (SURFACE, "faces: the model has none (1 free-form surface: not read): export it as polygons"),
        ("call other.obj\nf 1 2 3 4\n", "line 6: 'call other.obj': geometry in another file is not read: put its text"),
    ],
)
def test_obj_that_needs_more_is_refused(tmp_path, text, line):
    (tmp_path / "a.obj").write_text(SQUARE + text)
    assert line in refusal(tmp_path / "a.obj")


# ---- glTF ----

LEFT = ["lights without faces are left out, draw them: Point", "1 camera: not read"]


@pytest.mark.parametrize(
    ("path", "objects"),
    [
        (BLENDER / "lights.glb", True),
        (PACKED / "quantized.glb", True),  # normalized integers of 16 bits, one transform for each mesh
        (PACKED / "quantized-scene.glb", True),  # of 8 bits, one transform for the scene
        (PACKED / "sparse.glb", True),
        (PACKED / "gltfpack-vpn.glb", False),
    ],
)
def test_a_room_of_blender_s_through_other_tools(new, path, objects):
    model, said, emits = new(path)
    assert said == LEFT and emits == ["Glow"]
    assert not objects or model.objects == ("room", "crate", "panel")
    assert area_of(model) == pytest.approx({"W\u00e4nde": 59.0, "Wood": 4.0, "Glow": 1.0}, rel=0.01)
    assert np.allclose(box(model), [[0, 0, 0], [4, 3, 2.5]], atol=0.01)
    assert quick.model_groups(path) == set(model.groups)


@pytest.mark.parametrize("path", [BLENDER / "my room.gltf", PACKED / "obj2gltf.gltf"])
def test_gltf_of_blender_and_obj2gltf(new, path):
    model, said, emits = new(path)
    assert said == ["glTF and its buffers were packed into model.glb"] and emits == ["Glow"]
    assert area_of(model) == {"W\u00e4nde": 59.0, "Wood": 4.0, "Glow": 1.0}


def test_a_glb_with_a_second_buffer_beside_it(new, tmp_path):
    """gltfpack -cf: what is compressed stands beside, uncompressed, too. In a scene's folder such a file is refused."""
    model, said, _ = new(PACKED / "gltfpack-fallback.glb")
    assert np.isclose(area_of(model)["W\u00e4nde"], 59, rtol=0.01)
    assert said[0] == "buffers beside it were packed into model.glb"
    assert said[-1] == "1 camera, 1 extension EXT_meshopt_compression: not read"
    with pytest.raises(BadInput, match="is another file: make new-scene MODEL=... packs it into one"):
        models.load(PACKED / "gltfpack-fallback.glb")


@pytest.mark.parametrize("path", [BLENDER / "draco.glb", PACKED / "meshopt.glb"])
def test_compressed_meshes_are_refused_with_the_way_out(path):
    line = refusal(path)
    assert "_compression is not read: `gltf-transform copy IN.glb OUT.glb` writes it uncompressed" in line


@pytest.mark.parametrize("name", ["instanced", "instanced-quantized"])
def test_instances(new, name):
    """The crate and four chairs are five instances of one mesh; rotations and sizes may be integers."""
    model, said, _ = new(PACKED / f"{name}.glb")
    true = models.load(BLENDER / "instances.glb")
    assert len(model.objects) == 7 and area_of(model)["Wood"] == pytest.approx(4 + 4 * 1.12, rel=1e-3)
    assert np.allclose(box(model), box(true), atol=2e-3) and model.closed_objects.tolist() == [True, False] + [True] * 5
    assert len(said) == 1 and said[0].startswith(
        "nodes of one name, and instances, are objects of their own: Cube.001.2"
    )


def test_skins_and_morph_targets_stand_as_the_file_places_them(new):
    """The bone lifts the crate by 0.5 m; the shape key at a half lifts the ceiling from 2.5 m to 2.75."""
    model, said, _ = new(BLENDER / "skin.glb")
    crate = models.load(BLENDER / "skin.glb")
    p = crate.corners()[crate.facet_object[crate.triangle_facet] == crate.objects.index("crate")].reshape(-1, 3)
    assert np.allclose([p.min(axis=0), p.max(axis=0)], [[0.5, 0.75, 0.5], [1.5, 1.25, 1.5]], atol=1e-5)
    assert box(model) == [[0, 0, 0], [4, 3, 2.75]]
    assert said == [
        "morph targets stand at the file's weights",
        "meshes with a skin stand in the pose of their joints' nodes",
    ]


def glb(gltf, binary=b"", spare=b""):
    text = json.dumps(gltf).encode()
    chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", binary + bytes(-len(binary) % 4))]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body + spare


TRIANGLE = np.array([(0, 0, 0), (2, 0, 0), (0, 1, 0)], "<f4").tobytes()


def gltf(**more):
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "materials": [{"name": "paint"}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
        "nodes": [{"name": "a", "mesh": 0}],
        **more,
    }


def _primitive(**more):
    return {"attributes": {"POSITION": 0}, "material": 0, **more}


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"nodes": [{"mesh": 0, "camera": 0}], "cameras": [{"type": "perspective"}]}, "1 camera: not read"),
        ({"scenes": [{}, {"name": "x", "nodes": [0]}], "scene": 1}, "it has 2 scenes, of which 'x' is read"),
        (
            {"scenes": [{"nodes": [0]}], "nodes": [{"name": "a", "mesh": 0}, {"mesh": 0}]},
            "1 unplaced node: not read",
        ),
        ({"animations": [{}, {}]}, "2 animations: not read"),
        ({"meshes": [{"primitives": [_primitive(mode=1), _primitive(), _primitive(mode=0)]}]}, "2 point or line prim"),
        ({"extensionsUsed": ["MSFT_lod", "KHR_materials_ior"]}, "1 extension MSFT_lod: not read"),
        ({"extensions": {"KHR_materials_variants": {"variants": [{}, {}]}}}, "2 material variants: not read"),
        (
            {"materials": [{"name": "paint", "extensions": {"KHR_materials_transmission": {"transmissionFactor": 1}}}]},
            "materials that let light through are taken for opaque ones: paint",
        ),
    ],
)  # fmt: skip
def test_what_gltf_holds_besides_is_said(new, tmp_path, more, said):
    (tmp_path / "a.glb").write_bytes(glb(gltf(**more), TRIANGLE))
    model, lines, _ = new(tmp_path / "a.glb")
    assert model.facet_area().tolist() == [1] and len(lines) == 1 and lines[0].startswith(said), lines


def test_spare_bytes_and_chunks_out_of_order(new, tmp_path):
    """What stands behind the end is counted; a binary chunk before the JSON, and chunks of others, do no harm."""
    words = json.dumps(gltf()).encode()
    words += b" " * (-len(words) % 4)
    parts = [(b"XTRA", b"1234"), (b"BIN\0", TRIANGLE), (b"JSON", words)]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in parts)
    (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body + b"12345")
    model, lines, _ = new(tmp_path / "a.glb")
    assert model.groups == ("paint",) and lines == ["5 spare bytes: not read"]
    shutil.copy(tmp_path / "a.glb", tmp_path / "model.glb")
    assert quick.model_groups(tmp_path / "model.glb") == {"paint"}


@pytest.mark.parametrize(
    ("kind", "values", "normalized", "longest"),
    [
        (5120, np.array([(-128, 0, 0), (127, 0, 0), (0, 127, 0)], "<i1"), True, 2.0),  # -128 and -127 are both -1
        (5121, np.array([(0, 0, 0), (255, 0, 0), (0, 255, 0)], "<u1"), True, 1.0),
        (5122, np.array([(-32768, 0, 0), (32767, 0, 0), (0, 32767, 0)], "<i2"), True, 2.0),
        (5123, np.array([(0, 0, 0), (65535, 0, 0), (0, 65535, 0)], "<u2"), True, 1.0),
        (5123, np.array([(0, 0, 0), (400, 0, 0), (0, 400, 0)], "<u2"), False, 400.0),
    ],
)
def test_integers_as_the_extension_says(new, tmp_path, kind, values, normalized, longest):
    told = {"bufferView": 0, "componentType": kind, "count": 3, "type": "VEC3", "normalized": normalized}
    more = {"accessors": [told], "bufferViews": [{"buffer": 0, "byteLength": values.nbytes}]}
    (tmp_path / "a.glb").write_bytes(glb(gltf(**more, extensionsRequired=["KHR_mesh_quantization"]), values.tobytes()))
    model, _, _ = new(tmp_path / "a.glb")
    assert np.ptp(model.vertices, axis=0)[0] == longest


def test_sparse_values_over_zeros(new, tmp_path):
    """An accessor without a buffer view is zeros, and the values that stand in it."""
    binary = np.array([1, 2], "<u4").tobytes() + np.array([(2, 0, 0), (0, 1, 0)], "<f4").tobytes()
    sparse = {"count": 2, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 1}}
    told = {"componentType": 5126, "count": 3, "type": "VEC3", "sparse": sparse}
    views = [{"buffer": 0, "byteLength": 8}, {"buffer": 0, "byteOffset": 8, "byteLength": 24}]
    more = {"accessors": [told], "bufferViews": views, "buffers": [{"byteLength": 32}]}
    (tmp_path / "a.glb").write_bytes(glb(gltf(**more), binary))
    assert new(tmp_path / "a.glb")[0].facet_area().tolist() == [1]
    told["count"] = 10**12
    (tmp_path / "a.glb").write_bytes(glb(gltf(**more), binary))
    assert "accessor 0: count: 1000000000000" in refusal(tmp_path / "a.glb")


@pytest.mark.parametrize(
    "uri",
    [
        "data:application/octet-stream;base64," + base64.b64encode(TRIANGLE).decode(),
        "data:;base64," + base64.b64encode(TRIANGLE).decode().replace("=", "%3D").replace("/", "%2F"),
        "data:application/gltf-buffer," + "".join(f"%{byte:02x}" for byte in TRIANGLE),
        "W%C3%A4nde%20%231.bin",
        "W\u00e4nde #1.bin",  # as some write it: not encoded
        ".\\W\u00e4nde #1.bin",
        "./w\u00c4NDE%20#1.bin",
    ],
)
def test_addresses_of_buffers(new, tmp_path, uri):
    (tmp_path / "W\u00e4nde #1.bin").write_bytes(TRIANGLE)
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(buffers=[{"byteLength": 36, "uri": uri}])))
    assert new(tmp_path / "a.gltf")[0].facet_area().tolist() == [1]


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (
            {"extensionsRequired": ["KHR_draco_mesh_compression"]},
            "`gltf-transform copy IN.glb OUT.glb` writes it uncomp",
        ),
        ({"extensionsRequired": ["XX_voxels"]}, "extensionsRequired: XX_voxels: not known here: export it without"),
        ({"asset": {"version": "1.0"}}, "version: glTF 1.0 instead of 2: export it as glTF 2.0"),
        ({"asset": {"version": "2.0", "minVersion": "2.1"}}, "version: glTF 2.1 instead of 2"),
        ({"meshes": {"a": {}}}, "version: glTF 1 instead of 2"),
        ({"meshes": [{"primitives": [_primitive(mode=7)]}]}, "mode: 7 is not known"),
        (
            {"accessors": [{"componentType": 5126, "count": 3, "type": "VEC3"}]},
            "accessor 0: has no data, or compressed",
        ),
        ({"buffers": [{"byteLength": 36, "uri": "%2e%2e/secret.bin"}]}, "lies outside the model's folder"),
        ({"buffers": [{"byteLength": 36, "uri": "https://x.org/a.bin"}]}, "lies outside the model's folder"),
        (
            {"buffers": [{"byteLength": 36, "uri": "data:;base64,AAAA"}]},
            "buffers[0]: truncated: 36 bytes are announced, 3",
        ),
    ],
)
def test_gltf_that_needs_more_is_refused(tmp_path, more, line):
    (tmp_path.parent / "secret.bin").write_bytes(TRIANGLE)
    (tmp_path / "a.glb").write_bytes(glb(gltf(**more), TRIANGLE))
    assert line in refusal(tmp_path / "a.glb")


def test_hidden_nodes_hide_what_hangs_on_them_and_emission_of_strength_0_is_none(new, tmp_path):
    hidden = {"KHR_node_visibility": {"visible": False}}
    strength = {"KHR_materials_emissive_strength": {"emissiveStrength": 0}}
    nodes = [{"name": "a", "mesh": 0}, {"extensions": hidden, "children": [2]}, {"mesh": 0}]
    materials = [{"name": "paint", "emissiveFactor": [1, 1, 1], "extensions": strength}]
    (tmp_path / "a.glb").write_bytes(glb(gltf(nodes=nodes, materials=materials), TRIANGLE))
    model, said, emits = new(tmp_path / "a.glb")
    assert model.objects == ("a",) and said == ["1 hidden node: not read"] and emits == []


def test_instances_cost_no_more_than_they_may(tmp_path):
    told = {"componentType": 5126, "count": 10**6, "type": "VEC3"}
    sparse = {"count": 1, "indices": {"bufferView": 0, "componentType": 5125}, "values": {"bufferView": 0}}
    accessors = [gltf()["accessors"][0], told | {"sparse": sparse}]
    node = {"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 1}}}}
    (tmp_path / "a.glb").write_bytes(glb(gltf(accessors=accessors, nodes=[node]), TRIANGLE))
    assert "1000000 instances: at most 65535" in refusal(tmp_path / "a.glb")


def test_a_copy_of_ours_keeps_what_was_said(tmp_path):
    """A model in another unit is read from our own GLB later: `check` still says what its file held besides."""
    model = models.load(BLENDER / "lights.glb")
    write_glb(tmp_path / "model.glb", model)
    assert models.load(tmp_path / "model.glb").notes == model.notes == tuple(LEFT)


# ---- PLY, STL ----


@pytest.mark.parametrize("name", ["room.ply", "room-text.ply", "room.stl", "room-text.stl"])
def test_ply_and_stl_of_blender(new, name):
    model, said, _ = new(BLENDER / name)
    assert area_of(model) == {"surface": 64.0} and box(model) == [[0, 0, 0], [4, 3, 2.5]] and len(said) == 1
    assert model.n_facets == 13


@pytest.mark.parametrize(
    ("name", "left"),
    [("room.ply", None), ("room-text.ply", None), ("room.stl", None), ("room.off", "is an OFF file: export it as OBJ")],
)
def test_files_of_open3d(new, base, name, left):
    path = DATA / "writers" / "open3d" / name
    if left:
        assert left in refusal(path)
    else:
        model, said, _ = new(path)
        assert np.isclose(model.facet_area().sum(), 95.86) and box(model) == box(base) and len(said) == 1


@pytest.mark.parametrize("form", ["ascii", "binary"])
def test_ply_of_trimesh(new, base, tmp_path, form):
    import trimesh

    colours = np.tile([255, 0, 0, 255], (len(base.triangles), 1))
    mesh = trimesh.Trimesh(base.vertices, base.triangles, process=False, face_colors=colours)
    (tmp_path / "a.ply").write_bytes(mesh.export(file_type="ply", encoding=form))
    model, said, _ = new(tmp_path / "a.ply")
    assert np.isclose(model.facet_area().sum(), 95.86) and box(model) == box(base)
    assert said[1].startswith("1 property of faces (red), 1 property of faces (green)")


PLY = """ply
format {} 1.0
comment TextureFile room.png, before end_header
comment end_header
obj_info made by hand
element edge 1
property int vertex1
property int vertex2
element vertex 6
property double x
property uchar red
property double y
property double z
element face 2
property uchar material_index
property list uint8 int32 vertex_index
property list uchar float texcoord
end_header
"""
CORNERS = [(0, 0, 0), (3, 0, 0), (3, 1, 0), (1, 1, 0), (1, 3, 0), (0, 3, 0)]  # an L of 5 m2, a hollow polygon


def _rows(order):
    data = struct.pack(order + "2i", 0, 1) + b"".join(struct.pack(order + "dBdd", x, 7, y, z) for x, y, z in CORNERS)
    data += struct.pack(order + "BB6iB2f", 1, 6, *range(6), 2, 0.5, 0.5)
    return data + struct.pack(order + "BB3iB", 1, 3, 0, 1, 0, 0)  # of other lengths, and without area


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_as_the_format_allows(new, tmp_path, form):
    text = "0 1\n" + "\n".join(f"{x} 7 {y} {z}" for x, y, z in CORNERS) + "\n1 6 0 1 2 3 4 5 2 .5 .5\n1 3 0 1 0 0\n"
    rows = text.encode() if form == "ascii" else _rows("<" if "little" in form else ">")
    (tmp_path / "a.ply").write_bytes(PLY.format(form).encode() + rows)
    os.mkfifo(tmp_path / "room.png")
    model, said, _ = new(tmp_path / "a.ply")
    assert model.facet_area().tolist() == [5] and model.n_facets == 1
    assert said[1] == "1 edge, 1 property of faces (material_index), 1 property of faces (texcoord): not read"


def test_ply_strips(new, tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    (tmp_path / "a.ply").write_text(head + "0 0 0\n1 0 0\n0 1 0\n1 1 0\n8 0 1 2 3 -1 0 1 2\n")
    model, _, _ = new(tmp_path / "a.ply")
    assert model.facet_area().tolist() == [1] and model.facet_normal.tolist() == [[0, 0, 1]]


@pytest.mark.parametrize(
    ("extra", "line"),
    [
        ("", "it is a point cloud of 1 points: make a mesh"),
        ("property float f_dc_0\n", "a point cloud of Gaussian splats"),
    ],
)
def test_point_clouds_are_refused_by_name(tmp_path, extra, line):
    head = f"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n{extra}"
    (tmp_path / "a.ply").write_text(f"{head}end_header\n0 0 0 0\n")
    assert line in refusal(tmp_path / "a.ply")


def _binary_stl(header, spare=b"", attribute=0):
    rows = [((0, 0, 0), (1, 0, 0), (0, 1, 0)), ((0, 0, 0), (0, 1, 0), (0, 0, 1))]
    normals = [(0, 0, 1), (-1, 0, 0)]  # the second points against its corners
    body = b"".join(struct.pack("<12fH", *n, *np.ravel(row), attribute) for n, row in zip(normals, rows, strict=True))
    return header.ljust(80) + struct.pack("<I", 2) + body + spare


ONE = "1 of 2 normals point against their corners: the corners tell the front"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (_binary_stl(b"solid facet normal"), [ONE]),
        (_binary_stl(b"solid of CAD", b"\0" * 60), [ONE, "60 spare bytes: not read"]),
        (_binary_stl(b"COLOR=\xff\0\0\xff", attribute=3), [ONE, "2 triangle colours: not read"]),
    ],
)
def test_binary_stl(new, tmp_path, content, said):
    (tmp_path / "a.stl").write_bytes(content)
    model, lines, _ = new(tmp_path / "a.stl")
    assert model.facet_area().tolist() == [0.5, 0.5] and lines[1:] == said
    assert model.facet_normal.tolist() == [[0, 0, 1], [1, 0, 0]]


def test_text_stl_of_several_solids(new, tmp_path):
    text = (BLENDER / "room-text.stl").read_text()
    again = text.replace("solid", "Solid").replace("vertex ", "vertex  10")  # the x of each: 100, 104 and so on
    (tmp_path / "a.stl").write_bytes(("\r\n" + text + again).replace("\n", "\r\n").encode())
    model, said, _ = new(tmp_path / "a.stl")
    assert said[1] == "2 solid names: not read" and len(model.triangles) == 52


FACET = b"facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("a.stl", _binary_stl(b"x")[:-30], "truncated: 2 triangles are announced, 1 are there"),
        ("a.stl", b"x" * 80 + bytes(4), "has no faces"),
        ("a.stl", b"solid x\nendsolid\n", "has no faces"),
        ("a.stl", b"solid x\n" + FACET.replace(b"1 0 0", b"1,5 0 0"), "could not convert"),
        ("a.stl", b"solid x\n" + FACET + FACET[:40], "truncated"),
        ("a.stl", b"solid x\n" + FACET, "truncated: it has no line 'endsolid'"),
    ],
)  # fmt: skip
def test_stl_that_is_refused(tmp_path, name, content, line):
    (tmp_path / name).write_bytes(content)
    assert line in refusal(tmp_path / name)


# ---- other formats, pipes ----


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"Kaydara FBX Binary  \0\x1a\0", "an FBX file"),
        (b"; FBX 7.3.0 project file\n", "an FBX file"),
        (b"BLENDER-v300", "a file of Blender"),
        (b"MM" + struct.pack("<I", 10) + b"\2\0\0\0", "a 3DS file"),
        (b'<?xml version="1.0"?>\n<COLLADA version="1.4.1">', "a COLLADA file (.dae)"),
        (b'<?xml version="1.0"?><!DOCTYPE X3D PUBLIC "x"><X3D><Scene>', "an X3D file"),
        (b"#VRML V2.0 utf8\n", "a VRML file"),
        (b"PK\x03\x04" + b"\0" * 26 + b"3D/3dmodel.model", "a 3MF file"),
        (b"ISO-10303-21;\nHEADER;\nFILE_SCHEMA(('AP214'));", "a STEP file"),
        (b"ISO-10303-21;\nHEADER;\nFILE_SCHEMA(('IFC4'));", "an IFC file"),
        (b"\xff\xfe\xff\x0eS\0k\0e\0t\0c\0h\0U\0p\0", "a SketchUp file"),
        (b"OFF\n8 6 12\n0 0 0\n", "an OFF file"),
        (b"3D Geometry File Format        4", "a Rhino file (.3dm)"),
        (b"  0\nSECTION\n  2\nHEADER\n", "a DXF file"),
        (b"\x1f\x8b\x08\0", "a gzip archive"),
        (b"//Maya ASCII 2023 scene\n", "a file of Maya"),
        (b"\x89PNG\r\n\x1a\n\0\0", "a picture (PNG)"),
        (b"\xff\xd8\xff\xe1\0\0", "a picture (JPEG)"),
        (b"AC3Db\n", "an AC3D file"),
        (b'{"metadata": {"type": "Object"}}', "a JSON file of three.js"),
        (b'LookAt 0 0 1 0 0 0 0 1 0\nFilm "rgb"\nWorldBegin\n', "a scene of pbrt"),
    ],
)
def test_formats_that_are_not_read_are_named(tmp_path, content, kind):
    (tmp_path / "a.obj").write_bytes(content)
    line = refusal(tmp_path / "a.obj")
    assert f"is {kind}: " in line and len(line) > len(f"{tmp_path}/a.obj: is {kind}: ")
    assert strangers_files.kind_of(b"v 0 0 0\nOFF\n<scene") is None


@pytest.mark.parametrize("beside", [False, True])
def test_a_pipe_is_not_waited_for(tmp_path, beside):
    """As the model itself, and beside one: as its buffer, its library, or in a scene's folder."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "a.gltf").write_text(json.dumps(gltf(buffers=[{"byteLength": 36, "uri": "pipe"}])))
    (tmp_path / "a.obj").write_text(OBJ.format("pipe"))
    os.mkfifo(tmp_path / "left.png")

    def ask():
        if beside:
            files, said = foreign_models.convert(tmp_path / "a.obj")
            assert list(files) == ["model.obj"] and "mtllib pipe: there is no such file" in said[0]
            assert quick.pixels(tmp_path / "left.png") is None and quick.lens_of(tmp_path / "pipe") is None
            foreign_models.convert(tmp_path / "a.gltf")
        else:
            with pytest.raises(BadInput, match="pipe: is no file"):
                artefact.read_npz(tmp_path / "pipe")
            bounded.content(tmp_path / "pipe")

    outcome = confined.call(ask)
    assert outcome.end == "refused" and "pipe: is no file" in outcome.lines[0], outcome


def test_an_index_out_of_range(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
    (tmp_path / "a.ply").write_text(
        head + "element face 1\nproperty list int int vertex_index\nend_header\n0 0 0\n3 0 0 9\n"
    )
    with pytest.raises(BadInput, match=r"face index 9 is out of range \(0 to 0\)"):
        mesh_files.mesh(tmp_path / "a.ply", "ply")
