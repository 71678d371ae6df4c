"""Every rule of data/SCENE.md section 3: what a scene may say, and the one line for what it may not."""

from pathlib import Path

import pytest

from lib.core.stage import BadInput
from lib.planning import files
from lib.planning import scene as scenes
from lib.planning.pipeline import Stage
from tests.helpers.attic import attic

ROOT = Path(__file__).resolve().parents[1]
NUMBERS = {"lambda": "auto", "passes": 3, "method": "merge", "fast": True}
STAGES = {
    "segment": Stage("segment", "", params=NUMBERS, writes={"regions": "left.regions.png"}),
    "fit": Stage("fit", "", writes={"materials": "materials.json"}),
    "render": Stage("render", "", writes={"rendered": "rendered.png"}, may_write={"mirror": "mirror.png"}),
    "report": Stage("report", "", writes={"page": "report.html"}),
}


@pytest.fixture
def folder(tmp_path):
    return attic(tmp_path)


def problems(folder, text):
    (folder / "scene.yaml").write_bytes(text.encode() if isinstance(text, str) else text)
    try:
        found = scenes.read(folder, STAGES).problems
    except BadInput as bad:
        found = bad.problems
    assert all("\n" not in line and line.startswith(str(folder)) for line in found)
    return [line.replace(f"{folder}/scene.yaml: ", "") for line in found]


def test_all_keys_are_optional(folder):
    assert problems(folder, "") == problems(folder, "# nothing\n") == problems(folder, "{}") == []
    scene = scenes.read(folder, STAGES)
    assert (
        scene.goals == ("materials.json", "rendered.png", "report.html")
        and scene.lamps == {}
        and scene.fact("transfer") == "auto"
    )


def test_everything_the_contract_shows_and_that_is_built(folder):
    (folder / "truth").mkdir()
    assert (
        problems(
            folder,
            """
board: {corners: [9, 6], square_m: 0.030}
lens: LENSMODEL_OPENCV8
lamps:
  lamp: [1.0, 0, 1e6]
  light box: unknown
reference: {wall: [0.80, 1, 0]}
transfer: {gamma: 2.2}
surfaces: {wall: diffuse}
goals: [materials.json, rendered.png, left.regions.png, left.png, rendered.png]
augment: []
params: {segment: {lambda: 1e-3, passes: 0, method: admm, fast: false}}
""",
        )
        == []
    )
    scene = scenes.read(folder, STAGES)
    assert scene.lamps == {"lamp": [1.0, 0, 1e6], "light box": "unknown"} and scene.fact("lamp_groups") == [
        "lamp",
        "light box",
    ]
    assert scene.params == {"segment": {"lambda": 0.001, "passes": 0, "method": "admm", "fast": False}}
    assert scene.goals == ("materials.json", "rendered.png", "left.regions.png", "left.png")


@pytest.mark.parametrize(
    "text, line",
    [
        (
            "bogus: 1",
            "bogus: 1 is an unknown key; known are board, lens, camera, lamps, reference, transfer, surfaces, explain, "
            "refine, movable, model, photos, goals, augment, exports, params",
        ),
        ("lamps: {lamp: [1, 1, 1]}\nlamps: {lamp: [1, 1, 1]}", "line 2: lamps: the key stands there twice"),
        ("lamps: {lamp: [1, 1, 1], lamp: unknown}", "line 1: lamp: the key stands there twice"),
        ("lamps:", "lamps: is empty: leave the key out or give it a value"),
        ("- lamps", '["lamps"] is not a mapping of keys to values'),
        ("lamps: [lamp]", 'lamps: ["lamp"] is not a mapping'),
        ("lamps: {lamp: [1, 1]}", "lamps.lamp: [1, 1] is not a list of three numbers or `unknown`"),
        ("lamps: {lamp: 1}", "lamps.lamp: 1 is not a list of three numbers or `unknown`"),
        ("lamps: {lamp: [1, 1, true]}", "lamps.lamp: [1, 1, true] is not a list of three numbers or `unknown`"),
        ("lamps: {lamp: ['1', 1, 1]}", 'lamps.lamp: ["1", 1, 1] is not a list of three numbers or `unknown`'),
        ("lamps: {lamp: [1, 1, -1e-9]}", "lamps.lamp: [1, 1, -1e-09] is negative"),
        ("lamps: {lamp: [1, 1, .inf]}", "lamps.lamp: [1, 1, Infinity] is not finite"),
        ("lamps: {lamp: [1, 1, 1e999]}", "lamps.lamp: [1, 1, Infinity] is not finite"),
        ("lamps: {lamp: [1, 1, .nan]}", "lamps.lamp: [1, 1, NaN] is not finite"),
        ("lamps: {7: [1, 1, 1]}", "lamps: 7 is not a name (quote it)"),
        (
            "lamps: {candle: [1, 1, 1]}",
            "lamps.candle: [1, 1, 1] names no group of model.obj, which has lamp, light box, wall",
        ),
        ("reference: {wall: [1.2, 0, 0]}", "reference.wall: [1.2, 0, 0] is outside [0, 1]"),
        ("reference: {wall: unknown}", 'reference.wall: "unknown" is not a list of three numbers'),
        (
            "reference: {cat: [0, 0, 0]}",
            "reference.cat: [0, 0, 0] names no group of model.obj, which has lamp, light box, wall",
        ),
        (
            "transfer: gama",
            'transfer: "gama" is none of auto, gamma, linear, srgb, curve, linear_per_group, histogram, '
            "histogram_per_group, {gamma: 2.2}",
        ),
        ("lamps: {lamp: {place_sigma_m: 0.1}}", "lamps.lamp.emittance: is not a list of three numbers or `unknown`"),
        (
            "lamps: {lamp: {emittance: unknown, place_sigma_m: 0}}",
            "lamps.lamp.place_sigma_m: 0 is not a positive length",
        ),
        ("lamps: {lamp: {emittance: unknown, gradient: unknown}}", 'lamps.lamp.gradient: "unknown" is not built yet'),
        ("lamps: {lamp: {emittance: unknown, lobe: sharp}}", 'lamps.lamp.lobe: "sharp" is neither `unknown` nor'),
        ("lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, -1]}}}", "lamps.lamp.lobe: {"),
        ("lamps: {lamp: {emittance: unknown, lobe: {ies: a.ies}}}", 'lamps.lamp.lobe.ies: "a.ies" is not built yet'),
        (
            "lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, 0], exponent: 2}}}",
            "lamps.lamp.lobe.aim: [0, 0, 0] is not a direction",
        ),
        (
            "lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, -1], exponent: -1}}}",
            "lamps.lamp.lobe.exponent: -1 is not a number from 0",
        ),
        ("lamps: {lamp: {emittance: unknown, size: 1}}", "lamps.lamp.size: 1 is an unknown key; known are emittance"),
        ("model: {unit: yards}", 'model.unit: "yards" is none of mm, cm, m, km, in, ft'),
        ("model: {up: north}", 'model.up: "north" is none of x, y, z, -x, -y, -z'),
        ("model: {size: 3}", "model.size: 3 is an unknown key; known are unit, up"),
        ("model: mm", 'model: "mm" is not a mapping'),
        ("transfer: {gamma: 0}", "transfer.gamma: 0 is not a positive number"),
        ("transfer: {gamma: .nan}", "transfer.gamma: NaN is not a positive number"),
        ("transfer: {}", "transfer: {} is neither one gamma nor one curve"),
        (
            "transfer: {gamma: 2, curve: a.json}",
            'transfer: {"gamma": 2, "curve": "a.json"} is neither one gamma nor one',
        ),
        ("transfer: {gamma: 2, x: 1}", "transfer.x: 1 is an unknown key; known are gamma, curve"),
        ("transfer: {curve: a.json}", 'transfer.curve: "a.json" is not in the scene\'s folder'),
        ("transfer: {curve: ../a.json}", 'transfer.curve: "../a.json" lies outside the scene\'s folder'),
        (
            "surfaces: {wall: shiny}",
            'surfaces.wall: "shiny" is none of diffuse, mirror, coloured_mirror, glossy, textured',
        ),
        (
            "surfaces: {wall: velvet}",
            'surfaces.wall: "velvet" is none of diffuse, mirror, coloured_mirror, glossy, textured',
        ),
        ("goals: materials.json", 'goals: "materials.json" is not a list'),
        ("goals: [../other/left.png]", 'goals: "../other/left.png" lies outside the scene\'s folder'),
        ("goals: [/etc/passwd]", 'goals: "/etc/passwd" lies outside the scene\'s folder'),
        ("goals: [picture.png]", 'goals: "picture.png" is neither made by a stage nor given'),
        ("goals: [7]", "goals: 7 is not a file's name"),
        ("board: {corners: [9, 6]}", "board.square_m: is missing"),
        (
            "board: {corners: [9, 6.5], square_m: 0.03}",
            "board.corners: [9, 6.5] is not two whole numbers of at least 2",
        ),
        ("board: {corners: [9, 6], square_m: 0}", "board.square_m: 0 is not a positive length in metres"),
        (
            "board: {corners: [9, 6], square_m: 0.03, colour: red}",
            'board.colour: "red" is an unknown key; known are corners, square_m',
        ),
        ("lens: OPENCV8", 'lens: "OPENCV8" is not a name of a mrcal lens model, LENSMODEL_...'),
        ("augment: [{name: tea pot}]", 'augment[0].name: "tea pot" is not a name of letters, digits, _ and -'),
        (
            "params: {blend: {x: 1}}",
            'params.blend: {"x": 1} belongs to no stage; stages are segment, fit, render, report',
        ),
        (
            "params: {segment: {lamda: 1}}",
            "params.segment.lamda: 1 is no number of segment, which has lambda, passes, method, fast",
        ),
        ("params: {segment: {lambda: thick}}", 'params.segment.lambda: "thick" is neither a number nor `auto`'),
        ("params: {segment: {lambda: .inf}}", "params.segment.lambda: Infinity is not finite"),
        ("params: {segment: {passes: 1.5}}", "params.segment.passes: 1.5 is not a whole number"),
        ("params: {segment: {fast: 1}}", "params.segment.fast: 1 is neither true nor false"),
        ("params: {segment: 3}", "params.segment: 3 is not a mapping"),
        ("lamps: {lamp: [1, 1, 1}", "line 1: expected ',' or ']', but got '}'"),
        ("a: 1\n---\nb: 2", "line 2: but found another document"),
        (b"\xff\xfe", "not UTF-8: invalid start byte at byte 0"),
        (
            "lamps: !!python/object:os.system {}",
            "line 1: !!python/object:os.system: tags are not read",
        ),
    ],
)
def test_one_line_per_problem(folder, text, line):
    found = problems(folder, text)
    assert len(found) == 1 and found[0].startswith(line)


def test_all_problems_at_once(folder):
    found = problems(
        folder,
        "bogus: 1\nlamps: {lamp: [-1, 1, 1], candle: [1]}\ntransfer: 3\nreference: {wall: [2, 2, 2]}\n"
        "augment: [{camera: ../door.cameramodel}, {name: a, add: {file: no.obj}}, {name: a}]",  # no material
    )
    assert [line.split(":")[0] for line in found] == [
        "bogus",
        "lamps.lamp",
        "lamps.candle",
        "transfer",
        "reference.wall",
        "augment[0].name",
        "augment[0].camera",
        "augment[1].add.material",
        "augment[1].add.file",
        "augment[2].name",
    ]


@pytest.mark.parametrize(
    "text",
    [
        "&a [*a]",
        "[" * 5000,
        "? [1, 2]\n: 3",
        "a: &x {b: *x}",
        "<<: {lamps: 1}",
        "\t- x",
        "%YAML 9.9\n---\n{}",
        "a: 2020-01-01",
    ],
)
def test_odd_yaml_is_one_line(folder, text):
    assert len(problems(folder, text)) == 1


def test_words_and_numbers_as_yaml_1_2_has_them(folder):
    """A group may be called `no` or `on`; 1e-3 is a number; 010 is ten and 1:30 a word."""
    (folder / "model.obj").write_text("usemtl no\nusemtl on\n")
    assert problems(folder, "lamps: {no: [1e-3, +1E2, .5], on: [010, 0, 0]}") == []
    assert scenes.read(folder, STAGES).lamps == {"no": [0.001, 100.0, 0.5], "on": [10, 0, 0]}
    assert problems(folder, "lamps: {no: [1:30, 1, 1]}") == [
        'lamps.no: ["1:30", 1, 1] is not a list of three numbers or `unknown`'
    ]


def test_two_photographs_or_two_models(folder):
    (folder / "left.tif").touch()
    (folder / "model.glb").touch()
    assert problems(folder, "") == [
        f"{folder}: left.png and left.tif: only one of them may be given",
        f"{folder}: model.obj and model.glb: only one of them may be given",
    ]


def test_transfer_of_a_linear_photograph(folder):
    (folder / "left.png").rename(folder / "left.exr")
    problems(folder, "")
    assert scenes.read(folder, STAGES).fact("transfer") == "linear"


def test_a_folder_without_scene_yaml(folder):
    with pytest.raises(BadInput, match="scene.yaml: there is no such file"):
        scenes.read(folder, STAGES)


def test_groups_of_a_binary_model(tmp_path):
    import json

    def glb(content):
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        path = tmp_path / "model.glb"
        path.write_bytes(
            b"glTF"
            + (2).to_bytes(4, "little")
            + (20 + len(text)).to_bytes(4, "little")
            + len(text).to_bytes(4, "little")
            + b"JSON"
            + text
        )
        return path

    assert files.model_groups(glb({"materials": [{"name": "wall"}, {"name": "lamp"}]})) == {"wall", "lamp"}
    assert files.model_groups(glb({"materials": [{}]})) is None and files.model_groups(glb({})) is None
    (tmp_path / "model.glb").write_bytes(b"glTF")
    assert files.model_groups(tmp_path / "model.glb") is None
