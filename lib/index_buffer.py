"""§3.2, §4.5 Index buffers: which facet each pixel shows, how far away, how much of it, and whether to trust it.

    index = draw(model, camera)                 # OpenGL, headless
    index = reference(model, camera)            # the same by casting rays; no graphics needed

What is nearest wins. Where facets coincide in depth (within the rounding of a float32) the one
that turns its front to the camera wins, then the later one in the file: a board drawn exactly
on a wall hides it, a panel of two polygons back to back shows the right one.
"""

import functools
from dataclasses import dataclass

import numpy as np

from lib import frames

SUBPIXELS = 8                     # the A-buffer's fragments: 8 x 8 to a pixel
TIE = 4e-7                        # float32's rounding, and a little, in 1 / z


@dataclass(frozen=True, eq=False)
class IndexBuffer:
    """facet : (H, W) int32            -1 where the model shows nothing
    depth : (H, W) float64 m        along z, from the facet's plane in double precision; 0 for nothing
    triangle : (H, W) int32         -1 for nothing
    method : "opengl" or "rays"
    """

    facet: np.ndarray
    depth: np.ndarray
    triangle: np.ndarray
    method: str


class NoGraphics(Exception):
    """There is no EGL to draw with."""


# What both methods draw.

@dataclass(frozen=True, eq=False)
class _View:
    """The triangles that can be seen, in drawing order: of two at the same depth the later one wins.

    p : (N, 3, 3) camera frame, the furthest at 1          slope : (N, 3)  1/z = slope . (x, y, 1) on the plane
    low, high : (N,)  bounds of 1/z on the triangle        triangle : (N,) into the model
    unit : m, the length that became 1
    """

    p: np.ndarray
    slope: np.ndarray
    low: np.ndarray
    high: np.ndarray
    triangle: np.ndarray
    unit: float


NEAR = 1e-6                       # of the distance of the furthest vertex; nothing nearer is seen


def _view(model, camera):
    p = camera.points(model.vertices)[model.triangles]
    unit = np.abs(p).max() if p.size else 1.0
    p = p / unit
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    height = np.einsum("ij,ij->i", normal, p.mean(axis=1))                     # < 0: its front faces the camera
    length = np.linalg.norm(normal, axis=1)
    keep = np.flatnonzero((np.abs(height) > 1e-14 * length) & (p[..., 2].max(axis=1) > NEAR))
    order = np.lexsort((model.triangle_facet[keep], height[keep] < 0))
    triangle = keep[order]
    p, z = p[triangle], p[triangle][..., 2]
    low = 1 / z.max(axis=1)
    high = 1 / np.maximum(z.min(axis=1), NEAR)
    return _View(p, normal[triangle] / height[triangle, None], low, high, triangle, unit)


def _buffer(model, camera, view, rank, method):
    """From the rank of the winning triangle at each pixel (-1: none) to facet and depth."""
    rank = _sharpen(model, camera, view, rank)
    seen = rank >= 0
    triangle = np.full(rank.shape, -1, np.int32)
    triangle[seen] = view.triangle[rank[seen]]
    facet = np.full(rank.shape, -1, np.int32)
    facet[seen] = model.triangle_facet[triangle[seen]]
    y, x = np.nonzero(seen)
    v = camera.directions(np.column_stack([x, y]))
    r = rank[seen]
    # A pixel on the rim of a triangle seen edge-on may lie a hair outside, where its plane runs away: hence the bounds.
    inverse = np.clip(np.einsum("ij,ij->i", view.slope[r], v), view.low[r], view.high[r])
    depth = np.zeros(rank.shape)
    depth[seen] = view.unit / inverse
    return IndexBuffer(facet, depth, triangle, method)


def _sharpen(model, camera, view, rank):
    """Decide anew, in double precision, between the triangles that meet at a pixel beside an edge.

    OpenGL moves corners to the next 1/256 px, Embree has floats: a pixel centre that close to an edge may have
    gone to the wrong side. The candidates are the triangles of the pixel and its eight neighbours.
    """
    if len(view.triangle) == 0:
        return rank
    H, W = rank.shape
    facet = np.append(model.triangle_facet[view.triangle], -1)[rank]
    y, x = np.nonzero(boundary(facet))
    v = camera.directions(np.column_stack([x, y]))
    around = np.pad(rank, 1, mode="edge")
    old = rank[y, x]
    best, winner, empty = np.zeros(len(y)), np.full(len(y), -1), np.zeros(len(y), bool)
    candidates = [around[y + 1 + dy, x + 1 + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    reach = []
    for t in candidates:
        empty |= t < 0
        a, b, c = np.moveaxis(view.p[t], 1, 0)
        turn = np.sign(np.einsum("ij,ij->i", view.slope[t], np.cross(b - a, c - a)))
        inside = t >= 0
        for corner, following in ((a, b), (b, c), (c, a)):                     # v . (a x b): on which side of the edge ab
            inside &= np.einsum("ij,ij->i", v, np.cross(corner, following)) * turn >= 0
        inverse = np.clip(np.einsum("ij,ij->i", view.slope[t], v), view.low[t], view.high[t])
        reach.append(np.where(inside, inverse, -1.0))
        best = np.maximum(best, reach[-1])
    for t, inverse in zip(candidates, reach):
        slack = TIE * (np.einsum("ij,ij->i", np.abs(view.slope[t]), np.abs(v)) + best)
        winner = np.maximum(winner, np.where((inverse >= 0) & (inverse >= best - slack), t, -1))
    rank = rank.copy()
    rank[y, x] = np.where((winner < 0) & ~empty, old, winner)                  # none, though nothing empty is near: a crack
    return rank


# OpenGL.

_VERTEX = """
#version 330
in vec4 clip; in vec3 slope; in vec2 bounds; in float rank;
uniform vec4 window;                                     // scale, offset of the part of the picture that is drawn
flat out vec3 f_slope; flat out vec2 f_bounds; flat out float f_rank;
void main() {
    gl_Position = vec4(clip.xy * window.xy + clip.w * window.zw, clip.zw);
    f_slope = slope; f_bounds = bounds; f_rank = rank;
}"""

# First the largest 1/z at every pixel, by blending with MAX into 32-bit floats: a depth buffer has 24 bits.
# Its value comes from the plane of the triangle, not from interpolation, so that clipping cannot disturb it.
_COMMON = """
#version 330
flat in vec3 f_slope; flat in vec2 f_bounds; flat in float f_rank;
uniform vec4 ray;                                        // (x, y) of a pixel's ray at z = 1: ray.xy * gl_FragCoord.xy + ray.zw
out float result;
vec3 direction() { return vec3(ray.xy * gl_FragCoord.xy + ray.zw, 1.0); }
float inverse_depth() { return clamp(dot(f_slope, direction()), f_bounds.x, f_bounds.y); }
"""
_NEAREST = _COMMON + "void main() { result = inverse_depth(); }"
# Then, among those that are as near as that, the triangle of the highest rank.
_WINNER = _COMMON + """
uniform sampler2D nearest;
uniform float tie;
void main() {
    float best = texelFetch(nearest, ivec2(gl_FragCoord.xy), 0).r;
    float slack = tie * (dot(abs(f_slope), abs(direction())) + best);
    if (inverse_depth() < best - slack) discard;
    result = f_rank;
}"""


@functools.lru_cache(maxsize=1)
def _context():
    try:
        import moderngl

        context = moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:                 # no package, no libEGL, no driver: each has its own exception
        raise NoGraphics(" ".join(str(error).split()) or type(error).__name__) from None
    programs = [context.program(vertex_shader=_VERTEX, fragment_shader=shader) for shader in (_NEAREST, _WINNER)]
    return context, programs


def require_graphics():
    """Raises NoGraphics, with the reason, where draw() cannot work."""
    _context()


class _Painter:
    """Draws parts of the picture: ranks of the winning triangles, -1 for none."""

    def __init__(self, view, camera):
        import moderngl

        self.context, self.programs = _context()
        self.camera, self.count = camera, 3 * len(view.triangle)
        if self.count == 0:
            return
        M = frames.clip_from_camera(camera.K, camera.width, camera.height)
        p = view.p / NEAR                                                      # the near plane is at 1
        clip = np.concatenate([p, np.ones((*p.shape[:2], 1))], axis=2) @ M.T
        rank = np.arange(len(p), dtype=float)
        flat = np.column_stack([view.slope, view.low, view.high, rank])
        data = np.concatenate([clip, np.repeat(flat[:, None], 3, axis=1)], axis=2).astype(np.float32)
        self.buffer = self.context.buffer(data.tobytes())
        used = [[name for name in ("clip", "slope", "bounds", "rank") if name in program] for program in self.programs]
        parts = {"clip": "4f", "slope": "3f", "bounds": "2f", "rank": "1f"}
        self.arrays = [self.context.vertex_array(program, [(
            self.buffer, " ".join(parts[name] if name in names else f"{4 * int(parts[name][0])}x" for name in parts), *names)])
            for program, names in zip(self.programs, used)]
        self.mode = moderngl.TRIANGLES
        self.shape, self.targets = None, []

    def paint(self, x0, y0, width, height, finer=1):
        """(height, width) int32 of the window whose corner is the sub-pixel (x0, y0), `finer` sub-pixels to a pixel side."""
        if self.count == 0:
            return np.full((height, width), -1, np.int32)
        gl, camera = self.context, self.camera
        if self.shape != (width, height):
            self._release_targets()
            for _ in range(2):
                texture = gl.texture((width, height), 1, dtype="f4")
                self.targets.append((texture, gl.framebuffer([texture])))
            self.shape = (width, height)
        W, H = camera.width * finer, camera.height * finer
        # ndc of the whole picture -> ndc of the window
        sx, sy = W / width, H / height
        window = (sx, sy, sx - 2 * x0 / width - 1, sy - 2 * y0 / height - 1)
        (dx, dy, _), (ox, oy, _) = (camera.directions(np.array([[1.0, 1.0], [0.0, 0.0]])))
        step = np.array([dx - ox, dy - oy]) / finer
        corner = camera.directions(np.array([[(x0 / finer) - 0.5, (y0 / finer) - 0.5]]))[0, :2]
        gl.disable(gl.DEPTH_TEST | gl.CULL_FACE)
        gl.enable_only(gl.BLEND)
        gl.blend_func = gl.ONE, gl.ONE
        gl.blend_equation = gl.MAX
        (nearest, first), (_, second) = self.targets
        for program, array, target, nothing in zip(self.programs, self.arrays, (first, second), (0.0, -1.0)):
            program["window"], program["ray"] = window, (*step, *corner)
            if "nearest" in program:
                nearest.use(0)
                program["nearest"], program["tie"] = 0, TIE
            target.use()
            target.clear(nothing, nothing, nothing, nothing)
            array.render(self.mode)
        return np.frombuffer(second.read(components=1, dtype="f4"), np.float32).reshape(height, width).astype(np.int32)

    def _release_targets(self):
        for texture, framebuffer in self.targets:
            framebuffer.release()
            texture.release()
        self.targets = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.count:
            self._release_targets()
            for thing in (*self.arrays, self.buffer):
                thing.release()


def draw(model, camera) -> IndexBuffer:
    """The index buffer by OpenGL. Raises NoGraphics where there is no EGL: use reference() there."""
    _context()
    view = _view(model, camera)
    with _Painter(view, camera) as painter:
        rank = np.empty((camera.height, camera.width), np.int32)
        for x0, y0, x1, y1 in _tiles(camera.width, camera.height):
            rank[y0:y1, x0:x1] = painter.paint(x0, y0, x1 - x0, y1 - y0)
    return _buffer(model, camera, view, rank, "opengl")


def _tiles(width, height, widest=8192, pixels=1 << 22):
    columns = min(width, widest)
    rows = max(1, min(height, pixels // columns))
    for y0 in range(0, height, rows):
        for x0 in range(0, width, columns):
            yield x0, y0, min(x0 + columns, width), min(y0 + rows, height)


# Rays.

def _caster(view):
    """Embree on the view's triangles: float32, hence the camera at the origin and the furthest vertex at 1."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    corners = np.ascontiguousarray(view.p.reshape(-1, 3), np.float32)
    scene.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)))
    return scene


def _cast(scene, view, v, plane):
    """Rank of the triangle that each ray (n, 3), z = 1, camera frame, meets first; -1: none. plane : of _shared_planes."""
    import open3d

    rays = np.zeros((len(v), 6), np.float32)
    rays[:, 3:] = v
    rank = scene.cast_rays(open3d.core.Tensor(rays))["primitive_ids"].numpy().view(np.int32).astype(np.int64)
    # Where several facets lie in one plane Embree names any of them: there look at all their triangles, in double precision.
    hit_plane = np.where(rank >= 0, plane[rank], -1)
    order = np.argsort(hit_plane, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(hit_plane[order])) + 1):
        if len(part) and hit_plane[part[0]] >= 0:
            rank[part] = _settle(view, np.flatnonzero(plane == hit_plane[part[0]]), v[part], rank[part])
    return rank


def _settle(view, candidates, v, rank):
    """The highest rank among the triangles `candidates` of one plane that are as near as the nearest, for rays v (n, 3)."""
    best = np.clip(np.einsum("ij,ij->i", view.slope[rank], v), view.low[rank], view.high[rank])
    winner = rank.copy()
    for t in np.sort(candidates):
        of = np.flatnonzero(winner < t)
        a, b, c = view.p[t]
        turn = np.sign(view.slope[t] @ np.cross(b - a, c - a))
        for corner, following in ((a, b), (b, c), (c, a)):         # v . (a x b): on which side of the edge ab the ray passes
            of = of[v[of] @ np.cross(corner, following) * turn >= 0]
        inverse = np.clip(v[of] @ view.slope[t], view.low[t], view.high[t])
        tied = inverse >= best[of] - TIE * (np.abs(v[of]) @ np.abs(view.slope[t]) + best[of])
        winner[of[tied]] = t
    return winner


def _shared_planes(model, view):
    """(N,) int: the number of a plane in which a triangle lies together with those of another facet (either way round), else -1."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used = np.unique(model.triangles)
    low, high = model.vertices[used].min(axis=0), model.vertices[used].max(axis=0)
    middle, size = (low + high) / 2, np.linalg.norm(high - low)
    n = model.facet_normal
    offset = (model.facet_offset - n @ middle) / size
    plane = np.column_stack([n, offset])
    # The same cell in one of five shifted grids: planes closer than a cell's fifth always meet. Both sides count alike.
    cell = 5e-5
    facet = np.arange(len(n))
    left, right = [], []
    for shift in range(5):
        both = np.concatenate([plane, -plane])
        key = np.unique(np.floor(both / cell + shift / 5).astype(np.int64), axis=0, return_inverse=True)[1].reshape(-1)
        first = np.zeros(key.max() + 1, int)
        first[key[::-1]] = np.tile(facet, 2)[::-1]
        left.append(np.tile(facet, 2)), right.append(first[key])
    left, right = np.concatenate(left), np.concatenate(right)
    number = connected_components(coo_matrix((np.ones(len(left), bool), (left, right)), shape=(len(n), len(n))), directed=False)[1]
    number = np.where(np.bincount(number)[number] > 1, number, -1)
    return number[model.triangle_facet[view.triangle]]


def reference(model, camera) -> IndexBuffer:
    """The index buffer by casting rays: the yardstick of draw(), and what runs where there is no EGL."""
    view = _view(model, camera)
    if len(view.triangle) == 0:
        rank = np.full((camera.height, camera.width), -1)
    else:
        v = camera.directions(camera.pixels().reshape(-1, 2))
        rank = _cast(_caster(view), view, v, _shared_planes(model, view)).reshape(camera.height, camera.width)
    return _buffer(model, camera, view, rank, "rays")


# The A-buffer.

def coverage(model, camera, facet, method="opengl"):
    """How much of each pixel every facet covers (Carpenter's A-buffer): 8 x 8 sub-pixels.

    facet : (H, W) int32, -1 for nothing       the index buffer, at the centres
    Returns a dict of arrays, for the pixels that are not wholly of their own facet:
    pixel (P,) flat index y W + x; start (P + 1,); facet (S,), count (S,): pixel i holds count[k] / 64 of
    facet[k] for k from start[i] to start[i + 1]. What is missing from 64 shows nothing.

    `opengl` draws the whole picture 8 times as fine, in tiles: 0.4 s of CPU for 640 x 480. `rays` looks only at
    pixels beside an edge of the index buffer or under the visible edge of a facet (slivers have those too):
    0.1 s, or 1 s where facets lie in each other's planes. They agree but for sub-pixels that an edge just touches.
    """
    view = _view(model, camera)
    n, H, W = SUBPIXELS, camera.height, camera.width
    facet_of_rank = np.append(model.triangle_facet[view.triangle], -1).astype(np.int32)      # [-1] is nothing
    pixels, samples = [np.zeros(0, np.int64)], [np.zeros((0, n * n), np.int32)]
    if method == "opengl":
        with _Painter(view, camera) as painter:
            for x0, y0, x1, y1 in _tiles(W, H, widest=8192 // n, pixels=(1 << 22) // n**2):
                fine = facet_of_rank[painter.paint(n * x0, n * y0, n * (x1 - x0), n * (y1 - y0), finer=n)]
                block = fine.reshape(y1 - y0, n, x1 - x0, n)
                mixed = (block != facet[y0:y1, None, x0:x1, None]).any(axis=(1, 3))
                y, x = np.nonzero(mixed)
                pixels.append((y + y0) * W + x + x0)
                samples.append(block.transpose(0, 2, 1, 3)[y, x].reshape(-1, n * n))
    elif len(view.triangle):
        near = boundary(facet) | (visible_edges(model, camera, facet, facet_depth(model, camera, facet)))
        at = np.flatnonzero(near)
        offsets = (np.arange(n) + 0.5) / n - 0.5
        sub = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
        scene, plane = _caster(view), _shared_planes(model, view)
        for part in np.array_split(at, max(1, len(at) // 20000)):
            q = np.column_stack([part % W, part // W])[:, None] + sub
            values = facet_of_rank[_cast(scene, view, camera.directions(q.reshape(-1, 2)), plane)].reshape(-1, n * n)
            mixed = (values != facet.ravel()[part, None]).any(axis=1)
            pixels.append(part[mixed])
            samples.append(values[mixed])
    pixel, sample = np.concatenate(pixels), np.concatenate(samples)
    order = np.argsort(pixel, kind="stable")
    pixel, sample = pixel[order], np.sort(sample[order], axis=1)
    new = np.ones(sample.shape, bool)
    new[:, 1:] = sample[:, 1:] != sample[:, :-1]
    at = np.flatnonzero(new)
    count = np.diff(np.append(at, sample.size))
    owner, value = at // (n * n), sample.ravel()[at]
    real = value >= 0
    start = np.concatenate([[0], np.cumsum(np.bincount(owner[real], minlength=len(pixel)))])
    return {"pixel": pixel.astype(np.int32), "start": start.astype(np.int32),
            "facet": value[real].astype(np.int32), "count": count[real].astype(np.uint8)}


def facet_depth(model, camera, facet):
    """(H, W) m: the depth of an index buffer that was read from a file, from the planes of its facets; 0 for nothing."""
    n = model.facet_normal @ camera.T_cam_world[:3, :3].T
    height = model.facet_offset - model.facet_normal @ camera.centre
    v = camera.directions(camera.pixels())
    inverse = np.einsum("hwi,hwi->hw", n[facet], v) / np.where(height == 0, 1e-300, height)[facet]
    return np.where((facet >= 0) & (inverse > 0), 1 / np.where(inverse > 0, inverse, 1), 0.0)


# Edges.

def boundary(facet):
    """(H, W) bool: one of the eight neighbours shows another facet."""
    return ~_uniform(facet, 1)


def _uniform(labels, radius):
    """(H, W) bool: the (2 radius + 1)^2 window shows one label only; beyond the picture nothing counts."""
    import cv2

    values = labels.astype(np.float32)                   # exact below 2^24
    window = np.ones((2 * radius + 1, 2 * radius + 1), np.uint8)
    return cv2.erode(values, window) == cv2.dilate(values, window)


def facet_edges(model):
    """(E, 2) vertices: the edges where a facet ends, by position; each facet has its own copy."""
    t = model.triangles
    position = np.unique(model.vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    ends = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    facet = np.tile(model.triangle_facet, 3)
    key = np.column_stack([np.sort(position[ends], axis=1), facet])
    order = np.lexsort(key.T)
    key = key[order]
    same = (key[1:] == key[:-1]).all(axis=1)
    inner = np.concatenate([[False], same]) | np.concatenate([same, [False]])
    return ends[order[~inner]]


def visible_edges(model, camera, facet, depth):
    """The hidden-surface buffer (figure 4.7, middle): (H, W) bool, the pixels that a visible edge of a facet crosses.

    facet, depth : (H, W), the index buffer; slivers thinner than a pixel leave their edges too.
    """
    edges = np.zeros((camera.height, camera.width), bool)
    _, q, seen = _followed_edges(model, camera, facet, depth)
    x, y = _nearest_pixel(camera, q[seen])
    edges[y, x] = True
    return edges


def wireframe(model, camera, facet, depth):
    """(S, 2, 2) px: the visible pieces of the facets' edges, from (x, y) to (x, y); the lines of figure 2.6."""
    owner, q, seen = _followed_edges(model, camera, facet, depth)
    begins = seen & ~np.concatenate([[False], seen[:-1] & (owner[1:] == owner[:-1])]) if len(q) else seen
    ends = seen & ~np.concatenate([seen[1:] & (owner[1:] == owner[:-1]), [False]]) if len(q) else seen
    return np.stack([q[begins], q[ends]], axis=1)


def _nearest_pixel(camera, q):
    x, y = np.floor(q + 0.5).astype(int).T
    return np.clip(x, 0, camera.width - 1), np.clip(y, 0, camera.height - 1)


def clip_to_picture(camera, a, b, near):
    """(begin, end), each (E,): the part of every segment from a to b that lies in the pyramid of the picture, from 0 at a to 1 at b; begin >= end: none.

    a, b : (E, 3), camera frame        near : least z, the same unit
    The pyramid is five half-spaces through the centre and the near plane, all linear in p.
    """
    K, W, H = camera.K, camera.width, camera.height
    sides = np.array([[*(K[0] + [0, 0, 0.5]), 0], [*([0, 0, W - 0.5] - K[0]), 0],
                      [*(K[1] + [0, 0, 0.5]), 0], [*([0, 0, H - 0.5] - K[1]), 0], [0, 0, 1.0, -near]])
    begin, end = np.zeros(len(a)), np.ones(len(a))
    for plane in sides:
        fa, fb = a @ plane[:3] + plane[3], b @ plane[:3] + plane[3]
        with np.errstate(divide="ignore", invalid="ignore"):
            cut = fa / (fa - fb)
        begin = np.where((fa < 0) & (fb >= 0), np.maximum(begin, cut), begin)
        end = np.where((fa >= 0) & (fb < 0), np.minimum(end, cut), end)
        end = np.where((fa < 0) & (fb < 0), -1, end)
    return begin, end


def _followed_edges(model, camera, facet, depth):
    """(owner (N,), q (N, 2) px, seen (N,) bool): every facet edge inside the picture, followed in steps of a quarter of a pixel.

    A point is seen where it is not behind the furthest depth among its pixel and the neighbours.
    """
    K = camera.K
    a, b = np.moveaxis(camera.points(model.vertices)[facet_edges(model)], 1, 0)
    begin, end = clip_to_picture(camera, a, b, NEAR * np.abs(a).max() if len(a) else 1.0)
    inside = begin < end
    a, b, begin, end = a[inside], b[inside], begin[inside, None], end[inside, None]
    a, b = a + begin * (b - a), a + end * (b - a)
    if len(a) == 0:
        return np.zeros(0, int), np.zeros((0, 2)), np.zeros(0, bool)
    w = np.stack([1 / a[:, 2], 1 / b[:, 2]])                                   # linear along the edge in the picture
    qa, qb = (a @ K.T)[:, :2] * w[0, :, None], (b @ K.T)[:, :2] * w[1, :, None]
    steps = np.maximum(1, np.ceil(4 * np.linalg.norm(qb - qa, axis=1)).astype(int)) + 1
    owner = np.repeat(np.arange(len(a)), steps)
    t = (np.arange(len(owner)) - np.repeat(np.cumsum(steps) - steps, steps)) / (steps - 1)[owner]
    q = qa[owner] + t[:, None] * (qb - qa)[owner]
    inverse = w[0][owner] * (1 - t) + w[1][owner] * t
    x, y = _nearest_pixel(camera, q)
    return owner, q, inverse >= _furthest(facet, depth)[y, x] * (1 - 1e-6)


def _furthest(facet, depth):
    """(H, W): the least 1/z that the facets at a pixel and its eight neighbours reach within a pixel of their centres."""
    import cv2

    b = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0)
    least = b.copy()
    for axis in (0, 1):
        here, there = _shifted(axis, 1)
        step = np.where(facet[here] == facet[there], np.abs(b[here] - b[there]), 0)
        slope = np.zeros_like(b)
        slope[here] = step
        np.maximum(slope[there], step, out=slope[there])
        least -= slope
    return cv2.erode(least, np.ones((3, 3), np.uint8))


def _shifted(axis, step):
    """Two views of a picture, `step` pixels apart along an axis."""
    here, there = [slice(None)] * 2, [slice(None)] * 2
    here[axis], there[axis] = slice(None, -step), slice(step, None)
    return tuple(here), tuple(there)


# Trust.

@dataclass(frozen=True, eq=False)
class Trust:
    """mask : (H, W) bool          pixels to be used in the analysis
    edges : (H, W) bool         Canny's edges of the photograph
    left : dict of int          how many pixels each step left
    """

    mask: np.ndarray
    edges: np.ndarray
    left: dict


def trusted(photograph, facet, hidden, facet_group, *, margin_px=2, keep=0.5, edge_noise=12.0, enough=400, window_px=7) -> Trust:
    """Which pixels can be trusted (§4.5): away from edges, neither saturated nor black, and as flat as their facet.

    photograph : Photograph             facet : (H, W) int32, -1 for nothing
    hidden : (H, W) bool                visible edges of facets
    margin_px                           pixels left out on each side of an edge, beyond those that mix two facets
    keep                                the part of each facet's pixels kept: those nearest to a planar approximation
    edge_noise                          an edge of the photograph rises above the noise this many times
    enough                              a group that has fewer pixels gives up its margins, then the choice, step by step

    A pixel is judged by the mean of its surroundings on the same facet (window_px wide), never by its own
    value: noise has a long tail on one side, and to choose pixels by their noise would bias their mean.
    """
    import cv2

    labels = facet + 1
    display, black, white = _display(photograph)
    mixed = boundary(facet) | hidden | (facet < 0)
    left = {"seen": int((facet >= 0).sum())}

    inner = np.where(mixed, 0, labels)
    planes = [*np.moveaxis(display, 2, 0), black, white]
    *mean, black, white = _local_mean(planes, inner, range(1, window_px // 2 + 1))
    mean = np.stack(mean, axis=2)
    clipped = (black > 0) | (white > 0)                               # one black or saturated pixel spoils its surroundings
    if not photograph.linear:
        clipped |= (mean > 0.97).any(axis=2)
    usable = ~mixed & ~clipped
    left["not clipped"] = int((~clipped & (facet >= 0)).sum())
    edges = _canny(display, inner, edge_noise) & ~mixed

    # The margin: as wide as asked where a group can afford it.
    n_facets = len(facet_group)
    at_margin, count = [], []
    for margin in range(margin_px + 1):
        grown = (mixed | edges).astype(np.uint8)
        if margin:
            grown = cv2.dilate(grown, np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
        at_margin.append(usable & (grown == 0))
        count.append(np.bincount(facet[at_margin[-1]], minlength=n_facets))
    margin = np.full(n_facets, margin_px)
    for narrower in range(margin_px - 1, -1, -1):
        group_count = np.bincount(facet_group, count[narrower + 1], int(facet_group.max()) + 1)
        poor = (margin == narrower + 1) & (count[narrower + 1] < enough) & (group_count[facet_group] < 2 * enough)
        margin[poor] = narrower
    mask = np.zeros(facet.shape, bool)
    for m, candidates in enumerate(at_margin):
        mask |= candidates & (margin[facet] == m) & (facet >= 0)
    left["away from edges"] = int(mask.sum())

    mask = _flattest(mean, facet, mask, n_facets, keep, enough // 2)
    left["trusted"] = int(mask.sum())
    return Trust(mask, edges, left)


def _display(photograph):
    """Values as a screen shows them (H, W, C), black (H, W) and saturated (H, W) pixels."""
    values = photograph.values
    if photograph.linear:
        bright = np.percentile(values, 99) if values.size else 1.0
        display = np.clip(values / max(bright, 1e-300), 0, 4) ** (1 / 2.2)
        return display, (values <= 0).all(axis=2), np.zeros(values.shape[:2], bool)
    return values, (values <= 2 / 255 + 1e-9).all(axis=2), (values >= 250 / 255 - 1e-9).any(axis=2)


def _local_mean(planes, labels, steps):
    """Each (H, W) plane averaged over the pixels of the same label at these steps along rows, then along columns."""
    same = {(axis, step): (labels[_shifted(axis, step)[0]] == labels[_shifted(axis, step)[1]]).astype(np.float32)
            for axis in (1, 0) for step in steps if step < labels.shape[axis]}
    total = [np.ones(labels.shape, np.float32), *(np.asarray(plane, np.float32) for plane in planes)]
    for axis in (1, 0):
        for i, source in enumerate(total):
            total[i] = source.copy()
            for step in steps:
                if step < labels.shape[axis]:
                    here, there = _shifted(axis, step)
                    total[i][here] += source[there] * same[axis, step]
                    total[i][there] += source[here] * same[axis, step]
    return [plane / total[0] for plane in total[1:]]


def _canny(display, labels, edge_noise):
    """(H, W) bool: Canny's edges of the photograph inside the facets; between facets the index buffer has them.

    Everything is measured on one facet at a time: the gradient of the smoothed picture less its mean in
    the surroundings (shading changes over many pixels, an edge within few), in standard deviations of
    the facet's noise. That is the median of the second difference, which shading leaves alone.
    """
    import cv2

    planes = [np.ascontiguousarray(plane, np.float32) for plane in np.moveaxis(display, 2, 0)]
    order = np.argsort(labels[1:-1, 1:-1], axis=None, kind="stable")
    sorted_labels = labels[1:-1, 1:-1].ravel()[order]
    ends = np.flatnonzero(np.diff(sorted_labels, prepend=-1, append=-1))
    smooth = _local_mean(_local_mean(planes, labels, (1, 2)), labels, (1,))
    after = 0.06                      # standard deviation of the gradient below for white noise of 1
    strongest = None
    for plane, soft in zip(planes, smooth):
        second = cv2.filter2D(plane, cv2.CV_32F, np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6)
        second = np.abs(second[1:-1, 1:-1].ravel()[order])
        sigma = np.full(int(labels.max()) + 1, 1 / 255, np.float32)            # a step of an 8-bit picture
        for a, b in zip(ends[:-1], ends[1:]):
            sigma[sorted_labels[a]] = max(sigma[sorted_labels[a]], np.median(second[a:b]) / 0.6745)
        gradient = []
        for axis in (1, 0):
            here, there = _shifted(axis, 2)
            middle = tuple(slice(1, -1) if k == axis else slice(None) for k in (0, 1))
            g = np.zeros_like(soft)
            inside = (labels[here] == labels[there]) & (labels[here] == labels[middle])
            g[middle] = np.where(inside, (soft[there] - soft[here]) / 2, 0) if soft.shape[axis] > 2 else 0
            gradient.append(g / (after * sigma[labels]))
        around = _local_mean([np.clip(g, -4 * edge_noise, 4 * edge_noise) for g in gradient], labels, (3, 6))
        gradient = [g - mean for g, mean in zip(gradient, around)]
        size = gradient[0] ** 2 + gradient[1] ** 2
        if strongest is None:
            strongest, best = gradient, size
        else:
            strongest = [np.where(size > best, g, old) for g, old in zip(gradient, strongest)]
            best = np.maximum(best, size)
    gx, gy = (np.clip(16 * g, -30000, 30000).astype(np.int16) for g in strongest)
    return cv2.Canny(gx, gy, 8 * edge_noise, 16 * edge_noise, L2gradient=True) > 0


def _flattest(mean, facet, mask, n_facets, keep, least):
    """Of each facet's pixels in mask, the part `keep` (but at least `least`) nearest to I = a + b x + c y, all channels together."""
    y, x = np.nonzero(mask)
    owner = facet[y, x]
    number = np.bincount(owner, minlength=n_facets)
    safe = np.maximum(number, 1)
    average = lambda v: np.bincount(owner, v, n_facets) / safe
    u, v = x - average(x)[owner], y - average(y)[owner]
    uu, uv, vv = average(u * u), average(u * v), average(v * v)
    ridge = 1e-9 * (uu + vv) + 1e-9                                            # one pixel, one line: no slope across it
    uu, vv = uu + ridge, vv + ridge
    determinant = uu * vv - uv * uv
    error = np.zeros(len(y))
    for channel in range(mean.shape[2]):
        value = mean[y, x, channel].astype(float)
        value -= average(value)[owner]
        p, q = average(u * value), average(v * value)
        b, c = (p * vv - q * uv) / determinant, (q * uu - p * uv) / determinant
        error += (value - b[owner] * u - c[owner] * v) ** 2
    order = np.lexsort((error, owner))
    place = np.arange(len(y)) - np.repeat(np.cumsum(number) - number, number)
    wanted = np.minimum(number, np.maximum(np.ceil(keep * number), least)).astype(int)
    chosen = order[place < wanted[owner[order]]]
    result = np.zeros(mask.shape, bool)
    result[y[chosen], x[chosen]] = True
    return result
