"""Index buffers: by hand, by difference, by law, ties, at the edge."""

import numpy as np
import pytest

from lib.buffers import coverage as a_buffer
from lib.buffers import edges, index_buffer
from lib.given import cameras
from lib.given import model as models
from lib.light import hemicube
from tests.helpers import rooms
from tests.helpers.boxes import K, Objects, brute_force, draw_if_possible, forward, look, room


@pytest.fixture
def load(tmp_path):
    return lambda objects, **options: models.load(objects.write(tmp_path / "model.obj", **options))


@pytest.fixture(params=["opengl", "rays"])
def draw(request):
    return draw_if_possible if request.param == "opengl" else index_buffer.reference


# By hand


def test_one_triangle(load, draw):
    """f = 1 px, so at z = 1 the model's metres are pixels.

    The corners (1, 0), (3.9, 0), (1, 2.9) hold six pixel centres.
    """
    model = load(Objects().add("t", [(0.9, -0.1, 1), (3.9, -0.1, 1), (0.9, 2.9, 1)], [(0, 1, 2)]))
    index = draw(model, forward(5, 4, np.eye(3)))
    assert index.facet.tolist() == [[-1, 0, 0, 0, -1], [-1, 0, 0, -1, -1], [-1, 0, -1, -1, -1], [-1, -1, -1, -1, -1]]
    assert np.allclose(index.depth, index.facet == 0, rtol=1e-14)


def test_first_pixel_is_the_top_left_one(load, draw):
    model = load(Objects().add("t", [(-0.4, -0.4, 1), (0.4, -0.4, 1), (0.4, 0.4, 1), (-0.4, 0.4, 1)], [(0, 1, 2, 3)]))
    assert np.argwhere(draw(model, forward(6, 5, np.eye(3))).facet == 0).tolist() == [[0, 0]]


def test_both_sides_are_seen(load, draw):
    square = [(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)]
    for face in ((0, 1, 2, 3), (3, 2, 1, 0)):
        assert (draw(load(Objects().add("t", square, [face])), forward()).facet[119] == 0).sum() == 300


def test_depth_of_a_slanted_plane(load, draw):
    """The plane z = 2 + x / 2: along the ray (x, y, 1) z, z = 2 / (1 - x / 2)."""
    model = load(
        Objects().add("t", [(x, y, 2 + x / 2) for x, y in ((-3, -9), (20, -9), (20, 9), (-3, 9))], [(0, 1, 2, 3)])
    )
    index = draw(model, forward())
    x = (np.arange(320) - 159.5) / 300
    assert (index.facet == 0).all()
    assert np.allclose(index.depth, 2 / (1 - x / 2), rtol=1e-13)


# By difference


@pytest.mark.parametrize("seed", range(3))
def test_against_brute_force(load, draw, seed):
    model = load(room(seed))
    camera = look(np.random.default_rng(seed).uniform([0.1, 0.1, 0.5], [5.9, 4.9, 2.5]), (3, 2.5, 1))
    index = draw(model, camera)
    q = np.random.default_rng(1).integers(0, (320, 240), (3000, 2))
    facet, depth = brute_force(model, camera, q)
    seen = index.facet[q[:, 1], q[:, 0]]
    assert np.count_nonzero(seen != facet) <= 1
    same = seen == facet
    assert np.allclose(index.depth[q[:, 1], q[:, 0]][same], depth[same], rtol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_opengl_and_rays_agree(load, seed):
    """But for pixel centres within 1/128 px of an edge: at most 0.01 %.

    With off-centre principal points, and cameras near and on walls.
    """
    rng = np.random.default_rng(seed)
    model = load(room(seed, boxes=25))
    K = np.array(
        [[rng.uniform(250, 900), 0, rng.uniform(0, 640)], [0, rng.uniform(250, 900), rng.uniform(-100, 480)], [0, 0, 1]]
    )
    eye = rng.uniform([0.2, 0.2, 0.2], [5.8, 4.8, 2.8])
    if seed % 2:
        eye[seed % 3] = 0.004
    camera = look(eye, (3, 2.5, 1), K, 640, 480)
    a, b = draw_if_possible(model, camera), index_buffer.reference(model, camera)
    differ = a.facet != b.facet
    assert differ.mean() <= 1e-4
    assert (a.facet >= 0).all()  # closed: no crack between triangles
    near = edges.boundary(a.facet) | edges.visible_edges(model, camera, a.facet, a.depth)
    assert near[differ].all()
    assert np.allclose(a.depth[~differ], b.depth[~differ], rtol=1e-12)


def test_hemicubes_drawn_between_leave_the_next_buffer_as_it_was(load, tmp_path):
    """One process, one OpenGL context: a second one stayed current and the index buffer's programs drew garbage."""
    model = load(room(3))
    camera = look((1.1, 0.9, 1.6), (3, 2.5, 1))
    before = draw_if_possible(model, camera)
    surface = rooms.surface(tmp_path / "box.obj", {**rooms.room(), **rooms.LAMP})
    hemicube.rows(surface, rooms.patches(surface, 20), resolution=8)
    after = index_buffer.draw(model, camera)
    assert np.array_equal(after.facet, before.facet)
    assert np.array_equal(after.depth, before.depth)


# By law


@pytest.mark.parametrize(
    "scale, move", [(1, (1e6, -1e6, 5e5)), (1e-3, (0, 0, 0)), (1e4, (0, 0, 0)), (1e4, (1e6, 0, 0))]
)
def test_moved_and_scaled(load, draw, scale, move):
    scene, eye, at = room(3), (0.4, 0.5, 1.7), (4, 3, 0.7)
    here = draw(load(scene), look(eye, at))
    there = draw(load(scene, scale=scale, move=move), look(eye, at, scale=scale, move=move))
    differ = here.facet != there.facet
    assert differ.mean() <= 1e-4
    far = np.abs(move).max() / scale
    assert np.allclose(there.depth[~differ], here.depth[~differ] * scale, rtol=1e-12 + 1e-12 * far)


def test_the_file_may_show_far_more_than_the_picture(load, draw):
    """A model 1000 times as large as what is seen: the same ids."""
    scene, camera = room(4), look((0.4, 0.5, 1.7), (4, 3, 0.7))
    here = draw(load(scene), camera)
    scene.add("ground", [(-5000, -5000, -1), (5000, -5000, -1), (5000, 5000, -1), (-5000, 5000, -1)], [(0, 1, 2, 3)])
    differ = here.facet != draw(load(scene), camera).facet
    assert differ.mean() <= 1e-4


# Ties


def wall_and_board(gap):
    wall = [(-3, -2, 4), (3, -2, 4), (3, 2, 4), (-3, 2, 4)]
    board = [(-1, -0.5, 4 - gap), (1, -0.5, 4 - gap), (0.9, 0.5, 4 - gap), (-1, 0.5, 4 - gap)]
    return wall, board


@pytest.mark.parametrize("gap", [0, 1e-5, 1e-3])
@pytest.mark.parametrize("first", ["wall", "board"])
@pytest.mark.parametrize("far", [0, 1e6])
def test_a_board_on_a_wall(load, draw, gap, first, far):
    """A board 10 um off a wall at 4 m hides it. Exactly on it, the later one in the file wins, everywhere."""
    wall, board = wall_and_board(gap)
    scene = Objects()
    for name in (first, "board" if first == "wall" else "wall"):
        scene.add(name, wall if name == "wall" else board, [(0, 3, 2, 1)], name)
    model = load(scene, move=(0, 0, far))
    T = np.eye(4)
    T[2, 3] = -far
    facet = draw(model, cameras.Camera(K, 320, 240, T)).facet
    name = np.array(model.objects)[model.facet_object[facet[90:150, 100:220]]]
    assert (name == ("wall" if gap == 0 and first == "board" else "board")).all()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("tilt", [0, 0.3, 20])
def test_a_panel_of_two_polygons_shows_its_front(load, draw, turned, tilt):
    """Back to back in one plane: the one that faces the camera is seen, whichever comes first."""
    square = [(x, y, 3 + tilt * x) for x, y in ((-0.1, -1), (0.1, -1), (0.1, 1), (-0.1, 1))]
    faces = [(0, 3, 2, 1), (0, 1, 2, 3)]
    model = load(Objects().add("panel", square, faces[::-1] if turned else faces))
    facet = draw(model, forward()).facet
    seen = np.unique(facet[facet >= 0])
    assert len(seen) == 1 and model.facet_normal[seen[0]][2] < 0


def test_lamp_in_a_ceiling(load):
    """Coplanar, overlapping, seen at a grazing angle: both methods agree on every pixel, and the lamp is whole."""
    scene = room(5, boxes=0).add("lamp", [(1, 1, 3), (1, 4, 3), (5, 4, 3), (5, 1, 3)], [(0, 1, 2, 3)], "lamp")
    model = load(scene)
    camera = look((0.3, 2.5, 2.95), (5, 2.5, 2.9))
    a, b = draw_if_possible(model, camera).facet, index_buffer.reference(model, camera).facet
    assert (a != b).mean() <= 1e-4
    lamp = a == model.n_facets - 1
    row = lamp.any(axis=1)
    assert row.sum() > 5
    assert all(np.ptp(np.flatnonzero(line)) + 1 == line.sum() for line in lamp[row])  # no holes


# At the edge


def test_facets_that_reach_behind_the_camera(load, draw):
    """A floor 200 m long below a camera that stands in its middle: seen down to the bottom of the picture, exactly."""
    model = load(
        Objects().add("floor", [(-100, 1.5, -100), (100, 1.5, -100), (100, 1.5, 100), (-100, 1.5, 100)], [(0, 1, 2, 3)])
    )
    index = draw(model, forward())
    y = (np.arange(240) - 119.5) / 300
    depth = np.where(y > 0, 1.5 / np.where(y > 0, y, 1), np.inf)
    expected = np.where(depth <= 100, depth, 0)
    assert np.array_equal(index.facet[:, 160] == 0, expected > 0)
    assert np.allclose(index.depth[:, 160], expected, rtol=1e-12)


def test_in_the_plane_of_a_facet_it_is_not_seen(load, draw):
    model = load(Objects().add("floor", [(-1, 0, 1), (1, 0, 1), (1, 0, 5), (-1, 0, 5)], [(0, 1, 2, 3)]))
    assert (draw(model, forward(K=np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]))).facet == -1).all()


def test_looking_away(load, draw):
    model = load(Objects().add("t", [(-1, -1, -2), (1, -1, -2), (0, 1, -2)], [(0, 1, 2)]))
    index = draw(model, forward())
    assert (index.facet == -1).all() and (index.depth == 0).all()
    arrays = a_buffer.coverage(model, forward(), index.facet, index.method)
    assert len(arrays["pixel"]) == 0 and arrays["start"].tolist() == [0]
    assert not edges.visible_edges(model, forward(), index.facet, index.depth).any()


def test_one_pixel(load, draw):
    model = load(room(0))
    camera = look((1, 1, 1.5), (3, 2.5, 1), np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]), 1, 1)
    index = draw(model, camera)
    assert index.facet.shape == (1, 1) and index.facet[0, 0] == brute_force(model, camera, np.zeros((1, 2)))[0][0]


def test_sides_that_meet_others_half_way_leave_no_cracks(load, draw):
    """T-junctions: a wall of two strips beside a wall of three.

    A ray may slip through by rounding, a pixel in a thousand may not.
    """
    scene = Objects()
    for n, x0, x1 in ((2, -3, 0.1), (3, 0.1, 3)):
        for i in range(n):
            y0, y1 = 6 * i / n - 3, 6 * (i + 1) / n - 3
            scene.add(
                f"{n}{i}",
                [(x0, y0, 2 + 0.1 * x0), (x1, y0, 2 + 0.1 * x1), (x1, y1, 2 + 0.1 * x1), (x0, y1, 2 + 0.1 * x0)],
                [(0, 1, 2, 3)],
            )
    assert (draw(load(scene), forward()).facet < 0).sum() <= 1
