"""What is wrong with chessboard shots, told before mrcal runs: each in one line that names the pictures.

    check_counts(paths, (9, 6))                 # the pictures show a board of other counts
    check_order("corners.vnl", boards, (9, 6))  # its corners are no rows of nine
    check_views(boards)                         # the same shot again and again
    contradiction(boards, (9, 6), focal, sizes) # shots of two moments, exchanged, turned or mirrored

They look for mistakes of a square and more. What is smaller mrcal's residuals tell.
"""

from collections import Counter

import numpy as np

from lib.core.stage import BadInput
from lib.vision import boards as files
from lib.vision.boards import SIDES

LOOKED_AT = 6  # pictures whose boards are counted before the search
LONGEST = 1600  # px of a picture in which a board is counted
SAME_PX = 1.0  # RMS of the corners' differences below which two pictures show the board at one place
OFF = 0.5  # of the distance between neighbouring corners: from there on a shot contradicts the others
KNOWN = 0.02  # sigma of a focal length, its share: parallel boards leave it open, and contradict each other
FAR = 5.0  # squares: a shot that contradicts the best one so much has no say in how the cameras stand
MOST = 30  # shots that calibrate roughly, and that are tried as what the others are compared with
SMALLEST_GRID = (3, 3)  # that OpenCV's search begins with
NAMED = 5  # pictures in a message


def check_counts(paths, corners):
    """BadInput where the first pictures agree on a board of other counts than corners (nx, ny).

    Half a CPU second at 640 x 480 px, and two where it refuses: 28 pictures without a board took fifty.
    """
    seen = {path: sorted(counts) for path in paths[:LOOKED_AT] if (counts := _counted(_small(path)))}
    votes = Counter(map(tuple, seen.values()))
    told = tuple(sorted(corners))
    if not votes or told in votes:
        return
    other, number = votes.most_common(1)[0]
    shown = [path for path, counts in seen.items() if tuple(counts) == other]
    part = all(a <= b for a, b in zip(told, other, strict=True))  # of what is there: the search would find it somewhere
    if number < (2 if part else 3) or 2 * number <= len(seen):  # of a blurred board a part may be found, too
        return
    if not part and files.find(_small(shown[0]), corners) is not None:
        return
    nx, ny = other[::-1]
    squares = " (inner corners count, not squares)" if told == (other[0] + 1, other[1] + 1) else ""
    raise BadInput(
        f"{shown[0]}: board: no board of {corners[0]} x {corners[1]} inner corners; one of {nx} x {ny} is there"
        f"{squares}: board: {{corners: [{nx}, {ny}]}} in scene.yaml"
    )


def _small(path):
    """(H, W) uint8 of a picture, at most LONGEST px long."""
    import cv2

    grey = files.grey8(path, as_stored=True)
    factor = LONGEST / max(grey.shape)
    return grey if factor >= 1 else cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def _counted(grey):
    """(nx, ny) of the largest board that is found, None where none is."""
    import cv2

    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    found, _, meta = cv2.findChessboardCornersSBWithMeta(grey, SMALLEST_GRID, flags)
    return meta.shape[::-1] if found else None


def check_order(path, boards, corners):
    """BadInput where the corners of a file are no grid, row by row, of nx corners in a row: corners (nx, ny)."""
    nx, ny = corners
    for names, views in zip(boards.names, boards.q, strict=True):
        for name, view in zip(names, views, strict=True):
            if not np.isfinite(view).all() or _is_grid(view):
                continue
            shapes = [(n, nx * ny // n) for n in range(2, nx * ny // 2 + 1) if nx * ny % n == 0 and n != nx]
            fits = [shape for shape in shapes if _is_grid(view.reshape(*shape[::-1], 2))]
            hint = f"; rows of {fits[0][0]} are: board: {{corners: {list(fits[0])}}}" if fits else ""
            raise BadInput(f"{path}: {name}: its {nx * ny} corners are no board of {nx} x {ny}, row by row{hint}")


def _is_grid(q):
    """Are corners (ny, nx, 2) px those of a plane's grid, but for a lens: within half the distance of neighbours?"""
    grid = _grid(q.shape[1::-1])
    H = _homography(grid, q.reshape(-1, 2))
    if H is None:
        return False
    off = np.linalg.norm(_mapped(H, grid) - q.reshape(-1, 2), axis=1)
    return float(np.median(off)) < OFF * float(np.median(files.spacing(q)))


def _grid(corners):
    """(nx ny, 2) in squares, row by row."""
    return np.stack(np.meshgrid(np.arange(corners[0]), np.arange(corners[1])), -1).reshape(-1, 2).astype(float)


def _homography(p, q):
    import cv2

    return cv2.findHomography(p, q)[0]


def _mapped(H, p):
    homogeneous = np.column_stack([p, np.ones(len(p))]) @ H.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return homogeneous[:, :2] / homogeneous[:, 2:]


def check_views(boards):
    """BadInput where all pictures of one camera show the board at one place: they tell no lens."""
    for side in (0, 1):
        views = [view for view in boards.q[side] if np.isfinite(view).all()]
        apart = [np.sqrt(((view - views[0]) ** 2).sum(-1).mean()) for view in views]
        if len(views) > 1 and max(apart) < SAME_PX:
            raise BadInput(
                f"boards: {SIDES[side]}: all {len(views)} pictures with a board show it at one place (to "
                f"{max(apart):.2f} px), which tells no lens: hold it tilted otherwise, and elsewhere, in each"
            )


# ---- both cameras ----


def contradiction(boards, corners, focal, sizes) -> str | None:
    """A line that names the shots in which the board does not stand where the other shots say; None where all agree.

    corners : (nx, ny); focal : (left, right) px, a guess; sizes : ((w, h), (w, h)) px

    Each camera is calibrated roughly. The two poses of the board in one shot tell how the cameras stand to each other,
    and that must tell where the right camera sees the boards of the other shots. Of small boards in much noise it tells
    too little: what is named here is wrong only if mrcal cannot fit it either.
    """
    both = np.flatnonzero(np.isfinite(boards.q).all((0, 2, 3, 4)))
    if len(both) < 2:
        return None
    grid = np.column_stack([_grid(corners), np.zeros(corners[0] * corners[1])])
    q = boards.q[:, both].reshape(2, len(both), -1, 2)
    lenses = [_rough_lens(grid, q[side], focal[side], sizes[side]) for side in (0, 1)]
    if None in lenses:
        return None
    rays = [np.stack([_undistorted(view, *lenses[side]) for view in q[side]]) for side in (0, 1)]
    poses = [[_poses(grid, view) for view in rays[side]] for side in (0, 1)]
    step = np.array([np.median(files.spacing(view)) for view in boards.q[1, both]]) / lenses[1][0][0, 0]
    off = _off(grid, rays[1], poses[0], _between_cameras(grid, rays[1], poses, step), step)
    wrong = np.flatnonzero(off > OFF)
    if not len(wrong):
        return None
    if 2 * len(wrong) >= len(both):
        return (
            f"boards: pairs: the shots do not agree on how the cameras stand to each other: at most "
            f"{len(both) - len(wrong)} of {len(both)} do. The n-th left-* and the n-th right-* picture, sorted by "
            "name, must show the board at one moment, neither mirrored nor turned"
        )
    names = [f"{boards.names[0][both[n]]} and {boards.names[1][both[n]]}" for n in wrong]
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return (
        f"boards: {', '.join(names[:NAMED])}{more}: the board lies {_squares(off[wrong].min())} or more from where the "
        f"other {len(both) - len(wrong)} shots say: not of one moment, exchanged, zoomed, mirrored or turned: leave "
        "both pictures out"
    )


def _squares(off):
    return "far" if off > 100 else f"{off:.1f} squares"


def _some(count):
    """At most MOST of so many, evenly."""
    return np.unique(np.linspace(0, count - 1, min(count, MOST)).astype(int))


def _rough_lens(grid, views, focal, size):
    """(K, distortion) by OpenCV, with two radial terms; None where the boards do not tell the focal length.

    grid : (P, 3) squares; views : (n, P, 2) px
    """
    import cv2

    K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1.0]])
    some = [np.float32(views[n]).reshape(-1, 1, 2) for n in _some(len(views))]
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
    flags |= cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT
    try:
        _, K, distortion, *_, sigma, _, _ = cv2.calibrateCameraExtended(
            [np.float32(grid)] * len(some), some, size, K, np.zeros(5), flags=flags
        )
    except cv2.error:
        return None
    known = np.isfinite(K).all() and 0 <= sigma[0, 0] < KNOWN * K[0, 0] and np.abs(distortion).max() < 1
    return (K, distortion) if known else None


def _undistorted(q, K, distortion):
    """(P, 2): x / z, y / z of the rays of pixels."""
    import cv2

    return cv2.undistortPoints(q.reshape(-1, 1, 2), K, distortion).reshape(-1, 2)


def _poses(grid, rays):
    """[(R, t)] of a board in the camera's frame, in squares: a plane far away has two that look alike."""
    import cv2

    try:
        _, r, t, _ = cv2.solvePnPGeneric(grid, rays.reshape(-1, 1, 2), np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    except cv2.error:
        return []
    return [(cv2.Rodrigues(a)[0], b.ravel()) for a, b in zip(r, t, strict=True) if np.isfinite([a, b]).all()]


def _off(grid, rays_right, poses_left, T, step):
    """(n,) by how much each shot contradicts T = (R, t), left to right camera: the median over the corners, in squares.

    rays_right : (n, P, 2); poses_left : of each shot; step : (n,) between neighbouring corners, as rays
    """
    R, t = T
    off = np.full(len(rays_right), np.inf)
    for n, seen in enumerate(rays_right):
        for R_board, t_board in poses_left[n]:
            p = (grid @ R_board.T + t_board) @ R.T + t
            if (p[:, 2] > 0).all():
                apart = np.linalg.norm(p[:, :2] / p[:, 2:] - seen, axis=1)
                off[n] = min(off[n], np.median(apart) / step[n])
    return off


def _between_cameras(grid, rays_right, poses, step):
    """(R, t) left to right camera, in squares: of the shot that contradicts the others least, then by all of them.

    One shot alone tells it badly: a small board's tilt is known to degrees.
    """
    from scipy.optimize import least_squares
    from scipy.spatial.transform import Rotation

    best, least = (np.eye(3), np.zeros(3)), np.inf
    for m in _some(len(rays_right)):
        for R_left, t_left in poses[0][m]:
            for R_right, t_right in poses[1][m]:
                R = R_right @ R_left.T
                T = R, t_right - R @ t_left
                if (lost := np.minimum(_off(grid, rays_right, poses[0], T, step), 1.0).sum()) < least:
                    best, least = T, lost
    off = _off(grid, rays_right, poses[0], best, step)
    some = [n for n in range(len(off)) if poses[0][n] and off[n] < FAR]
    boards = np.stack([grid @ poses[0][n][0][0].T + poses[0][n][0][1] for n in some])
    corners = [0, int(grid[:, 0].max()), -1 - int(grid[:, 0].max()), -1]

    def error(change):
        R = Rotation.from_rotvec(change[:3]).as_matrix() @ best[0]
        p = boards[:, corners] @ R.T + best[1] + change[3:]
        apart = p[..., :2] / np.maximum(p[..., 2:], 1e-6) - rays_right[some][:, corners]
        return (apart / step[some, None, None]).ravel()

    change = least_squares(error, np.zeros(6), loss="soft_l1", f_scale=0.1, max_nfev=50).x
    return Rotation.from_rotvec(change[:3]).as_matrix() @ best[0], best[1] + change[3:]
