"""§2.4 The non-linear refinement: the pose that puts the model's visible edges on the edges of both photographs.

    result = refine(model, sides, found)            # found : recognition.recognise.Recognition

From a pose the index buffer says which edges each camera sees. Samples along them search the photograph along
their normals for the greatest change, at sub-pixel; the pose (six numbers: the pair's relative pose is
fixed; seven where its scale is unknown) that brings the samples onto what they found comes from
Levenberg-Marquardt steps with a robust loss. From coarse pictures to fine ones, with new visibility at every step.

The paper moves the corners of facets onto the corners of their regions by plain gradient descent: method "paper".
"""

from dataclasses import dataclass, replace

import numpy as np

from lib.given.cameras import Camera, rt_from_matrix
from lib.vision.recognition import symmetry
from lib.vision.refinement.edges import STEP_PX, find, locate, model_edges, pyramid, visible_samples
from lib.vision.refinement.evidence import evidence_of, refuted, witnesses_of
from lib.vision.refinement.paper import paper_method
from lib.vision.refinement.rig import Fit, Rig, depth, gap_to_prior, moved_px, point, project, rig_of, rms, step, view


@dataclass(frozen=True, eq=False)
class Refined:
    """The refined pose, and what the photographs say of it.

    cameras : tuple of Camera          posed in the model's frame
    covariance : (6, 6)              of (omega, tau): T = exp(omega, tau) T_hat, left camera's axes, rad and m
    scale : m per unit of the pair's baseline; 1 where that is the metre; of an unknown lens: times its focal length
    focal_sigma : of an unknown lens, as a part of the focal length; None where the lens is known
    rms_px : of the residuals, robust
    support : share of the predicted edges that the photographs show; chance : share that would be found anywhere
    evidence : nats, from support against chance;  needed, least : evidence and support that an answer needs
    trace : list of dict              iteration, step, error_px, rt_cam_world, ...; cpu_s, wall_s of the process
    status, chosen, ambiguous         see refine
    """

    cameras: tuple
    covariance: np.ndarray
    scale: float
    rms_px: float
    support: float
    chance: float
    evidence: float
    trace: list
    needed: float = 0.0
    least: float = 0.0
    status: str = "unique"
    chosen: int = 0
    ambiguous: tuple = ()
    focal_sigma: float | None = None


WITNESS = 10  # samples that share their error, about


def _solve(rig, T, scale, found, sigma, free, prior, iterations=6, basis=None):
    """Levenberg-Marquardt on correspondences, with a Geman-McClure loss of width 2.5 sigma.

    found : [(p, q, normal, offset, weight)] per side; sigma : px; free : the scale too; prior : (H, T0, scale0) or None
    basis : (6, k), the steps that are allowed, or None for all; H and J are then of k numbers, and there is no prior
    Returns T, scale, the normal matrix, and [(J, residuals, robust weights)] per side.
    """
    size = basis.shape[1] if basis is not None else 7 if free else 6
    width = 2.5 * sigma

    def linearise(T, scale, jacobian):
        H, b, cost, parts = np.zeros((size, size)), np.zeros(size), 0.0, []
        if prior is not None:
            gap = gap_to_prior(prior, T, scale, size)
            H, b, cost = (
                WITNESS * sigma**2 * prior[0],
                WITNESS * sigma**2 * prior[0] @ gap,
                WITNESS * sigma**2 * gap @ prior[0] @ gap,
            )
        for side, (p, q, normal, offset, weight) in enumerate(found):
            if jacobian:
                now, dq = project(rig, side, T, scale, p, True, free)
            else:
                now = project(rig, side, T, scale, p)
            r = np.einsum("ij,ij->i", normal, now - q) - offset
            u = (r / width) ** 2
            cost += (weight * width**2 * u / (1 + u)).sum()
            robust = weight / (1 + u) ** 2
            if jacobian:
                J = np.einsum("ni,nik->nk", normal, dq)
                J = J if basis is None else J @ basis
                H += (robust[:, None] * J).T @ J
                b += (robust * r) @ J
                parts.append((J, r, robust))
        return H, b, cost, parts

    damping = 1e-4
    H, b, cost, parts = linearise(T, scale, True)
    for _ in range(iterations):
        A = H + damping * np.diag(np.diag(H) + 1e-12)
        delta = -np.linalg.lstsq(A, b, rcond=1e-14)[0]
        delta = delta if basis is None else basis @ delta
        T_new, scale_new = step(T, scale, delta)
        new_cost = linearise(T_new, scale_new, False)[2]
        if new_cost > cost:
            damping = max(10 * damping, 1e-3)
            if damping > 1e6:
                break
            continue
        gain = cost - new_cost
        T, scale, damping = T_new, scale_new, damping / 10
        H, b, cost, parts = linearise(T, scale, True)
        if gain < 1e-7 * max(cost, 1e-12):
            break
    return T, scale, H, parts


# The method.


def _edges_method(model, edges, rig, pyramids, T, scale, free, schedule, trace, prior=None):
    """`fit_edges` of the model's visible edges."""

    def sampled(T, scale, factor, reach):
        see = lambda camera: visible_samples(model, edges, camera, factor, step_px=3.0, reach=reach)
        return [see(camera) for camera in rig.cameras(T, scale)]

    return fit_edges(sampled, rig, pyramids, T, scale, free, schedule, trace, prior)


def fit_edges(sampled, rig, pyramids, T, scale, free, schedule, trace, prior=None, basis=None):
    """Runs a schedule [(factor, reach px)]; appends to the trace.

    sampled : (T, scale, factor, reach px) -> Samples per side, whose p are in the frame that T takes to the left
    camera: the world, or an object        basis : of `_solve`, for an object that slides on its support

    Returns T, scale and the last Fit, or None in its place where there were too few samples.
    """
    last, before = None, None
    for number, (factor, reach) in enumerate(schedule):
        final = number == len(schedule) - 1
        samples, drawn = None, None
        for _ in range(12 if final else 4):
            if drawn is None or moved_px(rig, drawn, T, scale) > 0.3 * factor:
                samples = sampled(T, scale, factor, max(int(reach) + 1, 5))
                drawn = (T, scale)
            found, at = [], []
            for side, s in enumerate(samples):
                q_full = project(rig, side, T, scale, s.p)
                if reach > 2:
                    offset, strength, doubt = find(
                        pyramids[side][factor], (q_full + 0.5) / factor - 0.5, s.normal, reach
                    )
                    good = (strength > 0) & (np.abs(offset) < reach) & (doubt < 0.9)
                    weight = (1 - doubt**2) * np.minimum(s.clear / 3, 1)
                else:
                    offset, spread, strength = locate(pyramids[side][1], q_full, s.normal, s.clear)
                    good = (strength > 0) & (spread < 1)
                    weight = STEP_PX**2 / (STEP_PX**2 + spread**2)
                found.append((s.p[good], q_full[good], s.normal[good], factor * offset[good], weight[good]))
                at.append((s.edge[good], len(s.q)))
            r = np.concatenate([f[3] for f in found])
            if len(r) < 20:
                return T, scale, None
            if trace[-1]["error_px"] is None:  # the start: what the first search sees
                trace[-1]["error_px"] = float(np.sqrt(np.mean(r**2)))
            sigma = max(1.4826 * float(np.median(np.abs(r))), 0.08 * factor)
            before = (T, scale)
            T, scale, H, parts = _solve(
                rig, T, scale, found, sigma, free, prior if factor > 1 or reach > 5 else None, 6, basis
            )
            last = Fit(H, parts, at, [(f[0], f[2]) for f in found])
            trace.append(point(trace, T, rms(parts), factor=factor, samples=len(r)))
            if moved_px(rig, before, T, scale) < (0.01 if final else 0.1) * factor:
                break
    return T, scale, last


def covariance_by_edges(fit):
    """Of the step, by clusters: errors along one edge go together, whatever their cause (lens, light, the model).

    So each edge is one witness, and the covariance is the jackknife's over edges. Leaving edge e out moves the solution
    by (H - A_e)^-1 g_e, with A_e and g_e the edge's share of the normal matrix and its gradient. The covariance is the
    sum of the squares (CR3; Bell and McCaffrey 2002). It knows that a long edge bends the solution towards itself.
    """
    size = len(fit.H)
    A, g = {}, {}
    for (J, r, w), (edge, _) in zip(fit.parts, fit.at, strict=True):
        order = np.argsort(edge, kind="stable")
        for part in np.split(order, np.flatnonzero(np.diff(edge[order])) + 1):
            if len(part):
                e = edge[part[0]]
                A[e] = A.get(e, np.zeros((size, size))) + (w[part, None] * J[part]).T @ J[part]
                g[e] = g.get(e, np.zeros(size)) + (w[part] * r[part]) @ J[part]
    unit = np.sqrt(np.maximum(np.diag(fit.H), 1e-300))
    scaled = np.outer(unit, unit)
    moves = np.array([np.linalg.lstsq((fit.H - A[e]) / scaled, g[e] / unit, rcond=1e-9)[0] for e in g])
    return moves.T @ moves / scaled


def _lens_covariance(fit, rig, T, scale, lens_px):
    """What the cameras' own error adds, each camera by itself.

    Principal points are known to lens_px, focal lengths so well that the picture's corners are.
    """
    inverse, total = np.linalg.pinv(fit.H), 0.0
    for side, (s, (J, _, w), (p, normal)) in enumerate(zip(rig.sides, fit.parts, fit.where, strict=True)):
        q = project(rig, side, T, scale, p)
        K = s.camera.K
        for change in (np.array([1.0, 0]), np.array([0, 1.0]), (q - K[:2, 2]) / np.hypot(K[0, 2], K[1, 2])):
            move = inverse @ ((w * (normal * change).sum(axis=1)) @ J) * lens_px
            total = total + np.outer(move, move)
    return total


def refine(
    model, sides, found, labels=None, *, method="edges", lens_px=0.1, certain=8.0, ln_hypotheses=0.0, is_zoom=False
) -> Refined:
    """The recognised poses refined and judged by the photographs.

    sides : Side of the left photograph, and of the right one if there is one
    found : recognition.recognise.Recognition, "unique" or "ambiguous"; each of its poses is refined
    labels : (N, 2) of the scene facets' regions, for method "paper"
    lens_px : how well the cameras' own projections are known: it goes into the covariance
    certain : nats by which the photographs must prefer a pose to call the others wrong
    ln_hypotheses : of how many poses `found` has the best: so much evidence the best of them has by chance
    is_zoom : the lone camera's focal length is unknown, and `scale` of the poses multiplies it

    status : "unique"; "ambiguous": other poses, among them those that a nearly symmetric model has, are not refuted;
    "symmetric": but for the equal ones of a model that comes onto itself; "not recognised"
    ambiguous : {rt_cam_world, support, error_px} of the others and the equal ones
    """
    rig = rig_of(
        sides,
        depth(model, Camera(sides[0].camera.K, sides[0].camera.width, sides[0].camera.height, found.poses[0].T)),
        is_zoom,
    )
    free = found.poses[0].covariance.shape == (7, 7)
    edges = model_edges(model)
    pyramids = [pyramid(side.photograph, 16) for side in sides]
    results = [
        _refine_one(model, edges, rig, pyramids, pose, free, method, labels, lens_px) for pose in found.poses[:MOST]
    ]
    order = sorted(range(len(results)), key=lambda k: -results[k].evidence)
    best, alike = results[order[0]], symmetry.motions(model)
    moved = lambda motion: best.cameras[0].T_cam_world @ motion.T
    own = [moved(motion) for motion in alike]
    equal = [T for T, motion in zip(own, alike, strict=True) if motion.is_exact]
    rivals = [results[k] for k in order[1:] if not _is_one_of(results[k], equal, rig)]
    rivals += [_unrefined(best, rig, T) for T, motion in zip(own, alike, strict=True) if not motion.is_exact]
    others = _not_refuted(model, edges, rig, pyramids, best, rivals, certain)
    status = "ambiguous" if others else "symmetric" if equal else "unique"
    unproved = found.status == "unproved"
    needed, least = ln_hypotheses + PROOF, SHOWN if unproved else LEAST
    unseen = best.support < least
    elsewhere = any(not _is_one_of(other, own, rig) for other in others)  # what the model's shape does not account for
    if unproved and (elsewhere or best.evidence < needed or unseen) or unseen and method == "edges":
        status = "not recognised"
    as_good = [(r.cameras[0].T_cam_world, r.support, r.rms_px) for r in others]
    as_good += [(T, best.support, best.rms_px) for T in equal]
    ambiguous = tuple({"rt_cam_world": rt_from_matrix(T), "support": s, "error_px": px} for T, s, px in as_good)
    return replace(best, needed=needed, least=least, status=status, chosen=order[0], ambiguous=ambiguous)


def _is_one_of(result, poses, rig):
    """Is it one of these poses (4, 4)?"""
    camera = result.cameras[0]
    return any(_near(camera, replace(camera, T_cam_world=T), rig.depth) for T in poses)


def _unrefined(best, rig, T):
    """The best pose where the model is brought nearly onto itself; what the photographs say of it is not known yet."""
    inverse = np.linalg.inv(best.cameras[0].T_cam_world)
    cameras = tuple(replace(c, T_cam_world=c.T_cam_world @ inverse @ T) for c in best.cameras)
    return replace(best, cameras=cameras, rms_px=None)


def _not_refuted(model, edges, rig, pyramids, best, rivals, certain):
    """The rivals that the photographs do not refute, each place once."""
    if not rivals:
        return []
    of = lambda r: witnesses_of(model, edges, _posed(rig, r), pyramids, r.cameras[0].T_cam_world, 1.0)
    witnesses, others = of(best), []
    for rival in rivals:
        if any(_near(rival.cameras[0], other.cameras[0], rig.depth) for other in (best, *others)):
            continue
        seen = of(rival)
        if not refuted(witnesses, seen, best.support, max(best.chance, 0.02), certain):
            found = np.concatenate([hit for _, _, hit, _ in seen])
            others.append(replace(rival, support=float(found.mean()) if len(found) else 0.0))
    return others


MOST = 8  # poses that are refined and listed
PROOF = 20.0  # nats of the photographs, beyond ln(hypotheses)
SHOWN = 0.7  # of the edges that a pose predicts, where nothing but the photographs proves it
LEAST = 0.5  # where the facets prove it too: right ones show .76 to .97 in random rooms, other models up to .48
ENOUGH = 50.0  # nats with which no coarser start is tried


def _posed(rig, result):
    """The rig of a result, its lengths in metres, its lenses known."""
    inverse = np.linalg.inv(result.cameras[0].T_cam_world)
    relative = tuple(camera.T_cam_world @ inverse for camera in result.cameras)
    if rig.is_zoom:
        sides = tuple(replace(side, camera=c) for side, c in zip(rig.sides, result.cameras, strict=True))
        rig = replace(rig, sides=sides, is_zoom=False)
    return replace(rig, relative=relative)


def _near(a, b, depth):
    """Did two starts end at the same pose?"""
    turn = np.linalg.norm(a.T_cam_world[:3, :3] - b.T_cam_world[:3, :3])
    return turn < 0.02 and np.linalg.norm(a.centre - b.centre) < 0.02 * depth


def _refine_one(model, edges, rig, pyramids, pose, free, method, labels, lens_px):
    """A recognition.Pose refined, from the finest start to coarser ones, until the photographs support the result.

    If they support none without doubt, the result that they support most.
    """
    start = point([], pose.linear, None, step="linear")
    prior = (np.linalg.inv(9 * pose.covariance), pose.T, pose.scale)
    if method == "paper":
        trace = [start]
        T, error = paper_method(model, rig, pose.T, pose.scale, pose.matches, labels, trace)
        support, chance, evidence = evidence_of(model, edges, rig, pyramids, T, pose.scale)
        return Refined(
            rig.cameras(T, pose.scale), pose.covariance[:6, :6], pose.scale, error, support, chance, evidence, trace
        )
    wanted, factor, tried = _start_px(rig, pose), 1, []
    while True:
        schedule = [(f, reach) for f in (16, 8, 4, 2, 1) if f <= factor for reach in (8.0, 5.0)]
        trace = [dict(start)]
        T, scale, fit = _edges_method(model, edges, rig, pyramids, pose.T, pose.scale, free, schedule, trace, prior)
        support, _, evidence = evidence_of(model, edges, rig, pyramids, T, scale)
        tried.append((evidence, T, scale, trace))
        factor *= 2
        if (support > 0.7 and evidence > ENOUGH) or factor not in pyramids[0] or 4 * factor > wanted:
            break
    _, T, scale, trace = max(tried, key=lambda t: t[0])
    final = [(1, 3.0), (1, 2.0)]
    if free and not rig.is_zoom:
        T, scale, _ = _edges_method(model, edges, rig, pyramids, T, scale, free, final[:1], trace)
        rig, T, scale, fit, held = _each_alone(model, edges, rig, pyramids, T, scale, final, trace)
    else:
        T, scale, fit = _edges_method(model, edges, rig, pyramids, T, scale, free, final, trace)
        held = rig
    support, chance, evidence = evidence_of(model, edges, rig, pyramids, T, scale)
    covariance = pose.covariance
    if fit is not None:
        covariance = covariance_by_edges(fit)
        if rig.is_zoom:  # seven numbers are many for the few edges of one photograph
            number = len(np.unique(fit.at[0][0]))
            covariance = covariance * number / max(number - len(fit.H), 1)
        covariance = covariance + _lens_covariance(fit, held, T, scale, lens_px)
    return Refined(
        rig.cameras(T, scale),
        covariance[:6, :6],
        scale,
        rms(fit.parts) if fit else None,
        support,
        chance,
        evidence,
        trace,
        focal_sigma=float(np.sqrt(covariance[6, 6])) if rig.is_zoom else None,
    )


def _each_alone(model, edges, rig, pyramids, T, scale, schedule, trace):
    """Each camera to its own edges: for a relative pose that was estimated from the photographs, up to scale.

    The model knows it better. Returns the rig as it was found, the left pose, the scale (m per baseline), the left
    camera's fit and the rig of that fit.
    """
    poses, fits, rigs = [], [], []
    for side, camera in enumerate(rig.cameras(T, scale)):
        alone = Rig((rig.sides[side],), (np.eye(4),), rig.depth)
        pose, _, fit = _edges_method(
            model,
            edges,
            alone,
            pyramids[side : side + 1],
            camera.T_cam_world,
            1.0,
            False,
            schedule,
            trace if side == 0 else trace[:1],
        )
        poses.append(pose), fits.append(fit), rigs.append(alone)
    relative = [pose @ np.linalg.inv(poses[0]) for pose in poses]
    if len(poses) > 1:
        scale = float(np.linalg.norm(relative[1][:3, 3]))
        relative[1][:3, 3] /= scale
    return Rig(rig.sides, tuple(relative), rig.depth), poses[0], scale, fits[0], rigs[0]


def _start_px(rig, pose):
    """3 sigma of where the pose puts corners and middle of the picture, px."""
    _, x = view(rig)
    _, J = project(rig, 0, pose.T, pose.scale, (x - pose.T[:3, 3]) @ pose.T[:3, :3], True)
    C = J @ pose.covariance[:6, :6] @ J.transpose(0, 2, 1)
    return 3 * float(np.sqrt(np.median(np.trace(C, axis1=1, axis2=2))))
