"""What a run says meanwhile and at its end: one line for each stage, also without a terminal, and a last one."""

import json
import re
import signal
import subprocess
import sys
import time

import pytest

from lib.planning import gallery, progress
from tests.helpers.html import Page


def test_a_line_for_each_stage_and_none_of_commands(toy):
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, ["see", "pose", "fit", "compare"]), said
    lines = [line for line in said.splitlines() if line.startswith("[")]
    assert [line.split()[:2] for line in lines] == [
        ["[1/4]", "see"],
        ["[2/4]", "pose"],
        ["[3/4]", "fit"],
        ["[4/4]", "compare"],
    ]
    assert all(re.fullmatch(r"\[\d/4\] \w+  \d+ s, about \d+ left", line) for line in lines)
    assert "--report" not in said
    assert "--report" in (toy.out / "commands/fit").read_text()
    assert re.fullmatch(r"room: 0 warnings, \d+ s: .*materials.json .*scorecard.csv", said.splitlines()[-1])


def test_the_second_make_does_nothing_and_says_how_it_stands(toy):
    toy.make("room")
    status, ran, said = toy.make("room")
    assert (status, ran, len(said.splitlines())) == (0, [], 1)


def test_command_lines_are_shown_on_demand(toy):
    assert "stages/fit.py" in toy.make("room", "V=1")[2]


def report(folder, name, **fields):
    (folder / f"{name}.report.json").write_text(json.dumps({"status": "complete", "warnings": []} | fields))


def test_the_last_line(tmp_path):
    for name in ("fit", "render", "report"):
        report(tmp_path, name)
    report(tmp_path, "index", warnings=["a", "b"])
    (tmp_path / "rendered.json").write_text('{"rmse": 0.00503}')
    (tmp_path / "materials.json").write_text('{"groups": {"wall": {"identified": true}, "cup": {"identified": false}}}')
    page = tmp_path / "report.html"
    said = progress.summary(tmp_path, "attic", str(page), time.time() - 22, ["index", "fit", "render", "report"])
    assert said == f"attic: 0.50 %, 1 of 2 materials, 2 warnings, 22 s: file://{page}"
    report(tmp_path, "fit", status="does not fit")
    said = progress.summary(tmp_path, "attic", str(page), time.time() - 22, ["index", "fit", "render", "report"])
    assert said.startswith("attic: does not fit, 0.50 %,")
    report(tmp_path, "augment.gloss", noisy=["wall", "door"])
    said = progress.summary(tmp_path, "attic", str(page), time.time() - 22, ["augment.gloss"])
    assert said.startswith("attic: noise on wall, door, 0 warnings")


def test_what_is_left_is_by_the_last_run(tmp_path):
    assert progress.seconds("fit", tmp_path / "fit.report.json") == sum(progress.TYPICAL["fit"])
    report(tmp_path, "fit", waited_s=91.5)
    assert progress.seconds("fit", tmp_path / "fit.report.json", 10**8) == 91.5
    larger = progress.seconds("render", tmp_path / "x", 24_000_000)
    assert larger > 20 * progress.seconds("render", tmp_path / "x")


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_stage_says_so_in_one_line(root, sign):
    """Both ended without a word, or in a traceback."""
    code = (
        "import time, argparse\nfrom lib.core import stage\n"
        "def main(opt):\n    print('on', flush=True); time.sleep(30)\n"
        "stage.run(main, argparse.ArgumentParser(prog='fit.py'))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=root,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell's background jobs ignore it
    )
    assert process.stdout.readline() == "on\n"
    process.send_signal(sign)
    _, said = process.communicate(timeout=600)
    assert process.returncode == 128 + sign
    assert len(said.splitlines()) == 1 and "nothing of it was written" in said


def test_the_overview_is_short_and_one_scene_is_told_in_full(toy):
    (toy.folder / "data/other").mkdir()
    (toy.folder / "data/other/scene.yaml").write_text("goals: [regions.txt]\n")
    (toy.folder / "data/other/left.png").write_text("photo")
    status, _, said = toy.make("plan")
    assert status == 0 and "see -> pose -> fit -> compare\n    room\n" in said and "see -> compare\n    other\n" in said
    assert "left out of all, for no goal needs it: mask, later" in said and "without" not in said
    status, _, said = toy.make("plan", "SCENE=room")
    assert status == 0 and "room: see -> pose -> fit -> compare" in said and "without mask: no goal needs it" in said
    assert "other" not in said


def test_a_gallery_of_all_scenes_with_a_page(tmp_path):
    """Badge, error, warnings, seconds and a picture of each; names are escaped, what is broken says nothing."""
    for name in ("attic", "a&b", "empty", "broken"):
        (tmp_path / name).mkdir()
    for name in ("attic", "a&b", "broken"):
        (tmp_path / name / "report.html").write_text("x")
    (tmp_path / "attic/materials.json").write_text('{"status": "does not fit"}')
    (tmp_path / "attic/rendered.json").write_text('{"rmse": 0.0123}')
    (tmp_path / "attic/rendered.png").write_bytes(b"")
    (tmp_path / "attic/fit.report.json").write_text('{"waited_s": 4.4, "warnings": ["x"]}')
    (tmp_path / "a&b/materials.json").write_text('{"status": "converged"}')
    (tmp_path / "broken/materials.json").write_text("{")
    gallery.write(tmp_path)
    found = Page((tmp_path / "index.html").read_text()).all("li")
    assert [card.text for card in found] == [
        "a&b converged 0 s",
        "attic does not fit 1.23 % off the photograph, 1 warning, 4 s",
        "broken complete 0 s",
    ]
    assert [card.one("a").attributes["href"] for card in found][1] == "attic/report.html"
    assert found[1].one("img").attributes["src"] == "attic/rendered.png" and found[1].one(kind="bad")
