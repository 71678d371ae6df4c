"""The model: polygons to triangles and facets, and what is refused."""

import json
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import model as models
from tests.helpers.growth import growth

ROOT = Path(__file__).resolve().parents[1]
CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
FACES = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # outwards


def obj(path, vertices, *faces, head="usemtl a"):
    """faces: tuples of indices from 0, or lines of text."""
    lines = [head, *("v " + " ".join(repr(float(c)) for c in v) for v in vertices)]
    lines += [f if isinstance(f, str) else "f " + " ".join(str(i + 1) for i in f) for f in faces]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def load(tmp_path):
    return lambda vertices, *faces, **options: models.load(obj(tmp_path / "model.obj", vertices, *faces, **options))


def test_one_triangle(load):
    model = load([(0, 0, 1), (2, 0, 1), (0, 2, 1)], (0, 1, 2))
    assert model.triangles.tolist() == [[0, 1, 2]] and model.n_facets == 1
    assert model.facet_normal.tolist() == [[0, 0, 1]] and model.facet_offset.tolist() == [1]
    assert model.objects == ("default",) and model.groups == ("a",)
    assert model.facet_area().tolist() == [2] and model.warnings == ()


def test_cube(load):
    model = load(CUBE, *FACES)
    assert model.n_facets == 6 and len(model.triangles) == 12
    assert np.allclose(np.sort(model.facet_offset), [0, 0, 0, 1, 1, 1])
    outwards = model.corners().mean(axis=1) - 0.5
    assert (np.einsum("ij,ij->i", outwards, model.triangle_normals()[0]) > 0).all()
    assert np.allclose(model.facet_area(), 1)


def test_names_objects_and_groups(load):
    """`g` is ignored, names may hold spaces, an object that comes back is the same one, unused names do not count."""
    model = load(
        CUBE,
        "usemtl b b # x",
        (0, 1, 3, 2),
        "o first thing",
        "usemtl c",
        (4, 6, 7, 5),
        "g other",
        "o second",
        "usemtl unused",
        "usemtl c",
        (0, 4, 5, 1),
        "o first thing",
        (2, 3, 7, 6),
        "o empty",
    )
    assert model.objects == ("default", "first thing", "second") and model.groups == ("b b # x", "c")
    assert model.facet_object.tolist() == [0, 1, 2, 1] and model.facet_group.tolist() == [0, 1, 1, 1]


def test_index_forms(load):
    """Negative indices count from the end, texture and normal indices are skipped.

    Lines may continue, comments end them.
    """
    model = load([(0, 0, 0), (1, 0, 0), (0, 1, 0)], "f -3/1/1 -2//1 \\", " -1/7 # f 9 9 9")
    assert model.triangles.tolist() == [[0, 1, 2]]


def test_windows_lines_and_vertex_colours(tmp_path):
    (tmp_path / "m.obj").write_bytes(
        b"mtllib m.mtl\r\nusemtl a\r\nv 0 0 0 1 0 0\r\nv 1 0 0 1 0 0\r\nv 0 1 0 1 0 0\r\nf 1 2 3\r\n"
    )
    model = models.load(tmp_path / "m.obj")
    assert model.groups == ("a",) and model.n_facets == 1


# Facets

GRID = [(x, y, 0) for y in range(2) for x in range(3)]  # 3 4 5
LEFT, RIGHT = (0, 1, 4, 3), (1, 2, 5, 4)  # 0 1 2


def test_neighbours_in_a_plane_are_one_facet(load):
    assert load(GRID, LEFT, RIGHT).n_facets == 1


def test_another_group_object_or_side_is_another_facet(load):
    assert load(GRID, LEFT, "usemtl b", RIGHT).n_facets == 2
    assert load(GRID, LEFT, "o b", RIGHT).n_facets == 2
    assert load(GRID, LEFT, RIGHT[::-1]).n_facets == 2
    assert load(GRID, LEFT, LEFT[::-1]).n_facets == 2  # a panel of two polygons, back to back


def test_a_shared_corner_is_not_an_edge(load):
    assert load([*GRID, (2, 2, 0), (1, 2, 0)], LEFT, (4, 5, 6, 7)).n_facets == 2


def test_edges_are_shared_by_position(load):
    """Exporters give each polygon its own vertices; -0.0 is 0.0."""
    own = [GRID[i] for i in LEFT] + [(x, y, -0.0) for x, y, _ in (GRID[i] for i in RIGHT)]
    assert load(own, (0, 1, 2, 3), (4, 5, 6, 7)).n_facets == 1


@pytest.mark.parametrize("rise, count", [(0, 1), (5e-4, 1), (2e-3, 2), (0.1, 2)])
@pytest.mark.parametrize("scale, far", [(1, 0), (1e-3, 0), (1e4, 0), (1, 1e6)])
def test_coplanar_within_a_thousandth(load, rise, count, scale, far):
    p = np.array(GRID, float)
    p[[2, 5], 2] = rise
    assert load(p * scale + far, LEFT, RIGHT).n_facets == count


def test_a_small_piece_beside_a_large_one(load):
    """A sliver 1 mm wide that leans by 1 % of that beside a wall of 1 m: within 1e-3 of the size of the two."""
    p = np.array(GRID, float)
    p[[2, 5]] = [1.001, 0, 1e-5], [1.001, 1, 1e-5]
    assert load(p, LEFT, RIGHT).n_facets == 1


@pytest.mark.parametrize("sides", [8, 64, 1000, 20000])
def test_a_round_thing_is_not_a_facet(load, sides):
    """Each step between strips may be flat enough; the chain of them is not.

    No facet turns by more than 3.7 degrees.
    """
    a = 2 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(a), np.sin(a), np.zeros(sides)])
    i = np.arange(sides)
    j = (i + 1) % sides
    model = load(np.concatenate([ring, ring + [0, 0, 3]]), *np.column_stack([i, j, j + sides, i + sides]).tolist())
    assert 8 <= model.n_facets <= sides
    turn = np.einsum("ij,ij->i", model.triangle_normals()[0], model.facet_normal[model.triangle_facet])
    assert turn.min() > np.cos(np.radians(3.7))
    if sides <= 1000:
        assert model.n_facets == sides


# Polygons


def area(model):
    return model.triangle_normals()[1].sum()


def test_concave_polygons(load):
    arrow = [(0, 0, 0), (2, 1, 0), (0, 2, 0), (1, 1, 0)]  # a quad; its bad diagonal leaves the polygon
    for turn in range(4):
        model = load(arrow, tuple(np.roll(range(4), turn)))
        assert np.isclose(area(model), 1) and (model.triangle_normals()[0] == [0, 0, 1]).all()
    ell = [(0, 0, 5), (3, 0, 5), (3, 1, 5), (1, 1, 5), (1, 3, 5), (0, 3, 5)]
    for face in (range(6), reversed(range(6))):
        model = load(ell, tuple(face))
        assert np.isclose(area(model), 5) and model.n_facets == 1 and model.warnings == ()


def test_twelve_corners_on_a_tilted_plane(load):
    a = np.arange(12) * np.pi / 6
    star = np.column_stack([np.cos(a), np.sin(a), np.zeros(12)]) * np.where(np.arange(12) % 2, 0.4, 1)[:, None]
    u, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    u *= np.sign(np.linalg.det(u))
    model = load(star @ u.T + 10, tuple(range(12)))
    assert np.isclose(area(model), 12 * 0.5 * 0.4 * 0.5) and np.allclose(model.facet_normal, u[:, 2])


def test_a_corner_on_a_straight_side(load):
    model = load([(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 2, 0)], (0, 1, 2, 3))
    assert np.isclose(area(model), 2) and (model.triangle_normals()[1] > 0).all()


def test_not_planar(load):
    model = load([(0, 0, 0), (1, 0, 0), (1, 1, 0.2), (0, 1, 0)], (0, 1, 2, 3))
    assert model.n_facets == 2 and len(model.triangles) == 2
    assert any("not planar" in warning for warning in model.warnings)


def test_nearly_planar_stays_one(load):
    model = load([(0, 0, 0), (1, 0, 0), (1, 1, 5e-4), (0, 1, 0)], (0, 1, 2, 3))
    assert model.n_facets == 1 and model.warnings == ()


def test_crooked_polygons_keep_the_order_of_the_file(load):
    model = load(
        [(0, 0, 0), (1, 0, 0), (1, 1, 0.2), (0, 1, 0), (5, 0, 0), (6, 0, 0), (5, 1, 0)],
        "usemtl b",
        (0, 1, 2, 3),
        "usemtl c",
        (4, 5, 6),
    )
    assert model.groups == ("b", "c") and model.facet_group.tolist() == [0, 0, 1]


@pytest.mark.parametrize(
    "points",
    [
        [(0, 0, 0), (1, 1, 1), (2, 2, 2)],
        [(0, 0, 0), (0, 0, 0), (1, 0, 0)],
        [(0, 0, 0), (1, 0, 0), (0, 0, 0), (1, 0, 0)],
    ],
)
@pytest.mark.parametrize("far", [0, 1e6])
def test_polygons_without_area_are_dropped(load, points, far):
    count = len(points)
    vertices = np.array([*points, (0, 0, 1), (1, 0, 1), (0, 1, 1)], float) + far
    model = load(vertices, tuple(range(count)), (count, count + 1, count + 2))
    assert len(model.triangles) == 1 and model.n_facets == 1
    assert model.warnings == ("1 polygons without area were dropped",)


def test_a_sliver_is_kept(load):
    model = load([(0, 0, 0), (1, 0, 0), (1, 1e-6, 0), (0, 1e-6, 0)], (0, 1, 2, 3))
    assert np.isclose(area(model), 1e-6) and model.warnings == ()


def test_a_polygon_that_stands_there_twice(load):
    model = load(GRID, LEFT, LEFT)
    assert np.isclose(area(model), 1) and "twice" in model.warnings[0]


@pytest.mark.parametrize("far", [0, 1e6])
def test_moving_and_scaling_changes_nothing_else(load, far):
    rng = np.random.default_rng(1)
    vertices = rng.integers(0, 4, (30, 3)) / 4  # many coplanar, some without area
    faces = [tuple(rng.choice(30, 3, replace=False)) for _ in range(60)]
    near = load(vertices, *faces)
    for scale in (1e-3, 1, 1e4):
        moved = load((vertices + far) * scale, *faces)
        assert np.array_equal(moved.triangles, near.triangles) and np.array_equal(
            moved.triangle_facet, near.triangle_facet
        )
        assert np.allclose(moved.facet_normal, near.facet_normal, atol=1e-8)


# Closed objects


def test_a_box_is_solid_a_room_is_not(load):
    model = load(
        [*CUBE, *(np.array(CUBE) * 6 - 3)],
        "o box",
        *FACES,
        "o room",
        *[tuple(8 + i for i in reversed(f)) for f in FACES],
    )
    assert model.solid_objects().tolist() == [True, True]
    assert model.solid_objects(camera_centre=(-1, -1, -1)).tolist() == [True, False]
    assert model.solid_objects(camera_centre=(0.5, 0.5, 0.5)).tolist() == [False, False]


def test_an_open_box_is_not_solid(load):
    assert load(CUBE, *FACES[1:]).solid_objects().tolist() == [False]


def test_lamps_tell_rooms_from_solids(load):
    """A lamp that shines into an object makes it a room; one that shines out of its surface does not."""
    room = [tuple(reversed(f)) for f in FACES]
    assert load(CUBE, *room[1:], "usemtl lamp", room[0]).solid_objects(lamps=["lamp"]).tolist() == [False]
    assert load(CUBE, *FACES[1:], "usemtl lamp", FACES[0]).solid_objects(lamps=["lamp"]).tolist() == [True]
    assert load(CUBE, *FACES[1:], "usemtl lamp", FACES[0]).solid_objects(lamps=["sun"]).tolist() == [True]


def test_boxes_that_touch_along_an_edge_close(load):
    beside = [(x + 1, y + 1, z) for x, y, z in CUBE]
    assert load([*CUBE, *beside], *FACES, *[tuple(8 + i for i in f) for f in FACES]).solid_objects().tolist() == [True]


# Refused


@pytest.mark.parametrize(
    "lines, says",
    [
        ("v 0 nan 0", "line 2: vertex y = nan is not finite"),
        ("v 0 0 inf", "line 2: vertex z = inf"),
        ("v 0 zero 0", "line 2: vertex y = zero is not a number"),
        ("v 0 0", "line 2: vertex has 2 coordinates"),
        ("f 1 2 4", "line 5: face index 4 is out of range (1 to 3)"),
        ("f 0 2 3", "line 5: face index 0 is out of range"),
        ("f -4 2 3", "line 5: face index -4 is out of range"),
        ("f 1 2", "line 5: face 'f 1 2' has 2 corners"),
        ("f 1 2 x", "not a whole number"),
        ("f 1 1 2", "faces: none of the 1 has an area"),
        ("", "faces: the model has none"),
    ],
)
def test_refused(tmp_path, lines, says):
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
    text = f"usemtl a\n{lines}\n{vertices}f 1 2 3\n" if lines.startswith("v") else f"usemtl a\n{vertices}{lines}\n"
    path = tmp_path / "model.obj"
    path.write_text(text)
    with pytest.raises(BadInput) as refusal:
        models.load(path)
    (line,) = refusal.value.problems
    assert line.startswith(f"{path}: ") and says in line


def test_face_without_material(tmp_path):
    with pytest.raises(BadInput, match=r"line 5: face 'f 1 2 3' has no material"):
        models.load(obj(tmp_path / "m.obj", [(0, 0, 0), (1, 0, 0), (0, 1, 0)], (0, 1, 2), head="o a"))


@pytest.mark.parametrize(
    "content", [b"", b"\0\1\2", b"glTF", b"glTF" + struct.pack("<II", 2, 12), b"glTF" + struct.pack("<II", 2, 999)]
)
def test_not_a_model(tmp_path, content):
    (tmp_path / "m.glb").write_bytes(content)
    with pytest.raises(BadInput, match="m.glb: "):
        models.load(tmp_path / "m.glb")


# GLB


def glb(path, gltf, binary=b""):
    text = json.dumps(gltf).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return path


def square(**primitive):
    """A unit square in the plane z = 0 as a GLB, its front towards +z."""
    p = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], "<f4").tobytes()
    index = np.array([0, 1, 2, 0, 2, 3], "<u2").tobytes()
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 60}],
        "scenes": [{"nodes": [0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "materials": [{"name": "paint"}],
        "nodes": [{"name": "panel", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0, **primitive}]}],
    }, p + index


def test_glb(tmp_path):
    model = models.load(glb(tmp_path / "m.glb", *square()))
    assert model.objects == ("panel",) and model.groups == ("paint",) and model.n_facets == 1
    assert model.facet_normal.tolist() == [[0, 0, 1]] and model.facet_area().tolist() == [1]


def test_glb_nodes_move_and_mirror(tmp_path):
    """Two nodes show one mesh: one raised by its parent, one mirrored in x.

    The front of the mirrored one stays in front.
    """
    gltf, binary = square()
    gltf["nodes"] = [
        {"name": "up", "translation": [0, 0, 2], "children": [1, 2]},
        {"name": "a", "mesh": 0, "scale": [3, 1, 1]},
        {"name": "b", "mesh": 0, "matrix": [-1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]},
    ]
    model = models.load(glb(tmp_path / "m.glb", gltf, binary))
    assert model.objects == ("a", "b") and model.facet_offset.tolist() == [2, 2]
    assert model.facet_normal.tolist() == [[0, 0, 1], [0, 0, 1]] and model.facet_area().tolist() == [3, 1]
    assert model.corners()[2:].max(axis=(0, 1)).tolist() == [5, 1, 2]


@pytest.mark.parametrize(
    "quaternion, normal", [([0, 0, 0, 1], [0, 0, 1]), ([np.sqrt(0.5), 0, 0, np.sqrt(0.5)], [0, -1, 0])]
)
def test_glb_rotation(tmp_path, quaternion, normal):
    gltf, binary = square()
    gltf["nodes"][0]["rotation"] = quaternion
    assert np.allclose(models.load(glb(tmp_path / "m.glb", gltf, binary)).facet_normal, [normal])


def test_glb_strips_and_fans(tmp_path):
    for mode, order in ((5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])):
        gltf, binary = square(mode=mode)
        gltf["accessors"][1]["count"] = 4
        model = models.load(glb(tmp_path / "m.glb", gltf, binary[:48] + np.array(order, "<u2").tobytes()))
        assert model.n_facets == 1 and model.facet_area().tolist() == [1] and model.facet_normal.tolist() == [[0, 0, 1]]


def test_glb_refused(tmp_path):
    gltf, binary = square()
    nan = np.array([(0, 0, 0), (1, np.nan, 0), (1, 1, 0), (0, 1, 0)], "<f4").tobytes() + binary[48:]
    bare = json.loads(json.dumps(gltf))
    del bare["meshes"][0]["primitives"][0]["material"]
    for description, content, says in (
        (gltf, nan, "vertex 1: y = nan"),
        (bare, binary, "has no material"),
        (gltf, binary[:50], "truncated"),
        (gltf, binary[:48] + b"\7\0" * 6, "index 7 is out of range"),
    ):
        with pytest.raises(BadInput, match=says):
            models.load(glb(tmp_path / "m.glb", description, content))


@pytest.mark.scene
def test_a_hundred_thousand_triangles(tmp_path):
    """Four times as many triangles cost four times as much, with room for a busy machine; all pairs: sixteen."""
    for n in (113, 225):
        x, y = np.meshgrid(np.arange(n), np.arange(n))
        z = np.random.default_rng(0).normal(size=x.shape)
        i = (x + n * y)[:-1, :-1].ravel() + 1
        with open(tmp_path / f"{n}.obj", "w") as file:
            file.write("usemtl a\n")
            np.savetxt(file, np.column_stack([x.ravel(), y.ravel(), z.ravel()]), "v %.9g %.9g %.9g")
            np.savetxt(
                file,
                np.concatenate([np.column_stack([i, i + 1, i + n + 1]), np.column_stack([i, i + n + 1, i + n])]),
                "f %d %d %d",
            )
    model = models.load(tmp_path / "225.obj")
    assert len(model.triangles) == 2 * (n - 1) ** 2 and model.n_facets > 0.99 * len(model.triangles)
    assert growth(lambda: models.load(tmp_path / "113.obj"), lambda: models.load(tmp_path / "225.obj")) < 10


@pytest.mark.parametrize("unit, metres", [("mm", 1e-3), ("in", 0.0254), ("km", 1e3)])
def test_a_model_in_another_unit(tmp_path, unit, metres):
    """The stage's file is the model in metres, with the same objects and groups."""
    source = ROOT / "data/office/model.obj"
    drawn = "\n".join(
        " ".join(["v", *(repr(float(x) / metres) for x in line.split()[1:])]) if line.startswith("v ") else line
        for line in source.read_text().splitlines()
    )
    (tmp_path / "model.obj").write_text(drawn)
    out = tmp_path / "model.metres.glb"
    command = ["--model", tmp_path / "model.obj", "--unit", json.dumps(unit), "--metres", out]
    subprocess.run(
        [sys.executable, ROOT / "stages/units.py", *command, "--report", tmp_path / "units.report.json"], check=True
    )
    made, true = models.load(out), models.load(source)
    assert made.groups == true.groups and made.objects == true.objects and made.n_facets == true.n_facets
    np.testing.assert_allclose(made.vertices.min(axis=0), true.vertices.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(np.sort(made.facet_area()), np.sort(true.facet_area()), rtol=1e-5)
