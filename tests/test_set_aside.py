"""What is named need not be explained: the rest of the photograph is asked again."""

from types import SimpleNamespace

import numpy as np
import pytest

from lib.analysis.answer import set_aside
from lib.analysis.causes.candidates import Candidate
from lib.given.materials import Why
from tests.helpers import rooms
from tests.helpers.small_scenes import Studio, photograph
from tests.helpers.views import look

CAMERA = {"size": (160, 120), "focal": 94.0}
PAINTS = {"bottom": (0.4, 0.25, 0.15), "west": (0.6, 0.3, 0.3), "top": (0.8, 0.8, 0.7), "north": (0.3, 0.5, 0.6)}
PAINTS |= {"east": (0.5,) * 3, "south": (0.5, 0.6, 0.5)}


@pytest.mark.scene
def test_a_box_too_many_is_set_aside(tmp_path):
    """What stands behind it is not of its material: the rest is known as without it, but for the box's shadow."""
    (tmp_path / "true").mkdir(), (tmp_path / "given").mkdir()
    camera, power = look((3.8, 1.2, 1.5), (0, 1.5, 1.0), **CAMERA), [(6.0, 6.0, 6.0)]
    true = Studio(tmp_path / "true", rooms.room() | rooms.LAMP, camera)
    light = true.picture({name: np.array(rho) for name, rho in PAINTS.items()}, power)
    extra = {"extra": [("top", p) for _, p in rooms.solid("extra", 0.8, 0.6, 0, 1.3, 1.1, 0.9)["extra"]]}
    given = Studio(tmp_path / "given", rooms.room() | rooms.LAMP | extra, camera)
    found, _ = given.fit(photograph(light), power)
    assert ("group_wrong", "extra") in {(w["cause"], w["subject"]) for w in found["why"]}
    assert found["status"] == "approximate" and not found["groups"]["top"]["identified"]
    known = {n: g for n, g in found["groups"].items() if g["identified"]}
    assert len(known) >= 3
    off = max(np.abs(np.subtract(g["rho_d"], PAINTS[n]) / g["sigma"]["rho_d"]).max() for n, g in known.items())
    assert off < 3


@pytest.mark.scene
def test_what_the_model_lacks_is_still_said(tmp_path):
    """A box of another material and one that the model has not: setting aside the one dropped the other."""
    (tmp_path / "true").mkdir(), (tmp_path / "given").mkdir()
    camera, power = look((3.8, 1.2, 1.5), (0, 1.5, 1.0), **CAMERA), [(6.0, 6.0, 6.0)]
    lacking, box = rooms.solid("lacking", 0.6, 1.9, 0, 1.3, 2.6, 0.9), rooms.solid("box", 0.8, 0.3, 0, 1.3, 0.8, 0.7)
    true = Studio(tmp_path / "true", rooms.room() | rooms.LAMP | box | lacking, camera)
    paints = PAINTS | {"box": (0.1, 0.2, 0.5), "lacking": (0.2, 0.3, 0.1)}
    light = true.picture({name: np.array(rho) for name, rho in paints.items()}, power)
    box = {"box": [("bottom", p) for _, p in box["box"]]}
    found, _ = Studio(tmp_path / "given", rooms.room() | rooms.LAMP | box, camera).fit(photograph(light), power)
    assert {"group_wrong", "object_missing"} <= {w["cause"] for w in found["why"]}
    assert found["status"] != "converged"


def task(objects=("room", "box")):
    """Of two tiles, one of each object."""
    view = SimpleNamespace(model=SimpleNamespace(objects=objects))
    return SimpleNamespace(found=SimpleNamespace(object=np.arange(len(objects))), view=lambda: view)


def accused(pixels, *names):
    """An answer of as many tiles as there are numbers of pixels, in which objects are named."""
    why = [Why(*named) if isinstance(named, tuple) else Why("group_wrong", named, "", 50.0) for named in names]
    problem = SimpleNamespace(n_pixels=np.array(pixels), tile_group=np.zeros(len(pixels), int))
    explained = SimpleNamespace(given=Candidate(problem, None, None), lobes={})
    return SimpleNamespace(why=why, climb=None, refined=None, explained=explained)


@pytest.mark.parametrize(
    ("pixels", "why", "aside"),
    [
        ((80, 20), ["box"], [1]),
        ((70, 30), ["box"], []),  # with more than a fold gone, what is left of a wrong model fits
        ((80, 20), ["room", "box"], [1]),  # either is what the other is not: the smaller one
        ((80, 20), [("units", None, "", None), "box"], []),
        ((80, 20), [("unknown", None, "", None)], []),
        ((80, 20), [("group_wrong", "gone", "", 50.0)], []),
    ],
)
def test_what_is_set_aside(pixels, why, aside):
    assert set_aside.apart(task(), accused(pixels, *why)) == aside
