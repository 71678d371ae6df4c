"""What a run says meanwhile and at its end: one line for each stage, also without a terminal, and a last one."""

import json
import re
import signal
import subprocess
import sys
import time

import pytest

from lib.core import kernel_cache
from lib.planning import compiling, gallery, progress
from lib.planning.command import imports
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
    assert all(re.fullmatch(r"\[\d/4\] \w+  \d+ s, about \d+ s left", line) for line in lines)
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
    report(tmp_path, "fit", status="approximate", to=0.0412)
    assert "approximate, to about 4 %" in progress.summary(tmp_path, "office", "report.html", 0, ["fit"])
    report(tmp_path, "fit", status="does not fit")
    said = progress.summary(tmp_path, "attic", str(page), time.time() - 22, ["index", "fit", "render", "report"])
    assert said.startswith("attic: does not fit, 0.50 %,")
    report(tmp_path, "augment.gloss", noisy=["wall", "door"])
    said = progress.summary(tmp_path, "attic", str(page), time.time() - 22, ["augment.gloss"])
    assert said.startswith("attic: noise on wall, door, 0 warnings")
    report(tmp_path, "index", warnings=["a"], notes=["b"])
    assert ": 1 warning, 1 note, " in progress.summary(tmp_path, "attic", str(page), time.time(), ["index"])


def test_what_is_left_is_by_the_last_run(tmp_path):
    assert progress.seconds("fit", tmp_path / "fit.report.json") == sum(progress.TYPICAL["fit"])
    report(tmp_path, "fit", waited_s=91.5)
    assert progress.seconds("fit", tmp_path / "fit.report.json", 10**8) == 91.5
    report(tmp_path, "fit", waited_s=91.5, compile_wall_s=60.5)  # which the next run does not compile
    assert progress.seconds("fit", tmp_path / "fit.report.json") == 31
    larger = progress.seconds("render", tmp_path / "x", 24_000_000)
    assert larger > 20 * progress.seconds("render", tmp_path / "x")


def test_the_modules_of_the_table_are_there_and_their_stages_import_them(root):
    for name, modules in compiling.SECONDS.items():
        files = set(imports(root / f"stages/{name}.py", root))
        assert not [m for m in modules if compiling.path_of(m) not in files], name


def test_what_is_to_be_compiled_is_said_apart(monkeypatch, tmp_path):
    """A first run was said to take 67 s and took 416: nobody counted the kernels. Measured: 134 and 219 CPU s."""
    monkeypatch.setattr(compiling, "is_compiled", lambda module: False)
    office = ["index", "formfactors", "gather", "fit", "coverage", "render", "compare", "report"]
    stereo = ["calibrate", "undistort", "segment", "surfaces", "match", "reconstruct", "recognise", *office]
    assert 0.75 * 134 < sum(compiling.seconds(office).values()) < 1.25 * 134
    assert 0.75 * 219 < sum(compiling.seconds(stereo).values()) < 1.25 * 219
    assert compiling.words(120) == ", and 120 s of compiling the first time"
    assert "first time" in compiling.of_photometry()
    monkeypatch.setattr(compiling, "is_compiled", lambda module: module != "vision.surfaces")
    assert sum(compiling.seconds(stereo).values()) == compiling.SECONDS["surfaces"]["vision.surfaces"]
    assert compiling.of_photometry() == ""


def test_a_module_is_compiled_where_numba_left_an_index(monkeypatch, tmp_path):
    """A folder alone is made at the import; an edit of a constant in another module compiles it anew."""
    (tmp_path / "lib").mkdir()
    for name, text in {"a": "from lib.b_kernels import C\n", "b": "C = 1\n"}.items():
        (tmp_path / f"lib/{name}_kernels.py").write_text(text)
    monkeypatch.setattr(kernel_cache, "ROOT", tmp_path)
    kernel_cache.imported.cache_clear()
    try:
        folder = kernel_cache.folder(tmp_path / "lib/a_kernels.py")
        assert folder.parent == tmp_path / ".kernels" and not compiling.is_compiled("a")
        (folder / "a_kernels.f-3.py311.nbi").write_bytes(b"")
        assert compiling.is_compiled("a")
        (tmp_path / "lib/b_kernels.py").write_text("C = 2\n")
        assert not compiling.is_compiled("a")
    finally:
        kernel_cache.imported.cache_clear()


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
