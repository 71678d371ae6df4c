"""pipeline.yaml itself: what it may not say, what its stages take, what the system must have."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lib.core import stage
from lib.core.stage import BadInput
from lib.planning import doctor
from lib.planning.command import imports
from lib.planning.pipeline import read_pipeline
from tests.helpers import stages
from tests.helpers.toy_project import PIPELINE

ROOT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    "text, problem",
    [
        ("a: {writes: {x: x.txt}, colour: red}", "a.colour: unknown key"),
        ("a: {writes: {x: x.txt}}\nb: {writes: {y: x.txt}}", "x.txt is written by a too"),
        ("a: {reads: {y: y.txt}, writes: {x: x.txt}}\nb: {writes: {y: y.txt}}", "which b writes only later"),
        ("a: {reads: {x: y.txt}, writes: {x: x.txt}}", "option x stands there twice"),
        ("a: {writes: {x: x.txt}, sweep: {n: [1, 2]}}", "a.sweep.n: no such parameter"),
        ("a: {writes: {x: x.txt}, facts: {n: nonsense}}", "nonsense is no fact"),
        ("a: {writes: {x: x.txt}}\nb: {may_write: {y: x.txt}}", "x.txt is written by a too"),
        ("a: {may_write: {x: x.txt}, reads: {x: y.txt}}", "option x stands there twice"),
        ("a: {may_write: {x: x.txt}}\nb: {reads: {x: x.txt}}", "b.reads.x: a need not write x.txt: list it under"),
    ],
)
def test_a_pipeline_that_contradicts_itself(tmp_path, text, problem):
    (tmp_path / "pipeline.yaml").write_text(text)
    with pytest.raises(BadInput, match=problem):
        read_pipeline(tmp_path / "pipeline.yaml")


def test_who_reads_what_need_not_be_written_can_do_without_it():
    """A camera told in numbers has no pose.json: `compare`, after all else had run, ended at that."""
    pipeline = read_pipeline(ROOT / "pipeline.yaml").values()
    same = {"<camera pose>": ("pose.json", "pose.camera.json")}  # of scenes with movable objects, and of others
    files = {name for s in pipeline for file in s.may_write.values() for name in (file, *same.get(file, ()))}
    lacking = [
        (reader.name, option)
        for reader in pipeline
        for option, file in (reader.may_read | reader.reads).items()
        if file in files and option not in stages.module(reader.name).options().get_default("_may_lack")
    ]
    assert lacking == []


def test_imports_are_followed_into_functions_and_packages(tmp_path):
    for name, text in {
        "stages/a.py": "def main():\n    from lib import deep, other as o\n    import numpy\n",
        "lib/__init__.py": "",
        "lib/deep.py": "from . import deeper\nfrom .pack.one import x\n",
        "lib/deeper.py": "import lib.deep\n",
        "lib/other.py": "",
        "lib/pack/__init__.py": "",
        "lib/pack/one.py": "x = 1\n",
        "lib/unused.py": "",
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    found = [str(p.relative_to(tmp_path)) for p in imports(tmp_path / "stages/a.py", tmp_path)]
    assert found == [
        "lib/__init__.py",
        "lib/deep.py",
        "lib/deeper.py",
        "lib/other.py",
        "lib/pack/__init__.py",
        "lib/pack/one.py",
    ]


def built():
    return [
        name
        for name, stage in read_pipeline(ROOT / "pipeline.yaml").items()
        if (ROOT / "stages" / f"{name}.py").is_file()
    ]


@pytest.mark.parametrize("name", built())
def test_a_stage_takes_the_options_that_the_pipeline_gives_it(name, root):
    """--help needs nothing installed (-S: no site-packages), and names every option of pipeline.yaml."""
    entry = read_pipeline(root / "pipeline.yaml")[name]
    text = subprocess.run(
        [sys.executable, "-I", "-S", f"stages/{name}.py", "--help"], cwd=root, capture_output=True, text=True
    )
    assert text.returncode == 0, text.stderr
    words = set(text.stdout.replace(",", " ").replace("[", " ").replace("]", " ").split())
    options = {
        stage.option_of(o)
        for o in (*entry.reads, *entry.may_read, *entry.written, *entry.facts, *entry.params, "report")
    }
    assert not options - words


@pytest.mark.parametrize("name", built())
def test_a_stage_is_executable_and_refuses_in_one_line(name, root, run):
    """As a process of its own, and as tests call it."""
    assert os.access(root / "stages" / f"{name}.py", os.X_OK)
    alone, here = run(f"stages/{name}.py", "--no-such-option"), stages.call(name, "--no-such-option")
    assert alone.returncode == here.returncode == 2 and alone.stderr == here.stderr
    assert alone.stderr.count("\n") == 1 and "Traceback" not in alone.stderr


# ---- what the system must have ----


def test_what_is_missing_of_the_system(toy, monkeypatch, capsys):
    """A stage that cannot do without is refused with what to do.

    One with a way round is only warned about; stages that are not planned are not asked.
    """
    monkeypatch.setitem(doctor.NEEDS, "mrcal", (lambda: False, "apt-get install mrcal", None))
    monkeypatch.setitem(doctor.NEEDS, "egl", (lambda: False, "apt-get install libegl1", "rays are cast instead"))
    (toy.folder / "pipeline.yaml").write_text(
        PIPELINE.replace("params: {lambda: 0.5, wrong: 0}", "needs: {mrcal: left.png, egl: , magic: boards/}")
    )
    with pytest.raises(BadInput) as refusal:
        toy.plan()
    assert refusal.value.problems == ("mrcal: not installed, and the stage see needs it: apt-get install mrcal",)
    assert (
        capsys.readouterr().err
        == "plan.py: warning: see finds no egl: rays are cast instead (apt-get install libegl1)\n"
    )
    toy.give(**{"camera.txt": "known"})
    assert toy.plan().planned == ["fit", "compare"] and capsys.readouterr().err == ""


def test_the_doctor_says_what_to_do():
    for check in (doctor.check_python, doctor.check_make, doctor.check_mrcal, doctor.check_machine):
        for mark, what, remedy in check():
            assert mark in ("ok", "--", "!!") and what and (mark == "ok" or remedy)


def test_help_names_the_stages(run):
    said = run("make", "help").stdout
    assert (
        "stages: units calibrate undistort undistort_right pose orient segment surfaces match" in said
        and "make <scene>/<stage>" in said
    )
