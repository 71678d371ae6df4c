"""All further photographs of a scene: those that are posed help to place the others, and each that is found helps too.

places = locate_all(model, posed, taken)           # {name: locate.Place}
"""

from typing import NamedTuple

from lib.vision import orientation
from lib.vision.location import features, likeness
from lib.vision.location.locate import Known, Place, Taken, World, locate
from lib.vision.refinement.edges import model_edges, pyramid
from lib.vision.refinement.evidence import evidence_of
from lib.vision.refinement.pose import LEAST
from lib.vision.refinement.rig import Side, rig_of

ROUNDS = 3  # at most: a photograph that none of the given ones helps may be placed by one that was found
NEW = 2 * features.LEAST  # features that it must share with such a one to be tried again


def known(model, name, camera, photograph, grey) -> Known:
    """A posed photograph as `locate` needs it."""
    return Known(name, likeness.Known(model, camera, photograph), grey)


def locate_all(model, posed, taken, trace=None) -> dict[str, Place]:
    """Where photographs were taken from.

    posed : list of Known;  taken : list of Taken;  trace : called with name= and found= after each that was looked for
    """
    posed, places, new = list(posed), {}, ()
    for number in range(ROUNDS):
        again = [one for one in taken if one.name not in places or places[one.name].camera is None]
        again = [one for one in again if number == 0 or any(_shares(one, other) for other in new)]
        if not again:
            break
        world = World.of(model, [one.seen.camera for one in posed])
        for one in again:
            places[one.name] = locate(world, one, posed)
            if trace:
                trace(name=one.name, found=places[one.name].camera is not None)
        new = [
            known(model, one.name, places[one.name].camera, one.photograph, one.grey)
            for one in again
            if places[one.name].camera is not None
        ]
        posed += new
    return {one.name: places[one.name] for one in taken}


class Shown(NamedTuple):
    """share : of the model's edges, that a photograph with a given pose shows;  nats : what that is worth"""

    share: float
    nats: float

    @property
    def is_believed(self):
        """Other photographs may be placed by this one."""
        return self.share >= LEAST


def shown(model, camera, photograph) -> Shown:
    """What the photograph says of its given pose."""
    rig = rig_of([Side(camera, photograph)], 1.0)
    pyramids = [pyramid(photograph, 1)]
    support, _, nats = evidence_of(model, model_edges(model), rig, pyramids, camera.T_cam_world, 1.0)
    return Shown(support, nats)


def _shares(taken: Taken, other: Known):
    return len(orientation.match(taken.grey, other.grey)[0]) >= NEW
