"""The focal length of a pair's lenses from the two photographs alone, and how little that says.

    left, right = focal_length(paths, greys)          # Focal: px, one sigma, and where it comes from

Three witnesses, each with its own sigma, are joined by their weights in log f.

* What the camera wrote into the file (EXIF).
* Right angles: their vanishing points fix f in a single photograph (Caprile and Torre 1990), so long as no two of the
  three directions lie in the picture plane.
* The epipolar geometry. It is blind where a stereo pair of an object is usual: optical axes that meet at equal
  distances (Sturm 1999). So it is asked last and believed least.

Assumed are square pixels, no distortion but one radial term, and an axis near the middle: CENTRE says how near.
"""

import functools
from dataclasses import dataclass

import numpy as np

from lib.core.stage import BadInput
from lib.given import cameras
from lib.vision import orientation
from lib.vision.boards import SIDES

CENTRE = 0.02  # of the picture's width: how far the axis may lie from the middle, one sigma
BENT = 0.1  # OpenCV's k1, one sigma: phones straighten their pictures, machine cameras do not
BENDS = (0.0, -0.15, -0.3, -0.5, 0.15)  # k1 / f^2 in widths where the search begins: to strong barrels of wide lenses
LEFT_OVER = 0.15  # of k1 in log f: one coefficient is a coarse description of a bent lens
EXIF = 0.05  # relative: rounding to mm, breathing with the focus, crops
DEFAULT, WIDE = 1.2, 0.35  # COLMAP's default focal length in widths, and sigma of log f of phones to short telephotos
USEFUL = 0.25  # a witness with a larger sigma of log f has seen nothing
MODEL = 0.005  # relative: one lens for both photographs, square pixels
TOLERANCE = np.radians(1.5)  # between a segment and the direction to its vanishing point
SHORTEST, LONGEST = 0.3, 6.0  # focal lengths that are possible, in widths
SEGMENT_PX = 0.7  # how well a segment's end is placed
STEP = 1e-6  # of the numerical derivatives


@dataclass(frozen=True)
class Focal:
    """A focal length and who told it.

    f, sigma : px; assumed : nobody saw anything, f is a default; witnesses : ({from, f, sigma}, ...)
    bent : {k1, sigma} of the radial distortion that straight edges show, or None
    """

    f: float
    sigma: float
    assumed: bool
    witnesses: tuple
    bent: dict | None

    @property
    def origin(self):
        """Who told it, in words."""
        if not self.witnesses:
            return "assumed: a common lens"
        return " and ".join(dict.fromkeys(w["from"] for w in self.witnesses))


def _untraced(**point):
    pass


def exif(path):
    """px, or None: focal length noted in the file, with the sensor's size noted or known to COLMAP."""
    import pycolmap

    pycolmap.logging.minloglevel = 3
    if str(path).lower().endswith(".exr"):
        return None
    camera = pycolmap.infer_camera_from_image(path)
    return float(camera.mean_focal_length()) if camera.has_prior_focal_length else None


# ---- right angles ----


def segments(grey):
    """(N, 2, 2) px: straight edges, the longest first, at most 300, none shorter than a fortieth of the picture."""
    import cv2

    found = cv2.createLineSegmentDetector(cv2.LSD_REFINE_STD).detect(grey)[0]
    if found is None:
        return np.zeros((0, 2, 2))
    ends = found.reshape(-1, 2, 2).astype(float)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    order = np.argsort(-length)[:300]
    return ends[order][length[order] > max(grey.shape) / 40]


def _towards(ends, v):
    """(N,) rad in [0, pi/2] between each segment and the direction from its middle to v (3,), homogeneous."""
    middle, along = ends.mean(1), ends[:, 1] - ends[:, 0]
    to = v[:2] - middle * v[2]
    cross = np.abs(along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0])
    return np.arctan2(cross, np.abs((along * to).sum(1)))


def vanishing(ends, size, random, hypotheses=4000, trace=_untraced):
    """(log f, its sigma, k1, its sigma) from three directions at right angles, f in widths; None if none are seen.

    ends : (N, 2, 2) px; size : (w, h) px; trace : called with rms_px=... at each step of the polish

    A hypothesis is four segments: two vanishing points, and f from their right angle. Its score is the length of the
    segments that point to one of the three. The best is polished: f, k1, axis and rotation together.
    """
    if len(ends) < 8:
        return None
    width = max(size)
    x = (ends - (np.array(size) - 1) / 2) / width  # centred, in widths
    length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    best = (0.0, None, None, None)
    for bend in BENDS:  # a bent picture's edges meet nowhere, and Newton would not find the way
        straight = _straightened(x, [0.0, 0.0, 0.0, bend])
        for f, R in _hypotheses(straight, length, random, hypotheses // len(BENDS)):
            angle = np.min([_towards(straight, R[:, k] * [f, f, 1]) for k in range(3)], axis=0)
            score = float((length * np.maximum(0, 1 - angle / TOLERANCE)).sum())
            if score > best[0]:
                best = (score, f, R, bend * f**2)
    if best[1] is None:
        return None
    in_px = lambda rms: trace(rms_px=width * rms)
    return _polish(x, length, *best[1:], SEGMENT_PX / width, in_px)


def _hypotheses(straight, length, random, count):
    """(f in widths, rotation) of random fours of segments (N, 2, 2), long ones more often."""
    homogeneous = np.concatenate([straight, np.ones((len(straight), 2, 1))], -1)
    lines = np.cross(homogeneous[:, 0], homogeneous[:, 1])
    four = random.choice(len(straight), (count, 4), p=length / length.sum())
    v1, v2 = np.cross(lines[four[:, 0]], lines[four[:, 1]]), np.cross(lines[four[:, 2]], lines[four[:, 3]])
    with np.errstate(divide="ignore", invalid="ignore"):
        f2 = -(v1[:, :2] * v2[:, :2]).sum(1) / (v1[:, 2] * v2[:, 2])
    good = np.isfinite(f2) & (f2 > SHORTEST**2) & (f2 < LONGEST**2)
    for a, b, f in zip(v1[good], v2[good], np.sqrt(f2[good]), strict=True):
        yield f, _frame(a, b, f)


def _frame(a, b, f):
    """(3, 3) rotation: as columns the directions of two vanishing points, at right angles already, and their normal."""
    u = a / [f, f, 1]
    v = b / [f, f, 1]
    u = u / np.linalg.norm(u)
    v = v - u * (u @ v)
    v = v / np.linalg.norm(v)
    return np.stack([u, v, np.cross(u, v)], 1)


def _polish(x, length, f, R, k1, noise, trace):
    """`vanishing`'s answer: Gauss-Newton with Cauchy weights on log f, the axis (2), k1 and the rotation (3).

    x : (N, 2, 2), centred, and its length (N,), in widths; noise : of the ends, in widths
    trace : called with the RMS residual at each step, in widths
    """
    state = np.array([np.log(f), 0.0, 0.0, k1])
    for _ in range(30):
        V = _vanishing_points(state, R)
        off = np.stack([_towards(_straightened(x, state), V[:, k]) for k in range(3)], 1)
        which, near = off.argmin(1), off.min(1) < TOLERANCE
        e = _beside(x, state, R, which)[near]
        if len(e):
            trace(float(np.sqrt(np.mean(e**2))))
        scale = max(1.4826 * np.median(np.abs(e)), 0.3 * noise) if near.any() else noise
        weight = 1 / (1 + (e / scale) ** 2)
        J = _beside_derivatives(x, state, R, which)[near]
        prior = np.diag([1, CENTRE**-2, CENTRE**-2, BENT**-2, 0, 0, 0]) * scale**2
        A = J.T @ (weight[:, None] * J) + prior
        g = J.T @ (weight * e) + prior[:, :4] @ [0, *state[1:]]
        try:
            step = np.linalg.solve(A, -g)
        except np.linalg.LinAlgError:
            return None
        step *= min(1.0, 0.2 / np.abs(step).max())
        state, R = state + step[:4], _turned(R, step[4:])
        if np.abs(step).max() < 1e-8:
            break
    counts = np.bincount(which[near], minlength=3)
    share = length[near].sum() / length.sum()
    if share < 0.4 or np.sort(counts)[1] < 3 or not np.log(SHORTEST) < state[0] < np.log(LONGEST):
        return None  # no room of right angles: one direction, or none
    # sandwich: segments of one edge err alike, and the residuals' tails are long
    meat = J.T @ ((weight * e)[:, None] ** 2 * J) + prior * scale**2
    inverse = np.linalg.inv(A)
    covariance = inverse @ meat @ inverse
    sigma = np.sqrt(covariance[0, 0])
    return (
        float(state[0]),
        float(np.hypot(sigma, LEFT_OVER * state[3])),
        float(state[3]),
        float(np.sqrt(covariance[3, 3])),
    )


def _vanishing_points(state, R):
    """(3, 3), homogeneous, as columns, in widths."""
    K = np.array([[np.exp(state[0]), 0, state[1]], [0, np.exp(state[0]), state[2]], [0, 0, 1]])
    return K @ R


def _beside(x, state, R, which):
    """(N,) widths, signed: a segment's end beside the line from its middle to its vanishing point, which (N,)."""
    v = _vanishing_points(state, R)[:, which].T
    straight = _straightened(x, state)
    middle, end = straight.mean(1), straight[:, 1]
    to = v[:, :2] - middle * v[:, 2:]
    to = to / np.maximum(np.linalg.norm(to, axis=1, keepdims=True), 1e-12)
    d = end - middle
    return d[:, 0] * to[:, 1] - d[:, 1] * to[:, 0]


def _beside_derivatives(x, state, R, which):
    """(N, 7): of `_beside` by log f, the axis, k1 and the rotation."""
    at = lambda h: _beside(x, state + h[:4], _turned(R, h[4:]), which)
    return np.stack([(at(h) - at(-h)) / (2 * STEP) for h in STEP * np.eye(7)], 1)


def _turned(R, w):
    return cameras.matrix_from_rt([*w, 0, 0, 0])[:3, :3] @ R


def _straightened(x, state):
    """(N, 2, 2) without the radial distortion k1 = state[3], in tangents of the angle as OpenCV's.

    The inverse of the distortion, by fixed point.
    """
    centred = (x - state[1:3]) / np.exp(state[0])
    straight = centred
    for _ in range(4):
        straight = centred / np.maximum(1 + state[3] * (straight**2).sum(-1, keepdims=True), 0.3)
    return straight * np.exp(state[0]) + state[1:3]


# ---- epipolar geometry ----


def epipolar(size, q_left, q_right, random, samples=30, trace=_untraced):
    """(log f, sigma) of one lens for both photographs, f in widths, by bundle over pose and f; None if it cannot tell.

    size : (w, h) px; q_left, q_right : (N, 2) px, matched; trace : called with rms_px=... at each step

    The spread is the bootstrap's. Near Sturm's critical motions it is as wide as the search, and the witness is
    dropped.
    """
    starts = []
    for log_f in np.log([0.6, 1.0, 1.7]):
        try:
            camera = _pinhole(size, log_f)
            starts.append((orientation.relative_pose(camera, camera, q_left, q_right, samples=0), log_f))
        except BadInput:
            continue
    if not starts:
        return None
    pose, log_f = min(starts, key=lambda s: (-s[0].inlier.sum(), s[0].rms_px))
    these = np.flatnonzero(pose.inlier)

    def residual(state, which):
        rt, log_f = state
        K = _pinhole(size, log_f).K
        return orientation.sampson(rt, K, K, q_left[which], q_right[which])

    rt, log_f = _bundle(residual, these, pose.rt_right_left, log_f, 30, trace)
    others = [_bundle(residual, random.choice(these, len(these)), rt, log_f, 8)[1] for _ in range(samples)]
    spread = float(np.sqrt(np.mean((np.array(others) - log_f) ** 2)))
    return log_f, float(np.hypot(spread, CENTRE))


def _pinhole(size, log_f):
    """A Camera at the origin. size : (w, h) px; log_f : of the focal length in widths"""
    width, height = size
    f = max(size) * np.exp(log_f)
    K = np.array([[f, 0, (width - 1) / 2], [0, f, (height - 1) / 2], [0, 0, 1]])
    return cameras.Camera(K, width, height, np.eye(4))


def _bundle(residual, which, rt, log_f, steps, trace=_untraced):
    """(rt, log f) by Gauss-Newton with Cauchy weights. residual : ((rt, log f), which) -> (n,) px"""
    at = lambda h: residual((orientation.moved(rt, h[:5]), log_f + h[5]), which)
    for _ in range(steps):
        e = residual((rt, log_f), which)
        trace(rms_px=float(np.sqrt(np.mean(e**2))))
        scale = max(1.4826 * np.median(np.abs(e)), 0.02)
        J = np.stack([(at(h) - at(-h)) / (2 * STEP) for h in STEP * np.eye(6)], 1)
        weight = 1 / (1 + (e / scale) ** 2)
        A = J.T @ (weight[:, None] * J)
        A[5, 5] += scale**2 / 1.0**2  # log f within a factor of e, so that no step is endless
        g = J.T @ (weight * e)
        g[5] += scale**2 * log_f
        step = np.linalg.solve(A + 1e-12 * np.trace(A) * np.eye(6), -g)
        step *= min(1.0, 0.2 / np.abs(step).max())
        rt = orientation.moved(rt, step[:5])
        log_f = float(np.clip(log_f + step[5], np.log(SHORTEST), np.log(LONGEST)))
        if np.abs(step).max() < 1e-6:
            break
    return rt, log_f


# ---- the witnesses together ----


def focal_length(paths, greys, trace=_untraced):
    """[Focal, Focal] of left and right; one lens where the photographs have one size.

    paths : of the photographs, for their EXIF; greys : (H, W) uint8 each
    trace : called with step=, side= and rms_px=... at each step of a search
    """
    random = np.random.default_rng(0)
    sizes = [grey.shape[::-1] for grey in greys]
    same = sizes[0] == sizes[1]
    witnesses = [[], []]
    for side, (path, grey, size) in enumerate(zip(paths, greys, sizes, strict=True)):
        noted = exif(path)
        if noted:
            witnesses[side].append({"from": "EXIF", "log_f": float(np.log(noted / max(size))), "sigma": EXIF})
        traced = functools.partial(trace, step="right angles", side=SIDES[side])
        found = vanishing(segments(grey), size, random, trace=traced)
        if found:
            told = dict(zip(("log_f", "sigma", "k1", "k1_sigma"), found, strict=True))
            witnesses[side].append({"from": "right angles", **told})
    if same:
        witnesses[0] = witnesses[1] = witnesses[0] + witnesses[1]
        traced = functools.partial(trace, step="epipolar geometry", side="both")
        if found := epipolar(sizes[0], *orientation.match(*greys), random, trace=traced):
            witnesses[0].append({"from": "epipolar geometry", "log_f": found[0], "sigma": found[1]})
    return [_join(w, max(size)) for w, size in zip(witnesses, sizes, strict=True)]


def _join(witnesses, width):
    """Focal from [{from, log_f, sigma, ...}], f in widths; width : px."""
    useful = [w for w in witnesses if w["sigma"] < USEFUL]
    if not useful:
        return Focal(DEFAULT * width, DEFAULT * WIDE * width, True, (), None)
    told = tuple(
        {
            "from": w["from"],
            "f": width * float(np.exp(w["log_f"])),
            "sigma": width * float(np.exp(w["log_f"])) * w["sigma"],
        }
        for w in useful
    )
    log_f, sigma = np.array([w["log_f"] for w in useful]), np.array([w["sigma"] for w in useful])
    weight = sigma**-2
    mean, joint = float((weight * log_f).sum() / weight.sum()), weight.sum() ** -0.5
    if len(useful) > 1:  # witnesses that contradict each other are worth less (Birge 1932)
        joint *= max(1.0, np.sqrt((weight * (log_f - mean) ** 2).sum() / (len(useful) - 1)))
    f, joint = width * float(np.exp(mean)), np.hypot(joint, MODEL)
    return Focal(f, f * float(joint), False, told, _bent(useful))


def _bent(witnesses):
    """{k1, sigma} of the radial distortion, or None where nobody saw straight edges."""
    edges = [w for w in witnesses if "k1" in w]
    if not edges:
        return None
    weights = np.array([w["k1_sigma"] ** -2 for w in edges])
    k1 = float(weights @ [w["k1"] for w in edges] / weights.sum())
    return {"k1": k1, "sigma": float(weights.sum() ** -0.5)}
