# In Blender's Text Editor: open this file, Run Script.  Writes <scene>.camera.json beside the .blend file, for
#     make new-scene NAME=... MODEL=... PHOTO=... CAMERA=<scene>.camera.json
# Export the model as OBJ or glTF *without* turning it (OBJ: Forward Y, Up Z), so that it has Blender's own axes.
import json

import bpy

render, camera = bpy.context.scene.render, bpy.context.scene.camera
if camera is None:
    raise RuntimeError("the scene has no camera: choose one in the scene's properties")
kind = getattr(camera.data, "type", "PERSP")
if kind != "PERSP":  # its pixels are no pinhole's
    words = {"ORTHO": "orthographic", "PANO": "panoramic"}
    raise RuntimeError(f"the camera is {words.get(kind, kind)}: set it to Perspective")
if getattr(render, "use_border", False) and getattr(render, "use_crop_to_border", False):
    raise RuntimeError("the render region is cropped, so that pictures are a part of the camera's: switch Crop off")
if getattr(render, "use_multiview", False):
    raise RuntimeError("stereoscopy is on, so that pictures are of another place than the camera's: switch it off")
width, height = (int(n * render.resolution_percentage / 100) for n in (render.resolution_x, render.resolution_y))
ratio = render.pixel_aspect_y / render.pixel_aspect_x  # of a pixel
fit = camera.data.sensor_fit
across = fit == "HORIZONTAL" or fit == "AUTO" and width >= height * ratio
side = width if across else height * ratio  # px, that the sensor spans
sensor = camera.data.sensor_height if fit == "VERTICAL" else camera.data.sensor_width
focal = camera.data.lens / sensor * side
told = {"type": kind, "size_px": [width, height], "lens_px": [focal, focal / ratio]}
told["shift_px"] = [camera.data.shift_x * side, camera.data.shift_y * side / ratio]
told["matrix_world"] = [list(row) for row in camera.matrix_world.normalized()]
with open(bpy.path.abspath(f"//{bpy.context.scene.name}.camera.json"), "w") as file:
    json.dump(told, file, indent=1)
