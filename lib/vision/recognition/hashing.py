"""The model's facets as a database, and which of them a reconstructed facet may be.

The paper hashes facets by size, shape, angle and distance. There is no hash table here. Size is a bound (what is seen
is no larger than the facet), angle and distance are the boxes of places that branch and bound searches (search.py),
and nothing asks for the shape: most regions are parts of facets.
"""

from dataclasses import dataclass

import numpy as np

from lib.given import rays
from lib.vision.facets_file import SceneFacets
from lib.vision.recognition import hashing_kernels as kernels

# The model's facets, as the search needs them.


@dataclass(frozen=True, eq=False)
class Database:
    """The model's F facets, relative to `centre`."""

    model: object  # lib.given.model.Model
    centre: np.ndarray  # (3,) m, world
    size: np.ndarray  # (3,) m of the model's box
    axes: np.ndarray  # (F, 3, 3) normal, two in-plane
    low: np.ndarray  # (F, 3) m, extents along the axes
    high: np.ndarray  # (F, 3) m
    rim: np.ndarray  # (R,) vertices on the rims of facets
    rim_facet: np.ndarray  # (R,) of which, ascending
    caster: rays.Caster
    local: rays.Local
    twosided: np.ndarray  # (F,) bool: its back can be seen

    def corners(self, facet):
        """(k, 3) m: of the facet's outline."""
        first, last = np.searchsorted(self.rim_facet, [facet, facet + 1])
        return self.model.vertices[np.unique(self.rim[first:last])] - self.centre


def database(model) -> Database:
    """The model's facets with axes, extents and rims. model : lib.given.model.Model"""
    used = model.vertices[np.unique(model.triangles)]
    centre, size = (used.min(axis=0) + used.max(axis=0)) / 2, np.ptp(used, axis=0)
    p = model.vertices - centre
    ends, facet, rim = _edges(model)
    axes = _axes(model, p, ends, facet, rim)
    order = np.argsort(facet, kind="stable")
    along = np.einsum("nai,ni->na", axes[facet[order]], p[ends[order, 0]])
    start = np.searchsorted(facet[order], np.arange(model.n_facets))
    low, high = np.minimum.reduceat(along, start), np.maximum.reduceat(along, start)
    low[:, 0] = high[:, 0] = (low[:, 0] + high[:, 0]) / 2
    rim = rim[np.argsort(facet[rim], kind="stable")]
    local = rays.Local.of(model)
    return Database(
        model,
        centre,
        size,
        axes,
        low,
        high,
        ends[rim, 0],
        facet[rim],
        rays.Caster(local.points(model.corners())),
        local,
        ~model.closed_objects[model.facet_object] | _inward(model),
    )


def _edges(model):
    """Edges of triangles: their ends (E, 2), their facets (E,), and which are on a rim: those that a facet has once."""
    t = model.triangles
    ends, facet = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), np.tile(model.triangle_facet, 3)
    position = np.unique(model.vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    key = np.column_stack([np.sort(position[ends], axis=1), facet])
    order = np.lexsort(key.T)
    same = (key[order][1:] == key[order][:-1]).all(axis=1)
    return ends, facet, order[~(np.concatenate([[False], same]) | np.concatenate([same, [False]]))]


def _axes(model, p, ends, facet, rim):
    """(F, 3, 3) of each facet: its normal, the direction of the longest edge on its rim, and across both."""
    v = p[ends[:, 1]] - p[ends[:, 0]]
    length = np.linalg.norm(v, axis=1)
    longest = np.zeros(model.n_facets, int)
    for chosen in (np.arange(len(ends)), rim):  # a facet without a rim (closed on itself) takes any edge
        by_length = chosen[np.argsort(length[chosen], kind="stable")]
        longest[facet[by_length]] = by_length
    n = model.facet_normal
    u = v[longest] - n * np.einsum("ij,ij->i", v[longest], n)[:, None]
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return np.stack([n, u, np.cross(n, u)], axis=1)


def _inward(model):
    """(F,) bool: facets of closed objects that face inwards (rooms). From outside their backs are seen.

    To allow that costs little.
    """
    corners = model.corners()
    edges = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    signed = np.einsum("ij,ij->i", corners[:, 0] - model.vertices.mean(axis=0), edges)
    volume = np.bincount(model.facet_object[model.triangle_facet], signed, len(model.objects))
    return volume[model.facet_object] < 0


# What the search knows of each scene facet.


@dataclass(frozen=True, eq=False)
class Seen:
    """N scene facets, in units of the facets, left frame; sigmas are those of the covariance."""

    n: np.ndarray  # (N, 3) normals, towards the camera
    g: np.ndarray  # (N, 3) middle of the outline
    angle: np.ndarray  # (N,) rad, sigma of the normal
    height: np.ndarray  # (N,) sigma of the plane at g
    slide: np.ndarray  # (N,) sigma of g within the plane
    extent: np.ndarray  # (N, 2) of the outline, short and long
    outline: list  # (k, 3)
    v: list  # (k, 3) rays through the region, z = 1
    inverse: list  # (k,) 1/z there
    sigma: list  # (k,) of it
    m: np.ndarray  # (N, 3)
    covariance: np.ndarray  # (N, 3, 3) of m
    pivot: np.ndarray  # (3,) the middle of all facets
    radius: float  # how far away they are


SYSTEMATIC = 0.002  # of 1/z: regions are not exactly what a facet shows; no covariance knows that
RASTER = 40  # cells across an outline, of which the rays are chosen


def seen_facets(scene: SceneFacets, camera, samples=24) -> Seen:
    """What the search knows. camera : gives the focal length, which says what a pixel is worth; samples : rays each"""
    n, d = scene.normal, scene.distance
    covariance = scene.covariance + (SYSTEMATIC / d)[:, None, None] ** 2 * np.eye(3)
    directions, inverse, sigma, g = [], [], [], []
    for polygon, m, C in zip(scene.polygons, scene.m, covariance, strict=True):
        v = _rays_through(polygon, samples)
        b = v @ m
        v, b = v[b > 0], b[b > 0]
        directions.append(v)
        inverse.append(b)
        sigma.append(np.sqrt(np.einsum("ij,jk,ik->i", v, C, v)))
        g.append((v / b[:, None]).mean(axis=0) if len(v) else polygon.mean(axis=0))
    g = np.array(g).reshape(-1, 3)
    P = np.eye(3) - n[:, :, None] * n[:, None, :]
    angle = d * np.sqrt(np.linalg.eigvalsh(P @ covariance @ P)[:, -1]) if len(g) else np.zeros(0)
    height = d * np.sqrt(np.einsum("ni,nij,nj->n", g, covariance, g))
    cosine = np.abs(np.einsum("ni,ni->n", n, g)) / np.linalg.norm(g, axis=1)
    slide = height * np.sqrt(1 - np.minimum(cosine, 1) ** 2) / np.maximum(cosine, 0.05) + 2 * g[:, 2] / camera.K[0, 0]
    return Seen(
        n=n,
        g=g,
        angle=angle,
        height=height,
        slide=slide,
        extent=_extents(scene.polygons, n),
        outline=scene.polygons,
        v=directions,
        inverse=inverse,
        sigma=sigma,
        m=scene.m,
        covariance=covariance,
        pivot=np.median(g, axis=0) if len(g) else np.zeros(3),
        radius=float(np.median(np.linalg.norm(g, axis=1))) if len(g) else 1.0,
    )


def _rays_through(polygon, samples):
    """(k, 3) directions, z = 1, k <= samples, spread over a polygon (n, 3), away from its rim where there is room."""
    import cv2

    z = np.maximum(polygon[:, 2], 1e-3 * np.abs(polygon).max())
    q = polygon[:, :2] / z[:, None]  # at z = 1
    low, high = q.min(axis=0), q.max(axis=0)
    step = max((high - low).max() / RASTER, 1e-12)
    mask = np.zeros((RASTER + 3, RASTER + 3), np.uint8)
    cv2.fillPoly(mask, [np.rint(8 * ((q - low) / step + 1)).astype(np.int32)], 1, shift=3)
    inner = mask
    for _ in range(3):
        smaller = cv2.erode(inner, np.ones((3, 3), np.uint8), borderValue=0)
        if smaller.sum() < samples:
            break
        inner = smaller
    y, x = np.nonzero(inner if inner.any() else mask)
    if len(x) == 0:
        x, y = np.array([1.0]), np.array([1.0])
    keep = np.unique(np.linspace(0, len(x) - 1, samples).astype(int))
    return np.column_stack([low[0] + (x[keep] - 1) * step, low[1] + (y[keep] - 1) * step, np.ones(len(keep))])


def _extents(polygons, n):
    """(N, 2): sides of the smallest rectangle around each polygon within its plane, short and long. n : (N, 3)"""
    import cv2

    extent = np.zeros((len(polygons), 2))
    for i, polygon in enumerate(polygons):
        u = np.cross(n[i], np.eye(3)[np.argmin(np.abs(n[i]))])
        u /= np.linalg.norm(u)
        flat = np.column_stack([polygon @ u, polygon @ np.cross(n[i], u)]).astype(np.float32)
        extent[i] = sorted(cv2.minAreaRect(flat - flat.mean(axis=0))[1])
    return extent


# Positions: what each correspondence asks of them.


def correspondences(seen, db, R, sigma, large, size_ok):
    """kernels.Correspondences at one rotation, or None where no normals agree.

    R : (3, 3) world to camera; sigma : rad, of it; large : (L,) facets of the model that are large enough for some
    size_ok : (N, L) bool, for which
    """
    lever = np.linalg.norm(seen.g - seen.pivot, axis=1)
    scene = kernels.SceneSide(
        n=seen.n @ R,
        gate=np.cos(np.minimum(3.5 * np.hypot(seen.angle, sigma) + 0.01, 0.6)),
        outline=(np.concatenate(seen.outline) - seen.pivot) @ R,
        start=np.cumsum([0, *(len(outline) for outline in seen.outline)]),
        g=(seen.g - seen.pivot) @ R,
        tall=3 * np.hypot(seen.height, sigma * lever),
        wide=3 * np.hypot(seen.slide, sigma * lever),
    )
    model = kernels.ModelSide(db.axes[large], db.low[large], db.high[large], db.twosided[large])
    made = kernels.fill(scene, model, size_ok)
    return made._replace(facet=large[made.facet]) if len(made.scene) else None


def distinct_planes(db, facets):
    """How many planes these facets of the model lie on."""
    planes = []
    for f in facets:
        if not any(_one_plane(db, f, g) for g in planes):
            planes.append(f)
    return len(planes)


def _one_plane(db, f, g):
    """Do two facets lie on one plane, to 2.5 degrees and 1 cm?"""
    cosine = db.axes[f, 0] @ db.axes[g, 0]
    return abs(cosine) > 0.999 and abs(db.low[f, 0] - np.sign(cosine) * db.low[g, 0]) < 0.01
