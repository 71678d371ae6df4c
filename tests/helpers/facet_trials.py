"""Random rooms, cameras in them, and the noisy, partial, half spurious facets that a reconstruction would give. Shared by the tests of recognise and its curves."""

import numpy as np

from lib.buffers import index_buffer, opengl
from lib.given.cameras import Camera
from lib.synthetic import geometry, optics
from lib.vision.recognition.hashing import SceneFacets

NOISE_PX = 0.3  # of a contour point, in disparity
INDEPENDENT = 12  # contour points whose errors are independent


def polygons_of_rooms(random, rooms=3, furniture=14, symmetric=False, gap=0.3):
    """[(object, [(group, corners)])] of a row of furnished rooms along x, and the rooms' boxes. The same kinds of furniture stand in all of them."""
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
    """A camera at eye height near a wall of the box, looking inwards; nothing within 0.4 m before it, at least five facets in view."""
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


def facets_seen(random, model, camera, *, spurious=0.5, baseline=0.3, most=14, least_px=400, unit="m", partial=True):
    """SceneFacets of what the camera sees, and which are true: (N,) model facet or -1. `spurious` is their share in the end.

    A partial facet has been cut along a line (occlusion, shading) and half of the spurious ones are true regions on false planes.
    """
    import cv2

    index = draw(model, camera)
    count = np.bincount(index.facet[index.facet >= 0], minlength=model.n_facets)
    large = [f for f in np.argsort(-count) if count[f] >= least_px][:most]
    m, C, polygons, truth = [], [], [], []

    def add(mask, m_true, facet, wrong=False):
        contours = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]
        if not contours:
            return
        contour = max(contours, key=cv2.contourArea)
        if cv2.contourArea(contour) < 0.5 * least_px:
            return
        q = contour[:, 0].astype(float)
        spread = covariance_of(q, m_true, camera, baseline)
        noisy = m_true + np.linalg.cholesky(spread) @ random.normal(size=3)
        corners = cv2.approxPolyDP(contour, 1.5, True)[:, 0].astype(float)
        v = camera.directions(corners)
        inverse = v @ noisy
        if len(v) < 3 or inverse.min() < 1e-2:
            return
        m.append(noisy), C.append(spread), polygons.append(v / inverse[:, None]), truth.append(-1 if wrong else facet)

    R, t = camera.T_cam_world[:3, :3], camera.T_cam_world[:3, 3]
    for f in large:
        n = R @ model.facet_normal[f]
        plane = n / (model.facet_offset[f] + n @ t)
        mask = index.facet == f
        if partial and random.random() < 0.6:  # a line through a random pixel cuts a part away
            y, x = np.nonzero(mask)
            k = random.integers(len(x))
            a = random.uniform(0, 2 * np.pi)
            yy, xx = np.mgrid[: camera.height, : camera.width]
            side = (xx - x[k]) * np.cos(a) + (yy - y[k]) * np.sin(a) > 0
            cut = mask & side
            if cut.sum() >= 0.3 * mask.sum():
                mask = cut
        add(mask, plane, f)
    real = len(m)
    wanted = int(round(real * spurious / (1 - spurious)))
    tries = 0
    while len(m) < real + wanted and tries < 20 * wanted + 20:
        tries += 1
        if random.random() < 0.5 and large:  # a region matched with the wrong one: a false plane
            mask = index.facet == large[random.integers(len(large))]
        else:
            mask = np.zeros((camera.height, camera.width), np.uint8)
            centre = random.uniform((20, 20), (camera.width - 20, camera.height - 20))
            corners = centre + random.uniform(12, 60) * geometry.regular(
                (0, 0), 1, int(random.integers(3, 7)), random.uniform(0, 6)
            ) * random.uniform(0.5, 1.5, 2)
            cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 1)
            mask = mask > 0
        if not mask.any():
            continue
        y, x = np.nonzero(mask)
        v = camera.directions(np.array([[x.mean(), y.mean()]]))[0]
        if random.random() < 0.3 and real:  # parallel to a true facet, elsewhere
            n = m[random.integers(real)]
            n = -n / np.linalg.norm(n)
        else:
            n = random.normal(size=3)
            n /= np.linalg.norm(n)
        if n @ v > 0:
            n = -n
        if -n @ v < 0.2 * np.linalg.norm(v):
            continue
        depth = random.uniform(1.0, 6.0)
        add(mask, n / (depth * (n @ v)), -1, wrong=True)
    order = random.permutation(len(m))
    q = 1.0 if unit == "m" else baseline
    facets = SceneFacets(
        np.array([m[i] for i in order]).reshape(-1, 3) * q,
        np.array([C[i] for i in order]).reshape(-1, 3, 3) * q * q,
        [polygons[i] / q for i in order],
        np.column_stack([np.arange(len(m)) + 1] * 2),
        unit,
    )
    return facets, np.array([truth[i] for i in order], int)


def photograph(random, model, camera, noise=0.01, gamma=2.2, finer=4):
    """What an index buffer drawn `finer` times as fine shows when each facet has a colour and light falls off along it; display values, 8 bit."""
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
