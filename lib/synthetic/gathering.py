"""A photograph of a diffuse room with little noise: stored light, then one bounce from every pixel, on Mitsuba's rays.

A path tracer's pixels have 1 % of noise after a thousand samples.  Here the light that was reflected twice or more is
found first, as irradiance of texels of some centimetres, bounce after bounce.  Then each sample of a pixel sends one
ray to every lamp and one ray to see what light the rest of the room reflects to it.  Near surfaces are lit anew for
that ray, so that a texel's size shows nowhere.  Samples are stratified: (0, 2)-sequences, permuted in every pixel.

For rooms whose polygons are all seen from their fronts alone (solids, and walls that face inwards) and diffuse.
Nothing of `lib` computes light here: the truth stays independent.  Mitsuba (`mi`, a variant llvm_*) is passed in.
"""

import numpy as np

from lib.synthetic.mitsuba_scene import write_ply
from lib.synthetic.optics import directions
from lib.synthetic.pictures import Passes
from lib.synthetic.stereo_pictures import PairPictures

OFF_M = 1e-4  # rays start so far off their surface
NEAR_M = 0.3  # surfaces nearer than this are lit anew
SPREAD = (6, 12)  # bounces after which the light of all later ones is guessed
CHUNK = 1 << 22  # samples at once


class Gatherer:
    """A room, ready to be traced: `warm` finds the stored light, `picture` makes one pass of a photograph."""

    def __init__(self, mi, recipe, folder, texel_m=0.03):
        self.mi, self.recipe, self.polygons = mi, recipe, recipe.polygons
        if recipe.surfaces or recipe.reference:
            raise ValueError("gathering is for diffuse rooms with black lamps")
        write_ply(folder / "room.ply", self.polygons)
        shape = {"type": "ply", "filename": str(folder / "room.ply"), "face_normals": True}
        self.scene = mi.load_dict({"type": "scene", "room": shape}, optimize=False)
        self._tables(texel_m)

    # ---- tables ----

    def _tables(self, texel_m):
        """What a ray needs of the polygon that it meets, and the texels of all polygons."""
        mi, frames = self.mi, [_frame(p, texel_m) for p in self.polygons]
        self.numbers = [nu * nv for _, _, _, nu, nv in frames]
        first = np.r_[0, np.cumsum(self.numbers)]
        self.texels = int(first[-1])
        triangles = [i for i, p in enumerate(self.polygons) for _ in range(len(p.points) - 2)]
        self.polygon_of = mi.UInt32(np.array(triangles, np.uint32))
        vector = lambda rows: mi.Float(np.asarray(rows, np.float32).ravel())
        self.origin, self.u, self.v = (vector([f[k] for f in frames]) for k in (0, 1, 2))
        self.n = vector([p.normal() for p in self.polygons])
        self.nu = mi.UInt32(np.array([f[3] for f in frames], np.uint32))
        self.nv = mi.UInt32(np.array([f[4] for f in frames], np.uint32))
        self.first = mi.UInt32(first[:-1].astype(np.uint32))
        self.rho = vector([self.recipe.materials.get(p.group, (0, 0, 0)) for p in self.polygons])
        self.E = vector([self.recipe.lamps.get(p.group, (0, 0, 0)) for p in self.polygons])
        lobes = [self.recipe.lobes.get(p.group, ((0, 0, 0), -1)) for p in self.polygons]
        self.aim, self.exponent = vector([aim for aim, _ in lobes]), mi.Float(np.array([n for _, n in lobes], "f4"))
        self.is_lamp = mi.Bool(np.array([p.group in self.recipe.lamps for p in self.polygons]))
        self.owner = mi.UInt32(np.repeat(np.arange(len(self.polygons)), self.numbers).astype(np.uint32))
        zero = np.zeros(3 * self.texels, np.float32)
        self.direct, self.indirect = mi.Float(zero), mi.Float(zero)

    def _row(self, table, index, active=True):
        """Row `index` of a table of three columns."""
        import drjit as dr

        return dr.gather(self.mi.Vector3f, table, index, active)

    def _numbers(self, sample, count, of, dimension, seed):
        """Two numbers in [0, 1): sample `sample` of `count` of a pixel's or texel's own sequence."""
        mi = self.mi
        a, b = mi.sample_tea_32(of, seed + dimension)
        c, d = mi.sample_tea_32(a, b)
        k = mi.permute_kensler(sample, count, a)
        return mi.Point2f(mi.radical_inverse_2(k, c), mi.sobol_2(k, d))

    # ---- light ----

    def _thrown(self, polygon, d, active=True):
        """What a lamp's polygon throws along unit directions d, over what it throws along its aim."""
        import drjit as dr

        exponent = dr.gather(self.mi.Float, self.exponent, polygon, active)
        cosine = dr.dot(self._row(self.aim, polygon, active), d)
        return dr.select(exponent < 0, 1, dr.select(cosine > 0, dr.power(dr.maximum(cosine, 1e-9), exponent), 0))

    def _meet(self, origin, d, active=True):
        """(met, distance, polygon, whether its front is met)."""
        import drjit as dr

        hit = self.scene.ray_intersect_preliminary(self.mi.Ray3f(origin, d), active=active)
        met = hit.is_valid() & active
        polygon = dr.gather(self.mi.UInt32, self.polygon_of, hit.prim_index, met)
        return met, hit.t, polygon, dr.dot(self._row(self.n, polygon, met), d) < 0

    def _from_lamps(self, p, n, numbers, first, active=True):
        """Irradiance of points p, a little off their surfaces, from one point of every lamp.

        numbers : dimension -> two numbers in [0, 1); from the dimension `first` on they are taken
        """
        import drjit as dr

        mi, total = self.mi, self.mi.Vector3f(0)
        for i, polygon in enumerate(self.polygons):
            if polygon.group not in self.recipe.lamps:
                continue
            (a, b, _, d), area, nl = polygon.points, polygon.area(), polygon.normal()
            at = [mi.Vector3f(*map(float, x)) for x in (a, b - a, d - a, nl)]
            s = numbers(first + i)
            v = at[0] + s.x * at[1] + s.y * at[2] - p
            r2 = dr.squared_norm(v)
            w = v / dr.sqrt(r2)
            cosines = dr.maximum(dr.dot(w, n), 0) * dr.maximum(-dr.dot(w, at[3]), 0)
            lit = active & (cosines > 0)
            ray = mi.Ray3f(p, w, dr.sqrt(r2) - OFF_M, 0.0, [])
            lit &= ~self.scene.ray_test(ray, active=lit)
            share = dr.select(lit, cosines * area / (np.pi * r2), 0) * self._thrown(mi.UInt32(i), -w)
            total += share * mi.Vector3f(*map(float, self.recipe.lamps[polygon.group]))
        return total

    def _texel(self, polygon, p, active):
        """The number of the texel that holds p."""
        import drjit as dr

        mi, at = self.mi, p - self._row(self.origin, polygon, active)
        nu = dr.gather(mi.UInt32, self.nu, polygon, active)
        nv = dr.gather(mi.UInt32, self.nv, polygon, active)
        number = []
        for axis, count in ((self.u, nu), (self.v, nv)):
            e = self._row(axis, polygon, active)
            x = dr.dot(at, e) / dr.squared_norm(e) * mi.Float(count)
            number.append(dr.minimum(mi.UInt32(dr.maximum(x, 0)), count - 1))
        return dr.gather(mi.UInt32, self.first, polygon, active) + number[1] * nu + number[0]

    def _reflected(self, origin, n, numbers, first):
        """(radiosity met by a ray about n with density cosine / pi, whether the ray is in the room)."""
        import drjit as dr

        mi = self.mi
        d = mi.Frame3f(n).to_world(mi.warp.square_to_cosine_hemisphere(numbers(first)))
        met, distance, polygon, front = self._meet(origin, d)
        shown = met & front
        texel = self._texel(polygon, origin + distance * d, shown)
        near = shown & (distance < NEAR_M)
        n_met = self._row(self.n, polygon, shown)
        anew = self._from_lamps(origin + distance * d + OFF_M * n_met, n_met, numbers, first + 200, near)
        direct = dr.select(near, anew, self._row(self.direct, texel, shown))
        B = self._row(self.rho, polygon, shown) * (direct + self._row(self.indirect, texel, shown))
        in_room = met & (front | dr.gather(mi.Bool, self.is_lamp, polygon, met))
        return dr.select(shown, B, 0), in_room

    def warm(self, coarse=(24, 16), fine=(10, 64), seed=1):
        """Finds the stored light: irradiance of every texel from lamps, and from what is reflected.

        coarse : bounces, rays of a texel, until the light has spread
        fine : passes, rays of a texel, that are averaged afterwards
        """
        totals = []
        for bounce in range(coarse[0]):
            mean = self._means(coarse[1], seed + bounce)
            totals.append(mean[1].sum(0))
            if bounce in SPREAD:
                mean[1] *= 1 + _still_to_come(*totals[-3:]) / totals[-1]
            self._store(mean)
        total = 0
        for k in range(fine[0]):
            total = total + self._means(fine[1], seed + 1000 + k)
            self._store(total / (k + 1))

    def _means(self, rays, seed) -> np.ndarray:
        """(2, texels, 3): a pass over all texels, as means."""
        new, seen = self._pass_over_texels(rays, seed)
        return new / np.maximum(seen, 1)[None, :, None]

    def _store(self, mean):
        self.direct, self.indirect = (self.mi.Float(x.astype(np.float32).ravel()) for x in mean)

    def _pass_over_texels(self, rays, seed):
        """((2, texels, 3) sums of irradiance from lamps and from reflections, (texels,) samples in the room)."""
        import drjit as dr

        mi, step = self.mi, max(1, CHUNK // rays)
        out, seen = np.zeros((2, self.texels, 3)), np.zeros(self.texels)
        for start in range(0, self.texels, step):
            count = min(step, self.texels - start)
            i = dr.arange(mi.UInt32, count * rays)
            texel, sample = i // rays + dr.opaque(mi.UInt32, start), i % rays
            numbers = lambda k, t=texel, s=sample: self._numbers(s, rays, t, k, dr.opaque(mi.UInt32, seed))
            polygon = dr.gather(mi.UInt32, self.owner, texel)
            n, nu = self._row(self.n, polygon), dr.maximum(dr.gather(mi.UInt32, self.nu, polygon), 1)
            nv, local = dr.gather(mi.UInt32, self.nv, polygon), texel - dr.gather(mi.UInt32, self.first, polygon)
            at = numbers(0)
            x, y = (mi.Float(local % nu) + at.x) / mi.Float(nu), (mi.Float(local // nu) + at.y) / mi.Float(nv)
            p = self._row(self.origin, polygon) + x * self._row(self.u, polygon) + y * self._row(self.v, polygon)
            p += OFF_M * n
            reflected, valid = self._reflected(p, n, numbers, 1)
            lit = self._from_lamps(p, n, numbers, 1000)
            sums = _sums([dr.select(valid, c, 0) for c in (*lit, *reflected, mi.Float(1))], rays)
            out[:, start : start + count] = sums[:6].reshape(2, 3, count).transpose(0, 2, 1)
            seen[start : start + count] = sums[6]
        return out, seen

    # ---- pictures ----

    def picture(self, spp, seed, K=None, T_cam_world=None) -> np.ndarray:
        """(H, W, 3) linear values: one pass of the recipe's view, or of another one."""
        import drjit as dr

        mi, (W, H) = self.mi, self.recipe.size
        T = np.linalg.inv(self.recipe.T_cam_world if T_cam_world is None else T_cam_world)
        K, step, out = self.recipe.K if K is None else K, max(1, CHUNK // spp), np.zeros((H * W, 3))
        # opaque: Dr.Jit widens a literal 0 to the first chunk's size, and the last chunk is shorter
        x_axis, y_axis, z_axis, eye = (
            mi.Vector3f(*(dr.opaque(mi.Float, float(c)) for c in T[:3, k])) for k in range(4)
        )
        for start in range(0, H * W, step):
            count = min(step, H * W - start)
            i = dr.arange(mi.UInt32, count * spp)
            pixel, sample = i // spp + dr.opaque(mi.UInt32, start), i % spp
            numbers = lambda k, p=pixel, s=sample: self._numbers(s, spp, p, k, dr.opaque(mi.UInt32, seed))
            q = numbers(0)
            x = (mi.Float(pixel % W) + q.x - 0.5 - float(K[0, 2])) / float(K[0, 0])
            y = (mi.Float(pixel // W) + q.y - 0.5 - float(K[1, 2])) / float(K[1, 1])
            d = dr.normalize(x * x_axis + y * y_axis + z_axis)
            met, distance, polygon, front = self._meet(eye, d)
            shown = met & front
            n = self._row(self.n, polygon, shown)
            p = eye + distance * d + OFF_M * n
            reflected, _ = self._reflected(p, n, numbers, 1)
            light = reflected + self._from_lamps(p, n, numbers, 1000)
            B = self._row(self.rho, polygon, shown) * light
            B += self._row(self.E, polygon, shown) * self._thrown(polygon, -d, shown)
            out[start : start + count] = _sums([dr.select(shown, c, 0) for c in B], spp).T / spp
        return out.reshape(H, W, 3)

    def passes(self, opt, labels, groups, K=None, T_cam_world=None) -> Passes:
        """Independent passes of one view; labels, groups : as in `Passes`."""
        passes = Passes((*labels.shape, 3), labels, groups)
        for k in range(opt.passes):
            passes.add(self.picture(opt.spp, opt.seed + k + 1, K, T_cam_world))
        return passes

    def shown(self) -> np.ndarray:
        """(H, W) number of the polygon at each pixel's centre; -1: nothing."""
        mi, (W, H) = self.mi, self.recipe.size
        d = directions(self.recipe.K, self.recipe.size, self.recipe.T_cam_world).reshape(-1, 3)
        d = (d / np.linalg.norm(d, axis=-1, keepdims=True)).astype(np.float32)
        eye = mi.Point3f(*map(float, np.linalg.inv(self.recipe.T_cam_world)[:3, 3]))
        met, _, polygon, _ = self._meet(eye, mi.Vector3f(*(mi.Float(np.ascontiguousarray(c)) for c in d.T)))
        return np.where(np.array(met), np.array(polygon).astype(int), -1).reshape(H, W)


def gathered(mi, recipe, folder, opt) -> tuple:
    """(passes, (H, W) groups, seeds used) like `pictures.render`; the passes also know `objects`, (H, W) index + 1."""
    import cv2

    room = Gatherer(mi, recipe, folder)
    room.warm(seed=opt.seed)
    number = room.shown()
    labels = _numbered(recipe.groups, recipe.polygons, lambda p: p.group)[number]
    lamps = np.isin(labels, [recipe.groups.index(g) + 1 for g in recipe.lamps])
    pure = np.where(lamps | (cv2.dilate(lamps.astype(np.uint8), np.ones((3, 3))) == 0), labels, 0)
    passes = room.passes(opt, pure, len(recipe.groups))
    passes.objects = _numbered(recipe.objects, recipe.polygons, lambda p: p.object)[number]
    return passes, labels, opt.passes + 1


def gathered_pair(mi, recipe, folder, opt) -> PairPictures:
    """Both views of a pair of pinholes, like `stereo_pictures.pair_of_photographs`."""
    room = Gatherer(mi, recipe, folder)
    room.warm(seed=opt.seed)
    labels = _numbered(recipe.groups, recipe.polygons, lambda p: p.group)[room.shown()]
    none = np.zeros_like(labels)
    views = {side: room.passes(opt, none, 0, lens.K, T) for side, (lens, T) in recipe.views().items()}
    return PairPictures(views, labels, opt.passes + 1)


def _numbered(names, polygons, key):
    """(P + 1,) index + 1 of each polygon's name; the last, 0, is of no polygon."""
    return np.array([names.index(key(p)) + 1 for p in polygons] + [0], np.uint16)


def _still_to_come(a, b, c) -> np.ndarray:
    """What later bounces add to c, per channel, where each adds the same share of the one before."""
    share = np.clip((c - b) / (b - a), 0, 0.95)
    return (c - b) * share / (1 - share)


def _sums(columns, number) -> np.ndarray:
    """(columns, n): sums of `number` neighbours each."""
    import drjit as dr

    dr.eval(columns)  # together: else each sum traces its rays anew
    return np.array([np.array(dr.block_sum(column, number)) for column in columns])


def _frame(polygon, texel_m):
    """(origin, u, v, texels along u, along v): a rectangle about a polygon."""
    e = polygon.points[1] - polygon.points[0]
    e = e / np.linalg.norm(e)
    f = np.cross(polygon.normal(), e)
    s, t = (polygon.points - polygon.points[0]) @ e, (polygon.points - polygon.points[0]) @ f
    origin = polygon.points[0] + s.min() * e + t.min() * f
    counts = [max(1, int(np.ceil(np.ptp(x) / texel_m))) for x in (s, t)]
    return origin, np.ptp(s) * e, np.ptp(t) * f, *counts
