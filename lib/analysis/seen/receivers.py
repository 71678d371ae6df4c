"""Tiles of the photograph with the places of their pixels: what the camera receives, at once or by way of mirrors."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from lib.analysis.seen.gather import Gathered
from lib.light.form_factors import FormFactorRows, elements
from lib.light.surface import Surface, backproject

PER_TILE = ("facet", "group", "object", "chain", "direct", "lobe", "fit")
PER_PIXEL = ("pixel", "values", "p", "side", "direction")


@dataclass(eq=False)
class Receivers:
    """T tiles of M pixels, where those lie, and the light that reaches them.

    facet, group, object, chain : (T,) of the diffuse facet that is shown in the end, and the mirrors on the way
    start : (T + 1,);  pixel : (M,) flat;  values : (M, C) display;  p : (M, 3) local;  side : (M,)
    direction : (M, 3) of the view;  direct : (T, L);  rows : (T, N)
    lobe : (T,) specular group whose lobe it shows, -1;  fit : (T,) bool, used by the fit; the others audit it
    """

    facet: np.ndarray
    group: np.ndarray
    object: np.ndarray
    chain: np.ndarray
    start: np.ndarray
    pixel: np.ndarray
    values: np.ndarray
    p: np.ndarray
    side: np.ndarray
    direction: np.ndarray
    direct: np.ndarray
    rows: FormFactorRows
    lobe: np.ndarray
    fit: np.ndarray

    def __len__(self):
        return len(self.facet)

    @property
    def n_pixels(self):
        return np.diff(self.start)

    def take(self, which) -> Receivers:
        """The tiles numbered `which`."""
        n = self.n_pixels[which]
        at = elements(self.start, which)
        return Receivers(
            **{name: getattr(self, name)[which] for name in PER_TILE},
            **{name: getattr(self, name)[at] for name in PER_PIXEL},
            start=np.concatenate([[0], np.cumsum(n)]),
            rows=self.rows.take(which),
        )

    @staticmethod
    def joined(parts) -> Receivers:
        """Several sets of tiles as one."""
        parts = [part for part in parts if len(part)]
        rows = [part.rows for part in parts]
        in_rows = [f.name for f in fields(FormFactorRows) if f.name not in ("indptr", "columns")]
        return Receivers(
            **{name: np.concatenate([getattr(part, name) for part in parts]) for name in PER_TILE + PER_PIXEL},
            start=_starts(part.n_pixels for part in parts),
            rows=FormFactorRows(
                indptr=_starts(np.diff(r.indptr) for r in rows),
                columns=rows[0].columns,
                **{name: np.concatenate([getattr(r, name) for r in rows]) for name in in_rows},
            ),
        )


class Ways(NamedTuple):
    """Light by specular ways to tiles, by chain.

    G : (T, N) CSR;  D : (T, L);  G_spread, D_spread : half the difference of two samples of them
    """

    G: dict
    D: dict
    G_spread: dict
    D_spread: dict


def _starts(counts):
    return np.concatenate([[0], np.cumsum(np.concatenate(list(counts)))])


def directions(camera, pixel):
    """(M, 3) unit vectors from the camera through pixels (M,) flat, model's frame."""
    v = camera.rays(np.stack([pixel % camera.width, pixel // camera.width], axis=1).astype(float))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def placed(found: Gathered, surface: Surface, camera, fit: bool) -> Receivers:
    """Gathered tiles with the places of their pixels."""
    t = found.tiles
    p, side = backproject(surface, camera, np.repeat(t.facet, np.diff(t.start)), t.pixel)
    return _receivers(found, p, side, directions(camera, t.pixel), fit)


def unplaced(found: Gathered, fit=False) -> Receivers:
    """Gathered tiles without the places of their pixels: enough for an audit of diffuse groups."""
    none = np.zeros((0, 3))
    return _receivers(found, none, np.zeros(0, int), none, fit)


def _receivers(found, p, side, direction, fit):
    t, T = found.tiles, len(found.tiles)
    return Receivers(
        t.facet,
        found.group,
        found.object,
        np.zeros(T, np.int32),
        t.start,
        t.pixel,
        found.pixels,
        p,
        side,
        direction,
        t.direct,
        t.rows,
        lobe=np.full(T, -1, np.int32),
        fit=np.full(T, fit),
    )


def few(start, most):
    """At most so many elements of each set, evenly: the new start, and the numbers of those taken."""
    n = np.minimum(np.diff(start), most)
    k = np.arange(int(n.sum())) - np.repeat(np.cumsum(n) - n, n)
    chosen = np.repeat(start[:-1], n) + k * np.repeat(np.diff(start), n) // np.repeat(n, n)
    return np.concatenate([[0], np.cumsum(n)]), chosen
