"""The pose and the places of objects that the photograph's edges ask for, before any photometry.

    found = register(model, camera, photograph)
    if found.explained:
        camera, model = found.camera(camera), found.model(model)

The index buffer says which edges of the model the camera sees. Across each piece of an edge the photograph has peaks;
one of them, or none, is that edge. The motions that put most pieces on peaks are found by cause: the camera, its
principal point, single objects. A cause is taken if it wins by 10 nats on edges that it was not fitted to, and the
model is drawn anew until nothing moves. Last, edges are placed to a hundredth of a pixel, and the covariance is that of
the scatter from edge to edge (docs/decisions/registration.md).
"""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from lib.given.cameras import Camera, rt_from_matrix
from lib.vision.refinement.edges import model_edges, pyramid
from lib.vision.registration.motions import Block, State, World, corrected_camera, corrected_model
from lib.vision.registration.pieces import edge_owner, lines, mean_by, pieces_of, samples_of
from lib.vision.registration.placing import covariance, place, solve
from lib.vision.registration.selection import CENTRE, ENOUGH, POSE, Selection, Sight

DRAWINGS = 5  # at most, while causes are looked for
SETTLED_PX = 0.3  # what a sample has moved since the model was drawn
LINE_M = 2e-3
LOOSE_M = 0.01  # how well people place the objects that they draw
TOGETHER = (
    2.0  # so many times worse than its lines say is the place of an object: the shadow at its foot pulls them all
)
LOST = 0.6  # of the edges that chance has not found, the least that must be there
QUIET = 0.02  # contrast of noise, 4 % of the light, from which it hides edges: 10 % leave .35 of them in a white room
COARSEST, SEARCH_PX, PLACING_PX = (
    16,
    600,
    1200,
)  # causes are sought in pictures 600 to 1200 px wide, and placed in wider


@dataclass(frozen=True, eq=False)
class Moved:
    """An object that does not stand where the model has it.

    rt : (6,) Rodrigues vector and m, the model as given to the model as corrected        covariance : (6, 6)
    """

    rt: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Registration:
    """What the edges say.

    pose : (6,) Rodrigues vector and m, takes the given camera's coordinates to the corrected ones; None: as given
    covariance : (6, 6) of (omega, tau), corrected coordinates = exp(omega, tau) x those of `pose`; None with it
    centre_px : (2,) to be added to cx and cy; None: as given        centre_covariance : (2, 2)
    objects : {name: Moved}
    nats : {cause: nats} by which what was taken wins against the same without it, the others fitted anew
    rivals : the same of the camera's other cause, in place of the one that was taken
    alone : {cause: nats} by which single causes win against the given files before anything has moved
            causes: "pose", "principal_point", ("objects", name), ("turn", name)
    before_px, after_px : median distance of the edges from where the photograph has them
    loose : {name: (6, 6) covariance of the turn and move, world} of objects left where they are: what the edges do not
        tell, if the model is good to LOOSE_M
    seen : Seen, how many of them the photograph has, as given and as corrected
    n_edges : straight lines that were found        missing : {name: share of its silhouette that is found}
    """

    pose: np.ndarray | None
    covariance: np.ndarray | None
    centre_px: np.ndarray | None
    centre_covariance: np.ndarray | None
    objects: dict
    nats: dict
    rivals: dict
    alone: dict
    before_px: float
    after_px: float
    n_edges: int
    missing: dict
    seen: "Seen"
    loose: dict
    trace: list = field(default_factory=list)
    state: State = field(default_factory=State)

    @property
    def explained(self) -> bool:
        """Whether the given files have to be corrected."""
        return self.pose is not None or self.centre_px is not None or bool(self.objects)

    def camera(self, camera):
        """The given camera, corrected."""
        return corrected_camera(camera, self.state.correction, self.state.centre_px)

    def model(self, model):
        """The given model, corrected."""
        return corrected_model(model, self.state.objects)


def reduced(camera, factor) -> Camera:
    """The camera of a picture that is `factor` times smaller; each of its pixels is a square of the photograph's."""
    K = np.array([[1 / factor, 0, 0.5 / factor - 0.5], [0, 1 / factor, 0.5 / factor - 0.5], [0, 0, 1]]) @ camera.K
    return Camera(K, camera.width // factor, camera.height // factor, camera.T_cam_world)


class Registrar:
    """One photograph, and the model that is drawn into it."""

    def __init__(self, model, camera, level, fixed=()):
        """camera : of the whole photograph        level : Level, the photograph reduced level.factor times"""
        self.world = World(model, reduced(camera, level.factor), fixed)
        self.level = level

    def sight(self, state) -> Sight:
        """The model drawn where the state has it."""
        world = self.world
        model = world.model_at(state)
        edges = model_edges(model)
        owner = edge_owner(model, edges, world.span)
        samples = samples_of(world, state, model, edges, owner, lines(edges, owner, LINE_M))
        p = world.moved(state, samples.p, samples.owner)
        depth = float(np.median(world.camera_at(state).points(p)[:, 2])) if len(p) else 1.0
        return Sight(state, samples, pieces_of(samples, self.level), p, depth)

    def search(self):
        """(blocks, Sight, worth, rivals, alone, trace): causes are added drawing by drawing, then losers taken back."""
        state, blocks, alone, trace = State(), [], None, []
        for _ in range(DRAWINGS):
            sight = self.sight(state)
            if len(sight.pieces.edge) < 8:
                return [], sight, {}, {}, alone or {}, trace
            selection = Selection(self.world, sight)
            more, numbers, said = selection.forward(blocks)
            alone = said if alone is None else alone
            moved = np.abs(selection.jacobian(more) @ numbers).max(initial=0)
            trace.append({"causes": len(more), "moved_px": float(moved), "sigma_px": selection.sigma})
            new, blocks = len(more) > len(blocks), more
            state = self.world.step(state, blocks, numbers)
            if not new and moved < SETTLED_PX:
                break
        if not blocks:
            return [], sight, {}, {}, alone, trace
        return *self._backward(blocks, state), alone, trace

    def _backward(self, blocks, state):
        """(blocks, sight, {block: nats}, {rival: nats}): what still wins where all has settled."""
        swapped = False
        while True:
            sight = self.sight(state)
            selection = Selection(self.world, sight)
            worth = {block: selection.worth(blocks, block) for block in blocks}
            spare = {block: selection.spare(nats, block) for block, nats in worth.items()}
            worst = min(spare, key=spare.get, default=None)
            rivals = selection.instead(blocks)
            if worst is not None and spare[worst] < 0:
                gone, new = worst, []
            elif not swapped and any(nats > worth[CENTRE if rival == POSE else POSE] for rival, nats in rivals.items()):
                gone, new = next(b for b in blocks if b in (POSE, CENTRE)), list(rivals)
                swapped = True
            else:
                return blocks, sight, worth, rivals
            blocks, state = self._exchanged(blocks, state, selection, gone, new)

    def _exchanged(self, blocks, state, selection, gone, new):
        """(blocks, state) with one cause taken back and others put in its place, all fitted anew."""
        blocks = [b for b in blocks if b != gone and not (gone.kind == "object" and b.thing == gone.thing)] + new
        state = self.world.without(state, gone)
        x, start = selection.at(state), np.zeros(sum(self.world.size(b) for b in blocks))
        numbers = selection.fitted(blocks, x, np.ones(len(x), bool), None if new else start)
        return blocks, self.world.step(state, blocks, numbers)

    def result(self, blocks, sight, worth, rivals, alone, trace) -> Registration:
        """The edges placed at sub-pixel, the causes fitted to them.  sight : of this picture"""
        state, factor = sight.state, self.level.factor
        for _ in range(3):
            state, moved, fit = self._placed(blocks, sight, state)
            if moved > SETTLED_PX:
                sight = self.sight(state)
            elif moved < 0.02:
                break
        parts = self._parts(blocks, fit[0], state)
        nats, rivals, alone = ({self._cause(b): n for b, n in said.items()} for said in (worth, rivals, alone))
        before, after, n_edges = self._offsets(sight, state)
        world = self.world
        return Registration(
            rt_from_matrix(state.correction) if "pose" in parts else None,
            parts.get("pose"),
            factor * state.centre_px if "principal_point" in parts else None,
            factor**2 * parts["principal_point"] if "principal_point" in parts else None,
            {world.model.objects[k]: Moved(rt_from_matrix(T), parts[k]) for k, T in state.objects.items()},
            nats,
            rivals,
            alone,
            factor * before,
            factor * after,
            n_edges,
            missing(world, sight),
            seen(sight.pieces, self.level.noise),
            self._loose(sight, state),
            trace,
            replace(state, centre_px=factor * state.centre_px),
        )

    def _cause(self, block):
        """A block's name outside."""
        if block.thing < 0:
            return block.kind
        return ("objects" if block.kind == "object" else "turn", self.world.model.objects[block.thing])

    def _placed(self, blocks, sight, state):
        """(state, px it moved, (covariance,)) after one fit to placed edges."""
        if not blocks:
            return state, 0.0, (np.zeros((0, 0)),)
        world, s = self.world, sight.samples
        placed = self._place(sight, state)
        c = placed.chosen
        prior = world.prior(blocks, sight.depth)
        if len(c) < len(prior):
            return state, 0.0, (np.diag(prior**2),)
        p = world.moved(state, s.p[c], s.owner[c])
        J = np.einsum("ni,nik->nk", s.normal[c], world.jacobian(state, blocks, p, s.owner[c]))
        numbers, H, ridge, w = solve(J, placed.offset, placed.weight, prior)
        spread = covariance(J, placed.offset - J @ numbers, w, H, s.edge[c], ridge, prior)
        return world.step(state, blocks, numbers), float(np.abs(J @ numbers).max(initial=0)), (spread,)

    def _loose(self, sight, state):
        """{name: (6, 6)} of every movable object that stays where it is."""
        world, s, found = self.world, sight.samples, {}
        placed = self._place(sight, state)
        c = placed.chosen
        p = world.moved(state, s.p[c], s.owner[c])
        for thing in set(map(int, world.movable)) - state.objects.keys():
            block, mine = Block("object", thing), np.flatnonzero(s.owner[c] == thing)
            size = world.size(block)
            prior, spread = np.full(size, LOOSE_M), LOOSE_M**2 * np.eye(size)
            if len(mine) >= 3 * size:
                of = c[mine]
                J = np.einsum("ni,nik->nk", s.normal[of], world.jacobian(state, [block], p[mine], s.owner[of]))
                offset = placed.offset[mine]
                numbers, H, ridge, w = solve(J, offset, placed.weight[mine], prior)
                spread = covariance(J, offset - J @ numbers, w, H, s.edge[of], ridge, prior)
            spread = np.linalg.inv(np.linalg.inv(TOGETHER**2 * spread) + np.eye(size) / LOOSE_M**2)
            way = world.twist(state, block)
            found[world.model.objects[thing]] = way @ spread @ way.T
        return found

    def _place(self, sight, state):
        """Where the photograph has the samples of a sight, from where the state has them."""
        s = sight.samples
        q = np.nan_to_num(self.world.project(state, s.p, s.owner), nan=-1e3)
        x = mean_by(s.piece, np.einsum("ni,ni->n", s.normal, q - s.q))
        return place(self.level, s, q, sight.pieces, x)

    def _parts(self, blocks, spread, state):
        """{cause: covariance}: of the pose (6, 6), of the principal point (2, 2), of each object by index (6, 6)."""
        at, maps = 0, {}
        for block in blocks:
            n = self.world.size(block)
            key = block.kind if block.thing < 0 else block.thing
            way = np.eye(n) if block.thing < 0 else self.world.twist(state, block)
            maps.setdefault(key, []).append((slice(at, at + n), way))
            at += n
        parts = {}
        for key, pieces in maps.items():
            which = np.concatenate([np.arange(at)[part] for part, _ in pieces])
            way = np.concatenate([way for _, way in pieces], axis=1)
            parts[key] = way @ spread[np.ix_(which, which)] @ way.T
        return parts

    def _offsets(self, sight, state):
        """(median px before, after, lines found)."""
        world, s = self.world, sight.samples
        if len(s.q) == 0:
            return 0.0, 0.0, 0
        q = world.project(state, s.p, s.owner)
        placed = self._place(sight, state)
        fine = ~placed.coarse
        c, offset = placed.chosen[fine], placed.offset[fine]
        if len(c) == 0:
            return 0.0, 0.0, 0
        there = world.project(State(), s.p, s.owner)
        shift = np.einsum("ni,ni->n", s.normal[c], (there - q)[c])
        before = np.abs(np.nan_to_num(offset - shift, nan=1e3))
        return float(np.median(before)), float(np.median(np.abs(offset))), len(np.unique(s.edge[c]))


class Seen(NamedTuple):
    """Shares of the model's edges. found : that the photograph has;  chance : that it has 8 px beside them, too

    pieces : of edges that were looked at;  noise : of Level, what hides edges
    """

    found: float
    chance: float
    pieces: float = np.inf
    noise: float = 0.0

    @property
    def is_lost(self):
        """The photograph hardly shows these edges: nothing can be learnt from them."""
        least = LOST * QUIET / max(self.noise, QUIET)
        return self.found < self.chance + least * (1 - self.chance)

    @property
    def nats(self):
        """What so many found pieces are worth against chance: of a few that happen to be there little."""
        found, chance = np.clip([self.found, self.chance], 0.02, 0.98)
        each = found * np.log(found / chance) + (1 - found) * np.log((1 - found) / (1 - chance))
        return float(self.pieces * each) if found > chance else 0.0

    @property
    def is_surely_lost(self):
        """Not by chance, of few edges: another place, another model, or other units."""
        unsure = np.sqrt(self.found * (1 - self.found) / max(self.pieces, 1))
        return self._replace(found=self.found + unsure).is_lost


def seen(pieces, noise=0.0, near_px=2.5, beside_px=8.0) -> Seen:
    """How many pieces of edges that a photograph can show are where they should be. noise : of its Level"""
    pieces = pieces.part(~pieces.smooth)
    if len(pieces.edge) == 0:
        return Seen(0.0, 0.0, 0.0, noise)
    hit = lambda x: ((np.abs(pieces.offset - x) < near_px) & (pieces.share > 0)).any(axis=1)
    beside = (hit(0.0 - beside_px).astype(float) + hit(beside_px)) / 2
    w = pieces.weight
    found, chance = (float(np.average(h, weights=w)) for h in (hit(0.0), beside))
    return Seen(found, chance, float(w.sum() ** 2 / (w**2).sum()), noise)


def missing(world, sight, near_px=2.5, beside_px=8.0):
    """{name: share found} of objects most of whose silhouette the photograph has not.

    An object is missing if its pieces are found hardly more often than anything is found 8 px beside, and the odds
    against its being there are ENOUGH nats.
    """
    pieces, s = sight.pieces, sight.samples
    if len(pieces.edge) == 0:
        return {}
    outer = mean_by(s.piece, s.silhouette.astype(float)) > 0.5
    hit = lambda x: ((np.abs(pieces.offset - x) < near_px) & (pieces.share > 0)).any(axis=1)
    here, beside = hit(0.0), (hit(beside_px).astype(float) + hit(-beside_px)) / 2
    answer = {}
    for thing in world.movable:
        mine = outer & (pieces.owner == thing)
        rest = outer & ~mine
        if len(np.unique(pieces.edge[mine])) < 3 or not rest.any():
            continue
        there = np.clip(np.average(here[rest], weights=pieces.weight[rest]), 0.05, 0.97)
        chance = np.clip(np.average(beside[outer], weights=pieces.weight[outer]), 0.03, 0.9)
        w, found = pieces.weight[mine], here[mine]
        nats = (w * np.where(found, np.log(chance / there), np.log((1 - chance) / (1 - there)))).sum()
        if nats >= ENOUGH:
            answer[world.model.objects[thing]] = float(np.average(found, weights=w))
    return answer


def register(model, camera, photograph, fixed=()) -> Registration:
    """The pose and the objects' places that the edges of the photograph ask for.

    model, camera : as given        photograph : image.Photograph        fixed : names of objects that stay
    """
    levels = pyramid(photograph, COARSEST)
    search, placing = (max(f for f in levels if f == 1 or camera.width >= f * px) for px in (SEARCH_PX, PLACING_PX))
    registrar = Registrar(model, camera, levels[search], fixed)
    blocks, sight, *said = registrar.search()
    if placing != search:
        registrar = Registrar(model, camera, levels[placing], fixed)
        state = replace(sight.state, centre_px=search / placing * sight.state.centre_px)
        sight = registrar.sight(state)
    return registrar.result(blocks, sight, *said)
