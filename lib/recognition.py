"""§2.4 Recognition: which part of the model do the reconstructed facets show, and from where?

    scene = read_facets("facets.json")
    found = recognise(scene, model, camera)         # Recognition: poses, best first, and their matches

The frame of the facets is the left camera's; a pose takes the model's frame ("world", metres) to it. The
scale q is the metre per unit of the facets: 1, or unknown where the unit is the pair's baseline.

Method. Normals alone give a few rotations (angles are the hash: pairs of scene facets against pairs of the
model's directions). For each, a scene facet i may lie on a model facet a if it is not larger, and that holds for the
positions in a flat box: thin along the normal (the covariance), as wide as the part that is seen may slide on
what is there. The largest set of matches compatible with one displacement is the deepest point of those
boxes, found by branch and bound, so that nothing is missed. The best candidates are fitted to the planes in
closed form, then by least squares under the covariances, and rays say what the camera would see there: only a
facet that would show itself where the region lies counts.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from lib import artefact
from lib.stage import BadInput

GATE = 21.1            # chi-square of 3 degrees of freedom, 99.99 %
DISTINCT_RAD = 0.05    # poses that differ by more than this, or by DISTINCT of the scene's depth, are different answers
DISTINCT = 0.05
PROVEN_SHARE = 0.33    # of all evidence; half of the facets may be spurious


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
            if array.ndim != len(shape) or any(s and s != n for s, n in zip(shape, array.shape)) or not np.isfinite(array).all():
                raise BadInput(f"{where}: {name}: finite numbers of shape {shape} are needed, got {value!r:.60}")
            return array
        if not isinstance(facet, dict) or not isinstance(facet.get("plane"), dict):
            raise BadInput(f"{where}: plane: is missing")
        n, d = numbers(facet["plane"].get("n"), "plane.n", (3,)), float(numbers(facet["plane"].get("d"), "plane.d", ()))
        if abs(np.linalg.norm(n) - 1) > 1e-3 or d >= 0:
            raise BadInput(f"{where}: plane: a unit normal towards the camera and d < 0 are needed, got |n| = {np.linalg.norm(n):.4g}, d = {d:g}")
        spread = numbers(facet.get("covariance"), "covariance", (3, 3))
        if np.linalg.eigvalsh((spread + spread.T) / 2)[0] < -1e-6 * max(abs(np.trace(spread)), 1e-300):
            raise BadInput(f"{where}: covariance: has a negative eigenvalue")
        polygon = numbers(facet.get("polygon"), "polygon", (0, 3))
        if len(polygon) < 3:
            raise BadInput(f"{where}: polygon: {len(polygon)} corners instead of at least 3")
        m.append(n / d), covariance.append((spread + spread.T) / 2), polygons.append(polygon)
        labels.append([int(facet.get("left_label", 0) or 0), int(facet.get("right_label", 0) or 0)])
    return SceneFacets(np.array(m, float).reshape(-1, 3), np.array(covariance, float).reshape(-1, 3, 3), polygons,
                       np.array(labels, int).reshape(-1, 2), content["unit"])


# Results.

@dataclass(frozen=True, eq=False)
class Pose:
    """T : (4, 4)                  T_cam_world, metres
    scale : m per unit of the facets
    covariance : (6, 6) or (7, 7)   of (omega, tau[, ln scale]): T = exp(omega, tau) T_hat, camera axes, radians and metres
    matches : (n, 2) int        scene facet, model facet
    score : evidence in nats: what the matches' chance would have been
    chi2 : of the matches, 3 for each expected
    vertex_m : root mean square distance of the outlines' corners to the nearest corner of their facets, metres
    """

    T: np.ndarray
    scale: float
    covariance: np.ndarray
    matches: np.ndarray
    score: float
    chi2: float
    vertex_m: float
    linear: np.ndarray = field(default=None, repr=False)      # T after the closed form


@dataclass(frozen=True, eq=False)
class Recognition:
    """poses : tuple of Pose          best first; those behind the first explain the facets as well ("ambiguous")
    status : "unique"; "ambiguous"; "unproved": no more evidence than the search finds by chance, or for a small part of the facets only, or a
             pose that they hardly hold, so that the photographs must decide; "not recognised": nothing to decide about
    why : str                     in plain words, where it is not recognised
    weight : (N,)                 evidence in nats of each scene facet
    counts : dict                 rotations, correspondences, nodes, candidates; whether the search was complete; chance: nats found by chance
    """

    poses: tuple
    status: str
    why: str
    weight: np.ndarray
    counts: dict


# The model's facets, as the search needs them.

@dataclass(frozen=True, eq=False)
class Database:
    """F facets, relative to `centre` (m, world). axes : (F, 3, 3) normal, two in-plane; low, high : (F, 3) extents along them."""

    model: object
    centre: np.ndarray
    size: np.ndarray               # (3,) m of the model's box
    axes: np.ndarray
    low: np.ndarray
    high: np.ndarray
    rim: np.ndarray                # (R,) vertices on the rims of facets
    rim_facet: np.ndarray          # (R,) of which, ascending
    caster: object
    local: object
    twosided: np.ndarray           # (F,) bool: its back can be seen

    def corners(self, facet):
        """(k, 3) m: of the facet's outline."""
        first, last = np.searchsorted(self.rim_facet, [facet, facet + 1])
        return self.model.vertices[np.unique(self.rim[first:last])] - self.centre


def database(model) -> Database:
    from lib import rays

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
    for chosen in (np.arange(len(ends)), rim):                                  # a facet without a rim (closed on itself) takes any edge
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
    return Database(model, centre, size, axes, low, high, ends[rim, 0], facet[rim], rays.Caster(local.points(model.corners())), local,
                    ~model.closed_objects[model.facet_object] | _inward(model))


def _inward(model):
    """(F,) bool: facets of closed objects that face inwards (rooms): seen from outside they show their backs, which costs little to allow."""
    signed = np.einsum("ij,ij->i", model.corners()[:, 0] - model.vertices.mean(axis=0),
                       np.cross(model.corners()[:, 1] - model.corners()[:, 0], model.corners()[:, 2] - model.corners()[:, 0]))
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


SYSTEMATIC = 0.002        # of 1/z: regions are not exactly what a facet shows; no covariance knows that


def _seen(scene, camera, samples=24):
    import cv2

    n, d = scene.normal, scene.distance
    covariance = scene.covariance + (SYSTEMATIC / d)[:, None, None] ** 2 * np.eye(3)
    rays, inverse, sigma, g = [], [], [], []
    for polygon, m, C in zip(scene.polygons, scene.m, covariance):
        z = np.maximum(polygon[:, 2], 1e-3 * np.abs(polygon).max())
        q = polygon[:, :2] / z[:, None]                                        # at z = 1
        low, high = q.min(axis=0), q.max(axis=0)
        raster = 40
        step = max((high - low).max() / raster, 1e-12)
        mask = np.zeros((raster + 3, raster + 3), np.uint8)
        cv2.fillPoly(mask, [np.rint(8 * ((q - low) / step + 1)).astype(np.int32)], 1, shift=3)
        inner = mask
        for _ in range(3):                                                     # away from the rim, where there is room
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
    return _Seen(n, g, angle, height, slide, extent, scene.polygons, rays, inverse, sigma, scene.m, covariance, pivot, radius)


# Rotations.

def _directions(db, most=60):
    """(D, 3) distinct directions that facets face, both sides of those that have two, the largest areas first."""
    area = db.model.facet_area()
    n = np.concatenate([db.axes[:, 0], -db.axes[db.twosided, 0]])
    area = np.concatenate([area, area[db.twosided]])
    order = np.argsort(-area, kind="stable")
    n, found = n[order], []
    while len(n) and len(found) < most:
        found.append(n[0])
        n = n[n @ n[0] < math.cos(0.005)]
    return np.array(found)


def _rotations(seen, directions, most=200, tried=20000):
    """Rotations, world to camera, that bring normals together: (R, sigma rad, evidence) each, the most evidence first.

    The evidence of a normal that meets one of the model's directions is -ln of the chance that any normal does.
    """
    from scipy.spatial.transform import Rotation

    gate = np.minimum(3 * seen.angle + 0.03, 0.6)
    evidence = np.maximum(-np.log(len(directions) * (1 - np.cos(gate)) / 2), 0)
    i, j = np.triu_indices(len(seen.n), 1)
    cosine = np.einsum("ij,ij->i", seen.n[i], seen.n[j])
    tolerance = 3 * np.hypot(seen.angle[i], seen.angle[j]) + 0.005
    use = (np.abs(cosine) < math.cos(0.3)) & (tolerance < 0.35)
    i, j, cosine, tolerance = i[use], j[use], cosine[use], tolerance[use]
    model_angle = np.arccos(np.clip(directions @ directions.T, -1, 1))
    pairs, number = [], 0
    for k in np.argsort(tolerance, kind="stable"):
        a, b = np.nonzero((np.abs(model_angle - math.acos(cosine[k])) < tolerance[k]) & (np.sin(model_angle) > 0.15))
        pairs.append(np.stack([np.full(len(a), k), a, b]))
        number += len(a)
        if number > tried:
            break
    if number == 0:
        return []
    k, a, b = np.concatenate(pairs, axis=1)
    R = _frames(seen.n[i[k]], seen.n[j[k]]) @ _frames(directions[a], directions[b]).transpose(0, 2, 1)
    score = _support(R, seen.n, directions, np.cos(gate), evidence)
    order = np.argsort(-score, kind="stable")
    R, score = R[order], score[order]
    quaternion = Rotation.from_matrix(R).as_quat()
    left = np.ones(len(R), bool)
    found, kept = [], np.zeros((0, 3, 3))
    for k in range(len(R)):
        if not left[k]:
            continue
        left &= np.abs(quaternion @ quaternion[k]) < math.cos(0.04 / 2)
        refined, sigma, fits = _aligned(R[k], seen.n, seen.angle, directions)
        if not sigma < 0.2:
            continue
        if (np.einsum("ij,kij->k", refined, kept) > 1 + 2 * math.cos(0.02)).any():
            continue
        kept = np.concatenate([kept, refined[None]])
        found.append((refined, sigma, float(evidence[fits].sum())))
        if len(found) == most:
            break
    return sorted(found, key=lambda f: -f[2])


@njit(cache=True)
def _aligned(R, n, angle, directions):
    """R improved on all normals near a direction: (R, sigma rad of its worst turn, (N,) bool which normals); sigma is infinite where nothing holds it."""
    fits, sigma = np.zeros(len(n), np.bool_), 0.03
    for _ in range(3):
        M, information = np.zeros((3, 3)), np.zeros((3, 3))
        for i in range(len(n)):
            best, a = -2.0, 0
            for d in range(len(directions)):
                cosine = 0.0
                for x in range(3):
                    for y in range(3):
                        cosine += n[i, x] * R[x, y] * directions[d, y]
                if cosine > best:
                    best, a = cosine, d
            fits[i] = best > math.cos(min(3 * math.sqrt(angle[i] ** 2 + sigma ** 2) + 0.005, 0.6))
            if fits[i]:
                w = 1 / (angle[i] ** 2 + 1e-6)
                for x in range(3):
                    information[x, x] += w
                    for y in range(3):
                        M[x, y] += w * n[i, x] * directions[a, y]
                        information[x, y] -= w * n[i, x] * n[i, y]
        if fits.sum() < 2:
            return R, np.inf, fits
        u, _, vt = np.linalg.svd(M)                                             # Kabsch, as below
        turn = np.eye(3)
        turn[2, 2] = np.linalg.det(u @ vt)
        R = u @ turn @ vt
        least = np.linalg.eigvalsh(information)[0]
        sigma = 1 / math.sqrt(least) if least > 0 else np.inf
    return R, sigma, fits


@njit(cache=True)
def _support(R, n, directions, gate, evidence):
    """(len(R),): the evidence of the normals n (N, 3) that a rotation brings within their gates (cosines) of a direction."""
    score = np.zeros(len(R))
    for k in range(len(R)):
        for i in range(len(n)):
            x = R[k, 0, 0] * n[i, 0] + R[k, 1, 0] * n[i, 1] + R[k, 2, 0] * n[i, 2]
            y = R[k, 0, 1] * n[i, 0] + R[k, 1, 1] * n[i, 1] + R[k, 2, 1] * n[i, 2]
            z = R[k, 0, 2] * n[i, 0] + R[k, 1, 2] * n[i, 1] + R[k, 2, 2] * n[i, 2]
            for d in range(len(directions)):
                if x * directions[d, 0] + y * directions[d, 1] + z * directions[d, 2] > gate[i]:
                    score[k] += evidence[i]
                    break
    return score


def _frames(a, b):
    """(..., 3, 3): orthonormal frames, as columns, from two directions each, the error of the angle shared between both."""
    c = np.cross(a, b)
    c = c / np.linalg.norm(c, axis=-1, keepdims=True)
    s = a / np.linalg.norm(a, axis=-1, keepdims=True) + b / np.linalg.norm(b, axis=-1, keepdims=True)
    s = s / np.linalg.norm(s, axis=-1, keepdims=True)
    return np.stack([s, c, np.cross(s, c)], axis=-1)


def kabsch(a, b, weight):
    """The rotation R (det +1: never a reflection) that minimises sum weight |b - R a|^2; a, b : (n, 3). Kabsch 1976, Horn 1987.

    >>> R = kabsch(np.eye(3), np.eye(3)[[1, 2, 0]], np.ones(3))
    >>> (R @ np.eye(3)[0]).round(9) + 0.0
    array([0., 1., 0.])
    """
    u, _, vt = np.linalg.svd((weight[:, None] * b).T @ a)
    return u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt


# Positions: the deepest point of the boxes.

def _correspondences(seen, db, R, sigma, large, size_ok):
    """Scene facet on model facet side, at this rotation: arrays for _search.

    One correspondence asks, for each of three axes A of the model facet, that A.c + q P1 >= low and A.c + q P2 <= high:
    c is the pivot's place in the model, q the scale, P1 and P2 hold the outline's reach and the tolerance.
    """
    lever = np.linalg.norm(seen.g - seen.pivot, axis=1)
    gate = np.cos(np.minimum(3.5 * np.hypot(seen.angle, sigma) + 0.01, 0.6))
    start = np.cumsum([0, *(len(outline) for outline in seen.outline)])
    made = _fill(seen.n @ R, gate, (np.concatenate(seen.outline) - seen.pivot) @ R, start, (seen.g - seen.pivot) @ R,
                 3 * np.hypot(seen.height, sigma * lever), 3 * np.hypot(seen.slide, sigma * lever), db.axes[large], db.twosided[large], size_ok)
    i, f, A, P1, P2 = made
    f = large[f]
    return (i, f, A, P1, P2, db.low[f], db.high[f]) if len(i) else None


@njit(cache=True)
def _fill(n, gate, outline, start, g, tall, wide, axes, twosided, size_ok):
    """The arrays of _correspondences, all directions in the model's frame; outline, g : from the pivot."""
    most = 0
    for k in range(len(n)):
        for f in range(len(axes)):
            cosine = n[k, 0] * axes[f, 0, 0] + n[k, 1] * axes[f, 0, 1] + n[k, 2] * axes[f, 0, 2]
            most += size_ok[k, f] and (cosine > gate[k] or (cosine < -gate[k] and twosided[f]))
    scene, facet = np.empty(most, np.int64), np.empty(most, np.int64)
    A, P1, P2 = np.empty((most, 3, 3)), np.empty((most, 3)), np.empty((most, 3))
    c = 0
    for k in range(len(n)):
        for f in range(len(axes)):
            cosine = n[k, 0] * axes[f, 0, 0] + n[k, 1] * axes[f, 0, 1] + n[k, 2] * axes[f, 0, 2]
            if not (size_ok[k, f] and (cosine > gate[k] or (cosine < -gate[k] and twosided[f]))):
                continue
            scene[c], facet[c], A[c] = k, f, axes[f]
            h = A[c, 0, 0] * g[k, 0] + A[c, 0, 1] * g[k, 1] + A[c, 0, 2] * g[k, 2]
            P1[c, 0], P2[c, 0] = h + tall[k], h - tall[k]
            for a in (1, 2):
                least, largest = np.inf, -np.inf
                for p in range(start[k], start[k + 1]):
                    x = A[c, a, 0] * outline[p, 0] + A[c, a, 1] * outline[p, 1] + A[c, a, 2] * outline[p, 2]
                    least, largest = min(least, x), max(largest, x)
                slack = wide[k] + 0.03 * (largest - least)
                P1[c, a], P2[c, a] = least + slack, largest - slack
            c += 1
    return scene, facet, A, P1, P2


SCALE_STEP = 0.08          # ln; the scales are searched in steps
MOST_NODES = 2_000_000     # some seconds


@njit(cache=True)
def _search(scene, A, P1, P2, low, high, member, start, scale, reach, weight, half, span, resolution, margin, most_nodes):
    """Branch and bound over the places c of the pivot, |c| <= half, and scales q, for all problems (rotation, step of scale) at once.

    Problem k has the correspondences member[start[k]:start[k + 1]], scales within reach[k] of scale[k], and is done at resolution[k].
    The bound of a cell is the weight of the scene facets that some correspondence allows somewhere in it; the cell of the highest
    bound is halved first, so the deepest point comes first, and then everything within `margin` of it.

    Returns problem (n,), places (n, 4), scores (n,), cells visited; complete unless most_nodes were not enough.
    """
    marks = np.full((3, len(weight)), -1)
    capacity = 4096
    cell, bound, sure, owner = np.empty((capacity, 8)), np.empty(capacity), np.empty(capacity), np.empty(capacity, np.int64)
    heap, free = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    used, size, spare, stamp = 0, 0, 0, 0
    largest = 0
    for k in range(len(start) - 1):
        largest = max(largest, start[k + 1] - start[k])
    pool = np.empty(4 * largest + 4, np.int64)
    problem, places, scores, count = np.empty(512, np.int64), np.empty((512, 4)), np.empty(512), 0
    best, nodes = 0.0, 0
    child = np.empty(8)
    for k in range(len(start) - 1):                                             # the roots
        pool[:start[k + 1] - start[k]] = member[start[k]:start[k + 1]]
        child[:3], child[3:6], child[6], child[7] = 0.0, half, scale[k], reach[k]
        stamp += 1
        n, most, everywhere, middle = _allowed(scene, A, P1, P2, low, high, weight, child, pool, 0, start[k + 1] - start[k], largest, marks, stamp)
        best = max(best, middle)
        if used == capacity:
            capacity *= 2
            cell, bound, sure, owner, heap, free = _grown(cell, bound, sure, owner, heap, free, capacity)
        cell[used], bound[used], sure[used], owner[used] = child, most, everywhere, k
        size = _push(heap, size, bound, used)
        used += 1
    while size > 0 and nodes < most_nodes:
        at = heap[0]
        size = _pop(heap, size, bound)
        if bound[at] < best - margin:
            break
        nodes += 1
        k, value, certain = owner[at], bound[at], sure[at]
        here = cell[at].copy()
        free[spare] = at
        spare += 1
        widest, axis = here[7] * span, 3
        for a in range(3):
            if here[3 + a] > widest:
                widest, axis = here[3 + a], a
        near = -1
        for s in range(count):
            if problem[s] == k:
                gap = max(abs(places[s, 0] - here[0]), abs(places[s, 1] - here[1]), abs(places[s, 2] - here[2]), abs(places[s, 3] - here[6]) * span)
                if gap < 3 * resolution[k] + widest:
                    near = s
                    break
        if near >= 0 and widest < 2 * resolution[k] and value <= scores[near]:
            continue                                                            # the same place again
        if widest < resolution[k] or certain >= value - 1e-9:
            if near < 0:
                if count == len(scores):
                    continue                                                    # the others are worse, or as good: enough to know
                near = count
                count += 1
                scores[near] = 0.0
            if value > scores[near]:
                problem[near], scores[near], places[near, :3], places[near, 3] = k, value, here[:3], here[6]
            continue
        stamp += 1
        length = start[k + 1] - start[k]
        pool[:length] = member[start[k]:start[k + 1]]
        n, _, _, _ = _allowed(scene, A, P1, P2, low, high, weight, here, pool, 0, length, length, marks, stamp)
        for side in (-1, 1):
            child[:] = here
            if axis == 3:
                child[7] /= 2
                child[6] += side * child[7]
            else:
                child[3 + axis] /= 2
                child[axis] += side * child[3 + axis]
            stamp += 1
            _, most, everywhere, middle = _allowed(scene, A, P1, P2, low, high, weight, child, pool, length, n, length + n, marks, stamp)
            best = max(best, middle)
            if most < best - margin or most <= 0:
                continue
            if spare > 0:
                spare -= 1
                new = free[spare]
            else:
                if used == capacity:
                    capacity *= 2
                    cell, bound, sure, owner, heap, free = _grown(cell, bound, sure, owner, heap, free, capacity)
                new = used
                used += 1
            cell[new], bound[new], sure[new], owner[new] = child, most, everywhere, k
            size = _push(heap, size, bound, new)
    return problem[:count], places[:count], scores[:count], nodes


@njit(cache=True)
def _grown(cell, bound, sure, owner, heap, free, capacity):
    n = len(bound)
    new_cell, new_bound, new_sure = np.empty((capacity, 8)), np.empty(capacity), np.empty(capacity)
    new_owner, new_heap, new_free = np.empty(capacity, np.int64), np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    new_cell[:n], new_bound[:n], new_sure[:n], new_owner[:n], new_heap[:n], new_free[:n] = cell, bound, sure, owner, heap, free
    return new_cell, new_bound, new_sure, new_owner, new_heap, new_free


@njit(cache=True)
def _push(heap, size, bound, item):
    """A heap of items, the highest bound on top, the newer (smaller) cell first among equals; returns the new size."""
    k = size
    while k > 0 and bound[item] >= bound[heap[(k - 1) // 2]]:
        heap[k] = heap[(k - 1) // 2]
        k = (k - 1) // 2
    heap[k] = item
    return size + 1


@njit(cache=True)
def _pop(heap, size, bound):
    """Takes the top away; returns the new size."""
    size -= 1
    item, k = heap[size], 0
    while 2 * k + 1 < size:
        c = 2 * k + 1
        if c + 1 < size and bound[heap[c + 1]] > bound[heap[c]]:
            c += 1
        if bound[item] >= bound[heap[c]]:
            break
        heap[k] = heap[c]
        k = c
    heap[k] = item
    return size


@njit(cache=True)
def _allowed(scene, A, P1, P2, low, high, weight, cell, pool, start, length, end, marks, stamp):
    """Which of the correspondences pool[start:start + length] are possible in a cell; they are written to pool[end:].

    Returns their number and the weights of the scene facets that are possible somewhere, hold everywhere, hold in the middle.
    """
    n, most, everywhere, middle = 0, 0.0, 0.0, 0.0
    q, eq = cell[6], cell[7]
    for s in range(start, start + length):
        k = pool[s]
        possible, certain, holds = True, True, True
        for a in range(3):
            x = A[k, a, 0] * cell[0] + A[k, a, 1] * cell[1] + A[k, a, 2] * cell[2]
            r = abs(A[k, a, 0]) * cell[3] + abs(A[k, a, 1]) * cell[4] + abs(A[k, a, 2]) * cell[5]
            first, second = x + q * P1[k, a] - low[k, a], high[k, a] - x - q * P2[k, a]
            r1, r2 = r + eq * abs(P1[k, a]), r + eq * abs(P2[k, a])
            if first + r1 < 0 or second + r2 < 0:
                possible = False
                break
            if first < r1 or second < r2:
                certain = False
                if first < 0 or second < 0:
                    holds = False
        if possible:
            pool[end + n] = k
            n += 1
            i = scene[k]
            if marks[0, i] != stamp:
                marks[0, i] = stamp
                most += weight[i]
            if certain and marks[1, i] != stamp:
                marks[1, i] = stamp
                everywhere += weight[i]
            if holds and marks[2, i] != stamp:
                marks[2, i] = stamp
                middle += weight[i]
    return n, most, everywhere, middle


# From a place to a pose.

def closed_form(m, covariance, n_world, offset, g, scale_free=False):
    """Pose from planes in closed form: (T_cam_world, scale). The paper's linear step.

    m, covariance, g : of the scene's planes and a point on each;  n_world, offset : of the model's, facing the camera.
    Rotation by Kabsch on the normals, then translation (and scale) by weighted linear least squares on
    the points' heights: n . (q R^T g + c) = offset, c the camera's centre.
    """
    d = 1 / np.linalg.norm(m, axis=1)
    n = -m * d[:, None]
    P = np.eye(3) - n[:, :, None] * n[:, None, :]
    angle2 = d ** 2 * np.linalg.eigvalsh(P @ covariance @ P)[:, -1]
    R = kabsch(n_world, n, 1 / angle2)
    height = d * np.sqrt(np.einsum("ni,nij,nj->n", g, covariance, g))
    M = np.column_stack([n_world, np.einsum("ni,ni->n", n_world, g @ R)]) / height[:, None]
    if scale_free:
        x = np.linalg.lstsq(M, offset / height, rcond=1e-9)[0]
        c, q = x[:3], float(x[3])
    else:
        c, q = np.linalg.lstsq(M[:, :3], offset / height - M[:, 3], rcond=1e-9)[0], 1.0
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, -R @ c
    return T, q


def _fit(seen, db, T, q, scene_idx, facet_idx, scale_free, iterations=8):
    """Gauss-Newton on the planes' m = n q / d under their covariances: T, q, information (6, 6) or (7, 7), chi2 per match."""
    n_w, o = db.axes[facet_idx, 0], db.low[facet_idx, 0]
    L = np.linalg.inv(np.linalg.cholesky(seen.covariance[scene_idx]))
    m = seen.m[scene_idx]
    size = 7 if scale_free else 6

    def residual(T, q):
        n = n_w @ T[:3, :3].T
        d = o + n @ T[:3, 3]
        d = np.where(np.abs(d) < 1e-9, 1e-9, d)
        return n, d, np.einsum("nij,nj->ni", L, m - n * (q / d)[:, None])
    n, d, r = residual(T, q)
    damping = 0.0
    for _ in range(iterations):
        J = np.zeros((len(m), 3, size))
        p = n * (q / d)[:, None]
        for k in range(3):
            w = np.zeros(3)
            w[k] = 1
            J[:, :, k] = -np.cross(w, n) * (q / d)[:, None]
            J[:, :, 3 + k] = p * (n[:, k] / d)[:, None]
        if scale_free:
            J[:, :, 6] = -p
        J = np.einsum("nij,njk->nik", L, J).reshape(-1, size)
        H, b = J.T @ J, J.T @ r.ravel()
        step = -np.linalg.lstsq(H + damping * np.diag(np.diag(H)), b, rcond=1e-12)[0]
        if not np.isfinite(step).all():
            break
        T_new, q_new = moved(T, step), q * math.exp(min(max(step[6], -1), 1)) if scale_free else q
        n_new, d_new, r_new = residual(T_new, q_new)
        if (r_new ** 2).sum() > (r ** 2).sum():
            damping = max(10 * damping, 1e-3)
            continue
        small = (r ** 2).sum() - (r_new ** 2).sum() < 1e-6 * max((r ** 2).sum(), 1e-12)
        T, q, n, d, r, damping = T_new, q_new, n_new, d_new, r_new, damping / 10
        if small:
            break
    return T, q, H, (r ** 2).sum(axis=1)


def moved(T, step):
    """exp(omega, tau) T: a pose turned by omega (rad) about the camera's axes, then moved by tau (m) along them."""
    from lib.cameras import matrix_from_rt

    return matrix_from_rt(np.asarray(step[:6], float)) @ T


def _explained(seen, db, T, q, share=0.55):
    """What the camera would see: (matches (n, 2), fraction (N,)).

    A scene facet is explained where the rays through its region meet the model at the depth that its plane has, within
    3.5 sigma; the facet met most often is its match.
    """
    R, centre = T[:3, :3], -T[:3, :3].T @ T[:3, 3]
    count = np.array([len(v) for v in seen.v])
    if count.sum() == 0:
        return np.zeros((0, 2), int), np.zeros(len(count))
    v = np.concatenate(seen.v)
    v_world = v @ R
    length = np.linalg.norm(v_world, axis=1)
    rays = np.empty((len(v), 6), np.float32)
    rays[:, :3] = (centre + db.centre - db.local.centre) / db.local.diagonal
    rays[:, 3:] = v_world / length[:, None]
    triangle, distance = db.caster.closest(rays)
    hit = triangle >= 0
    facet = np.where(hit, db.model.triangle_facet[triangle], -1)
    inverse = np.where(hit, length / np.maximum(np.where(hit, distance, 1) * db.local.diagonal, 1e-12), 0) * q     # 1/z in units of the facets
    expected, sigma = np.concatenate(seen.inverse), np.concatenate(seen.sigma)
    turned = np.einsum("ij,ij->i", db.axes[facet, 0], v_world) < 0
    normal = seen.n[np.repeat(np.arange(len(count)), count)] @ R
    aligned = np.abs(np.einsum("ij,ij->i", db.axes[facet, 0], normal)) > np.cos(np.minimum(3.5 * seen.angle + 0.02, 0.7))[np.repeat(np.arange(len(count)), count)]
    good = hit & (np.abs(inverse - expected) < 3.5 * sigma + 0.002 * expected) & (turned | db.twosided[facet]) & aligned
    owner = np.repeat(np.arange(len(count)), count)
    fraction = np.bincount(owner, good, len(count)) / np.maximum(count, 1)
    matches = []
    for i in np.flatnonzero(fraction >= share):
        matches.append((i, np.bincount(facet[(owner == i) & good]).argmax()))
    return np.array(matches, int).reshape(-1, 2), fraction


def _facing(db, T, facets):
    """+1 where the front faces the camera at T, else -1: (n,)."""
    centre = -T[:3, :3].T @ T[:3, 3]
    return np.where(db.low[facets, 0] - db.axes[facets, 0] @ centre < 0, 1.0, -1.0)


def _polish(seen, db, weight, T, q, pairs, scale_free):
    """From a candidate to a Pose (in coordinates about db.centre), or None."""
    facets = pairs[:, 1]
    turn = _facing(db, T, facets)
    linear, q_linear = closed_form(seen.m[pairs[:, 0]], seen.covariance[pairs[:, 0]], turn[:, None] * db.axes[facets, 0], turn * db.low[facets, 0],
                                   seen.g[pairs[:, 0]], scale_free)
    if not (np.isfinite(linear).all() and q_linear > 0):
        return None
    # The closed form is the start unless it is worse posed than the search's own place (two facets, say).
    T, q = (linear, q_linear) if _well_posed(db, pairs) else (T, q)
    H, chi2 = None, None
    for _ in range(3):
        T, q, H, chi2 = _fit(seen, db, T, q, pairs[:, 0], pairs[:, 1], scale_free)
        matches, fraction = _explained(seen, db, T, q)
        if len(matches) < 2:
            return None
        same = len(matches) == len(pairs) and (matches == pairs).all()
        pairs = matches
        if same:
            break
    T, q, H, chi2 = _fit(seen, db, T, q, pairs[:, 0], pairs[:, 1], scale_free)
    good = chi2 < GATE
    if good.sum() < 2:
        return None
    if not good.all():
        pairs = pairs[good]
        T, q, H, chi2 = _fit(seen, db, T, q, pairs[:, 0], pairs[:, 1], scale_free)
        fraction = _explained(seen, db, T, q)[1]
        keep = (chi2 < GATE) & (fraction[pairs[:, 0]] >= 0.5)
        pairs, chi2 = pairs[keep], chi2[keep]
        if len(pairs) < 2:
            return None
    evidence = weight[pairs[:, 0]] * np.minimum(1, fraction[pairs[:, 0]] / 0.9) - np.maximum(chi2 - 3, 0) / 2
    distance = [_corner_distance(seen.outline[i], db.corners(f), T, q) for i, f in pairs]
    return Pose(T, q, H, pairs, float(np.maximum(evidence, 0).sum()), float(chi2.sum()), float(np.sqrt(np.mean(np.square(distance)))), linear)


def _well_posed(db, pairs):
    return np.linalg.svd(db.axes[pairs[:, 1], 0], compute_uv=False)[-1] > 0.1 if len(pairs) >= 3 else False


def _corner_distance(outline, corners, T, q):
    if len(corners) == 0:
        return 0.0
    p = corners @ T[:3, :3].T + T[:3, 3]
    gap = np.linalg.norm(q * outline[:, None] - p[None], axis=2)
    return np.sqrt(np.mean(np.minimum(gap.min(axis=1), np.ptp(p, axis=0).max()) ** 2))


# The whole.

def recognise(scene, model, camera, db=None, *, certain=5.0) -> Recognition:
    """The displacements of the model that explain the facets, best first.

    camera : gives the focal length (what a pixel is worth), no more
    certain : nats; a pose whose evidence falls short of the best's by less is another answer

    "not recognised": fewer than 3 facets that fix six degrees of freedom (seven with the scale), or nothing that
    explains enough of them.
    """
    scale_free = scene.unit == "baseline"
    db = db or database(model)
    counts = {"facets": len(scene), "rotations": 0, "correspondences": 0, "nodes": 0, "candidates": 0, "complete": True}
    nothing = lambda why: Recognition((), "not recognised", why, np.zeros(len(scene)), counts)
    if len(scene) < 3:
        return nothing(f"{len(scene)} facets cannot fix a pose: at least 3 are needed")
    seen = _seen(scene, camera)
    rank = np.linalg.svd(seen.n, compute_uv=False)
    if rank[-1] < 0.05 * rank[0]:
        return nothing(f"the {len(scene)} facets face less than 3 independent directions: the pose can slide")
    weight, size_ok = _weights(seen, db, scale_free)
    rotations = _rotations(seen, _directions(db))
    counts["rotations"] = len(rotations)
    poses = []
    for T, q, pairs in _candidates(seen, db, rotations, weight, size_ok, scale_free, certain + 2.0, counts):
        pose = _polish(seen, db, weight, T, q, pairs, scale_free)
        if pose is not None and not any(_same(pose, other, seen) and other.score >= pose.score for other in poses):
            poses = [other for other in poses if not _same(pose, other, seen)] + [pose]
    return _judge(seen, db, weight, poses, certain, scale_free, counts)


def _candidates(seen, db, rotations, weight, size_ok, scale_free, margin, counts):
    """The displacements (T, scale, matches (n, 2)) whose bound comes within margin of the best, best first. Fills in counts.

    counts["chance"] : so many displacements could have been told apart, so much evidence is found by chance: three facets put a scene anywhere.
    """
    extent = float(np.linalg.norm(db.size))
    spread = max(float(np.linalg.norm(seen.g - seen.pivot, axis=1).max()), 1e-12)
    # the scale: the scene is at most as large as the model, and at least a fiftieth of it
    scales = extent / spread * np.exp(-np.arange(SCALE_STEP, math.log(50), SCALE_STEP)) if scale_free else np.ones(1)
    reach = (math.exp(SCALE_STEP / 2) - 1 if scale_free else 0.0) * scales
    large = np.flatnonzero(size_ok.any(axis=0))
    size_ok = np.ascontiguousarray(size_ok[:, large])
    parts, member, start, which, total = [], [], [0], [], 0
    for number, (R, sigma, _) in enumerate(rotations):
        made = _correspondences(seen, db, R, sigma, large, size_ok)
        if made is None:
            continue
        i, f, A, P1, P2, low, high = made
        parts.append(made)
        for q, e in zip(scales, reach):
            fits = np.flatnonzero(((q - e) * (P2 - P1) <= high - low).all(axis=1))     # what is seen is not larger
            if len(fits):
                member.append(fits + total)
                start.append(start[-1] + len(fits))
                which.append((number, q, e))
        total += len(i)
    counts["correspondences"], counts["chance"] = start[-1], 0.0
    if not which:
        return []
    i, f, A, P1, P2, low, high = (np.concatenate(arrays) for arrays in zip(*parts))
    which = np.array(which)
    thin = 3 * np.median(seen.height) * (0.3 * extent / spread if scale_free else 1.0)
    counts["chance"] = round(float(np.log(len(which)) + np.log(np.maximum(db.size / (2 * thin), 1)).sum()), 1)
    resolution = np.maximum(0.4 * which[:, 1] * np.median(P1[:, 0] - P2[:, 0]) / 2, 1e-6 * extent)
    problem, places, scores, counts["nodes"] = _search(i, A, P1, P2, low, high, np.concatenate(member), np.array(start), which[:, 1].copy(), which[:, 2].copy(),
                                                       weight, db.size / 2 + 0.25 * extent, spread, resolution, margin, MOST_NODES)
    counts["complete"] = bool(counts["nodes"] < MOST_NODES)
    found = []
    for k in [k for k in np.argsort(-scores, kind="stable") if scores[k] >= scores.max() - margin][:150]:
        R, place, q, mine = rotations[int(which[problem[k], 0])][0], places[k], places[k, 3], member[problem[k]]
        x = np.einsum("cad,d->ca", A[mine], place[:3])
        slack = 0.4 * (P1[mine, :1] - P2[mine, :1]).clip(0) * q
        holds = ((x + q * P1[mine] - low[mine] >= -slack) & (high[mine] - x - q * P2[mine] >= -slack)).all(axis=1)
        gap = np.abs(x[:, 0] + q * (P1[mine, 0] + P2[mine, 0]) / 2 - low[mine, 0])
        nearest = {}
        for c in np.flatnonzero(holds):
            if i[mine[c]] not in nearest or gap[c] < gap[nearest[i[mine[c]]]]:
                nearest[i[mine[c]]] = c
        if len(nearest) >= 3:
            T = np.eye(4)
            T[:3, :3], T[:3, 3] = R, q * seen.pivot - R @ place[:3]
            found.append((T, q, np.array([(s, f[mine[c]]) for s, c in sorted(nearest.items())])))
    counts["candidates"] = len(found)
    return found


def _weights(seen, db, scale_free):
    """Evidence of each scene facet in nats, and which model facets are large enough for it (N, F).

    -ln of the chance that a displacement drawn at random (its rotation right) explains the facet: the share of the model's box
    that its boxes fill. Facets in one plane share one evidence.
    """
    extent = np.sort(db.high[:, 1:] - db.low[:, 1:], axis=1)                     # (F, 2) short, long
    spread = max(float(np.linalg.norm(seen.g - seen.pivot, axis=1).max()), 1e-12)
    q = 0.3 * np.linalg.norm(db.size) / spread if scale_free else 1.0
    slack = 3 * seen.slide[:, None] + 0.06 * seen.extent
    diagonal = np.linalg.norm(extent, axis=1)
    need = np.maximum(seen.extent - 2 * slack, 0)
    size_ok = np.ones((len(seen.n), len(extent)), bool)
    if not scale_free:
        size_ok = (need[:, None, 1] <= diagonal) & (need[:, None, 0] <= extent[None, :, 0] * 1.42)
    # the box of facet f for scene facet i: thin, and as wide as the outline may slide
    wide = np.maximum(extent[None] - q * need[:, None], 0) + q * 2 * slack[:, None]
    volume = 2 * 3 * q * seen.height[:, None] * wide.prod(axis=2)
    share = np.where(size_ok, volume, 0).sum(axis=1) / np.prod(np.maximum(db.size, 0.05 * db.size.max())) / 3
    weight = np.clip(-np.log(np.maximum(share, 1e-12)), 0.3, 8.0)
    height = np.abs(np.einsum("ni,mi->nm", seen.m, seen.g) - 1) / np.sqrt(np.einsum("mi,nij,mj->nm", seen.g, seen.covariance, seen.g))
    coplanar = (height < 3) & (height.T < 3) & (seen.n @ seen.n.T > 0.99)
    return weight / np.sqrt(np.maximum(coplanar.sum(axis=1), 1)), size_ok


def _same(a, b, seen):
    """Do two poses put the scene at the same place?"""
    turn = np.linalg.norm(a.T[:3, :3] - b.T[:3, :3]) / math.sqrt(2)
    ca, cb = (p.T[:3, :3].T @ (p.scale * seen.pivot - p.T[:3, 3]) for p in (a, b))
    reach = DISTINCT * seen.radius * max(a.scale, b.scale)
    return turn < DISTINCT_RAD and np.linalg.norm(ca - cb) < reach and abs(math.log(a.scale / b.scale)) < DISTINCT


def _judge(seen, db, weight, poses, certain, scale_free, counts):
    """Order, status, covariances, and back to the model's own frame."""
    if not poses:
        return Recognition((), "not recognised", "no displacement of the model explains three of the facets", weight, counts)
    # Ties within the evidence's resolution go to the least mean square error between corners (the paper's rule).
    poses = sorted(poses, key=lambda p: (-round(p.score, 1), p.vertex_m))
    best = poses[0]
    size = 7 if scale_free else 6
    loosest = 1 / math.sqrt(max(np.linalg.eigvalsh(best.covariance / _unit(seen, best.scale, size))[0], 1e-12))      # rad, or parts of the depth
    planes = f"only {_distinct_planes(db, best.matches[:, 1])} distinct planes explain {len(best.matches)} of {len(weight)} facets: the pose cannot be known"
    if len(best.matches) < 3 or loosest > 1:
        return Recognition((), "not recognised", planes, weight, counts)
    rivals = [p for p in poses[1:] if p.score > best.score - certain]
    final = []
    for p in (best, *rivals):
        T = p.T.copy()
        T[:3, 3] = p.T[:3, 3] - p.T[:3, :3] @ db.centre
        linear = p.linear.copy()
        linear[:3, 3] = linear[:3, 3] - linear[:3, :3] @ db.centre
        final.append(replace(p, T=T, covariance=np.linalg.inv(p.covariance + 1e-2 * _unit(seen, p.scale, size) * np.eye(size)), linear=linear))
    if not counts["complete"]:
        why = f"the search gave up after {counts['nodes']} cells: other displacements may explain the facets as well"
        return Recognition(tuple(final), "unproved", why, weight, counts)
    if loosest > 0.15:
        return Recognition(tuple(final), "unproved", planes, weight, counts)
    share = best.score / max(float(weight.sum()), 1e-12)
    if best.score < counts["chance"] + 1 or share < PROVEN_SHARE:
        small = "no more than a displacement that is wrong explains by chance" if best.score < counts["chance"] + 1 else f"{100 * share:.0f} % of what they say"
        why = f"the best displacement explains {len(best.matches)} of {len(weight)} facets, {small}"
        return Recognition(tuple(final), "unproved", why, weight, counts)
    return Recognition(tuple(final), "ambiguous" if len(final) > 1 else "unique", "", weight, counts)


def _unit(seen, scale, size):
    """Outer product that makes an information matrix dimensionless: radians, and translations as parts of the scene's depth."""
    u = np.ones(size)
    u[3:6] = 1 / (seen.radius * scale)
    return np.outer(u, u)


def _distinct_planes(db, facets):
    planes = []
    for f in facets:
        if not any(abs(db.axes[f, 0] @ db.axes[g, 0]) > 0.999 and abs(db.low[f, 0] - np.sign(db.axes[f, 0] @ db.axes[g, 0]) * db.low[g, 0]) < 0.01 for g in planes):
            planes.append(f)
    return len(planes)


def warm_up():
    """Compiles, or reads from the cache, what is compiled."""
    one, zero, eye = np.zeros((1, 3)), np.zeros(1, np.int64), np.eye(3)
    _support(eye[None], eye, eye, np.ones(3), np.ones(3))
    _aligned(eye, eye, np.ones(3), eye)
    _fill(one, np.ones(1), eye, np.array([0, 3]), one, np.ones(1), np.ones(1), eye[None], np.ones(1, bool), np.ones((1, 1), bool))
    _search(zero, eye[None], one - 1, one + 1, one - 1, one + 1, zero, np.array([0, 1]), np.ones(1), np.zeros(1), np.ones(1), np.ones(3), 1.0, np.ones(1), 1.0, 100)
