"""Lamps that throw their light in lobes: the factors, what arrives of them, and what a photograph tells of them."""

import json
import os
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from lib.analysis.causes.candidates import Candidate
from lib.analysis.causes.lamp_lobe import LampLobe, across, moved
from lib.core.stage import BadInput
from lib.given import materials
from lib.given.transfer import Transfer
from lib.light import lamps as lamps_
from lib.light import lamps_kernels as kernels
from lib.light import specular, specular_file, specular_lamps, throws
from lib.light import surface as surfaces
from lib.light.chains import Chains
from lib.light.lamps import LAMBERTIAN, thrown
from lib.light.mirror_view import MirrorView
from lib.light.specular_file import Traced
from tests.helpers import rooms
from tests.helpers.made_problems import COLOURS, made
from tests.helpers.small_scenes import closed_room, finish, rectangle, surface

ROOT = Path(__file__).resolve().parents[1]
LAMP = np.array([[0, 0, 2.0], [0, 0.8, 2.0], [1.2, 0, 2.0]])  # shines downwards


def lobe(aim, exponent):
    return np.append(np.array(aim) / np.linalg.norm(aim), exponent)


def test_what_is_thrown():
    """max(0, cos)^exponent, of any length; a lobe of exponent 0 is even before the lamp and dark behind it."""
    along = np.array([[0, 0, -2.0], [0, 3.0, -3.0], [0, 1.0, 0.1]])
    assert np.allclose(thrown(lobe((0, 0, -1), 2), along), [1, 0.5, 0])
    assert np.allclose(thrown(lobe((0, 0, -1), 0), along), [1, 1, 0])
    assert np.allclose(thrown(LAMBERTIAN, along), 1)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 3.0, 20.0])
def test_the_factor_of_a_lobe_is_its_integral(exponent):
    """Against two million points of the lamp; receivers lie near, far, beside and aslant."""
    rng = np.random.default_rng(1)
    p = np.vstack([rng.uniform((-2, -2, 0), (2, 2, 1.8), (10, 3)), [[0.4, 0.3, 1.9]]])
    normals = np.array([[0, 0, 1.0], [0, 0.6, 0.8]])
    which, aim = np.arange(len(p)) % 2, lobe((0.3, 0.2, -1), exponent)
    lamp = kernels.LampArrays(LAMP[None], np.array([[0, 0, -1.0]]), np.ones(1), aim)
    found = kernels.factors(p, which, normals, lamp)
    a, b = rng.random((2, 2_000_000))
    r = np.sqrt(a)[:, None]
    q = (1 - r) * LAMP[0] + r * (1 - b[:, None]) * LAMP[1] + r * b[:, None] * LAMP[2]
    for i in range(len(p)):
        way = p[i] - q
        d = np.linalg.norm(way, axis=1)
        here, there = np.maximum(-way @ normals[which[i]], 0) / d, np.maximum(-way[:, 2], 0) / d
        true = (thrown(aim, way) * here * there / d**2).mean() * 0.48 / np.pi
        assert found[i] == pytest.approx(true, rel=5e-3, abs=1e-5)


# ---- in a room ----


@pytest.fixture(scope="module")
def room():
    """A closed room under a lamp of 1.2 x 0.7 m."""
    lamp = ("lamp", rectangle((1.4, 1.0, 2.4), (0, 0.7, 0), (1.2, 0, 0)))
    return surface([*closed_room(), lamp], ("lamp",))


@pytest.mark.parametrize("exponent", [0.5, 2.5, 8.0])
def test_a_share_of_the_lambertian_light_arrives(room, exponent):
    """Few rays tell the share of a patch as well as the lamp's factors do; its slopes are its differences."""
    aim, mesh = lobe((0.3, 0.1, -1), exponent), rooms.patches(room, 150)
    normal = surfaces.side_normals(room)[mesh.side]
    even, aimed = (
        lamps_.direct(
            room,
            lamps_.emitters(room, ["lamp"], lobes),
            mesh.centre,
            normal,
            np.arange(len(mesh)),
            1,
            n_samples=1,
            shadows=False,
        )[:, 0]
        for lobes in ({}, {"lamp": aim})
    )
    ways = throws.throws(room, "lamp", mesh.centre[:, None], normal)
    lit = even > 0.01 * even.max()
    assert np.allclose(ways.share(aim)[lit], (aimed / np.maximum(even, 1e-12))[lit], rtol=0.02, atol=0.01)
    axes = across(aim)
    for k, step in enumerate(1e-4 * np.eye(3)):
        there, back = (ways.share(moved(aim, sign * step)) for sign in (1, -1))
        assert np.allclose((there - back) / 2e-4, ways.slopes(aim, axes)[:, k], atol=2e-2 * max(exponent, 1))


def test_a_mirror_shows_a_lobe_mirrored(room):
    """A mirror on the floor throws the light up again, along the mirrored aim."""
    lamps, chains = lamps_.emitters(room, ["lamp"], {"lamp": lobe((0.3, 0.1, -1), 2)}), Chains(1)
    (image, *_), *_ = specular_lamps.mirrored_lamps(room, finish(room, bottom="mirror"), chains, lamps)
    assert np.allclose(image.lobe, lobe((0.3, 0.1, 1), 2))


def test_what_fit_traced_keeps_the_lobes(room, tmp_path):
    """A file of lambertian lamps, or of another lobe, is not taken for this one."""
    lobes = {"lamp": lobe((0.3, 0.1, -1), 2)}
    lamps, mesh = lamps_.emitters(room, ["lamp"], lobes), rooms.patches(room, 60)
    made = specular.transport(room, mesh, finish(room, bottom="mirror"), Chains(1), lamps, 1)
    none = MirrorView(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 3)), np.zeros(0, int), np.zeros((0, 3)))
    specular_file.write(tmp_path / "specular.npz", Traced(made, np.zeros(0, int), none, lobes["lamp"][None]))
    found = specular_file.read(tmp_path / "specular.npz")
    assert len(made.mirrored) and np.allclose([lamp.lobe for lamp in found.transport.mirrored], lobe((0.3, 0.1, 1), 2))
    assert found.fits(made.finish, len(mesh), lobes["lamp"][None])
    assert not found.fits(made.finish, len(mesh), LAMBERTIAN[None])


def test_a_lobe_without_a_direction_is_refused(tmp_path):
    (tmp_path / "m.json").write_text('{"groups": {}, "lamps": {"lamp": {"lobe": {"aim": [0, 0, 0], "exponent": 2}}}}')
    with pytest.raises(BadInput, match=r"lamps.lamp.lobe.aim"):
        materials.read(tmp_path / "m.json")


# ---- in a made room whose tiles see the lamp from all sides ----


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def under_a_lobe(true, seed):
    """(problem, LampLobe) of a photograph under a lamp with that lobe."""
    problem, rho, _ = made(COLOURS, seed=seed)
    rng = np.random.default_rng(seed)
    way = lambda n: throws.Throws(unit(rng.normal(size=(n, 1, 3)) * (1, 1, 0.3) - (0, 0, 1)), np.ones((n, 1)))
    tiles = SimpleNamespace(direct=problem.D_tile)
    lobes = LampLobe(None, SimpleNamespace(lamp_factor=problem.D), SimpleNamespace(tiles=tiles), ("lamp",))
    lobes.__dict__["ways"] = {"lamp": (way(6), way(len(problem.tile_group)))}
    lit, F = lobes.standing(problem, {"lamp": true}), problem.F.toarray()
    first = rho * (lit.D @ problem.emittance)
    b = np.stack([np.linalg.solve(np.eye(6) - rho[:, [c]] * F, first[:, c]) for c in range(3)], axis=1)
    B = rho[problem.tile_group] * (lit.D_tile @ problem.emittance + problem.G @ b)
    noise = 1 + 0.01 * rng.standard_normal((problem.start[-1], 3))
    shown = Transfer("gamma", 2.0).display(np.maximum(np.repeat(B, problem.n_pixels, axis=0) * noise, 0))
    return replace(problem, pixels=shown), lobes


@pytest.mark.parametrize("exponent", [1.0, 3.0])
def test_a_lobe_is_found_from_far_away(exponent):
    """From 24 starts up to 80 degrees off: 44 of 48 of both exponents; steps that only a prior held back found 39."""
    true, found = lobe((0.3, -0.4, -1), exponent), 0
    for seed in range(3):
        problem, lobes = under_a_lobe(true, seed)
        given = Candidate.of(problem)
        for aim in ((0, 0, -1), (0.8, 0.3, -0.6), (-0.8, 0.5, -0.5), (0.5, -0.9, -0.3)):
            for begin in (1.0, 3.0):
                last = lobes.fitted(given, {"lamp": lobe(aim, begin)}).taken[lobes.name]["lamp"]
                found += bool(last[:3] @ true[:3] > 0.9999 and abs(last[3] - exponent) < 0.05)
    assert found >= 22


# ---- a photograph ----


def fitted(folder, facts):
    """materials.json of the lobed room under other facts."""
    scene = folder / "data/lobed"
    shutil.copytree(ROOT / "data/lobed-8", scene, ignore=shutil.ignore_patterns("truth"))
    (scene / "scene.yaml").write_text(facts)
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    words = ["make", f"DATA={folder / 'data'}", f"BUILD={folder / 'build'}", "lobed/fit"]
    run = subprocess.run(words, cwd=ROOT, env=clean, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    return materials.read(folder / "build/lobed/materials.json")


TRUTH = materials.read(ROOT / "data/lobed-8/truth/materials.json")
LAMP_YAML = "lamps: {lamp: {emittance: [36.2979, 31.3137, 27.1693], lobe: %s}}\n"


def error(found):
    pairs = [(found.groups[name].rho_d, group.rho_d) for name, group in TRUTH.groups.items()]
    return np.mean([np.abs(np.divide(ours, true) - 1) for ours, true in pairs if ours is not None])


def most_in_sigmas(found):
    """Of what is claimed; 0 where nothing is."""
    claims = [(group, TRUTH.groups[name]) for name, group in found.groups.items() if group.identified]
    return max((np.abs(np.subtract(g.rho_d, t.rho_d) / g.sigma.rho_d).max() for g, t in claims), default=0)


@pytest.mark.scene
@pytest.mark.slow
def test_a_lobe_that_is_told_is_taken_as_it_is(tmp_path):
    true = TRUTH.lamps["lamp"].lobe
    told = json.dumps({"aim": [2 * v for v in true.aim], "exponent": true.exponent})
    found = fitted(tmp_path, LAMP_YAML % told)
    assert found.status == "converged" and found.explained == [] and error(found) < 0.01
    assert found.lamps["lamp"].sigma is None and np.allclose(found.lobes["lamp"], TRUTH.lobes["lamp"])


@pytest.mark.scene
@pytest.mark.slow
def test_a_lobe_that_is_asked_for_is_found_without_leave(tmp_path):
    found = fitted(tmp_path, LAMP_YAML % "unknown" + "explain: []\n")
    lamp, sigma = found.lobes["lamp"], found.lamps["lamp"].sigma
    assert found.status == "converged" and error(found) < 0.01
    assert np.degrees(np.arccos(lamp[:3] @ TRUTH.lobes["lamp"][:3])) < 3 * sigma.aim_deg < 2
    assert abs(lamp[3] - TRUTH.lobes["lamp"][3]) < 3 * sigma.exponent < 0.1


@pytest.mark.slow
def test_the_ladder_climbs_in_the_light_of_a_lobe(tmp_path):
    found = fitted(tmp_path, "lamps: {lamp: [36.2979, 31.3137, 27.1693]}\nsurfaces: {crate: textured}\n")
    assert found.status == "converged" and found.groups["crate"].kind == "textured" and error(found) < 0.02
    assert np.degrees(np.arccos(found.lobes["lamp"][:3] @ TRUTH.lobes["lamp"][:3])) < 1


@pytest.mark.slow
def test_without_leave_a_lobe_is_a_misfit(tmp_path):
    found = fitted(tmp_path, "lamps: {lamp: [36.2979, 31.3137, 27.1693]}\nexplain: []\n")
    assert found.status in ("approximate", "does not fit") and found.why and most_in_sigmas(found) < 3


@pytest.mark.scene
def test_a_lobe_that_is_told_wrongly_is_named(tmp_path):
    true = TRUTH.lamps["lamp"].lobe
    found = fitted(tmp_path, LAMP_YAML % json.dumps({"aim": list(true.aim), "exponent": true.exponent + 1}))
    assert found.status in ("approximate", "does not fit") and most_in_sigmas(found) < 3
    assert [(why.cause, why.subject) for why in found.why] == [("lamp_lobe", "lamp")]
    said = float(found.why[0].text.split("cos^")[1].split()[0])
    assert said == pytest.approx(true.exponent, abs=0.1)
