"""A path tracer of Mitsuba that also finds lamps in flat mirrors."""

import itertools
from typing import NamedTuple

import numpy as np

from lib.synthetic.mitsuba_scene import MAX_DEPTH


class Mirror(NamedTuple):
    """A flat perfect mirror; arrays of NumPy."""

    point: np.ndarray  # (3,) m: on its plane
    normal: np.ndarray  # (3,) unit
    rho_s: tuple
    shape: object  # Mitsuba's pointer to it


class Lamp(NamedTuple):
    """A lamp, which is a parallelogram."""

    corner: np.ndarray  # (3,) m
    a: np.ndarray  # (3,) m: one side
    b: np.ndarray  # (3,) m: the other
    normal: np.ndarray  # (3,) unit
    area: float  # m2
    radiance: np.ndarray  # (3,)


def tracer(mi, recipe, scene, roulette):
    """The path tracer of the scene: Mitsuba's own, or its twin below where perfect mirrors hang."""
    if not recipe.mirrors():
        return mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": roulette})
    return mirrored_lamps(mi)(recipe, scene, roulette)


def _mirrors(mi, recipe, scene):
    shapes = {s.id(): s for s in scene.shapes()}
    out = []
    for p in recipe.mirrors():
        n = np.cross(p.points[1] - p.points[0], p.points[2] - p.points[0])
        shape = mi.ShapePtr(shapes.get(f"group{recipe.groups.index(p.group)}"))
        out.append(Mirror(p.points[0], n / np.linalg.norm(n), recipe.surface(p.group).rho_s, shape))
    return out


def _lamps(recipe):
    out = []
    for p in (p for p in recipe.polygons if p.group in recipe.lamps):
        a, b = p.points[1] - p.points[0], p.points[3] - p.points[0]
        assert np.allclose(p.points[2], p.points[1] + b), "lamps are parallelograms"
        n = np.cross(a, b)
        area = np.linalg.norm(n)
        out.append(Lamp(p.points[0], a, b, n / area, area, np.array(recipe.lamps[p.group]) / np.pi))
    return out


def mirrored_lamps(mi, order=2):
    """The class of a path tracer that samples lamps also through up to `order` flat mirrors.

    Light that falls from a lamp by way of a mirror is what a plain path tracer meets by chance alone (fireflies).
    Here one point y is drawn on the lamps at every vertex with a diffuse or glossy lobe, for each chain of mirrors
    (m1, m2, ...), the empty one included.  Seen from there y lies at its mirror image R_m1 R_m2 y.  The ray towards it
    must meet just those mirrors and then y.  A ray that the BSDF draws may find the same light; both are weighted by
    the power heuristic, with the unfolded length for the distance.  Chains beyond `order` stay with the BSDF's rays
    alone.  So the mean is that of Mitsuba's `path`, and the variance bearable.
    """
    import drjit as dr

    class MirroredLamps(mi.SamplingIntegrator):
        def __init__(self, recipe, scene, roulette):
            super().__init__(mi.Properties())
            self.modules, self.roulette = (mi, dr), roulette
            self.mirrors, self.lamps = _mirrors(mi, recipe, scene), _lamps(recipe)
            self.area = sum(lamp.area for lamp in self.lamps)
            self.chains = [
                chain
                for length in range(order + 1)
                for chain in itertools.product(range(len(self.mirrors)), repeat=length)
                if all(a != b for a, b in itertools.pairwise(chain))
            ]

        def code(self, chain):
            """A number for a chain, as the loop below counts it up."""
            k = 0
            for m in chain:
                k = k * (len(self.mirrors) + 1) + m + 1
            return k

        def mirror_of(self, si):
            """1 + index of the mirror that was met, or 0."""
            k = mi.UInt32(0)
            for i, mirror in enumerate(self.mirrors):
                k = dr.select(si.shape == mirror.shape, mi.UInt32(i + 1), k)
            return k

        def lamp_point(self, u, v):
            """A point uniform over all lamps, its lamp's normal and radiance; u, v in [0, 1)."""
            y, n, radiance = mi.Point3f(0), mi.Normal3f(0, 0, 1), mi.Color3f(0)
            low = 0.0
            for lamp in self.lamps:
                share = lamp.area / self.area
                here = (u >= low) & (u < low + share)
                s = (u - low) / share
                corner, a, b = (list(map(float, v3)) for v3 in (lamp.corner, lamp.a, lamp.b))
                at = mi.Point3f(*(corner[k] + s * a[k] + v * b[k] for k in range(3)))
                y, n = dr.select(here, at, y), dr.select(here, mi.Normal3f(*map(float, lamp.normal)), n)
                radiance = dr.select(here, mi.Color3f(*map(float, lamp.radiance)), radiance)
                low += share
            return y, n, radiance

        def mirror_image(self, y, chain):
            """Where y appears through the mirrors of the chain, the one nearest to the viewer first."""
            image = mi.Point3f(y)
            for mirror in (self.mirrors[m] for m in reversed(chain)):
                n3 = mi.Vector3f(*map(float, mirror.normal))
                image = image - 2 * (dr.dot(n3, image) - float(mirror.normal @ mirror.point)) * n3
            return image

        def light(self, scene, ctx, bsdf, si, sampler, active):
            """The light of all lamps by all chains that si reflects to its viewer."""
            L = mi.Color3f(0)
            for chain in self.chains:
                xi = sampler.next_2d(active)
                y, normal, radiance = self.lamp_point(xi.x, xi.y)
                d = self.mirror_image(y, chain) - si.p
                length = dr.norm(d)
                d /= length
                wo = si.to_local(d)
                value, density = bsdf.eval_pdf(ctx, si, wo, active)
                ok = active & (dr.max(value) > 0)
                at, weight = dr.detach(si), mi.Color3f(1)
                for mirror in (self.mirrors[m] for m in chain):
                    n3 = mi.Vector3f(*map(float, mirror.normal))
                    at = scene.ray_intersect(at.spawn_ray(d), ok)
                    ok &= at.is_valid() & (at.shape == mirror.shape)
                    d = d - 2 * dr.dot(d, n3) * n3
                    weight *= mi.Color3f(*map(float, mirror.rho_s))
                cosine = -dr.dot(d, normal)
                ok &= cosine > 1e-6
                ok &= ~scene.ray_test(at.spawn_ray_to(y), ok)
                pdf = dr.square(length) / (dr.maximum(cosine, 1e-6) * self.area)
                mis = dr.square(pdf) / (dr.square(pdf) + dr.square(density))
                L += dr.select(ok, value * weight * radiance * (mis / pdf), 0)
            return L

        @dr.syntax
        def sample(self, scene, sampler, ray, medium=None, active=True):
            mi, dr = self.modules  # dr.syntax sees no names of the functions around
            ctx = mi.BSDFContext()
            ray = mi.Ray3f(ray)
            L, beta = mi.Color3f(0), mi.Color3f(1)
            depth, chain, length = mi.UInt32(0), mi.UInt32(0), mi.Float(0)
            density, straight = mi.Float(1), mi.Bool(True)  # of the last ray of a BSDF's lobe; no such ray yet
            active = mi.Bool(active)
            while active:
                si = scene.ray_intersect(ray, active)
                active &= si.is_valid()
                length += dr.select(active, si.t, 0)
                # a lamp that was met
                Le = si.emitter(scene, active).eval(si, active)
                pdf = dr.square(length) / (dr.maximum(si.wi.z, 1e-6) * self.area)
                sampled = mi.Bool(False)
                for c in self.chains:
                    sampled |= chain == self.code(c)
                mis = dr.select(straight | ~sampled, 1, dr.square(density) / (dr.square(density) + dr.square(pdf)))
                L += dr.select(active, beta * Le * mis, 0)
                active &= depth + 1 < MAX_DEPTH
                # lamps, directly and in mirrors
                bsdf = si.bsdf(ray)
                smooth = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
                L += beta * self.light(scene, ctx, bsdf, si, sampler, smooth)
                # on
                bs, weight = bsdf.sample(ctx, si, sampler.next_1d(active), sampler.next_2d(active), active)
                ray = si.spawn_ray(si.to_world(bs.wo))
                beta *= weight
                delta = mi.has_flag(bs.sampled_type, mi.BSDFFlags.Delta)
                chain = dr.select(delta, chain * (len(self.mirrors) + 1) + self.mirror_of(si), 0)
                length = dr.select(delta, length, 0)
                density = dr.select(delta, density, bs.pdf)
                straight &= delta
                depth += 1
                survival = dr.select(depth >= self.roulette, dr.minimum(dr.max(beta), 0.95), 1)
                active &= (dr.max(beta) > 0) & (sampler.next_1d(active) < survival)
                beta *= dr.rcp(dr.maximum(survival, 1e-6))
            return L, mi.Bool(True), []

    return MirroredLamps
