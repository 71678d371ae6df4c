"""Programs that read exports, under an interpreter that has them (.venv-exports): each renders, or says what it reads.

    $ .venv-exports/bin/python tests/helpers/consumers.py mitsuba exports/mitsuba out.npy 160 120 64

Renders are (H, W, 3) float32, linear image values (pi x radiance); `samples` is per pixel.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

PYTHON = Path(__file__).resolve().parents[2] / ".venv-exports/bin/python"
PATHS = "-ab 40 -ad 1 -as 0 -aa 0 -lr -12 -lw 1e-6 -ds .2 -dj 1 -dt 0 -dc 1 -st 0 -ss 1 -u+"  # of Radiance
RENDERERS = {"mitsuba": "mitsuba", "radiance": "pyradiance", "blender": "bpy"}  # kind -> package


def absent(package):
    """Why a test that needs a package is skipped, or None."""
    if PYTHON.is_file():
        looked = f"import importlib.util as u, sys; sys.exit(u.find_spec({package!r}) is None)"
        if subprocess.run([PYTHON, "-c", looked]).returncode == 0:
            return None
    return f"{package}: not installed: make .venv-exports/ready"


def ask(kind, folder, *more):
    """What a program says of an export: a picture, or what JSON it prints."""
    import numpy as np

    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "out.npy"
        argv = [PYTHON, __file__, kind, folder, out, *more]
        done = subprocess.run(list(map(str, argv)), capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, done.stderr + done.stdout
        return np.load(out) if out.exists() else json.loads(done.stdout.splitlines()[-1])


# ---- what follows runs under the other interpreter ----


def mitsuba(folder, out, width, height, samples):
    import mitsuba as mi
    import numpy as np

    mi.set_variant("scalar_rgb")
    scene = mi.load_file(str(folder / "scene.xml"), spp=samples)
    picture = np.array(mi.render(scene, spp=samples))[..., :3]
    assert picture.shape == (height, width, 3)
    np.save(out, np.pi * picture)


def radiance(folder, out, width, height, samples):
    """By paths, one ray on at each bounce: what converges without settings."""
    import numpy as np
    import pyradiance

    home = Path(pyradiance.__file__).parent
    env = {**os.environ, "RAYPATH": f".:{home / 'lib'}"}
    words = [*PATHS.split(), "-h", "-fff"]
    with tempfile.TemporaryDirectory() as scratch:
        octree = Path(scratch) / "scene.oct"
        with open(octree, "wb") as file:
            subprocess.run([home / "bin/oconv", "scene.rad"], stdout=file, env=env, cwd=folder, check=True)
        view = f"-ff -c {samples} -pj 1 -vf view.vf -x {width} -y {height} -pa 0".split()
        rays = subprocess.run([home / "bin/vwrays", *view], stdout=subprocess.PIPE, env=env, cwd=folder, check=True)
        trace = [home / "bin/rtrace", *words, octree]
        done = subprocess.run(trace, input=rays.stdout, stdout=subprocess.PIPE, env=env, cwd=folder, check=True)
    values = np.frombuffer(done.stdout, "f4").reshape(height, width, samples, 3)
    np.save(out, np.pi * values.mean(axis=2))


def blender(folder, out, width, height, samples):
    """The script as it is, but for its samples; the file is linear, without the exposure."""
    import runpy

    import bpy
    import numpy as np

    script = runpy.run_path(str(folder / "scene.py"))
    script["main"].__globals__["SAMPLES"] = samples
    script["main"]([])
    scene = bpy.data.scenes["anasyn"]
    bpy.ops.wm.save_as_mainfile(filepath=str(out.with_suffix(".blend")))
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(out.with_suffix(".exr"))
    bpy.ops.render.render(write_still=True, scene=scene.name)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.name = "Non-Color"
    assert tuple(image.size) == (width, height)
    pixels = np.array(image.pixels[:], np.float32).reshape(height, width, image.channels)
    np.save(out, np.pi * pixels[::-1, :, :3])


def usd(folder, out):
    """What is in the stage, and whether its shaders' inputs are those that MaterialX knows."""
    import MaterialX
    from pxr import Gf, Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(folder / "scene.usda"))
    library = MaterialX.createDocument()
    where = MaterialX.getDefaultDataSearchPath()
    MaterialX.loadLibraries(MaterialX.getDefaultDataLibraryFolders(), where, library)
    strange, bound = [], {}
    for prim in stage.Traverse():
        if prim.IsA(UsdShade.Shader):
            shader = UsdShade.Shader(prim)
            definition = library.getNodeDef(shader.GetIdAttr().Get())
            if definition:
                known = {i.getName(): i.getType() for i in definition.getActiveInputs()}
                strange += [i.GetBaseName() for i in shader.GetInputs() if i.GetBaseName() not in known]
        if prim.IsA(UsdGeom.Mesh):
            material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
            surface = material.ComputeSurfaceSource()[0]
            bound[prim.GetName()] = {
                i.GetBaseName(): list(v) if isinstance(v, Gf.Vec3f) else v
                for i in surface.GetInputs()
                if isinstance(v := i.Get(), Gf.Vec3f | float | int)
            }
    camera = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Camera))
    frustum = UsdGeom.Camera(camera).GetCamera(Usd.TimeCode.Default()).frustum
    to_window = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    at = [list(to_window.Transform(Gf.Vec3d(*p))) for p in ((1.3, 2.0, 0.7), (2.0, 2.5, 1.0))]
    up = str(UsdGeom.GetStageUpAxis(stage))
    metres = UsdGeom.GetStageMetersPerUnit(stage)
    print(json.dumps({"strange": strange, "bound": bound, "at": at, "up": up, "metres": metres}))


def blender_cameras(folder, out):
    """docs/blender_camera.py in Blender itself: [file, size, points, where Blender's own projection has them (px)]."""
    import itertools

    import bpy
    import numpy as np
    from mathutils import Vector

    rng, told = np.random.default_rng(5), []
    sizes, fits, aspects = [(640, 480), (480, 640)], ["AUTO", "HORIZONTAL", "VERTICAL"], [(1, 1), (1, 1.2), (1.3, 1)]
    for n, (size, fit, aspect) in enumerate(itertools.product(sizes, fits, aspects)):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene, data = bpy.context.scene, bpy.data.cameras.new("camera")
        scene.name, camera = f"scene{n}", bpy.data.objects.new("camera", data)
        scene.collection.objects.link(camera)
        scene.camera, data.sensor_fit, data.lens = camera, fit, float(rng.uniform(18, 50))
        data.shift_x, data.shift_y = map(float, rng.uniform(-0.2, 0.2, 2))
        camera.rotation_euler, camera.location = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)
        scene.render.resolution_x, scene.render.resolution_y = 2 * size[0], 2 * size[1]
        scene.render.resolution_percentage = 50
        scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
        bpy.context.view_layer.update()
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{n}.blend"))
        exec((Path(__file__).parents[2] / "docs/blender_camera.py").read_text(), {})
        local = np.concatenate([rng.uniform(-1, 1, (12, 2)), -rng.uniform(2, 6, (12, 1))], axis=1)
        world = [camera.matrix_world @ Vector(p) for p in local]
        graph, (x, y) = bpy.context.evaluated_depsgraph_get(), size
        P = camera.calc_matrix_camera(graph, x=x, y=y, scale_x=aspect[0], scale_y=aspect[1])
        seen = [P @ camera.matrix_world.normalized().inverted() @ Vector((*p, 1)) for p in world]
        q = [((c[0] / c[3] + 1) / 2 * x - 0.5, (1 - c[1] / c[3]) / 2 * y - 0.5) for c in seen]
        told.append([str(folder / f"scene{n}.camera.json"), size, [list(p) for p in world], q])
    print(json.dumps(told))


def blender_refusals(folder, out):
    """What docs/blender_camera.py says of cameras that are no perspective ones, and of none: {type: words}."""
    import bpy

    told = {}
    for kind in ("ORTHO", "PANO", "none"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        scene, data = bpy.context.scene, bpy.data.cameras.new("camera")
        if kind != "none":
            scene.camera, data.type = bpy.data.objects.new("camera", data), kind
            scene.collection.objects.link(scene.camera)
        bpy.ops.wm.save_as_mainfile(filepath=str(folder / f"{kind}.blend"))
        try:
            exec((Path(__file__).parents[2] / "docs/blender_camera.py").read_text(), {})
        except RuntimeError as error:
            told[kind] = str(error)
    print(json.dumps(told | {"written": sorted(path.name for path in folder.glob("*.json"))}))


def mitsuba_rays(folder, out):
    """Of folder/*.xml, where there is rays.json beside: what each ray hits first, [point, normal], or None; of every
    sensor that is read, its size and rays through some pixels, [x, y, origin, direction]."""
    import mitsuba as mi
    import numpy as np

    mi.set_variant("scalar_rgb")
    mi.set_log_level(mi.LogLevel.Error)
    rays, told = json.loads((folder / "rays.json").read_text()), {}
    for path in sorted(folder.glob("*.xml")):
        scene, hits, seen = mi.load_file(str(path)), [], []
        for origin, direction in rays:
            hit = scene.ray_intersect(mi.Ray3f(origin, direction))
            hits.append([np.array(hit.p).tolist(), np.array(hit.n).tolist()] if hit.is_valid() else None)
        for sensor in scene.sensors()[:1]:
            width, height = np.array(sensor.film().crop_size()).tolist()
            for x, y in ((0.0, 0.0), (width - 1.0, 0.0), (0.25 * width, 0.8 * height), (width - 1.0, height - 1.0)):
                at = mi.Point2f((x + 0.5) / width, (y + 0.5) / height)
                ray, _ = sensor.sample_ray(0, 0.5, at, mi.Point2f(0.5, 0.5))
                seen.append([x, y, np.array(ray.o).tolist(), np.array(ray.d).tolist()])
        told[path.stem] = [hits, seen]
    print(json.dumps(told))


if __name__ == "__main__":
    kind, folder, out, *numbers = sys.argv[1:]
    globals()[kind](Path(folder).resolve(), Path(out), *map(int, numbers))
