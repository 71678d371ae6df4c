"""The folder of a synthetic scene: photographs, model, truth, and where they come from."""

import json
import tempfile
import time
from pathlib import Path

import numpy as np

from lib.given import image
from lib.synthetic.gathering import gathered, gathered_pair
from lib.synthetic.mitsuba_scene import MAX_DEPTH
from lib.synthetic.optics import rodrigues
from lib.synthetic.origin import origin
from lib.synthetic.pictures import mirror_groups, render
from lib.synthetic.stereo_pictures import board_shots, pair_of_photographs, photographed


def synthesise(mi, recipe, opt):
    """One photograph through a pinhole: the folder that stages/synthesise.py describes."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        traced = gathered if opt.gather else render
        passes, labels, number = traced(mi, recipe, Path(folder), opt)
    wall = time.perf_counter() - start
    B = passes.mean()
    if recipe.channels == 1:
        B = np.repeat(B.mean(-1, keepdims=True), 3, -1)

    pixels = group_pixels(recipe, labels)
    noise = stated_noise(mi, recipe, opt, passes, labels, number)
    _say_groups(recipe, labels, B, pixels, noise)
    median = 100 * max(noise["median_pixel"])
    print(f"{recipe.name}: {wall:.0f} s, {number} passes, median pixel {median:.2f} %, displayed {noise['displayed']}")
    if opt.preview:
        image.write_png8(opt.preview, displayed(recipe, B))
        return

    truth = opt.out / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    _write_given(recipe, opt, noise)
    (opt.out / "left.posed.cameramodel").write_text(recipe.cameramodel())
    if recipe.gamma is None:
        write_half(opt.out / "left.exr", B)
    else:
        image.write_png8(opt.out / "left.png", displayed(recipe, B))
    if recipe.mirrors():
        image.write_png16(truth / "mirror.png", mirror_groups(recipe, labels))
    if opt.gather or opt.linear:
        image.write_exr(truth / "linear.exr", B)
    if opt.gather:
        image.write_png16(truth / "object.png", passes.objects)
    contents = {"noise": noise, "materials": true_materials(recipe, pixels)}
    for group, texture in recipe.textures().items():
        write_half(truth / texture_file(recipe, group), texture.image)
    if recipe.textures():
        contents["textures"] = true_textures(recipe)
    _write_truth(recipe, truth, labels, contents)


def synthesise_pair(mi, recipe, opt):
    """A stereo scene: renders it and writes its folder."""
    pair, rng = recipe.pair, np.random.default_rng([opt.seed, 77])
    truth = opt.out / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        pictures = (gathered_pair if opt.gather else pair_of_photographs)(mi, recipe, Path(folder), opt)
        print(f"{recipe.name}: pair {time.perf_counter() - start:.0f} s")
        linear = {side: p.mean() for side, p in pictures.passes.items()}
        for side, B in linear.items():
            image.write_png8(opt.out / f"{side}.png", photographed(recipe, B, rng))
        if pair.board:
            (opt.out / "boards").mkdir(exist_ok=True)
            for side, n, B in board_shots(mi, recipe, Path(folder), opt.board_spp, opt.seed + 5000):
                shot = photographed(recipe, B[..., None], rng)[..., 0]
                image.write_png8(opt.out / "boards" / f"{side}-{n:02d}.png", shot)
    print(f"{recipe.name}: {time.perf_counter() - start:.0f} s")

    labels, pixels = pictures.labels, group_pixels(recipe, pictures.labels)
    noise = stated_noise_of_pair(mi, recipe, opt, pictures)
    _say_pair(recipe, pictures, linear, pixels, noise)
    _write_given(recipe, opt, noise)
    for file, text in recipe.pair_files().items():
        (opt.out / file).write_text(text)
    contents = {"noise": noise, "materials": true_materials(recipe, pixels)}
    if pair.board:
        contents["boards"] = true_boards(pair.board)
    _write_truth(recipe, truth, labels, contents)


# ---- what is said while it runs ----


def _say_groups(recipe, labels, B, pixels, noise):
    """A line for each group that the photograph shows."""
    shown = displayed(recipe, B)
    for k, g in enumerate(recipe.groups):
        here = labels == k + 1
        if here.any():
            worst = 100 * np.max(noise["groups"].get(g, {}).get("noise", 0))
            print(f"{g:12s} {pixels[g]:7d} px  mean B", np.round(B[here].mean(0), 3), end="")
            print("  display", np.round(shown[here].mean() / 255, 2), end="")
            print("  clipped", int((B[here] >= 1).any(-1).sum()), " noise %", np.round(worst, 3))


def _say_pair(recipe, pictures, linear, pixels, noise):
    """A line for each group of the left view.

    The labels know no distortion and are a few pixels off: good enough to look at.
    """
    shown = displayed(recipe, linear["left"])
    for k, g in enumerate(recipe.groups):
        if pixels[g]:
            print(f"{g:12s} {pixels[g]:7d} px  display", np.round(shown[pictures.labels == k + 1].mean() / 255, 2))
    percent = {side: np.round(100 * np.array(d), 2).tolist() for side, d in noise["median_pixel"].items()}
    print(f"clipped {[float((B >= 1).any(-1).mean()) for B in linear.values()]}, noise of display %", percent)


# ---- what the photographer gives ----


def displayed(recipe, B) -> np.ndarray:
    """Displayed value round(255 clip(B)^(1/gamma)): (H, W) or (H, W, 3) uint8."""
    B = B if recipe.channels == 3 else B.mean(-1)
    return np.round(255 * np.clip(B, 0, 1) ** (1 / (recipe.gamma or 2.2))).astype(np.uint8)


def write_half(path, B):
    """An EXR of half floats, unlike lib/given/image.py's.

    A committed photograph should be small, and 0.05 % is far below its noise.
    """
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: np.ascontiguousarray(B[..., i], dtype=np.float16) for i, name in enumerate("RGB")}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def _write_given(recipe, opt, noise):
    """model.obj, model.mtl, scene.yaml, origin.md."""
    obj, mtl = recipe.model()
    (opt.out / "model.obj").write_text(obj)
    (opt.out / "model.mtl").write_text(mtl)
    (opt.out / "scene.yaml").write_text(recipe.scene_yaml())
    (opt.out / "origin.md").write_text(origin(recipe, opt, noise))


# ---- the truth ----


def _write_truth(recipe, truth, labels, contents):
    """group.png, legend.json and a .json for each of `contents`."""
    image.write_png16(truth / "group.png", labels)
    legend = {"groups": list(recipe.groups), "objects": list(recipe.objects), "facets": []}
    for name, content in {**contents, "legend": legend}.items():
        (truth / f"{name}.json").write_text(json_text(content))


def json_text(content) -> str:
    """A file of truth/ as it is committed."""
    return json.dumps(content, indent=1) + "\n"


def group_pixels(recipe, labels) -> dict[str, int]:
    """How many pixels show each group."""
    return {g: int((labels == k + 1).sum()) for k, g in enumerate(recipe.groups)}


def true_materials(recipe, pixels) -> dict:
    """The true answer in the format of materials.json.

    A group that is not a lamp is listed even if nothing shows it.
    """
    some = lambda values: None if values is None else list(map(float, values))
    groups = {}
    for g in (g for g in recipe.groups if g not in recipe.lamps):
        surface = recipe.surface(g)
        groups[g] = {
            "kind": surface.kind,
            "rho_d": list(map(float, recipe.rho_d(g))),
            "rho_s": list(surface.rho_s),
            "alpha": some(surface.alpha),
            "tangent": some(surface.tangent),
            "texture": {str(facet_of(recipe, g)): texture_file(recipe, g)} if surface.texture else None,
            "assumed": None,
            "sigma": None,
            "pixels": pixels[g],
            "error": None,
            "identified": True,
        }
    transfer = {"kind": "linear"} if recipe.gamma is None else {"kind": "gamma", "gamma": recipe.gamma, "sigma": None}
    return {
        "status": "truth",
        "groups": groups,
        "lamps": {g: true_lamp(recipe, g) for g in recipe.lamps},
        "transfer": transfer,
        "scale": "lamps",
        "image": None,
    }


def true_lamp(recipe, group) -> dict:
    """What a lamp emits, and how."""
    lamp = {"emittance": list(map(float, recipe.lamps[group])), "sigma": None}
    if group in recipe.lobes:
        aim, exponent = recipe.lobes[group]
        lamp["lobe"] = {"aim": list(aim), "exponent": exponent}
    return lamp


def facet_of(recipe, group) -> int:
    """The number of the group's only facet in model.obj: every polygon is one there, object by object."""
    polygons = [p for name in recipe.objects for p in recipe.polygons if p.object == name]
    (number,) = (k for k, p in enumerate(polygons) if p.group == group)
    return number


def texture_file(recipe, group) -> str:
    """Name of the textured group's image below truth/."""
    return f"texture-{facet_of(recipe, group)}.exr"


def true_textures(recipe) -> dict:
    """The content of textures.json: where each texture-<facet>.exr lies."""
    entries = {}
    for group, texture in recipe.textures().items():
        frame = {key: [float(x) for x in getattr(texture, key)] for key in ("origin", "u", "v")}
        entries[group] = {"file": texture_file(recipe, group), **frame}
    return entries


def true_boards(board) -> dict:
    """The content of boards.json."""
    meaning = "inner corner (i, j) of a board, row by row, lies at (i, j, 0) square_m of its frame"
    return {
        "meaning": f"rt_left_board: {meaning}",
        "corners": list(board.corners),
        "square_m": board.square_m,
        "rt_left_board": [[float(x) for x in (*rodrigues(T[:3, :3]), *T[:3, 3])] for T in board.T_left_board],
    }


# ---- the noise of the path tracer ----


def _settings(mi, opt, integrator, sampler):
    """How the picture was traced."""
    return {
        "variant": opt.variant,
        "mitsuba": mi.__version__,
        "integrator": f"{integrator}, max_depth {MAX_DEPTH}, rr_depth {opt.roulette}",
        "sampler": sampler,
        "spp": opt.spp * opt.passes,
        "spp_per_pass": opt.spp,
        "passes": opt.passes,
    }


def stated_noise(mi, recipe, opt, passes, labels, number) -> dict:
    """The content of noise.json: what scatters between the passes, of pixels and of group means."""
    pixels = group_pixels(recipe, labels)
    lit = np.isin(labels, [k + 1 for k, g in enumerate(recipe.groups) if g not in recipe.lamps])
    kind = "path, lamps also sampled through the mirrors" if recipe.mirrors() else "path"
    sampler = "independent"
    if opt.gather:
        kind = (
            "stored irradiance, one bounce gathered (lib/synthetic/gathering.py); that it is stored adds 0.1 % or less"
        )
        sampler = "(0, 2)-sequences"
    return {
        **_settings(mi, opt, kind, sampler),
        "spp_highest": int(opt.spp * passes.count.max()),
        "seeds": [opt.seed, opt.seed + number - 1],
        "unit": "1",
        "meaning": "standard error of the mean over independent passes / mean, per channel; linear values; "
        "group means without the pixels beside a lamp",
        "median_pixel": [float(x) for x in np.median(passes.pixel_noise()[lit], 0)],
        "displayed": displayed_noise(recipe, passes, labels),
        "groups": {
            g: {
                "pixels": pixels[g],
                "passes": len(passes.group_means[k]),
                "noise": [float(x) for x in passes.group_noise(k)],
            }
            for k, g in enumerate(recipe.groups)
            if pixels[g] >= 500 and g not in recipe.lamps
        },
    }


def displayed_noise(recipe, passes, labels) -> dict:
    """Standard errors of displayed values in [0, 1], the worst channel, apart from lamps and the pixels beside them.

    A firefly would be far above its like.
    """
    import cv2

    lamps = np.isin(labels, [recipe.groups.index(g) + 1 for g in recipe.lamps])
    B, gamma = passes.mean(), recipe.gamma or 2.2
    error = (passes.pixel_noise() * np.clip(B, 0, 1) ** (1 / gamma) / gamma * (B < 1)).max(-1)
    error = error[cv2.dilate(lamps.astype(np.uint8), np.ones((5, 5))) == 0]
    return {
        "median": round(float(np.median(error)), 5),
        "of_1000_the_worst": round(float(np.quantile(error, 0.999)), 5),
        "worst": round(float(error.max()), 5),
    }


def stated_noise_of_pair(mi, recipe, opt, pictures) -> dict:
    """The content of a stereo scene's noise.json."""
    gamma, median = recipe.gamma, {}
    for side, p in pictures.passes.items():
        display = p.pixel_noise() * np.clip(p.mean(), 0, 1) ** (1 / gamma) / gamma
        median[side] = [float(x) for x in np.median(display, (0, 1))]
    return {
        **_settings(mi, opt, "path", "independent, jittered"),
        "spp_boards": opt.board_spp,
        "seeds": [opt.seed, opt.seed + pictures.seeds - 1],
        "sensor": recipe.pair.noise,
        "unit": "1",
        "meaning": "of displayed values in [0, 1]: sensor is the standard deviation of the noise added before rounding"
        "; median_pixel is the path tracer's standard error, the median over the picture, per channel",
        "median_pixel": median,
    }
