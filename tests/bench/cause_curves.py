"""Error against CPU time of what is put right before materials are looked for (for tests/bench).

pose        `office` seen from 2 px beside: what is left of the error, px, by the width at which edges are placed
objects     a box of `office` 3 cm beside: what is left, m, by the same width
lamp_place  the lamp of `office` 12 cm beside: reflectances, by the rounds of moving it
glow        `office` without the wall behind the camera: reflectances, by how the glow may change, and by rays
lamp_lobe   `lobed-8`, whose scene.yaml tells of no lobe: reflectances, by the rounds of fitting it
vignetting  cos^4, 37 degrees in the corner, by the number of radial terms: reflectances
matrix      a camera that mixes colours, by the rounds of fitting: reflectances
response    a film curve, by the function that is fitted: reflectances
noise       3 and 10 % of displayed values, tiles as means and as medians: reflectances

The shipped photographs, changed here.  Truth is read to score, and by nothing else.
"""

import time
from dataclasses import replace

import numpy as np

from tests.bench.fit_curves import ROOT, SETTINGS, Case

HEAD = ("cause", "scene", "setting", "cpu_s", "error", "unit")
DRAWS = 6
MOVED = ("carton", "bin", "cabinet")  # of `office`, on its floor
MIXING = ((0.9, 0.2, -0.1), (0.1, 0.85, 0.05), (-0.05, 0.25, 0.8))
WIDTHS = (160, 320, 640)  # px, at which edges are placed


def measure(log):
    """Rows of HEAD."""
    cases = [Case(scene) for scene in ("office", "gallery-white")]
    rows = [*poses(cases[0]), *objects(cases[0])]
    for of_lamp, case in ((lamp_place, Case("office")), (lamp_lobe, Case("lobed-8"))):
        rows += [(cause, case.name, setting, cpu_s, error, "1") for cause, setting, cpu_s, error in of_lamp(case)]
    rows += [("glow", "office", setting, cpu_s, error, "1") for setting, cpu_s, error in glow()]
    for case in cases:
        light = case.photograph.values**case.gamma
        case.problem(*SETTINGS[0])  # warm-up
        for of_cause in (vignetting, matrix, response, noise):
            for cause, setting, cpu_s, error in of_cause(case, light):
                rows.append((cause, case.name, setting, cpu_s, error, "1"))
    for row in rows:
        log(*row)
    return HEAD, rows


def poses(case):
    """The camera off by 2 px at random; the error is that of the model's points in the picture, its median."""
    from lib.given.cameras import Camera, matrix_from_rt
    from lib.vision.registration import register

    usual, random = (register.PLACING_PX, register.SEARCH_PX), np.random.default_rng(7)
    points = case.model.vertices
    shown = lambda T: _project(case.camera.K, T, points)
    true, twists = case.camera.T_cam_world, []
    while len(twists) < DRAWS:
        twist = random.normal(size=6) * [1, 1, 1, 3, 3, 3]
        off = np.median(np.linalg.norm(shown(matrix_from_rt(1e-4 * twist) @ true) - shown(true), axis=1))
        twists.append(1e-4 * twist * 2 / off)
    register.register(case.model, case.camera, case.photograph)  # warm-up
    for width in WIDTHS:
        register.PLACING_PX, register.SEARCH_PX = width, min(width, usual[1])
        left, began = [], time.process_time()
        for twist in twists:
            given = matrix_from_rt(twist) @ true
            camera = Camera(case.camera.K, case.camera.width, case.camera.height, given)
            found = register.register(case.model, camera, case.photograph)
            T = given if found.pose is None else matrix_from_rt(found.pose) @ given
            left.append(np.median(np.linalg.norm(shown(T) - shown(true), axis=1)))
        yield "pose", case.name, f"{width} px", (time.process_time() - began) / DRAWS, float(np.median(left)), "px"
    register.PLACING_PX, register.SEARCH_PX = usual


def objects(case):
    """A thing that is free to move, off by 3 cm along the floor at random; what is left of it, median of the draws."""
    from lib.given.cameras import matrix_from_rt
    from lib.vision.registration import register
    from lib.vision.registration.motions import World, corrected_model

    usual, random = (register.PLACING_PX, register.SEARCH_PX), np.random.default_rng(8)
    free = [thing for thing in World(case.model, case.camera).movable if case.model.objects[thing] in MOVED]
    angles = random.uniform(0, 2 * np.pi, DRAWS)
    moves = [(free[k % len(free)], 0.03 * np.array([np.cos(a), np.sin(a), 0])) for k, a in enumerate(angles)]
    for width in WIDTHS:
        register.PLACING_PX, register.SEARCH_PX = width, min(width, usual[1])
        left, began = [], time.process_time()
        for thing, move in moves:
            given = corrected_model(case.model, {thing: matrix_from_rt([0, 0, 0, *move])})
            found = register.register(given, case.camera, case.photograph)
            back = found.objects.get(case.model.objects[thing])
            left.append(np.linalg.norm(move + (0 if back is None else np.array(back.rt[3:]))))
        yield "objects", case.name, f"{width} px", (time.process_time() - began) / DRAWS, float(np.median(left)), "m"
    register.PLACING_PX, register.SEARCH_PX = usual


def lamp_place(case):
    """The lamp in the model 12 cm from where it was."""
    from lib.analysis.causes import lamp_place as own
    from lib.analysis.causes.candidates import Candidate
    from lib.analysis.seen.direct_light import DirectLight
    from lib.given.cameras import matrix_from_rt
    from lib.vision.registration.motions import corrected_model

    case.problem(*SETTINGS[0])
    name = case.factors.lamps[0]
    thing, _ = own.Lamps.of(DirectLight(case.view, case.factors, case.found)).things[name]
    case.model = corrected_model(case.model, {thing: matrix_from_rt([0, 0, 0, 0.1, 0.066, 0])})
    problem, _ = case.problem(*SETTINGS[2])
    lamps, usual = own.Lamps.of(DirectLight(case.view, case.factors, case.found)), own.LampPlace.rounds
    first = Candidate.of(problem)
    yield "lamp_place", "as drawn", 0.0, case.errors(first.result.state)[0]
    for rounds in (1, 2, 3, 6):
        began, own.LampPlace.rounds = time.process_time(), usual._replace(most=rounds)
        found = own.LampPlace(lamps, name, 0.1).fitted(first)
        yield "lamp_place", f"{rounds} rounds", time.process_time() - began, case.errors(found.result.state)[0]
    own.LampPlace.rounds = usual


def lamp_lobe(case):
    """From the lambertian lamp that scene.yaml tells of."""
    from lib.analysis.causes import lamp_lobe as own
    from lib.analysis.causes.candidates import Candidate

    problem, _ = case.problem(*SETTINGS[2])
    lobes, usual = own.LampLobe(lambda: case.view, case.factors, case.found, case.factors.lamps), own.LampLobe.rounds
    first = Candidate.of(problem)
    yield "lamp_lobe", "lambertian", 0.0, case.errors(first.result.state)[0]
    for rounds in (1, 2, 3, 5, usual.most):
        began, own.LampLobe.rounds = time.process_time(), usual._replace(most=rounds)
        found = own.begun(first, own.uneven(first, lobes), lobes)
        yield "lamp_lobe", f"{rounds} rounds", time.process_time() - began, case.errors(found.result.state)[0]
    own.LampLobe.rounds = usual


def glow():
    """Black outside, an even glow, and one that changes along the axes."""
    import tempfile
    from pathlib import Path
    from shutil import copytree

    from lib.analysis.causes import glow as own
    from lib.analysis.causes.candidates import Candidate
    from lib.analysis.fit.facts import problem_of
    from lib.analysis.seen import gather

    with tempfile.TemporaryDirectory() as folder:
        there = copytree(ROOT / "data/office", Path(folder) / "office")
        lines = (there / "model.obj").read_text()
        (there / "model.obj").write_text(lines.replace("f 4 6 5 1\n", "", 1))
        case = Case("office", there)
    case.problem(*SETTINGS[0])  # warm-up
    for setting in SETTINGS[1:5]:
        _, cpu_s = case.problem(*setting)
        factors, found = gather.with_outside(lambda: case.view, case.factors, case.found)
        problem = problem_of(factors, found, lamps=case.facts["lamps"], reference={}, transfer=None)
        began = time.process_time()
        dark = Candidate.of(problem)
        yield f"black, {setting[3]} rays", cpu_s + time.process_time() - began, case.errors(dark.result.state)[0]
        even = own.even(dark)
        yield f"even, {setting[3]} rays", cpu_s + time.process_time() - began, case.errors(even.result.state)[0]
        changing = own.changing(even)
        yield f"changing, {setting[3]} rays", cpu_s + time.process_time() - began, case.errors(changing.result.state)[0]


def _project(K, T, points):
    q = (points @ T[:3, :3].T + T[:3, 3]) @ K.T
    return (q[:, :2] / q[:, 2:])[q[:, 2] > 0.1]


def vignetting(case, light):
    """By none to four radial terms."""
    from lib.analysis.causes import vignetting as own
    from lib.analysis.causes.candidates import Candidate
    from lib.given.falloff import Lens

    H, W = light.shape[:2]
    x, y = np.meshgrid(np.arange(W) - (W - 1) / 2, np.arange(H) - (H - 1) / 2)
    tangent = np.hypot(x, y) / np.hypot((W - 1) / 2, (H - 1) / 2) * np.tan(np.radians(37))
    problem, tiles = _problem(case, (light / (1 + tangent**2)[..., None] ** 2) ** (1 / case.gamma))
    lens, usual, spreads = Lens((case.camera.K[0, 2], case.camera.K[1, 2]), (W, H)), own.TERMS, own.SPREADS
    cause = own.Vignetting(lens, tiles.pixel)
    for terms in (0, 1, 2, 3, 4):
        own.TERMS = terms
        own.SPREADS = tuple((s[0],) * (terms - usual) + s[max(usual - terms, 0) :] for s in spreads)
        own._lenses.cache_clear()
        began = time.process_time()
        found = Candidate.of(problem)
        found = cause.fitted(found) if terms else found
        yield "vignetting", f"{terms} terms", time.process_time() - began, case.errors(found.result.state)[0]
    own.TERMS, own.SPREADS = usual, spreads
    own._lenses.cache_clear()


def matrix(case, light):
    """By none to six rounds."""
    from lib.analysis.causes.candidates import Candidate
    from lib.analysis.causes.colour_mixing import ColourMixing

    mixed = np.clip(light @ np.transpose(MIXING), 0, 1) ** (1 / case.gamma)
    problem, _ = _problem(case, mixed)
    usual, began = ColourMixing.rounds, time.process_time()
    first = Candidate.of(problem)
    yield "matrix", "none", time.process_time() - began, case.errors(first.result.state)[0]
    for rounds in (1, 2, usual.most):
        began, ColourMixing.rounds = time.process_time(), usual._replace(most=rounds)
        found = ColourMixing().fitted(first)
        yield "matrix", f"{rounds} rounds", time.process_time() - began, case.errors(found.result.state)[0]
    ColourMixing.rounds = usual


def response(case, light):
    """Hable's filmic curve, fitted as gamma, sRGB and a free curve."""
    from lib.analysis.causes.candidates import Candidate
    from lib.given.transfer import Transfer

    shape = lambda v: (v * (0.22 * v + 0.03) + 0.002) / (v * (0.22 * v + 0.3) + 0.06) - 1 / 30
    problem, _ = _problem(case, (shape(4 * light) / shape(4.0)) ** (1 / 2.2))
    for function in (Transfer("gamma", 2.2), Transfer("srgb"), Transfer("gamma", 2.2).as_curve()):
        began = time.process_time()
        told = replace(problem, transfer=function, fit_transfer=len(function.parameters) > 0)
        found = Candidate.of(told)
        yield "response", function.kind, time.process_time() - began, case.errors(found.result.state)[0]


def noise(case, light):
    """Of the displayed values, and of as much in the sensor's light."""
    from lib.analysis.causes.candidates import Candidate

    shown, random = light ** (1 / case.gamma), np.random.default_rng(3)
    for sigma in (0.03, 0.1):
        noisy, _ = _problem(case, shown + random.normal(0, sigma, shown.shape))
        for name, medians in (("means", False), ("medians", True)):
            began = time.process_time()
            found = Candidate.of(replace(noisy, noisy=medians))
            yield f"noise {sigma:g}", name, time.process_time() - began, case.errors(found.result.state)[0]


def _problem(case, values):
    """(Problem, Tiles) of the case with another photograph (H, W, C), rounded to 8 bits."""
    from lib.buffers import edges, index_buffer, trust

    before, mask = case.photograph, case.trusted
    case.photograph = replace(before, values=np.round(255 * np.clip(values, 0, 1)) / 255)
    index = index_buffer.reference(case.model, case.camera)
    hidden = edges.visible_edges(case.model, case.camera, index.facet, index.depth)
    case.trusted = trust.trusted(case.photograph, case.facet, hidden, case.model.facet_group).mask
    problem, _ = case.problem(*SETTINGS[2])
    case.photograph, case.trusted = before, mask
    return problem, case.found.tiles


def plot(rows, axes):
    """Left: the pose; right: reflectances, one line for each cause and scene."""
    for cause, scene in dict.fromkeys((r[0], r[1]) for r in rows):
        mine = [r for r in rows if r[:2] == (cause, scene)]
        ax = axes[0] if cause in ("pose", "objects") else axes[1]
        ax.loglog(
            [max(r[3], 1e-3) for r in mine], [max(r[4], 1e-4) for r in mine], "-o", ms=3, label=f"{cause}, {scene}"
        )
        for r in mine:
            ax.annotate(r[2], (max(r[3], 1e-3), max(r[4], 1e-4)), fontsize=6)
    axes[0].set(title="camera 2 px off", xlabel="CPU s", ylabel="left of the error, px or m")
    axes[1].set(title="light, lens, noise", xlabel="CPU s of the fit", ylabel="mean relative reflectance error")
