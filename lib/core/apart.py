"""Time that the open report lists apart: for what loads itself where it is first needed.

    with apart("imports"):
        import open3d

Nothing is imported here: kernels are compiled anew when a module changes that theirs imports.
"""

import contextlib

opened = []  # the reports (lib/core/report.py) whose blocks have not ended, the innermost last


@contextlib.contextmanager
def apart(label):
    """`Report.excluded(label)` of the report that is open, if one is."""
    with opened[-1].excluded(label) if opened else contextlib.nullcontext():
        yield
