"""Photometry, section 4: gamma, exposure, noise, black and white, lamps that are told wrongly."""

import contextlib
import io
import tempfile
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from lib.analysis.causes import explain
from lib.analysis.causes.response import RESOLVED
from lib.analysis.causes.scope import Scope
from lib.analysis.fit.gauss_newton import fit, gauss_newton
from tests.helpers import rooms, small_scenes
from tests.helpers.boxes import look
from tests.helpers.made_problems import COLOURS, made
from tests.verify.walks import Found, near, walk

PART = "photometry"


# ---- problems that are made: light and tiles are the model's own ----


@walk(
    PART,
    "gamma",
    law="found, and the reflectances with it",
    axis="gamma",
    at=[0.3, 0.5, 0.7, 1.0, 1.4, 1.8, 2.2, 2.6, 3.5, 5.0],
)
def gamma(value):
    problem, rho, _ = made(COLOURS, gamma=value)
    found = gauss_newton(problem, max_iterations=100)
    both = np.append(found.state.rho.ravel(), found.state.gamma / value)
    return near(both, np.append(rho.ravel(), 1.0), 1e-3, iterations=found.iterations)


@walk(
    PART,
    "black and white groups",
    law="found, and never outside [0, 1]",
    axis="rho",
    at=[0.0, 1e-3, 0.5, 0.9, 0.99, 0.999],
)
def ends(value):
    problem, rho, _ = made([value, 0.3, 0.5, 0.2, 0.7])
    found = gauss_newton(problem, max_iterations=100)
    inside = ((found.state.rho >= 0) & (found.state.rho <= 1)).all()
    return near(found.state.rho, rho, 2e-3 if inside else 0.0, iterations=found.iterations)


@walk(PART, "every wall white", law="found", axis="1 - rho", at=[0.5, 0.1, 1e-2, 1e-3])
def white(loss):
    problem, rho, _ = made(np.full(5, 1 - loss) - 0.1 * loss * np.arange(5), tiles=60, E=(0.15,))  # nothing saturated
    found = explain.explain(problem, Scope(allowed=()), gamma=2.2, max_iterations=100).result
    return near(found.state.rho, rho, 2e-3, iterations=found.iterations)


@walk(
    PART,
    "noise",
    law="no value is 4.5 of its sigma off; ten seeds",
    axis="noise of a pixel",
    at=[1e-3, 3e-3, 1e-2, 3e-2, 0.1],
)
def noise(share):
    z, steps = [], 0
    for seed in range(10):
        problem, rho, _ = made(COLOURS, noise=share, seed=seed)
        found = gauss_newton(problem)
        z.append(np.abs(found.state.rho - rho)[1:] / found.sigma_rho[1:])
        steps = max(steps, found.iterations)
    worst = float(np.max(z))
    return Found(worst, 0.0, worst, 4.5, steps, f"rms {np.sqrt(np.mean(np.square(z))):.2f} sigma")


@walk(PART, "tiles of a group", law="within 4.5 of sigma, down to one pixel", axis="pixels", at=[1, 2, 4, 40, 400])
def few(pixels):
    problem, rho, _ = made(COLOURS, noise=0.01, tiles=1 if pixels < 4 else 10, pixels=pixels)
    found = gauss_newton(problem, max_iterations=100)
    if found.sigma_rho is None:
        return Found(None, None, 0.0, 0.0, found.iterations, "no sigma: nothing claimed")
    z = float((np.abs(found.state.rho - rho)[1:] / np.maximum(found.sigma_rho[1:], 1e-12)).max())
    return Found(z, 0.0, z, 4.5, found.iterations)


@walk(
    PART,
    "groups never seen",
    law="found by the light they give; without any, nothing is claimed",
    axis="unseen of five",
    at=[0, 1, 2, 5],
)
def unseen(n):
    problem, rho, _ = made(COLOURS, unseen=tuple(range(1, n + 1)))
    found = gauss_newton(problem)
    if n == 5:
        claimed = found.converged or found.sigma_rho is not None or not np.isfinite(found.state.rho).all()
        return Found(None, None, float(claimed), 0.0, found.iterations, "nothing seen, nothing claimed")
    return near(found.state.rho, rho, 4e-3, iterations=found.iterations)


@walk(
    PART,
    "a lamp of unknown power",
    law="within 4 of sigma, by interreflection alone",
    axis="rho",
    at=[0.2, 0.5, 0.8, 0.9],
)
def unknown_lamp(value):
    problem, rho, _ = made(value - 0.05 * np.arange(5) * value, given_E=False)
    found, scale = fit(problem)
    if scale == "convention":
        return Found(None, None, 0.0, 0.0, found.iterations, "scale by convention, and said so")
    off = abs(found.state.E[0, 0] - 1.5)
    return Found(float(found.state.E[0, 0]), 1.5, float(off), float(4 * found.sigma_E[0, 0] + 1e-2), found.iterations)


# ---- photographs of a room by our own renderer, through the stages gather and fit ----

PAINTS = {"bottom": 0.45, "top": 0.8, "west": 0.6, "east": 0.3, "north": 0.7, "south": 0.5, "box": 0.25, "lamp": 0.0}
POWER = 6.0


@cache
def studio():
    """A room with a box, seen once, and its linear light at POWER."""
    folder = Path(tempfile.mkdtemp(prefix="verify-"))
    objects = rooms.room() | rooms.LAMP | rooms.solid("box", 1.2, 1.6, 0, 2.1, 2.4, 0.8)
    camera = look(
        (0.3, 0.3, 1.6),
        (2.4, 2.2, 0.9),
        width=320,
        height=240,
        K=np.array([[220.0, 0, 159.5], [0, 220, 119.5], [0, 0, 1]]),
    )
    with contextlib.redirect_stderr(io.StringIO()):
        made_ = small_scenes.Studio(folder, objects, camera)
        linear = made_.picture(PAINTS, (POWER,))
    return SimpleNamespace(studio=made_, linear=linear)


def fitted(linear, told, *, noise=0.004, bits=8, gamma=2.2, **facts):
    """materials.json of a photograph of the room."""
    photograph = small_scenes.photograph(linear, gamma=gamma, noise=noise, bits=bits)
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        materials, report = studio().studio.fit(photograph, (told,), **facts)
    return materials, report


def judged(materials, report, wanted=4.5):
    """The worst claim in sigma, of groups that are identified: what is not claimed is not wrong."""
    worst, claims = 0.0, 0
    for name, group in materials["groups"].items():
        if group["identified"] and group["rho_d"] and group["sigma"] and group["kind"] == "diffuse":
            claims += 1
            off = abs(group["rho_d"][0] - PAINTS[name])
            worst = max(worst, off / max(group["sigma"]["rho_d"][0] or 1e-9, 1e-9))
    note = f"{materials['status']}, {claims} of {len(PAINTS) - 1} claimed"
    return Found(worst, 0.0, worst, wanted, report["iterations"], note)


@walk(
    PART, "exposure", law="within 4.5 of sigma, or not claimed", axis="times", at=[0.02, 0.05, 0.2, 1.0, 3.0, 8.0, 20.0]
)
def exposure(times):
    """What is white is left out, and what is black; told lamps are those of the photograph."""
    return judged(*fitted(times * studio().linear, times * POWER))


@walk(
    PART,
    "noise of a photograph",
    law="within 4.5 of sigma, or not claimed",
    axis="display",
    at=[0.0, 0.01, 0.03, 0.1],
    short=[0, 2],
)
def noisy(sigma):
    return judged(*fitted(studio().linear, POWER, noise=sigma))


@walk(
    PART,
    "a lamp told wrongly",
    law="named or not claimed: no value 4.5 sigma off",
    axis="times",
    at=[0.1, 0.5, 0.8, 1.0, 1.25, 2.0, 10.0],
    short=[1, 3, 6],
)
def wrong_lamp(times):
    return judged(*fitted(studio().linear, times * POWER))


@walk(
    PART,
    "a reference told wrongly",
    law="named, or no value 4.5 sigma off; right ones are not accused",
    axis="rho told for .7",
    at=[0.3, 0.5, 0.65, 0.68, 0.7, 0.72, 0.75, 0.9],
    short=[1, 4, 6],
)
def wrong_reference(rho):
    """Beside a told lamp. A group that is told claims nothing of its own."""
    materials, report = fitted(studio().linear, POWER, reference={"north": [rho] * 3})
    told = materials["groups"].pop("north")
    found, accused = judged(materials, report), [w["subject"] for w in materials["why"] or []]
    right = (
        accused in ([], ["north"]) and (not accused or rho != PAINTS["north"]) and told["identified"] != bool(accused)
    )
    return found._replace(error=found.error if right else np.inf)


@walk(
    PART,
    "transfer told wrongly",
    law="named, or nothing 4.5 sigma off; what the picture hardly shows is a fact",
    at=["linear", "gamma 2.0", "gamma 2.1", "srgb", "gamma 2.2"],
    short=[0, 1, 3],
)
def wrong_transfer(told):
    """sRGB told for a gamma of 2.2: the tiles would not choose between them, and the reflectances differ."""
    transfer = {"gamma": float(told.split()[1])} if told.startswith("gamma") else told
    materials, report = fitted(studio().linear, POWER, transfer=transfer)
    found = judged(materials, report)
    if found.holds:
        return found
    free, _ = fitted(studio().linear, POWER)
    more = materials["image"]["rmse"] - free["image"]["rmse"]
    note = f"the picture does not tell: {found.value:.1f} sigma off"
    return Found(materials["image"]["rmse"], free["image"]["rmse"], more, RESOLVED, found.iterations, note)
