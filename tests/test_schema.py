"""docs/scene.schema.json: editors check scene.yaml by what the program checks it by, as far as a schema can say."""

import json

import jsonschema
import pytest

from lib.core.stage import BadInput
from lib.core.yaml_file import read_yaml
from lib.planning import rules, schema
from lib.planning import scene as scenes
from lib.planning.pipeline import read_pipeline
from tests.helpers.attic import attic


@pytest.fixture(scope="module")
def stages(request):
    return read_pipeline(request.config.rootpath / "pipeline.yaml")


@pytest.fixture(scope="module")
def validator(stages):
    made = schema.schema(stages)
    jsonschema.Draft7Validator.check_schema(made)
    return jsonschema.Draft7Validator(made)


def test_the_file_is_what_the_command_makes(root):
    """`python -m lib.planning.schema > docs/scene.schema.json` makes it."""
    assert (root / "docs/scene.schema.json").read_text(encoding="utf-8") == schema.text()


def test_shipped_scenes_hold_it(root, validator):
    paths = sorted(root.glob("data/*/scene.yaml"))
    assert len(paths) > 20
    assert not {path.parent.name: e.message for path in paths for e in validator.iter_errors(read_yaml(path))}


def refused(folder, stages, text):
    """Whether the program refuses what scene.yaml says; what the folder lacks for it is not asked."""
    (folder / "scene.yaml").write_text(text, encoding="utf-8")
    try:
        problems = scenes.read(folder, stages).problems
    except BadInput as bad:
        problems = bad.problems
    return [line for line in problems if line.startswith(f"{folder}/scene.yaml: ")]


RIGHT = """
{}
board: {corners: [9, 6], square_m: 0.03}
lens: LENSMODEL_OPENCV8
lens: LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=20_fov_x_deg=120
lamps: {lamp: [1.0, 0, 1e6], light box: unknown}
lamps: {lamp: {emittance: unknown, lobe: unknown, place_sigma_m: 0.2}}
lamps: {lamp: {emittance: [4, 4, 4], lobe: {aim: [0, 0, -1], exponent: 0}}}
reference: {wall: [0.8, 1, 0]}
transfer: auto
transfer: {gamma: 2.2}
transfer: {curve: curve.json}
surfaces: {wall: coloured_mirror}
explain: []
explain: [curve, vignetting, lamp_place]
refine: [objects]
movable: [default]
model: {unit: mm, up: -y}
goals: [materials.json, augmented.egg.png, left.png]
exports: [gltf, blender]
params: {segment: {lambda: auto}, fit: {threshold: 0.02, method: paper}}
params: {segment: {lambda: 0.1}, formfactors: {patches: 1}}
augment: [{name: a, change: {wall: {rho_d: [0.6, 0.1, 0.1]}}}]
augment: [{name: a, add: {file: egg.obj, at: [1, 0, 1], scale: 2, rotate: [0, 0, 1], material: {kind: mirror}}}]
augment: [{name: a, add: [{sphere: 0.1, material: {kind: diffuse, rho_d: [1, 1, 1]}}]}]
augment: [{name: a, add: {file: egg.obj, material: {lid: {kind: diffuse, rho_d: [0, 0, 0]}}}}]
augment: [{name: a, add: {ellipsoid: [1, 1, 2], material: {emittance: [1, 1, 1]}}, grain: true}]
augment: [{name: a, remove: [default], lamps: {lamp: [0, 0, 0]}}]
augment: [{name: a, move: {default: [0, -1, 0]}}]
augment: [{name: a, cameras: path.csv}, {name: b, cameras: [a.cameramodel, b.cameramodel], frames: 2}]
""".strip().split("\n")

# What the schema refuses, and the program
WRONG = """
bogus: 1
sky: unknown
lamps:
board: {corners: [9], square_m: 0.03}
board: {corners: [9, 1], square_m: 0.03}
board: {corners: [9, 6], square_m: 30}
board: {corners: [9, 6]}
board: {corners: [9, 6], square_m: 0.03, colour: red}
lens: OPENCV8
camera: {eye: [0, 0, 1], at: [1, 0, 1]}
camera: {eye: [0, 0, 1], at: [1, 0], hfov_deg: 60}
camera: {eye: [0, 0, 1], at: [1, 0, 1], hfov_deg: 180}
lamps: [lamp]
lamps: {lamp: 1}
lamps: {lamp: [1, 1]}
lamps: {lamp: [1, 1, -1e-9]}
lamps: {lamp: [1, 1, true]}
lamps: {lamp: ['1', 1, 1]}
lamps: {lamp: unknwon}
lamps: {7: [1, 1, 1]}
lamps: {lamp: {place_sigma_m: 0.1}}
lamps: {lamp: {emittance: unknown, place_sigma_m: 0}}
lamps: {lamp: {emittance: unknown, gradient: unknown}}
lamps: {lamp: {emittance: unknown, lobe: sharp}}
lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, -1]}}}
lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, 0], exponent: 2}}}
lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, 1], exponent: 1001}}}
reference: {wall: [1.2, 0, 0]}
reference: {wall: unknown}
transfer: gama
transfer: {gamma: 0}
transfer: {gamma: 2.2, curve: curve.json}
transfer: {curve: ../curve.json}
transfer: {curve: /curve.json}
surfaces: {wall: glass}
surfaces: wall
explain: curve
explain: [fog]
refine: objects
refine: [camera]
movable: [default, default]
movable: ['']
model: {unit: yards}
model: {up: north}
model: {size: 3}
photos: {x: 0.5}
photos: {x: {exposure: 0}}
photos: {x: {colour: red}}
goals: materials.json
goals: [1]
goals: [../materials.json]
exports: [vrml]
exports: [gltf, gltf]
params: {sgment: {lambda: 1}}
params: {segment: {lamda: 1}}
params: {segment: {lambda: much}}
params: {formfactors: {patches: 0}}
params: {formfactors: {patches: 1.5}}
params: {fit: {method: newton}}
params: {fit: {threshold: 0}}
augment: {name: a}
augment: [a]
augment: [{camera: door.cameramodel}]
augment: [{name: a b}]
augment: [{name: a, paint: red}]
augment: [{name: a, frames: 10}]
augment: [{name: a, cameras: [a.cameramodel], frames: 10}]
augment: [{name: a, cameras: [a.cameramodel, b.cameramodel]}]
augment: [{name: a, cameras: [a.cameramodel, b.cameramodel], frames: 1}]
augment: [{name: a, cameras: path.txt}]
augment: [{name: a, camera: a.cameramodel, cameras: path.csv}]
augment: [{name: a, add: {at: [1, 0, 1], material: {kind: mirror}}}]
augment: [{name: a, add: {sphere: 1, ellipsoid: [1, 1, 1], material: {kind: mirror}}}]
augment: [{name: a, add: {sphere: 0, material: {kind: mirror}}}]
augment: [{name: a, add: {sphere: 1}}]
augment: [{name: a, add: {sphere: 1, material: {kind: gold}}}]
augment: [{name: a, add: {sphere: 1, material: {kind: diffuse}}}]
augment: [{name: a, add: {sphere: 1, material: {kind: textured, texture: a.png}}}]
augment: [{name: a, add: {sphere: 1, material: {kind: glossy, rho_d: [0, 0, 0], rho_s: [1, 1, 1]}}}]
augment: [{name: a, add: {sphere: 1, material: {kind: diffuse, rho_d: [1, 1, 1], alpha: [1, 1]}}}]
augment: [{name: a, add: {sphere: 1, material: {lid: {kind: mirror}}}}]
augment: [{name: a, add: {file: egg.fbx, material: {kind: mirror}}}]
augment: [{name: a, change: {wall: {rho_d: [0.6, 0.1]}}}]
augment: [{name: a, change: {wall: {emittance: [1, 1, 1]}}}]
augment: [{name: a, change: {wall: {kind: glossy}}}]
augment: [{name: a, move: {default: [0, 1]}}]
augment: [{name: a, remove: default}]
augment: [{name: a, lamps: {lamp: [-1, 0, 0]}}]
augment: [{name: a, grain: much}]
""".strip().split("\n")

# What the program alone can say: names of the model, files of the folder, numbers that are compared
BEYOND = """
lamps: {candle: unknown}
goals: [materials.jsn]
transfer: {curve: gone.json}
board: {corners: [9.0, 6], square_m: 0.03}
camera: {eye: [0, 0, 1], at: [0, 0, 1], hfov_deg: 60}
camera: {eye: [0, 0, 1], at: [0, 0, 2], hfov_deg: 60}
augment: [{name: a, add: {sphere: 1, material: {kind: glossy, rho_d: [1, 1, 1], rho_s: [1, 1, 1], alpha: [1, 1]}}}]
augment: [{name: a, change: {wall: {alpha: [0.1, 0.2]}}}]
augment: [{name: a}, {name: a}]
augment: [{name: a, remove: [default], move: {default: [0, 0, 1]}}]
""".strip().split("\n")


@pytest.fixture
def folder(tmp_path):
    made = attic(tmp_path)
    (made / "scene.yaml").write_text("{}")
    for name in ("curve.json", "egg.obj", "path.csv", "a.cameramodel", "b.cameramodel"):
        (made / name).write_text("")
    return made


def holds(folder, validator, text):
    (folder / "scene.yaml").write_text(text, encoding="utf-8")
    return validator.is_valid(read_yaml(folder / "scene.yaml"))


@pytest.mark.parametrize("text", RIGHT)
def test_what_is_right_holds_it(folder, stages, validator, text):
    assert holds(folder, validator, text)
    assert not refused(folder, stages, text)


@pytest.mark.parametrize("text", WRONG)
def test_what_the_program_refuses_the_schema_refuses(folder, stages, validator, text):
    assert refused(folder, stages, text)
    assert not holds(folder, validator, text)


@pytest.mark.parametrize("text", BEYOND)
def test_what_no_schema_can_say_the_program_refuses(folder, stages, validator, text):
    """So that this list stays short: what the schema learns to say goes up to the others."""
    assert refused(folder, stages, text)
    assert holds(folder, validator, text)


def test_every_key_is_asked_here():
    """A key of scene.yaml that nobody wrote into the lists above would be checked by luck alone."""
    asked = {line.partition(":")[0] for line in (*RIGHT, *WRONG)}
    assert asked >= set(rules.KEYS)
    assert json.loads(schema.text())["properties"].keys() == set(rules.KEYS)
