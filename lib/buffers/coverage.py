"""The A-buffer (section 3.2.2): which facets share a mixed pixel, and how much of it each covers."""

import numpy as np

from lib.buffers.cast import cast, caster, shared_planes
from lib.buffers.edges import boundary, visible_edges
from lib.buffers.index_buffer import facet_depth
from lib.buffers.opengl import Painter, tiles
from lib.buffers.viewport import viewport_of

SUBPIXELS = 8  # the A-buffer's fragments: 8 x 8 to a pixel


def coverage(model, camera, facet, method="opengl") -> dict[str, np.ndarray]:
    """How much of each pixel every facet covers (Carpenter's A-buffer): 8 x 8 sub-pixels.

    facet : (H, W) int32, -1 for nothing       the index buffer, at the centres
    method : `opengl` draws the whole picture 8 times as fine, in tiles: 0.4 s of CPU for 640 x 480. `rays` looks only
        at pixels beside an edge of the index buffer or under the visible edge of a facet (slivers have those too):
        0.1 s, or 1 s where facets lie in each other's planes. They agree but for sub-pixels that an edge just touches.

    Returns arrays for the P pixels that are not wholly of their own facet: pixel (P,) flat index y W + x; start
    (P + 1,); facet (S,), count (S,): pixel i holds count[k] / 64 of facet[k] for k from start[i] to start[i + 1]. What
    is missing from 64 shows nothing.
    """
    view = viewport_of(model, camera)
    facet_of_rank = np.append(model.triangle_facet[view.triangle], -1).astype(np.int32)  # [-1] is nothing
    pixels, samples = [np.zeros(0, np.int64)], [np.zeros((0, SUBPIXELS**2), np.int32)]
    mixed_pixels = _drawn if method == "opengl" else _cast
    for pixel, sample in mixed_pixels(model, camera, view, facet_of_rank, facet):
        pixels.append(pixel)
        samples.append(sample)
    return _counted(np.concatenate(pixels), np.concatenate(samples))


def _drawn(model, camera, view, facet_of_rank, facet):
    """Yields ((p,) pixels that are mixed, (p, 64) facets of their sub-pixels), by OpenGL."""
    n, H, W = SUBPIXELS, camera.height, camera.width
    with Painter(view, camera) as painter:
        for x0, y0, x1, y1 in tiles(W, H, widest=8192 // n, pixels=(1 << 22) // n**2):
            fine = facet_of_rank[painter.paint(n * x0, n * y0, n * (x1 - x0), n * (y1 - y0), finer=n)]
            block = fine.reshape(y1 - y0, n, x1 - x0, n)
            mixed = (block != facet[y0:y1, None, x0:x1, None]).any(axis=(1, 3))
            y, x = np.nonzero(mixed)
            yield (y + y0) * W + x + x0, block.transpose(0, 2, 1, 3)[y, x].reshape(-1, n * n)


def _cast(model, camera, view, facet_of_rank, facet):
    """The same by rays, through pixels beside an edge."""
    if len(view.triangle) == 0:
        return
    n, W = SUBPIXELS, camera.width
    near = boundary(facet) | visible_edges(model, camera, facet, facet_depth(model, camera, facet))
    at = np.flatnonzero(near)
    offsets = (np.arange(n) + 0.5) / n - 0.5
    sub = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    scene, plane = caster(view), shared_planes(model, view)
    for part in np.array_split(at, max(1, len(at) // 20000)):
        q = np.column_stack([part % W, part // W])[:, None] + sub
        values = facet_of_rank[cast(scene, view, camera.directions(q.reshape(-1, 2)), plane)].reshape(-1, n * n)
        mixed = (values != facet.ravel()[part, None]).any(axis=1)
        yield part[mixed], values[mixed]


def _counted(pixel, sample):
    """The arrays that `coverage` returns, of pixels (P,) and the facets of their sub-pixels (P, 64); -1: nothing."""
    order = np.argsort(pixel, kind="stable")
    pixel, sample = pixel[order], np.sort(sample[order], axis=1)
    new = np.ones(sample.shape, bool)
    new[:, 1:] = sample[:, 1:] != sample[:, :-1]
    at = np.flatnonzero(new)
    count = np.diff(np.append(at, sample.size))
    owner, value = at // SUBPIXELS**2, sample.ravel()[at]
    real = value >= 0
    start = np.concatenate([[0], np.cumsum(np.bincount(owner[real], minlength=len(pixel)))])
    return {
        "pixel": pixel.astype(np.int32),
        "start": start.astype(np.int32),
        "facet": value[real].astype(np.int32),
        "count": count[real].astype(np.uint8),
    }
