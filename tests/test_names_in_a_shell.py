"""What is told on make's command line is text, whatever signs it holds; and what `make clean` may remove (case 37)."""

import os
import shutil
import subprocess
import sys

import pytest

from tests.conftest import ROOT

BASE = ROOT / "tests/data/cases/base"
RUNS = ("`touch {}`$(touch {})$(shell touch {})", "' ; touch {} ; '", '" ; touch {} ; "')


def make(*words, cwd=ROOT, **environment):
    """make in the project's own folder, as from a shell of a user's."""
    clean = {k: v for k, v in os.environ.items() if not k.startswith("MAKE") and k not in ("MFLAGS", "BUILD", "DATA")}
    return subprocess.run(
        ["make", *map(str, words)], cwd=cwd, env=clean | environment, capture_output=True, text=True, errors="replace"
    )


@pytest.mark.parametrize(
    "name",
    ["price $5.png", 'a"b.png', "a'b.png", "a #1 b.png", "a\\b.png", "x`id`.png", "x$(shell id).png", "-x;y&z.png"],
)
def test_a_photograph_of_any_name_is_read(tmp_path, name):
    shutil.copy(BASE / "room.png", tmp_path / name)
    told = {"MODEL": BASE / "room.obj", "CAMERA": BASE / "room.cameramodel", "PHOTO": tmp_path / name}
    done = make("new-scene", "NAME=x", f"DATA={tmp_path}/data", *(f"{k}={v}" for k, v in told.items()))
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "data/x/left.png").read_bytes() == (BASE / "room.png").read_bytes()


@pytest.mark.parametrize("text", RUNS)
@pytest.mark.parametrize(
    "variable", ["PHOTO", "MODEL", "CAMERA", "IMAGE", "PICKS", "NAME", "MEGAPIXELS", "SCENE", "ODD"]
)
def test_nothing_that_is_told_runs(tmp_path, variable, text):
    """On the command line and in the environment."""
    made = tmp_path / "made"
    told = {"NAME": "x", "MODEL": "none.obj", "PHOTO": "none.png", variable: "x" + text.replace("{}", str(made))}
    words = [f"{k}={v}" for k, v in told.items()]
    target = "plan" if variable == "SCENE" else "new-scene"
    for done in (make(target, f"DATA={tmp_path}", *words), make(target, f"DATA={tmp_path}", **told)):
        assert done.returncode == 2 and "Traceback" not in done.stderr, done
    assert not made.exists()


@pytest.mark.parametrize("text", RUNS)
@pytest.mark.parametrize("variable", ["DATA", "BUILD", "V"])
def test_no_folder_and_no_switch_runs(toy, tmp_path, variable, text):
    """The outputs go there, or it is said that Make cannot; a scene's own Make is asked, too."""
    text, python = "x" + text.replace("{}", "made"), f"PYTHON={sys.executable}"
    if variable == "DATA":
        shutil.move(toy.folder / "data", toy.folder / text)
    for done in (
        make("room", python, f"{variable}={text}", cwd=toy.folder),
        make("room", python, cwd=toy.folder, **{variable: text}),
        make("help", f"{variable}={text}", cwd=toy.folder),
        make("clean", f"{variable}={text}", cwd=toy.folder),
    ):
        assert "Traceback" not in done.stderr, done
        assert done.returncode == 0 or "Make cannot handle a file of this name" in done.stderr, done
    assert not list(tmp_path.rglob("made"))


@pytest.mark.parametrize("text", RUNS)
def test_no_goal_runs(toy, tmp_path, text):
    done = make("room" + text.replace("{}", "made"), cwd=toy.folder)
    assert done.returncode == 2 and "is not a scene or a target" in done.stderr, done
    assert not list(tmp_path.rglob("made"))


# ---- clean ----


def test_clean_removes_what_anasyn_made_and_says_what_stays(toy, files_under):
    """make BUILD=data clean and make BUILD=desk clean deleted whole folders."""
    assert toy.make("room")[0] == 0
    foreign = {
        "notes.txt": "mine",
        "photos/a.png": "mine",
        "other/plan.mk": "all: ; true\n",
        "index.html": "<h1>Mine</h1>",
    }
    for name, text in foreign.items():
        path = toy.folder / "build" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
    (toy.folder / "elsewhere").mkdir()
    shutil.move(toy.out, toy.folder / "elsewhere/room")
    assert toy.make("room")[0] == 0
    (toy.folder / "build/linked").symlink_to(toy.folder / "elsewhere/room")
    done = make("clean", cwd=toy.folder)
    assert done.returncode == 0, done
    removed, stays = done.stdout.splitlines()
    assert removed == "build: removed: room"
    assert stays == "build: stays, for no scene's outputs lie in it: index.html, linked, notes.txt, other, photos"
    assert files_under(toy.folder / "build").items() >= {k: v.encode() for k, v in foreign.items()}.items()
    assert (toy.folder / "elsewhere/room/plan.mk").exists()


def test_clean_leaves_the_scenes_where_they_are(toy, files_under):
    before = files_under(toy.folder / "data")
    assert make("clean", "BUILD=data", cwd=toy.folder).returncode == 0
    assert files_under(toy.folder / "data") == before


def test_clean_ends_with_an_empty_folder_gone(toy):
    assert toy.make("room")[0] == 0
    assert make("clean", cwd=toy.folder).returncode == 0 and not (toy.folder / "build").exists()
    assert make("clean", cwd=toy.folder).stdout == "build: is not there: nothing to remove\n"


def test_a_page_of_others_is_no_gallery_of_ours(tmp_path):
    """`make` wrote index.html over one that was there."""
    from lib.planning import gallery

    (tmp_path / "room").mkdir()
    (tmp_path / "room/report.html").write_text("x")
    gallery.write(tmp_path)
    assert gallery.is_ours(tmp_path / "index.html")
    (tmp_path / "index.html").write_text("<title>My page</title>")
    gallery.write(tmp_path)
    assert (tmp_path / "index.html").read_text() == "<title>My page</title>"
