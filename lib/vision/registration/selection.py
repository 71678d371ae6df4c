"""Which causes the edges ask for: none, the pose, the principal point, objects, or several of them.

The camera's causes are judged on edges that they were not fitted to. An object has too few edges to leave some out: it
is judged by the marginal likelihood of all edges (Laplace), which is that of edges foretold one after the other. A
cause is taken if it wins by ENOUGH nats.
"""

from dataclasses import dataclass

import numpy as np

from lib.vision.registration.likelihood import FOLDS, curvature, fit, folds, log_likelihood, scatter
from lib.vision.registration.motions import Block
from lib.vision.registration.pieces import REACH_PX, mean_by

ENOUGH = 10.0  # nats
OF_CAMERA = 20.0  # nats of the pose or the principal point where all has settled: the edges of a bare room are few, and
# one of them that is badly seen weighs much
OFFERED = 5.0  # nats of an object while causes are looked for: it is judged again where all has settled
LINES, SEEN_PX = 2, 60.0  # of an object, at least, to be moved
TURN_LINES = 5
PREFERRED = 5.0  # nats of the pose before the principal point
GRID_PX = 1.5
POSE, CENTRE = Block("pose"), Block("principal_point")
NEAR = (1.0, 0.5)  # px, the widths of a fit that starts near


@dataclass(frozen=True, eq=False)
class Sight:
    """What one drawing of the model shows.

    samples, pieces        p : (N, 3) m, the samples as the state has them        depth : m, median of the samples
    """

    state: object
    samples: object
    pieces: object
    p: np.ndarray
    depth: float


class Selection:
    """The causes of one sight, judged by cross-validation."""

    def __init__(self, world, sight):
        self.world, self.sight = world, sight
        self.pieces = sight.pieces
        self.fold = folds(self.pieces)
        self._columns = {}
        self.sigma = self._scatter()

    def _scatter(self):
        """px: of the edges about where the better camera puts them, the one that is or the best other."""
        x = np.zeros(len(self.pieces.edge))
        sigma = scatter(self.pieces, x)
        for _ in range(2):
            J = self.jacobian([POSE])
            numbers = fit(self.pieces, J, x, self.world.prior([POSE], self.sight.depth), sigma)
            sigma = min(sigma, scatter(self.pieces, x + J @ numbers))
        return sigma

    def jacobian(self, blocks):
        """(M, n) px per unit, of the pieces along their normals."""
        parts = [np.zeros((len(self.pieces.edge), 0))]
        for block in blocks:
            if block not in self._columns:
                s = self.sight.samples
                J = self.world.jacobian(self.sight.state, [block], self.sight.p, s.owner)
                self._columns[block] = mean_by(s.piece, np.einsum("ni,nik->nk", s.normal, J))
            parts.append(self._columns[block])
        return np.concatenate(parts, axis=1)

    def at(self, state):
        """(M,) px: where another state has the pieces, along their normals."""
        s = self.sight.samples
        q = self.world.project(state, self.world_points(), s.owner)
        gap = np.einsum("ni,ni->n", s.normal, np.nan_to_num(q - s.q, nan=1e6))
        return mean_by(s.piece, gap)

    def world_points(self):
        return self.sight.samples.p

    def candidates(self, taken, camera):
        """Blocks that may be added."""
        found = [] if POSE in taken or CENTRE in taken else list(camera)  # they say nearly the same
        edge, first = np.unique(self.pieces.edge, return_index=True)
        lines = np.bincount(self.pieces.owner[first], minlength=len(self.world.model.objects))
        px = np.bincount(self.pieces.owner, self.pieces.px, len(self.world.model.objects))
        for thing in self.world.movable[(lines[self.world.movable] >= LINES)]:
            if px[thing] < SEEN_PX:
                continue
            if Block("object", int(thing)) not in taken:
                found.append(Block("object", int(thing)))
            elif self.world.axes(thing)[1] is not None and lines[thing] >= TURN_LINES:
                found.append(Block("turn", int(thing)))
        return [block for block in found if block not in taken]

    def fitted(self, blocks, x, train, start=None):
        """(n,) numbers fitted to the pieces `train` (M,) bool."""
        if not blocks:
            return np.zeros(0)
        prior = self.world.prior(blocks, self.sight.depth)
        J = self.jacobian(blocks)[train]
        part = self.pieces.part(train)
        if start is None:
            return fit(part, J, x[train], prior, self.sigma)
        return fit(part, J, x[train], prior, self.sigma, start, NEAR)

    def starts(self, block, x, train):
        """Starts (1,) or (n,) numbers of one block, the others fixed at x."""
        if block.kind != "object":
            return [np.zeros(self.world.size(block))]
        mine = np.flatnonzero(train & (self.pieces.owner == block.thing))
        part, J = self.pieces.part(mine), self.jacobian([block])[mine]
        n = J.shape[1]
        each = GRID_PX if n == 2 else 2 * GRID_PX
        unit = each / np.maximum(np.sqrt((J**2).mean(axis=0)), 1e-9)
        unit = np.minimum(unit, 0.03)
        half = int(REACH_PX / each)
        grid = np.stack(np.meshgrid(*n * [np.arange(-half, half + 1)], indexing="ij"), axis=-1).reshape(-1, n) * unit
        prior = self.world.prior([block], self.sight.depth)
        value = log_likelihood(x[mine, None] + J @ grid.T, part, each).sum(axis=0)
        value = value - 0.5 * ((grid / prior) ** 2).sum(axis=1)
        best = np.argsort(-value)[:1]
        return [np.zeros(n), *grid[best]]

    def extended(self, blocks, numbers, block, x, train):
        """(n + k,) numbers of blocks and one more, the best of several starts."""
        J = self.jacobian(blocks)
        all_blocks = [*blocks, block]
        if block in (POSE, CENTRE):
            if not blocks:
                return self.fitted(all_blocks, x, train)
            alone = self.fitted([block], x + J @ numbers, train)
            return self.fitted(all_blocks, x, train, np.concatenate([numbers, alone]))
        return np.concatenate([numbers, self._alone(block, x + J @ numbers, train)])

    def _alone(self, block, x, train):
        """Numbers of an object's block, all else fixed: only its own pieces move."""
        mine = train & (self.pieces.owner == block.thing)
        if not mine.any():
            return self._zeros([block])
        J, part = self.jacobian([block])[mine], self.pieces.part(mine)
        tried = [self.fitted([block], x, mine, start) for start in self.starts(block, x, train)]
        return max(tried, key=lambda v: log_likelihood(x[mine] + J @ v, part, self.sigma).sum())

    def nats(self, blocks, x, per_fold):
        """Log-likelihood of the edges left out.  per_fold : FOLDS times (n,) numbers fitted to the others"""
        J, total = self.jacobian(blocks), 0.0
        for f, numbers in enumerate(per_fold):
            mine = self.fold == f
            total += log_likelihood(x[mine] + J[mine] @ numbers, self.pieces.part(mine), self.sigma).sum()
        return float(total)

    def trains(self):
        return [self.fold != f for f in range(FOLDS)]

    def held_out(self, blocks, x, start=None):
        """(nats, per-fold numbers) of blocks that are fitted together from x."""
        per_fold = [self.fitted(blocks, x, train, start) for train in self.trains()]
        return self.nats(blocks, x, per_fold), per_fold

    def forward(self, taken):
        """(blocks, (n,) numbers, {block: nats}): causes are added while one wins; nats of each as the first.

        Objects that moved alike look like a pose in part, so the camera has to win against objects alone.
        """
        found = self._added(taken, (POSE, CENTRE))
        camera = [b for b in found[0] if b in (POSE, CENTRE) and b not in taken]
        rivals = [b for b, nats in found[2].items() if b.thing >= 0 and nats > 0 and b not in found[0]]
        if not camera or not rivals:
            return found
        other = self._added(taken, ())
        if set(other[0]) <= set(found[0]):
            return found
        return max((found, other), key=lambda way: self.marginal(way[0], way[1]))[:2] + (found[2],)

    def marginal(self, blocks, numbers):
        """Nats of all edges with these causes, up to a constant: Laplace."""
        if not blocks:
            return float(log_likelihood(np.zeros(len(self.fold)), self.pieces, self.sigma).sum())
        J, prior = self.jacobian(blocks), self.world.prior(blocks, self.sight.depth)
        x = J @ numbers
        fits = log_likelihood(x, self.pieces, self.sigma).sum() - 0.5 * ((numbers / prior) ** 2).sum()
        return float(fits - self._occam(J, x, prior))

    def _added(self, taken, camera):
        """The same, with the causes `camera` of the camera, or none."""
        x = np.zeros(len(self.pieces.edge))
        everything = np.ones(len(x), bool)
        blocks = list(taken)
        near = self._zeros(blocks)
        numbers = self.fitted(blocks, x, everything, near)
        nats, per_fold = self.held_out(blocks, x, near) if camera else (0.0, None)
        alone = None
        while True:
            offers, judged = self._offers(blocks, numbers, per_fold, x, nats, camera)
            alone = judged if alone is None else alone
            if not offers:
                return blocks, numbers, alone
            if any(block.thing < 0 for _, block, _ in offers):
                blocks, numbers = self._best_of(blocks, offers)
                numbers = self.fitted(blocks, x, everything, numbers)
            else:  # the camera fixed, objects know nothing of each other
                numbers = np.concatenate([numbers, *[more[len(numbers) :] for _, _, more in offers]])
                blocks = [*blocks, *[block for _, block, _ in offers]]
                numbers = self.fitted(blocks, x, everything, numbers)
            if camera:
                nats, per_fold = self.held_out(blocks, x, numbers)

    def _best_of(self, blocks, offers):
        """(blocks, numbers) with the offer that wins by most.

        A turn of the camera does nearly what a moved principal point does, but not the other way round: a wrong pose
        does little harm, a wrong principal point leaves errors. So the pose is taken unless it is clearly the worse.
        """
        best = max(offers, key=lambda offer: offer[0])
        if best[1] == CENTRE:
            best = next((o for o in offers if o[1] == POSE and o[0] > best[0] - PREFERRED), best)
        return [*blocks, best[1]], best[2]

    def _offers(self, blocks, numbers, per_fold, x, nats, camera):
        """[(gain, block, numbers)] of those that win by enough, {block: nats} of all near ones."""
        everything = np.ones(len(x), bool)
        here = log_likelihood(x + self.jacobian(blocks) @ numbers, self.pieces, self.sigma).sum()
        offers, judged = [], {}
        for block in self.candidates(blocks, camera):
            more = self.extended(blocks, numbers, block, x, everything)
            J = self.jacobian([*blocks, block])
            if log_likelihood(x + J @ more, self.pieces, self.sigma).sum() - here < OFFERED:
                continue
            if block.kind in ("object", "turn"):
                gain = self.evidence(blocks, numbers, block, more, x)
            else:
                folded = [
                    self.extended(blocks, old, block, x, train)
                    for old, train in zip(per_fold, self.trains(), strict=True)
                ]
                gain = self.nats([*blocks, block], x, folded) - nats
            judged[block] = gain
            if gain >= (OFFERED if block.thing >= 0 else ENOUGH):
                offers.append((gain, block, more))
        return offers, judged

    def evidence(self, blocks, numbers, block, more, x):
        """Nats by which blocks at `more` win against those without the last one, at `numbers`: Laplace."""
        J = self.jacobian([*blocks, block])
        posterior = lambda J, v, prior: (
            log_likelihood(x + J @ v, self.pieces, self.sigma).sum() - 0.5 * ((v / prior) ** 2).sum()
        )
        prior = self.world.prior([*blocks, block], self.sight.depth)
        n = len(numbers)
        gain = posterior(J, more, prior) - posterior(J[:, :n], numbers, prior[:n])
        return float(gain - self._occam(J[:, n:], x + J @ more, prior[n:]))

    def _occam(self, J, x, prior):
        """Nats that the freedom of numbers costs: how much smaller the posterior is than the prior."""
        H = curvature(self.pieces, J, x, self.sigma) + np.diag(1 / prior**2)
        return 0.5 * np.linalg.slogdet(H)[1] + np.log(prior).sum()

    def worth(self, blocks, block):
        """Nats by which the state wins against one without this cause, the others fitted anew."""
        gone = [b for b in blocks if b == block or (block.kind == "object" and b == Block("turn", block.thing))]
        rest = [b for b in blocks if b not in gone]
        zero = np.zeros(len(self.pieces.edge))
        x = self.at(self.world.without(self.sight.state, block))
        if block.kind in ("object", "turn"):
            return self._worth_of_object(gone, rest, x)
        full = self.held_out(blocks, zero, self._zeros(blocks))[0]
        return full - max(self.held_out(rest, x, start)[0] for start in (self._zeros(rest), None))

    def spare(self, nats, block):
        """By how much a cause wins beyond what it must: where more objects may have moved, chance has more of them."""
        return nats - (OF_CAMERA if block in (POSE, CENTRE) else ENOUGH + np.log(max(len(self.world.movable), 1)))

    def instead(self, blocks):
        """{block: nats} of the camera's other cause in place of the one that was taken, against neither."""
        camera = [b for b in blocks if b in (POSE, CENTRE)]
        if len(camera) != 1:
            return {}
        rest = [b for b in blocks if b not in camera]
        x = self.at(self.world.without(self.sight.state, camera[0]))
        other = CENTRE if camera[0] == POSE else POSE
        none, full = (
            max(self.held_out(b, x, start)[0] for start in (self._zeros(b), None)) for b in (rest, [*rest, other])
        )
        return {other: full - none}

    def _zeros(self, blocks):
        return np.zeros(sum(self.world.size(block) for block in blocks))

    def _worth_of_object(self, gone, rest, x):
        """The same for an object, by the marginal likelihood.  x : (M,) px without it"""
        zero, everything = np.zeros(len(x)), np.ones(len(x), bool)
        numbers = self.fitted(rest, x, everything, self._zeros(rest))
        with_it = log_likelihood(zero, self.pieces, self.sigma).sum()
        without = log_likelihood(x + self.jacobian(rest) @ numbers, self.pieces, self.sigma).sum()
        prior = self.world.prior(gone, self.sight.depth)
        return float(with_it - without - self._occam(self.jacobian(gone), zero, prior))
