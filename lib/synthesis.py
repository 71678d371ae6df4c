"""Synthetic photographs by Mitsuba 3, which is independent of everything else here: scenes, passes, lenses, chessboards, truth.

Only stages/synthesise.py uses this; Mitsuba (`mi`, its variant set) is passed in. Linear image value = pi x radiance.
"""
import time
from pathlib import Path

MAX_DEPTH = 120


def mitsuba_scene(mi, recipe, folder, roulette, window=None):
    """The recipe as a Mitsuba scene: one mesh per group.  Linear image value = pi x radiance, so emittance E is radiance E / pi."""
    import numpy as np
    T = np.linalg.inv(recipe.T_cam_world)
    W, H = recipe.size
    f, cx, cy = recipe.K[0, 0], recipe.K[0, 2], recipe.K[1, 2]
    film = {"type": "hdrfilm", "width": W, "height": H, "pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}}
    if window is not None:
        x0, y0, x1, y1 = window
        film |= {"crop_offset_x": x0, "crop_offset_y": y0, "crop_width": x1 - x0, "crop_height": y1 - y0}
    scene = {
        "type": "scene",
        # Russian roulette is unbiased; what lies beyond 120 bounces is less than 0.9^120 = 3e-6.
        "integrator": {"type": "path", "max_depth": MAX_DEPTH, "rr_depth": roulette},
        "sensor": {
            "type": "perspective", "near_clip": 1e-3, "far_clip": 1e3, "fov_axis": "x",
            "fov": float(2 * np.degrees(np.arctan(W / (2 * f)))),
            # Mitsuba's camera has x left and y up; its film covers [0, W], ours [-0.5, W - 0.5].
            "to_world": mi.ScalarTransform4f((T @ np.diag([-1.0, -1.0, 1.0, 1.0])).tolist()),
            "principal_point_offset_x": float(0.5 - (cx + 0.5) / W), "principal_point_offset_y": float(0.5 - (cy + 0.5) / H),
            "film": film, "sampler": {"type": "independent"},
        },
    }
    room = recipe.pair.room if recipe.pair else ""        # no light comes from the other rooms of a stereo scene's model
    for i, group in enumerate(recipe.groups):
        path = folder / f"{i}.ply"
        polygons = [p for p in recipe.polygons if p.group == group and p.object.startswith(room)]
        if not polygons:
            continue
        write_ply(path, polygons)
        bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(x) for x in recipe.rho_d(group)]}}
        shape = {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": {"type": "twosided", "bsdf": bsdf}}
        if group in recipe.lamps:
            radiance = [float(x) / np.pi for x in recipe.lamps[group]]
            shape["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
        scene[f"group{i}"] = shape
    return mi.load_dict(scene, optimize=False)       # optimised, identical materials would collapse into one


def write_ply(path, polygons):
    """Convex polygons as fans; corners are not shared between polygons, so that normals stay flat."""
    vertices, faces = [], []
    for polygon in polygons:
        first = len(vertices)
        vertices += [p for p in polygon.points]
        faces += [(first, first + i, first + i + 1) for i in range(1, len(polygon.points) - 1)]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(vertices)}", "property float x", "property float y", "property float z",
             f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(f"{x:.9g}" for x in v) for v in vertices] + [" ".join(map(str, (3, *f))) for f in faces]
    path.write_text("\n".join(lines) + "\n")


def group_picture(mi, scene, recipe):
    """(H, W) index + 1 of the group at each pixel's centre, by one ray per pixel through our own camera; 0 = nothing."""
    import numpy as np
    W, H = recipe.size
    T = np.linalg.inv(recipe.T_cam_world)
    x, y = np.meshgrid(np.arange(W), np.arange(H))
    v = np.stack([(x - recipe.K[0, 2]) / recipe.K[0, 0], (y - recipe.K[1, 2]) / recipe.K[1, 1], np.ones((H, W))], -1) @ T[:3, :3].T
    v /= np.linalg.norm(v, axis=-1, keepdims=True)
    shapes = scene.shapes()
    label = np.array([int(s.id().removeprefix("group")) + 1 for s in shapes])
    if mi.variant().startswith("scalar"):
        index = {s.id(): k for s, k in zip(shapes, label)}
        eye = mi.Point3f(*map(float, T[:3, 3]))
        out = np.zeros(H * W, np.uint16)
        for i, d in enumerate(v.reshape(-1, 3)):
            hit = scene.ray_intersect_preliminary(mi.Ray3f(eye, mi.Vector3f(*map(float, d))))
            if hit.is_valid():
                out[i] = index[hit.shape.id()]
        return out.reshape(H, W)
    import drjit
    d = v.reshape(-1, 3)
    hit = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(*map(float, T[:3, 3])), mi.Vector3f(d[:, 0], d[:, 1], d[:, 2])))
    out = np.zeros(H * W, np.uint16)
    pointers = drjit.reinterpret_array(mi.UInt32, hit.shape).numpy()
    valid = hit.is_valid().numpy()
    for s, k in zip(shapes, label):
        out[valid & (pointers == drjit.reinterpret_array(mi.UInt32, mi.ShapePtr(s)).numpy()[0])] = k
    return out.reshape(H, W)


class Passes:
    """Independent passes over a picture, some over a window only: mean and variance per pixel, and group means per pass.

    `labels` (H, W): index + 1 of the group whose mean a pixel enters, 0 = none."""

    def __init__(self, shape, labels, groups):
        import numpy as np
        self.labels, self.groups = labels, groups
        self.sum, self.squares, self.count = np.zeros(shape), np.zeros(shape), np.zeros(shape[:2])
        self.group_means = [[] for _ in range(groups)]

    def add(self, image, window=None):
        x0, y0, x1, y1 = window or (0, 0, self.labels.shape[1], self.labels.shape[0])
        self.sum[y0:y1, x0:x1] += image
        self.squares[y0:y1, x0:x1] += image ** 2
        self.count[y0:y1, x0:x1] += 1
        inside = self.labels[y0:y1, x0:x1]
        for k in range(self.groups):
            here = inside == k + 1
            if here.any() and here.sum() == (self.labels == k + 1).sum():     # a window counts for the groups it wholly contains
                self.group_means[k].append(image[here].mean(0))

    def mean(self):
        return self.sum / self.count[..., None]

    def pixel_noise(self):
        """Standard error of each pixel's mean, relative to it."""
        import numpy as np
        n, mean = self.count[..., None], self.mean()
        variance = np.maximum(self.squares / n - mean ** 2, 0) * n / np.maximum(n - 1, 1)
        return np.sqrt(variance / n) / np.maximum(mean, 1e-12)

    def group_noise(self, k):
        """Standard error of the group's mean over the passes, relative to it; per channel."""
        import numpy as np
        means = np.array(self.group_means[k])
        return means.std(0, ddof=1) / np.sqrt(len(means)) / means.mean(0)


def window_of(labels, k):
    import numpy as np
    y, x = np.nonzero(labels == k + 1)
    return int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1


def render(mi, recipe, folder, opt):
    """All passes; stops at `--target` or after `--more` passes of a window."""
    import numpy as np
    import cv2
    full = mitsuba_scene(mi, recipe, folder, opt.roulette)
    labels = group_picture(mi, full, recipe)
    # A pixel at a lamp's edge is lamp in part, a hundred times brighter: it would be most of the noise of the ceiling's mean.
    lamps = np.isin(labels, [recipe.groups.index(g) + 1 for g in recipe.lamps])
    pure = np.where(lamps | (cv2.dilate(lamps.astype(np.uint8), np.ones((3, 3))) == 0), labels, 0)
    passes = Passes((recipe.size[1], recipe.size[0], 3), pure, len(recipe.groups))
    seed = opt.seed
    for _ in range(opt.passes):
        passes.add(np.array(mi.render(full, spp=opt.spp, seed=seed), dtype=float)[..., :3] * np.pi)
        seed += 1
    for k, group in enumerate(recipe.groups):
        size = (labels == k + 1).sum()
        if size < 500 or group in recipe.lamps:
            continue
        window = x0, y0, x1, y1 = window_of(pure, k)
        if (x1 - x0) * (y1 - y0) > 0.2 * labels.size:
            continue
        scene, left = None, opt.more
        while left > 0 and (noise := passes.group_noise(k).max()) > opt.target:
            scene = scene or mitsuba_scene(mi, recipe, folder, opt.roulette, window)
            # so many passes are still needed, at the noise seen so far; a few at a time
            need = len(passes.group_means[k]) * ((noise / opt.target) ** 2 - 1)
            for _ in range(int(min(left, max(1, np.ceil(need * 0.5))))):
                passes.add(np.array(mi.render(scene, spp=opt.spp, seed=seed), dtype=float)[..., :3] * np.pi, window)
                seed += 1
                left -= 1
    return passes, labels, seed - opt.seed


# ---- stereo scenes: our own rays, through any lens ----------------------------------------------------------

def through_lens(mi, scene, integrator, lens, T_cam_world, size, spp, seed):
    """One pass: (H, W, 3) pi x mean radiance over each pixel's square, `spp` jittered places in it."""
    import drjit
    import numpy as np
    (W, H), side = size, int(round(spp ** 0.5))
    sampler = mi.load_dict({"type": "independent", "sample_count": 1})
    sampler.seed(seed, wavefront_size=W * H * spp)
    i = drjit.arange(mi.UInt32, W * H * spp)
    pixel, stratum = i // spp, i % spp
    jitter = sampler.next_2d()
    u = mi.Float64(pixel % W) - 0.5 + (mi.Float64(stratum % side) + mi.Float64(jitter.x)) / side
    v = mi.Float64(pixel // W) - 0.5 + (mi.Float64(stratum // side) + mi.Float64(jitter.y)) / side
    x, y = lens.unproject(u, v)
    R, t = T_cam_world[:3, :3].tolist(), T_cam_world[:3, 3]
    length = drjit.sqrt(x * x + y * y + 1)
    d = [mi.Float((R[0][k] * x + R[1][k] * y + R[2][k]) / length) for k in range(3)]
    eye = mi.Point3f(*map(float, -T_cam_world[:3, :3].T @ t))
    L = integrator.sample(scene, sampler, mi.RayDifferential3f(eye, drjit.normalize(mi.Vector3f(*d))))[0]
    return np.stack([np.array(L[k]) for k in range(3)], -1).reshape(H, W, spp, 3).mean(2, dtype=float) * np.pi


def photographed(recipe, B, rng):
    """What the sensor gives: displayed values with its noise, rounded; (H, W, 3), or (H, W) of a grey scene, uint8."""
    import numpy as np
    B = B if recipe.channels == 3 else B.mean(-1)
    values = np.clip(B, 0, 1) ** (1 / recipe.gamma) + rng.normal(0, recipe.pair.noise, B.shape)
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def pair_of_photographs(mi, recipe, folder, opt):
    """{side: Passes} of both views, (H, W) groups of the left one without distortion, seeds used."""
    import numpy as np
    scene = mitsuba_scene(mi, recipe, folder, opt.roulette)
    integrator = mi.load_dict({"type": "path", "max_depth": MAX_DEPTH, "rr_depth": opt.roulette})
    labels = group_picture(mi, scene, recipe)
    passes, seed = {}, opt.seed
    for side, (lens, T) in recipe.views().items():
        passes[side] = Passes((recipe.size[1], recipe.size[0], 3), np.zeros_like(labels), 0)
        for _ in range(opt.passes):
            passes[side].add(through_lens(mi, scene, integrator, lens, T, recipe.size, opt.spp, seed))
            seed += 1
    return passes, labels, seed - opt.seed


def board_shots(mi, recipe, folder, spp, seed):
    """Yields (side, number, (H, W) linear values): boards before a grey wall, lit by one small lamp beside the cameras, each exposed for itself."""
    import numpy as np
    pair, size = recipe.pair, recipe.size
    integrator = mi.load_dict({"type": "path", "max_depth": 2})
    wall = [[-9, -9, 4], [-9, 9, 4], [9, 9, 4], [9, -9, 4]]
    from lib.recipes import Polygon
    for n, T in enumerate(pair.board.T_left_board):
        scene = {"type": "scene", "lamp": {"type": "point", "position": [.1 + .06 * (n % 5), -.45, -.2], "intensity": {"type": "rgb", "value": 10.0}}}
        polygons = pair.board.polygons(T) + [Polygon("wall", "wall", np.array(wall, float))]
        for group, rho in (("white", .78), ("black", .045), ("wall", .36)):
            path = folder / f"{group}.ply"
            write_ply(path, [p for p in polygons if p.group == group])
            bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": rho}}
            scene[group] = {"type": "ply", "filename": str(path), "face_normals": True, "bsdf": {"type": "twosided", "bsdf": bsdf}}
        scene = mi.load_dict(scene, optimize=False)
        views = {side: through_lens(mi, scene, integrator, lens, V, size, spp, seed + 2 * n + k)[..., 0]
                 for k, (side, lens, V) in enumerate(zip(("left", "right"), pair.lenses, (np.eye(4), pair.T_right_left)))}
        # the white of the board at about 0.65 of full scale
        gain = .65 / max(np.percentile(B[labels], 90) for B, labels in ((B, board_mask(pair, T, side, size)) for side, B in views.items()) if labels.any())
        for side, B in views.items():
            yield side, n, B * gain


def board_mask(pair, T, side, size):
    """(H, W) where the squares of the board are, roughly: its outline without the lens's bending of straight lines."""
    import cv2
    import numpy as np
    k = ("left", "right").index(side)
    M = (np.eye(4), pair.T_right_left)[k] @ T
    p = pair.board.outline(0) @ M[:3, :3].T + M[:3, 3]
    mask = np.zeros(size[::-1], np.uint8)
    if p[:, 2].min() > .2:
        cv2.fillConvexPoly(mask, np.round(pair.lenses[k].project(p)).astype(np.int32), 1)
    return mask > 0


def synthesise_pair(mi, recipe, opt):
    """A stereo scene: renders it and writes its folder."""
    import json
    import tempfile
    import numpy as np
    from lib import image, recipes
    out, truth, pair = opt.out, opt.out / "truth", recipe.pair
    rng = np.random.default_rng([opt.seed, 77])
    truth.mkdir(parents=True, exist_ok=True)
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        passes, labels, number = pair_of_photographs(mi, recipe, Path(folder), opt)
        print(f"{recipe.name}: pair {time.perf_counter() - start:.0f} s")
        linear = {side: p.mean() for side, p in passes.items()}
        for side, B in linear.items():
            image.write_png8(out / f"{side}.png", photographed(recipe, B, rng))
        if pair.board:
            (out / "boards").mkdir(exist_ok=True)
            for side, n, B in board_shots(mi, recipe, Path(folder), opt.board_spp, opt.seed + 5000):
                image.write_png8(out / "boards" / f"{side}-{n:02d}.png", photographed(recipe, B[..., None], rng)[..., 0])
    print(f"{recipe.name}: {time.perf_counter() - start:.0f} s")

    gamma = recipe.gamma
    display = {side: np.median(p.pixel_noise() * np.clip(p.mean(), 0, 1) ** (1 / gamma) / gamma, (0, 1)) for side, p in passes.items()}
    noise = {
        "variant": opt.variant, "mitsuba": mi.__version__, "integrator": f"path, max_depth {MAX_DEPTH}, rr_depth {opt.roulette}", "sampler": "independent, jittered",
        "spp": opt.spp * opt.passes, "spp_per_pass": opt.spp, "passes": opt.passes, "spp_boards": opt.board_spp, "seeds": [opt.seed, opt.seed + number - 1],
        "sensor": pair.noise, "unit": "1",
        "meaning": "of displayed values in [0, 1]: sensor is the standard deviation of the noise added before rounding; median_pixel is the path tracer's standard error, the median over the picture, per channel",
        "median_pixel": {side: [float(x) for x in d] for side, d in display.items()},
    }
    pixels = {g: int((labels == k + 1).sum()) for k, g in enumerate(recipe.groups)}
    shown = labels, displayed(recipe, linear["left"])
    for k, g in enumerate(recipe.groups):
        if pixels[g]:                   # the picture without distortion is a few pixels off: good enough to look at
            print(f"{g:12s} {pixels[g]:7d} px  display", np.round(shown[1][labels == k + 1].mean() / 255, 2))
    print(f"clipped {[float((B >= 1).any(-1).mean()) for B in linear.values()]}, noise of display %", {s: np.round(100 * d, 2).tolist() for s, d in display.items()})

    obj, mtl = recipe.model()
    (out / "model.obj").write_text(obj)
    (out / "model.mtl").write_text(mtl)
    (out / "scene.yaml").write_text(recipe.scene_yaml())
    for file, text in recipe.pair_files().items():
        (out / file).write_text(text)
    (out / "origin.md").write_text(origin(recipe, opt, noise))
    image.write_png16(truth / "group.png", labels)
    contents = {"noise": noise, "materials": true_materials(recipe, pixels), "legend": {"groups": list(recipe.groups), "objects": list(recipe.objects), "facets": []}}
    if pair.board:
        contents["boards"] = {"meaning": "rt_left_board: inner corner (i, j) of a board, row by row, lies at (i, j, 0) square_m of its frame", "corners": list(pair.board.corners),
                              "square_m": pair.board.square_m,
                              "rt_left_board": [[float(x) for x in (*recipes.rodrigues(T[:3, :3]), *T[:3, 3])] for T in pair.board.T_left_board]}
    for name, content in contents.items():
        (truth / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")


# ---- writing -----------------------------------------------------------------------------------------------

def displayed(recipe, B):
    """Displayed value round(255 clip(B)^(1/gamma)): (H, W) or (H, W, 3) uint8."""
    import numpy as np
    B = B if recipe.channels == 3 else B.mean(-1)
    return np.round(255 * np.clip(B, 0, 1) ** (1 / (recipe.gamma or 2.2))).astype(np.uint8)


def write_half(path, B):
    """Half floats, unlike lib/image's: a committed photograph should be small, and 0.05 % is far below its noise."""
    import numpy as np
    import OpenEXR
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    channels = {name: np.ascontiguousarray(B[..., i], dtype=np.float16) for i, name in enumerate("RGB")}
    with OpenEXR.File(header, channels) as file:
        file.write(str(path))


def synthesise(mi, recipe, opt):
    """One photograph through a pinhole: the folder that stages/synthesise.py describes."""
    import json
    import tempfile
    import numpy as np
    from lib import image

    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        passes, labels, number = render(mi, recipe, Path(folder), opt)
    wall = time.perf_counter() - start
    B = passes.mean()
    if recipe.channels == 1:
        B = np.repeat(B.mean(-1, keepdims=True), 3, -1)

    pixels = {g: int((labels == k + 1).sum()) for k, g in enumerate(recipe.groups)}
    lit = np.isin(labels, [k + 1 for k, g in enumerate(recipe.groups) if g not in recipe.lamps])
    relative = passes.pixel_noise()[lit]
    noise = {
        "variant": opt.variant, "mitsuba": mi.__version__, "integrator": f"path, max_depth {MAX_DEPTH}, rr_depth {opt.roulette}", "sampler": "independent",
        "spp": opt.spp * opt.passes, "spp_per_pass": opt.spp, "passes": opt.passes,
        "spp_highest": int(opt.spp * passes.count.max()), "seeds": [opt.seed, opt.seed + number - 1],
        "unit": "1", "meaning": "standard error of the mean over independent passes / mean, per channel; linear values; group means without the pixels beside a lamp",
        "median_pixel": [float(x) for x in np.median(relative, 0)],
        "groups": {g: {"pixels": pixels[g], "passes": len(passes.group_means[k]), "noise": [float(x) for x in passes.group_noise(k)]}
                   for k, g in enumerate(recipe.groups) if pixels[g] >= 500 and g not in recipe.lamps},
    }
    for g in recipe.groups:
        here = labels == recipe.groups.index(g) + 1
        if here.any():
            print(f"{g:12s} {pixels[g]:7d} px  mean B", np.round(B[here].mean(0), 3), " display", np.round(displayed(recipe, B)[here].mean() / 255, 2),
                  " clipped", int((B[here] >= 1).any(-1).sum()), " noise %", np.round(100 * np.max(noise["groups"].get(g, {}).get("noise", 0)), 3))
    print(f"{recipe.name}: {wall:.0f} s, {number} passes, median pixel {100 * max(noise['median_pixel']):.2f} %")
    if opt.preview:
        image.write_png8(opt.preview, displayed(recipe, B))
        return

    out, truth = opt.out, opt.out / "truth"
    truth.mkdir(parents=True, exist_ok=True)
    obj, mtl = recipe.model()
    (out / "model.obj").write_text(obj)
    (out / "model.mtl").write_text(mtl)
    (out / "scene.yaml").write_text(recipe.scene_yaml())
    (out / "left.posed.cameramodel").write_text(recipe.cameramodel())
    (out / "origin.md").write_text(origin(recipe, opt, noise))
    if recipe.gamma is None:
        write_half(out / "left.exr", B)
    else:
        image.write_png8(out / "left.png", displayed(recipe, B))
    image.write_png16(truth / "group.png", labels)
    for name, content in (("noise", noise), ("materials", true_materials(recipe, pixels)),
                          ("legend", {"groups": list(recipe.groups), "objects": list(recipe.objects), "facets": []})):
        (truth / f"{name}.json").write_text(json.dumps(content, indent=1) + "\n")


def true_materials(recipe, pixels):
    """The true answer in the format of materials.json.  A group that is not a lamp is listed even if nothing shows it."""
    groups = {g: {"kind": "diffuse", "rho_d": list(map(float, recipe.rho_d(g))), "rho_s": [0, 0, 0], "alpha": None, "tangent": None,
                  "texture": None, "assumed": None, "sigma": None, "pixels": pixels[g], "error": None, "identified": True}
              for g in recipe.groups if g not in recipe.lamps}
    transfer = {"kind": "linear"} if recipe.gamma is None else {"kind": "gamma", "gamma": recipe.gamma, "sigma": None}
    return {"status": "truth", "groups": groups, "lamps": {g: {"emittance": list(map(float, E)), "sigma": None} for g, E in recipe.lamps.items()},
            "transfer": transfer, "scale": "lamps", "image": None}


def origin(recipe, opt, noise):
    made = f"stages/synthesise.py --scene {opt.scene} --out data/{opt.scene} --spp {opt.spp} --passes {opt.passes}"
    tracer = f"from the recipe in lib/recipes.py, path-traced by Mitsuba {noise['mitsuba']} ({noise['variant']}; {noise['spp']} samples per pixel"
    if recipe.pair:
        boards = (f"Chessboards: {opt.board_spp} samples per pixel, before a grey wall, one small lamp beside the cameras; the last four pairs are close, seen by one camera alone.\n"
                  if recipe.pair.board else "")
        made += (f" --board-spp {opt.board_spp}" if recipe.pair.board else "") + f" --roulette {opt.roulette} --seed {opt.seed} --variant {opt.variant}"
        return (f"# {recipe.name}\n\n{recipe.about}. Synthetic: made by\n\n    {made}\n\n{tracer}), every ray through the lens; then noise of {recipe.pair.noise:g}\n"
                "of full scale, rounded to 8 bits: truth/noise.json. The room that is seen lets no light in from the others, so it was traced alone.\n"
                f"{boards}\ntruth/: reflectances and transfer in materials.json; lenses with the relative pose in {{left,right}}.cameramodel; the pose in\n"
                "{left,right}.posed.cameramodel, the same cameras without distortion (fx fy cx cy kept); group.png is the view of that left one.\n"
                "\nLicence: as the project's.\n")
    made += f" --target {opt.target:g} --more {opt.more} --roulette {opt.roulette} --seed {opt.seed} --variant {opt.variant}"
    source = ("\nGeometry, paints and lamp: the numbers in data/cornell-box-measured, see its README and `recipes.cornell_channels`.\n"
              if recipe.name == "cornell" else "")
    return (f"# {recipe.name}\n\n{recipe.about}. Synthetic: made by\n\n    {made}\n\n{tracer}, up to\n"
            f"{noise['spp_highest']} where a small group needed more). Noise: truth/noise.json. True reflectances and transfer: truth/materials.json.\n"
            f"{source}\nLicence: as the project's.\n")
