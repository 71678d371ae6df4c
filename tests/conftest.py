"""What several tests share: running executables as a user would, and small scene folders."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers import stages, toy_project

ROOT = Path(__file__).resolve().parents[1]
SIDES = ("left", "right")


def pytest_collection_modifyitems(items):
    """Whole scenes first, then files whose tests take seconds: what is left at the end is short, and no core waits."""
    dear = {item.path for item in items if item.get_closest_marker("scene")}
    items.sort(key=lambda item: 0 if item.path.name == "test_scenes.py" else 1 if item.path in dear else 2)


@pytest.fixture(scope="session")
def root():
    """The project's root folder."""
    return ROOT


@pytest.fixture
def run():
    """run(*words, cwd=...) -> CompletedProcess with stdout and stderr as text.

    `stages/x.py`, `-m lib.x` and `-c text` run under this Python.
    """

    def call(*words, cwd=ROOT, **options):
        words = [os.fspath(w) if isinstance(w, os.PathLike) else str(w) for w in words]
        if words[0].endswith(".py") or words[0] in ("-m", "-c"):
            words = [sys.executable, *words]
        environment = {
            k: v for k, v in os.environ.items() if k not in ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MAKEOVERRIDES")
        }
        return subprocess.run(
            words,
            cwd=cwd,
            capture_output=True,
            text=True,
            env=environment | options.pop("env", {}),
            timeout=options.pop("timeout", 1800),
            **options,
        )

    return call


@pytest.fixture
def toy(tmp_path, run):
    """A project of stub stages, see tests/helpers/toy_project.py."""
    return toy_project.Toy(tmp_path, run)


@pytest.fixture
def refuses(run):
    """Runs a command that must refuse: exit 2, one line per problem on stderr, no traceback; returns the lines.

    A stage is called in this process: that each refuses as a process of its own is tests/test_pipeline.py's.
    """

    def call(*words, **options):
        words = [str(word) for word in words]
        in_here = words[0].startswith("stages/") and not options
        result = stages.call(Path(words[0]).stem, *words[1:]) if in_here else run(*words, **options)
        assert result.returncode == 2, result
        assert "Traceback" not in result.stderr, result.stderr
        return result.stderr.strip().splitlines()

    return call


@pytest.fixture
def files_under():
    """files_under(folder) -> {relative path: content}: what a refusal must leave as it was."""

    def call(folder):
        folder = Path(folder)
        return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}

    return call


@pytest.fixture
def pair_files(tmp_path):
    """pair_files(Q, values) -> the options that match and reconstruct share, the pair written to tmp_path."""

    import numpy as np

    from lib.given import cameras, image

    def write(Q, values=None):
        values = Q.noisy(0.01, np.random.default_rng(0)) if values is None else values
        words = []
        cameras_of = (Q.left, Q.right)
        for side, v, labels, camera, tail in zip(SIDES, values, Q.labels, cameras_of, ("", "-right"), strict=True):
            image.write_png8(tmp_path / f"{side}.png", np.round(255 * v).astype(np.uint8))
            image.write_png16(tmp_path / f"{side}.surfaces.png", labels)
            cameras.write_cameramodel(tmp_path / f"{side}.cameramodel", camera)
            words += [
                f"--photograph{tail}",
                tmp_path / f"{side}.png",
                f"--surfaces{tail}",
                tmp_path / f"{side}.surfaces.png",
                f"--camera{tail}",
                tmp_path / f"{side}.cameramodel",
            ]
        return words

    return write
