"""What a scene leaves open, and what is known of the photograph that causes need."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lib.analysis.seen.gather import Gathered, out_of_range
from lib.given.causes import BUILT
from lib.given.falloff import Lens


@dataclass(frozen=True, eq=False)
class Scope:
    """What may be explained.

    response : the transfer function is free;  allowed : names of causes that may be taken
    camera : it may do more than its transfer function says, which was not measured
    lens, pixel : where the pixels (M,) of the tiles lie;  None: nothing is known of the lens
    lobes : lamp_lobe.LampLobe, None where nothing is known of the ways of their light
    vain : nothing can be learnt from such values
    asked : [Question], which the search adds to
    """

    response: bool = True
    camera: bool = True
    allowed: tuple = BUILT
    lens: Lens | None = None
    pixel: np.ndarray | None = None
    lobes: Any = None
    vain: bool = False
    asked: list = field(default_factory=list)

    @classmethod
    def of(cls, camera, gathered: Gathered, transfer, allowed, lobes=None, asked=None) -> Scope:
        """camera : Camera or None;  transfer, allowed : of scene.yaml, None: all that is left open"""
        lens = None if camera is None else Lens((camera.K[0, 2], camera.K[1, 2]), (camera.width, camera.height))
        allowed = tuple(BUILT if allowed is None else allowed)
        camera = "curve" in allowed and not (isinstance(transfer, dict) and "curve" in transfer)
        response = camera and transfer in (None, "auto")
        return cls(
            response,
            camera,
            allowed,
            lens,
            gathered.tiles.pixel,
            lobes,
            out_of_range(gathered),
            [] if asked is None else asked,
        )

    def note(self, question):
        """Keep a question; the same one of the same fit is asked again once another cause was tried in vain."""
        if question not in self.asked:
            self.asked.append(question)
