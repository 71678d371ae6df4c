"""How facets reflect beyond rho_d, and the numbered ways by which light comes past them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.light import ward_kernels as kernels
from lib.light.surface import Surface

DIFFUSE, MIRROR, GLOSSY = 0, 1, 2


@dataclass(frozen=True)
class Finish:
    """How facets reflect beyond rho_d. M specular groups.

    groups : (M,) numbers of the groups;  kind : (M,) MIRROR or GLOSSY;  alpha : (M, 2) Ward's
    tangent : (M, 3) direction of alpha_x, model's frame;  form : of lib/light/ward.py
    """

    groups: tuple
    kind: np.ndarray
    alpha: np.ndarray
    tangent: np.ndarray
    form: int = kernels.BOUNDED

    def __len__(self):
        return len(self.groups)

    def only(self, which):
        """The finish of the specular groups numbered `which` alone."""
        return replace(
            self,
            groups=tuple(self.groups[m] for m in which),
            kind=self.kind[which],
            alpha=self.alpha[which],
            tangent=self.tangent[which],
        )

    def equals(self, other):
        """Whether two finishes are the same to the last bit, so that rays follow the same ways."""
        return (
            other is not None
            and self.groups == other.groups
            and self.form == other.form
            and all(np.array_equal(getattr(self, n), getattr(other, n)) for n in ("kind", "alpha", "tangent"))
        )

    def facets(self, surface: Surface):
        """The number of each facet's specular group, -1, (F,) int32, and the tangent frame in its plane (F, 2, 3)."""
        number = np.full(len(surface.groups) + 1, -1, np.int32)  # the last is that of the lids
        number[list(self.groups)] = np.arange(len(self.groups))
        of = number[surface.group]
        axes = np.array(surface.axes)
        for f in np.flatnonzero(of >= 0):
            if self.kind[of[f]] == GLOSSY and self.tangent[of[f]].any():
                axes[f] = kernels.frame(surface.normal[f], self.tangent[of[f]])
                axes[f, 1] *= surface.hand
        return of, axes


class Chains:
    """The numbered ways by which light comes: how often it met each specular group. Number 0: not at all.

    count : of each number, where chains are read from a file
    """

    def __init__(self, n_groups, count=()):
        self.count = [tuple(map(int, c)) for c in count] or [(0,) * n_groups]
        self._number = {c: k for k, c in enumerate(self.count)}

    def __len__(self):
        return len(self.count)

    def then(self, chain, group):
        """Numbers (n,) of the chains `chain` (n,) with one more meeting of `group` (n,)."""
        M = len(self.count[0])
        pair = np.asarray(chain, np.int64) * M + group
        table = np.zeros(len(self) * M, np.int32)
        for both in np.flatnonzero(np.bincount(pair, minlength=len(table))):
            k, g = divmod(int(both), M)
            table[both] = self.number(tuple(c + (m == g) for m, c in enumerate(self.count[k])))
        return table[pair]

    def number(self, count):
        """Of a tuple of M counts; a new one where it has none."""
        if count not in self._number:
            self._number[count] = len(self.count)
            self.count.append(count)
        return self._number[count]

    def joined(self, a, b):
        """Number of the chain that is a and then b."""
        return self.number(tuple(x + y for x, y in zip(self.count[a], self.count[b], strict=True)))

    @property
    def counts(self):
        """(K, M) int."""
        return np.array(self.count, int).reshape(len(self.count), -1)

    def power(self, rho_s):
        """(K, C): the product of rho_s (M, C) along each chain."""
        return np.prod(rho_s[None] ** self.counts[:, :, None], axis=1)

    def total(self, rho_s, F, D, b, E):
        """(R, C): what specular ways bring of the light b (N, C) and E (L, C); the number 0 where there are none.

        F, D : {chain: (R, N)}, {chain: (R, L)}
        """
        power = self.power(rho_s)
        return sum(power[k] * (A @ light) for parts, light in ((F, b), (D, E)) for k, A in parts.items())

    def slope(self, rho_s, m):
        """(K, C): derivative of `power` with respect to rho_s[m]."""
        n = self.counts
        lower = n.copy()
        lower[:, m] = np.maximum(lower[:, m] - 1, 0)
        return n[:, m, None] * np.prod(rho_s[None] ** lower[:, :, None], axis=1)
