"""An object's pose by the sub-pixel edges of all photographs, and what they say for and against it."""

import math
from dataclasses import dataclass, replace

import numpy as np

from lib.given.cameras import rt_from_matrix
from lib.vision.objects.scenery import own_samples
from lib.vision.refinement.edges import find
from lib.vision.refinement.pose import covariance_by_edges, fit_edges
from lib.vision.refinement.rig import point, rms

CONTACT_M, CONTACT_SHARE = 5e-4, 1e-3  # how well a thing that stands on something does: m, and of its size
FREE_CHI2 = 21.1  # of the three numbers that a support fixes: beyond it, by chance once in 10,000, it does not
ASIDE_PX = 0.04  # that an edge as a whole may lie beside its place, one sigma: light, shadows, the sensor
HIT_PX, BESIDE_PX = 1.5, 9.0


@dataclass(frozen=True, eq=False)
class Support:
    """What an object stands on.  normal : (3,) unit, world;  point : (3,) m, of the object's middle, world"""

    normal: np.ndarray
    point: np.ndarray

    @property
    def _along(self):
        """Two unit vectors (3,) in the plane, across each other."""
        u = np.cross(self.normal, np.eye(3)[np.argmin(np.abs(self.normal))])
        u /= np.linalg.norm(u)
        return u, np.cross(self.normal, u)

    def basis(self, T_left_world):
        """(6, 3) steps (omega, tau) along the left camera's axes: two slides, and a turn about the normal."""
        R, (u, v) = T_left_world[:3, :3], self._along
        c, n = R @ self.point + T_left_world[:3, 3], R @ self.normal
        columns = [np.append(np.zeros(3), R @ u), np.append(np.zeros(3), R @ v), np.append(n, -np.cross(n, c))]
        return np.stack(columns, axis=1)

    def across(self, T_left_world):
        """(6, 3): a lift along the normal, and two turns that tilt."""
        R = T_left_world[:3, :3]
        c, columns = R @ self.point + T_left_world[:3, 3], [np.append(np.zeros(3), R @ self.normal)]
        for axis in self._along:
            columns.append(np.append(R @ axis, -np.cross(R @ axis, c)))
        return np.stack(columns, axis=1)


@dataclass(frozen=True, eq=False)
class Fitted:
    """T : T_world_object (4, 4);  covariance : (6, 6) of (omega, tau), T_left_object = exp(omega, tau) T_hat

    rms_px : robust;  support, chance, nats : of `evidence`;  number : of edge samples, all photographs together
    stands : whether it was held on its support
    """

    T: np.ndarray
    covariance: np.ndarray | None
    rms_px: float | None
    support: float
    chance: float
    nats: float
    number: int
    stands: bool = True


def evidence(scenery, thing, photographs):
    """(share of the object's predicted edges that are found, share found beside them, nats, number of samples).

    A sample every 5 px; five share their fate, so that an edge along another one is not twenty witnesses.
    """
    hits = beside = number = 0
    for s, levels in zip(
        own_samples(scenery, thing, photographs, 1, 4, step_px=5.0), photographs.pyramids, strict=True
    ):
        number += len(s.q)
        for shift in (0.0, BESIDE_PX, -BESIDE_PX):
            offset, strength, _ = find(levels[1], s.q + shift * s.normal, s.normal, HIT_PX)
            found = int(((strength > 0) & (np.abs(offset) < HIT_PX)).sum())
            hits, beside = (hits + found, beside) if shift == 0 else (hits, beside + found / 2)
    if number == 0:
        return 0.0, 0.0, 0.0, 0
    chance = min(max(beside / number, 0.05), 0.5)
    nats = (hits * math.log(0.8 / chance) + (number - hits) * math.log(0.2 / (1 - chance))) / 5
    return hits / number, chance, nats, number


def fitted(scenery, thing, T, photographs, support, schedule, final=False) -> Fitted:
    """The object from T_world_object, on its support where it has one.

    schedule : [(factor, reach px)]        final : the covariance too, and whether it stands on its support at all
    """
    left = photographs.T_left_world
    inverse = np.linalg.inv(left)
    window = photographs.window(scenery.points(thing) @ T[:3, :3].T + T[:3, 3])
    if window is None:
        return Fitted(T, None, None, 0.0, 0.0, 0.0, 0)

    def sampled(T_left, scale, factor, reach):
        T_world = inverse @ T_left
        out = []
        for s in own_samples(scenery.at(thing, T_world), thing, window, factor, reach):
            out.append(_in_frame(s, T_world))
        return out

    def solved(T, schedule, basis):
        trace = [point([], left @ T, None)]
        schedule = [(f, reach) for f, reach in schedule if all(f in levels for levels in window.pyramids)]
        T_left, _, fit = fit_edges(
            sampled, window.rig, window.pyramids, left @ T, 1.0, False, schedule, trace, basis=basis
        )
        return inverse @ T_left, fit

    basis = support.basis(left) if support else None
    T, fit = solved(T, schedule, basis)
    covariance, stands = None, support is not None
    if final and fit is not None:
        covariance = _covariance(fit)
        if support:
            size = np.linalg.norm(np.ptp(scenery.points(thing), axis=0))
            tilt = CONTACT_M / size + CONTACT_SHARE
            across = support.across(left) * [CONTACT_M, tilt, tilt]
            covariance = basis @ covariance @ basis.T + across @ across.T
            T, fit, covariance, stands = _freed(T, fit, covariance, support, solved, schedule, left)
    share, chance, nats, number = evidence(scenery.at(thing, T), thing, window)
    return Fitted(T, covariance, rms(fit.parts) if fit else None, share, chance, nats, number, stands)


def _covariance(fit):
    """By edges, and what each edge may lie aside in each photograph by itself: few edges do not tell how far."""
    H = np.linalg.pinv(fit.H)
    total = covariance_by_edges(fit)
    for (J, _, w), (edge, _) in zip(fit.parts, fit.at, strict=True):
        for e in np.unique(edge):
            move = H @ (w[edge == e] @ J[edge == e]) * ASIDE_PX
            total = total + np.outer(move, move)
    return total


def _freed(T, fit, covariance, support, solved, schedule, left):
    """Does the object stand where its support has it? Else it is free, as its edges have it."""
    T_free, fit_free = solved(T, schedule[-1:], None)
    if fit_free is None:
        return T, fit, covariance, True
    C = _covariance(fit_free)
    gap = rt_from_matrix(left @ T_free @ np.linalg.inv(left @ T))
    held = np.column_stack([support.basis(left), support.across(left)])
    numbers = np.linalg.solve(held, gap)[3:]
    if numbers[0] < -3 * CONTACT_M:
        return T, fit, covariance, True  # nothing sinks into what it stands on: it is lower than its model
    inverse = np.linalg.inv(held)
    own = (inverse @ C @ inverse.T)[3:, 3:]
    allowed = np.diag([CONTACT_M**2, CONTACT_SHARE**2, CONTACT_SHARE**2])
    if numbers @ np.linalg.solve(own + allowed, numbers) < FREE_CHI2 or rms(fit_free.parts) > rms(fit.parts):
        return T, fit, covariance, True
    return T_free, fit_free, C, False


def _in_frame(samples, T_world):
    """The samples with p in the object's own frame."""
    return replace(samples, p=(samples.p - T_world[:3, 3]) @ T_world[:3, :3])
