"""What is our own in Mitsuba: Ward's lobe, lamps that are found by way of mirrors, stored light that is gathered.

Mitsuba runs only where `make scenes` has put it; these tests skip elsewhere.
"""

import functools
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.helpers.made_scenes import DATA

ROOT = Path(__file__).resolve().parents[1]

HEAD = """
import json, mitsuba as mi, numpy as np
mi.set_variant('llvm_ad_rgb')
import drjit as dr
from lib.synthetic import recipes
from lib.synthetic.mirrored_lamps import tracer
from lib.synthetic.mitsuba_scene import bsdf_of, mitsuba_scene
from lib.synthetic.pictures import group_picture
from lib.synthetic.ward_bsdf import register_ward
register_ward(mi)
"""


@functools.cache
def with_mitsuba(code):
    """What a program prints as JSON in Mitsuba's own environment (`make scenes`); skips where there is none.

    It has `mi`, `np`, `dr`, `recipes`, `bsdf_of`, `mitsuba_scene`, `group_picture` and `tracer` at hand.
    """
    python = ROOT / ".venv-scenes" / "bin" / "python"
    library = sorted(Path("/usr/lib").glob("*/libLLVM.so.1[6-9]*")) + sorted(Path("/usr/lib").glob("*/libLLVM.so.2*"))
    if not python.exists() or not (library or "DRJIT_LIBLLVM_PATH" in os.environ):
        pytest.skip("no Mitsuba with LLVM here")
    run = subprocess.run(
        [python, "-c", HEAD + code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={"DRJIT_LIBLLVM_PATH": str(library[0]) if library else ""} | os.environ,
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return json.loads(run.stdout.splitlines()[-1])


WARD = """
def ward(rho_d, rho_s, alpha, tangent=(0., 0, 0)):
    rgb = {"rho_d": [rho_d] * 3, "rho_s": [rho_s] * 3}
    return mi.load_dict({"type": "ward", **rgb, "alpha": [*alpha, 0.], "tangent": list(tangent)})
def at(theta, phi=0.):
    return mi.Vector3f(*map(float, (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))))
def surface(wi, n):
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi, si.sh_frame = wi, mi.Frame3f(mi.Normal3f(0, 0, 1))
    return si
ctx = mi.BSDFContext()
def sampler(n):
    s = mi.load_dict({"type": "independent"})
    s.seed(1, n)
    return s
"""


def test_ward_albedo():
    """Directional albedo at 0, 45, 75 and 89 degrees, sampled: the known table of the bounded form.

    Sampling loses and gains nothing.
    """
    table = with_mitsuba(
        WARD
        + """
n, out = 2_000_000, []
for a in (.05, .3):
    for deg in (0, 45, 75, 89):
        s = sampler(n)
        si = surface(at(np.radians(float(deg))), n)
        bs, w = ward(0., 1., (a, a)).sample(ctx, si, s.next_1d(), s.next_2d(), True)
        out.append(float(dr.mean(w.x)[0]))
print(json.dumps(out))"""
    )
    assert table == pytest.approx([0.998, 0.996, 0.979, 0.825, 0.910, 0.864, 0.778, 0.917], abs=0.0015)


def test_ward_density_is_what_sampling_draws():
    """Uniform directions against the BSDF's own, anisotropic and mixed with diffuse.

    The density integrates to what is not lost below the surface, value / density to the same albedo.
    """
    r = with_mitsuba(
        WARD
        + """
n = 4_000_000
b = ward(.1, .4, (.35, .12), (.6, .8, 0.))
s = sampler(n)
si = surface(at(.9, .4), n)
wo = mi.warp.square_to_uniform_hemisphere(s.next_2d())
value, density = b.eval_pdf(ctx, si, wo, True)
bs, w = b.sample(ctx, si, s.next_1d(), s.next_2d(), True)
again, pdf = b.eval_pdf(ctx, si, bs.wo, True)
m = lambda x: float(dr.mean(x)[0])
print(json.dumps([m(density) * 2 * np.pi, m(dr.select(bs.pdf > 0, 1., 0.)),
                  m(value.x) * 2 * np.pi, m(w.x),
                  float(dr.max(dr.abs(pdf - bs.pdf))[0]),
                  m(wo.x * value.x) * 2 * np.pi, m(bs.wo.x * w.x),
                  m(b.eval(ctx, si, -wo, True).x)]))"""
    )
    assert r[0] == pytest.approx(r[1], abs=0.003) and r[2] == pytest.approx(r[3], rel=0.005) and r[4] < 1e-3
    assert r[5] == pytest.approx(r[6], rel=0.01) and r[7] == 0


def test_ward_is_radiance():
    """45 values of the real Radiance (data/brdf-ward-radiance).

    The tangent, turned with the azimuths, changes nothing.
    """
    table = DATA / "brdf-ward-radiance" / "ward_brdf_radiance.csv"
    if not table.exists():
        pytest.skip("no table")
    rows = np.genfromtxt(table, delimiter=",", names=True, dtype=None, encoding=None)
    numbers = [
        [float(r[c]) for c in ("rho_s", "alpha", "theta_i_deg", "theta_o_deg", "dphi_deg", "f_radiance")] for r in rows
    ]
    values = np.array(
        with_mitsuba(
            WARD
            + f"""
out = []
for rho_s, alpha, ti, to, dphi, f in {numbers}:
    for turn in (0., .7):
        b = ward(0., rho_s, (alpha, alpha), (float(np.cos(turn)), float(np.sin(turn)), 0.))
        wo = at(np.radians(to), np.radians(dphi) + turn)
        out.append(float((b.eval(ctx, surface(at(np.radians(ti), turn), 1), wo, True).x / wo.z)[0]))
b = [ward(0., 1., (.4, .1), t) for t in ((1., 0, 0), (.6, .8, 0), (0., 1, 0), (1., 0, 5.))]
turn = float(np.arctan2(.8, .6))
for k, t in ((0, 0.), (1, turn), (2, np.pi / 2), (3, 0.)):
    out.append(float(b[k].eval(ctx, surface(at(.5, t + .2), 1), at(.7, t + 2.9), True).x[0]))
print(json.dumps(out))"""
        )
    )
    values, turned = values[:-4], values[-4:]
    f = np.repeat([n[-1] for n in numbers], 2)
    assert np.abs(values - f).max() < 2e-4 and np.allclose(values, f, rtol=2e-4, atol=1e-6)
    assert turned == pytest.approx([turned[0]] * 4, rel=1e-4) and turned[0] > 0.01


@pytest.mark.slow
def test_lamps_through_mirrors_have_the_mean_of_mitsuba():
    """Mitsuba's own path tracer and its twin that samples lamps through mirrors give groups the same means.

    Small pictures of the scenes with mirrors. The mirror reflects exactly rho_s, also under a glancing angle.
    """
    out = with_mitsuba(
        WARD
        + """
import tempfile
from dataclasses import replace
from pathlib import Path
out = []
for name in ("office-coloured-mirror", "two-mirrors"):
    r = recipes.make(name)
    K = r.K.copy()
    K[:2] /= 16
    K[:2, 2] += .5 / 16 - .5
    r = replace(r, K=K, size=(40, 30))
    with tempfile.TemporaryDirectory() as folder:
        scene = mitsuba_scene(mi, r, Path(folder), 6)
        labels = group_picture(mi, scene, r)
        own = mi.load_dict({"type": "path", "max_depth": 120, "rr_depth": 6})
        for k, g in enumerate(r.groups):
            if g not in r.lamps and (labels == k + 1).sum() >= 20:
                out.append([(labels == k + 1).tolist()])
        for integrator in (own, tracer(mi, r, scene, 6)):
            picture = lambda s: np.array(mi.render(scene, integrator=integrator, spp=128, seed=s), dtype=float)
            images = np.array([picture(s).mean(-1) for s in range(16)])
            for o in out:
                if len(o[0]) == 30 and len(o) < 3:
                    of = images[:, np.array(o[0])].mean(1)
                    o.append([of.mean(), of.std(ddof=1) / 4])
    for o in out:
        o[0] = name
gold = mi.load_dict(bsdf_of(mi, recipes.make("office-coloured-mirror"), "mirror"))
for deg in (0., 60., 89.):
    bs, w = gold.sample(ctx, surface(at(np.radians(deg)), 1), mi.Float(.3), mi.Point2f(.2, .7), True)
    out.append(["rho_s", [float(w[c][0]) for c in range(3)]])
print(json.dumps(out))"""
    )
    for _, w in (o for o in out if o[0] == "rho_s"):
        assert w == pytest.approx([0.88, 0.72, 0.50], abs=1e-6)
    groups = [o for o in out if o[0] != "rho_s"]
    z = np.array([(a - b) / np.hypot(sa, sb) for _, (a, sa), (b, sb) in groups])
    assert len(z) > 12 and np.abs(z).max() < 4.5 and np.sqrt((z**2).mean()) < 1.7, z
    assert np.median([sb / sa for _, (a, sa), (b, sb) in groups]) < 1


@pytest.mark.outside
@pytest.mark.slow
def test_gathering_has_the_mean_of_mitsuba():
    """Groups of a random room by Mitsuba's own path tracer, and by stored light: the same means, less noise."""
    out = with_mitsuba(
        """
import tempfile
from dataclasses import replace
from pathlib import Path
from lib.synthetic.gathering import Gatherer
r = recipes.make("small-202")
K = r.K.copy()
K[:2] /= 10
K[:2, 2] += .5 / 10 - .5
r = replace(r, K=K, size=(40, 30))
with tempfile.TemporaryDirectory() as folder:
    scene = mitsuba_scene(mi, r, Path(folder), 8)
    labels = group_picture(mi, scene, r)
    own = mi.load_dict({"type": "path", "max_depth": 120, "rr_depth": 8})
    room = Gatherer(mi, r, Path(folder), texel_m=0.05)
    room.warm(coarse=(20, 16), fine=(4, 64))
    pictures = (lambda s: np.array(mi.render(scene, integrator=own, spp=256, seed=s), dtype=float) * np.pi,
                lambda s: room.picture(256, s))
    images = [np.array([picture(s) for s in range(12)]) for picture in pictures]
    out = [np.median(x.std(0) / x.mean(0)) for x in images]
    for k, g in enumerate(r.groups):
        if g not in r.lamps and (labels == k + 1).sum() >= 20:
            of = [x[:, labels == k + 1].mean((1, 2)) for x in images]
            out.append([of[1].mean() / of[0].mean() - 1, of[0].std(ddof=1) / 12 ** .5 / of[0].mean()])
print(json.dumps(out))"""
    )
    path, gathered, *groups = out
    off, sigma = np.array(groups).T
    assert len(groups) >= 6 and gathered < 0.5 * path
    assert np.abs(off / np.hypot(sigma, 0.0015)).max() < 4, off
