"""The model's facets as a database, and which of them a reconstructed facet may be."""

from dataclasses import dataclass

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.vision.recognition import hashing_kernels as kernels

# Facets of the scene.


@dataclass(frozen=True, eq=False)
class SceneFacets:
    """m : (N, 3) 1/unit               m . x = 1 on the plane, left frame
    covariance : (N, 3, 3)         of m
    polygons : list of (k, 3)      outlines of what was seen, on the planes
    labels : (N, 2) int            regions, left and right
    unit : "m" or "baseline"
    """

    m: np.ndarray
    covariance: np.ndarray
    polygons: list
    labels: np.ndarray
    unit: str = "m"

    def __len__(self):
        return len(self.m)

    @property
    def normal(self):
        """(N, 3) unit, towards the camera: n . x = d with d <= 0."""
        return -self.m / np.linalg.norm(self.m, axis=1, keepdims=True)

    @property
    def distance(self):
        """(N,) unit: of the planes from the camera."""
        return 1 / np.linalg.norm(self.m, axis=1)


def read_facets(path) -> SceneFacets:
    """facets.json (data/SCENE.md, section 4), checked."""
    content = artefact.read_json(path)
    if not isinstance(content, dict) or not isinstance(content.get("facets"), list):
        raise BadInput(f"{path}: facets: a list is needed")
    for key, allowed in (("frame", ("left",)), ("unit", ("m", "baseline"))):
        if content.get(key) not in allowed:
            raise BadInput(f"{path}: {key}: {content.get(key)!r} is not {' or '.join(allowed)}")
    m, covariance, polygons, labels = [], [], [], []
    for i, facet in enumerate(content["facets"]):
        where = f"{path}: facets: {i}"

        def numbers(value, name, shape):
            try:
                array = np.array(value, float)
            except (TypeError, ValueError):
                raise BadInput(f"{where}: {name}: {value!r:.60} are not numbers") from None
            if (
                array.ndim != len(shape)
                or any(s and s != n for s, n in zip(shape, array.shape))
                or not np.isfinite(array).all()
            ):
                raise BadInput(f"{where}: {name}: finite numbers of shape {shape} are needed, got {value!r:.60}")
            return array

        if not isinstance(facet, dict) or not isinstance(facet.get("plane"), dict):
            raise BadInput(f"{where}: plane: is missing")
        n, d = numbers(facet["plane"].get("n"), "plane.n", (3,)), float(numbers(facet["plane"].get("d"), "plane.d", ()))
        if abs(np.linalg.norm(n) - 1) > 1e-3 or d >= 0:
            raise BadInput(
                f"{where}: plane: a unit normal towards the camera and d < 0 are needed, got |n| = {np.linalg.norm(n):.4g}, d = {d:g}"
            )
        spread = numbers(facet.get("covariance"), "covariance", (3, 3))
        if np.linalg.eigvalsh((spread + spread.T) / 2)[0] < -1e-6 * max(abs(np.trace(spread)), 1e-300):
            raise BadInput(f"{where}: covariance: has a negative eigenvalue")
        polygon = numbers(facet.get("polygon"), "polygon", (0, 3))
        if len(polygon) < 3:
            raise BadInput(f"{where}: polygon: {len(polygon)} corners instead of at least 3")
        m.append(n / d), covariance.append((spread + spread.T) / 2), polygons.append(polygon)
        labels.append([int(facet.get("left_label", 0) or 0), int(facet.get("right_label", 0) or 0)])
    return SceneFacets(
        np.array(m, float).reshape(-1, 3),
        np.array(covariance, float).reshape(-1, 3, 3),
        polygons,
        np.array(labels, int).reshape(-1, 2),
        content["unit"],
    )


# The model's facets, as the search needs them.


@dataclass(frozen=True, eq=False)
class Database:
    """F facets, relative to `centre` (m, world). axes : (F, 3, 3) normal, two in-plane; low, high : (F, 3) extents along them."""

    model: object
    centre: np.ndarray
    size: np.ndarray  # (3,) m of the model's box
    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rim: np.ndarray  # (R,) vertices on the rims of facets
    rim_facet: np.ndarray  # (R,) of which, ascending
    caster: object
    local: object
    twosided: np.ndarray  # (F,) bool: its back can be seen

    def corners(self, facet):
        """(k, 3) m: of the facet's outline."""
        first, last = np.searchsorted(self.rim_facet, [facet, facet + 1])
        return self.model.vertices[np.unique(self.rim[first:last])] - self.centre


def database(model) -> Database:
    from lib.given import rays

    used = model.vertices[np.unique(model.triangles)]
    centre, size = (used.min(axis=0) + used.max(axis=0)) / 2, np.ptp(used, axis=0)
    p = model.vertices - centre
    # edges on the rim of each facet: by position, those that it has once; the longest gives the facet its axes
    t = model.triangles
    ends, facet = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]]), np.tile(model.triangle_facet, 3)
    position = np.unique(model.vertices + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    key = np.column_stack([np.sort(position[ends], axis=1), facet])
    order = np.lexsort(key.T)
    same = (key[order][1:] == key[order][:-1]).all(axis=1)
    rim = order[~(np.concatenate([[False], same]) | np.concatenate([same, [False]]))]
    v = p[ends[:, 1]] - p[ends[:, 0]]
    length = np.linalg.norm(v, axis=1)
    longest = np.zeros(model.n_facets, int)
    for chosen in (np.arange(len(ends)), rim):  # a facet without a rim (closed on itself) takes any edge
        by_length = chosen[np.argsort(length[chosen], kind="stable")]
        longest[facet[by_length]] = by_length
    n = model.facet_normal
    u = v[longest] - n * np.einsum("ij,ij->i", v[longest], n)[:, None]
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    axes = np.stack([n, u, np.cross(n, u)], axis=1)
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


def _inward(model):
    """(F,) bool: facets of closed objects that face inwards (rooms): seen from outside they show their backs, which costs little to allow."""
    signed = np.einsum(
        "ij,ij->i",
        model.corners()[:, 0] - model.vertices.mean(axis=0),
        np.cross(model.corners()[:, 1] - model.corners()[:, 0], model.corners()[:, 2] - model.corners()[:, 0]),
    )
    volume = np.bincount(model.facet_object[model.triangle_facet], signed, len(model.objects))
    return volume[model.facet_object] < 0


# What the search knows of each scene facet.


@dataclass(frozen=True, eq=False)
class _Seen:
    """Per scene facet, in units of the facets. n : (N, 3); g : (N, 3) middle of the outline; angle : (N,) rad and height : (N,) sigma of the
    normal and of the plane at g; slide : (N,) sigma of g within the plane; outline : list (k, 3); v : list (k, 3) rays, z = 1, through the region;
    inverse : list (k,) 1/z there, sigma : list (k,)"""

    n: np.ndarray
    g: np.ndarray
    angle: np.ndarray
    height: np.ndarray
    slide: np.ndarray
    extent: np.ndarray
    outline: list
    v: list
    inverse: list
    sigma: list
    m: np.ndarray
    covariance: np.ndarray
    pivot: np.ndarray
    radius: float


SYSTEMATIC = 0.002  # of 1/z: regions are not exactly what a facet shows; no covariance knows that


def seen_facets(scene, camera, samples=24):
    import cv2

    n, d = scene.normal, scene.distance
    covariance = scene.covariance + (SYSTEMATIC / d)[:, None, None] ** 2 * np.eye(3)
    rays, inverse, sigma, g = [], [], [], []
    for polygon, m, C in zip(scene.polygons, scene.m, covariance):
        z = np.maximum(polygon[:, 2], 1e-3 * np.abs(polygon).max())
        q = polygon[:, :2] / z[:, None]  # at z = 1
        low, high = q.min(axis=0), q.max(axis=0)
        raster = 40
        step = max((high - low).max() / raster, 1e-12)
        mask = np.zeros((raster + 3, raster + 3), np.uint8)
        cv2.fillPoly(mask, [np.rint(8 * ((q - low) / step + 1)).astype(np.int32)], 1, shift=3)
        inner = mask
        for _ in range(3):  # away from the rim, where there is room
            smaller = cv2.erode(inner, np.ones((3, 3), np.uint8), borderValue=0)
            if smaller.sum() < samples:
                break
            inner = smaller
        y, x = np.nonzero(inner if inner.any() else mask)
        if len(x) == 0:
            x, y = np.array([1.0]), np.array([1.0])
        keep = np.unique(np.linspace(0, len(x) - 1, samples).astype(int))
        v = np.column_stack([low[0] + (x[keep] - 1) * step, low[1] + (y[keep] - 1) * step, np.ones(len(keep))])
        b = v @ m
        v, b = v[b > 0], b[b > 0]
        rays.append(v), inverse.append(b)
        sigma.append(np.sqrt(np.einsum("ij,jk,ik->i", v, C, v)))
        g.append((v / b[:, None]).mean(axis=0) if len(v) else polygon.mean(axis=0))
    g = np.array(g).reshape(-1, 3)
    P = np.eye(3) - n[:, :, None] * n[:, None, :]
    angle = d * np.sqrt(np.linalg.eigvalsh(P @ covariance @ P)[:, -1]) if len(g) else np.zeros(0)
    height = d * np.sqrt(np.einsum("ni,nij,nj->n", g, covariance, g))
    cosine = np.abs(np.einsum("ni,ni->n", n, g)) / np.linalg.norm(g, axis=1)
    slide = height * np.sqrt(1 - np.minimum(cosine, 1) ** 2) / np.maximum(cosine, 0.05) + 2 * g[:, 2] / camera.K[0, 0]
    extent = np.zeros((len(g), 2))
    for i, polygon in enumerate(scene.polygons):
        u = np.cross(n[i], np.eye(3)[np.argmin(np.abs(n[i]))])
        u /= np.linalg.norm(u)
        flat = np.column_stack([polygon @ u, polygon @ np.cross(n[i], u)]).astype(np.float32)
        extent[i] = sorted(cv2.minAreaRect(flat - flat.mean(axis=0))[1])
    pivot = np.median(g, axis=0) if len(g) else np.zeros(3)
    radius = float(np.median(np.linalg.norm(g, axis=1))) if len(g) else 1.0
    return _Seen(
        n, g, angle, height, slide, extent, scene.polygons, rays, inverse, sigma, scene.m, covariance, pivot, radius
    )


# Positions: the deepest point of the boxes.


def correspondences(seen, db, R, sigma, large, size_ok):
    """Scene facet on model facet side, at this rotation: arrays for _search.

    One correspondence asks, for each of three axes A of the model facet, that A.c + q P1 >= low and A.c + q P2 <= high:
    c is the pivot's place in the model, q the scale, P1 and P2 hold the outline's reach and the tolerance.
    """
    lever = np.linalg.norm(seen.g - seen.pivot, axis=1)
    gate = np.cos(np.minimum(3.5 * np.hypot(seen.angle, sigma) + 0.01, 0.6))
    start = np.cumsum([0, *(len(outline) for outline in seen.outline)])
    made = kernels.fill(
        seen.n @ R,
        gate,
        (np.concatenate(seen.outline) - seen.pivot) @ R,
        start,
        (seen.g - seen.pivot) @ R,
        3 * np.hypot(seen.height, sigma * lever),
        3 * np.hypot(seen.slide, sigma * lever),
        db.axes[large],
        db.twosided[large],
        size_ok,
    )
    i, f, A, P1, P2 = made
    f = large[f]
    return (i, f, A, P1, P2, db.low[f], db.high[f]) if len(i) else None


def distinct_planes(db, facets):
    planes = []
    for f in facets:
        if not any(
            abs(db.axes[f, 0] @ db.axes[g, 0]) > 0.999
            and abs(db.low[f, 0] - np.sign(db.axes[f, 0] @ db.axes[g, 0]) * db.low[g, 0]) < 0.01
            for g in planes
        ):
            planes.append(f)
    return len(planes)
