"""make new-scene: a folder from people's files, and what is said about them."""

import base64
import json
import sys

import cv2
import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import cameras, foreign_models, fspy, image, picks, usd_models
from lib.given import model as models
from lib.given.model.glb_writer import write_glb
from lib.planning import scene as scenes
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import walk
from tests.helpers import rooms
from tests.helpers.mistakes import HEIGHT, WIDTH, camera, picture

EVERYTHING = {**rooms.room(), **rooms.LAMP}


@pytest.fixture
def given(tmp_path):
    """A folder with a photograph, a model and a camera, as other programs leave them."""
    folder = tmp_path / "my files"
    folder.mkdir()
    cv2.imwrite(str(folder / "IMG 1.jpeg"), picture())
    rooms.write(folder / "room.obj", EVERYTHING)
    cameras.write_cameramodel(folder / "cam.cameramodel", camera())
    return folder


@pytest.fixture
def new(given, run):
    """new(MODEL=..., ...) -> (exit status, folder of the scene, what was said)"""

    def call(name="attic", photo="IMG 1.jpeg", **words):
        words = {"model": "room.obj", "camera": "cam.cameramodel"} | words
        of = lambda key, value: value if key == "megapixels" else given / value
        options = [word for key, value in words.items() if value for word in (f"--{key}", of(key, value))]
        data = given.parent / "data"
        done = run("stages/new_scene.py", "--data", data, "--name", name, "--photo", given / photo, *options)
        return done.returncode, data / name, done.stdout + done.stderr

    return call


def planned(folder, root):
    """The scene as planning reads it: no problem."""
    stages = read_pipeline(root / "pipeline.yaml")
    found = scenes.read(folder, stages)
    assert not found.problems, found.problems
    return found


def test_a_folder_that_plans(new, root):
    status, folder, said = new()
    assert status == 0, said
    assert sorted(p.name for p in folder.iterdir()) == ["left.jpg", "left.posed.cameramodel", "model.obj", "scene.yaml"]
    assert planned(folder, root).lamps == {"lamp": "unknown"}
    assert "missing" not in said and "make attic/check" in said
    assert "data/SCENE.md" in (folder / "scene.yaml").read_text()


def test_what_is_missing_is_said(new, given, root):
    text = (given / "room.obj").read_text().replace("lamp", "panel7")
    (given / "room.obj").write_text(text)
    status, folder, said = new(camera=None)
    assert status == 0 and "missing: lamps: write in scene.yaml which groups emit" in said
    assert "missing: the pose of the photograph: pick eight or more corners" in said
    assert planned(folder, root).lamps == {}


def test_lamps_by_their_material(new, given, root):
    text = (given / "room.obj").read_text().replace("lamp", "panel 7")
    (given / "room.obj").write_text("mtllib room.mtl\n" + text)
    (given / "room.mtl").write_text("newmtl panel 7\nKe 5 5 5\nnewmtl top\nKe 0 0 0\n")
    status, folder, said = new()
    assert status == 0 and planned(folder, root).lamps == {"panel 7": "unknown"}, said
    assert (folder / "model.mtl").is_file() and not (folder / "room.mtl").exists()


def test_units_and_axes_are_said_and_not_applied(new, given, root):
    """A room with y up, in centimetres."""
    turned = {o: [(g, [(100 * x, 100 * z, -100 * y) for x, y, z in c]) for g, c in p] for o, p in EVERYTHING.items()}
    rooms.write(given / "room.obj", turned)
    T = cameras.towards((0.4, 1.5, -0.4), (3, 1, -2), (0, 1, 0))
    cameras.write_cameramodel(given / "cam.cameramodel", cameras.Camera(camera().K, WIDTH, HEIGHT, T))
    status, folder, said = new()
    assert status == 0 and "perhaps write model: {unit: cm}" in said and "perhaps write model: {up: y}" in said, said
    assert planned(folder, root).model == {}
    assert "# model: {unit: cm}" in (folder / "scene.yaml").read_text()


@pytest.mark.parametrize(
    "told, words",
    [
        (lambda x, y, z: (100 * x, 100 * z, -100 * y), "read as cm, and"),  # the file's own numbers
        (lambda x, y, z: (x, y, z), "read as m, z up, and"),  # as Blender shows them
        (lambda x, y, z: (x, z, -y), "8 of them corners of the model -> pose.csv"),
    ],
)
def test_picks_in_any_unit_and_axes(new, given, root, told, words):
    """Of a room with y up, in centimetres: pose.csv is in metres of the model's frame, and its unit is written."""
    turned = {o: [(g, [(100 * x, 100 * z, -100 * y) for x, y, z in c]) for g, c in p] for o, p in EVERYTHING.items()}
    rooms.write(given / "room.obj", turned)
    corners = [(x, y, z) for x in (0, 4) for y in (0, 3) for z in (0, 2.5)]
    rows = [",".join(map(str, (3 * k + 1, 2 * k, *told(*corner), "room"))) for k, corner in enumerate(corners)]
    (given / "points.csv").write_text("\n".join(["x_px,y_px,X,Y,Z,name", *rows]) + "\n")
    status, folder, said = new(camera=None, picks="points.csv")
    assert status == 0 and words in said and "missing: the pose" not in said, said
    scene = planned(folder, root)
    assert scene.model == {"unit": "cm"}
    found = picks.read(folder / "pose.csv")
    assert np.allclose(found.p, [(x, z, -y) for x, y, z in corners])
    assert found.names[0] == "room, line 2" and found.q[1].tolist() == [4, 2]


def test_picks_off_all_corners_stay_as_they_are(new, given, root):
    (given / "points.csv").write_text("x_px,y_px,X,Y,Z\n1,2,.3,.4,.5\n3,4,1,.4,.5\n5,6,.3,1,.7\n7,8,.3,.4,1.9\n")
    status, folder, said = new(camera=None, picks="points.csv")
    assert status == 0 and "picks: 4 -> pose.csv as they are: few of them are corners of the model" in said, said
    assert np.allclose(picks.read(folder / "pose.csv").p, picks.read(given / "points.csv").p)


def test_a_large_photograph_is_made_smaller_with_its_camera_and_picks(new, given, root):
    """Half as many pixels each way: the same point of the model lies on the same place of the picture."""
    whole = new(name="whole")[1]
    status, folder, said = new(megapixels="0.001")
    assert status == 0, said
    assert (
        "photograph: 64 x 48 px, means of 2 x 2 pixels for memory and time (MEGAPIXELS=1 keeps all) -> left.png" in said
    )
    before, after = (image.read_photograph(path) for path in (whole / "left.jpg", folder / "left.png"))
    assert after.bits == 16 and after.values.shape == (24, 32, 3)
    assert np.allclose(after.values[3, 5], before.values[6:8, 10:12].mean(axis=(0, 1)), atol=1e-4)
    p = np.array([[3, 2, 1], [2.5, 1.8, 0.7]])
    q, smaller = (cameras.read_cameramodel(f / "left.posed.cameramodel").project(p) for f in (whole, folder))
    assert np.allclose(smaller, (q + 0.5) / 2 - 0.5)
    planned(folder, root)
    (given / "points.csv").write_text(
        "x_px,y_px,X,Y,Z,sigma_px\n1,2,0,0,0,2\n3,4,4,0,0,1\n5,6,4,3,0,1\n7,8,4,3,2.5,1\n"
    )
    folder = new(name="picked", camera=None, picks="points.csv", megapixels="0.001")[1]
    found = picks.read(folder / "pose.csv")
    assert found.q.tolist() == [[0.25, 0.75], [1.25, 1.75], [2.25, 2.75], [3.25, 3.75]] and found.sigma.tolist()[0] == 1


def test_megapixels_is_a_number(new):
    status, folder, said = new(megapixels="many")
    assert status == 2 and "MEGAPIXELS: many: is no number from 0.0001 to 1000" in said and not folder.exists()


def same(folder, groups=None):
    """The model of the folder has the room's facets."""
    found = models.load(next(folder.glob("model.*")))
    assert np.isclose(found.facet_area().sum(), 2 * (4 * 3 + 4 * 2.5 + 3 * 2.5) + 1)
    assert groups is None or sorted(found.groups) == sorted(groups)
    return found


def gltf_of(glb, folder, inline):
    """A .gltf and its buffer, beside it or in it, of a GLB."""
    data = glb.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    gltf, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    address = "data:application/octet-stream;base64," + base64.b64encode(binary).decode() if inline else "room.bin"
    (folder / "room.bin").write_bytes(binary)
    gltf["buffers"] = [{"byteLength": len(binary), "uri": address}]
    (folder / "room.gltf").write_text(json.dumps(gltf))


@pytest.mark.parametrize("inline", [True, False])
def test_gltf(new, given, inline):
    glb = given / "room.glb"
    write_glb(glb, models.load(given / "room.obj"))
    gltf_of(glb, given, inline)
    status, folder, said = new(model="room.gltf")
    assert status == 0, said
    same(folder, ["bottom", "top", "west", "east", "south", "north", "lamp"])
    status, folder, said = new("other", model="room.glb")
    assert status == 0, said
    same(folder)


@pytest.mark.parametrize(("kind", "form"), [("ply", "ascii"), ("ply", "binary"), ("stl", "binary"), ("stl", "ascii")])
def test_ply_and_stl_are_one_group(new, given, kind, form):
    trimesh = pytest.importorskip("trimesh")
    m = models.load(given / "room.obj")
    mesh = trimesh.Trimesh(m.vertices, m.triangles, process=False)
    if kind == "ply":
        mesh.export(given / "room.ply", encoding="ascii" if form == "ascii" else "binary")
    else:
        mesh.export(given / "room.stl", file_type="stl_ascii" if form == "ascii" else "stl")
    status, folder, said = new(model=f"room.{kind}")
    assert status == 0 and "has no materials: everything is one group, surface" in said, said
    same(folder, ["surface"])


MITSUBA = """<scene version="3.0.0">
<bsdf type="diffuse" id="plaster"/>
<shape type="cube" id="room"><transform name="to_world"><scale x="-1"/><translate value="1, 1, 1"/>
  <scale x="2" y="1.5" z="1.25"/></transform><ref id="plaster"/></shape>
<shape type="rectangle" id="panel"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="180"/>
  <translate x="2" y="1.5" z="2.4"/></transform><emitter type="area"/></shape>
</scene>"""


def test_shapes_of_mitsuba(new, given):
    (given / "room.xml").write_text(MITSUBA)
    status, folder, said = new(model="room.xml")
    assert status == 0, said
    found = same(folder, ["plaster", "lamp-panel"])
    (lamp,) = np.flatnonzero(found.facet_group == found.groups.index("lamp-panel"))
    assert np.allclose(found.facet_normal[lamp], (0, 0, -1)) and np.isclose(found.facet_offset[lamp], -2.4)
    walls = found.facet_normal[found.facet_group == found.groups.index("plaster")]
    middle = np.array([2, 1.5, 1.25])
    offset = found.facet_offset[found.facet_group == found.groups.index("plaster")]
    assert (np.abs(walls @ middle - offset) > 1).all() and len(walls) == 6
    (given / "room.xml").write_text(MITSUBA.replace('"cube"', '"serialized"'))
    assert new("other", model="room.xml")[0] == 2


REFUSED = {
    "name with a blank": ({"name": "my room"}, "NAME: my room: letters, digits, _ and - alone"),
    "name of a target": ({"name": "test"}, "NAME: test"),
    "photograph of another kind": ({"photo": "cam.cameramodel"}, "PHOTO: "),
    "no such model": ({"model": "rom.obj"}, "rom.obj: there is no such file"),
    "camera of another size": ({"camera": "small.cameramodel"}, "32 x 24 is not the photograph's 64 x 48"),
    "an FBX": ({"model": "room.fbx"}, "is an FBX file: export it as OBJ or GLB"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_used_leaves_no_folder(new, given, case):
    small = cameras.look_at((0.4, 0.4, 1.5), (3, 2, 1), 70, 32, 24)
    cameras.write_cameramodel(given / "small.cameramodel", small)
    (given / "room.fbx").write_bytes(b"Kaydara FBX Binary  \0")
    words, line = REFUSED[case]
    status, folder, said = new(**words)
    assert status == 2 and line in said and "Traceback" not in said, said
    assert not folder.exists() and not list((given.parent / "data").glob("*"))


def test_a_scene_that_is_there_stays(new):
    _, folder, _ = new()
    (folder / "scene.yaml").write_text("lamps: {}\n")
    status, _, said = new()
    assert status == 2 and "is there already" in said and (folder / "scene.yaml").read_text() == "lamps: {}\n"


def test_a_project_of_fspy_in_the_folder_is_the_pose(new, root, run):
    """left.fspy.json beside the photograph: the stage `pose` makes left.posed.cameramodel of it."""
    _, folder, _ = new()
    (folder / "left.posed.cameramodel").unlink()
    posed = camera()
    words = {"cameraTransform": {"rows": np.linalg.inv(fspy.FLIP @ posed.T_cam_world).tolist()}}
    words |= {"principalPoint": {"x": 0, "y": 0}, "imageWidth": WIDTH, "imageHeight": HEIGHT}
    words["horizontalFieldOfView"] = 2 * np.arctan(WIDTH / 2 / posed.K[0, 0])
    (folder / "left.fspy.json").write_text(json.dumps(words))
    stages = read_pipeline(root / "pipeline.yaml")
    found = walk(scenes.read(folder, stages), stages, folder.parent / "build")
    assert found.planned[:2] == ["pose", "edges"] and "recognise" not in found.planned
    out = folder.parent / "left.posed.cameramodel"
    files = ["--photograph", folder / "left.jpg", "--fspy-json", folder / "left.fspy.json", "--posed", out]
    done = run("stages/pose.py", *files, "--report", folder.parent / "report.json")
    assert done.returncode == 0, done.stderr
    again = cameras.read_cameramodel(out)
    assert np.allclose(again.T_cam_world, posed.T_cam_world) and np.allclose(again.K, posed.K)
    (folder / "pose.csv").write_text("x_px,y_px,X,Y,Z\n")
    assert any("only one of them may tell the pose" in line for line in scenes.read(folder, stages).problems)


# ---- USD ----

USD = """#usda 1.0
( metersPerUnit = 0.01
  upAxis = "Y" )
def Xform "Room" {
    double3 xformOp:translate = (100, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "Floor" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {
        point3f[] points = [(0, 0, 0), (400, 0, 0), (400, 0, 300), (0, 0, 300), (0, 250, 0), (400, 250, 0)]
        int[] faceVertexCounts = [4, 4]
        int[] faceVertexIndices = [3, 2, 1, 0, 0, 1, 5, 4]
        rel material:binding = </Looks/Wood>
        def GeomSubset "back" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1]
            rel material:binding = </Looks/Wall>
        }
    }
    def Mesh "Hidden" {
        point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        token visibility = "invisible"
    }
    def Mesh "Panel" ( prepend apiSchemas = ["MaterialBindingAPI"] ) {
        point3f[] points = [(100, 240, 100), (200, 240, 100), (200, 240, 200)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        uniform token orientation = "leftHanded"
        rel material:binding = </Looks/Glow>
    }
    def SphereLight "Bulb" {
        float inputs:intensity = 3
    }
    SHAPE
}
def Scope "Looks" {
    def Material "Wood" {
    }
    def Material "Wall" {
    }
    def Material "Glow" {
        def Shader "s" {
            uniform token info:id = "UsdPreviewSurface"
            color3f inputs:emissiveColor = (1, 1, 1)
        }
    }
}
"""


def test_usd_by_its_own_package(tmp_path):
    """Metres by its unit, a group for each material, left-handed faces turned, hidden meshes left out."""
    (tmp_path / "model.usda").write_text(USD.replace("SHAPE", ""))
    parts, emits, said = usd_models.read(tmp_path / "model.usda")
    assert [part[:2] for part in parts] == [("Floor", "Wood"), ("Floor", "Wall"), ("Panel", "Glow")]
    corners = [[part[2][k] for k in face] for part in parts for face in part[3]]
    np.testing.assert_allclose(corners[0], [(1, 0, 3), (5, 0, 3), (5, 0, 0), (1, 0, 0)], atol=1e-6)
    np.testing.assert_allclose(corners[1], [(1, 0, 0), (5, 0, 0), (5, 2.5, 0), (1, 2.5, 0)], atol=1e-6)
    np.testing.assert_allclose(corners[2], [(3, 2.4, 2), (3, 2.4, 1), (2, 2.4, 1)], atol=1e-6)
    assert emits == {"Glow": True} and "0.01 m to its unit" in said[0] and "Bulb" in " ".join(said)
    (tmp_path / "model.usda").write_text(USD.replace("SHAPE", 'def NurbsPatch "Sail" {\n}'))
    with pytest.raises(BadInput, match=r"shapes that are not read: Sail \(NurbsPatch\)"):
        usd_models.read(tmp_path / "model.usda")
    (tmp_path / "model.usda").write_text("#usda 1.0\n(")
    with pytest.raises(BadInput, match="not readable"):
        usd_models.read(tmp_path / "model.usda")


def test_usd_becomes_an_obj_with_its_lamps(tmp_path, monkeypatch):
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], float)
    read = (
        [("a", "paint", square, [(0, 1, 2, 3)]), ("b", "glow", square + 1, [(0, 1, 2, 3)])],
        {"glow": True},
        ["USD"],
    )
    monkeypatch.setattr(foreign_models.usd_models, "read", lambda path: read)
    (tmp_path / "room.usdc").write_bytes(b"PXR-USDC")
    files, said = foreign_models.convert(tmp_path / "room.usdc")
    assert foreign_models.emitters(files) == ["glow"] and said == ["USD"]
    (tmp_path / "model.obj").write_bytes(files["model.obj"])
    assert models.load(tmp_path / "model.obj").groups == ("paint", "glow")


def test_usd_without_its_package_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pxr", None)
    (tmp_path / "room.usda").write_text(USD)
    with pytest.raises(BadInput, match="its package is not installed: .* pip install usd-core, or export OBJ or GLB"):
        foreign_models.convert(tmp_path / "room.usda")
