"""What to do next: for each way a run ends, the first line names the key, the file or the command to use."""

import ast
import json
import re
from pathlib import Path

import pytest

from lib.planning import next_steps
from lib.planning.next_steps import State, steps

ROOT = Path(__file__).resolve().parents[1]
GROUPS = {
    "wall": {
        "kind": "diffuse",
        "identified": True,
        "pixels": 9000,
        "rho_d": [0.5] * 3,
        "sigma": {"rho_d": [0.005] * 3},
    },
    "door: left": {"kind": "mirror", "identified": True, "pixels": 99000, "rho_d": None},
    "floor": {"kind": "diffuse", "identified": False, "pixels": 0, "rho_d": None},
}


def state(status=None, **more):
    materials = {"status": status, "groups": GROUPS, "scale": "lamps"} if status else {}
    fields = {name: more.pop(name) for name in ("pose", "check", "reports") if name in more}
    return State("make attic", "build/attic", materials | more if status else more, **fields)


def why(cause, subject=None, text="it"):
    return {"cause": cause, "subject": subject, "text": text, "evidence_nats": 99.0}


def fit(**arguments):
    return {"fit": {"status": "x", "arguments": arguments}}


def test_a_scene_that_fits_is_exported_and_changed():
    assert steps(state("converged")) == [
        "Take it to Blender, Mitsuba, Radiance or USD: `make attic/export` writes `build/attic/exports/`.",
        "For a new picture write `augment: [{name: red, change: {wall: {rho_d: [0.6, 0.1, 0.1]}}}]` in scene.yaml, then"
        " `make attic`: `build/attic/augmented.red.png` (docs/augment.md has more).",
    ]
    assert steps(state("converged", reports={"export": {}, "augment.red": {}})) == []


def test_what_it_says_of_augment_is_taken(tmp_path):
    """The example is valid YAML of this program's own rules, for a group of any name."""
    from lib.core.yaml_file import read_yaml

    groups = {"wall: left": GROUPS["wall"]}
    (line,) = [line for line in steps(state("converged", groups=groups)) if "augment" in line]
    (tmp_path / "scene.yaml").write_text(re.search("`(augment: .*?)`", line)[1] + "\n")
    assert read_yaml(tmp_path / "scene.yaml")["augment"][0]["change"] == {"wall: left": {"rho_d": [0.6, 0.1, 0.1]}}


def test_a_scale_that_is_not_known_asks_for_a_reference():
    first = steps(state("converged", scale="convention"))[0]
    assert "`reference: {wall: [0.8, 0.8, 0.8]}`" in first and "one factor" in first
    loose = {"wall": GROUPS["wall"] | {"sigma": {"rho_d": [0.06] * 3}}}
    assert "to 12 % only" in steps(state("converged", scale="interreflection", groups=loose))[0]
    assert "reference" not in steps(state("converged", scale="interreflection"))[0]  # to 1 %
    told = fit(reference={"wall": [0.5] * 3})
    assert "reference" not in steps(state("converged", scale="convention", reports=told))[0]


WAYS = [
    (why("lamp_power", "lamp"), "`lamps: {lamp: unknown}`"),
    (why("lamp_flipped", "lamp"), "Flip"),
    (why("lamp_lobe", "lamp"), "lobe: unknown"),
    (why("transfer"), "`transfer: auto`"),
    (why("range"), "times 16"),
    (why("open_model"), "Draw the wall"),
    (why("object_missing"), "Draw what is missing"),
    (why("group_wrong", "wall", "reference.wall: 0.4 fits better"), "Correct `reference: {wall: ...}`"),
    (why("group_wrong", "wall", "object 'x' reflects 2 times"), "a material of its own"),
]


@pytest.mark.parametrize("cause, way", WAYS, ids=[cause["cause"] for cause, _ in WAYS])
def test_what_does_not_fit_has_its_way_out_first(cause, way):
    """Nothing of the geometry is suspected: the way out comes first, then the look at the edges."""
    said = steps(state("does not fit", why=[cause]))
    assert way in said[0] and "check.png" in said[1] and len(said) == 2, said


@pytest.mark.parametrize("cause", ["pose", "camera", "units", "up_axis", "objects", "lamp_place", "unknown"])
def test_where_the_geometry_is_suspected_check_png_is_named_first(cause):
    said = steps(state("does not fit", why=[why(cause, "chair")]))
    assert said[0].startswith("Look at `build/attic/check.png` (`make attic/check` draws it)") and len(said) == 2, said


def test_a_line_of_scene_yaml_that_the_cause_names_is_repeated():
    said = steps(state("does not fit", why=[why("units", None, "the model fits in cm: write model: {unit: cm}")]))
    assert said[1] == "Write `model: {unit: cm}` in scene.yaml."


def test_a_cause_that_explain_forbids_asks_for_leave():
    said = steps(state("does not fit", why=[why("principal_point")], reports=fit(explain=["curve"])))
    assert any("`explain` in scene.yaml name pose" in line for line in said), said


def causes_of_the_contract():
    """Every cause that stands in SCENE.md's list of `why`, or that the code gives to Why(...)."""
    found = set(re.findall(r'Why\(\s*"(\w+)"', "".join(p.read_text() for p in (ROOT / "lib/analysis").rglob("*.py"))))
    text = (ROOT / "data/SCENE.md").read_text()
    listed = re.search(r"causes as above or (.*?)\.", text)[1]
    return found | set(re.findall(r"`(\w+)`", listed))


def test_every_cause_has_a_way_out():
    from lib.given.causes import BUILT

    missing = {
        cause for cause in {*causes_of_the_contract(), *BUILT} if not steps(state("does not fit", why=[why(cause)]))[1:]
    }
    assert not missing


def test_not_converged_says_which_number_to_raise():
    report = {"fit": {"status": "not converged", "arguments": {"max_iterations": 40}}}
    assert "`params: {fit: {max_iterations: 80}}`" in steps(state("not converged", reports=report))[0]
    report = {"render": {"status": "not converged", "arguments": {"rays": 256}, "warnings": ["group 'a' is darker"]}}
    assert "`params: {render: {rays: 1024}}`" in steps(state("converged", reports=report))[0]
    report = {"fit": {"status": "not converged", "warnings": ["the light balance is solved to 1e-2 of its light only"]}}
    assert "reference: {wall:" in steps(state("not converged", reports=report))[0]
    noisy = {"augment.night": {"status": "complete", "noisy": ["wall"], "arguments": {"rays": 256}}}
    assert "`params: {augment: {rays: 1024}}`" in steps(state("converged", reports=noisy))[0]


def params_named(text):
    return re.findall(r"params: \{(\w+): \{(\w+): ", text)


def test_the_numbers_that_it_raises_are_numbers_of_their_stages():
    from lib.planning.pipeline import read_pipeline

    stages = read_pipeline(ROOT / "pipeline.yaml")
    reports = {name: {"status": "not converged", "arguments": {"rays": 9}} for name in ("fit", "render", "radiosity")}
    said = [line for name, one in reports.items() for line in steps(state("not converged", reports={name: one}))]
    said += steps(state("converged", reports={"augment.a": {"noisy": ["x"]}}))
    said += steps(state("nothing seen", reports={"gather": {"status": "nothing seen"}}))
    named = params_named(" ".join(said))
    assert {"fit", "render", "radiosity", "augment", "index"} == {stage for stage, _ in named}
    assert not [(stage, name) for stage, name in named if name not in stages[stage].params]


def test_nothing_seen_looks_at_check_png_first():
    said = steps(state("nothing seen", reports={"index": {"status": "nothing seen"}}))
    assert "check.png" in said[0] and "`model: {up: y}`" in said[1]
    said = steps(state("nothing seen", reports={"gather": {"status": "nothing seen"}}))
    assert "check.png" in said[0] and "margin_px" in said[1]


def test_an_ambiguous_pose_asks_for_corners_before_anything_else():
    said = steps(state("converged", pose={"status": "ambiguous"}, reports={"recognise": {}}))
    assert "eight or more corners" in said[0] and "`pose.csv`" in said[0] and not any("export" in line for line in said)
    assert "more corners, in other depths," in steps(state(pose={"status": "ambiguous"}, reports={"pose": {}}))[0]


def test_after_check_its_picture_comes_first():
    doubts = {"findings": [{"about": "units", "text": "x", "doubt": True}, {"about": "camera", "text": "y"}]}
    said = steps(state(check=doubts))
    assert said[0].startswith("Look at `build/attic/check.png`:")
    assert "1 doubt)" in said[1] and "`make attic`" in said[2]
    assert len(steps(state(check={"findings": []}))) == 2


def test_geometry_alone_says_how_to_go_on():
    assert "lamps: {lamp: unknown}" in steps(state(pose={"status": "unique"}, reports={"recognise": {}}))[0]
    assert "model.obj" in steps(state(reports={"reconstruct": {"status": "complete"}}))[0]
    assert "left.cameramodel" in steps(state(reports={"calibrate": {"status": "complete"}}))[0]
    assert "pose.csv" in steps(state(reports={"match": {"status": "nothing matched"}}))[0]


def test_at_most_three_lines_and_each_a_sentence():
    many = [why(cause, "lamp") for cause in next_steps.WAYS]
    said = steps(state("does not fit", why=many, pose={"status": "ambiguous"}))
    assert len(said) == 3 and all(line.endswith((".", ").")) and line.count("`") % 2 == 0 for line in said)


def test_two_things_that_are_missing_are_one_line():
    said = steps(state("approximate", why=[why("object_missing"), why("object_missing")]))
    assert len(said) == len(set(said)) and sum("missing" in line for line in said) == 1


@pytest.mark.parametrize("broken", [None, 3, [], "x", {"why": "x", "groups": [1], "status": ["x"]}])
def test_files_of_others_may_hold_anything(tmp_path, broken):
    for name in ("materials.json", "pose.json", "check.json", "fit.report.json", "check.report.json"):
        (tmp_path / name).write_text(json.dumps(broken))
    assert steps(next_steps.read(tmp_path, "attic")) is not None


def test_it_is_read_from_the_folder_with_the_command_of_the_plan(tmp_path):
    (tmp_path / "plan.mk").write_text("# Written\n# again: make DATA=/x attic\n\nrest\n")
    (tmp_path / "materials.json").write_text(json.dumps({"status": "converged", "groups": GROUPS}))
    (tmp_path / "fit.report.json").write_text('{"status": "converged"}')
    found = next_steps.read(tmp_path, "attic/fit", ["fit"])
    assert found.make == "make DATA=/x attic" and found.status == "converged"
    assert next_steps.read(tmp_path, "attic", ["check"]).status is None  # what another run left behind


def test_terminal_and_page_say_the_same():
    """Both ask this module, and neither has lines of its own."""
    for path in ("lib/planning/progress.py", "lib/verdict/page/parts.py"):
        calls = [n.func for n in ast.walk(ast.parse((ROOT / path).read_text())) if isinstance(n, ast.Call)]
        assert "steps" in {c.attr for c in calls if isinstance(c, ast.Attribute)}, path
