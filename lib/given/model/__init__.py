"""The 3D model: triangles, and the facets, objects and groups they belong to.

    model = load("model.obj")                   # or .glb
    model.groups[model.facet_group[model.triangle_facet[t]]]

A *group* (the file's material) has one photometry, an *object* (`o`, node) is a thing, a *facet* is a maximal flat
piece of one object and one group.  The frame is the file's, the unit is the metre.
"""

import os

from lib.core import bounded
from lib.given.model.glb import read_glb
from lib.given.model.mesh import Model, build
from lib.given.model.obj import read_obj

MARKED = {b"glTF": read_glb}  # formats by their first bytes; what has no mark is read as OBJ


def load(path, metres=1.0, bare=None) -> Model:
    """Read and check model.obj or model.glb.

    metres : the unit of its lengths;  bare : group of faces without material; None: such are refused

    Refused, naming file, line (or primitive) and value: a vertex that is not finite, an index out of range, a face
    without material, no face at all.  Polygons without area are dropped; polygons that are not planar and those that
    cross themselves are triangulated; each leaves a warning.
    """
    path = os.fspath(path)
    content = bounded.content(path)
    read = next((reader for start, reader in MARKED.items() if content.startswith(start)), read_obj)
    polygons = read(path, content, bare)
    return build(path, polygons._replace(vertices=metres * polygons.vertices))
