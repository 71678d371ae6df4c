"""Inverse problems that are made: a lamp, six patches with a cube's exact factors, tiles that see them at random.

The photograph is the model's own light, so the right answer is known to rounding.
"""

import numpy as np
from scipy.sparse import csr_array

from lib.analysis.fit import problem as problem_
from lib.given.transfer import Transfer
from tests.helpers.truths import CUBE


def made(
    rho,
    *,
    gamma=2.0,
    E=(1.5,),
    transfer="gamma",
    tiles=30,
    pixels=40,
    noise=0.0,
    given_E=True,
    unseen=(),
    seed=0,
    lamps=1,
):
    """A problem and its true state. rho : (5,) or (5, C) of the groups 1..5 (faces); face 0 is the lamp (black)."""
    rng = np.random.default_rng(seed)
    rho = np.asarray(rho, float)
    rho = rho[:, None] if rho.ndim == 1 else rho
    C = rho.shape[1]
    E = np.broadcast_to(np.asarray(E, float).reshape(-1, 1), (lamps, C))
    F = CUBE.copy()
    rho_all = np.vstack([np.zeros(C), rho])
    D = F[:, :1] * rng.uniform(0.3, 1.0, (6, lamps)) if lamps > 1 else F[:, :1]
    seen = [g for g in range(1, 6) if g not in unseen]
    group = np.repeat(np.array(seen, int), tiles)
    G = rng.uniform(0.02, 0.3, (len(group), 6)) * (group[:, None] != np.arange(6))
    D_tile = rng.uniform(0.02, 0.3, (len(group), lamps))
    b = np.stack(
        [np.linalg.solve(np.eye(6) - rho_all[:, [c]] * F, rho_all[:, c] * (D @ E[:, c])) for c in range(C)], axis=1
    )
    B = rho_all[group] * (D_tile @ E + G @ b)
    T = Transfer(transfer, gamma) if transfer == "gamma" else Transfer(transfer)
    shade = np.repeat(B, pixels, axis=0) * (1 + noise * rng.standard_normal((len(B) * pixels, C)))
    names = ("lamp", "a", "b", "c", "d", "e")
    known = np.full((6, C), np.nan)
    known[0] = 0
    problem = problem_.Problem(
        F=csr_array(F),
        D=D,
        patch_group=np.arange(6),
        area=np.ones(6),
        G=csr_array(G),
        G_plain=csr_array(G),
        D_tile=D_tile,
        tile_group=group,
        tile_object=np.zeros(len(group), int),
        start=np.arange(len(group) + 1) * pixels,
        pixels=T.display(np.maximum(shade, 0)),
        groups=names,
        lamps=names[:1] * lamps,
        emittance=E.copy() if given_E else np.full_like(E, np.nan),
        rho=known,
        transfer=Transfer(transfer, 2.2) if transfer == "gamma" else T,
        fit_transfer=transfer == "gamma",
        group_area=np.ones(6),
    )
    return problem, rho_all, b


COLOURS = np.array([[0.7, 0.3, 0.2], [0.2, 0.5, 0.4], [0.8, 0.8, 0.7], [0.1, 0.15, 0.3], [0.5, 0.45, 0.6]])
