"""A small scene as Blender itself writes USD: .venv-exports/bin/python tests/data/writers/blender-usd/make.py

Two materials on one cube, a lamp, a sun, a camera, a hidden object, instances of a collection, a mesh with a mirrored
transform, a subdivision surface.
"""

from pathlib import Path

import bpy

HERE = Path(__file__).parent


def main():
    bpy.ops.wm.read_factory_settings(use_empty=True)
    names = ("wood", "wall paint", "glow", "off")
    wood, wall, glow, off = (bpy.data.materials.new(name) for name in names)
    for material, strength in ((wood, 0.0), (wall, 0.0), (glow, 3.0), (off, 0.0)):
        material.use_nodes = True
        inputs = material.node_tree.nodes["Principled BSDF"].inputs
        inputs["Emission Color"].default_value = (1, 1, 1, 1)
        inputs["Emission Strength"].default_value = strength
    bpy.ops.mesh.primitive_cube_add(size=2, location=(0, 0, 1))
    cube = bpy.context.object
    cube.name = "box"
    cube.data.materials.append(wood)
    cube.data.materials.append(wall)
    cube.data.polygons[5].material_index = 1  # the top
    bpy.ops.mesh.primitive_plane_add(size=1, location=(0, 0, 3), rotation=(3.141592653589793, 0, 0))
    bpy.context.object.name = "lamp"
    bpy.context.object.data.materials.append(glow)
    bpy.ops.mesh.primitive_plane_add(size=1, location=(5, 0, 0))
    mirrored = bpy.context.object
    mirrored.name, mirrored.scale = "mirrored", (-1, 1, 1)
    mirrored.data.materials.append(off)
    bpy.ops.mesh.primitive_plane_add(size=1)
    hidden = bpy.context.object
    hidden.name, hidden.hide_render = "hidden", True
    hidden.hide_set(True)
    bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 5, 0))
    round_ = bpy.context.object
    round_.name = "cushion"
    round_.data.materials.append(wood)
    round_.modifiers.new("Subdivision", "SUBSURF")
    chairs = bpy.data.collections.new("chairs")
    bpy.ops.mesh.primitive_plane_add(size=0.4, location=(0, 0, 0.45))
    seat = bpy.context.object
    seat.name = "seat"
    seat.data.materials.append(wood)
    chairs.objects.link(seat)
    bpy.context.scene.collection.objects.unlink(seat)
    for k in range(2):
        empty = bpy.data.objects.new(f"chair{k}", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", chairs, (10 + k, 0, 0)
        bpy.context.scene.collection.objects.link(empty)
    bpy.ops.object.light_add(type="SUN")
    bpy.ops.object.camera_add()
    for name, more in (("plain", {}), ("instanced", {"use_instancing": True, "export_subdivision": "IGNORE"})):
        bpy.ops.wm.usd_export(filepath=str(HERE / f"{name}.usdc"), export_textures_mode="KEEP", **more)


if __name__ == "__main__":
    main()
