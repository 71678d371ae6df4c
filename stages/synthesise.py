#!/usr/bin/env python3
"""Make a synthetic scene: path-trace a recipe with Mitsuba 3, which is independent of all else here; write its folder.

    $ stages/synthesise.py --scene office --out data/office

Not part of a scene's run: the small results are committed, and Mitsuba (`pip install mitsuba==3.9.1`) is only needed to
make them again.  The same options give the same numbers (of one variant, up to the order of floating-point sums).

reads   lib/synthetic   the recipes
writes  OUT/            scene.yaml model.obj model.mtl left.png|left.exr left.posed.cameramodel origin.md
        OUT/truth/      materials.json group.png legend.json noise.json
                        with mirrors: mirror.png (index + 1 of the group that they show)
                        with textures: texture-<facet>.exr textures.json
        with --gather: linear.exr (the mean, 32-bit floats) object.png
        of a stereo scene, without left.posed.cameramodel, also
        OUT/            right.png, boards/left-*.png and right-*.png or left.cameramodel and right.cameramodel
        OUT/truth/      {left,right}.cameramodel boards.json
                        {left,right}.posed.cameramodel (without the lens's distortion)

The picture is the mean of `--passes` passes of `--spp` samples per pixel, each with its own seed; their spread is the
noise.  Groups that stay above `--target` get further passes over the window that contains them, unless that is most of
the picture.  So every pixel is a mean of independent passes, some of more than others.  A group's noise is that of its
mean over pixels that no lamp's edge touches.

`--gather` traces a diffuse room another way, with a tenth of the noise in the same time: lib/synthetic/gathering.py.
Names room-<seed> and small-<seed> are random rooms: lib/synthetic/random_rooms.py; pair-<seed> are pairs in such rooms.

A stereo pair is traced through its lenses: every sample's ray is the one that the lens puts at that place of the pixel
(a box filter; no finished picture is warped).  The sensor's noise is added before values are rounded.  Its passes have
`--spp` jittered samples, a square number, and only `--passes` of them.

Scenes that are more than diffuse want llvm_ad_rgb where something is glossy or a perfect mirror.
"""

import argparse
import sys
from pathlib import Path

sys.path[0] = str(Path(__file__).resolve().parents[1])  # not stages/: its names would hide packages
from lib.core import stage


def options():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", required=True, help="name of the recipe")
    parser.add_argument("--out", required=True, type=Path, help="folder to write")
    parser.add_argument("--finer", type=stage.whole(1), default=1, help="pixels to each side of one of the recipe's")
    parser.add_argument("--spp", type=int, default=32, help="samples per pixel and pass")
    parser.add_argument("--passes", type=int, default=12, help="independent passes (8 or more for a stated noise)")
    parser.add_argument("--target", type=float, default=0.0005, help="relative noise wanted of a group's mean")
    parser.add_argument(
        "--more", type=int, default=200, help="at most so many further passes over a noisy group's window"
    )
    parser.add_argument(
        "--roulette", type=int, default=6, help="bounces before Russian roulette; 16 is twice as good in a white room"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the first pass; the others count on")
    parser.add_argument(
        "--variant", default="scalar_rgb", help="Mitsuba's; scalar_rgb needs nothing else, llvm_ad_rgb is faster"
    )
    parser.add_argument("--board-spp", type=int, default=36, help="samples per pixel of a chessboard's shot")
    parser.add_argument("--gather", action="store_true", help="stored light and one bounce; --spp 256 --passes 6 do")
    parser.add_argument("--linear", action="store_true", help="also truth/linear.exr, as --gather writes it")
    parser.add_argument("--preview", type=Path, help="write only this picture (PNG), nothing else")
    return parser


def main(opt):
    from lib.synthetic import recipes, scene_files

    try:
        recipe = recipes.make(opt.scene)
    except KeyError:
        names = ", ".join((*recipes.ALL_NAMES, *(f"{kind}-<seed>" for kind in recipes.RANDOM)))
        raise stage.BadInput(f"--scene: {opt.scene!r} is not one of {names}") from None
    if opt.finer > 1 and recipe.pair:
        raise stage.BadInput(f"--finer: {opt.finer}: a stereo scene has the pixels of its lenses")
    if opt.passes < 2:
        raise stage.BadInput(f"--passes: {opt.passes}: the noise needs at least 2")
    try:
        import mitsuba as mi
    except ImportError:
        raise stage.BadInput(
            "mitsuba: not installed: pip install mitsuba==3.9.1 (only needed to make scenes again)"
        ) from None

    mi.set_variant(opt.variant)
    scalar = opt.variant.startswith("scalar")
    if opt.gather and (scalar or recipe.surfaces or recipe.reference or recipe.pair and recipe.pair.board):
        raise stage.BadInput("--gather: for --variant llvm_ad_rgb, diffuse rooms with black lamps and given cameras")
    if recipe.lobes and not opt.gather:
        raise stage.BadInput(f"--scene: {opt.scene}: lamps with lobes are drawn by --gather alone")
    if scalar and any(surface.kind != "textured" for surface in recipe.surfaces.values()):
        raise stage.BadInput(f"--variant: {opt.variant}: mirrors and gloss are drawn by llvm_ad_rgb alone")
    if not recipe.pair:
        scene_files.synthesise(mi, recipe.finer(opt.finer), opt)
    elif scalar or opt.preview or not (is_square(opt.spp) and is_square(opt.board_spp)):
        raise stage.BadInput(
            "a stereo scene: --variant llvm_ad_rgb, square numbers of --spp and --board-spp, no --preview"
        )
    else:
        scene_files.synthesise_pair(mi, recipe, opt)


def is_square(number):
    return round(number**0.5) ** 2 == number


if __name__ == "__main__":
    stage.run(main, options())
