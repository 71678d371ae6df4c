"""A photograph through a pinhole: independent passes by Mitsuba, and which group each pixel shows."""

import numpy as np

from lib.synthetic.mirrored_lamps import tracer
from lib.synthetic.mitsuba_scene import mitsuba_scene
from lib.synthetic.optics import directions
from lib.synthetic.sight import first_polygon

# ---- labels ----


def group_picture(mi, scene, recipe) -> np.ndarray:
    """(H, W) index + 1 of the group at each pixel's centre, by one ray each through our own camera; 0 = nothing."""
    W, H = recipe.size
    v = directions(recipe.K, recipe.size, recipe.T_cam_world)
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    d = v.reshape(-1, 3)
    eye = mi.Point3f(*map(float, np.linalg.inv(recipe.T_cam_world)[:3, 3]))
    first_met = _first_met_singly if mi.variant().startswith("scalar") else _first_met
    return first_met(mi, scene, eye, d).reshape(H, W)


def _label(shape):
    """Index + 1 of the group that a shape of `mitsuba_scene` shows."""
    return int(shape.id().removeprefix("group")) + 1


def _first_met(mi, scene, eye, d):
    """(N,) labels of what the rays d (N, 3) from `eye` meet first; 0 = nothing."""
    import drjit

    ray = mi.Ray3f(eye, mi.Vector3f(d[:, 0], d[:, 1], d[:, 2]))
    hit = scene.ray_intersect_preliminary(ray)
    out = np.zeros(len(d), np.uint16)
    pointers = drjit.reinterpret_array(mi.UInt32, hit.shape).numpy()
    valid = hit.is_valid().numpy()
    for shape in scene.shapes():
        own = drjit.reinterpret_array(mi.UInt32, mi.ShapePtr(shape)).numpy()[0]
        out[valid & (pointers == own)] = _label(shape)
    return out


def _first_met_singly(mi, scene, eye, d):
    """The same, ray by ray, for Mitsuba's scalar variants."""
    labels = {shape.id(): _label(shape) for shape in scene.shapes()}
    out = np.zeros(len(d), np.uint16)
    for i, direction in enumerate(d):
        hit = scene.ray_intersect_preliminary(mi.Ray3f(eye, mi.Vector3f(*map(float, direction))))
        if hit.is_valid():
            out[i] = labels[hit.shape.id()]
    return out


def mirror_groups(recipe, labels, bounces=16) -> np.ndarray:
    """(H, W) index + 1 of the group that each pixel of a mirror shows after up to so many mirrors.

    0 where there is no mirror, where it shows nothing, or still a mirror.  The slow clear way.
    labels : (H, W) of group_picture
    """
    W, H = recipe.size
    d = directions(recipe.K, recipe.size, recipe.T_cam_world).reshape(-1, 3)
    eye = np.repeat(np.linalg.inv(recipe.T_cam_world)[None, :3, 3], len(d), 0)
    out = np.zeros(len(d), np.uint16)
    mirrors = [recipe.groups.index(p.group) + 1 for p in recipe.mirrors()]
    group_of = np.array([recipe.groups.index(p.group) + 1 for p in recipe.polygons] + [0])  # the last: number -1
    normals = np.array([p.normal() for p in recipe.polygons] + [np.zeros(3)])
    on = np.arange(len(d))  # rays that have met nothing but mirrors so far
    for _ in range(bounces + 1):
        distance, number = first_polygon(recipe.polygons, eye[on], d[on])
        group, normal = group_of[number], normals[number]
        is_mirror = np.isin(group, mirrors)
        out[on] = np.where(is_mirror, 0, group)
        on, distance, n = on[is_mirror], distance[is_mirror], normal[is_mirror]
        eye[on] += distance[:, None] * d[on]
        d[on] -= 2 * (d[on] * n).sum(1, keepdims=True) * n
    return np.where(np.isin(labels, mirrors), out.reshape(H, W), 0).astype(np.uint16)


# ---- passes ----


class Passes:
    """Independent passes over a picture, some over a window only: mean and variance per pixel, group means per pass.

    `labels` (H, W): index + 1 of the group whose mean a pixel enters, 0 = none.
    """

    def __init__(self, shape, labels, groups):
        self.labels, self.groups = labels, groups
        self.sum, self.squares, self.count = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2])
        self.group_means = [[] for _ in range(groups)]

    def add(self, image, window=None):
        """One pass, (h, w, 3), over the window x0, y0, x1, y1; a window counts for the groups it wholly contains."""
        x0, y0, x1, y1 = window or (0, 0, self.labels.shape[1], self.labels.shape[0])
        self.sum[y0:y1, x0:x1] += image
        self.squares[y0:y1, x0:x1] += image**2
        self.count[y0:y1, x0:x1] += 1
        inside = self.labels[y0:y1, x0:x1]
        for k in range(self.groups):
            here = inside == k + 1
            if here.any() and here.sum() == (self.labels == k + 1).sum():
                self.group_means[k].append(image[here].mean(0))

    def mean(self) -> np.ndarray:
        """(H, W, 3)."""
        return self.sum / self.count[..., None]

    def pixel_noise(self) -> np.ndarray:
        """(H, W, 3): standard error of each pixel's mean, relative to it."""
        n, mean = self.count[..., None], self.mean()
        variance = np.maximum(self.squares / n - mean**2, 0) * n / np.maximum(n - 1, 1)
        return np.sqrt(variance / n) / np.maximum(mean, 1e-12)

    def group_noise(self, k) -> np.ndarray:
        """(3,): standard error of the group's mean over the passes, relative to it."""
        means = np.array(self.group_means[k])
        return means.std(0, ddof=1) / np.sqrt(len(means)) / means.mean(0)


def window_of(labels, k) -> tuple[int, int, int, int]:
    """x0, y0, x1, y1 px: the smallest window with all pixels of group k."""
    y, x = np.nonzero(labels == k + 1)
    return int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1


class _Tracing:
    """Passes of one scene, each with the next seed."""

    def __init__(self, mi, recipe, folder, opt):
        self.mi, self.recipe, self.folder, self.opt = mi, recipe, folder, opt
        self.seed = opt.seed

    def scene(self, window=None):
        return mitsuba_scene(self.mi, self.recipe, self.folder, self.opt.roulette, window)

    def passes_of(self, scene):
        """A function that makes one pass, (h, w, 3) linear image values."""
        integrator = tracer(self.mi, self.recipe, scene, self.opt.roulette)

        def one_pass():
            image = self.mi.render(scene, integrator=integrator, spp=self.opt.spp, seed=self.seed)
            self.seed += 1
            return np.array(image, dtype=float)[..., :3] * np.pi

        return one_pass


def render(mi, recipe, folder, opt) -> tuple[Passes, np.ndarray, int]:
    """(passes, (H, W) groups, seeds used); stops at `opt.target` or after `opt.more` passes of a window."""
    import cv2

    tracing = _Tracing(mi, recipe, folder, opt)
    scene = tracing.scene()
    labels = group_picture(mi, scene, recipe)
    # A pixel at a lamp's edge is lamp in part and so a hundred times brighter.  It would make most of the noise of the
    # ceiling's mean.
    lamps = np.isin(labels, [recipe.groups.index(g) + 1 for g in recipe.lamps])
    pure = np.where(lamps | (cv2.dilate(lamps.astype(np.uint8), np.ones((3, 3))) == 0), labels, 0)
    passes = Passes((recipe.size[1], recipe.size[0], 3), pure, len(recipe.groups))
    one_pass = tracing.passes_of(scene)
    for _ in range(opt.passes):
        passes.add(one_pass())
    for k, group in enumerate(recipe.groups):
        if (labels == k + 1).sum() >= 500 and group not in recipe.lamps:
            _refine(passes, k, tracing)
    return passes, labels, tracing.seed - opt.seed


def _refine(passes, k, tracing):
    """Further passes over the window of a noisy group, unless that is most of the picture."""
    opt = tracing.opt
    window = x0, y0, x1, y1 = window_of(passes.labels, k)
    if (x1 - x0) * (y1 - y0) > 0.2 * passes.labels.size:
        return
    one_pass, left = None, opt.more
    while left > 0 and (noise := passes.group_noise(k).max()) > opt.target:
        one_pass = one_pass or tracing.passes_of(tracing.scene(window))
        # so many passes are still needed, at the noise seen so far; a few at a time
        need = len(passes.group_means[k]) * ((noise / opt.target) ** 2 - 1)
        for _ in range(int(min(left, max(1, np.ceil(need * 0.5))))):
            passes.add(one_pass(), window)
            left -= 1
