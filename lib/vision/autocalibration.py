"""The focal length of a pair's lenses from the two photographs alone, and how little that says.

    focal = focal_length(paths, greys)          # px, one sigma, and where it comes from

Three witnesses, each with its own sigma, joined by their weights in log f: what the camera wrote into the file (EXIF); right
angles, whose vanishing points fix f in a single photograph (Caprile and Torre 1990), so long as no two of the three directions
lie in the picture plane; the epipolar geometry. The last is blind exactly where a stereo pair of an object is usual:
optical axes that meet at equal distances (Sturm 1999), so it is asked last and believed least.
Square pixels, no distortion and an axis near the middle are assumed: CENTRE says how near.
"""

from dataclasses import dataclass

import numpy as np

from lib.given import cameras

CENTRE = 0.02  # of the picture's width: how far the axis may lie from the middle, one sigma
BENT = 0.1  # OpenCV's k1, one sigma: phones straighten their pictures, machine cameras do not
BENDS = (0.0, -0.15, -0.3, -0.5, 0.15)  # k1 / f^2 in widths where the search begins: to strong barrels of wide lenses
LEFT_OVER = 0.15  # of k1 in log f: one coefficient is a coarse description of a bent lens
EXIF = 0.05  # relative: rounding to mm, breathing with the focus, crops
DEFAULT, WIDE = 1.2, 0.35  # COLMAP's default focal length in widths, and sigma of log f of phones to short telephotos
USEFUL = 0.25  # a witness with a larger sigma of log f has seen nothing
MODEL = 0.005  # relative: one lens for both photographs, square pixels
TOLERANCE = np.radians(1.5)  # between a segment and the direction to its vanishing point


@dataclass(frozen=True)
class Focal:
    """f, sigma : px; assumed : nobody saw anything, f is a default; witnesses : [{from, f, sigma}]
    bent : {k1, sigma} of the radial distortion that straight edges show, or None"""

    f: float
    sigma: float
    assumed: bool
    witnesses: tuple
    bent: dict | None

    @property
    def origin(self):
        return (
            " and ".join(dict.fromkeys(w["from"] for w in self.witnesses))
            if self.witnesses
            else "assumed: a common lens"
        )


def exif(path):
    """px, or None: focal length noted in the file, with the sensor's size noted or known to COLMAP."""
    import pycolmap

    pycolmap.logging.minloglevel = 3
    if str(path).lower().endswith(".exr"):
        return None
    camera = pycolmap.infer_camera_from_image(path)
    return float(camera.mean_focal_length()) if camera.has_prior_focal_length else None


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
    """(N,) rad in [0, pi/2] between each segment and the direction from its middle to the vanishing point v (3,), homogeneous."""
    middle, along = ends.mean(1), ends[:, 1] - ends[:, 0]
    to = v[:2] - middle * v[2]
    cross = np.abs(along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0])
    return np.arctan2(cross, np.abs((along * to).sum(1)))


def vanishing(ends, size, random, hypotheses=4000):
    """(log f, its sigma, k1, its sigma) from three directions at right angles, or None where the picture shows no such.

    ends : (N, 2, 2) px; size : (w, h). Hypotheses: four segments, two vanishing points, f from their right angle; scored by the
    length of the segments that point to one of the three; then all of f, axis and rotation together, axis held by CENTRE."""
    if len(ends) < 8:
        return None
    width = max(size)
    x = (ends - (np.array(size) - 1) / 2) / width  # centred, in widths
    length = np.linalg.norm(x[:, 1] - x[:, 0], axis=1)
    best = (0.0, None, None, None)
    for bend in BENDS:  # a bent picture's edges meet nowhere, and Newton would not find the way
        straight = _straightened(x, [0.0, 0.0, 0.0, bend])
        homogeneous = np.concatenate([straight, np.ones((len(x), 2, 1))], -1)
        lines = np.cross(homogeneous[:, 0], homogeneous[:, 1])
        four = random.choice(len(x), (hypotheses // len(BENDS), 4), p=length / length.sum())
        v1, v2 = np.cross(lines[four[:, 0]], lines[four[:, 1]]), np.cross(lines[four[:, 2]], lines[four[:, 3]])
        with np.errstate(divide="ignore", invalid="ignore"):
            f2 = -(v1[:, :2] * v2[:, :2]).sum(1) / (v1[:, 2] * v2[:, 2])
        good = np.isfinite(f2) & (f2 > 0.3**2) & (f2 < 6.0**2)
        for a, b, f in zip(v1[good], v2[good], np.sqrt(f2[good])):
            R = _frame(a, b, f)
            angle = np.min([_towards(straight, R[:, k] * [f, f, 1]) for k in range(3)], axis=0)
            score = float((length * np.maximum(0, 1 - angle / TOLERANCE)).sum())
            if score > best[0]:
                best = (score, f, R, bend * f**2)
    if best[1] is None:
        return None
    return _polish(x, length, *best[1:], 0.7 / width)


def _frame(a, b, f):
    """(3, 3) rotation whose columns are the directions of two vanishing points (at right angles already) and their normal."""
    u = a / [f, f, 1]
    v = b / [f, f, 1]
    u = u / np.linalg.norm(u)
    v = v - u * (u @ v)
    v = v / np.linalg.norm(v)
    return np.stack([u, v, np.cross(u, v)], 1)


def _polish(x, length, f, R, k1, noise):
    """Gauss-Newton with Cauchy weights on log f, axis (2), radial distortion and rotation (3); residual: distance of a segment's end to the line from
    its middle to the vanishing point, in widths. noise : the ends' own, likewise."""

    def angles(state, R):
        K = np.array([[np.exp(state[0]), 0, state[1]], [0, np.exp(state[0]), state[2]], [0, 0, 1]])
        return K @ R

    def residual(state, R, which):
        v = angles(state, R)[:, which].T
        straight = _straightened(x, state)
        middle, end = straight.mean(1), straight[:, 1]
        to = v[:, :2] - middle * v[:, 2:]
        to = to / np.maximum(np.linalg.norm(to, axis=1, keepdims=True), 1e-12)
        d = end - middle
        return d[:, 0] * to[:, 1] - d[:, 1] * to[:, 0]

    def turned(R, w):
        return cameras.matrix_from_rt([*w, 0, 0, 0])[:3, :3] @ R

    state = np.array([np.log(f), 0.0, 0.0, k1])
    for _ in range(30):
        V = angles(state, R)
        off = np.stack([_towards(_straightened(x, state), V[:, k]) for k in range(3)], 1)
        which, near = off.argmin(1), off.min(1) < TOLERANCE
        e = residual(state, R, which)[near]
        scale = max(1.4826 * np.median(np.abs(e)), 0.3 * noise) if near.any() else noise
        weight = 1 / (1 + (e / scale) ** 2)
        J = np.stack(
            [
                (residual(state + h[:4], turned(R, h[4:]), which) - residual(state - h[:4], turned(R, -h[4:]), which))
                / 2e-6
                for h in 1e-6 * np.eye(7)
            ],
            1,
        )
        J = J[near]
        prior = np.diag([1, CENTRE**-2, CENTRE**-2, BENT**-2, 0, 0, 0]) * scale**2
        A = J.T @ (weight[:, None] * J) + prior
        g = J.T @ (weight * e) + prior[:, :4] @ [0, *state[1:]]
        try:
            step = np.linalg.solve(A, -g)
        except np.linalg.LinAlgError:
            return None
        step *= min(1.0, 0.2 / np.abs(step).max())
        state, R = state + step[:4], turned(R, step[4:])
        if np.abs(step).max() < 1e-8:
            break
    counts = np.bincount(which[near], minlength=3)
    share = length[near].sum() / length.sum()
    if share < 0.4 or np.sort(counts)[1] < 3 or not np.log(0.3) < state[0] < np.log(6.0):
        return None  # no room of right angles: one direction, or none
    # sandwich: segments of one edge err alike, and the residuals' tails are long
    meat = J.T @ ((weight * e)[:, None] ** 2 * J) + prior * scale**2
    inverse = np.linalg.inv(A)
    sigma = np.sqrt((inverse @ meat @ inverse)[0, 0])
    return (
        float(state[0]),
        float(np.hypot(sigma, LEFT_OVER * state[3])),
        float(state[3]),
        float(np.sqrt((inverse @ meat @ inverse)[3, 3])),
    )


def _straightened(x, state):
    """(N, 2, 2), without the radial distortion k1 = state[3], in tangents of the angle as OpenCV's: its inverse by fixed point."""
    centred = (x - state[1:3]) / np.exp(state[0])
    straight = centred
    for _ in range(4):
        straight = centred / np.maximum(1 + state[3] * (straight**2).sum(-1, keepdims=True), 0.3)
    return straight * np.exp(state[0]) + state[1:3]


def epipolar(size, q_left, q_right, random, samples=30):
    """(log f, sigma) of one lens for both photographs, in widths, by bundle over pose and f; None where the matches do not tell.

    The spread is the bootstrap's: near Sturm's critical motions it is as wide as the search, and the witness is dropped."""
    from lib.core.stage import BadInput
    from lib.vision import orientation

    width, height = size
    unit = max(size)
    pair = lambda log_f: cameras.Camera(
        np.array([[unit * np.exp(log_f), 0, (width - 1) / 2], [0, unit * np.exp(log_f), (height - 1) / 2], [0, 0, 1]]),
        width,
        height,
        np.eye(4),
    )
    starts = []
    for log_f in np.log([0.6, 1.0, 1.7]):
        try:
            camera = pair(log_f)
            starts.append((orientation.relative_pose(camera, camera, q_left, q_right, samples=0), log_f))
        except BadInput:
            continue
    if not starts:
        return None
    pose, log_f = min(starts, key=lambda s: (-s[0].inlier.sum(), s[0].rms_px))
    these = np.flatnonzero(pose.inlier)

    def residual(state, which):
        K = pair(state[1]).K
        return orientation.sampson(state[0], K, K, q_left[which], q_right[which])

    def solve(which, rt, log_f, steps):
        for _ in range(steps):
            e = residual((rt, log_f), which)
            scale = max(1.4826 * np.median(np.abs(e)), 0.02)
            J = np.stack(
                [
                    (
                        residual((orientation.moved(rt, h[:5]), log_f + h[5]), which)
                        - residual((orientation.moved(rt, -h[:5]), log_f - h[5]), which)
                    )
                    / 2e-6
                    for h in 1e-6 * np.eye(6)
                ],
                1,
            )
            weight = 1 / (1 + (e / scale) ** 2)
            A = J.T @ (weight[:, None] * J)
            A[5, 5] += scale**2 / 1.0**2  # log f within a factor of e, so that no step is endless
            g = J.T @ (weight * e)
            g[5] += scale**2 * log_f
            step = np.linalg.solve(A + 1e-12 * np.trace(A) * np.eye(6), -g)
            step *= min(1.0, 0.2 / np.abs(step).max())
            rt, log_f = orientation.moved(rt, step[:5]), float(np.clip(log_f + step[5], np.log(0.3), np.log(6.0)))
            if np.abs(step).max() < 1e-6:
                break
        return rt, log_f

    rt, log_f = solve(these, pose.rt_right_left, log_f, 30)
    others = [solve(random.choice(these, len(these)), rt, log_f, 8)[1] for _ in range(samples)]
    spread = float(np.sqrt(np.mean((np.array(others) - log_f) ** 2)))
    return log_f, float(np.hypot(spread, CENTRE))


def focal_length(paths, greys):
    """[Focal, Focal] of left and right; one lens where the photographs have one size."""
    from lib.vision import orientation

    random = np.random.default_rng(0)
    sizes = [grey.shape[::-1] for grey in greys]
    same = sizes[0] == sizes[1]
    witnesses = [[], []]
    for side, (path, grey, size) in enumerate(zip(paths, greys, sizes)):
        noted = exif(path)
        if noted:
            witnesses[side].append({"from": "EXIF", "log_f": float(np.log(noted / max(size))), "sigma": EXIF})
        found = vanishing(segments(grey), size, random)
        if found:
            witnesses[side].append(
                {"from": "right angles", "log_f": found[0], "sigma": found[1], "k1": found[2], "k1_sigma": found[3]}
            )
    if same:
        witnesses[0] = witnesses[1] = witnesses[0] + witnesses[1]
        if found := epipolar(sizes[0], *orientation.match(*greys), random):
            witnesses[0].append({"from": "epipolar geometry", "log_f": found[0], "sigma": found[1]})
    return [_join(w, max(size)) for w, size in zip(witnesses, sizes)]


def _join(witnesses, width):
    useful = [w for w in witnesses if w["sigma"] < USEFUL]
    edges = [w for w in useful if "k1" in w]
    weights = np.array([w["k1_sigma"] ** -2 for w in edges])
    bent = (
        {"k1": float(weights @ [w["k1"] for w in edges] / weights.sum()), "sigma": float(weights.sum() ** -0.5)}
        if edges
        else None
    )
    told = tuple(
        {
            "from": w["from"],
            "f": width * float(np.exp(w["log_f"])),
            "sigma": width * float(np.exp(w["log_f"])) * w["sigma"],
        }
        for w in useful
    )
    if not useful:
        return Focal(DEFAULT * width, DEFAULT * WIDE * width, True, (), None)
    log_f, sigma = np.array([w["log_f"] for w in useful]), np.array([w["sigma"] for w in useful])
    weight = sigma**-2
    mean, joint = float((weight * log_f).sum() / weight.sum()), weight.sum() ** -0.5
    if len(useful) > 1:  # witnesses that contradict each other are worth less (Birge 1932)
        joint *= max(1.0, np.sqrt((weight * (log_f - mean) ** 2).sum() / (len(useful) - 1)))
    f, joint = width * float(np.exp(mean)), np.hypot(joint, MODEL)
    return Focal(f, f * float(joint), False, told, bent)
