"""Every rule of data/SCENE.md section 3: what a scene may say, and the one line for what it may not."""
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from lib import plan as planning, scene as scenes
from lib.stage import BadInput

ROOT = Path(__file__).resolve().parents[1]
CAMERA = """# as mrcal writes it
{{ 'lensmodel': '{lens}', 'intrinsics': [ 100., 100., 1.5, 1.5 ], 'extrinsics': [ 0., 0., 0., 0., 0., 0. ], 'imagersize': [ 4, 4 ] }}
"""


@dataclass
class Stage:
    params: dict = field(default_factory=dict)
    writes: dict = field(default_factory=dict)


STAGES = {"segment": Stage({"lambda": "auto", "passes": 3, "method": "merge", "fast": True}, {"regions": "left.regions.png"}),
          "fit": Stage({}, {"materials": "materials.json"}), "render": Stage({}, {"rendered": "rendered.png"}), "report": Stage({}, {"page": "report.html"})}


@pytest.fixture
def folder(tmp_path):
    """A scene with a photograph, a model of three groups and a pinhole camera (never opened in earnest here)."""
    folder = tmp_path / "attic"
    folder.mkdir()
    (folder / "left.png").write_bytes(b"\x89PNG")
    (folder / "model.obj").write_text("mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wall\nf 1 2 3\nusemtl lamp \nf 1 2 3\r\n  usemtl light box\r\nf 1 2 3\n")
    (folder / "left.posed.cameramodel").write_text(CAMERA.format(lens="LENSMODEL_PINHOLE"))
    return folder


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
    assert scene.goals == ("materials.json", "rendered.png", "report.html") and scene.lamps == {} and scene.fact("transfer") == "gamma"


def test_everything_the_contract_shows_and_that_is_built(folder):
    (folder / "truth").mkdir()
    assert problems(folder, """
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
""") == []
    scene = scenes.read(folder, STAGES)
    assert scene.lamps == {"lamp": [1.0, 0, 1e6], "light box": "unknown"} and scene.fact("lamp_groups") == ["lamp", "light box"]
    assert scene.params == {"segment": {"lambda": 0.001, "passes": 0, "method": "admm", "fast": False}}
    assert scene.goals == ("materials.json", "rendered.png", "left.regions.png", "left.png")


@pytest.mark.parametrize("text, line", [
    ("bogus: 1", "bogus: 1 is an unknown key; known are board, lens, lamps, reference, transfer, surfaces, goals, augment, params"),
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
    ("lamps: {candle: [1, 1, 1]}", "lamps.candle: [1, 1, 1] names no group of model.obj, which has lamp, light box, wall"),
    ("reference: {wall: [1.2, 0, 0]}", "reference.wall: [1.2, 0, 0] is outside [0, 1]"),
    ("reference: {wall: unknown}", 'reference.wall: "unknown" is not a list of three numbers'),
    ("reference: {cat: [0, 0, 0]}", "reference.cat: [0, 0, 0] names no group of model.obj, which has lamp, light box, wall"),
    ("transfer: gama", 'transfer: "gama" is none of gamma, linear, srgb, curve, linear_per_group, histogram, histogram_per_group, {gamma: 2.2}'),
    ("transfer: {gamma: 0}", "transfer.gamma: 0 is not a positive number"),
    ("transfer: {gamma: .nan}", "transfer.gamma: NaN is not a positive number"),
    ("transfer: {}", "transfer.gamma: is missing"),
    ("transfer: {gamma: 2, x: 1}", "transfer.x: 1 is an unknown key; known is gamma"),
    ("transfer: curve", 'transfer: "curve" is not built yet'),
    ("surfaces: {wall: shiny}", 'surfaces.wall: "shiny" is none of diffuse, mirror, coloured_mirror, glossy, textured'),
    ("surfaces: {wall: velvet}", 'surfaces.wall: "velvet" is none of diffuse, mirror, coloured_mirror, glossy, textured'),
    ("goals: materials.json", 'goals: "materials.json" is not a list'),
    ("goals: [../other/left.png]", 'goals: "../other/left.png" lies outside the scene\'s folder'),
    ("goals: [/etc/passwd]", 'goals: "/etc/passwd" lies outside the scene\'s folder'),
    ("goals: [picture.png]", 'goals: "picture.png" is neither made by a stage nor given'),
    ("goals: [7]", "goals: 7 is not a file's name"),
    ("board: {corners: [9, 6]}", "board.square_m: is missing"),
    ("board: {corners: [9, 6.5], square_m: 0.03}", "board.corners: [9, 6.5] is not two whole numbers of at least 2"),
    ("board: {corners: [9, 6], square_m: 0}", "board.square_m: 0 is not a positive length in metres"),
    ("board: {corners: [9, 6], square_m: 0.03, colour: red}", 'board.colour: "red" is an unknown key; known are corners, square_m'),
    ("lens: OPENCV8", 'lens: "OPENCV8" is not a name of a mrcal lens model, LENSMODEL_...'),
    ("augment: [{name: teapot}]", 'augment: ["teapot"] is not built yet'),
    ("params: {blend: {x: 1}}", 'params.blend: {"x": 1} belongs to no stage; stages are segment, fit, render, report'),
    ("params: {segment: {lamda: 1}}", "params.segment.lamda: 1 is no number of segment, which has lambda, passes, method, fast"),
    ("params: {segment: {lambda: thick}}", 'params.segment.lambda: "thick" is neither a number nor `auto`'),
    ("params: {segment: {lambda: .inf}}", "params.segment.lambda: Infinity is not finite"),
    ("params: {segment: {passes: 1.5}}", "params.segment.passes: 1.5 is not a whole number"),
    ("params: {segment: {fast: 1}}", "params.segment.fast: 1 is neither true nor false"),
    ("params: {segment: 3}", "params.segment: 3 is not a mapping"),
    ("lamps: {lamp: [1, 1, 1}", "line 1: expected ',' or ']', but got '}'"),
    ("a: 1\n---\nb: 2", "line 2: but found another document"),
    (b"\xff\xfe", "not UTF-8: invalid start byte at byte 0"),
    ("lamps: !!python/object:os.system {}", "line 1: could not determine a constructor for the tag 'tag:yaml.org,2002:python/object:os.system'"),
])
def test_one_line_per_problem(folder, text, line):
    found = problems(folder, text)
    assert len(found) == 1 and found[0].startswith(line)


def test_all_problems_at_once(folder):
    found = problems(folder, "bogus: 1\nlamps: {lamp: [-1, 1, 1], candle: [1]}\ntransfer: 3\nreference: {wall: [2, 2, 2]}\naugment: [{camera: ../door.cameramodel}, {name: a, add: {file: no.obj}}, {name: a}]")
    assert [line.split(":")[0] for line in found] == ["bogus", "lamps.lamp", "lamps.candle", "transfer", "reference.wall",
                                                     "augment[0].name", "augment[0].camera", "augment[1].add.file", "augment[2].name", "augment"]


@pytest.mark.parametrize("text", ["&a [*a]", "[" * 5000, "? [1, 2]\n: 3", "a: &x {b: *x}", "<<: {lamps: 1}", "\t- x", "%YAML 9.9\n---\n{}", "a: 2020-01-01"])
def test_odd_yaml_is_one_line(folder, text):
    assert len(problems(folder, text)) == 1


def test_words_and_numbers_as_yaml_1_2_has_them(folder):
    """A group may be called `no` or `on`; 1e-3 is a number; 010 is ten and 1:30 a word."""
    (folder / "model.obj").write_text("usemtl no\nusemtl on\n")
    assert problems(folder, "lamps: {no: [1e-3, +1E2, .5], on: [010, 0, 0]}") == []
    assert scenes.read(folder, STAGES).lamps == {"no": [0.001, 100.0, 0.5], "on": [10, 0, 0]}
    assert problems(folder, "lamps: {no: [1:30, 1, 1]}") == ['lamps.no: ["1:30", 1, 1] is not a list of three numbers or `unknown`']


def test_two_photographs_or_two_models(folder):
    (folder / "left.tif").touch()
    (folder / "model.glb").touch()
    assert problems(folder, "") == [f"{folder}: left.png and left.tif: only one of them may be given", f"{folder}: model.obj and model.glb: only one of them may be given"]


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
        path.write_bytes(b"glTF" + (2).to_bytes(4, "little") + (20 + len(text)).to_bytes(4, "little") + len(text).to_bytes(4, "little") + b"JSON" + text)
        return path
    assert scenes.model_groups(glb({"materials": [{"name": "wall"}, {"name": "lamp"}]})) == {"wall", "lamp"}
    assert scenes.model_groups(glb({"materials": [{}]})) is None and scenes.model_groups(glb({})) is None
    (tmp_path / "model.glb").write_bytes(b"glTF")
    assert scenes.model_groups(tmp_path / "model.glb") is None


# ---- with the real pipeline: what is allowed but not built, what only matters for some goals, which camera a stage sees ----

def plan(folder, *wishes):
    """The real pipeline beside empty executables."""
    project = folder.parent / "project"
    (project / "stages").mkdir(parents=True, exist_ok=True)
    (project / "pipeline.yaml").write_text((ROOT / "pipeline.yaml").read_text())
    stages = planning.read_pipeline(project / "pipeline.yaml")
    for stage in stages.values():
        Path(stage.script).touch()
    return planning.walk(scenes.read(folder, stages), stages, folder.parent / "build", wishes or (None,))


def refusal(folder, text, *wishes):
    (folder / "scene.yaml").write_text(text)
    with pytest.raises(BadInput) as bad:
        plan(folder, *wishes)
    return [line.replace(f"{folder}/", "") for line in bad.value.problems]


def test_lamps_are_needed_when_a_goal_needs_photometry(folder):
    assert "scene.yaml: lamps: missing, and formfactors needs to know which groups emit" in refusal(folder, "goals: [formfactors.npz]")
    (folder / "scene.yaml").write_text("goals: [group.png]")
    assert plan(folder).planned == ["index", "compare"]


def test_what_is_left_out_and_why(folder):
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}")
    assert planning.explain(plan(folder)) == """attic: index -> formfactors -> gather -> fit -> coverage -> render -> compare -> report
  without calibrate: no goal needs it
  without undistort: no goal needs it
  without undistort_right: no goal needs it
  without orient: no goal needs it
  without segment: no goal needs it
  without match: no goal needs it
  without reconstruct: no goal needs it
  without recognise: its output is given (left.posed.cameramodel)
  without radiosity: no goal needs it
  without mirror buffers, lobes and textures: fit and render make them only where a group's error, or `surfaces`, demands it; never for groups named diffuse"""


SEE = ["segment", "match", "reconstruct", "recognise"]
BENT = ["undistort", "undistort_right"]
FIT = ["index", "formfactors", "gather", "fit", "compare"]


def cameras(folder, *names, lens="LENSMODEL_PINHOLE", apart=0.1):
    """Camera files of those names; those of the right photograph stand `apart` metres to the side."""
    for name in names:
        rt = f"[ 0., 0., 0., {-apart if 'right' in name else 0.}, 0., 0. ]"
        bent = ", 0." * {"LENSMODEL_OPENCV5": 5, "LENSMODEL_OPENCV8": 8}.get(lens, 0)
        (folder / f"{name}.cameramodel").write_text(CAMERA.format(lens=lens).replace("[ 0., 0., 0., 0., 0., 0. ]", rt).replace("1.5, 1.5 ]", f"1.5, 1.5{bent} ]"))


def chain(folder, text="lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]", *wishes):
    (folder / "scene.yaml").write_text(text)
    return plan(folder, *wishes).planned


def options(folder, stage):
    planned = plan(folder)
    argv, _ = planning.command(planned, planned.stages[stage], "python3")
    return {word[2:]: Path(value).name for word, value in zip(argv[2:], argv[3:]) if word.startswith("--")}


@pytest.fixture
def pair(folder):
    """A pair of unknown pose, with a model."""
    (folder / "left.posed.cameramodel").unlink()
    (folder / "right.png").write_bytes(b"\x89PNG")
    return folder


def test_a_pair_with_boards_runs_the_whole_chain(pair, monkeypatch):
    from lib import doctor
    monkeypatch.setitem(doctor.NEEDS, "mrcal", (lambda: True, "", None))
    (pair / "boards").mkdir()
    text = "board: {corners: [9, 6], square_m: 0.03}\nlamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]\n"
    assert chain(pair, text) == ["calibrate", *BENT, *SEE, *FIT]
    assert options(pair, "recognise")["camera-right"] == "right.pinhole.cameramodel" and options(pair, "index")["camera"] == "left.posed.cameramodel"
    assert options(pair, "segment")["photograph-right"] == "right.pinhole.png" and options(pair, "fit")["photograph"] == "left.pinhole.png"
    assert chain(pair, text + "lens: LENSMODEL_PINHOLE") == ["calibrate", *SEE, *FIT]
    assert options(pair, "match")["camera"] == "left.cameramodel" and options(pair, "index")["photograph"] == "left.png"
    assert refusal(pair, "lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]") == ["scene.yaml: board: missing, and calibrate needs to know the corners and squares of boards/"]


def test_a_pair_alone_has_its_lenses_and_its_relative_pose_estimated(pair):
    assert chain(pair) == ["calibrate", "orient", *SEE, *FIT]
    found = options(pair, "reconstruct")
    assert found["camera"] == "left.oriented.cameramodel" and found["orientation"] == "orientation.json"


def test_given_cameras_of_the_pair(pair):
    cameras(pair, "left", "right")
    assert chain(pair) == [*SEE, *FIT] and options(pair, "match")["camera-right"] == "right.cameramodel"
    cameras(pair, "left", "right", lens="LENSMODEL_OPENCV5")
    assert chain(pair) == [*BENT, *SEE, *FIT] and options(pair, "match")["camera-right"] == "right.pinhole.cameramodel"
    assert options(pair, "undistort_right")["lens-camera"] == "right.cameramodel"
    cameras(pair, "left", "right", apart=5e-10)
    assert chain(pair) == ["orient", *SEE, *FIT] and options(pair, "orient")["lens-camera"] == "left.cameramodel"
    cameras(pair, "left", "right", lens="LENSMODEL_OPENCV5", apart=0)
    assert chain(pair) == [*BENT, "orient", *SEE, *FIT] and options(pair, "orient")["lens-camera"] == "left.pinhole.cameramodel"
    assert options(pair, "recognise")["camera"] == "left.oriented.cameramodel"


def test_the_same_centre_behind_different_rotations(pair):
    """x_cam = R (x - c), whatever R: only the centres are compared."""
    import numpy as np
    from lib.cameras import matrix_from_rt
    rng = np.random.default_rng(0)
    centre = rng.normal(size=3)
    for name, shift in (("left", 0), ("right", 0), ("right", 1e-6)):
        r = rng.normal(size=3)
        t = -matrix_from_rt([*r, 0, 0, 0])[:3, :3] @ (centre + shift)
        (pair / f"{name}.cameramodel").write_text(CAMERA.format(lens="LENSMODEL_PINHOLE").replace("[ 0., 0., 0., 0., 0., 0. ]", str([*map(float, r), *map(float, t)])))
        np.testing.assert_allclose(scenes.centre_of(pair / f"{name}.cameramodel"), centre + shift, atol=1e-12)
        if name == "right":
            (pair / "scene.yaml").write_text("")
            assert scenes.unoriented(scenes.read(pair, STAGES)) == (shift == 0)


def test_one_camera_without_the_other(pair):
    cameras(pair, "left")
    assert refusal(pair, "goals: [facets.json]") == ["left.cameramodel: is given, but not that of the other photograph: give both, or none"]


def test_a_posed_photograph_with_a_lens_is_undistorted_and_keeps_its_pose(folder):
    cameras(folder, "left.posed", lens="LENSMODEL_OPENCV8")
    assert chain(folder) == ["undistort", *FIT]
    assert options(folder, "undistort")["lens-camera"] == "left.posed.cameramodel"
    assert options(folder, "index") | {"camera": "left.pinhole.cameramodel", "photograph": "left.pinhole.png"} == options(folder, "index")


def test_light_stays_light_when_it_is_undistorted(folder):
    (folder / "left.png").rename(folder / "left.exr")
    cameras(folder, "left.posed", lens="LENSMODEL_OPENCV8")
    assert chain(folder) == ["undistort", *FIT] and options(folder, "gather")["photograph"] == "left.pinhole.exr"


def test_one_photograph_alone_is_segmented(folder):
    assert chain(folder, "goals: [left.regions.png]") == ["segment", "compare"]
    assert "regions-right" not in options(folder, "segment")
    found = " ".join(refusal(folder, "goals: [matches.csv]"))
    assert "needs right.png or right.jpg or right.tif or right.exr, which is not in the scene's folder" in found


def test_vision_files_of_a_pair_whose_poses_are_given(folder):
    (folder / "right.png").write_bytes(b"\x89PNG")
    cameras(folder, "left.posed", "right.posed")
    assert chain(folder, "goals: [facets.json]") == ["segment", "match", "reconstruct", "compare"]
    assert options(folder, "match")["camera"] == "left.posed.cameramodel"


def spoil(folder, what):
    """One of the given files is not what it should be; returns what the one line must name."""
    photograph, model, camera = folder / "left.png", folder / "model.obj", folder / "left.posed.cameramodel"
    if what == "truncated":
        photograph.write_bytes(photograph.read_bytes()[:-20])
        return "left.png: truncated: "
    if what == "size":
        camera.write_text(camera.read_text().replace("[ 4, 4 ]", "[ 5, 4 ]"))
        return "left.png: size: 4 x 4 is not the camera's 5 x 4"
    if what == "nan":
        model.write_text(model.read_text().replace("v 1 0 0", "v 1 nan 0"))
        return "model.obj: line 3: vertex y = nan is not finite"
    if what == "index":
        model.write_text(model.read_text().replace("f 1 2 3", "f 1 2 4", 1))
        return "model.obj: line 6: face index 4 is out of range"
    if what == "camera":
        camera.write_text("{ 'lensmodel': ")
        return "left.posed.cameramodel: not a camera model"
    model.write_text(model.read_text().replace("usemtl lamp", "usemtl wall"))
    return "scene.yaml: lamps.lamp: [1, 1, 1] names no group of model.obj, which has light box, wall"


@pytest.mark.parametrize("what", ["truncated", "size", "nan", "index", "camera", "group"])
def test_bad_files_are_refused_before_anything_is_written(folder, refuses, run, what):
    import numpy as np
    from lib import image
    image.write_png8(folder / "left.png", np.full((4, 4, 3), 100))
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}")
    words = ["-m", "lib.plan", "--data", folder.parent, "--build", folder.parent / "build", f"{folder.name}/index"]
    line = spoil(folder, what)
    said, = refuses(*words)
    assert said.startswith(f"plan.py: {folder}/{line}") and not (folder.parent / "build").exists()


def test_good_files_are_opened_once(folder, run, monkeypatch):
    import numpy as np
    from lib import image
    image.write_png8(folder / "left.png", np.full((4, 4, 3), 100))
    (folder / "scene.yaml").write_text("lamps: {lamp: [1, 1, 1]}")
    planning.write(plan(folder), "python3", folder.parent / "project")
    monkeypatch.setattr(scenes, "inspect", None)
    planning.write(plan(folder), "python3", folder.parent / "project")


def test_a_missing_model(folder):
    (folder / "model.obj").unlink()
    found, = refusal(folder, "lamps: {lamp: [1, 1, 1]}\ngoals: [materials.json]")
    assert found.startswith("scene.yaml: goals: materials.json needs model.obj or model.glb, which is not in the scene's folder (stage ")


def test_the_contract_is_the_projects_own_copy():
    text = (ROOT / "data/SCENE.md").read_text()
    assert text.startswith("# The scene contract") and all(f"{key}:" in text for key in scenes.KEYS)


def test_every_file_between_stages_is_described():
    text = (ROOT / "data/SCENE.md").read_text() + (ROOT / "data/FORMATS.md").read_text()
    files = {file for stage in planning.read_pipeline(ROOT / "pipeline.yaml").values() for file in stage.writes.values()}
    assert [file for file in sorted(files) if file not in text and not file.startswith("<")] == []
