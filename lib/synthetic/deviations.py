"""Scenes whose given files deviate from the truth in one stated way.

    $ python -m lib.synthetic.deviations data/room-101 /tmp/room-101-lamp lamp --seed 3

SCENE is a folder that stages/synthesise.py wrote with --gather.  truth/ is copied as it is; truth/deviation.json says
what was changed, and what was drawn by chance.  The photograph is the true one unless the deviation is photographic.
"""

import argparse
from pathlib import Path

import numpy as np

from lib.synthetic import deviating_geometry as geometry
from lib.synthetic import deviating_photographs as photographs
from lib.synthetic import given_scene

KINDS = {
    "exact": lambda given, random: (given, {}),
    "pose": geometry.pose,
    "objects": geometry.objects,
    "lamp": geometry.lamp,
    "objects_1cm": geometry.objects_1cm,
    "objects_3cm": geometry.objects_3cm,
    "lamps_3cm": geometry.lamps_3cm,
    "all_3cm": geometry.all_3cm,
    "half_modelled": geometry.half_modelled,
    "extra_object": geometry.extra_object,
    "phone": photographs.phone,
    "saturation": photographs.saturation,
    "open": geometry.open_objects,
    "vignetting": photographs.vignetting,
    "colours": photographs.colours,
    "srgb": photographs.srgb,
    "tone": photographs.tone,
    "gamma": photographs.gamma,
    "exposure_dark": photographs.exposure_dark,
    "exposure_bright": photographs.exposure_bright,
    "jpeg": photographs.jpeg,
    "noise_3": photographs.noise_3,
    "noise_10": photographs.noise_10,
    "bayer": photographs.bayer,
    "12in16": photographs.twelve_in_sixteen,
    "open_room": geometry.open_room,
    "neutral_lamp": geometry.neutral_lamp,
    "lamp_power": geometry.lamp_power,
    "half_pixel": geometry.half_pixel,
    "missing_object": geometry.missing_object,
    "usemtl": geometry.forgotten_usemtl,
    "turned": geometry.turned,
    "y_up": geometry.y_up,
    "millimetres": geometry.millimetres,
    "flipped_lamp": geometry.flipped_lamp,
}


def deviate(scene, out, kind, seed=0) -> dict:
    """Writes the folder `out`; returns what was changed, as truth/deviation.json has it.

    The same kind, seed and scene give the same folder.
    """
    before = given_scene.read(scene)
    random = np.random.default_rng([*kind.encode(), seed])
    given, changed = KINDS[kind](before, random)
    said = {"kind": kind, "seed": seed, **changed}
    given_scene.write(given, before, out, said)
    return said


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="the exact scene's folder")
    parser.add_argument("out", type=Path, help="folder to write")
    parser.add_argument("kind", choices=list(KINDS))
    parser.add_argument("--seed", type=int, default=0, help="of what is drawn by chance")
    opt = parser.parse_args()
    print(deviate(opt.scene, opt.out, opt.kind, opt.seed))


if __name__ == "__main__":
    main()
