"""A corner with a red box, 32 x 24, as Blender stores pictures: python make.py FOLDER (bpy 5.0.1). Own work, CC0."""

import sys

import bpy

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
bpy.ops.mesh.primitive_plane_add(size=4)
bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 0, 0.5))
material = bpy.data.materials.new("red")
material.use_nodes = True
material.node_tree.nodes.get("Principled BSDF").inputs[0].default_value = (0.8, 0.1, 0.05, 1)
bpy.context.object.data.materials.append(material)
light = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
light.data.energy = 3
scene.collection.objects.link(light)
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
camera.location, camera.rotation_euler = (2.5, -2.5, 2.5), (0.95, 0, 0.785)
scene.collection.objects.link(camera)
scene.camera, scene.world = camera, bpy.data.worlds.new("w")
scene.render.engine, scene.cycles.samples, scene.cycles.device = "CYCLES", 4, "CPU"
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 32, 24, 100
scene.view_layers[0].use_pass_z = scene.view_layers[0].use_pass_normal = True
scene.view_settings.view_transform = "Standard"
settings = scene.render.image_settings
bpy.ops.render.render()


def save(name, media="IMAGE", **words):
    settings.media_type = media
    for key, value in words.items():
        setattr(settings, key, value)
    bpy.data.images["Render Result"].save_render(f"{sys.argv[1]}/{name}")


save("multilayer.exr", "MULTI_LAYER_IMAGE", file_format="OPEN_EXR_MULTILAYER", color_depth="16")
save("plain.exr", file_format="OPEN_EXR", color_depth="16", color_mode="RGBA")
for device, name in (
    ("sRGB", "srgb"),
    ("Display P3", "p3"),
    ("Rec.2020", "rec2020"),
    ("Rec.2100-PQ", "pq"),
    ("Rec.2100-HLG", "hlg"),
):
    scene.display_settings.display_device = device
    scene.view_settings.view_transform = "Standard"
    save(f"{name}.png", file_format="PNG", color_depth="16", color_mode="RGB")
    save(f"{name}.tif", file_format="TIFF", color_depth="16", color_mode="RGB")
    save(f"{name}.jpg", file_format="JPEG", color_mode="RGB", quality=95)
