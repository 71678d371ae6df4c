"""Clocks, two makes at once, truncated artefacts, full disks.  python -m tests.bench.faults does it to real stages."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lib.core import artefact, stage
from lib.core.report import Report

DAY_S = 86_400


def later(path, seconds=DAY_S):
    when = time.time() + seconds
    os.utime(path, (when, when))


def test_a_photograph_from_the_future_makes_no_loop(toy):
    """It did: every make ran every stage."""
    later(toy.room / "left.png")
    status, ran, said = toy.make("room")
    assert status == 0 and "fit" in ran
    assert said.count("its time lies in the future") == 1 and "Clock skew" not in said
    assert toy.make("room")[:2] == (0, [])
    toy.give(**{"left.png": "another photo"})
    later(toy.room / "left.png", 2 * DAY_S)
    assert toy.make("room")[1][0] == "see", "another photograph is noticed, though its time lies in the future"


def test_scripts_from_the_future_make_no_loop(toy):
    later(toy.folder / "stages/see.py")
    assert toy.make("room")[0] == 0
    assert toy.make("room")[:2] == (0, [])


def test_a_given_goal_from_the_future_is_copied_once(toy):
    toy.give(**{"later.txt": "given"})
    toy.scene("goals: [later.txt]\nlamps: {lamp: [1, 1, 1]}")
    later(toy.room / "later.txt")
    assert toy.make("room")[0] == 0 and toy.read("later.txt") == "given"
    before = (toy.out / "later.txt").stat().st_mtime_ns
    assert toy.make("room")[0] == 0 and (toy.out / "later.txt").stat().st_mtime_ns == before


def test_a_clock_that_was_put_back_hides_no_edit(toy):
    """It did: what was built seemed newer than any edit."""
    assert toy.make("room")[0] == 0
    for path in toy.out.rglob("*"):
        later(path, DAY_S + path.stat().st_mtime - time.time())
    status, ran, said = toy.make("room")
    assert (status, ran) == (0, []) and said.count("lie in the future") == 1, said
    toy.give(**{"left.png": "another photo"})
    assert toy.make("room")[1][0] == "see" and "another photo" in toy.read("materials.json")


@pytest.mark.parametrize("name", ["regions.txt", "depth.txt", "materials.json", "fit.report.json", "see.report.json"])
def test_a_truncated_artefact_is_made_again(toy, name):
    assert toy.make("room")[0] == 0
    whole = {p: p.read_bytes() for p in toy.out.iterdir() if p.is_file() and p.suffix in (".txt", ".json")}
    (toy.out / name).write_bytes(whole[toy.out / name][:5])
    status, ran, said = toy.make("room")
    assert status == 0 and ran and name in said, said
    assert {p: p.read_bytes() for p in whole} == whole
    assert toy.make("room")[:2] == (0, []), "what depends on the stage's other files has run, too"


def test_a_file_that_was_removed_is_made_with_all_that_depends_on_it(toy):
    """Make made it again, and what depends on the other files of its stage at the next make only."""
    assert toy.make("room")[0] == 0
    (toy.out / "depth.txt").unlink()
    assert toy.make("room")[1][0] == "see"
    assert toy.make("room")[:2] == (0, [])


def test_two_makes_at_once_do_the_work_once(toy):
    assert toy.make("room/see")[0] == 0  # the folder of the lock is there
    words = ["make", f"PYTHON={sys.executable}", "room"]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k != "MFLAGS"}
    (toy.folder / "ran").unlink()
    both = [subprocess.Popen(words, cwd=toy.folder, stderr=subprocess.PIPE, text=True, env=environment) for _ in "ab"]
    said = [one.communicate(timeout=600)[1] for one in both]
    assert [one.returncode for one in both] == [0, 0], said
    ran = (toy.folder / "ran").read_text().split()
    assert sorted(ran) == sorted(set(ran)), ran


def raising(error):
    def main(opt):
        raise error

    return main


@pytest.mark.parametrize(
    "error, line",
    [
        (OSError(errno.ENOSPC, "No space left on device", "b/a.npz"), "b/a.npz: No space left on device"),
        (OSError(errno.EROFS, "Read-only file system", "b/a.npz"), "b/a.npz: Read-only file system"),
        (MemoryError(), "there is not enough memory"),
    ],
)
def test_what_the_machine_lacks_is_one_line_and_exit_1(error, line, capsys):
    with pytest.raises(SystemExit) as end:
        stage.run(raising(error), stage.parser("x"), [])
    said = capsys.readouterr().err
    assert end.value.code == 1 and line in said and said.endswith(": nothing of it was written\n")
    assert len(said.splitlines()) == 1


def test_a_full_disk_names_the_file(tmp_path):
    """The system says so of a write, and does not say of which file."""
    with pytest.raises(OSError) as full, artefact.writing(tmp_path / "a.json"):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert full.value.filename == str(tmp_path / "a.json") and not list(tmp_path.iterdir())


def test_a_report_knows_how_large_its_files_are(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out/a.txt").write_text("four")
    with Report(tmp_path / "a.report.json", outputs=[str(tmp_path / "out/a.txt"), str(tmp_path / "none.txt")]):
        pass
    assert artefact.read_json(tmp_path / "a.report.json")["output_bytes"] == {"out/a.txt": 4}


def test_an_interrupt_waits_for_the_end_of_an_import(tmp_path):
    """open3d makes an ImportError of one, as if it were missing."""
    lines = ["import os, signal", "os.kill(os.getpid(), signal.SIGINT)", "print('loaded')"]
    (tmp_path / "half_loaded.py").write_text("\n".join(lines))
    program = (
        "import sys, time; sys.path[:0] = [%r, %r]\n"
        "from lib.core import stage\n"
        "def main(opt):\n    import half_loaded\n    time.sleep(600)\n"
        "stage.run(main, stage.parser('x'))\n"
    )
    words = [sys.executable, "-c", program % (str(Path(stage.__file__).parents[2]), str(tmp_path))]
    run = subprocess.run(words, capture_output=True, text=True)
    assert run.returncode == 130 and run.stdout == "loaded\n" and "Traceback" not in run.stderr


def test_an_interrupt_that_a_library_makes_an_error_of_is_one_all_the_same(tmp_path):
    """numpy makes a TypeError of one that comes while it compares rows."""
    program = (
        "import os, signal\nfrom lib.core import stage\n"
        "def main(opt):\n"
        "    try:\n        os.kill(os.getpid(), signal.%s)\n"
        "    except BaseException:\n        raise TypeError('rows')\n"
        "stage.run(main, stage.parser('x'))\n"
    )
    for sign in ("SIGINT", "SIGTERM"):
        words = [sys.executable, "-c", program % sign]
        run = subprocess.run(words, capture_output=True, text=True, cwd=Path(stage.__file__).parents[2])
        assert run.returncode == 128 + getattr(signal, sign) and len(run.stderr.splitlines()) == 1


def test_a_plan_that_is_interrupted_says_one_line():
    root = Path(stage.__file__).parents[2]
    program = (
        "import os, runpy, signal, sys\n"
        "class Asked:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'lib.planning.walk': os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Asked())\n"
        "sys.argv[1:] = ['--show']\n"
        "runpy.run_module('lib.planning.plan', run_name='__main__')\n"
    )
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=root)
    assert run.returncode == 130 and run.stderr == "plan.py: interrupted: nothing of it was written\n"


def test_a_stop_while_an_object_is_freed_is_not_lost():
    """What is raised there Python prints and forgets: the stage went on to its end."""
    program = (
        "import argparse, os, signal, time, weakref\n"
        "from lib.core import stage\n"
        "def main(opt):\n"
        "    a = type('A', (), {})()\n"
        "    seen = weakref.ref(a, lambda _: (os.kill(os.getpid(), signal.SIGTERM), time.sleep(0.01)))\n"
        "    del a\n"
        "    time.sleep(60)\n"
        "stage.run(main, argparse.ArgumentParser(prog='fit.py'))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(stage.__file__).parents[2]
    )
    assert (ended.returncode, ended.stderr) == (143, "fit.py: terminated: nothing of it was written\n")


@pytest.mark.parametrize("calls", [100, 3_000, 30_000, 300_000])
def test_signals_without_end_are_told_once(calls):
    """While it imports, while kernels compile, while it says that it stops: two tracebacks came of a second signal.

    No clock: the signals begin with the n-th call of a Python function.
    """
    program = (
        "import argparse, os, sys\n"
        "from lib.core import stage\n"
        "def count(frame, event, _, left=[%d]):\n"
        "    left[0] -= event == 'call'\n"
        "    if left[0] == 0:\n"
        "        sys.setprofile(None)\n"
        "        os.write(1, b'now')\n"
        "def main(opt):\n"
        "    sys.setprofile(count)\n"
        "    from lib.core.compiled import numba\n"
        "    while True:\n"
        "        numba.njit(lambda x: 2 * x + 1)(1.0)\n"
        "stage.run(main, argparse.ArgumentParser(prog='fit.py'))\n"
    )
    words, root = [sys.executable, "-c", program % calls], Path(stage.__file__).parents[2]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=root) as child:
        assert child.stdout.read(3) == "now"
        while child.poll() is None:
            child.send_signal(signal.SIGTERM)
        said = child.stderr.read()
    assert (child.returncode, said) == (143, "fit.py: terminated: nothing of it was written\n")


def test_who_reads_no_more_ends_a_stage_in_silence():
    """`make plan | head`."""
    program = (
        "from lib.core import stage\n"
        "def main(opt):\n    while True: print('a line')\n"
        "stage.run(main, stage.parser('x'))\n"
    )
    root = Path(stage.__file__).parents[2]
    words = ["bash", "-c", '"$0" -c "$1" | head -1; exit ${PIPESTATUS[0]}', sys.executable, program]
    run = subprocess.run(words, capture_output=True, text=True, cwd=root)
    assert (run.returncode, run.stdout, run.stderr) == (141, "a line\n", "")
