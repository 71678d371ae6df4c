"""Heavy packages, imported without the parts that draw windows and figures.

`import open3d` takes 1.1 s of CPU, 0.6 of them for widgets and plots, `import colour` 1.3, 0.4 of them for Matplotlib.
A stage needs neither.  Imported from here, an empty module stands in for that part meanwhile, and the time is listed
with the stage's imports.
"""

import importlib
import sys
import types
import warnings

from lib.core.apart import apart


def open3d():
    """The package open3d without open3d.visualization.  Raises ImportError."""
    return _without("open3d", "visualization")


def colour():
    """The package colour (colour-science) without colour.plotting, and without its remarks on what it lacks."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return _without("colour", "plotting")


def _without(package, part):
    if package in sys.modules:
        return sys.modules[package]
    name = f"{package}.{part}"
    sys.modules[name] = types.ModuleType(name)
    try:
        with apart("imports"):
            return importlib.import_module(package)
    finally:
        del sys.modules[name]  # who asks for it later gets it
