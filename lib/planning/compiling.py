"""How long the kernels of the stages to run will take to compile: on the first run, and after an edit of them.

Only the standard library, and no numba: this runs at every `make`.
"""

from __future__ import annotations

from lib.core import kernel_cache

WORTH = 5  # s that are worth a word
# CPU seconds of a first run of data/office-stereo and data/office by the modules that a stage compiles first, below
# lib/ and without `_kernels`. What mirrors, gloss and textures take more is not in it: who has them is not yet known.
SECONDS = {
    "segment": {"vision.segmentation": 4, "vision.potts": 7, "vision.merging": 8, "vision.frontiers": 4},
    "surfaces": {"vision.surfaces": 13},
    "match": {"vision.matching": 14},
    "reconstruct": {"vision.facets.borders": 13, "vision.facets.contours": 4},
    "recognise": {"vision.recognition.rotations": 8, "vision.recognition.hashing": 6, "vision.recognition.search": 8},
    "formfactors": {
        **{"light.surface": 14, "light.cells": 6, "light.form_factors": 9},
        **{"light.lamps": 10, "light.radiosity": 2, "light.adapt": 4},
    },
    "gather": {"light.form_factors": 3},
    "render": {
        **{"picture.triangles": 4, "picture.texels": 7, "picture.ray_light": 15, "picture.pixels": 5},
        **{"picture.pixel_light": 13, "picture.indirect": 3, "picture.leaves": 12, "picture.fragments": 10},
    },
}


def seconds(stages) -> dict[str, float]:
    """{stage: s}: what each of the stages, in the order in which they run, will compile before it works.

    stages : kinds of stages, as in pipeline.yaml
    """
    missing = {module for name in stages for module in SECONDS.get(name, {}) if not is_compiled(module)}
    return {name: sum(s for module, s in SECONDS.get(name, {}).items() if module in missing) for name in stages}


def of_photometry() -> str:
    """A line for who plans a first run from the index buffer on; "" where everything is compiled."""
    more = sum(seconds(["formfactors", "gather", "render"]).values())
    return f"and {10 * round(more / 10)} s more of compiling the first time" if more >= WORTH else ""


def is_compiled(module) -> bool:
    """module : as SECONDS names it"""
    return kernel_cache.is_compiled(path_of(module))


def path_of(module):
    return kernel_cache.ROOT.joinpath("lib", *module.split(".")).with_name(f"{module.rpartition('.')[2]}_kernels.py")


def words(compiling) -> str:
    """What is said after the seconds that are left; nothing where it is not worth a word.

    >>> words(133.9), words(3)
    (', and 130 s of compiling the first time', '')
    """
    return f", and {10 * round(compiling / 10)} s of compiling the first time" if compiling >= WORTH else ""
