"""Bad input, whole-or-absent files, and the reports: from outside, by hand and at the edge."""

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from lib.core import artefact, stage
from lib.core.report import Report
from lib.core.stage import BadInput
from lib.verdict import stage_reports

STAGE = """
import argparse, os, signal, sys, time
sys.path.insert(0, {root!r})
from lib.core import artefact, stage
from lib.core.report import Note, Report
def main(opt):
    with Report(opt.report, inputs=[opt.model], arguments=vars(opt)) as report, artefact.writing(opt.out) as partial:
        open(partial, "w").write("half")
{body}
parser = argparse.ArgumentParser()
for name in ("model", "out", "report"): parser.add_argument("--" + name)
parser.add_argument("--lamps", type=stage.json_option)
if __name__ == "__main__": stage.run(main, parser)
"""


@pytest.fixture
def small(tmp_path, root):
    """small(body) -> a stage whose body is this, and the words that run it."""

    def write(body):
        (tmp_path / "small.py").write_text(
            STAGE.format(root=str(root), body="\n".join(" " * 8 + line for line in body.split("\n")))
        )
        (tmp_path / "m.obj").write_text("v 0 0 0\n")
        return [
            tmp_path / "small.py",
            "--model",
            tmp_path / "m.obj",
            "--out",
            tmp_path / "out/b.txt",
            "--report",
            tmp_path / "out/small.report.json",
        ]

    return write


def outputs(folder):
    return sorted(p.name for p in (folder / "out").glob("*")) if (folder / "out").exists() else []


def test_a_stage_that_ends_well(small, run, tmp_path):
    result = run(
        *small(
            "report.warning('two\\nlines'); report.warning('two lines')\n"
            "report.note('good to know'); report.about('a.obj', [Note('3 dropped'), 'mend it'])\n"
            "report.error('residual', 1e-9, unit='1', against='eq. 3.2'); report['energy'] = 3"
        )
    )
    assert result.returncode == 0 and result.stderr == (
        "small.py: warning: two lines\nsmall.py: note: good to know\n"
        "small.py: note: a.obj: 3 dropped\nsmall.py: warning: a.obj: mend it\n"
    ), result
    assert outputs(tmp_path) == ["b.txt", "small.report.json"]
    report = artefact.read_json(tmp_path / "out/small.report.json")
    assert {
        "status",
        "arguments",
        "versions",
        "inputs",
        "wall_s",
        "cpu_s",
        "peak_mb",
        "warnings",
        "notes",
        "errors",
        "trace",
    } <= report.keys()
    assert report["errors"] == [{"name": "residual", "value": 1e-9, "unit": "1", "against": "eq. 3.2"}]
    assert report["inputs"] == {str(tmp_path / "m.obj"): hashlib.sha256(b"v 0 0 0\n").hexdigest()}
    assert report["energy"] == 3 and report["warnings"] == ["two lines", "a.obj: mend it"] and report["peak_mb"] > 1
    assert report["notes"] == ["good to know", "a.obj: 3 dropped"]


def test_bad_input_is_one_line_per_problem_and_no_output(small, refuses, tmp_path):
    problems = "'m.json: group wall: rho_d = 1.2 is outside [0, 1]', 'm.json: group desk:\\nrho_d is missing'"
    words = small(f"raise stage.BadInput({problems})")
    assert refuses(*words) == [
        "small.py: m.json: group wall: rho_d = 1.2 is outside [0, 1]",
        "small.py: m.json: group desk: rho_d is missing",
    ]
    assert outputs(tmp_path) == []


def test_a_missing_file_is_bad_input(small, refuses, tmp_path):
    words = small("pass")
    (tmp_path / "m.obj").unlink()
    assert refuses(*words) == [f"small.py: {tmp_path}/m.obj: there is no such file"]
    words = small(f"open({str(tmp_path / 'n.obj')!r})")
    assert refuses(*words) == [f"small.py: {tmp_path}/n.obj: No such file or directory"]


def test_an_option_that_is_not_json_is_one_line(small, refuses):
    assert refuses(*small("pass"), "--lamps", "{lamp}") == [
        "small.py: argument --lamps: '{lamp}' is not JSON (--help lists the options)"
    ]
    assert len(refuses(*small("pass"), "--lamps", "[NaN]")) == 1


def test_a_bug_keeps_its_traceback_and_leaves_no_output(small, run, tmp_path):
    result = run(*small("1 / 0"))
    assert result.returncode == 1 and "ZeroDivisionError" in result.stderr
    assert outputs(tmp_path) == []


@pytest.mark.parametrize("number, left", [(signal.SIGTERM, []), (signal.SIGINT, []), (signal.SIGKILL, ["partial"])])
def test_a_signal_leaves_nothing_under_the_outputs_names(small, tmp_path, number, left):
    """SIGTERM and SIGINT clean up; SIGKILL leaves a temporary file, which the next run removes."""
    words = small("print('ready', flush=True); time.sleep(60)")
    process = subprocess.Popen(
        [sys.executable, *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # a shell may have it ignored
    assert process.stdout.readline() == b"ready\n"
    artefact.remove_partials(tmp_path / "out")  # of a stage that is running: stays
    assert len(outputs(tmp_path)) == 1
    process.send_signal(number)
    assert process.wait(600) != 0
    assert ["partial" for name in outputs(tmp_path) if ".partial-" in name] == left and not {
        "b.txt",
        "small.report.json",
    } & set(outputs(tmp_path))
    artefact.remove_partials(tmp_path / "out")
    assert outputs(tmp_path) == []


def test_several_outputs_appear_together(tmp_path):
    (tmp_path / "a.txt").write_text("old")
    with pytest.raises(KeyError), artefact.writing_all(tmp_path / "a.txt", tmp_path / "b.png") as (a, b):
        assert b.endswith(".png") and os.path.dirname(a) == str(tmp_path)
        Path(a).write_text("new")
        raise KeyError
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "old"}
    paths = tmp_path / "a.txt", tmp_path / "b.png"
    with pytest.raises(RuntimeError, match="b.png was promised"), artefact.writing_all(*paths) as (a, _):
        Path(a).write_text("new")
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"a.txt": "old"}


@pytest.mark.parametrize("value", [float("nan"), float("inf"), [1, {"x": -float("inf")}]])
def test_json_has_no_nan(tmp_path, value):
    with pytest.raises(ValueError):
        artefact.write_json(tmp_path / "a.json", {"value": value})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["{", "", "NaN", '{"a": Infinity}', '{"a": 1, "a": 2}', "[" * 100_000, "\xff"])
def test_json_that_cannot_be_read_is_one_line(tmp_path, text):
    (tmp_path / "a.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(BadInput) as refusal:
        artefact.read_json(tmp_path / "a.json")
    assert (
        len(refusal.value.problems) == 1
        and str(refusal.value).startswith(f"{tmp_path}/a.json: ")
        and "\n" not in str(refusal.value)
    )


def test_json_round_trip(tmp_path):
    import numpy as np

    value = {
        "rho": np.array([0.1, 0.2]),
        "n": np.int64(3),
        "names": ("a", "b [1,\n 2]"),
        "nested": [[1, 2], [3, 4]],
        "null": None,
        "umlaut": "ü",
    }
    artefact.write_json(tmp_path / "a.json", value)
    assert artefact.read_json(tmp_path / "a.json") == {
        "rho": [0.1, 0.2],
        "n": 3,
        "names": ["a", "b [1,\n 2]"],
        "nested": [[1, 2], [3, 4]],
        "null": None,
        "umlaut": "ü",
    }


def test_npz(tmp_path):
    import numpy as np

    artefact.write_npz(tmp_path / "a.npz", F=np.eye(2), names=np.array(["a", "b"]))
    assert artefact.read_npz(tmp_path / "a.npz", "F", "names")["names"][1] == "b"
    for path, keys, complaint in (
        (tmp_path / "a.npz", ["B"], "B: the array is missing"),
        (tmp_path / "b.npz", [], "there is no such file"),
    ):
        with pytest.raises(BadInput, match=complaint):
            artefact.read_npz(path, *keys)
    whole = (tmp_path / "a.npz").read_bytes()
    np.savez(tmp_path / "o.npz", x=np.array([{}], dtype=object))
    for name, content in (
        ("cut.npz", whole[: len(whole) // 2]),
        ("bent.npz", whole[:60] + b"\xff" * 40 + whole[100:]),
        ("empty.npz", b""),
        ("o.npz", (tmp_path / "o.npz").read_bytes()),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(BadInput, match=f"{name}: not a readable .npz file"):
            artefact.read_npz(tmp_path / name)


def busy(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_what_is_excluded_counts_nowhere_else(tmp_path):
    """work 0.05 + imports 0.1 + compile 0.1 (0.05 of it inside a nested `excluded`): cpu_s is the work alone."""
    began = time.process_time()
    with Report(tmp_path / "r.json") as report:
        with report.excluded("imports"):
            busy(0.1)
        with report.timing("solve"):
            busy(0.05)
            with report.excluded("compile"):
                busy(0.05)
                with report.excluded("imports"):
                    busy(0.05)
                report.trace(image_rms=0.5)
        report.trace(iteration=7, image_rms=0.25)
    all_s = time.process_time() - began
    r = artefact.read_json(tmp_path / "r.json")
    # each second counts once: what is excluded is in neither, whatever the machine spends on the report itself
    assert 0.045 < r["timings"]["solve"]["cpu_s"] <= r["cpu_s"] + 1e-6
    assert r["cpu_s"] + r["compile_s"] <= all_s - 0.1 + 1e-6  # of imports, which count from the interpreter's start
    assert r["imports_s"] >= 0.1 and r["compile_s"] > 0.095
    assert [t["iteration"] for t in r["trace"]] == [0, 7] and r["trace"][0]["cpu_s"] <= r["trace"][1]["cpu_s"] <= r[
        "cpu_s"
    ] + 1e-9
    assert r["wall_s"] >= 0.045


def test_what_loads_itself_is_listed_apart(run, tmp_path):
    """A kernel where it is first called, Open3D where it is first asked for: neither counts as the stage's work."""
    done = run(
        "-c",
        "import sys\n"
        "from lib.core import packages\n"
        "from lib.core.report import Report\n"
        "with Report(sys.argv[1]) as report:\n"
        "    from lib.core.compiled import numba\n"
        "    with report.timing('work'):\n"
        "        numba.njit(lambda x: 2 * x)(1.0)\n"
        "        packages.open3d()\n",
        tmp_path / "r.json",
    )
    assert done.returncode == 0, done.stderr
    r = artefact.read_json(tmp_path / "r.json")
    apart = r["compile_s"] + r["imports_s"]
    assert min(r["compile_s"], r["imports_s"]) > 0 and r["timings"]["work"]["cpu_s"] < 0.2 * apart


def test_child_processes_count(tmp_path):
    with Report(tmp_path / "r.json"):
        subprocess.run([sys.executable, "-S", "-c", "import time\nwhile time.process_time() < 0.15: pass"], check=True)
    assert artefact.read_json(tmp_path / "r.json")["cpu_s"] >= 0.14


def test_no_report_of_a_failure(tmp_path):
    for error in (BadInput("x: y: z"), ZeroDivisionError()):
        with pytest.raises(type(error)), Report(tmp_path / "r.json"):
            raise error
    assert list(tmp_path.iterdir()) == []


def test_a_bar_is_silent_where_nobody_looks(capfd):
    bar = stage.Bar("rays")
    bar.begin -= 10
    for share in (0.0, 0.5, 1.0):
        bar(share)
    assert capfd.readouterr() == ("", "")


def test_a_bar_shows_the_share_and_goes_away(capsys, monkeypatch):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    bar = stage.Bar("rays")
    bar.begin -= 10
    bar(0.5)
    bar(1)
    shown, gone = capsys.readouterr().err.split("\033[K")[:2]
    assert shown.strip().startswith("rays [###############") and "50 %, 10 s left" in shown and gone == "\r"


@pytest.mark.scene
def test_what_a_user_waits_is_all_listed(small, run, tmp_path):
    """What is counted and what is listed apart is the time on a clock beside the process, but for Python's own start.

    The best of three, for the machine may be busy; a bare start beside each tells how slow it is.
    """
    body = """
with report.excluded("imports"):
    import numpy, numba, scipy.optimize
with report.excluded("compile"):
    numba.njit(lambda x: x + 1)(1.0)
time.sleep(0.2)"""
    words, missing, starts = small(body), [], []
    for _ in range(3):
        begin = time.monotonic()
        assert run("-c", "import argparse, json, pathlib").returncode == 0
        starts.append(time.monotonic() - begin)
        begin = time.monotonic()
        assert run(*words).returncode == 0
        real = time.monotonic() - begin
        report = artefact.read_json(tmp_path / "out/small.report.json")
        listed = sum(value for key, value in report.items() if key.endswith("wall_s"))
        assert report["waited_s"] == pytest.approx(listed) and 0.2 <= report["wall_s"] <= real
        assert {"imports_wall_s", "compile_wall_s", "hashing_wall_s"} < report.keys()
        missing.append(real - report["waited_s"])
    assert -0.03 < min(missing) < 3 * max(starts), (missing, starts)


def test_a_stage_called_from_python_does_not_end_the_process():
    """Its own command line ends the process at once; a call with words returns."""
    called = []
    stage.run(called.append, stage.parser("x"), ["--report", "r.json"])
    assert called[0].report == "r.json"


def test_a_stage_that_ran_twice_took_the_time_of_both(tmp_path):
    (tmp_path / "draft").mkdir()
    content = {"status": "converged", "cpu_s": 3.0, "wall_s": 2.0, "imports_s": 0.5, "imports_wall_s": 0.25}
    for folder, refined in ((tmp_path / "draft", None), (tmp_path, "refined.glb")):
        said = content | {
            "status": "draft" if refined is None else "converged",
            "arguments": {"refined_model": refined},
        }
        (folder / "fit.report.json").write_text(json.dumps(said))
    report = stage_reports.read(tmp_path / "fit.report.json")
    assert (report.status, report.cpu_s, report.wall_s) == ("converged", 6.0, 4.0)
    assert report.apart["imports"] == (1.0, 0.5) and report.waited_s == 4.5
    (tmp_path / "fit.report.json").write_text(json.dumps(content | {"arguments": {"refined_model": None}}))
    assert stage_reports.read(tmp_path / "fit.report.json").cpu_s == 3.0  # taken over: it is the first run's own
    told = {"refined_model": str(tmp_path / "draft/refined.glb")}  # by the edges, before the first run
    (tmp_path / "fit.report.json").write_text(json.dumps(content | {"arguments": told}))
    assert stage_reports.read(tmp_path / "fit.report.json").cpu_s == 3.0
