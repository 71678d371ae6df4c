"""Random rooms, cameras in them, and the noisy, partial, half spurious facets that a reconstruction would give.

Shared by the tests of recognise and its curves.
"""

import numpy as np

from lib.buffers import index_buffer, opengl
from lib.given.cameras import Camera
from lib.synthetic import geometry, optics
from lib.vision.recognition.hashing import SceneFacets

NOISE_PX = 0.3  # of a contour point, in disparity
INDEPENDENT = 12  # contour points whose errors are independent


def polygons_of_rooms(random, rooms=3, furniture=14, symmetric=False, gap=0.3):
    """[(object, [(group, corners)])] of a row of furnished rooms along x, and the rooms' boxes.

    The same kinds of furniture stand in all of them.
    """
    things, boxes, x0 = {}, [], 0.0
    kinds = [
        random.uniform((0.4, 0.3, 0.3), (1.6, 0.9, 1.9)) for _ in range(max(3, furniture // 2))
    ]  # repeated: two or more of each
    for r in range(rooms):
        size = np.array([5.0, 4.0, 2.8]) if symmetric else random.uniform((3.8, 3.2, 2.5), (6.0, 5.0, 3.1))
        low, high = np.array([x0, 0, 0]), np.array([x0, 0, 0]) + size
        boxes.append((low, high))
        p = geometry.room(*size)
        p = [geometry.Polygon(f"{q.object}{r}", q.group, q.points + low) for q in p]
        for k in range(0 if symmetric else furniture):
            s = kinds[random.integers(len(kinds))]
            turn = random.choice([0.0, 0.0, 0.0, random.uniform(-0.7, 0.7)])
            on_wall = random.random() < 0.25
            at = random.uniform((0, 0, 0), np.maximum(size - s, 0.01))
            z = random.uniform(0.8, max(0.81, size[2] - 1.0)) if on_wall else 0.0
            height = min(s[2], size[2] - z - 0.05)
            if on_wall:  # a plate on the wall y = size
                corner = np.array([at[0], size[1] - 0.04, z])
                s = np.array([s[0], 0.04, min(height, 0.9)])
                turn = 0.0
            else:
                corner, s = np.array([at[0], at[1], 0]), np.array([s[0], s[1], height])
            p += geometry.box(f"thing{r}-{k}", f"paint{k % 7}", corner + low, corner + s + low, turn=turn)
        for q in p:
            things.setdefault(q.object, []).append((q.group, q.points))
        x0 = high[0] + gap
    return things, boxes


def camera_in(random, model, low, high, width=320, height=240, focal=210.0):
    """A camera at eye height near a wall of the box, looking inwards; nothing within 0.4 m, five facets in view."""
    size = high - low
    while True:
        edge, along = random.uniform(0.08, 0.2), random.uniform(0.1, 0.9)
        at = [(edge, along), (1 - edge, along), (along, edge), (along, 1 - edge)][random.integers(4)]
        eye = low + size * np.array([*at, 0]) + [0, 0, random.uniform(1.3, 1.8)]
        target = (low + high) / 2 + random.uniform(-0.4, 0.4, 3)
        target[2] = low[2] + random.uniform(0.7, 1.2)
        T = optics.look(eye, target)
        roll = random.uniform(-0.1, 0.1)
        T[:2] = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]) @ T[:2]
        camera = Camera(optics.pinhole(width, height, focal), width, height, T)
        index = draw(model, camera)
        if index.depth.min() > 0.4 and (np.bincount(index.facet[index.facet >= 0]) > 400).sum() >= 5:
            return camera


def draw(model, camera):
    try:
        return index_buffer.draw(model, camera)
    except opengl.NoGraphics:
        return index_buffer.reference(model, camera)


def covariance_of(q, m, camera, baseline, noise_px=NOISE_PX):
    """(3, 3) of m from the disparities b f m . v of INDEPENDENT contour points q (n, 2) px."""
    v = camera.directions(q)
    v = v[np.linspace(0, len(v) - 1, INDEPENDENT).astype(int)]
    sigma = noise_px / (baseline * camera.K[0, 0])
    return sigma**2 * np.linalg.inv(v.T @ v)


class _Seen:
    """The facets collected so far, in the camera's frame."""

    def __init__(self, random, camera, baseline, least_px):
        self.random, self.camera, self.baseline, self.least_px = random, camera, baseline, least_px
        self.m, self.covariance, self.polygons, self.truth = [], [], [], []

    def add(self, mask, m_true, facet):
        """The facet of a mask (H, W) on the plane m_true with noise, unless it is too small or lies behind the camera.

        facet : of the model, or -1 where it is spurious
        """
        import cv2

        contours = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        if not contours:
            return
        contour = max(contours, key=cv2.contourArea)
        if cv2.contourArea(contour) < 0.5 * self.least_px:
            return
        q = contour[:, 0].astype(float)
        spread = covariance_of(q, m_true, self.camera, self.baseline)
        noisy = m_true + np.linalg.cholesky(spread) @ self.random.normal(size=3)
        corners = cv2.approxPolyDP(contour, 1.5, True)[:, 0].astype(float)
        v = self.camera.directions(corners)
        inverse = v @ noisy
        if len(v) < 3 or inverse.min() < 1e-2:
            return
        self.m.append(noisy)
        self.covariance.append(spread)
        self.polygons.append(v / inverse[:, None])
        self.truth.append(facet)

    def shuffled(self, unit):
        """SceneFacets in random order, and the model facet of each."""
        order = self.random.permutation(len(self.m))
        q = 1.0 if unit == "m" else self.baseline
        facets = SceneFacets(
            np.array([self.m[i] for i in order]).reshape(-1, 3) * q,
            np.array([self.covariance[i] for i in order]).reshape(-1, 3, 3) * q * q,
            [self.polygons[i] / q for i in order],
            np.column_stack([np.arange(len(self.m)) + 1] * 2),
            unit,
        )
        return facets, np.array([self.truth[i] for i in order], int)


def facets_seen(random, model, camera, *, spurious=0.5, baseline=0.3, most=14, least_px=400, unit="m", partial=True):
    """SceneFacets of what the camera sees, and which are true: (N,) model facet or -1.

    spurious : their share in the end
    partial : some facets have been cut along a line, as by occlusion or shading

    Half of the spurious ones are true regions on false planes.
    """
    index = draw(model, camera)
    count = np.bincount(index.facet[index.facet >= 0], minlength=model.n_facets)
    large = [f for f in np.argsort(-count) if count[f] >= least_px][:most]
    seen = _Seen(random, camera, baseline, least_px)
    R, t = camera.T_cam_world[:3, :3], camera.T_cam_world[:3, 3]
    for f in large:
        n = R @ model.facet_normal[f]
        mask = index.facet == f
        if partial and random.random() < 0.6:
            mask = _cut(random, mask)
        seen.add(mask, n / (model.facet_offset[f] + n @ t), f)
    real = len(seen.m)
    wanted = int(round(real * spurious / (1 - spurious)))
    for _ in range(20 * wanted + 20):
        if len(seen.m) >= real + wanted:
            break
        if random.random() < 0.5 and large:  # a region matched with the wrong one: a false plane
            mask = index.facet == large[random.integers(len(large))]
        else:
            mask = _random_polygon(random, camera)
        if mask.any() and (plane := _false_plane(random, camera, mask, seen.m[:real])) is not None:
            seen.add(mask, plane, -1)
    return seen.shuffled(unit)


def _cut(random, mask):
    """A line through a random pixel cuts a part away, at most 70 %."""
    y, x = np.nonzero(mask)
    k = random.integers(len(x))
    a = random.uniform(0, 2 * np.pi)
    yy, xx = np.mgrid[: mask.shape[0], : mask.shape[1]]
    cut = mask & ((xx - x[k]) * np.cos(a) + (yy - y[k]) * np.sin(a) > 0)
    return cut if cut.sum() >= 0.3 * mask.sum() else mask


def _random_polygon(random, camera):
    """A mask of 3 to 6 corners, somewhere in the picture."""
    import cv2

    mask = np.zeros((camera.height, camera.width), np.uint8)
    centre = random.uniform((20, 20), (camera.width - 20, camera.height - 20))
    corners = centre + random.uniform(12, 60) * geometry.regular(
        (0, 0), 1, int(random.integers(3, 7)), random.uniform(0, 6)
    ) * random.uniform(0.5, 1.5, 2)
    cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 1)
    return mask > 0


def _false_plane(random, camera, mask, true):
    """m of a plane that crosses the mask's middle, 1 to 6 m deep; None where it would be seen too obliquely.

    Three in ten are parallel to one of the true planes.
    """
    y, x = np.nonzero(mask)
    v = camera.directions(np.array([[x.mean(), y.mean()]]))[0]
    if random.random() < 0.3 and true:
        n = true[random.integers(len(true))]
        n = -n / np.linalg.norm(n)
    else:
        n = random.normal(size=3)
        n /= np.linalg.norm(n)
    if n @ v > 0:
        n = -n
    if -n @ v < 0.2 * np.linalg.norm(v):
        return None
    return n / (random.uniform(1.0, 6.0) * (n @ v))


def photograph(random, model, camera, noise=0.01, gamma=2.2, finer=4):
    """The view when each facet has a colour and light falls off along it: display values, 8 bit.

    finer : it is drawn so many times as fine, then averaged
    """
    import cv2

    from lib.given.image import Photograph

    K = np.array([[finer, 0, (finer - 1) / 2], [0, finer, (finer - 1) / 2], [0, 0, 1]]) @ camera.K
    fine = Camera(K, finer * camera.width, finer * camera.height, camera.T_cam_world)
    index = draw(model, fine)
    colour = random.uniform(0.08, 0.8, (len(model.groups), 3))[model.facet_group] * random.uniform(
        0.6, 1.1, (model.n_facets, 1)
    )
    p = fine.directions(fine.pixels()) * index.depth[..., None]
    fall = 1 / (1 + 0.1 * np.abs(p @ random.normal(size=3) * 0.5 - 1))
    light = np.where(index.facet[..., None] >= 0, colour[index.facet], 0) * fall[..., None]
    light = cv2.resize(light, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    shown = np.clip(light, 0, 1) ** (1 / gamma) + noise * random.normal(size=light.shape)
    return Photograph(np.round(255 * np.clip(shown, 0, 0.98)) / 255, 8, False, 3)


def room_trial(seed, folder, rooms_=3, **options):
    """(model, camera) of a seed; what is left of `options` goes to polygons_of_rooms."""
    from lib.given import model as models
    from tests.helpers import rooms

    random = np.random.default_rng(seed)
    things, boxes = polygons_of_rooms(random, rooms_, **options)
    model = models.load(rooms.write(folder / "model.obj", things))
    return random, things, model, camera_in(random, model, *boxes[random.integers(len(boxes))])


def pose_error(T, camera, scene_depth=3.0):
    """(degrees, metres): the turn, and how far a point at the scene's depth before the camera is put wrong."""
    D = T @ np.linalg.inv(camera.T_cam_world)
    turn = np.degrees(np.arccos(np.clip((np.trace(D[:3, :3]) - 1) / 2, -1, 1)))
    p = np.array([0, 0, scene_depth, 1.0])
    return float(turn), float(np.linalg.norm((D @ p - p)[:3]))
