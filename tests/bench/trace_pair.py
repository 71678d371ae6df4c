"""A pair path-traced by Mitsuba, in its own environment: the recipe comes pickled, the photographs go as .npz.

$ .venv-scenes/bin/python -m tests.bench.trace_pair recipe.pickle pair.npz
"""

import pickle
import sys
import tempfile
from pathlib import Path
from types import SimpleNamespace

import numpy as np

PASSES = SimpleNamespace(spp=36, passes=2, seed=1, roulette=6)


def main(recipe_file, pictures):
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    from lib.synthetic.gathering import gathered_pair
    from lib.synthetic.stereo_pictures import photographed

    recipe = pickle.loads(Path(recipe_file).read_bytes())
    with tempfile.TemporaryDirectory() as folder:
        passes = gathered_pair(mi, recipe, Path(folder), PASSES).passes
    random = np.random.default_rng([PASSES.seed, 77])
    np.savez(pictures, **{side: photographed(recipe, p.mean(), random) for side, p in passes.items()})


if __name__ == "__main__":
    main(*sys.argv[1:])
