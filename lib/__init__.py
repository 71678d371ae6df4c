"""The modules the stages call, named by the field; pipeline.yaml is the table of contents."""

import os

# numba's own threads: OpenMP's cost 15 ms a launch where other work runs beside them, these .2 ms, and the TBB of most
# systems is too old. They bear no launches from several threads of Python at once: none does.
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")
