"""The table of mistakes: each is told at once, in a line that names the cause and the way out."""

import pytest

from lib.core import stage
from lib.planning import plan
from tests.helpers.mistakes import MISTAKES, scene


def planned(folder, capsys):
    """(exit status, lines on stderr) of planning a scene, as `make` does before any stage runs."""
    build = folder.parent.parent / "build"
    words = [folder.name, "--data", str(folder.parent), "--build", str(build)]
    try:
        stage.run(plan.main, plan.options(), words)
    except SystemExit as end:
        return end.code, capsys.readouterr().err.splitlines()
    return 0, capsys.readouterr().err.splitlines()


@pytest.fixture
def attic(tmp_path):
    return scene(tmp_path / "data" / "attic")


def test_the_scene_itself_is_sound(attic, capsys):
    assert planned(attic, capsys) == (0, [])


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_and_its_line(mistake, attic, files_under, capsys):
    """Exit 2, no traceback, nothing written, and the line."""
    make, line = MISTAKES[mistake]
    make(attic)
    before = files_under(attic)
    status, lines = planned(attic, capsys)
    assert status == 2, lines
    assert any(line in said.replace(str(attic) + "/", "") for said in lines), lines
    assert not any("Traceback" in said for said in lines) and len(lines) <= 3, lines
    assert files_under(attic) == before and not (attic.parent.parent / "build").exists()


def test_the_table_is_long_enough():
    assert len(MISTAKES) >= 40


def test_a_byte_order_mark_takes_no_vertex_away(attic, capsys):
    """It did: the first vertex was lost, and all indices were shifted by one."""
    from lib.given import model

    text = (attic / "model.obj").read_text()
    body = "\n".join(sorted(text.splitlines(), key=lambda line: not line.startswith("v ")))  # the mark before a vertex
    (attic / "model.obj").write_text(body)
    plain = model.load(attic / "model.obj")
    (attic / "model.obj").write_bytes(b"\xef\xbb\xbf" + body.replace("\n", "\r\n").encode())
    marked = model.load(attic / "model.obj")
    assert (plain.vertices == marked.vertices).all() and (plain.triangles == marked.triangles).all()
    (attic / "model.obj").write_bytes(body.replace("\n", "\r").encode())
    assert (model.load(attic / "model.obj").vertices == plain.vertices).all()
