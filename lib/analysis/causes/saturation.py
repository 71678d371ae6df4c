"""Whether the camera, or who developed its picture, took colours farther from grey: no cause, but in every sigma.

    shown = mean + (1 + s) (display - mean),    mean over the channels of a pixel

Phones and editors do so by some tenths. Under white light a paint of stronger colour looks the same; only the light
that coloured surfaces throw on each other tells, which knows s to .01 to .02 in exact rooms. What the picture says of
s, how sure it is of that, and the odds that there is one at all are in the sigma of all that has colour.
"""

from __future__ import annotations

import numpy as np

from lib.analysis.causes.candidates import Candidate
from lib.analysis.fit.problem import CauseTerms
from lib.given.transfer import Metric

NAME = "saturation"
USUAL = 0.3 / np.sqrt(3)  # root of the mean square of s, where there is one: phones' pictures have 0 to .3


def doubted(found: Candidate) -> CauseTerms | None:
    """What s would change in the tiles, where there are colours and the picture was developed for a screen."""
    problem = found.problem
    if problem.channels != 3 or problem.transfer.kind == "linear":
        return None
    state = found.result.at.state
    shown = Metric(state.transfer).value(state.transfer.mixed(state.B))
    return CauseTerms((NAME,), (shown - shown.mean(axis=1, keepdims=True))[..., None], np.array([USUAL]))
