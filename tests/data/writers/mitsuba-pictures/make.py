"""A floor, 32 x 24, with depth and normals in one EXR: python make.py FILE (Mitsuba 3.9.1). Own work, CC0."""

import sys

import mitsuba as mi

mi.set_variant("scalar_rgb")
film = {"type": "hdrfilm", "width": 32, "height": 24, "pixel_format": "rgb", "component_format": "float16"}
scene = mi.load_dict(
    {
        "type": "scene",
        "integrator": {"type": "aov", "aovs": "dd:depth,nn:sh_normal", "img": {"type": "path"}},
        "sensor": {
            **{"type": "perspective", "fov": 50, "film": film, "sampler": {"type": "independent", "sample_count": 4}},
            "to_world": mi.ScalarTransform4f().look_at([2, -2, 2], [0, 0, 0.4], [0, 0, 1]),
        },
        "floor": {
            "type": "rectangle",
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.3, 0.2]}},
        },
        "sky": {"type": "constant"},
    }
)
mi.render(scene)
scene.sensors()[0].film().bitmap(raw=False).write(sys.argv[1])
