"""The causes that the search asks for, one line each."""

from __future__ import annotations

from lib.analysis.causes.cause import Cause
from lib.analysis.causes.colour_mixing import ColourMixing
from lib.analysis.causes.glow import Glow
from lib.analysis.causes.response import Response
from lib.analysis.causes.scope import Scope
from lib.analysis.causes.vignetting import Vignetting

CAUSES = [
    Response,
    Vignetting,
    Glow,
    ColourMixing,
]


def causes_of(scope: Scope) -> dict[str, Cause]:
    """{name: cause} that may be asked for in a scene; that of the lamps' lobes last, which rays have to tell first."""
    asked = [cause for cause in (kind.of(scope) for kind in CAUSES) if cause is not None]
    return {cause.name: cause for cause in (*asked, *([scope.lobes] if scope.lobes is not None else []))}
