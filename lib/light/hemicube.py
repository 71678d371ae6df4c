"""Form factors by hemicubes (section 3.3; Cohen and Greenberg 1985), drawn by OpenGL.

Half a cube is put over the centre of each patch, and the facets are drawn on its five faces through the Z-buffer.
Every pixel stands for its delta form factor, the exact factor of its square. The patch that it shows is found on the
facet's plane, as for index buffers, so that no cracks open between patches of unlike size.

Simplest and least accurate: a patch is one point, or a few, and a factor is known to a pixel along its outline,
|error| <= length of the outline in pixels * the largest delta form factor, 4 / (pi resolution^2). `make bench`
compares.
"""

from __future__ import annotations

import functools

import numpy as np

from lib.buffers import opengl
from lib.given.rays import shifts, sobol
from lib.given.rays_kernels import OFFSET
from lib.light import hemicube_kernels as kernels
from lib.light.cells_kernels import patch_points
from lib.light.form_factors import FormFactorRows
from lib.light.hemicube_kernels import HemicubePixels
from lib.light.surface import covered, side_normals

NEAR, FAR = 1e-6, 4.0  # in diagonals of the model
ATLAS_PIXELS = 1 << 22  # drawn between two readings

_VERTEX = """
#version 330
in vec3 p; in float facet;
uniform vec3 eye, right, up, forward;
uniform vec2 half_face;      // clip.y = half_face.x y + half_face.y z: all, or the upper half
flat out float f_facet;
void main() {
    vec3 v = p - eye;
    float w = dot(forward, v), y = dot(up, v);
    gl_Position = vec4(dot(right, v), half_face.x * y + half_face.y * w, w - 2.0 * NEAR, w);
    f_facet = facet;
}""".replace("NEAR", f"{NEAR:g}")
# The depth that is compared is linear: 24 bits then tell a board from its wall at any distance.
_FRAGMENT = """
#version 330
flat in float f_facet;
out float result;
void main() { result = f_facet; gl_FragDepth = clamp(1.0 / (gl_FragCoord.w * FAR), 0.0, 1.0); }
""".replace("FAR", f"{FAR:g}")


@functools.lru_cache(maxsize=1)
def _program():
    return opengl.context().program(vertex_shader=_VERTEX, fragment_shader=_FRAGMENT)


def delta_factors(resolution):
    """Factor from the element under the hemicube to each of its pixels.

    Returns the top (R, R), and one side (R // 2, R) from the horizon up. They are exact for the whole pixel, not the
    value at its centre times its area, so that their sum is 1.

    >>> top, side = delta_factors(8)
    >>> round(float(top.sum() + 4 * side.sum()), 12)
    1.0
    """
    x = np.linspace(-1, 1, resolution + 1)
    z = np.linspace(0, 1, resolution // 2 + 1)
    s = np.sqrt(1 + x**2)
    corner = (x[:, None] / s[:, None] * np.arctan(x / s[:, None]) + x / s * np.arctan(x[:, None] / s)) / (2 * np.pi)
    top = np.diff(np.diff(corner, axis=0), axis=1)
    s = np.sqrt(1 + z**2)
    corner = -np.arctan(x / s[:, None]) / (2 * np.pi * s[:, None])
    return top, np.diff(np.diff(corner, axis=0), axis=1)


def _faces(n, x, y):
    """right, up, forward and whether half of it, of the top and the four sides."""
    return [(x, y, n, False), (y, n, x, True), (-x, n, y, True), (-y, n, -x, True), (x, n, -y, True)]


def _pixels(resolution) -> HemicubePixels:
    """In the order in which the faces lie in the atlas."""
    top, side = delta_factors(resolution)
    centre = (np.arange(resolution) + 0.5) * 2 / resolution - 1
    height = (np.arange(resolution // 2) + 0.5) * 2 / resolution
    directions, delta = [], []
    for right, up, forward, half in _faces(*np.eye(3)[[2, 0, 1]]):
        rows = height if half else centre
        d = centre[None, :, None] * right + rows[:, None, None] * up + forward
        directions.append(d.reshape(-1, 3))
        delta.append((side if half else top).ravel())
    return HemicubePixels(np.concatenate(directions), np.concatenate(delta))


def eyes(surface, mesh, points=1):
    """(N, points, 3) local, where the hemicubes of each patch stand; (N,) the share of it that lies outside solids.

    One hemicube stands on the centre. Where the centre lies in a hole or in a solid, it stands on the point nearest to
    the middle of what is left. Several are spread over what lies outside solids.
    """
    n = max(32, 8 * points)
    p = patch_points(n, sobol(n), shifts(len(mesh), n, 0), mesh.pieces, surface.arrays)
    p = np.concatenate([np.asarray(mesh.centre, float)[:, None], p.reshape(-1, n, 3)], axis=1)
    normals = side_normals(surface)[mesh.side]
    up = np.broadcast_to(normals[:, None], p.shape)
    free = ~covered(surface, p.reshape(-1, 3), up.reshape(-1, 3)).reshape(p.shape[:2])
    exposed = free[:, 1:].mean(axis=1)
    rows = np.arange(len(p))[:, None]
    if points == 1:
        left = free[:, 1:, None]
        middle = (p[:, 1:] * left).sum(axis=1) / np.maximum(left.sum(axis=1), 1)
        far = np.linalg.norm(p - middle[:, None], axis=2) + np.where(free, 0.0, np.inf)
        far[:, 0] = np.where(free[:, 0] & _holds(surface, mesh), -1.0, np.inf)
        return p[rows, far.argmin(axis=1)[:, None]], exposed
    first = np.argsort(~free[:, 1:], axis=1, kind="stable")  # the points outside solids, in their order
    take = np.arange(points) % np.maximum(free[:, 1:].sum(axis=1), 1)[:, None]
    return p[rows, 1 + first[rows, take]], exposed


def _holds(surface, mesh):
    """(N,) bool: the centre of the patch lies on it."""
    f = mesh.side // 2
    relative = mesh.centre - surface.origin[f]
    uv = np.stack([np.einsum("ij,ij->i", relative, surface.axes[f, a]) for a in (0, 1)], axis=1)
    t = mesh.tri_uv
    owner = np.repeat(np.arange(len(mesh)), np.diff(mesh.tri_start))
    cross = lambda a, b: a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    turn = np.stack([cross(t[:, (k + 1) % 3] - t[:, k], uv[owner] - t[:, k]) for k in range(3)], axis=1)
    area = cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0])[:, None]
    return np.bincount(owner, (turn * np.sign(area) >= -1e-9 * np.abs(area)).all(axis=1), len(mesh)) > 0


class _Cubes:
    """Draws hemicubes; hands out the facet that each pixel shows, -1 for none, (count, pixels) float32."""

    def __init__(self, surface, resolution):
        try:
            self.gl, self.program = opengl.context(), _program()
        except opengl.NoGraphics as error:
            raise opengl.NoGraphics(f"no EGL to draw hemicubes with ({error}); use rays") from None
        R = self.resolution = resolution
        self.count = max(1, min(ATLAS_PIXELS // (3 * R * R), 8192 // R))
        facet = np.repeat(surface.facet, 3)[:, None]
        self.buffer = self.gl.buffer(np.hstack([surface.cast.reshape(-1, 3), facet]).astype(np.float32).tobytes())
        self.array = self.gl.vertex_array(self.program, [(self.buffer, "3f 1f", "p", "facet")])
        # a row of the atlas is one hemicube: the top, then two times two half faces
        size = (3 * R, self.count * R)
        self.colour, self.depth = self.gl.texture(size, 1, dtype="f4"), self.gl.depth_texture(size)
        self.target = self.gl.framebuffer([self.colour], self.depth)

    def draw(self, eye, frames):
        """(k, pixels).  eye : (k, 3);  frames : (k, 3, 3) the axes x, y and the normal;  k at most self.count"""
        gl, program, R = self.gl, self.program, self.resolution
        gl.enable_only(gl.DEPTH_TEST)
        self.target.use()
        self.target.clear(-1.0, -1.0, -1.0, -1.0, depth=1.0)
        for k, (o, (x, y, n)) in enumerate(zip(eye, frames, strict=True)):
            program["eye"] = tuple(o)
            for face, (right, up, forward, half) in enumerate(_faces(n, x, y)):
                if half:
                    self.target.viewport = (R + R * ((face - 1) // 2), k * R + (R // 2) * ((face - 1) % 2), R, R // 2)
                else:
                    self.target.viewport = (0, k * R, R, R)
                program["right"], program["up"], program["forward"] = tuple(right), tuple(up), tuple(forward)
                program["half_face"] = (2.0, -1.0) if half else (1.0, 0.0)
                self.array.render()
        shown = np.frombuffer(
            self.target.read(viewport=(0, 0, 3 * R, len(eye) * R), components=1, dtype="f4"), np.float32
        )
        shown = shown.reshape(len(eye), R, 3 * R)
        parts = [shown[:, :, :R].reshape(len(eye), -1)]
        for face in range(4):
            a, b = R + R * (face // 2), (R // 2) * (face % 2)
            parts.append(shown[:, b : b + R // 2, a : a + R].reshape(len(eye), -1))
        return np.concatenate(parts, axis=1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for thing in (self.target, self.colour, self.depth, self.array, self.buffer):
            thing.release()


def rows(surface, mesh, *, resolution=128, points=1) -> FormFactorRows:
    """F between all patches from hemicubes `resolution` pixels wide (even), on so many points of each patch.

    A patch that lies wholly in a solid sees nothing. Raises opengl.NoGraphics, in one line, where there is no EGL.
    """
    if resolution < 2 or resolution % 2:
        raise ValueError(f"hemicube: a resolution of {resolution} is not an even number of pixels")
    if points < 1:
        raise ValueError(f"hemicube: {points} points are too few")
    pixels = _pixels(resolution)
    normals = side_normals(surface)[mesh.side]
    frames = np.concatenate([surface.axes[mesh.side // 2], normals[:, None]], axis=1)
    eye, exposed = eyes(surface, mesh, points)
    eye = eye + OFFSET * normals[:, None]
    parts = []
    with _Cubes(surface, resolution) as cubes:
        step = max(1, cubes.count // points)
        for a in range(0, len(mesh), step):
            some = slice(a, a + step)
            e, f = eye[some].reshape(-1, 3), np.repeat(frames[some], points, axis=0)
            shown = np.concatenate(
                [cubes.draw(e[k : k + cubes.count], f[k : k + cubes.count]) for k in range(0, len(e), cubes.count)]
            )
            binned = kernels.binned(shown, e, f, points, pixels, surface.arrays, mesh.table, len(mesh))
            parts.append(_sparse(*binned, exposed[some]))
    entries, indices, count, valid, lost = (np.concatenate(part) for part in zip(*parts, strict=True))
    # Counted in pixels of mean weight. The points are few and known: there are no halves to compare, both are alike.
    n = float(len(pixels.delta) * points)
    share = np.where(valid > 0, exposed, 0)
    count = count * n * np.repeat(share, entries)
    valid = valid * n * share
    return FormFactorRows(
        indptr=np.concatenate([[0], np.cumsum(entries)]).astype(np.int64),
        indices=indices.astype(np.int32),
        count=count.astype(np.float32),
        half=(count / 2).astype(np.float32),
        valid=valid.astype(np.float32),
        valid_half=(valid / 2).astype(np.float32),
        shot=np.full(len(mesh), len(pixels.delta) * points),
        lost=(lost * n * share).astype(np.float32),
        columns=len(mesh),
    )


def _sparse(F, inside, nowhere, exposed):
    """entries (k,), indices and count (nnz,), valid and lost (k,) of FormFactorRows, as shares of all pixels.

    F, inside, nowhere : of kernels.binned;  exposed : (k,)
    """
    blind = (inside > 0.5) | (exposed == 0)  # a point is in a solid or it is not; the rest is rounding at its edges
    F[blind], nowhere[blind] = 0, 0
    at = np.nonzero(F)
    return np.bincount(at[0], minlength=len(F)), at[1], F[at], 1 - np.where(blind, 1, inside), nowhere
