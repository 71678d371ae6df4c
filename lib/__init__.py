"""The modules the stages call, named by the field; pipeline.yaml is the table of contents."""

import os

os.environ.setdefault("NUMBA_THREADING_LAYER", "omp")  # the TBB of most systems is too old for numba, which then warns
