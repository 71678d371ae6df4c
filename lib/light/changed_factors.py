"""The form factors of a changed scene from those of the scene as it was: only what the change touches is cast anew.

A ray that meets neither what was taken out nor what was put in ends where it ended. So each row is the stored one, less
the old ends and with the new ends of the few rays that do. The rays are those of `form_factors.rays`: the answer is
that of casting them all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lib.given.rays import Caster
from lib.light import form_factors
from lib.light import lamps as lamps_
from lib.light import surface as surfaces
from lib.light.adapt import sees_something
from lib.light.cells import Mesh, Tree
from lib.light.factors_file import FormFactors
from lib.light.form_factors import FormFactorRows, chunks, from_patches, located
from lib.light.form_factors_kernels import DROPPED, LOST
from lib.light.surface import Surface

FINER = 2.0  # patches of what is added are so many times narrower than the root cells of the scene


def changed(factors: FormFactors, before: Surface, after: Surface, lamps, *, n_rays=512) -> FormFactors:
    """The factors of the scene `after`, whose facets are those of `before`, some without triangles, and others.

    factors : lambertian and without the outside, as the file has them;  lamps : names of the groups that emit, the old
    ones first;  n_rays : of each patch whose row did not come from rays
    """
    mesh = _with_new_patches(factors.mesh, before, after)
    there = np.isin(mesh.side // 2, after.facet)
    rows = _rows(factors, mesh, before, after, there, n_rays)
    emitters = lamps_.emitters(after, lamps)
    D = lamps_.patch_direct(after, mesh, emitters, len(lamps), n_points=32)
    D[~there] = 0
    group = after.group[mesh.side // 2]
    area = surfaces.group_areas(after) * after.local.diagonal**2
    return FormFactors(mesh, rows, D, tuple(lamps), group, after.groups, area, factors.diagonal_m)


def touched(before: Surface, after: Surface) -> Caster:
    """What was taken out and what was put in, as it is cast."""
    there = [np.unique(s.facet[s.group[s.facet] >= 0]) for s in (before, after)]
    gone, more = np.setdiff1d(*there), np.setdiff1d(*there[::-1])
    own = [s.cast[np.isin(s.facet, f) & (s.group[s.facet] >= 0)] for s, f in ((before, gone), (after, more))]
    return Caster(np.concatenate(own))


def _with_new_patches(mesh: Mesh, before: Surface, after: Surface) -> Mesh:
    """The patches, and behind them those of sides that are new, or that light reaches only now."""
    sides = 2 * np.count_nonzero(after.group >= 0)
    start = np.append(mesh.table_start, np.full(sides - len(mesh.table_start), -1))
    shape = np.vstack([mesh.table_shape, np.ones((sides - len(mesh.table_shape), 2), np.int32)])
    free = (start < 0) & ~after.inside[:sides] & np.isin(np.arange(sides) // 2, after.facet)
    wanted = sees_something(after, np.flatnonzero(free))
    old = replace(mesh, table_start=start, table_shape=shape)
    if not len(wanted):
        return old
    coarse = 2 * np.sqrt(np.average(mesh.area, weights=mesh.area)) / FINER
    tree = Tree(after, wanted, coarse)
    tree.sort()
    new = tree.mesh()
    added = new.table_start >= 0
    return Mesh(
        np.concatenate([mesh.side, new.side]),
        np.concatenate([mesh.area, new.area]),
        np.concatenate([mesh.centre, new.centre]),
        np.concatenate([mesh.tri_start, mesh.tri_start[-1] + new.tri_start[1:]]).astype(mesh.tri_start.dtype),
        np.concatenate([mesh.tri_uv, new.tri_uv]),
        np.concatenate([mesh.tri_cdf, new.tri_cdf]),
        np.concatenate([mesh.tri_side, new.tri_side]),
        np.where(added, new.table_start + len(mesh.leaf), start),
        np.where(added[:, None], new.table_shape, shape).astype(np.int32),
        np.concatenate([mesh.leaf, np.where(new.leaf >= 0, new.leaf + len(mesh), -1)]).astype(np.int32),
        np.concatenate([mesh.parent, new.parent + mesh.parent.max(initial=-1) + 1]).astype(np.int32),
    )


def _rows(factors, mesh, before, after, there, n_rays) -> FormFactorRows:
    """(N',) rows of all patches, the stored ones corrected."""
    rows, n = factors.rows, len(factors.mesh)
    stored = int(rows.shot.max(initial=1))
    if stored == 1:  # not from rays
        stored = n_rays
    delta = _Delta(stored, len(mesh))
    caster = touched(before, after)
    ray_start, make = from_patches(after, mesh, stored)
    for first, last in chunks(ray_start[: n + 1]):
        rays = make(first, last)
        which = np.flatnonzero((caster.closest(rays)[0] >= 0) & np.repeat(there[first:last], stored))
        if len(which):
            some = rays[which]
            ends = [located(s, m, some, *s.caster.closest(some)) for s, m in ((before, factors.mesh), (after, mesh))]
            delta.add(first + which // stored, which % stored, *ends)
    corrected = delta.applied(rows, there[:n])
    if len(mesh) == n:
        return corrected
    return _stacked(corrected, form_factors.rays(after, mesh, n_rays=stored, begin=n))


class _Delta:
    """By how much the counts of stored rows change."""

    def __init__(self, n_rays, columns):
        self.n_rays, self.columns, self.parts = n_rays, columns, []

    def add(self, patch, number, old, new):
        """patch, number : (m,) of the rays;  old, new : where they ended and end"""
        changed = np.flatnonzero(old != new)
        self.parts.append([values[changed] for values in (patch, number, old, new)])

    def applied(self, rows: FormFactorRows, there) -> FormFactorRows:
        """The rows with the change. there : (n,) bool, patches that are still there"""
        from scipy.sparse import csr_array

        n = len(rows.valid)
        parts = self.parts or [[np.zeros(0, int)] * 4]
        patch, number, old, new = (np.concatenate(p) for p in zip(*parts, strict=True))
        early = number < (self.n_rays + 1) // 2
        scale = 1.0 if rows.shot.max(initial=1) > 1 else 1 / self.n_rays
        size = (n, self.columns)
        grown = lambda values: csr_array((values, rows.indices, rows.indptr), shape=size)

        def counted(which):
            plus, minus = which & (new >= 0), which & (old >= 0)
            row = np.concatenate([patch[plus], patch[minus]])
            column = np.concatenate([new[plus], old[minus]])
            value = scale * np.concatenate([np.ones(plus.sum()), -np.ones(minus.sum())])
            return csr_array((value, (row, column)), shape=size)

        keep = np.repeat(there, np.diff(rows.indptr))
        whole = (grown(np.where(keep, rows.count, 0).astype(float)) + counted(np.ones(len(patch), bool))).tocsr()
        half = (grown(np.where(keep, rows.half, 0).astype(float)) + counted(early)).tocsr()
        # both on the entries of the whole: a count that became 0 stays there as one
        both = (whole * 0 + half * 0 + abs(whole) + abs(half)).tocsr()
        both.sort_indices()
        indptr, indices = both.indptr.astype(np.int64), both.indices.astype(np.int32)
        row = np.repeat(np.arange(n), np.diff(indptr))
        at = lambda matrix: np.asarray(matrix[row, indices], np.float32).reshape(-1)
        tally = lambda kind, which: (
            scale
            * (
                np.bincount(patch[which & (new == kind)], minlength=n)
                - np.bincount(patch[which & (old == kind)], minlength=n)
            )
        )
        every = np.ones(len(patch), bool)
        alive = lambda values: np.where(there, values, 0).astype(np.float32)
        return FormFactorRows(
            indptr,
            indices,
            np.maximum(at(whole), 0),
            np.maximum(at(half), 0),
            alive(rows.valid - tally(DROPPED, every)),
            alive(rows.valid_half - tally(DROPPED, early)),
            rows.shot,
            alive(rows.lost + tally(LOST, every)),
            self.columns,
        )


def _stacked(a: FormFactorRows, b: FormFactorRows) -> FormFactorRows:
    """The rows of a, and behind them those of b."""
    names = ("indices", "count", "half", "valid", "valid_half", "shot", "lost")
    join = {name: np.concatenate([getattr(a, name), getattr(b, name)]) for name in names}
    return FormFactorRows(indptr=np.concatenate([a.indptr, a.indptr[-1] + b.indptr[1:]]), columns=b.columns, **join)
