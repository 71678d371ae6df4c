"""Makes the files beside this note: python make.py FOLDER, in an environment with bpy."""

import sys
from pathlib import Path

import bpy

out = Path(sys.argv[1])


def material(name, colour, emits=0.0):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"]
    shader.inputs["Base Color"].default_value = (*colour, 1)
    shader.inputs["Emission Color"].default_value = (1, 1, 1, 1)
    shader.inputs["Emission Strength"].default_value = emits
    return made


def box(name, at, size, paint):
    bpy.ops.mesh.primitive_cube_add(size=1, location=at)
    thing = bpy.context.object
    thing.name, thing.scale = name, size
    thing.data.materials.append(paint)
    return thing


def room():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    wall, wood, lamp = (
        material("Wände", (0.8, 0.8, 0.8)),
        material("Wood", (0.5, 0.3, 0.2)),
        material("Glow", (0, 0, 0), 5),
    )
    box("room", (2, 1.5, 1.25), (4, 3, 2.5), wall)
    box("crate", (1, 1, 0.5), (1, 0.5, 1), wood)
    bpy.ops.mesh.primitive_plane_add(size=1, location=(2, 1.5, 2.4), rotation=(3.141592653589793, 0, 0))
    bpy.context.object.name = "panel"
    bpy.context.object.data.materials.append(lamp)


gltf = lambda name, form="GLB", **words: bpy.ops.export_scene.gltf(
    filepath=str(out / name), export_format=form, **words
)

room()
bpy.ops.object.light_add(type="POINT", location=(2, 1.5, 2))
bpy.ops.object.camera_add(location=(1, 1, 1.5))
bpy.ops.curve.primitive_bezier_circle_add(location=(3, 2, 1))
gltf("lights.glb", export_lights=True, export_cameras=True, export_yup=False)
gltf("my room.gltf", "GLTF_SEPARATE", export_yup=False)
gltf("draco.glb", export_draco_mesh_compression_enable=True)
bpy.ops.wm.obj_export(filepath=str(out / "room.obj"), forward_axis="Y", up_axis="Z", export_curves_as_nurbs=True)
bpy.ops.wm.ply_export(filepath=str(out / "room.ply"), forward_axis="Y", up_axis="Z", ascii_format=False)
bpy.ops.wm.ply_export(filepath=str(out / "room-text.ply"), forward_axis="Y", up_axis="Z", ascii_format=True)
bpy.ops.wm.stl_export(filepath=str(out / "room.stl"), forward_axis="Y", up_axis="Z", ascii_format=False)
bpy.ops.wm.stl_export(filepath=str(out / "room-text.stl"), forward_axis="Y", up_axis="Z", ascii_format=True)
bpy.ops.export_scene.fbx(filepath=str(out / "room.fbx"))
bpy.ops.wm.save_as_mainfile(filepath=str(out / "room.blend"))

# four instances of a chair
room()
chair = box("chair", (3, 1, 0.25), (0.4, 0.4, 0.5), bpy.data.materials["Wood"])
for k in range(3):
    again = chair.copy()
    again.location = (3, 1.6 + 0.6 * k, 0.25)
    bpy.context.collection.objects.link(again)
gltf("instances.glb", export_gpu_instances=True, export_yup=False)

# an arm of bones that is raised, and a shape key
room()
crate = bpy.data.objects["crate"]
bpy.ops.object.armature_add(location=(1, 1, 0))
arm = bpy.context.object
crate.select_set(True)
bpy.context.view_layer.objects.active = arm
bpy.ops.object.parent_set(type="ARMATURE_AUTO")
arm.pose.bones[0].location = (0, 0.5, 0)
room_ = bpy.data.objects["room"]
room_.shape_key_add(name="Basis")
key = room_.shape_key_add(name="higher")
for point in key.data:
    if point.co.z > 0:
        point.co.z += 0.2
key.value = 0.5
bpy.context.view_layer.update()
gltf(
    "skin.glb",
    export_yup=False,
    export_animations=False,
    export_current_frame=True,
    export_rest_position_armature=False,
)
