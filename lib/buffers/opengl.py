"""Index buffers by OpenGL, without a display: EGL, and a painter of facets in floating-point depth."""

import functools

import numpy as np

from lib.buffers.viewport import NEAR, TIE
from lib.given import frames


class NoGraphics(RuntimeError):
    """There is no EGL to draw with."""


# ---- shaders ----

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
uniform vec4 ray;              // (x, y) of a pixel's ray at z = 1: ray.xy * gl_FragCoord.xy + ray.zw
out float result;
vec3 direction() { return vec3(ray.xy * gl_FragCoord.xy + ray.zw, 1.0); }
float inverse_depth() { return clamp(dot(f_slope, direction()), f_bounds.x, f_bounds.y); }
"""
_NEAREST = _COMMON + "void main() { result = inverse_depth(); }"
# Then, among those that are as near as that, the triangle of the highest rank.
_WINNER = (
    _COMMON
    + """
uniform sampler2D nearest;
uniform float tie;
void main() {
    float best = texelFetch(nearest, ivec2(gl_FragCoord.xy), 0).r;
    float slack = tie * (dot(abs(f_slope), abs(direction())) + best);
    if (inverse_depth() < best - slack) discard;
    result = f_rank;
}"""
)

_PARTS = {"clip": "4f", "slope": "3f", "bounds": "2f", "rank": "1f"}  # of a vertex: attribute -> floats


@functools.lru_cache(maxsize=1)
def context():
    """The one moderngl context of this process.  Raises NoGraphics.

    A second one would be current from then on: what is drawn with the programs of the first would be garbage.
    """
    try:
        import moderngl

        return moderngl.create_context(standalone=True, backend="egl", require=330)
    except Exception as error:  # no package, no libEGL, no driver: each has its own exception
        raise NoGraphics(" ".join(str(error).split()) or type(error).__name__) from None


@functools.lru_cache(maxsize=1)
def _programs():
    """The programs of the two passes."""
    return [context().program(vertex_shader=_VERTEX, fragment_shader=shader) for shader in (_NEAREST, _WINNER)]


def require_graphics():
    """Raises NoGraphics, with the reason, where draw() cannot work."""
    _programs()


class Painter:
    """Draws parts of the picture: ranks of the winning triangles, -1 for none."""

    def __init__(self, view, camera):
        import moderngl

        self.context, self.programs = context(), _programs()
        self.camera, self.count = camera, 3 * len(view.triangle)
        if self.count == 0:
            return
        M = frames.clip_from_camera(camera.K, camera.width, camera.height)
        p = view.p / NEAR  # the near plane is at 1
        clip = np.concatenate([p, np.ones((*p.shape[:2], 1))], axis=2) @ M.T
        rank = np.arange(len(p), dtype=float)
        flat = np.column_stack([view.slope, view.low, view.high, rank])
        data = np.concatenate([clip, np.repeat(flat[:, None], 3, axis=1)], axis=2).astype(np.float32)
        self.buffer = self.context.buffer(data.tobytes())
        self.arrays = [self._vertex_array(program) for program in self.programs]
        self.mode = moderngl.TRIANGLES
        self.shape, self.targets = None, []

    def _vertex_array(self, program):
        """The buffer as one program sees it: attributes that it does not use are skipped (x)."""
        used = [name for name in _PARTS if name in program]
        layout = " ".join(part if name in used else f"{4 * int(part[0])}x" for name, part in _PARTS.items())
        return self.context.vertex_array(program, [(self.buffer, layout, *used)])

    def paint(self, x0, y0, width, height, finer=1) -> np.ndarray:
        """(height, width) int32: the ranks in a window whose corner is the sub-pixel (x0, y0).

        finer : sub-pixels to a pixel side
        """
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
        (dx, dy, _), (ox, oy, _) = camera.directions(np.array([[1.0, 1.0], [0.0, 0.0]]))
        step = np.array([dx - ox, dy - oy]) / finer
        corner = camera.directions(np.array([[x0 / finer - 0.5, y0 / finer - 0.5]]))[0, :2]
        gl.disable(gl.DEPTH_TEST | gl.CULL_FACE)
        gl.enable_only(gl.BLEND)
        gl.blend_func = gl.ONE, gl.ONE
        gl.blend_equation = gl.MAX
        (nearest, first), (_, second) = self.targets
        passes = zip(self.programs, self.arrays, (first, second), (0.0, -1.0), strict=True)
        for program, array, target, nothing in passes:
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


def tiles(width, height, widest=8192, pixels=1 << 22):
    """Yields x0, y0, x1, y1 of windows that cover a picture, each `widest` px wide and of about `pixels` px at most."""
    columns = min(width, widest)
    rows = max(1, min(height, pixels // columns))
    for y0 in range(0, height, rows):
        for x0 in range(0, width, columns):
            yield x0, y0, min(x0 + columns, width), min(y0 + rows, height)
