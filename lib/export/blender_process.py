"""The recovered scene in Blender, as a scene of its own beside what is open.

    $ blender --python scene.py                     or, with Blender as a Python module:  python scene.py
    $ blender -b --python scene.py -- out.png       renders it, too, by Cycles

scene.json and pictures lie beside this script. The camera has the photograph as its background. An emission of
emittance x watt_per_unit / pi is a lamp of that many W/m2; the exposure takes 1.0 back to the photograph's white. View
transform Standard: Blender shows sRGB, the photograph its own camera's curve.
"""

import json
import math
import sys
from pathlib import Path

import bpy

FOLDER = Path(__file__).resolve().parent
SENSOR_MM = 36.0
SAMPLES, BOUNCES = 256, 64


def main(argv):
    told = json.loads((FOLDER / "scene.json").read_text(encoding="utf-8"))
    scene = bpy.data.scenes.new(told["name"])
    if bpy.context.window:
        bpy.context.window.scene = scene
    radiance = told["watt_per_unit"] / math.pi  # of an emittance of 1.0
    materials = {name: material(name, look, radiance) for name, look in told["looks"].items()}
    collections = {}
    for piece in told["pieces"]:
        thing = piece["object"]
        if thing not in collections:
            collections[thing] = bpy.data.collections.new(thing)
            scene.collection.children.link(collections[thing])
        collections[thing].objects.link(mesh(piece, materials[piece["look"]]))
    camera(scene, told)
    world = bpy.data.worlds.new(told["name"])
    world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = [*told["glow"], 1.0]
    background.inputs["Strength"].default_value = radiance
    scene.world = world
    rendering(scene, told)
    if argv:
        scene.render.filepath = str(Path(argv[0]).resolve())
        bpy.ops.render.render(write_still=True, scene=scene.name)


def mesh(piece, look):
    """An object of triangles that share no corner."""
    points, uv = piece["points"], piece["uv"]
    data = bpy.data.meshes.new(piece["name"])
    data.from_pydata(points, [], [(i, i + 1, i + 2) for i in range(0, len(points), 3)])
    layer = data.uv_layers.new(name="st")
    for loop in data.loops:
        layer.data[loop.index].uv = uv[loop.vertex_index]
    data.materials.append(look)
    return bpy.data.objects.new(piece["name"], data)


def camera(scene, told):
    """The photograph's camera, its principal point by a shift."""
    lens, (W, H) = told["camera"], told["camera"]["size"]
    (fx, _, cx), (_, fy, cy), _ = lens["K"]
    data = bpy.data.cameras.new("photograph")
    data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", SENSOR_MM, SENSOR_MM * fx / W
    data.shift_x = ((W - 1) / 2 - cx) / W
    data.shift_y = (cy - (H - 1) / 2) / W * fx / fy
    data.clip_start, data.clip_end = 0.001, 10000.0
    data.show_background_images = True
    picture = data.background_images.new()
    picture.image = bpy.data.images.load(str(FOLDER / told["photograph"]))
    thing = bpy.data.objects.new("photograph", data)
    thing.matrix_world = [list(column) for column in zip(*lens["T_world_cam"], strict=True)]  # Blender takes columns
    scene.collection.objects.link(thing)
    scene.camera = thing
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = W, H, 100
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0, fy / fx), max(1.0, fx / fy)


def rendering(scene, told):
    scene.unit_settings.system = "METRIC"
    scene.display_settings.display_device = "sRGB"
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.exposure = math.log2(math.pi / told["watt_per_unit"])
    scene.view_settings.gamma = 1.0
    scene.render.engine = "CYCLES"
    scene.render.film_transparent = False
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format = "PNG"
    cycles = scene.cycles
    cycles.samples, cycles.use_denoising, cycles.use_adaptive_sampling = SAMPLES, False, False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = BOUNCES
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1.0


# ---- materials ----


def material(name, look, radiance):
    """A look as nodes: Diffuse, Glossy (Beckmann, Ward's alphas), their sum, or Emission on the front."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    made["exact"] = json.dumps(look["exact"])
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    output = nodes.new("ShaderNodeOutputMaterial")
    made.use_backface_culling = False
    last = surface(nodes, links, look)
    if look["emittance"]:
        last = lamp(nodes, links, look, radiance, last)
    links.new(last, output.inputs["Surface"])
    made.diffuse_color = [*look["rho_d"], 1.0]
    return made


def surface(nodes, links, look):
    """The socket of what reflects."""
    diffuse = nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = [*look["rho_d"], 1.0]
    if look["texture"]:
        image = nodes.new("ShaderNodeTexImage")
        image.image = bpy.data.images.load(str(FOLDER / look["texture"]))
        image.image.colorspace_settings.name = "Non-Color"  # linear albedo
        image.extension = "EXTEND"
        links.new(image.outputs["Color"], diffuse.inputs["Color"])
    if not any(look["rho_s"]):
        return diffuse.outputs[0]
    glossy = nodes.new("ShaderNodeBsdfAnisotropic")
    glossy.inputs["Color"].default_value = [*look["rho_s"], 1.0]
    wide, narrow = look["alpha"] or (0.0, 0.0)
    glossy.distribution = "BECKMANN"
    glossy.inputs["Roughness"].default_value = (wide * narrow) ** 0.25  # squared: the mean of the alphas
    if look["tangent"] and wide != narrow:
        glossy.inputs["Anisotropy"].default_value = math.sqrt(narrow / wide) - 1  # below 0: wider along the tangent
        tangent = nodes.new("ShaderNodeCombineXYZ")
        for socket, value in zip(tangent.inputs, look["tangent"], strict=True):
            socket.default_value = value
        links.new(tangent.outputs[0], glossy.inputs["Tangent"])
    if not any(look["rho_d"]):
        return glossy.outputs[0]
    both = nodes.new("ShaderNodeAddShader")
    links.new(diffuse.outputs[0], both.inputs[0])
    links.new(glossy.outputs[0], both.inputs[1])
    return both.outputs[0]


def lamp(nodes, links, look, radiance, back):
    """The socket of a lamp: on its front, emission and what it reflects; on its back what it reflects."""
    emission = nodes.new("ShaderNodeEmission")
    strength = max(look["emittance"])
    emission.inputs["Color"].default_value = [*(v / max(strength, 1e-9) for v in look["emittance"]), 1.0]
    emission.inputs["Strength"].default_value = strength * radiance
    geometry = nodes.new("ShaderNodeNewGeometry")
    if look["throw"]:
        *aim, exponent = look["throw"]
        dot = nodes.new("ShaderNodeVectorMath")
        dot.operation = "DOT_PRODUCT"
        links.new(geometry.outputs["Incoming"], dot.inputs[0])  # towards the eye
        dot.inputs[1].default_value = aim
        value = calculated(nodes, links, "MAXIMUM", dot.outputs["Value"], 0.0)
        value = calculated(nodes, links, "POWER", value, exponent)
        value = calculated(nodes, links, "MULTIPLY", value, strength * radiance)
        links.new(value, emission.inputs["Strength"])
    front = nodes.new("ShaderNodeAddShader")
    links.new(emission.outputs[0], front.inputs[0])
    links.new(back, front.inputs[1])
    sides = nodes.new("ShaderNodeMixShader")
    links.new(geometry.outputs["Backfacing"], sides.inputs[0])
    links.new(front.outputs[0], sides.inputs[1])
    links.new(back, sides.inputs[2])
    return sides.outputs[0]


def calculated(nodes, links, operation, socket, number):
    """The socket of a calculation with one socket and one number."""
    node = nodes.new("ShaderNodeMath")
    node.operation = operation
    links.new(socket, node.inputs[0])
    node.inputs[1].default_value = number
    return node.outputs[0]


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
