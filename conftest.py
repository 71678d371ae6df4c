"""For the examples in lib/ as well as for tests/.

NumPy prints as it does by itself, whatever a package has set (colour does).
"""

import sys

import pytest

collect_ignore = [
    "lib/given/mrcal_process.py",  # runs under mrcal's own interpreter
    "lib/export/blender_process.py",  # under Blender's
]
collect_ignore_glob = ["tests/data/*"]  # scripts that made fixtures, of programs that are not here


@pytest.fixture(autouse=True)
def plain_numpy():
    if "numpy" in sys.modules:
        import numpy as np

        with np.printoptions(
            legacy=False, precision=8, suppress=False, linewidth=75, sign="-", floatmode="maxprec", threshold=1000
        ):
            yield
    else:
        yield
