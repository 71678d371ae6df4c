"""What may have been mistaken where a photograph hardly shows the model's edges: the unit, the up axis, the direction,
or a picture that was mirrored.

Each mistake that people make is undone, and the edges are looked for again.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from lib.given.cameras import Camera, matrix_from_rt
from lib.given.units import METRES
from lib.vision.refinement.edges import pyramid
from lib.vision.registration.motions import State
from lib.vision.registration.register import COARSEST, SEARCH_PX, Registrar, Seen, seen

CLEAR, LEFT = 0.3, 0.3  # so much more of the edges must be there, or so little left of what was not
QUARTER = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # Y up to Z up
MIRRORED = "the photograph is mirrored (mirror it back in a picture editor): flipped"
FLIPS = {
    f"{MIRRORED} left to right": 1,
    f"{MIRRORED} top to bottom": 0,
    "the photograph is turned: with the picture upside down": (0, 1),  # a camera's roll keeps its principal point
}
ROLLS = {"a quarter to the left": 90, "a quarter to the right": -90, "upside down": 180}


class Mistake(NamedTuple):
    """cause : of SCENE.md's `why`: units, up_axis or camera;  seen : of the edges, without it"""

    cause: str
    text: str
    seen: Seen


def mistake(model, camera, photograph, now: Seen) -> Mistake | None:
    """The mistake without which the photograph tells most for the edges; None where no known one explains it."""
    level = _level(photograph, camera.width)
    tried = []
    for cause, text, other, view, shown in _undone(model, camera, level):
        share = _share(other, view, shown)
        tried.append(Mistake(cause, f"{text}, the photograph has {share.found:.0%} of its edges, not {{}}", share))
    best = max(tried, key=lambda m: m.seen.nats)
    is_clear = best.seen.found >= min(now.found + CLEAR, 1 - LEFT * (1 - now.found))
    if best.seen.is_lost or not is_clear:
        return None
    return best._replace(text=best.text.format(f"{now.found:.0%}"))


def seen_best(model, cameras, photograph) -> int | None:
    """Which camera's edges the photograph clearly has more of than any other's; None: no one's.

    cameras : [Camera] of one size
    """
    level = _level(photograph, cameras[0].width)
    shares = [_share(model, camera, level) for camera in cameras]
    best = int(np.argmax([share.found for share in shares]))
    others = max(share.found for k, share in enumerate(shares) if k != best)
    return best if not shares[best].is_lost and shares[best].found >= others + CLEAR else None


def _level(photograph, width):
    """Where the photograph is looked at: small."""
    return pyramid(photograph, COARSEST)[max(f for f in (1, 2, 4, 8, 16) if f == 1 or width >= f * SEARCH_PX)]


def _share(model, camera, level) -> Seen:
    """How much of the model's edges a photograph has where the camera sees them."""
    sight = Registrar(model, camera, level).sight(State())
    return seen(sight.pieces, level.noise) if len(sight.pieces.edge) >= 8 else Seen(0.0, 0.0, 0.0)


def _undone(model, camera, level):
    """(cause, in words, model, camera, Level of the photograph) without each mistake."""
    for unit in (name for name in METRES if name != "m"):
        size = np.ptp(model.vertices, axis=0).max()
        text = f"the model is {size:,.4g} m large: with its lengths in {unit} (model: {{{{unit: {unit}}}}})"
        yield "units", text, _turned(model, METRES[unit] * np.eye(3)), camera, level
    for turn, axis in ((QUARTER, "Y"), (QUARTER.T, "-Y")):
        yield (
            "up_axis",
            f"the model stands on its side: with {axis} as its up axis",
            _turned(model, turn),
            camera,
            level,
        )
    for words, degrees in ROLLS.items():
        yield (
            "camera",
            f"the camera is turned: with the picture {words}",
            model,
            _rolled(camera, [0, 0, 1], degrees),
            level,
        )
    for axis in (1, 2):  # of the world, up
        up = camera.T_cam_world[:3, axis]
        yield "camera", "the camera looks the other way: turned round", model, _rolled(camera, up, 180), level
    for text, axes in FLIPS.items():
        yield "camera", text, model, camera, level.flipped(axes)


def _rolled(camera, axis, degrees):
    """The camera turned about an axis of its own, where it stands."""
    T = matrix_from_rt([*np.radians(degrees) * np.asarray(axis), 0, 0, 0])
    return Camera(camera.K, camera.width, camera.height, T @ camera.T_cam_world)


def _turned(model, A):
    """The model with its vertices times A (3, 3), a rotation or a scale."""
    scale = np.cbrt(np.linalg.det(A))
    vertices = model.vertices @ A.T
    normal = model.facet_normal @ (A / scale).T
    return replace(model, vertices=vertices, facet_normal=normal, facet_offset=scale * model.facet_offset)
