"""Index buffers by rays: the same ids as OpenGL's, where there is no OpenGL."""

import numpy as np

from lib.buffers.viewport import TIE
from lib.core import packages


def caster(view):
    """Embree on the view's triangles: float32, hence the camera at the origin and the furthest vertex at 1."""
    open3d = packages.open3d()
    scene = open3d.t.geometry.RaycastingScene()
    corners = np.ascontiguousarray(view.p.reshape(-1, 3), np.float32)
    index = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    scene.add_triangles(open3d.core.Tensor(corners), open3d.core.Tensor(index))
    return scene


def cast(scene, view, v, plane) -> np.ndarray:
    """Rank of the triangle that each ray meets first, (n,) int; -1: none.

    scene : of `caster`        v : (n, 3) rays, z = 1, camera frame        plane : of `shared_planes`
    """
    open3d = packages.open3d()
    rays = np.zeros((len(v), 6), np.float32)
    rays[:, 3:] = v
    rank = scene.cast_rays(open3d.core.Tensor(rays))["primitive_ids"].numpy().view(np.int32).astype(np.int64)
    # Where several facets lie in one plane Embree names any of them. There look at all their triangles, in double
    # precision.
    hit_plane = np.where(rank >= 0, plane[rank], -1)
    order = np.argsort(hit_plane, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(hit_plane[order])) + 1):
        if len(part) and hit_plane[part[0]] >= 0:
            rank[part] = _settle(view, np.flatnonzero(plane == hit_plane[part[0]]), v[part], rank[part])
    return rank


def _settle(view, candidates, v, rank):
    """The highest rank among triangles of one plane that are as near as the nearest, for rays v (n, 3).

    candidates : ranks of the plane's triangles        rank : (n,) what Embree met
    """
    best = np.clip(np.einsum("ij,ij->i", view.slope[rank], v), view.low[rank], view.high[rank])
    winner = rank.copy()
    candidates = np.sort(candidates)
    p = view.p[candidates]
    past = np.cross(p, np.roll(p, -1, axis=1))  # v . (a x b): on which side of the edge ab the ray passes
    across = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    past *= np.sign(np.einsum("ti,ti->t", view.slope[candidates], across))[:, None, None]
    for t, edges in zip(candidates, past, strict=True):
        of = np.flatnonzero(winner < t)
        of = of[(v[of] @ edges.T >= 0).all(axis=1)]
        inverse = np.clip(v[of] @ view.slope[t], view.low[t], view.high[t])
        tied = inverse >= best[of] - TIE * (np.abs(v[of]) @ np.abs(view.slope[t]) + best[of])
        winner[of[tied]] = t
    return winner


def shared_planes(model, view) -> np.ndarray:
    """(N,) int: for each triangle of the view the number of a plane that it shares with other facets, either way round.

    -1 where it shares none.
    """
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
        left.append(np.tile(facet, 2))
        right.append(first[key])
    left, right = np.concatenate(left), np.concatenate(right)
    graph = coo_matrix((np.ones(len(left), bool), (left, right)), shape=(len(n), len(n)))
    number = connected_components(graph, directed=False)[1]
    number = np.where(np.bincount(number)[number] > 1, number, -1)
    return number[model.triangle_facet[view.triangle]]
