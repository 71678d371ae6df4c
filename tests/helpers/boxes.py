"""Rooms with boxes in them, cameras, and both ways of drawing index buffers."""

import itertools

import numpy as np

from lib.buffers import coverage as a_buffer
from lib.buffers import index_buffer, opengl
from lib.given import cameras

K = np.array([[300.0, 0, 159.5], [0, 300, 119.5], [0, 0, 1]])
BOX = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]  # outwards


def box(low, high):
    """Eight corners; bit k of the number says low or high along axis k."""
    return [[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)]


class Objects:
    """Collects objects and writes them as OBJ."""

    def __init__(self):
        self.lines, self.count = [], 0

    def add(self, name, vertices, faces, group="a"):
        """faces: indices from 0 into vertices; group: one name, or one per face."""
        self.lines += [f"o {name}", *("v " + " ".join(repr(float(c)) for c in v) for v in vertices)]
        groups = [group] * len(faces) if isinstance(group, str) else group
        for face, material in zip(faces, groups, strict=True):
            self.lines += [f"usemtl {material}", "f " + " ".join(str(self.count + i + 1) for i in face)]
        self.count += len(vertices)
        return self

    def write(self, path, scale=1.0, move=(0, 0, 0)):
        lines = []
        for line in self.lines:
            if line.startswith("v "):
                line = "v " + " ".join(repr(float(c) * scale + m) for c, m in zip(line.split()[1:], move, strict=True))
            lines.append(line)
        path.write_text("\n".join(lines) + "\n")
        return path


def room(seed, boxes=15):
    """A room of 6 x 5 x 3 m with boxes in it, some of them thin, some through each other."""
    rng = np.random.default_rng(seed)
    scene = Objects().add(
        "room", box((0, 0, 0), (6, 5, 3)), [f[::-1] for f in BOX], ["wall"] * 4 + ["floor", "ceiling"]
    )
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


def draw_if_possible(model, camera):
    """By OpenGL; where there is no EGL, what is said of OpenGL is tested of its fallback."""
    try:
        return index_buffer.draw(model, camera)
    except opengl.NoGraphics:
        return index_buffer.reference(model, camera)


def coverage_if_possible(model, camera, facet, method):
    """The A-buffer; by rays where there is no EGL."""
    try:
        return a_buffer.coverage(model, camera, facet, method)
    except opengl.NoGraphics:
        return a_buffer.coverage(model, camera, facet, "rays")


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


def pixel_shares(arrays):
    """{flat pixel: {facet: count}} of the A-buffer's arrays."""
    shares = {}
    for pixel, (a, b) in zip(arrays["pixel"], itertools.pairwise(arrays["start"]), strict=True):
        shares[int(pixel)] = dict(zip(arrays["facet"][a:b].tolist(), arrays["count"][a:b].tolist(), strict=True))
    return shares
