"""What `augment` is measured on: changes of shipped scenes, whose true pictures Mitsuba renders (augment_truth.py).

No packages: both environments read it.
"""

LAMP = "v 0 0 0\nv 0 0.5 0\nv 0.8 0.5 0\nv 0.8 0 0\nusemtl lamp\nf 1 2 3 4\n"  # shines downwards
BOX = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 1
v 1 0 1
v 1 1 1
v 0 1 1
usemtl box
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
"""
FILES = {"lamp.obj": LAMP, "box.obj": BOX}
VIEW = {"eye": [1.2, 0.5, 1.7], "at": [3.6, 3.2, 1.0]}  # another viewpoint, in either office

_EGG = {"ellipsoid": [0.1, 0.1, 0.16], "rotate": [0, 0, 0.4], "material": {"kind": "mirror"}}
_SECOND = {"file": "lamp.obj", "at": [0.6, 2.6, 2.7], "material": {"emittance": [24, 24, 30]}}


def _six(egg_at, mirror, gone, paint):
    return {
        "viewpoint": {"camera": "view.cameramodel"},
        "egg": {"add": {**_EGG, "at": egg_at}},
        "mirror": {"change": {mirror: {"kind": "mirror"}}},
        "painted": {"change": {"wall": {"rho_d": paint}}},
        "lamp": {"add": _SECOND},
        "removed": {"remove": gone},
    }


CASES = {
    "office": {
        **_six([4.4, 1.6, 0.92], "board", ["carton", "carton-2"], [0.35, 0.5, 0.7]),
        "box": {
            "add": {
                "file": "box.obj",
                "at": [1.7, 1.9, 0.0],
                "scale": 0.4,
                "rotate": [0, 0, 0.5],
                "material": {"kind": "diffuse", "rho_d": [0.2, 0.5, 0.3]},
            }
        },
        "moved": {"move": {"bin": [-0.6, 0.5, 0]}},
        "night": {"lamps": {"lamp": [10, 10, 16]}},
        "gloss": {
            "change": {"floor": {"kind": "glossy", "rho_d": [0.38, 0.3, 0.23], "rho_s": 3 * [0.3], "alpha": 2 * [0.05]}}
        },
        "ball": {
            "add": {"sphere": 0.15, "at": [4.4, 1.6, 0.91], "material": {"kind": "diffuse", "rho_d": [0.7, 0.4, 0.1]}}
        },
    },
    "office-mirror": _six([4.45, 2.1, 0.92], "books", ["carton"], [0.35, 0.5, 0.7]),
}
