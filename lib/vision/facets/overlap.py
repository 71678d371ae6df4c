"""§2.3 as printed: the plane that mirrors the left region exactly on the right one, and conversely.

The overlap of two regions of whole pixels is maximised in the plane's three parameters. It is kept to compare with:
the borders' places to a part of a pixel say more (docs/decisions/overlap.md).
"""

from dataclasses import replace

import numpy as np

from lib.vision.facets import contours_kernels, overlap_kernels
from lib.vision.facets.contours import LEAST_POINTS, Measured, measured_at
from lib.vision.facets.contours_kernels import RESIDUAL, SIGMA, WEIGHT, Border
from lib.vision.facets.overlap_kernels import Carried
from lib.vision.matching import RegionArrays, ViewArrays

REACH_PX = (2.0, 0.5)  # of the simplex, and of the one that starts again where it ended
WHOLE_PX = np.sqrt(2 / 12)  # sigma between two borders known to whole pixels: of points, and of whole upright sides
MEET_PX = 1.5  # borders that lie farther apart do not tell how well the plane is known


def overlap_plane(regions, views, l: int, r: int, starts, uv0, f_px: float, size: float, steps: int):
    """(plane, overlap): the best maximum from some planes (a, b, c) at uv0.

    regions, views : of the left and of the right picture;  l, r : labels;  steps : of each simplex, at most
    """
    left = carried(regions[0], views[0], views[1], l, r, uv0)
    right = carried(regions[1], views[1], views[0], r, l, uv0)
    best = np.asarray(starts[0], float), -1.0
    for plane in starts:
        for reach in REACH_PX:
            plane, value = overlap_kernels.maximise(plane, uv0, size, reach, steps, left, right, f_px)
        best = max(best, (plane, value), key=lambda x: x[1])
    return best


def carried(regions: RegionArrays, here: ViewArrays, there: ViewArrays, label, wanted, uv0):
    """The pixels of one region, to be carried into another picture and compared with its region `wanted`."""
    pixels = regions.order[regions.first[label - 1] : regions.first[label]]
    du, dv = here.u.ravel()[pixels] - uv0[0], here.v.ravel()[pixels] - uv0[1]
    known = np.isfinite(du)
    return Carried(du[known], dv[known], there.labels, wanted, there.R, there.K)


def measured(plane, uv0, size, left: Border, right: Border, part) -> Measured | None:
    """How well the plane of maximal overlap is known; None where the borders do not meet.

    The borders that are left when their own plane is taken away show how far sides are off. The plane stays as it is.

    part : (n,) side of the outline of each left point
    """
    rows = np.empty((len(left.uv), contours_kernels.COLUMNS))
    rows = rows[: contours_kernels.contour_rows(plane, uv0, MEET_PX, 1.0, left, part, right, rows)]
    rows = rows[rows[:, WEIGHT] > 0.1]
    if len(rows) < LEAST_POINTS:
        return None
    coarser = rows[:, SIGMA] / np.hypot(rows[:, SIGMA], WHOLE_PX)
    rows[:, [0, 1, 2, RESIDUAL]] *= coarser[:, None]
    rows[:, SIGMA] /= coarser
    A = rows[:, :3] / [size, size, 1]
    w = np.sqrt(rows[:, WEIGHT])
    rows[:, RESIDUAL] -= A @ np.linalg.lstsq(A * w[:, None], rows[:, RESIDUAL] * w, rcond=1e-9)[0]
    x = measured_at(plane, uv0, size, rows, int(part.max()) + 1)
    return replace(x, b=np.zeros(3), D=np.zeros_like(x.D))
