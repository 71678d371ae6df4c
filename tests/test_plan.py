"""The machinery, on a toy pipeline of stub stages: what runs, what is left out, what an edit reruns."""

import collections
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from lib.core import stage
from lib.core.report import Report
from lib.core.stage import BadInput
from lib.planning.pipeline import read_pipeline
from lib.planning.plan import TARGETS, check_name, main, options
from lib.planning.walk import explain
from tests.helpers.toy_project import PIPELINE

ROOT = Path(__file__).resolve().parents[1]


def newer(path, text):
    """Edit a file so that Make cannot miss it, however coarse the clock."""
    path.write_text(text)
    os.utime(path, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns + 50_000_000))


# ---- the three rules ----


def timeless(said):
    """What was said, without the seconds that it took."""
    return re.sub(r", \d+ s: ", ": ", said)


def test_what_no_goal_needs_is_left_out(toy):
    assert toy.plan().planned == ["see", "pose", "fit", "compare"]
    assert (
        explain(toy.plan())
        == """room: see -> pose -> fit -> compare
  without mask: no goal needs it
  without later: no goal needs it"""
    )


def test_what_waits_for_an_error_is_said_where_reflectances_are_fitted(toy):
    """One line, for the stages of the plan that would make it; none where nothing is fitted."""
    (toy.folder / "pipeline.yaml").write_text(
        PIPELINE.replace("facts: {lamps: lamps}", "facts: {lamps: lamps, surfaces: surfaces}").replace(
            "later", "render"
        )
    )
    (toy.folder / "stages/render.py").touch()
    line = (
        "  without mirror buffers, lobes and textures: {} them only where a group's error, or `surfaces`, demands it; "
        "never for groups named diffuse"
    )
    assert explain(toy.plan()).splitlines()[-1] == line.format("fit makes")
    toy.scene("goals: [render.txt]\nlamps: {lamp: [1, 1, 1]}")
    assert explain(toy.plan()).splitlines()[-1] == line.format("fit and render make")
    assert "mirror" not in explain(toy.plan("see"))
    toy.give(**{"materials.json": '"found"'})
    assert "mirror" not in explain(toy.plan())


def test_what_is_given_is_not_made(toy):
    toy.give(**{"camera.txt": "known"})
    assert (
        explain(toy.plan())
        == """room: fit -> compare
  without see: no goal needs it
  without pose: its output is given (camera.txt)
  without mask: no goal needs it
  without later: no goal needs it"""
    )
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["fit", "compare"]), said
    assert toy.read("materials.json") == "fit(known, photo)"


def test_may_read_is_passed_when_there_and_pulls_nothing_in(toy):
    toy.make("room")
    assert (
        toy.read("materials.json") == "fit(pose(see(photo)), photo, see(photo))"
    )  # see runs for its regions: its depth is there too
    toy.give(**{"camera.txt": "known", "mask.txt": "masked"})
    toy.make("room")
    assert toy.read("materials.json") == "fit(known, photo, masked)"


def test_a_goal_that_is_given_is_copied(toy):
    toy.give(**{"materials.json": '"found"'})
    status, ran, said = toy.make("room")
    assert (status, ran, toy.read("materials.json")) == (0, ["compare"], '"found"'), said
    assert "copied: materials.json is given" in explain(toy.plan())
    assert toy.make("room")[1] == []


def test_a_stage_never_overwrites_what_is_given(toy):
    """Half of what `see` and `fit` write is given: they run for the other half, and readers get what is given."""
    toy.give(**{"depth.txt": "measured", "trace.txt": "mine"})
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert toy.read("materials.json") == "fit(pose(see(photo)), photo, measured)"
    assert not (toy.out / "depth.txt").exists() and not list(toy.out.glob("scratch/**/*.txt"))
    assert (toy.room / "depth.txt").read_text() == "measured"
    assert "see leaves depth.txt as it is given" in explain(toy.plan())
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
    assert (
        toy.make("room/fit")[1] == toy.make("room/compare")[1] == toy.make("room", "room/see")[1] == []
    )  # the same command lines


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
    newer(toy.room / "truth/materials.json", '"truer"')
    assert toy.make("room")[1] == ["compare"]


# ---- files that are written only where a scene has them ----

MIRRORED = PIPELINE.replace("regions.txt, depth: depth.txt}", "regions.txt}\n  may_write: {mirror: mirror.txt}")
MIRRORED = MIRRORED.replace("{depth: depth.txt, mask", "{mirror: mirror.txt, mask")


@pytest.fixture
def mirrored(toy):
    """`see` writes mirror.txt only where the folder `toy` says so, and `fit` may read it."""
    toy.pipeline(MIRRORED)
    return toy


def shows_a_mirror(toy, there):
    """The room's photograph changes, and there is a mirror in it or none."""
    flag = toy.folder / "has-mirror"
    flag.touch() if there else flag.unlink(missing_ok=True)
    newer(toy.room / "left.png", "mirror" if there else "photo")


def test_may_write_is_passed_on_where_it_was_written(mirrored):
    shows_a_mirror(mirrored, True)
    status, ran, said = mirrored.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert mirrored.read("mirror.txt") == "see(mirror)"
    assert mirrored.read("materials.json") == "fit(pose(see(mirror)), mirror, see(mirror))"
    assert mirrored.make("room")[1] == []


def test_may_write_is_named_though_nothing_was_written(mirrored):
    """The reader is told where the file would be; the run is complete without it, and a second make does nothing."""
    status, ran, said = mirrored.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert not (mirrored.out / "mirror.txt").exists() and "not written" not in said
    assert "--mirror build/room/mirror.txt" in " ".join(json.loads(mirrored.read("fit.report.json"))["argv"])
    assert mirrored.read("materials.json") == "fit(pose(see(photo)), photo)"
    assert mirrored.make("room")[1] == []


def test_a_stale_file_is_removed_before_its_stage_runs(mirrored):
    shows_a_mirror(mirrored, True)
    mirrored.make("room")
    shows_a_mirror(mirrored, False)
    assert mirrored.make("room")[1] == ["see", "pose", "fit", "compare"]
    assert not (mirrored.out / "mirror.txt").exists()
    assert mirrored.read("materials.json") == "fit(pose(see(photo)), photo)"


def test_a_goal_that_may_not_be_written(mirrored):
    """It plans its writer, and is met if the stage ended well; a line says that there is none."""
    mirrored.scene("goals: [mirror.txt]")
    assert mirrored.plan().planned == ["see", "compare"]
    status, ran, said = mirrored.make("room")
    assert (status, ran) == (0, ["see", "compare"]), said
    assert "\nmirror.txt: not written: the scene has none\n" in said
    assert timeless(said).splitlines()[-1] == "room: 0 warnings: build/room/scorecard.csv"
    status, ran, said = mirrored.make("room")
    assert (ran, timeless(said)) == (
        [],
        "mirror.txt: not written: the scene has none\nroom: 0 warnings: build/room/scorecard.csv\n",
    )
    shows_a_mirror(mirrored, True)
    status, ran, said = mirrored.make("room")
    assert status == 0 and ran == ["see", "compare"] and "not written" not in said and mirrored.read("mirror.txt")


def test_a_goal_whose_writer_fails_is_not_met(mirrored):
    mirrored.scene("goals: [mirror.txt]")
    shows_a_mirror(mirrored, True)
    (mirrored.folder / "kill-see").touch()
    status, ran, said = mirrored.make("room")
    assert status != 0 and ran == ["see"] and not (mirrored.out / "mirror.txt").exists(), said


def test_may_write_pulls_nothing_in(mirrored):
    """Its reader runs without it where no goal needs the writer."""
    mirrored.give(**{"camera.txt": "known"})
    status, ran, said = mirrored.make("room")
    assert (status, ran) == (0, ["fit", "compare"]), said
    assert "--mirror" not in mirrored.read("fit.report.json")


def test_a_given_file_of_that_name_is_passed_on(mirrored):
    """What the stage makes of it goes to a scratch folder; taken away, its place is the stage's again."""
    shows_a_mirror(mirrored, True)
    mirrored.give(**{"mirror.txt": "painted"})
    status, ran, said = mirrored.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert mirrored.read("materials.json") == "fit(pose(see(mirror)), mirror, painted)"
    assert not (mirrored.out / "mirror.txt").exists() and not list(mirrored.out.glob("scratch/**/*.txt"))
    assert "see leaves mirror.txt as it is given" in explain(mirrored.plan())
    (mirrored.room / "mirror.txt").unlink()
    assert mirrored.make("room")[1] == ["see", "pose", "fit", "compare"]
    assert mirrored.read("materials.json") == "fit(pose(see(mirror)), mirror, see(mirror))"


def test_a_given_goal_that_a_stage_may_write_is_copied(mirrored):
    mirrored.give(**{"mirror.txt": "painted"})
    mirrored.scene("goals: [mirror.txt]")
    status, ran, said = mirrored.make("room")
    assert (status, ran, mirrored.read("mirror.txt")) == (0, ["compare"], "painted"), said
    assert "copied: mirror.txt is given" in explain(mirrored.plan())


def test_a_stage_sees_none_where_the_file_was_not_written(tmp_path):
    """`stage.run` forgets the path of a file that its writer need not write; a mistyped path of another is refused."""
    seen = []
    parser = stage.parser("x", reads="model", may_read="depth", may_lack="mirror", may_write="made")
    words = ["--model", "m.obj", "--depth", "d.exr", "--mirror", str(tmp_path / "mirror.png"), "--made", "made.png"]
    stage.run(seen.append, parser, words)
    (tmp_path / "mirror.png").touch()
    stage.run(seen.append, parser, words)
    assert [opt.mirror for opt in seen] == [None, str(tmp_path / "mirror.png")]
    assert [stage.inputs(opt) for opt in seen] == [["m.obj", "d.exr"], ["m.obj", "d.exr", str(tmp_path / "mirror.png")]]
    with pytest.raises(BadInput, match=r"d\.exr: there is no such file"), Report.of(seen[0]):
        pass


# ---- what reruns ----


def test_a_second_make_does_nothing(toy):
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    assert timeless(said).splitlines()[-1] == "room: 0 warnings: build/room/materials.json build/room/scorecard.csv"
    status, ran, said = toy.make("room")
    line = "room: 0 warnings: build/room/materials.json build/room/scorecard.csv\n"
    assert (status, ran, timeless(said)) == (0, [], line)


@pytest.mark.scene
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
    same = "goals: [materials.json]\nlamps: {lamp: [2, 2, 2]}   # the same, said otherwise\n"
    toy.scene(same + "params: {fit: {method: newton}}")
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
    toy.give(**{"materials.json": '"given"'})
    toy.make("room")
    assert toy.read("materials.json") == '"given"'
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
    stages = read_pipeline(toy.folder / "pipeline.yaml")
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


@pytest.mark.parametrize(
    "wish, line",
    [
        ("attic", "data/attic: there is no such scene; data has room"),
        ("room/nothing", "room/nothing: there is no such stage; stages are see, pose, mask, fit, later, compare"),
        ("ro.om", "ro.om: is not a scene's name: letters, digits, _ and - only"),
    ],
)
def test_unknown_wishes_get_one_clear_line(toy, wish, line):
    status, ran, said = toy.make(wish)
    assert status == 2 and ran == [] and f"plan.py: {line}\n" in said and not (toy.folder / "build").exists()


def test_a_folder_that_make_cannot_name_stops_no_other_scene(toy):
    for name in ("a b", "x:y"):
        shutil.copytree(toy.room, toy.folder / "data" / name)
    status, ran, said = toy.make("room")
    assert (status, len(ran)) == (0, 4) and "data/x:y: warning: left out" in said and "data/a b: warning" in said


def test_a_scene_cannot_bear_a_targets_name(toy):
    shutil.copytree(toy.room, toy.folder / "data/clean")
    with pytest.raises(BadInput, match="target of the Makefile"):
        check_name(toy.folder / "data", "clean")


def test_every_target_of_the_makefile_is_known(root, refuses, tmp_path):
    """`make new-scene NAME=docs` made a scene that `make docs` could not name."""
    rules = set(re.findall(r"^([a-z][a-z-]*):(?!=)", (root / "Makefile").read_text(), re.M))
    assert {"docs", "lint", "demo", "setup"} <= rules and rules == set(TARGETS)
    words = ["--data", tmp_path, "--model", root / "data/office/model.obj", "--photo", root / "data/office/left.png"]
    for name in ("docs", "verify-long"):
        lines = refuses("stages/new_scene.py", "--name", name, *words)
        assert len(lines) == 1 and "no target of the Makefile" in lines[0]
    assert not list(tmp_path.iterdir())


def test_a_plan_looks_at_few_files(root, tmp_path, monkeypatch, capsys):
    """It asked thousands of times, for files that are not there too: 200 scenes took 19 CPU s."""
    looks = collections.Counter()
    real = os.stat
    monkeypatch.setattr(os, "stat", lambda *words, **options: looks.update(["stat"]) or real(*words, **options))
    counts = []
    for number in (1, 5):
        for k in range(number):
            (tmp_path / f"s{k}").exists() or (tmp_path / f"s{k}").symlink_to(root / "data/office")
        looks.clear()
        main(options().parse_args(["--show", "--data", str(tmp_path), "--pipeline", str(root / "pipeline.yaml")]))
        counts.append(looks["stat"])
    assert "s0, s1, s2, s3, s4" in capsys.readouterr().out
    assert (counts[1] - counts[0]) / 4 < 150, counts


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
    first = toy.make("room")[2].splitlines()[0]
    needed = "materials.json needs left.png or left.jpg, which is not in the scene's folder (stage see)"
    assert first == f"plan.py: data/room/scene.yaml: goals: {needed}"


def test_a_stage_that_is_not_built_yet(toy):
    (toy.folder / "stages/pose.py").unlink()
    with pytest.raises(BadInput) as refusal:
        toy.plan()
    assert refusal.value.problems == (
        f"{toy.room}/scene.yaml: goals: materials.json needs camera.txt, which is not given: "
        "the stage pose is not built yet",
    )
    toy.give(**{"camera.txt": "known"})
    assert toy.plan().planned == ["fit", "compare"]
