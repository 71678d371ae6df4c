"""The pose, and where it is unknown the focal length, from picked points and lines, some of which may be wrong.

    found = solve(picks, camera, focal_known=False)     # picks : lib.given.picks.Picks

A picked place is right, with normal noise of its sigma times one factor that all share, or anywhere in the picture.
Poses and that factor are found together by expectation and maximisation of this mixture (Torr and Zisserman, MLESAC,
2000) from several starts, of which the likeliest answer stays. A start is pycolmap's absolute pose by LO-RANSAC (from
points), or one of many views of what was picked (from lines alone). Of a line each picked end tells its distance from
the model's line in the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import lgamma

import numpy as np

from lib.core.stage import BadInput
from lib.given.cameras import Camera, matrix_from_rt, towards
from lib.given.picks import LEAST, Picks

STEP = 1e-6  # of a parameter, for derivatives
FOCAL_STARTS = (0.8, 1.2, 2.0)  # over the picture's larger side, where it is unknown
MOST_WRONG = 0.6  # of what was picked
CHANCE = 10.0  # nats by which the right ones must beat chance, where some are wrong
LEAST_MISREAD = 6  # points: fewer agree with some camera whatever they are
FEW, COARSE = 5, 2.0  # places with an unknown focal length that check nothing;  factor worth a word
WRONG = 0.5  # probability of being wrong, from which it is an outlier
LARGEST_FACTOR = 6.0  # of the noise over what the file says
LOOSE_FOCAL = 0.3  # relative sigma from which the picks do not tell the focal length
LOOSE_TURN = np.radians(10)  # and the rotation
VIEWS = 60  # directions from which lines alone are looked at
RIVAL = 9.0  # twice the difference of log-likelihoods below which another pose explains the picks as well
OTHER = np.radians(2)  # so far turned is another pose
ITERATIONS, SETTLING = 60, 25
EXACT = 1e-3  # sigma, below which residuals are none


@dataclass(frozen=True, eq=False)
class Found:
    """What the picks tell.

    camera : posed;  covariance : (6, 6) of (omega, tau), T = exp(omega, tau) T_hat along the camera's axes, rad and m
    focal_sigma_px : None where the focal length was known;  factor : of the picks' sigmas, that their residuals show
    residual_px : (n + m,) of points (inf behind the camera), then of lines (the farther end);  outlier : (n + m,) bool
    redundancy : equations beyond unknowns, of what is no outlier;  rivals : poses (4, 4) that explain as much
    joint : (6 or 7, as many) the covariance with the logarithm of an unknown focal length
    """

    camera: Camera
    covariance: np.ndarray
    focal_sigma_px: float | None
    factor: float
    residual_px: np.ndarray
    outlier: np.ndarray
    redundancy: int
    rivals: tuple = ()
    joint: np.ndarray | None = None

    @property
    def rms_px(self) -> float:
        """Of what is no outlier."""
        return float(np.sqrt(np.mean(self.residual_px[~self.outlier] ** 2)))


def warnings(found: Found, names, focal_known) -> list[str]:
    """What a person should know. names : of the points and the lines"""
    said = []
    if found.redundancy == 0:
        said.append("no check is possible: so many numbers are unknown as the picked places tell")
    elif not focal_known and (~found.outlier).sum() <= FEW:
        said.append(f"no check is possible by {(~found.outlier).sum()} places: pick more, or give left.cameramodel")
    for k in np.flatnonzero(found.outlier):
        px = found.residual_px[k]
        away = (
            f"{px:.0f} px from where the camera of the others sees it"
            if np.isfinite(px)
            else "behind the camera of the others"
        )
        said.append(f"{names[k]}: is {away}: left out")
    if found.factor > COARSE:
        said.append(f"the places are {found.factor:.1f} times less exact than their sigma_px says")
    if found.rivals:
        said.append("another pose explains the picked places as well: see ambiguous in pose.json")
    return said


def solve(picks: Picks, camera: Camera, focal_known: bool) -> Found:
    """camera : its K, but for an unknown focal length, and its size count.  BadInput: too few, or places that do not
    tell the pose."""
    try:
        return _solved(picks, camera, focal_known)
    except BadInput as bad:
        why = misread(picks, camera, focal_known)
        raise BadInput(f"{bad}; {why}" if why else str(bad)) from None


def _solved(picks, camera, focal_known):
    n = len(picks.p) + len(picks.p_ends)
    if n < LEAST:
        raise BadInput(f"{n} picked place{'s' * (n != 1)}: at least {LEAST} are needed")
    _check_spread(picks)
    fits = [_Fit(picks, camera, focal_known, *start).climbed() for start in _starts(picks, camera, focal_known)]
    if not any(fit.agrees for fit in fits):
        fits += _from_all_around(picks, camera, focal_known)
    fits = sorted((fit for fit in fits if fit.is_sound), key=lambda fit: -fit.likelihood)
    if not fits:
        raise BadInput("no camera sees the picked places where they were picked: are X, Y, Z those of the model?")
    best = fits[0]
    if not best.agrees:
        share = f"{(~best.outlier).sum()} of {len(best.outlier)}"
        raise BadInput(f"only {share} picked places agree with any one camera, which so many may do by chance")
    return best.found(fits[1:])


def misread(picks: Picks, camera: Camera, focal_known: bool, than: Found | None = None) -> str | None:
    """How pixels may be meant if one camera then sees all places where they were picked, and it does not as they stand.

    than : what was found, which must have left some out, or be several times less exact than the picks say
    """
    if len(picks.p) < LEAST_MISREAD or than is not None and than.factor < COARSE and not than.outlier.any():
        return None
    width, height = camera.width, camera.height
    x, y = picks.q.T
    readings = {
        "x_px and y_px are swapped": (y, x),
        "y_px is counted from the bottom, or two of X, Y, Z are swapped": (x, height - 1 - y),
        "the picture was turned by a quarter": (width - 1 - y, x),
        "the picture was turned by a quarter the other way": (y, height - 1 - x),
    }
    for k in (2, 3, 4):
        readings[f"the picture was {k} times smaller"] = k * (x + 0.5) - 0.5, k * (y + 0.5) - 0.5
        readings[f"the picture was {k} times larger"] = (x + 0.5) / k - 0.5, (y + 0.5) / k - 0.5
    fits = {}
    for words, q in readings.items():
        told = replace(picks, q=np.stack(q, axis=1))
        if ((told.q > -1) & (told.q < (width, height))).all():
            starts = _starts(told, camera, focal_known)
            tried = [_Fit(told, camera, focal_known, *start).climbed() for start in starts]
            sound = [fit for fit in tried if fit.is_sound and not fit.outlier.any() and fit.factor < COARSE]
            fits |= {words: max(sound, key=lambda fit: fit.likelihood)} if sound else {}
    if not fits:
        return None
    # a quarter either way differ by half a turn of the camera, which all points agree with as well: it stands upright
    most = max(fit.likelihood for fit in fits.values())
    near = [words for words, fit in fits.items() if 2 * (most - fit.likelihood) < RIVAL]
    likely = max(near, key=lambda words: (fits[words].upright, fits[words].likelihood))
    return f"all {len(picks.p)} points would agree with one camera if {likely}"


def _check_spread(picks):
    """BadInput where all that was picked lies on one line of the model."""
    p = np.concatenate([picks.p, picks.p_ends.reshape(-1, 3)])
    size = np.linalg.svd(p - p.mean(axis=0), compute_uv=False)
    if size[1] < 1e-6 * size[0] or size[0] == 0:
        raise BadInput("all picked places lie on one straight line of the model: they do not tell how it is turned")


# ---- starts ----


def _starts(picks, camera, focal_known):
    """(T (4, 4), focal length over the camera's) to begin at, from points."""
    if len(picks.p) < 4:
        return []
    return [*_by_colmap(picks, camera, focal_known), *_of_planes(picks, camera, focal_known)]


def _by_colmap(picks, camera, focal_known):
    """pycolmap's absolute pose; of all, and at most so strict that half may be wrong."""
    import pycolmap

    found, K = [], camera.K
    for reach in (3.0, 12.0):
        options = pycolmap.AbsolutePoseEstimationOptions()
        options.estimate_focal_length = not focal_known
        options.ransac.max_error = reach * float(np.median(picks.sigma))
        options.ransac.random_seed = 1
        options.ransac.max_num_trials = 2000
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]] if focal_known else [K[0, 0], K[0, 2], K[1, 2]]
        model = "PINHOLE" if focal_known else "SIMPLE_PINHOLE"
        view = pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=params)
        result = pycolmap.estimate_absolute_pose(picks.q, picks.p, view, options)
        if result is not None:
            T = np.vstack([result["cam_from_world"].matrix(), [0, 0, 0, 1]])
            found.append((T, 1.0 if focal_known else view.params[0] / K[0, 0]))  # it writes into the camera
    return found


def _of_planes(picks, camera, focal_known):
    """Both poses from which a plane looks alike (Collins and Bartoli, IPPE), where all points lie on one."""
    import cv2

    middle = picks.p.mean(axis=0)
    _, size, axes = np.linalg.svd(picks.p - middle)
    if size[2] > 1e-3 * size[0]:
        return []
    turn, found = np.eye(4), []
    turn[:3, :3] = axes * np.sign(np.linalg.det(axes))  # a rotation: IPPE wants the plane z = 0
    turn[:3, 3] = -turn[:3, :3] @ middle
    flat = (picks.p - middle) @ turn[:3, :3].T
    q = np.ascontiguousarray(picks.q)  # OpenCV refuses columns of a larger table
    for share in (1.0,) if focal_known else _relative_focals(camera):
        K = camera.K * [[share, 1, 1], [1, share, 1], [1, 1, 1]]
        ok, rs, ts, _ = cv2.solvePnPGeneric(flat, q, K, None, flags=cv2.SOLVEPNP_IPPE)
        for r, t in zip(rs, ts, strict=True) if ok else ():
            found.append((matrix_from_rt(np.concatenate([r.ravel(), t.ravel()])) @ turn, share))
    return found


def _relative_focals(camera):
    side = max(camera.width, camera.height)
    return [share * side / camera.K[0, 0] for share in FOCAL_STARTS]


def _from_all_around(picks, camera, focal_known):
    """[_Fit] of views from all around, until one has nothing wrong, or some of one roll agree."""
    fits = []
    for roll in range(4):
        for look in _looks(picks, camera, focal_known, roll):
            fits.append(_Fit(picks, camera, focal_known, *look).settled().climbed())
            if fits[-1].agrees and not fits[-1].outlier.any():
                return fits
        if any(fit.agrees for fit in fits):
            break
    return fits


def _looks(picks, camera, focal_known, roll):
    """Views of all that was picked, from all around. roll : quarters of a turn about the view"""
    p = np.concatenate([picks.p, picks.p_ends.reshape(-1, 3)])
    middle, size = p.mean(axis=0), np.linalg.norm(p - p.mean(axis=0), axis=1).max()
    k = np.arange(VIEWS) + 0.5
    z, turn = 1 - 2 * k / VIEWS, np.pi * (1 + 5**0.5) * k  # a spiral over the sphere
    around = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], axis=1)
    for share in (1.0,) if focal_known else _relative_focals(camera)[1:2]:
        far = size * max(1.0, 2 * share * camera.K[0, 0] / min(camera.width, camera.height))
        for back in around:
            T = towards(middle + far * back, middle, (0, 0, 1) if abs(back[2]) < 0.99 else (0, 1, 0))
            T[:2] = _quarters(roll) @ T[:2]
            yield T, share


def _quarters(roll):
    """(2, 2) rotation by quarters of a turn.

    >>> _quarters(1)
    array([[ 0, -1],
           [ 1,  0]])
    """
    return np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), roll)


# ---- the mixture ----


class _Fit:
    """One start, and where it led.  theta : (6 or 7,) omega, tau, log of the focal length's share, from the start"""

    def __init__(self, picks, camera, focal_known, T, share):
        self.picks, self.camera, self.focal_known = picks, camera, focal_known
        self.T, self.share, self.factor = T, float(share), 1.0
        n, m = len(picks.p), len(picks.p_ends)
        self.sigma = np.concatenate([np.repeat(picks.sigma, 2), np.repeat(picks.sigma_ends, 2)])
        self.owner = np.concatenate([np.repeat(np.arange(n), 2), n + np.repeat(np.arange(m), 2)])
        self.anywhere = -np.log(float(camera.width * camera.height))  # a wrong pick's log-density
        self.right, self.share_right, self.likelihood = np.ones(n + m), 0.8, -np.inf
        self.is_sound = True

    @property
    def upright(self):
        """Cosine of the angle between the picture's up and the model's, z."""
        return -self.T[1, 2]

    @property
    def size(self):
        return 6 if self.focal_known else 7

    def moved(self, step):
        """(T, share) after a step."""
        change = matrix_from_rt(np.concatenate([step[:3], [0, 0, 0]]))
        change[:3, 3] = step[3:6]
        return change @ self.T, self.share * (1.0 if self.focal_known else float(np.exp(np.clip(step[6], -1, 1))))

    def posed(self, T, share):
        K = self.camera.K * [[share, 1, 1], [1, share, 1], [1, 1, 1]]
        return Camera(K, self.camera.width, self.camera.height, T)

    def residuals(self, T, share):
        """`_residuals` of a pose and a focal length."""
        return _residuals(self.picks, self.posed(T, share))

    def settled(self) -> _Fit:
        """From a start that is far off: squares under a width that follows their median."""
        n, self.right = len(self.right), np.ones(len(self.right))
        for _ in range(SETTLING):
            r = self.residuals(self.T, self.share)
            if not np.isfinite(r).all():
                break
            size = np.sqrt(np.bincount(self.owner, (r / self.sigma) ** 2, n))
            self.right = 1 / (1 + (size / (2 * max(np.median(size), EXACT))) ** 2) ** 2
            self._step(r)
        return self

    @property
    def agrees(self):
        """More of what was picked is right than would be by chance, in the best of all choices and starts."""
        wrong, n = int(self.outlier.sum()), len(self.right)
        if not self.is_sound or wrong > MOST_WRONG * n:
            return False
        noise = self.factor * float(np.median(self.sigma)) * np.sqrt(2 * np.pi * np.e)
        each = -0.5 * self.anywhere - np.log(noise)  # nats of an equation that holds
        choices = lgamma(n + 1) - lgamma(wrong + 1) - lgamma(n - wrong + 1) + np.log(VIEWS)
        return wrong == 0 or (2 * (n - wrong) - self.size) * each - choices > CHANCE

    def climbed(self) -> _Fit:
        """Expectation and maximisation until neither changes."""
        r = self.residuals(self.T, self.share)
        if not np.isfinite(r).all():
            r = np.where(np.isfinite(r), r, self.camera.width)
        self.factor = float(np.clip(1.48 * np.median(np.abs(r / self.sigma)), 1.0, LARGEST_FACTOR))
        for _ in range(ITERATIONS):
            before = self.likelihood
            r = self._expected()
            if r is None:
                return self
            self._step(r)
            if abs(self.likelihood - before) < 1e-6:
                break
        return self

    def _expected(self):
        """The residuals, with `right` and `likelihood` of them; None where a place is behind the camera for good."""
        r = self.residuals(self.T, self.share)
        lost = ~np.isfinite(r)
        if lost.all():
            self.is_sound = False
            return None
        r = np.where(lost, 10.0 * self.camera.width, r)
        s = self.factor * self.sigma
        each = np.bincount(self.owner, -0.5 * (r / s) ** 2 - np.log(s) - 0.5 * np.log(2 * np.pi))
        good, bad = np.log(self.share_right) + each, np.log1p(-self.share_right) + self.anywhere
        self.likelihood = float(np.logaddexp(good, bad).sum())
        self.right = np.exp(good - np.logaddexp(good, bad))
        self.share_right = float(np.clip(self.right.mean(), 0.05, 0.98))
        free = max(2 * self.right.sum() - self.size, 0.5)
        self.factor = float(
            np.clip(np.sqrt((self.right[self.owner] * (r / self.sigma) ** 2).sum() / free), 1.0, LARGEST_FACTOR)
        )
        return np.where(lost, 0.0, r)

    def _step(self, r):
        """A damped Gauss-Newton step of the weighted squares, shortened until they are no larger."""
        J, w = self.derivatives(), (np.sqrt(self.right[self.owner]) / self.sigma)
        keep = np.isfinite(J).all(axis=1)
        A, b = (J * w[:, None])[keep], (r * w)[keep]
        cost, damping = b @ b, 1e-9
        for _ in range(12):
            H = A.T @ A
            step = -np.linalg.lstsq(H + damping * np.diag(np.diag(H) + 1e-12), A.T @ b, rcond=1e-14)[0]
            T, share = self.moved(step)
            after = self.residuals(T, share)
            if np.isfinite(after[keep]).all() and ((after * w)[keep] ** 2).sum() <= cost * (1 + 1e-12):
                self.T, self.share = T, share
                return
            damping = max(damping, 1e-7) * 10

    def derivatives(self):
        """(2 (n + m), 6 or 7) px, by central differences."""
        depth = max(float(np.median(np.abs(self.posed(self.T, self.share).points(self._places())[:, 2]))), 1e-6)
        columns = []
        for k in range(self.size):
            h = np.zeros(7)
            h[k] = STEP * (depth if 3 <= k < 6 else 1.0)
            columns.append((self.residuals(*self.moved(h)) - self.residuals(*self.moved(-h))) / (2 * h[k]))
        return np.stack(columns, axis=1)

    def _places(self):
        return np.concatenate([self.picks.p, self.picks.p_ends.reshape(-1, 3)])

    @property
    def outlier(self):
        return self.right < WRONG

    def found(self, others) -> Found:
        """The answer. others : fits that are less likely"""
        good = ~self.outlier[self.owner]
        J = self.derivatives()[good] / (self.factor * self.sigma[good, None])
        redundancy = int(good.sum()) - self.size
        H = J.T @ J
        scale = np.sqrt(np.maximum(np.diag(H), 1e-300))
        values = np.linalg.eigvalsh(H / np.outer(scale, scale))
        if redundancy < 0 or values[0] < 1e-10:
            raise BadInput("the picked places do not tell the pose: they lie so that different cameras see them alike")
        covariance = np.linalg.inv(H / np.outer(scale, scale)) / np.outer(scale, scale)
        focal_sigma = None if self.focal_known else float(np.sqrt(covariance[6, 6]))
        turn = np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])
        if focal_sigma is not None and focal_sigma > LOOSE_FOCAL:
            raise BadInput(
                f"the picked places do not tell the focal length (sigma {focal_sigma:.0%}): pick some in other depths,"
                " or give left.cameramodel"
            )
        if turn > LOOSE_TURN:
            raise BadInput(f"the picked places do not tell the pose (sigma {np.degrees(turn):.0f} degrees)")
        camera = self.posed(self.T, self.share)
        return Found(
            camera,
            covariance[:6, :6],
            None if focal_sigma is None else focal_sigma * camera.K[0, 0],
            self.factor,
            residuals_px(self.picks, camera),
            self.outlier,
            redundancy,
            tuple(self._rivals(others)),
            covariance,
        )

    def _rivals(self, others):
        """Poses (4, 4) that explain the picks as well, and are others."""
        kept = [self.T]
        for other in others:
            if 2 * (self.likelihood - other.likelihood) > RIVAL:
                break
            if all(_angle(other.T, T) > OTHER for T in kept):
                kept.append(other.T)
        return kept[1:]


def _residuals(picks, camera):
    """(2 (n + m),) px: of points in x and y, of lines the distances of both picked ends; nan behind the camera."""
    of_points = (camera.project(picks.p) - picks.q).ravel()
    if not len(picks.p_ends):
        return of_points
    seen = camera.points(picks.p_ends.reshape(-1, 3)) @ camera.K.T
    line = np.cross(seen[0::2], seen[1::2])  # through both ends, also where one is behind the camera
    length = np.linalg.norm(line[:, :2], axis=1)
    ends = np.concatenate([picks.ends, np.ones((*picks.ends.shape[:2], 1))], axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.concatenate([of_points, (np.einsum("mek,mk->me", ends, line) / length[:, None]).ravel()])


def residuals_px(picks, camera) -> np.ndarray:
    """(n + m,) px: of points, inf behind the camera, then of lines, the farther end."""
    r = np.abs(np.nan_to_num(_residuals(picks, camera), nan=np.inf))
    n = 2 * len(picks.p)
    return np.concatenate([np.hypot(r[:n:2], r[1:n:2]), np.maximum(r[n::2], r[n + 1 :: 2])])


def _angle(A, B):
    """rad between two rotations."""
    return float(np.arccos(np.clip((np.trace(A[:3, :3] @ B[:3, :3].T) - 1) / 2, -1, 1)))
