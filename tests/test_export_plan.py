"""Exports in the plan: asked for by `exports`, by a goal or by name; unknown to every other scene."""

from pathlib import Path

import pytest

from lib.core.stage import BadInput
from lib.planning import scene as scenes
from lib.planning.command import command
from lib.planning.pipeline import read_pipeline
from lib.planning.walk import explain, walk
from tests.helpers.attic import attic

ROOT = Path(__file__).resolve().parents[1]
LAMP = "lamps: {lamp: [1, 1, 1]}\n"


@pytest.fixture
def folder(tmp_path):
    return attic(tmp_path)


def plan(folder, text, *wishes):
    (folder / "scene.yaml").write_text(text)
    stages = read_pipeline(ROOT / "pipeline.yaml")
    return walk(scenes.read(folder, stages), stages, folder.parent / "build", wishes or (None,))


def written(plan):
    return [file for file in plan.stages["export"].outputs if file.startswith("exports/")]


def test_a_scene_that_does_not_ask_knows_nothing_of_it(folder):
    found = plan(folder, LAMP)
    assert "export" not in found.stages and "export" not in explain(found)


def test_each_kind_is_a_goal(folder):
    found = plan(folder, LAMP + "exports: [colmap, gltf]")
    assert found.planned[-3:] == ["export", "compare", "report"]
    assert sorted(written(found)) == sorted(file for file in found.goals if file.startswith("exports/"))
    assert len(written(found)) == 4


def test_a_goal_names_a_file(folder):
    found = plan(folder, LAMP + "goals: [exports/colmap/images.txt]\nmodel: {up: y}")
    assert len(written(found)) == 3 and "render" not in found.planned
    argv = command(found, found.stages["export"], "python3").argv
    assert argv[argv.index("--up") + 1] == '"y"' and "--gltf" not in argv


def test_by_name_without_exports_every_kind(folder):
    found = plan(folder, LAMP, "export")
    assert len(written(found)) == 9 and "compare" not in found.planned
    found = plan(folder, LAMP + "exports: [gltf]", "export")
    assert written(found) == ["exports/gltf/scene.glb"]


@pytest.mark.parametrize(
    "text, line",
    [
        ("exports: gltf", 'exports: "gltf" is not a list of gltf, mitsuba, radiance, usd, colmap, blender'),
        ("exports: [obj]", 'exports: "obj" is none of gltf, mitsuba, radiance, usd, colmap, blender'),
        ("exports: [gltf, gltf]", 'exports: "gltf" stands there twice'),
        (
            "goals: [exports/gltf/scene.obj]",
            'goals: "exports/gltf/scene.obj" is neither made by a stage nor given; do you mean exports/gltf/scene.glb?',
        ),
    ],
)
def test_what_is_refused(folder, text, line):
    with pytest.raises(BadInput) as bad:
        plan(folder, LAMP + text)
    assert [problem.partition("scene.yaml: ")[2] for problem in bad.value.problems] == [line]


def test_a_given_export_is_copied_and_its_copy_goes_with_it(folder):
    """A goal in a folder: the stamp of its copy lies in a folder, too."""
    from lib.planning import makefile

    glb = folder / "exports/gltf/scene.glb"
    glb.parent.mkdir(parents=True)
    glb.write_bytes(b"glTF")
    build = folder.parent / "build/attic"
    text = "goals: [exports/gltf/scene.glb]"
    makefile.write(plan(folder, text), "python3", ROOT)
    assert (build / "commands/copy.exports/gltf/scene.glb").is_file()
    made = build / "exports/gltf/scene.glb"
    made.parent.mkdir(parents=True)
    made.write_bytes(b"glTF")
    glb.unlink()
    makefile.write(plan(folder, "goals: [scorecard.csv]"), "python3", ROOT)
    assert not made.exists()
