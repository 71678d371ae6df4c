"""Index buffers, the A-buffer, trusted pixels. Where there is no EGL, what is said of OpenGL is tested of its fallback."""
import json

import numpy as np
import pytest

from lib import cameras, image, index_buffer, model as models
from lib.image import Photograph
from lib.stage import BadInput

K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])
BOX = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]          # outwards


def box(low, high):
    """Eight corners; bit k of the number says low or high along axis k."""
    return [[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)]


class Scene:
    """Collects objects and writes them as OBJ."""

    def __init__(self):
        self.lines, self.count = [], 0

    def add(self, name, vertices, faces, group="a"):
        """faces: indices from 0 into vertices; group: one name, or one per face."""
        self.lines += [f"o {name}", *("v " + " ".join(repr(float(c)) for c in v) for v in vertices)]
        for face, material in zip(faces, [group] * len(faces) if isinstance(group, str) else group):
            self.lines += [f"usemtl {material}", "f " + " ".join(str(self.count + i + 1) for i in face)]
        self.count += len(vertices)
        return self

    def write(self, path, scale=1.0, move=(0, 0, 0)):
        lines = []
        for line in self.lines:
            if line.startswith("v "):
                line = "v " + " ".join(repr(float(c) * scale + m) for c, m in zip(line.split()[1:], move))
            lines.append(line)
        path.write_text("\n".join(lines) + "\n")
        return path


def room(seed, boxes=15):
    """A room of 6 x 5 x 3 m with boxes in it, some of them thin, some through each other."""
    rng = np.random.default_rng(seed)
    scene = Scene().add("room", box((0, 0, 0), (6, 5, 3)), [f[::-1] for f in BOX], ["wall"] * 4 + ["floor", "ceiling"])
    for i in range(boxes):
        low = rng.uniform([0.3, 0.3, 0.01], [5, 4, 2])
        scene.add(f"box{i}", box(low, np.minimum(low + rng.uniform(0.003, 1, 3), [5.9, 4.9, 2.9])), BOX, f"m{i % 5}")
    return scene


def look(eye, at, K=K, width=320, height=240, scale=1.0, move=(0, 0, 0)):
    eye, at = np.array(eye, float), np.array(at, float)
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = [x, np.cross(z, x), z]
    T[:3, 3] = -T[:3, :3] @ (eye * scale + move)
    return cameras.Camera(K, width, height, T)


def forward(width=320, height=240, K=K):
    """At the origin, looking along +z, y down."""
    return cameras.Camera(K, width, height, np.eye(4))


@pytest.fixture
def load(tmp_path):
    return lambda scene, **options: models.load(scene.write(tmp_path / "model.obj", **options))


def opengl(model, camera):
    try:
        return index_buffer.draw(model, camera)
    except index_buffer.NoGraphics:
        return index_buffer.reference(model, camera)


@pytest.fixture(params=["opengl", "rays"])
def draw(request):
    return opengl if request.param == "opengl" else index_buffer.reference


@pytest.fixture(params=["opengl", "rays"])
def coverage(request):
    def call(model, camera, facet):
        try:
            return index_buffer.coverage(model, camera, facet, request.param)
        except index_buffer.NoGraphics:
            return index_buffer.coverage(model, camera, facet, "rays")
    return call


def brute_force(model, camera, q):
    """(facet, depth) at pixels q (N, 2): every triangle, in double precision; the slow clear version."""
    p = camera.points(model.vertices)[model.triangles]
    v = camera.directions(q)
    e1, e2 = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    n = np.cross(e1, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.einsum("ti,ti->t", n, p[:, 0]) / (v @ n.T)
        hit = v[:, None] * z[..., None] - p[:, 0]
        area = np.einsum("ti,ti->t", n, n)
        a = np.einsum("nti,ti->nt", np.cross(hit, e2), n) / area
        b = np.einsum("nti,ti->nt", np.cross(e1, hit), n) / area
        z = np.where((z > 0) & (a >= 0) & (b >= 0) & (a + b <= 1), z, np.inf)
    first = z.argmin(axis=1)
    nothing = np.isinf(z.min(axis=1))
    return np.where(nothing, -1, model.triangle_facet[first]), np.where(nothing, 0, z.min(axis=1))


# By hand

def test_one_triangle(load, draw):
    """f = 1 px, so at z = 1 the model's metres are pixels: the corners (1, 0), (3.9, 0), (1, 2.9) hold six pixel centres."""
    model = load(Scene().add("t", [(0.9, -0.1, 1), (3.9, -0.1, 1), (0.9, 2.9, 1)], [(0, 1, 2)]))
    index = draw(model, forward(5, 4, np.eye(3)))
    assert index.facet.tolist() == [[-1, 0, 0, 0, -1], [-1, 0, 0, -1, -1], [-1, 0, -1, -1, -1], [-1, -1, -1, -1, -1]]
    assert np.allclose(index.depth, index.facet == 0, rtol=1e-14)


def test_first_pixel_is_the_top_left_one(load, draw):
    model = load(Scene().add("t", [(-0.4, -0.4, 1), (0.4, -0.4, 1), (0.4, 0.4, 1), (-0.4, 0.4, 1)], [(0, 1, 2, 3)]))
    assert np.argwhere(draw(model, forward(6, 5, np.eye(3))).facet == 0).tolist() == [[0, 0]]


def test_both_sides_are_seen(load, draw):
    square = [(-1, -1, 2), (1, -1, 2), (1, 1, 2), (-1, 1, 2)]
    for face in ((0, 1, 2, 3), (3, 2, 1, 0)):
        assert (draw(load(Scene().add("t", square, [face])), forward()).facet[119] == 0).sum() == 300


def test_depth_of_a_slanted_plane(load, draw):
    """The plane z = 2 + x / 2: along the ray (x, y, 1) z, z = 2 / (1 - x / 2)."""
    model = load(Scene().add("t", [(x, y, 2 + x / 2) for x, y in ((-3, -9), (20, -9), (20, 9), (-3, 9))], [(0, 1, 2, 3)]))
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
    """But for pixel centres within 1/128 px of an edge: at most 0.01 %. Off-centre principal points, cameras near and on walls."""
    rng = np.random.default_rng(seed)
    model = load(room(seed, boxes=25))
    K = np.array([[rng.uniform(250, 900), 0, rng.uniform(0, 640)], [0, rng.uniform(250, 900), rng.uniform(-100, 480)], [0, 0, 1]])
    eye = rng.uniform([0.2, 0.2, 0.2], [5.8, 4.8, 2.8])
    if seed % 2:
        eye[seed % 3] = 0.004
    camera = look(eye, (3, 2.5, 1), K, 640, 480)
    a, b = opengl(model, camera), index_buffer.reference(model, camera)
    differ = a.facet != b.facet
    assert differ.mean() <= 1e-4
    assert (a.facet >= 0).all()                                                # closed: no crack between triangles
    near = index_buffer.boundary(a.facet) | index_buffer.visible_edges(model, camera, a.facet, a.depth)
    assert near[differ].all()
    assert np.allclose(a.depth[~differ], b.depth[~differ], rtol=1e-12)


# By law

@pytest.mark.parametrize("scale, move", [(1, (1e6, -1e6, 5e5)), (1e-3, (0, 0, 0)), (1e4, (0, 0, 0)), (1e4, (1e6, 0, 0))])
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
    scene = Scene()
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
    model = load(Scene().add("panel", square, faces[::-1] if turned else faces))
    facet = draw(model, forward()).facet
    seen = np.unique(facet[facet >= 0])
    assert len(seen) == 1 and model.facet_normal[seen[0]][2] < 0


def test_lamp_in_a_ceiling(load):
    """Coplanar, overlapping, seen at a grazing angle: both methods agree on every pixel, and the lamp is whole."""
    scene = room(5, boxes=0).add("lamp", [(1, 1, 3), (1, 4, 3), (5, 4, 3), (5, 1, 3)], [(0, 1, 2, 3)], "lamp")
    model = load(scene)
    camera = look((0.3, 2.5, 2.95), (5, 2.5, 2.9))
    a, b = opengl(model, camera).facet, index_buffer.reference(model, camera).facet
    assert (a != b).mean() <= 1e-4
    lamp = a == model.n_facets - 1
    row = lamp.any(axis=1)
    assert row.sum() > 5
    assert all(np.ptp(np.flatnonzero(line)) + 1 == line.sum() for line in lamp[row])       # no holes


# At the edge

def test_facets_that_reach_behind_the_camera(load, draw):
    """A floor 200 m long below a camera that stands in its middle: seen down to the bottom of the picture, exactly."""
    model = load(Scene().add("floor", [(-100, 1.5, -100), (100, 1.5, -100), (100, 1.5, 100), (-100, 1.5, 100)], [(0, 1, 2, 3)]))
    index = draw(model, forward())
    y = (np.arange(240) - 119.5) / 300
    depth = np.where(y > 0, 1.5 / np.where(y > 0, y, 1), np.inf)
    expected = np.where(depth <= 100, depth, 0)
    assert np.array_equal(index.facet[:, 160] == 0, expected > 0)
    assert np.allclose(index.depth[:, 160], expected, rtol=1e-12)


def test_in_the_plane_of_a_facet_it_is_not_seen(load, draw):
    model = load(Scene().add("floor", [(-1, 0, 1), (1, 0, 1), (1, 0, 5), (-1, 0, 5)], [(0, 1, 2, 3)]))
    assert (draw(model, forward(K=np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]]))).facet == -1).all()


def test_looking_away(load, draw):
    model = load(Scene().add("t", [(-1, -1, -2), (1, -1, -2), (0, 1, -2)], [(0, 1, 2)]))
    index = draw(model, forward())
    assert (index.facet == -1).all() and (index.depth == 0).all()
    arrays = index_buffer.coverage(model, forward(), index.facet, index.method)
    assert len(arrays["pixel"]) == 0 and arrays["start"].tolist() == [0]
    assert not index_buffer.visible_edges(model, forward(), index.facet, index.depth).any()


def test_one_pixel(load, draw):
    model = load(room(0))
    camera = look((1, 1, 1.5), (3, 2.5, 1), np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]), 1, 1)
    index = draw(model, camera)
    assert index.facet.shape == (1, 1) and index.facet[0, 0] == brute_force(model, camera, np.zeros((1, 2)))[0][0]


def test_sides_that_meet_others_half_way_leave_no_cracks(load, draw):
    """T-junctions: a wall of two strips beside a wall of three. A ray may slip through by rounding, a pixel in a thousand may not."""
    scene = Scene()
    for n, x0, x1 in ((2, -3, 0.1), (3, 0.1, 3)):
        for i in range(n):
            y0, y1 = 6 * i / n - 3, 6 * (i + 1) / n - 3
            scene.add(f"{n}{i}", [(x0, y0, 2 + 0.1 * x0), (x1, y0, 2 + 0.1 * x1), (x1, y1, 2 + 0.1 * x1), (x0, y1, 2 + 0.1 * x0)], [(0, 1, 2, 3)])
    assert (draw(load(scene), forward()).facet < 0).sum() <= 1


# The A-buffer

def pixels(arrays):
    """{flat pixel: {facet: count}}."""
    return {int(p): dict(zip(arrays["facet"][a:b].tolist(), arrays["count"][a:b].tolist()))
            for p, a, b in zip(arrays["pixel"], arrays["start"], arrays["start"][1:])}


def test_coverage_by_hand(load, draw, coverage):
    """A facet from x = 0.75 px rightwards and y = -9 to 1.25 px: it covers 3/4 of pixel (1, 0), 3/4 of (2, 1) below, and so on."""
    model = load(Scene().add("t", [(0.75, -9, 1), (9, -9, 1), (9, 1.25, 1), (0.75, 1.25, 1)], [(0, 1, 2, 3)]))
    camera = forward(4, 3, np.eye(3))
    index = draw(model, camera)
    assert pixels(coverage(model, camera, index.facet)) == {1: {0: 48}, 5: {0: 36}, 6: {0: 48}, 7: {0: 48}}


@pytest.mark.parametrize("seed", range(3))
def test_coverage_both_ways(load, seed):
    model = load(room(seed))
    camera = look((0.2, 0.2 + seed, 1.5), (3, 2.5, 1))
    facet = index_buffer.reference(model, camera).facet
    try:
        drawn = index_buffer.coverage(model, camera, facet, "opengl")
    except index_buffer.NoGraphics:
        drawn = index_buffer.coverage(model, camera, facet, "rays")
    a, b = pixels(drawn), pixels(index_buffer.coverage(model, camera, facet, "rays"))
    assert all(sum(shares.values()) == 64 for shares in a.values())            # nothing is empty in a closed room
    whole = {p: {int(facet.ravel()[p]): 64} for p in {*a, *b}}
    wrong = [sum(abs(shares.get(f, 0) - b.get(p, whole[p]).get(f, 0)) for f in {*shares, *b.get(p, whole[p])}) / 2
             for p, shares in (whole | a).items()]
    assert max(wrong) <= 3 and np.mean(wrong) < 0.05


def test_coverage_sums_to_the_area(load, coverage):
    """A square of 100.3 x 50.7 px covers that many pixels, to the 64th parts that its edges leave open."""
    model = load(Scene().add("t", [(x, y, 3) for x, y in ((0, 0), (1.003, 0), (1.003, 0.507), (0, 0.507))], [(0, 1, 2, 3)]))
    camera = forward()
    facet = index_buffer.reference(model, camera).facet
    share = (facet == 0).astype(float).ravel()
    arrays = coverage(model, camera, facet)
    share[arrays["pixel"]] = np.add.reduceat(np.append(arrays["count"], 0), arrays["start"][:-1]) / 64
    assert np.isclose(share.sum(), 100.3 * 50.7, atol=0.13 * (100.3 + 50.7))


@pytest.mark.parametrize("width_px", [0.3, 0.6])
def test_a_sliver_thinner_than_a_pixel_is_found(load, coverage, width_px):
    """Between pixel centres: the index buffer does not see it, the A-buffer and the hidden-surface buffer do."""
    x0, x1 = (np.array([20.51, 20.51 + width_px]) - 0.3 - 159.5) / 100
    scene = Scene().add("wall", [(-9, -9, 9), (9, -9, 9), (9, 9, 9), (-9, 9, 9)], [(0, 1, 2, 3)])
    model = load(scene.add("rod", [(x0, -0.5, 3), (x1, -0.5, 3), (x1, 0.5, 3), (x0, 0.5, 3)], [(0, 1, 2, 3)]))
    camera = forward()
    index = index_buffer.reference(model, camera)
    shares = pixels(coverage(model, camera, index.facet))
    middle = [shares[120 * 320 + x].get(1, 0) / 64 for x in range(18, 24) if 120 * 320 + x in shares]
    assert np.isclose(sum(middle), width_px, atol=0.13)
    if width_px < 0.5:
        assert (index.facet != 1).all()
    edges = index_buffer.visible_edges(model, camera, index.facet, index.depth)
    assert edges[100:140, 19:23].any(axis=1).all()


def test_hidden_edges_are_hidden(load, draw):
    """A square behind a larger one leaves no edge; in front of it, its outline."""
    front, behind = [[(s * x, s * y, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))] for s, z in ((1, 3), (0.5, 4))]
    camera = forward()
    for name, small, others in (("behind", behind, front), ("before", [(x, y, 2) for x, y, _ in behind], front)):
        model = load(Scene().add("large", others, [(0, 1, 2, 3)]).add("small", small, [(0, 1, 2, 3)]))
        index = draw(model, camera)
        inside = index_buffer.visible_edges(model, camera, index.facet, index.depth)[30:210, 70:250]
        assert inside.any() == (name == "before")


def test_edges_inside_a_facet_are_none(load, draw):
    """The diagonal that cuts a square into triangles, and the seam of two polygons of one facet, are no edges."""
    model = load(Scene().add("t", [(x, y, 2) for y in (-9, 9) for x in (-9, 0, 9)], [(0, 1, 4, 3), (1, 2, 5, 4)]))
    index = draw(model, forward())
    assert not index_buffer.visible_edges(model, forward(), index.facet, index.depth).any()
    assert not index_buffer.boundary(index.facet).any()


# Trusted pixels

H, W = 120, 160
FACET = np.zeros((H, W), np.int32)
FACET[:, 80:] = 1
FACET[:30, :20] = 2
FACET[100:, 150:] = -1
GROUP = np.array([0, 1, 2])
NO_EDGES = np.zeros((H, W), bool)


def photo(values, linear=False):
    values = np.asarray(values, float)
    values = values[..., None] if values.ndim == 2 else values
    return Photograph(values, 0 if linear else 8, linear, values.shape[2])


def flat(level=0.5, noise=0.01, seed=0, channels=3):
    return np.clip(level + noise * np.random.default_rng(seed).normal(size=(H, W, channels)), 0, 1)


def test_no_pixel_that_mixes_two_facets():
    trust = index_buffer.trusted(photo(flat()), FACET, NO_EDGES, GROUP, keep=1)
    mask = trust.mask
    for y, x in np.argwhere(mask):
        assert len(np.unique(FACET[max(y - 1, 0):y + 2, max(x - 1, 0):x + 2])) == 1
    assert not mask[FACET < 0].any()
    assert not mask[50, 77:83].any() and mask[50, 76] and mask[50, 83]          # the mixed pixel and two more on each side


def test_half_of_each_facet():
    mask = index_buffer.trusted(photo(flat()), FACET, NO_EDGES, GROUP, keep=0.5).mask
    all_of_it = index_buffer.trusted(photo(flat()), FACET, NO_EDGES, GROUP, keep=1).mask
    for facet in (0, 1):
        n = (all_of_it & (FACET == facet)).sum()
        assert (mask & (FACET == facet)).sum() == -(-n // 2)
    assert (mask & ~all_of_it).sum() == 0


def test_a_small_group_keeps_what_is_honest():
    """A group of 12 x 20 pixels: margins and the choice give way, so all 10 x 18 that are pure stay; a mixed pixel never does."""
    small = FACET.copy()
    small[small == 2] = 0
    small[10:22, 10:30] = 2
    mask = index_buffer.trusted(photo(flat()), small, NO_EDGES, GROUP).mask
    assert (mask & (small == 2)).sum() == 10 * 18
    same_group = index_buffer.trusted(photo(flat()), small, NO_EDGES, np.array([0, 1, 0])).mask
    assert (same_group & (small == 2)).sum() <= 6 * 14                          # its group has plenty: margins stay


def test_one_pixel_facets_and_empty_facets():
    facet = FACET.copy()
    facet[60, 40] = 2
    mask = index_buffer.trusted(photo(flat()), facet, NO_EDGES, np.array([0, 1, 2, 3, 4])).mask
    assert not mask[59:62, 39:42].any() and mask.any()


@pytest.mark.parametrize("linear", [False, True])
def test_saturated_and_black_pixels_are_out(linear):
    values = flat(noise=0)
    values[:, :40], values[:, 120:] = 1.0, 0.0
    mask = index_buffer.trusted(photo(values, linear), FACET, NO_EDGES, GROUP, keep=1).mask
    assert not mask[:, 120:].any() and mask[:, 60:70].any()
    assert mask[40:100, 10:30].any() == linear                                  # in an EXR, 1.0 is only light


def test_light_above_one_is_trusted_in_linear_pictures():
    assert index_buffer.trusted(photo(7 * flat(), True), FACET, NO_EDGES, GROUP).left["trusted"] > 5000


@pytest.mark.parametrize("level", [0.2, 0.5, 0.9])
def test_skewed_noise_does_not_bias_the_choice(level):
    """A path tracer's noise: few bright pixels among many that are slightly dark. The chosen pixels keep its mean."""
    rng = np.random.default_rng(3)
    noise = rng.gamma(0.25, 1, (H, W, 3)) / 0.25 - 1                             # mean 0, skewness 4
    x = np.arange(W)[None, :, None]
    truth = level * (1 + 0.05 * np.sin(x / 20.0))
    values = truth * (1 + 0.03 * noise)
    mask = index_buffer.trusted(photo(np.clip(values, 0, 1)), FACET, NO_EDGES, GROUP).mask
    sigma = 0.03 * 2 / np.sqrt(3 * mask.sum())
    if mask.sum() > 300:
        ratio = (values[mask] / np.broadcast_to(truth, values.shape)[mask]).mean()
        clipped = (np.clip(values, 0, 1)[mask] / np.broadcast_to(truth, values.shape)[mask]).mean()
        assert abs(ratio - 1) < 4 * sigma + 0.001 and abs(clipped - 1) < 4 * sigma + 0.001
    else:
        assert level == 0.9                                                     # noise that reaches white leaves little


def test_an_edge_in_the_photograph_is_avoided():
    """A step of 10 % inside a facet, say the shadow of something the model does not have."""
    values = flat(noise=0.01)
    values[:, 120:] -= 0.05
    trust = index_buffer.trusted(photo(values), FACET, NO_EDGES, GROUP, keep=1)
    assert trust.edges[5:95, 118:122].any(axis=1).mean() > 0.9
    assert not trust.mask[5:95, 119:121].all(axis=1).any()


@pytest.mark.parametrize("noise", [0, 0.003, 0.02, 0.1])
def test_noise_and_shading_are_no_edges(noise):
    x, y = np.meshgrid(np.arange(W), np.arange(H))
    shading = (0.3 + 0.4 * np.exp(-((x - 40) ** 2 + (y - 60) ** 2) / 40.0**2))[..., None]
    rng = np.random.default_rng(1)
    values = np.round(np.clip(shading + noise * rng.normal(size=(H, W, 3)), 0, 1) * 255) / 255
    edges = index_buffer.trusted(photo(values), FACET, NO_EDGES, GROUP).edges
    assert edges.mean() < 0.03                    # beside a facet's rim shading that curves can pass for one
    assert edges[40:90, 10:70].mean() < 1e-3


@pytest.mark.parametrize("values", [np.zeros((H, W, 3)), np.ones((H, W, 1)), np.full((H, W, 1), 0.5), np.random.default_rng(0).random((H, W, 3))])
@pytest.mark.parametrize("linear", [False, True])
def test_extreme_photographs(values, linear):
    mask = index_buffer.trusted(photo(values, linear), FACET, NO_EDGES, GROUP).mask
    assert mask.shape == (H, W)
    if not linear and values.max() == values.min() and values.max() != 0.5:
        assert not mask.any()


def test_nothing_of_the_model_in_the_picture():
    trust = index_buffer.trusted(photo(flat()), np.full((H, W), -1, np.int32), NO_EDGES, GROUP)
    assert not trust.mask.any() and trust.left["seen"] == 0


# From outside

OUTPUTS = {"group": "group.png", "object": "object.png", "facet": "facet.png", "legend": "legend.json", "depth": "depth.exr",
           "hidden": "hidden.png", "trusted": "trusted.png", "report": "index.report.json"}


@pytest.fixture
def folder(tmp_path):
    """A small scene: a room with three boxes, its camera, a grey photograph of it."""
    room(7, boxes=3).write(tmp_path / "model.obj")
    K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
    cameras.write_cameramodel(tmp_path / "left.cameramodel", look((0.5, 0.6, 1.6), (4, 3, 1), K, 80, 60))
    image.write_png8(tmp_path / "left.png", np.full((60, 80, 3), (120, 130, 140), np.uint8))
    (tmp_path / "out").mkdir()
    return tmp_path


def index_command(folder, *more, **replaced):
    files = {"model": "model.obj", "camera": "left.cameramodel", "photograph": "left.png"} | replaced
    words = ["stages/index.py"]
    for name, file in files.items():
        words += [f"--{name}", folder / file]
    for name, file in OUTPUTS.items():
        words += [f"--{name}", folder / "out" / file]
    return [*words, *more]


def test_stage_writes_what_the_contract_says(run, folder):
    result = run(*index_command(folder))
    assert result.returncode == 0, result.stderr
    out = folder / "out"
    model, camera = models.load(folder / "model.obj"), cameras.read_cameramodel(folder / "left.cameramodel")
    facet = image.read_labels(out / "facet.png") - 1
    legend = json.loads((out / "legend.json").read_text())
    assert legend["groups"] == list(model.groups) and legend["objects"] == list(model.objects)
    assert legend["facets"] == np.column_stack([model.facet_object, model.facet_group]).tolist()
    assert np.array_equal(image.read_labels(out / "group.png") - 1, model.facet_group[facet])
    assert np.array_equal(image.read_labels(out / "object.png") - 1, model.facet_object[facet])
    depth = image.read_exr(out / "depth.exr")
    assert np.allclose(depth, index_buffer.reference(model, camera).depth, rtol=1e-6) or (facet != index_buffer.reference(model, camera).facet).any()
    for name in ("trusted", "hidden"):
        assert set(np.unique(image.read_labels(out / f"{name}.png"))) == {0, 255}
    report = json.loads((out / "index.report.json").read_text())
    assert report["status"] == "complete"
    assert sum(group["seen"] for group in report["groups"].values()) == 80 * 60
    assert sum(group["trusted"] for group in report["groups"].values()) == (image.read_labels(out / "trusted.png") > 0).sum()


def test_stage_without_graphics_casts_rays(run, folder):
    """libglvnd is pointed to no driver at all: a warning, and the same files."""
    drawn = run(*index_command(folder))
    facet = image.read_labels(folder / "out" / "facet.png")
    result = run(*index_command(folder), env={"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent.json"})
    assert drawn.returncode == result.returncode == 0, result.stderr
    assert "rays instead" in result.stderr
    assert json.loads((folder / "out" / "index.report.json").read_text())["method"] == "rays"
    assert (image.read_labels(folder / "out" / "facet.png") != facet).mean() <= 1e-3


def test_stage_looking_away(run, folder):
    K = np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]])
    cameras.write_cameramodel(folder / "left.cameramodel", look((0.5, 0.6, 100), (4, 3, 900), K, 80, 60))
    assert run(*index_command(folder)).returncode == 0
    assert json.loads((folder / "out" / "index.report.json").read_text())["status"] == "nothing seen"
    assert not image.read_labels(folder / "out" / "group.png").any()


def break_vertex(folder):
    path = folder / "model.obj"
    path.write_text(path.read_text().replace("v 6.0 ", "v nan ", 1))


def drop_material(folder):
    path = folder / "model.obj"
    path.write_text("\n".join(line for line in path.read_text().split("\n") if not line.startswith("usemtl")))


def cut_photograph(folder):
    path = folder / "left.png"
    path.write_bytes(path.read_bytes()[:-20])


def other_size(folder):
    image.write_png8(folder / "left.png", np.full((60, 81, 3), 99, np.uint8))


@pytest.mark.parametrize("damage, says", [
    (break_vertex, "model.obj: line 3: vertex x = nan is not finite"),
    (drop_material, "has no material"),
    (cut_photograph, "left.png: truncated"),
    (other_size, "left.png: size: 81 x 60 is not the camera's 80 x 60"),
    (lambda folder: (folder / "left.png").unlink(), "left.png"),
    (lambda folder: (folder / "model.obj").write_text(""), "model.obj: faces: the model has none"),
    (lambda folder: (folder / "left.cameramodel").write_text("{"), "left.cameramodel: not a camera model"),
])
def test_stage_refuses(refuses, folder, damage, says):
    damage(folder)
    line, = refuses(*index_command(folder))
    assert line.startswith("index.py: ") and says in line
    assert not list((folder / "out").iterdir())


@pytest.mark.parametrize("words, says", [(("--keep", "0"), "keep"), (("--margin-px", "-1"), "margin")])
def test_stage_refuses_numbers(refuses, folder, words, says):
    assert says in refuses(*index_command(folder, *words))[0]
    assert not list((folder / "out").iterdir())


@pytest.mark.parametrize("method", ["opengl", "rays"])
def test_coverage_stage(run, folder, method):
    assert run(*index_command(folder)).returncode == 0
    result = run("stages/coverage.py", "--model", folder / "model.obj", "--camera", folder / "left.cameramodel", "--facet", folder / "out" / "facet.png",
                 "--coverage", folder / "coverage.npz", "--report", folder / "coverage.report.json", "--method", method)
    assert result.returncode == 0, result.stderr
    with np.load(folder / "coverage.npz", allow_pickle=False) as arrays:
        assert all(sum(shares.values()) == 64 for shares in pixels(dict(arrays)).values())
        assert json.loads((folder / "coverage.report.json").read_text())["mixed_pixels"] == len(arrays["pixel"]) > 100


def test_coverage_refuses_another_models_facets(refuses, folder):
    image.write_png16(folder / "facet.png", np.full((60, 80), 999))
    line, = refuses("stages/coverage.py", "--model", folder / "model.obj", "--camera", folder / "left.cameramodel", "--facet", folder / "facet.png",
                    "--coverage", folder / "coverage.npz")
    assert "999 is beyond the model's 24 facets" in line and not (folder / "coverage.npz").exists()
