"""The kinds of exports: how each is written, and what each loses."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from lib.core.stage import BadInput
from lib.export import blender, colmap, gltf, microfacet, mitsuba, radiance, usd
from lib.export.scene import Scene


class Kind(NamedTuple):
    """files : option -> name in the kind's folder;  write : of a folder, a Scene, W/m2 per unit of emittance

    distribution : of the microfacets that stand for Ward's lobe, None where it is kept or nothing of it is shown
    loses : keys of LOSSES
    """

    files: dict
    write: Callable
    distribution: str | None = None
    loses: tuple = ()


KINDS = {
    "gltf": Kind(
        {"gltf": "scene.glb"},
        lambda folder, scene, watt: gltf.write(folder / "scene.glb", scene),
        "ggx",
        ("shift", "throw", "glow"),
    ),
    "mitsuba": Kind(
        {"mitsuba": "scene.xml"}, lambda folder, scene, watt: mitsuba.write(folder, scene), "beckmann", ("throw",)
    ),
    "radiance": Kind(
        {"radiance": "scene.rad", "radiance_view": "view.vf"},
        lambda folder, scene, watt: radiance.write(folder, scene),
        loses=("reflecting lamps",),
    ),
    "usd": Kind({"usd": "scene.usda"}, lambda folder, scene, watt: usd.write(folder, scene), "ggx", ("throw",)),
    "blender": Kind({"blender": "scene.py"}, blender.write, "beckmann"),
    "colmap": Kind(
        {"colmap_cameras": "cameras.txt", "colmap_images": "images.txt", "colmap_points": "points3D.txt"},
        lambda folder, scene, watt: colmap.write(folder, scene),
    ),
}
LOSSES = {
    "shift": "the principal point is taken as the middle of the picture, which is {} px off (exact in extras)",
    "throw": "lamps that throw their light in a lobe are lambertian here: {}",
    "reflecting lamps": "lamps reflect nothing here: {}",
    "glow": "the light that comes in where the model is open is left out: {}",
}


def asked(files) -> dict[str, Path]:
    """{kind: its folder} of {option: path}. BadInput: a file that does not bear its kind's name."""
    found, problems = {}, []
    for kind, (names, *_) in KINDS.items():
        paths = {option: Path(files[option]) for option in names if option in files}
        wrong = {option: path for option, path in paths.items() if path.name != names[option]}
        problems += [f"--{o.replace('_', '-')}: {path}: is not called {names[o]}" for o, path in wrong.items()]
        if paths:
            found[kind] = next(iter(paths.values())).parent
    if problems:
        raise BadInput(*problems)
    return found


def losses(kind, scene: Scene) -> list[str]:
    """What of this scene a kind cannot hold, a line each."""
    camera = scene.camera
    shift = np.abs(camera.K[:2, 2] - [(camera.width - 1) / 2, (camera.height - 1) / 2]).max()
    lamps = [look for look in scene.looks.values() if look.emittance is not None]
    subject = {
        "shift": f"{shift:.2g}" if shift > 0.01 else None,
        "throw": ", ".join(lamp.name for lamp in lamps if lamp.throw is not None),
        "reflecting lamps": ", ".join(lamp.name for lamp in lamps if lamp.rho_d.any()),
        "glow": " ".join(f"{v:.3g}" for v in scene.glow) if scene.glow.any() else None,
    }
    return [LOSSES[what].format(subject[what]) for what in KINDS[kind].loses if subject[what]]


def lobe_errors(kinds, scene: Scene) -> dict[str, float]:
    """{<kind>.lobe.<group>: how far the microfacets that stand for a group's lobe are off}, see microfacet.residual."""
    distributions = {kind: KINDS[kind].distribution for kind in kinds if KINDS[kind].distribution}
    return {
        f"{kind}.lobe.{name}": microfacet.residual(distribution, look.alpha)
        for kind, distribution in distributions.items()
        for name, look in scene.looks.items()
        if look.alpha is not None
    }
