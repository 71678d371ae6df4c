"""Dimensions of objects that the model has wrong: facets whose edges lie aside in all photographs.

A facet's distance along its own normal is one number.  Its edges follow: a point of an edge moves by the least vector
that puts it on the displaced planes of the facets that meet there.  All numbers of an object are fitted at once, on
sub-pixel edges.  Two opposite facets that both moved outwards are a larger object.
"""

from dataclasses import dataclass, replace

import numpy as np

from lib.vision.objects.fit import ASIDE_PX, evidence
from lib.vision.objects.scenery import Scenery
from lib.vision.refinement.edges import find, locate, model_edges, visible_samples

SIGMAS, LEAST_M = 6.0, 0.003  # below either a dimension counts as right
BETTER = 8.0  # nats by which the photographs must prefer the other dimensions
PRESENT, MORE = 0.75, 0.1  # share of the edges that must be found then, and how many more than before
PRIOR_M = 0.1
REACHES = (16.0, 8.0, 5.0, 3.0, 2.0, 2.0)
MOST_FACETS = 24
LEAST_SAMPLES = 20


@dataclass(frozen=True)
class Size:
    """by_m : how much larger than in the model, negative: smaller; sigma_m; axis : (3,) unit, world

    rms_px : robust, of the edges with all dimensions fitted
    """

    name: str
    by_m: float
    sigma_m: float
    axis: tuple
    up: int  # the axis of the model that is upright in the picture
    rms_px: float | None = None


def wrong(scenery, things, photographs) -> list[Size]:
    """Of each thing, where it stands as well as can be, the dimension that is most surely wrong."""
    found = [surest(scenery, thing, photographs) for thing in things]
    return [size for size in found if size]


def surest(scenery, thing, photographs) -> Size | None:
    """The dimension of one object that is most surely wrong, or None."""
    model = scenery.posed()
    facets = np.flatnonzero(model.facet_object == thing)
    if len(facets) > MOST_FACETS:
        return None
    used = model.vertices[np.unique(model.triangles[model.facet_object[model.triangle_facet] == thing])]
    window = photographs.window(used)
    before = evidence(scenery, thing, window) if window else (0, 0, 0, 0)
    if before[3] < LEAST_SAMPLES:
        return None
    shift, C = np.zeros(len(facets)), None
    for reach in REACHES:
        result = _step(_displaced(model, facets, shift), thing, facets, window, reach, shift)
        if result is None:
            return None
        shift, C, rms_px = result
    after = evidence(Scenery(_displaced(model, facets, shift), {}), thing, window)
    if after[2] < before[2] + BETTER or after[0] < max(PRESENT, before[0] + MORE):
        return None
    up = int(np.abs(photographs.T_left_world[1, :3]).argmax())
    size = _surest(model, facets, shift, C, thing, up)
    return size and replace(size, rms_px=rms_px)


def _step(model, thing, facets, window, reach, shift):
    """(shift (F,) m, covariance, robust rms px) after a Gauss-Newton step, or None."""
    edges = model_edges(model)
    owner = np.append(model.facet_object, -1)
    rows, residuals, weights, witness = [], [], [], []
    for side, (camera, levels) in enumerate(zip(window.cameras(), window.pyramids, strict=True)):
        s = visible_samples(model, edges, camera, 1, step_px=3.0, reach=max(int(reach) + 1, 5))
        own = owner[edges.facets] == thing
        keep = own[s.edge].any(axis=1) & (owner[np.maximum(s.sides, -1)] == thing).any(axis=1)
        p, q, normal, edge = s.p[keep], s.q[keep], s.normal[keep], s.edge[keep]
        if reach > 2:
            offset, strength, doubt = find(levels[1], q, normal, reach)
            good = (strength > 0) & (np.abs(offset) < reach) & (doubt < 0.9)
            weight = 1 - doubt**2
        else:
            offset, spread, strength = locate(levels[1], q, normal, s.clear[keep])
            good = (strength > 0) & (spread < 1)
            weight = 1 / (1 + (spread / 0.1) ** 2)
        J = _follows(model, edges, facets, edge, camera, p, normal)
        rows.append(J[good]), residuals.append(offset[good]), weights.append(weight[good])
        witness.append(2 * edge[good] + side)
    J, r, w, witness = (np.concatenate(x) for x in (rows, residuals, weights, witness))
    if len(r) < LEAST_SAMPLES:
        return None
    width = 2.5 * max(1.4826 * float(np.median(np.abs(r))), 0.1)
    change = np.zeros(len(facets))
    prior = np.eye(len(facets)) * 10 * (width / 2.5) ** 2 / PRIOR_M**2
    for _ in range(10):
        robust = w / (1 + ((J @ change - r) / width) ** 2) ** 2
        H = (robust[:, None] * J).T @ J + prior
        change = np.linalg.solve(H, (robust * r) @ J - prior @ shift)
    inverse, left = np.linalg.inv(H), r - J @ change
    C = PRIOR_M**2 * prior[0, 0] ** 2 * inverse @ inverse  # what only the prior tells
    for e in np.unique(witness):
        mine = witness == e
        for move in (ASIDE_PX * robust[mine] @ J[mine] @ inverse, (robust[mine] * left[mine]) @ J[mine] @ inverse):
            C = C + np.outer(move, move)
    return shift + change, C, float(np.sqrt((robust * left**2).sum() / robust.sum()))


def _follows(model, edges, facets, edge, camera, p, normal):
    """(N, F) px: how far samples go along their normals with each facet's shift."""
    number = np.full(model.n_facets + 1, -1)
    number[facets] = np.arange(len(facets))
    x = camera.points(p)
    K, z = camera.K, x[:, 2]
    dq = np.zeros((len(p), 2, 3))
    dq[:, 0, 0], dq[:, 1, 1] = K[0, 0] / z, K[1, 1] / z
    dq[:, 0, 2], dq[:, 1, 2] = -K[0, 0] * x[:, 0] / z**2, -K[1, 1] * x[:, 1] / z**2
    along = np.einsum("ni,nij,jk->nk", normal, dq, camera.T_cam_world[:3, :3])  # px by m of the world
    J = np.zeros((len(p), len(facets)))
    for e in np.unique(edge):
        own = [f for f in edges.facets[e] if f >= 0 and number[f] >= 0]
        N = model.facet_normal[own]
        J[np.ix_(edge == e, number[own])] = along[edge == e] @ np.linalg.pinv(N)
    return J


def _displaced(model, facets, shift):
    """The model with facets moved along their normals; what they share with others is theirs alone afterwards."""
    if not shift.any():
        return model
    mine = np.isin(model.triangle_facet, facets)
    used, where = np.unique(model.triangles[mine], return_inverse=True)
    p = model.vertices[used]
    position = np.unique(p.round(9), axis=0, return_inverse=True)[1].reshape(-1)
    where = where.reshape(-1, 3)
    moved = p.copy()
    number = dict(zip(facets.tolist(), shift.tolist(), strict=True))
    owner = model.triangle_facet[mine]
    for place in np.unique(position):
        around = np.unique(owner[(position[where] == place).any(axis=1)])
        move = np.linalg.pinv(model.facet_normal[around], rcond=1e-3) @ [number[int(f)] for f in around]
        moved[position == place] += move
    triangles = model.triangles.copy()
    triangles[mine] = len(model.vertices) + where
    offset = model.facet_offset.copy()
    offset[facets] += shift
    return replace(
        model,
        vertices=np.concatenate([model.vertices, moved]),
        triangles=triangles.astype(np.int32),
        facet_offset=offset,
    )


def _surest(model, facets, shift, C, thing, up) -> Size | None:
    """The pair of opposite facets that is most surely further apart, or nearer."""
    normal, found = model.facet_normal[facets], []
    stands = _stands(model, facets, thing)
    known = np.sqrt(np.diag(C)) < 0.3 * PRIOR_M
    for i, j in zip(*np.nonzero(np.triu(normal @ normal.T < -0.999)), strict=True):
        a = np.zeros(len(facets))
        a[[k for k in (i, j) if known[k] or not stands[k]]] = 1  # what stands on something is where it is
        if known[a != 0].all() and a.any():
            by, sigma = float(a @ shift), float(np.sqrt(a @ C @ a))
            found.append((abs(by) / sigma, Size(model.objects[thing], by, sigma, tuple(normal[i]), up)))
    found = [(s, size) for s, size in found if s > SIGMAS and abs(size.by_m) > LEAST_M]
    return max(found, key=lambda f: f[0])[1] if found else None


def _stands(model, facets, thing):
    """(F,) bool: a facet lies on one of another object, face to face."""
    others = np.flatnonzero(model.facet_object != thing)
    n, d = model.facet_normal, model.facet_offset
    size = np.linalg.norm(np.ptp(model.vertices[np.unique(model.triangles)], axis=0))
    facing = n[facets] @ n[others].T < -0.999
    return (facing & (np.abs(d[facets][:, None] + d[others][None]) < 3e-4 * size)).any(axis=1)
