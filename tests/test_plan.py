"""The machinery, on a toy pipeline of stub stages: what runs, what is left out, what an edit reruns, what a kill leaves."""
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from lib import plan as planning, scene as scenes
from lib.stage import BadInput

PIPELINE = """
see:    {reads: {photograph: left.png|jpg}, writes: {regions: regions.txt, depth: depth.txt}, params: {lambda: 0.5, wrong: 0}}
pose:   {reads: {regions: regions.txt}, writes: {camera: camera.txt}}
mask:   {reads: {camera: camera.txt}, writes: {mask: mask.txt}}
fit:    {reads: {camera: camera.txt, photograph: left.png|jpg}, may_read: {depth: depth.txt, mask: mask.txt}, facts: {lamps: lamps}, writes: {materials: materials.json, trace: trace.txt}, params: {method: newton}}
later:  {reads: {materials: materials.json}, writes: {later: later.txt}}
compare: {may_read: {reports: "*.report.json", materials: materials.json, truth: truth/}, facts: {scene: scene}, writes: {scorecard: scorecard.csv}}
"""
STUB = '''
import json, os, signal, sys
sys.path[:0] = [{root!r}, {toy!r}]
from lib import artefact
from toy import {module}
def main(argv):
    options, key = {{}}, None
    for word in argv:
        if word.startswith("--"): key = word[2:]; options[key] = []
        else: options[key].append(word)
    with open({toy!r} + "/ran", "a") as log: log.write({name!r} + "\\n")
    writes = {writes!r}
    text = {name!r} + "(" + ", ".join(open(p).read().strip() for k, v in options.items() if k not in writes and k != "report" for p in v if os.path.isfile(p)) + ")"
    if os.path.exists({toy!r} + "/refuse-" + {name!r}): print({name!r} + ".py: left.png: size: 0 is nothing", file=sys.stderr); sys.exit(2)
    with artefact.writing_all(*(options[k][0] for k in writes)) as partials:
        for p in partials:
            open(p, "w").write(text)
            if os.path.exists({toy!r} + "/kill-" + {name!r}): os.kill(os.getpid(), signal.SIGKILL)
    artefact.write_json(options["report"][0], {{"status": "converged", "argv": argv}})
main(sys.argv[1:])
'''
ROOT = Path(__file__).resolve().parents[1]


class Toy:
    """A project of its own in a folder: the real Makefile and lib/, a pipeline of stubs, one scene `room`."""

    def __init__(self, folder, run):
        self.folder, self.run, self.room, self.out = folder, run, folder / "data/room", folder / "build/room"
        for name in ("Makefile", "lib", "requirements.lock"):
            (folder / name).symlink_to(ROOT / name)
        for name in (".venv", "stages", "toy", "data/room"):
            (folder / name).mkdir(parents=True)
        (folder / ".venv/ready").touch()
        (folder / "pipeline.yaml").write_text(PIPELINE)
        for name, stage in planning.read_pipeline(folder / "pipeline.yaml").items():
            (folder / f"toy/{name}.py").write_text("from toy import common\n")
            (folder / f"stages/{name}.py").write_text(STUB.format(root=str(ROOT), toy=str(folder), name=name, module=name, writes=list(stage.writes)))
        (folder / "toy/common.py").touch()
        self.give(**{"left.png": "photo"})
        self.scene("goals: [materials.json]\nlamps: {lamp: [1, 1, 1]}")

    def give(self, **files):
        for name, text in files.items():
            path = self.room / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)

    def scene(self, text):
        (self.room / "scene.yaml").write_text(text)

    def make(self, *words):
        """Exit status, the stages that ran in their order, and what was said."""
        (self.folder / "ran").unlink(missing_ok=True)
        result = self.run("make", f"PYTHON={sys.executable}", *words, cwd=self.folder)
        ran = (self.folder / "ran").read_text().split() if (self.folder / "ran").exists() else []
        return result.returncode, ran, result.stdout + result.stderr

    def plan(self, *wishes):
        stages = planning.read_pipeline(self.folder / "pipeline.yaml")
        return planning.walk(scenes.read(self.room, stages), stages, self.folder / "build", wishes or (None,))

    def read(self, name):
        return (self.out / name).read_text()


@pytest.fixture
def toy(tmp_path, run):
    return Toy(tmp_path, run)


def newer(path, text):
    """Edit a file so that Make cannot miss it, however coarse the clock."""
    path.write_text(text)
    os.utime(path, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns + 50_000_000))


# ---- the three rules ----

def test_what_no_goal_needs_is_left_out(toy):
    assert toy.plan().planned == ["see", "pose", "fit", "compare"]
    assert planning.explain(toy.plan()) == """room: see -> pose -> fit -> compare
  without mask: no goal needs it
  without later: no goal needs it"""


def test_what_waits_for_an_error_is_said_where_reflectances_are_fitted(toy):
    """One line, for the stages of the plan that would make it; none where nothing is fitted."""
    (toy.folder / "pipeline.yaml").write_text(PIPELINE.replace("facts: {lamps: lamps}", "facts: {lamps: lamps, surfaces: surfaces}").replace("later", "render"))
    (toy.folder / "stages/render.py").touch()
    line = ("  without mirror buffers, lobes and textures: {} them only where a group's error, or `surfaces`, demands it; never for groups named diffuse")
    assert planning.explain(toy.plan()).splitlines()[-1] == line.format("fit makes")
    toy.scene("goals: [render.txt]\nlamps: {lamp: [1, 1, 1]}")
    assert planning.explain(toy.plan()).splitlines()[-1] == line.format("fit and render make")
    assert "mirror" not in planning.explain(toy.plan("see"))
    toy.give(**{"materials.json": "found"})
    assert "mirror" not in planning.explain(toy.plan())


def test_what_is_given_is_not_made(toy):
    toy.give(**{"camera.txt": "known"})
    assert planning.explain(toy.plan()) == """room: fit -> compare
  without see: no goal needs it
  without pose: its output is given (camera.txt)
  without mask: no goal needs it
  without later: no goal needs it"""
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["fit", "compare"]), said
    assert toy.read("materials.json") == "fit(known, photo)"


def test_may_read_is_passed_when_there_and_pulls_nothing_in(toy):
    toy.make("room")
    assert toy.read("materials.json") == "fit(pose(see(photo)), photo, see(photo))"       # see runs for its regions: its depth is there too
    toy.give(**{"camera.txt": "known", "mask.txt": "masked"})
    toy.make("room")
    assert toy.read("materials.json") == "fit(known, photo, masked)"


def test_a_goal_that_is_given_is_copied(toy):
    toy.give(**{"materials.json": "found"})
    status, ran, said = toy.make("room")
    assert (status, ran, toy.read("materials.json")) == (0, ["compare"], "found"), said
    assert "copied: materials.json is given" in planning.explain(toy.plan())
    assert toy.make("room")[1] == []


def test_a_stage_never_overwrites_what_is_given(toy):
    """Half of what `see` and `fit` write is given: they run for the other half, and readers get what is given."""
    toy.give(**{"depth.txt": "measured", "trace.txt": "mine"})
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert toy.read("materials.json") == "fit(pose(see(photo)), photo, measured)"
    assert not (toy.out / "depth.txt").exists() and not list(toy.out.glob("scratch/**/*.txt"))
    assert (toy.room / "depth.txt").read_text() == "measured"
    assert "see leaves depth.txt as it is given" in planning.explain(toy.plan())
    assert toy.make("room")[1] == []


def test_asking_for_a_vision_file_runs_its_stages_though_the_pose_is_given(toy):
    toy.give(**{"camera.txt": "known"})
    toy.scene("goals: [materials.json, regions.txt]\nlamps: {lamp: [1, 1, 1]}")
    assert toy.plan().planned == ["see", "fit", "compare"]


def test_up_to_one_stage(toy):
    status, ran, said = toy.make("room/pose")
    assert (status, ran) == (0, ["see", "pose"]), said
    assert not (toy.out / "scorecard.csv").exists()
    assert toy.make("room")[1] == ["fit", "compare"]
    assert toy.make("room/fit")[1] == toy.make("room/compare")[1] == toy.make("room", "room/see")[1] == []      # the same command lines


def test_up_to_a_stage_that_must_read_nothing(toy):
    """All that `compare` reads is optional: it still gets what the scene's goals have made, and nothing else."""
    assert toy.make("room/compare")[1] == ["see", "pose", "fit", "compare"]
    assert toy.make("room")[1] == []
    assert toy.make("room/later")[1] == ["later"]


def test_truth_reaches_the_comparison_alone(toy):
    toy.give(**{"truth/materials.json": "true"})
    toy.make("room")
    assert "truth" not in toy.read("fit.report.json") and '"data/room/truth/"' in toy.read("compare.report.json")
    assert "--scene room" in " ".join(json.loads(toy.read("compare.report.json"))["argv"])
    newer(toy.room / "truth/materials.json", "truer")
    assert toy.make("room")[1] == ["compare"]


# ---- what reruns ----

def test_a_second_make_does_nothing(toy):
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert said.strip().splitlines()[-1] == "room: build/room/materials.json build/room/scorecard.csv"
    status, ran, said = toy.make("room")
    assert (status, ran, said) == (0, [], "room: build/room/materials.json build/room/scorecard.csv\n")


def test_an_edit_reruns_what_it_touches_and_no_more(toy):
    toy.make("room")
    newer(toy.folder / "toy/pose.py", "from toy import common  # edited\n")
    assert toy.make("room")[1] == ["pose", "fit", "compare"]
    newer(toy.folder / "toy/compare.py", "from toy import common  # edited\n")
    assert toy.make("room")[1] == ["compare"]
    newer(toy.folder / "toy/common.py", "# edited\n")
    assert toy.make("room")[1] == ["see", "pose", "fit", "compare"]
    newer(toy.folder / "toy/later.py", "from toy import common  # edited\n")
    assert toy.make("room")[1] == []


def test_a_fact_and_a_number_rerun_the_stage_that_takes_them(toy):
    toy.make("room")
    toy.scene("goals: [materials.json]\nlamps: {lamp: [2, 2, 2]}")
    assert toy.make("room")[1] == ["fit", "compare"]
    toy.scene("goals: [materials.json]\nlamps: {lamp: [2, 2, 2]}   # the same, said otherwise\nparams: {fit: {method: newton}}")
    assert toy.make("room")[1] == []
    toy.scene("goals: [materials.json]\nlamps: {lamp: [2, 2, 2]}\nparams: {see: {lambda: 1e-3}}")
    assert toy.make("room")[1] == ["see", "pose", "fit", "compare"]
    assert "--lambda 0.001" in " ".join(json.loads(toy.read("see.report.json"))["argv"])


def test_an_older_photograph_in_the_place_of_the_first_is_noticed(toy):
    toy.make("room")
    toy.give(**{"left.png": "another"})
    os.utime(toy.room / "left.png", (1e9, 1e9))
    assert toy.make("room")[1] == ["see", "pose", "fit", "compare"]
    assert "another" in toy.read("materials.json")


def test_a_goal_given_and_taken_away_is_made_again(toy):
    toy.make("room")
    made = toy.read("materials.json")
    toy.give(**{"materials.json": "given"})
    toy.make("room")
    assert toy.read("materials.json") == "given"
    (toy.room / "materials.json").unlink()
    assert "fit" in toy.make("room")[1]
    assert toy.read("materials.json") == made


# ---- when it goes wrong ----

@pytest.mark.parametrize("name", ["see", "fit"])
def test_a_killed_stage_leaves_nothing_half_written(toy, name):
    (toy.folder / f"kill-{name}").touch()
    status, ran, said = toy.make("room")
    assert status != 0 and ran[-1] == name
    left = {p.name for p in toy.out.iterdir() if p.is_file() and ".partial-" not in p.name} - {"plan.mk"}
    stages = planning.read_pipeline(toy.folder / "pipeline.yaml")
    assert not left & set(stages[name].outputs)
    assert any(".partial-" in p.name for p in toy.out.iterdir())
    (toy.folder / f"kill-{name}").unlink()
    status, again, said = toy.make("room")
    assert status == 0 and again[0] == name, said
    assert not any(".partial-" in p.name for p in toy.out.iterdir())


def test_a_refusal_leaves_no_goal(toy):
    (toy.folder / "refuse-fit").touch()
    status, ran, said = toy.make("room")
    assert status == 2 and "fit.py: left.png: size: 0 is nothing" in said and "Traceback" not in said
    assert not (toy.out / "materials.json").exists() and not (toy.out / "scorecard.csv").exists()


def test_a_refusal_after_success_stands_at_the_next_make(toy):
    """The old answer belongs to the old input: Make must not call it up to date."""
    toy.make("room")
    newer(toy.room / "left.png", "broken")
    (toy.folder / "refuse-see").touch()
    assert toy.make("room")[0] == 2
    assert toy.make("room")[0] == 2


def test_side_by_side_and_what_would_run(toy):
    shutil.copytree(toy.room, toy.folder / "data/hall")
    status, ran, said = toy.make("-n", "room")
    assert (status, ran) == (0, []) and "stages/see.py" in said and not (toy.out / "materials.json").exists(), said
    status, ran, said = toy.make("-j2", "all")
    assert status == 0 and sorted(ran) == sorted(["see", "pose", "fit", "compare"] * 2), said
    assert toy.make("-j2", "all", "room/see", "room")[:2] == (0, [])


def test_other_folders(toy, tmp_path):
    where = tmp_path / "else where"
    shutil.copytree(toy.folder / "data", where / "scenes")
    status, ran, said = toy.make(f"DATA={where}/scenes", f"BUILD={where}/out", "room")
    assert status == 0 and len(ran) == 4 and (where / "out/room/materials.json").exists(), said
    assert not toy.out.exists()


@pytest.mark.parametrize("wish, line", [
    ("attic", "data/attic: there is no such scene; data has room"),
    ("room/nothing", "room/nothing: there is no such stage; stages are see, pose, mask, fit, later, compare"),
    ("ro.om", "ro.om: is not a scene's name: letters, digits, _ and - only"),
])
def test_unknown_wishes_get_one_clear_line(toy, wish, line):
    status, ran, said = toy.make(wish)
    assert status == 2 and ran == [] and f"plan.py: {line}\n" in said and not (toy.folder / "build").exists()


def test_a_scene_cannot_bear_a_targets_name(toy):
    shutil.copytree(toy.room, toy.folder / "data/clean")
    with pytest.raises(BadInput, match="target of the Makefile"):
        planning.check_name(toy.folder / "data", "clean")


def test_outputs_do_not_go_into_the_scenes_folder(toy):
    status, ran, said = toy.make("BUILD=data", "room")
    assert status == 2 and "outputs would lie in the scene's folder" in said and not (toy.room / "plan.mk").exists()


def test_nothing_is_written_for_a_bad_scene(toy, files_under):
    toy.scene("goals: [materials.json]")
    before = files_under(toy.folder)
    status, ran, said = toy.make("room")
    assert status == 2 and "data/room/scene.yaml: lamps: missing, and fit needs to know which groups emit" in said
    assert files_under(toy.folder) == before and not (toy.folder / "build").exists()


def test_a_missing_input_names_file_goal_and_stage(toy):
    (toy.room / "left.png").unlink()
    assert toy.make("room")[2].splitlines()[0] == \
        "plan.py: data/room/scene.yaml: goals: materials.json needs left.png or left.jpg, which is not in the scene's folder (stage see)"


def test_a_stage_that_is_not_built_yet(toy):
    (toy.folder / "stages/pose.py").unlink()
    with pytest.raises(BadInput) as refusal:
        toy.plan()
    assert refusal.value.problems == (f"{toy.room}/scene.yaml: goals: materials.json needs camera.txt, which is not given: the stage pose is not built yet",)
    toy.give(**{"camera.txt": "known"})
    assert toy.plan().planned == ["fit", "compare"]


# ---- the pipeline itself ----

@pytest.mark.parametrize("text, problem", [
    ("a: {writes: {x: x.txt}, colour: red}", "a.colour: unknown key"),
    ("a: {writes: {x: x.txt}}\nb: {writes: {y: x.txt}}", "x.txt is written by a too"),
    ("a: {reads: {y: y.txt}, writes: {x: x.txt}}\nb: {writes: {y: y.txt}}", "which b writes only later"),
    ("a: {reads: {x: y.txt}, writes: {x: x.txt}}", "option x stands there twice"),
    ("a: {writes: {x: x.txt}, sweep: {n: [1, 2]}}", "a.sweep.n: no such parameter"),
    ("a: {writes: {x: x.txt}, facts: {n: nonsense}}", "nonsense is no fact"),
])
def test_a_pipeline_that_contradicts_itself(tmp_path, text, problem):
    (tmp_path / "pipeline.yaml").write_text(text)
    with pytest.raises(BadInput, match=problem):
        planning.read_pipeline(tmp_path / "pipeline.yaml")


def test_imports_are_followed_into_functions_and_packages(tmp_path):
    for name, text in {"stages/a.py": "def main():\n    from lib import deep, other as o\n    import numpy\n", "lib/__init__.py": "",
                       "lib/deep.py": "from . import deeper\nfrom .pack.one import x\n", "lib/deeper.py": "import lib.deep\n", "lib/other.py": "",
                       "lib/pack/__init__.py": "", "lib/pack/one.py": "x = 1\n", "lib/unused.py": ""}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = [str(p.relative_to(tmp_path)) for p in planning.imports(tmp_path / "stages/a.py", tmp_path)]
    assert found == ["lib/__init__.py", "lib/deep.py", "lib/deeper.py", "lib/other.py", "lib/pack/__init__.py", "lib/pack/one.py"]


def built():
    return [name for name, stage in planning.read_pipeline(ROOT / "pipeline.yaml").items() if (ROOT / "stages" / f"{name}.py").is_file()]


@pytest.mark.parametrize("name", built())
def test_a_stage_takes_the_options_that_the_pipeline_gives_it(name, root):
    """--help needs nothing installed (-S: no site-packages), and names every option of pipeline.yaml."""
    stage = planning.read_pipeline(root / "pipeline.yaml")[name]
    text = subprocess.run([sys.executable, "-I", "-S", f"stages/{name}.py", "--help"], cwd=root, capture_output=True, text=True)
    assert text.returncode == 0, text.stderr
    words = set(text.stdout.replace(",", " ").replace("[", " ").replace("]", " ").split())
    options = {planning._option(o) for o in (*stage.reads, *stage.may_read, *stage.writes, *stage.facts, *stage.params, "report")}
    assert not options - words


@pytest.mark.parametrize("name", built())
def test_a_stage_is_executable_and_refuses_in_one_line(name, root, refuses):
    assert os.access(root / "stages" / f"{name}.py", os.X_OK)
    assert len(refuses(f"stages/{name}.py", "--no-such-option")) == 1


# ---- what the system must have ----

def test_what_is_missing_of_the_system(toy, monkeypatch, capsys):
    """A stage that cannot do without is refused with what to do; one with a way round is only warned about; others are not asked."""
    from lib import doctor
    monkeypatch.setitem(doctor.NEEDS, "mrcal", (lambda: False, "apt-get install mrcal", None))
    monkeypatch.setitem(doctor.NEEDS, "egl", (lambda: False, "apt-get install libegl1", "rays are cast instead"))
    (toy.folder / "pipeline.yaml").write_text(PIPELINE.replace("params: {lambda: 0.5, wrong: 0}", "needs: {mrcal: left.png, egl: , magic: boards/}"))
    with pytest.raises(BadInput) as refusal:
        toy.plan()
    assert refusal.value.problems == ("mrcal: not installed, and the stage see needs it: apt-get install mrcal",)
    assert capsys.readouterr().err == "plan.py: warning: see finds no egl: rays are cast instead (apt-get install libegl1)\n"
    toy.give(**{"camera.txt": "known"})
    assert toy.plan().planned == ["fit", "compare"] and capsys.readouterr().err == ""


def test_the_doctor_says_what_to_do():
    from lib import doctor
    for check in (doctor.check_python, doctor.check_make, doctor.check_mrcal, doctor.check_machine):
        for mark, what, remedy in check():
            assert mark in ("ok", "--", "!!") and what and (mark == "ok" or remedy)


def test_help_names_the_stages(run):
    said = run("make", "help").stdout
    assert "stages: calibrate undistort undistort_right orient segment match" in said and "make <scene>/<stage>" in said
