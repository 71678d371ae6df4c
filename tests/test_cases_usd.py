"""USD files of ordinary tools that were misread once, and what else such files hold."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import foreign_models, usd_models

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "tests/data"
CASES = DATA / "cases"
WRITTEN = DATA / "writers/usd-core"
TRIANGLE = "point3f[] points = [(0,0,0), (1,0,0), (0,1,0)]\nint[] faceVertexCounts = [3]\n"
TRIANGLE += "int[] faceVertexIndices = [0, 1, 2]\nuniform token subdivisionScheme = 'none'\n"
HEAD = '#usda 1.0\n(\nmetersPerUnit = 1\nupAxis = "Z"\nMORE)\n'


def text(body, more=""):
    return HEAD.replace("MORE", more) + body


@pytest.fixture
def read(tmp_path):
    """read(body of a usda, ...) -> (parts, emits, lines)"""

    def call(body, more="", **beside):
        (tmp_path / "room.usda").write_text(body if body.startswith("#usda") else text(body, more))
        for name, content in beside.items():
            (tmp_path / f"{name}.usda").write_text(content)
        return usd_models.read(tmp_path / "room.usda")

    return call


def refused(call, *words, **more):
    with pytest.raises(BadInput) as caught:
        call(*words, **more)
    (line,) = caught.value.problems
    assert "\n" not in line and "room.usda" in line
    return line


def extent(parts, thing):
    points = np.concatenate([p for name, _, p, _ in parts if name == thing])
    return points.min(axis=0).tolist(), points.max(axis=0).tolist()


# ---- the cases ----


def test_14_two_materials_of_one_name_are_two_groups():
    parts, _, said = usd_models.read(CASES / "14-glb-same-material-name/samename.usda")
    group = {thing: group for thing, group, _, _ in parts}
    assert group["room_left"] == "Paint" and group["room_right"] == "Paint.2"
    line = "/Room/kitchen/mats/Paint and /Room/hall/mats/Paint have one name: the second is group Paint.2"
    assert line in said


def test_22_what_is_drawn_has_the_purpose_render_or_none():
    parts, _, said = usd_models.read(CASES / "22-usd-proxy-and-guide/proxy.usda")
    things = [thing for thing, _, _, _ in parts]
    assert "crate_crate" in things and "crate_proxy" not in things and "rig_guide" not in things and len(things) == 9
    np.testing.assert_allclose(extent(parts, "crate_crate"), [(0.6, 3.4, 0), (1.5, 4.2, 0.8)], atol=1e-6)
    assert "1 proxy shape, 1 guide shape: not read" in said


def test_24_a_point_instancer_draws_its_instances_and_no_prototype():
    """The crate at (0.6 .. 1.5, 3.4 .. 4.2, 0 .. 0.8), once moved by (1.2, 0, 0), once by (0, -2, 0)."""
    parts, _, _ = usd_models.read(CASES / "24-usd-point-instancer/pi.usda")
    assert [part[:2] for part in parts if "proto" in part[0]] == [("proto", "crate"), ("proto.2", "crate")]
    np.testing.assert_allclose(extent(parts, "proto"), [(1.8, 3.4, 0), (2.7, 4.2, 0.8)], atol=1e-6)
    np.testing.assert_allclose(extent(parts, "proto.2"), [(0.6, 1.4, 0), (1.5, 2.2, 0.8)], atol=1e-6)


def test_41_nothing_outside_the_folder_is_read():
    with pytest.raises(BadInput, match="@../41-usd-outside-secret.usda@ lies outside the model's folder: flatten it"):
        usd_models.read(CASES / "41-usd-reads-outside/room.usda")


def test_42_prims_are_counted_before_they_are_composed():
    """In less than 1 GB: asked of a process of its own, for this one has had other children."""
    code = f"""
import resource, sys
sys.path.insert(0, {str(ROOT)!r})
from lib.given import usd_models
try:
    usd_models.read({str(CASES / "42-usd-nested-references/d.usda")!r})
except Exception as refusal:
    print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss, refusal)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    most_kb, _, line = done.stdout.partition(" ")
    assert re.search("composes to 1,[0-9,]+ prims or more, and at most 50,000 are read", line), done
    assert int(most_kb) < 1 << 20


def test_43_a_subset_names_faces_that_are_there(new_scene):
    path = CASES / "43-usd-subset-out-of-range/e.usda"
    done = new_scene(path)
    assert done.returncode == 2 and not done.stdout
    assert done.stderr.strip().endswith("/m/s: indices: face 7 is out of range: the mesh has 1")
    assert len(done.stderr.strip().splitlines()) == 1


@pytest.fixture
def new_scene(run, tmp_path):
    def call(model, *more):
        words = ["--data", tmp_path / "data", "--name", "x", "--model", model, "--photo", CASES / "base/room.png"]
        return run("stages/new_scene.py", *words, *more)

    return call


# ---- safety ----

OUTSIDE = {
    "sublayer": ("", "subLayers = [@../x.usda@]\n"),
    "reference": ('def "a" (references = @../x.usda@</w>) {\n}', ""),
    "payload": ('def "a" (payload = @../x.usda@</w>) {\n}', ""),
    "absolute": ('def "a" (references = @/etc/x.usda@</w>) {\n}', ""),
    "address": ('def "a" (references = @http://h/x.usda@</w>) {\n}', ""),
    "climbs": ('def "a" (references = @./b/../../x.usda@</w>) {\n}', ""),
    "package": ('def "a" (references = @../x.usdz[a.usda]@</w>) {\n}', ""),
    "arguments": ('def "a" (references = @../x.usda:SDF_FORMAT_ARGS:a=b@</w>) {\n}', ""),
    "expression": ('def "a" (references = @`"../x.usda"`@</w>) {\n}', ""),
    "variant": (
        'def "a" (variants = {string v = "x"}\nprepend variantSets = "v") {\nvariantSet "v" = {\n'
        '"x" (references = @../x.usda@</w>) {\n}\n"y" {\n}\n}\n}',
        "",
    ),
    "unused variant": (
        'def "a" (prepend variantSets = "v") {\nvariantSet "v" = {\n"x" {\n'
        'def "b" (payload = @../x.usda@) {\n}\n}\n}\n}',
        "",
    ),
    "clips": (
        'def "a" (clips = {dictionary default = {asset[] assetPaths = [@../x.usda@]\nstring primPath = "/w"}}) {\n}',
        "",
    ),
}


@pytest.mark.parametrize("how", OUTSIDE)
def test_layers_outside_the_folder_are_refused(read, how):
    line = refused(read, *OUTSIDE[how])
    assert "lies outside the model's folder" in line or how in ("package", "expression", "clips")
    assert "usdcat --flatten" in line


def test_what_a_layer_of_the_folder_names_is_looked_at_too(read):
    line = refused(read, 'def "a" (references = @b.usda@</w>) {\n}', b=text('def "w" (payload = @../s.usda@) {\n}'))
    assert "@../s.usda@ lies outside" in line


def test_layers_of_the_folder_are_read(read, tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts/c.usda").write_text(text(f'def Mesh "c" {{\n{TRIANGLE}}}', 'defaultPrim = "c"\n'))
    b = text('def "w" (references = @./parts/c.usda@) {\n}', 'defaultPrim = "w"\n')
    sub = text(f'def Mesh "s" {{\n{TRIANGLE}}}')
    parts, _, _ = read('def "a" (payload = @./b.usda@) {\n}', "subLayers = [@parts/../sub.usda@]\n", b=b, sub=sub)
    assert {part[0] for part in parts} == {"a", "s"}


@pytest.mark.parametrize(
    "body, more",
    [
        ('def "a" (references = @gone.usda@</w>) {\n}', ""),
        ('def "a" (payload = @./gone.usda@) {\n}', ""),
        ('def "a" (references = </gone>) {\n}', ""),
        ('def "a" (references = @b.usda@) {\n}', ""),  # b tells no defaultPrim
        ("", "subLayers = [@gone.usda@]\n"),
    ],
)
def test_a_layer_or_a_prim_that_is_not_found_is_refused(read, body, more, monkeypatch, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/gone.usda").write_text(text('def Mesh "w" {\n}'))
    monkeypatch.chdir(tmp_path / "elsewhere")  # where USD would look for a bare name
    monkeypatch.setenv("PXR_AR_DEFAULT_SEARCH_PATH", str(tmp_path / "elsewhere"))
    line = refused(read, f'def Mesh "m" {{\n{TRIANGLE}}}\n{body}', more, b=text('def "w" {\n}'))
    assert "does not compose" in line


def nested(arc, levels=9, wide=10):
    """Prims in each other by references, inherits and so on: wide to the power of levels."""
    rows = [f'class Mesh "L0" {{\n{TRIANGLE}}}']
    for k in range(1, levels + 1):
        inside = "\n".join(f'def "c{j}" ({arc.replace("TARGET", f"</L{k - 1}>")}) {{\n}}' for j in range(wide))
        rows.append(f'{"def" if k == levels else "class"} "L{k}" {{\n{inside}\n}}')
    return "\n".join(rows)


@pytest.mark.parametrize("arc", ["references = TARGET", "payload = TARGET", "inherits = TARGET", "specializes = TARGET",
                                 "references = TARGET\ninstanceable = true"])  # fmt: skip
def test_nested_arcs_of_every_kind_are_counted(read, arc):
    assert "prims or more, and at most 50,000 are read" in refused(read, nested(arc))
    assert len(read(nested(arc, 3, 3))[0]) == 27


def test_variants_that_nest_are_counted(read):
    """What is multiplied lies in the variant that is chosen."""
    rows = [f'class Mesh "L0" {{\n{TRIANGLE}}}']
    for k in range(1, 10):
        inside = "\n".join(f'def "c{j}" (references = </L{k - 1}>) {{\n}}' for j in range(10))
        sets = 'variants = {string v = "x"}\nprepend variantSets = "v"'
        rows.append(f'def "L{k}" ({sets}) {{\nvariantSet "v" = {{\n"x" {{\n{inside}\n}}\n"y" {{\n}}\n}}\n}}')
    assert "prims or more, and at most 50,000 are read" in refused(read, "\n".join(rows))
    chosen = "\n".join(rows).replace('string v = "x"', 'string v = "y"')
    assert "has no mesh" in refused(read, chosen)


def test_instancers_in_each_other_are_counted(read):
    """Ten to the ninth of instances, each level ten of the one below."""
    rows = [f'over "P0" {{\ndef Mesh "m" {{\n{TRIANGLE}}}\n}}']
    for k in range(1, 10):
        told = f"int[] protoIndices = [{', '.join('0' * 10)}]\npoint3f[] positions = [{', '.join(['(0,0,0)'] * 10)}]\n"
        kind = "def" if k == 9 else "over"
        rows.append(f'{kind} "P{k}" {{\ndef PointInstancer "i" {{\n{told}rel prototypes = </P{k - 1}>\n}}\n}}')
    assert "instances make 2,222,222,221 prims, and at most 50,000 are read" in refused(read, "\n".join(rows))


@pytest.mark.parametrize(
    "told, words",
    [("0", "metersPerUnit = 0 is no length"), ("-1", "metersPerUnit = -1"), ("nan", "nan"), ("inf", "inf")],
)
def test_a_unit_is_a_length(read, told, words):
    body = text(f'def Mesh "m" {{\n{TRIANGLE}}}').replace("metersPerUnit = 1", f"metersPerUnit = {told}")
    assert words in refused(read, body)


@pytest.mark.parametrize("point", ["(nan,0,0)", "(0,inf,0)"])
def test_points_are_finite(read, point):
    assert "/m: points: 1 is not finite" in refused(read, f'def Mesh "m" {{\n{TRIANGLE}}}'.replace("(1,0,0)", point))


@pytest.mark.parametrize(
    "more, words",
    [
        ("int[] holeIndices = [3]", "holeIndices: face 3 is out of range"),
        ("double3 xformOp:scale = (nan, 1, 1)\nuniform token[] xformOpOrder = ['xformOp:scale']", "is not finite"),
    ],
)
def test_what_a_mesh_says_is_checked(read, more, words):
    assert words in refused(read, f'def Mesh "m" {{\n{TRIANGLE}{more}\n}}')


def test_a_file_that_breaks_usds_package_is_one_line(tmp_path, monkeypatch):
    """As a crash and a lack of memory end the process: by a signal, without an answer."""
    (tmp_path / "room.usda").write_text(text(f'def Mesh "m" {{\n{TRIANGLE}}}'))
    for signal, words in (
        ("SIGSEGV", "broke off"),
        ("SIGABRT", "broke off"),
        ("SIGXCPU", "takes USD's package too long"),
    ):
        code = f"import os, signal; os.kill(os.getpid(), signal.{signal})"
        monkeypatch.setattr(usd_models, "MODULE", ("-c", code))
        assert words in refused(usd_models.read, tmp_path / "room.usda")


def test_a_name_that_is_no_text_is_one_line(tmp_path):
    """Two of a thousand files with a changed byte ended in a UnicodeDecodeError."""
    from pxr import Usd

    path = tmp_path / "room.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    stage.DefinePrim("/room", "Qzxjvk")
    stage.GetRootLayer().Save()
    path.write_bytes(path.read_bytes().replace(b"Qzxjvk", b"Qz\xe5jvk"))
    with pytest.raises(BadInput, match=r"room.usdc: a name in it is no text \(byte 0xe5\)"):
        usd_models.read(path)


def test_a_device_or_a_pipe_is_no_layer(read, tmp_path):
    os.mkfifo(tmp_path / "b.usda")
    assert "b.usda: is no file" in refused(read, 'def "a" (references = @b.usda@</w>) {\n}')


def test_a_package_holds_what_it_names(tmp_path):
    import zipfile

    for name, entries, words in (
        ("up.usdz", {"a.usda": text('def "a" (references = @../../x.usda@</w>) {\n}')}, "lies outside the package"),
        ("abs.usdz", {"a.usda": text('def "a" (references = @/etc/x.usda@</w>) {\n}')}, "lies outside the package"),
        ("gone.usdz", {"a.usda": text('def "a" (references = @b.usda@</w>) {\n}')}, "does not compose"),
        ("slip.usdz", {"a.usda": text(""), "../b.usda": text("")}, "../b.usda lies outside the package"),
    ):
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            for inside, content in entries.items():
                archive.writestr(inside, content)
        with pytest.raises(BadInput, match=words):
            usd_models.read(tmp_path / name)
    with zipfile.ZipFile(tmp_path / "small.usdz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.usda", text("# " + "x" * 10000))
    with pytest.raises(BadInput, match="a.usda: is compressed; a usdz is not"):
        usd_models.read(tmp_path / "small.usdz")


# ---- what else files hold ----


@pytest.mark.parametrize("name", ["room.usda", "room.usdc", "room.usdz"])
def test_a_room_as_usd_core_writes_it(name):
    """Text, crate and package are read alike: a class, instances, variants, an instancer, samples of time."""
    parts, emits, said = usd_models.read(WRITTEN / name)
    group = {thing: group for thing, group, _, _ in parts}
    assert group == {
        **{"night": "Wall", "Floor": "Wall", "Seat": "Seat", "Seat.2": "Seat", "Seat.3": "Seat"},
        **{"Cup": "Wood", "Cup.2": "Wood", "Box": "Box"},
    }
    assert emits == {"Wall": True}
    assert [extent(parts, f"Seat{k}")[0] for k in ("", ".2", ".3")] == [[0, 0.5, 0.45], [1, 0.5, 0.45], [2, 0.5, 0.45]]
    # the second cup is twice as large and turned by 180 degrees around z, the third turned around x and mirrored
    np.testing.assert_allclose(extent(parts, "Cup"), [(0.28, 0.18, 0.7), (0.3, 0.2, 0.7)], atol=1e-6)
    np.testing.assert_allclose(extent(parts, "Cup.2"), [(0.5, 0.19, 0.7), (0.51, 0.2, 0.7)], atol=1e-6)
    normal = {thing: np.cross(p[f[0][1]] - p[f[0][0]], p[f[0][2]] - p[f[0][0]]) for thing, _, p, f in parts}
    assert normal["Cup"][2] > 0
    assert normal["Cup.2"][2] > 0  # (0, 0, 1), mirrored along z, and turned around x
    assert "lights without faces are left out, draw them: Bulb" in said and "1 hidden instance: not read" in said


@pytest.mark.parametrize("name", ["plain", "instanced"])
def test_a_room_as_blender_writes_it(name):
    """One cube of two materials, a lamp, a mirrored plane, two chairs; each of them as an instance, too.

    Blender writes the chairs' wood a second time into their prototype: it stays one material.
    """
    parts, emits, said = usd_models.read(DATA / f"writers/blender-usd/{name}.usdc")
    groups = sorted(group for _, group, _, _ in parts)
    assert groups == ["glow", "off", "wall_paint", "wood", "wood", "wood", "wood"] and emits == {"glow": True}
    by_group = {group: (p, faces) for _, group, p, faces in parts}
    assert (by_group["wall_paint"][0][:, 2] == 2).all()
    normal = {g: np.cross(p[f[0][1]] - p[f[0][0]], p[f[0][2]] - p[f[0][0]]) for g, (p, f) in by_group.items()}
    assert normal["glow"][2] < 0 < normal["off"][2] and normal["wall_paint"][2] > 0
    seats = sorted(p.mean(axis=0).round(6).tolist() for thing, _, p, _ in parts if thing.startswith("Plane_003"))
    np.testing.assert_allclose(seats, [(10, 0, 0.45), (11, 0, 0.45)], atol=1e-6)
    assert said[-1] == "1 camera: not read" and said[-2].endswith("draw them: Sun")
    assert any("the control cage is read" in line for line in said) == (name == "plain")


def test_the_earliest_time_code_is_read_and_said(read):
    body = f"""def Mesh "m" {{
    {TRIANGLE}
    point3f[] points.timeSamples = {{ 3: [(0,0,1), (1,0,1), (0,1,1)], 9: [(0,0,7), (1,0,7), (0,1,7)] }}
    double3 xformOp:translate.timeSamples = {{ 5: (1, 0, 0), 9: (8, 0, 0) }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def Mesh "late" {{ {TRIANGLE}
    token visibility.timeSamples = {{ 1: "invisible", 4: "inherited" }}
    }}"""
    parts, _, said = read(body)
    assert [part[0] for part in parts] == ["m"] and extent(parts, "m") == ([1, 0, 1], [2, 1, 1])
    assert "2 prims are animated: read at the earliest time code, 1" in said and "1 invisible prim: not read" in said


def test_solids_are_as_large_as_usd_says(tmp_path):
    """Against UsdGeom's own extents; closed, and their volumes within those of 32 facets around."""
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.CreateNew(str(tmp_path / "room.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    sizes = {
        "size": 3.0,
        "radius": 0.5,
        "height": 4.0,
        "width": 2.0,
        "length": 5.0,
        "radiusTop": 0.5,
        "radiusBottom": 0.5,
    }
    pi, volume = np.pi, {"Cube": 27.0}
    volume |= {"Sphere": pi / 6, "Cylinder": pi, "Cylinder_1": pi, "Cone": pi / 3, "Capsule": pi * 7 / 6}
    volume |= {"Capsule_1": pi * 7 / 6, "Plane": 0}
    for kind in volume:
        for axis in "XYZ":
            prim = stage.DefinePrim(f"/{kind}{axis}", kind)
            for key, value in {**sizes, "axis": axis}.items():
                if prim.HasAttribute(key):
                    prim.GetAttribute(key).Set(value)
    stage.Save()
    parts, _, said = usd_models.read(tmp_path / "room.usda")
    assert len(parts) == 3 * len(volume) and "round shapes became 32 facets around" in " ".join(said)
    for thing, _, p, faces in parts:
        solid = UsdGeom.Boundable(stage.GetPrimAtPath(f"/{thing}"))
        box = UsdGeom.Boundable.ComputeExtentFromPlugins(solid, Usd.TimeCode.Default())
        np.testing.assert_allclose([p.min(axis=0), p.max(axis=0)], box, atol=1e-6, err_msg=thing)
        found = sum(np.linalg.det(p[[f[0], f[k], f[k + 1]]]) / 6 for f in faces for k in range(1, len(f) - 1))
        exact = volume[thing[:-1]]
        assert 0.98 * exact <= found <= exact + 1e-6, thing
        edges = {(a, b) for f in faces for a, b in zip(f, (*f[1:], f[0]), strict=True)}
        assert exact == 0 or all((b, a) in edges for a, b in edges), f"{thing} is not closed"


def test_what_is_left_out_is_counted(read):
    body = """def Mesh "m" (apiSchemas = ["MaterialBindingAPI"]) {
    point3f[] points = [(0,0,0), (1,0,0), (0,1,0)]
    int[] faceVertexCounts = [3, 3, 2]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 1, 0, 1]
    int[] holeIndices = [1]
    rel material:binding = </gone>
    def GeomSubset "s" (apiSchemas = ["MaterialBindingAPI"]) {
        uniform token familyName = "mine"
        int[] indices = [0]
        rel material:binding = </M>
    }
    }
    def Material "M" { }
    def BasisCurves "c" { }
    def Points "p" { }
    def Camera "cam" { }
    def Camera "cam2" { }
    def Foo "foo" { }
    def Scope "off" (active = false) { }
    over "nothing" { }
    class Mesh "cl" { }
    """.replace("{ }", "{\n}")
    parts, _, said = read(body)
    assert [(thing, group, len(faces)) for thing, group, _, faces in parts] == [("m", "m", 1)]
    assert "1 subdivision surface (catmullClark, as it tells no other): the control cage is read" in said
    for words in ("1 curve", "1 point cloud", "2 cameras", "1 Foo (unknown type) prim", "1 inactive prim", "1 hole",
                  "1 undefined over", "1 degenerate face", "1 dangling material binding",
                  "1 other family's material subset"):  # fmt: skip
        assert words in said[-1], words


def test_surfaces_that_are_not_read_are_refused(read):
    body = f'def Mesh "m" {{\n{TRIANGLE}}}\ndef NurbsPatch "sail" {{\n}}\ndef TetMesh "jelly" {{\n}}'
    assert "shapes that are not read: sail (NurbsPatch), jelly (TetMesh); make meshes of them" in refused(read, body)


def test_who_emits(read):
    """By the shaders of several tools; a weight of 0, or a black colour, is no lamp."""
    shaders = {
        "preview": "color3f inputs:emissiveColor = (1, 0, 0)",
        "black": "color3f inputs:emissiveColor = (0, 0, 0)",
        "standard": "float inputs:emission = 1",
        "standard_off": "float inputs:emission = 0\ncolor3f inputs:emission_color = (1, 1, 1)",
        "open_pbr": "float inputs:emission_luminance = 100\ncolor3f inputs:emission_color = (1, 1, 1)",
        "open_pbr_off": "float inputs:emission_luminance = 0\ncolor3f inputs:emission_color = (1, 1, 1)",
        "by_interface": "color3f inputs:emissiveColor.connect = </by_interface.inputs:glow>",
    }
    body = ""
    for name, told in shaders.items():
        glow = "color3f inputs:glow = (1, 1, 1)\n" if name == "by_interface" else ""
        body += f'def Material "{name}" {{\n{glow}def NodeGraph "g" {{\ndef Shader "s" {{\n{told}\n}}\n}}\n}}\n'
        binding = f"rel material:binding{':full' if name == 'preview' else ''} = </{name}>"
        body += f'def Mesh "m_{name}" (apiSchemas = ["MaterialBindingAPI"]) {{\n{TRIANGLE}{binding}\n}}\n'
    body += f'def Mesh "lit" (apiSchemas = ["MeshLightAPI"]) {{\n{TRIANGLE}}}\n'
    parts, emits, _ = read(body)
    assert {group for _, group, _, _ in parts} == {*shaders, "lit"}
    assert set(emits) == {"preview", "standard", "open_pbr", "by_interface", "lit"}


def test_one_definition_at_several_places_is_one_material(read):
    """Two chairs that refer to one file: one group; where one of them is painted over, two."""
    chair = f"""def Xform "chair" {{
    def Material "Wood" {{
    color3f inputs:a = (1, 1, 1)
    }}
    def Mesh "seat" (apiSchemas = ["MaterialBindingAPI"]) {{ {TRIANGLE}
    rel material:binding = </chair/Wood>
    }}
    }}"""
    twice = 'def "a" (references = @chair.usda@) {\n}\ndef "b" (references = @chair.usda@\ninstanceable = true) {\n}\n'
    chair = text(chair, 'defaultPrim = "chair"\n')
    parts, _, _ = read(twice, chair=chair)
    assert [part[:2] for part in parts] == [("seat", "Wood"), ("seat.2", "Wood")]
    painted = 'def "c" (references = @chair.usda@) {\nover "Wood" {\ncolor3f inputs:a = (0, 1, 0)\n}\n}\n'
    parts, _, said = read(twice + painted, chair=chair)
    assert [part[1] for part in parts] == ["Wood", "Wood", "Wood.2"]
    assert "/a/Wood and /c/Wood have one name: the second is group Wood.2" in said


def test_units_that_are_not_told_and_units_that_differ_are_said(read):
    mesh = f'def Mesh "m" {{\n{TRIANGLE}}}'
    parts, _, said = read(f"#usda 1.0\n{mesh}")
    assert extent(parts, "m")[1] == [0.01, 0.01, 0]
    assert said[0] == "USD, 0.01 m to its unit (it tells none, and USD means centimetres): written in metres"
    assert "its up axis is y" in said
    other = text(mesh, 'defaultPrim = "m"\n').replace("metersPerUnit = 1", "metersPerUnit = 0.01")
    _, _, said = read('def "a" (references = @b.usda@) {\n}', b=other)
    assert "b.usda has metersPerUnit 0.01, not 1.0: USD does not convert it" in said


def test_skinned_meshes_are_read_in_their_pose(tmp_path):
    """A triangle that one joint moves by 5 along z."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

    stage = Usd.Stage.CreateNew(str(tmp_path / "room.usda"))
    UsdGeom.SetStageMetersPerUnit(stage, 1)
    UsdSkel.Root.Define(stage, "/R")
    skeleton = UsdSkel.Skeleton.Define(stage, "/R/S")
    skeleton.CreateJointsAttr(["j"])
    skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1)])
    skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1)])
    animation = UsdSkel.Animation.Define(stage, "/R/A")
    animation.CreateJointsAttr(["j"])
    animation.CreateTranslationsAttr([Gf.Vec3f(0, 0, 5)])
    animation.CreateRotationsAttr([Gf.Quatf(1)])
    animation.CreateScalesAttr([Gf.Vec3h(1)])
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().AddTarget("/R/A")
    mesh = UsdGeom.Mesh.Define(stage, "/R/m")
    mesh.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    mesh.CreateFaceVertexCountsAttr([3])
    mesh.CreateFaceVertexIndicesAttr([0, 1, 2])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().AddTarget("/R/S")
    binding.CreateJointIndicesPrimvar(True, 1).Set(Vt.IntArray([0]))
    binding.CreateJointWeightsPrimvar(True, 1).Set(Vt.FloatArray([1]))
    assert Sdf.Layer and stage.GetRootLayer().Save()
    parts, _, _ = usd_models.read(tmp_path / "room.usda")
    assert extent(parts, "m") == ([0, 0, 5], [1, 1, 5])
    hall = Usd.Stage.CreateNew(str(tmp_path / "hall.usda"))  # the same, in instances, one of them in another
    UsdGeom.SetStageMetersPerUnit(hall, 1)
    for path, x in (("/one", 10), ("/pair", 20)):
        prim = UsdGeom.Xform.Define(hall, path)
        prim.AddTranslateOp().Set((x, 0, 0))
        held = hall.DefinePrim(f"{path}/in")
        held.GetReferences().AddReference("room.usda", "/R")
        held.SetInstanceable(True)
    again = UsdGeom.Xform.Define(hall, "/again")
    again.AddTranslateOp().Set((100, 0, 0))
    again.GetPrim().GetReferences().AddInternalReference("/pair")
    again.GetPrim().SetInstanceable(True)
    assert hall.GetRootLayer().Save()
    parts, _, said = usd_models.read(tmp_path / "hall.usda")
    boxes = sorted((p.min(axis=0).tolist(), p.max(axis=0).tolist()) for _, _, p, _ in parts)
    assert boxes == [([x, 0, 5], [x + 1, 1, 5]) for x in (10, 20, 100)] and not any("skin" in line for line in said)


def test_glass_and_pictures_are_said(read):
    """A material of opacity .2 with a picture; the binding is to the mesh."""
    surface = 'uniform token info:id = "UsdPreviewSurface"\nfloat inputs:opacity = 0.2\n'
    picture = 'uniform token info:id = "UsdUVTexture"\nasset inputs:file = @a.png@\n'
    material = f'def Material "glass"\n{{\ndef Shader "s"\n{{\n{surface}}}\ndef Shader "t"\n{{\n{picture}}}\n}}\n'
    bound = f'def Mesh "m" (apiSchemas = ["MaterialBindingAPI"]) {{\n{TRIANGLE}rel material:binding = </glass>\n}}\n'
    _, emits, said = read(material + bound)
    assert emits == {} and said[-2:] == [
        "materials that let light through are taken for opaque ones: glass",
        "1 material picture: not read",
    ]


def test_the_model_plans_with_its_lamp(new_scene, tmp_path):
    done = new_scene(WRITTEN / "room.usdz")
    assert done.returncode == 0, done.stderr
    assert "lamps: {Wall: unknown}" in (tmp_path / "data/x/scene.yaml").read_text()


def test_a_file_with_another_ending_says_what_to_name_it(tmp_path):
    (tmp_path / "room.txt").write_text(text(f'def Mesh "m" {{\n{TRIANGLE}}}'))
    with pytest.raises(BadInput, match="room.txt: name it .usd"):
        foreign_models.convert(tmp_path / "room.txt")
