"""What is doubtful about a model, in one line each. Nothing is mended: whoever drew it knows best."""

import numpy as np

from lib.core.rows import distinct
from lib.given.model.lying import NEAR, covered, spread

LARGEST = 300.0  # m: a model with a longer diagonal is hardly in metres
TOUCH = 1e-5  # in diagonals: planes nearer than that are one (lib/light/surface.py)
MANY = 200  # facets of one plane that a facet is compared with, and pairs of each step that are looked at closely
SHARE = 0.02  # of the smaller facet that lies before the other
BEHIND = 0.9  # part of an open object's pixels that show backs: it has no other side
AXIS = np.array([0.5377, 0.6339, 0.5560])  # no axis, no diagonal: normals are turned towards it


def findings(model, camera, facet) -> list[str]:
    """One line for each kind of thing that is found.

    facet : (H, W) int32 of the index buffer, -1 = nothing
    """
    diagonal = float(np.linalg.norm(np.ptp(model.vertices[np.unique(model.triangles)], axis=0)))
    boxes = _Boxes(model, diagonal)
    return [
        *_large(diagonal),
        *_doubled(model, boxes),
        *_gaps(model, boxes),
        *_torn(model),
        *_seen_from_behind(model, camera, facet, boxes),
    ]


class _Boxes:
    """The bounding boxes of all facets: low, high (F, 3) m; and the model's diagonal, m."""

    def __init__(self, model, diagonal):
        corners, n = model.corners(), model.n_facets
        self.low, self.high = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
        np.minimum.at(self.low, model.triangle_facet, corners.min(axis=1))
        np.maximum.at(self.high, model.triangle_facet, corners.max(axis=1))
        self.diagonal = diagonal


def _large(diagonal):
    if diagonal > LARGEST:
        yield (
            f"it is {diagonal:,.0f} m from corner to corner; a room of 3,000 m is in millimetres: "
            "write its coordinates in metres"
        )


def _doubled(model, boxes):
    """Facets that lie in the same place and face the same way. The later one in the file is never seen."""
    size = np.sqrt(model.facet_area())[:, None]
    place = np.hstack([boxes.low, boxes.high, size]) / (1e-6 * boxes.diagonal)
    key = np.rint(np.hstack([place, 1e3 * model.facet_normal])) + 0.0
    first, number = distinct(key)
    twice = np.flatnonzero((np.bincount(number)[number] > 1) & np.isfinite(boxes.low[:, 0]))  # not of absent objects
    twin = first[number[twice]]
    found = [_pair(model, a, b) for a, b in zip(twin, twice, strict=True) if a != b]
    if found:
        yield f"doubled faces, of which the photograph can show but one: {_listed(found)}"


def _gaps(model, boxes):
    """Facets that are as good as on each other, and are not. What is behind counts as seen, and is dark."""
    near, touch = NEAR * boxes.diagonal, TOUCH * boxes.diagonal
    turn = np.where(model.facet_normal @ AXIS < 0, -1, 1)
    height = turn * model.facet_offset
    alike = distinct(np.rint(1e3 * turn[:, None] * model.facet_normal))[1]
    solid = _outward(model)[model.facet_object]
    order = np.lexsort((height, alike))
    of_facet, widest = _Triangles(model), {}
    for step in range(1, min(MANY, len(order))):
        i, j = order[:-step], order[step:]
        gap = height[j] - height[i]
        close = (alike[i] == alike[j]) & (gap <= near)
        if not close.any():
            break
        # neither the upper side of the lower one nor the lower side of the upper one looks into a solid
        close &= (gap > touch) & ~(solid[i] & (turn[i] < 0)) & ~(solid[j] & (turn[j] > 0))
        close &= model.facet_object[i] != model.facet_object[j]
        close &= (np.minimum(boxes.high[i], boxes.high[j]) >= np.maximum(boxes.low[i], boxes.low[j]) - near).all(axis=1)
        for k in np.flatnonzero(close)[:MANY]:
            a, b, g = i[k], j[k], gap[k]
            if _overlap(of_facet[a], of_facet[b], near):
                pair = _pair(model, min(a, b), max(a, b))
                widest[pair] = max(widest.get(pair, 0.0), g)
    if widest:
        told = _listed([f"{pair} ({1000 * gap:.2g} mm)" for pair, gap in widest.items()])
        yield f"narrow gaps, whose darkness counts as what is beside them: {told}; let them touch"


class _Triangles:
    """The triangles (n, 3, 3) of each facet."""

    def __init__(self, model):
        order = np.argsort(model.triangle_facet, kind="stable")
        self._corners = model.corners()[order]
        self._start = np.searchsorted(model.triangle_facet[order], np.arange(model.n_facets + 1))

    def __getitem__(self, facet):
        return self._corners[self._start[facet] : self._start[facet + 1]]


def _overlap(mine, other, near):
    """Does a part of the smaller one of two facets, each of triangles (n, 3, 3), lie before the other?"""
    area = [np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum() for t in (mine, other)]
    small, large = (mine, other) if area[0] <= area[1] else (other, mine)
    # the rim of `covered` is as wide as the gap may be: points near the smaller one's own rim prove nothing
    middle = small.mean(axis=1, keepdims=True)
    return covered(large, spread(0.9 * small + 0.1 * middle, 100), near).mean() >= SHARE


def _outward(model):
    """(O,) bool: solids whose faces look outwards. Rooms look inwards."""
    corners = model.corners() - model.vertices.mean(axis=0)
    six = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    volume = np.bincount(model.facet_object[model.triangle_facet], six, len(model.objects))
    return model.solid_objects() & (volume > 0)


def _torn(model):
    """Objects of which neighbouring faces are turned opposite ways."""
    position = distinct(model.vertices)[1]
    a = position[model.triangles]
    ends = np.stack([a.ravel(), np.roll(a, -1, axis=1).ravel()], axis=1)
    owner = np.repeat(model.facet_object[model.triangle_facet], 3)
    sides = np.column_stack([owner, np.sort(ends, axis=1)])
    first, number = distinct(sides)
    net = np.bincount(number, np.where(ends[:, 0] < ends[:, 1], 1, -1))
    torn = (np.bincount(number) == 2) & (np.abs(net) == 2)
    if torn.any():
        told = _listed([repr(model.objects[i]) for i in np.unique(sides[first[torn], 0])])
        yield f"neighbouring faces that are turned opposite ways, in {told}"


def _seen_from_behind(model, camera, facet, boxes):
    """Objects whose backs the camera sees: a solid ever, an open object that is not flat from everywhere.

    Not the room that it stands in: one made of a cube has its faces outwards, and both sides of a wall are lit.
    """
    behind = model.facet_normal @ camera.centre < model.facet_offset
    pixels = np.bincount(facet[facet >= 0], minlength=model.n_facets)
    count = lambda weight: np.bincount(model.facet_object, weight, len(model.objects))
    seen, backs = count(pixels), count(pixels * behind)
    few = np.where(model.closed_objects, 0.01, BEHIND)
    wrong = (backs >= 20) & (backs > few * seen) & (model.closed_objects | ~_flat(model, boxes))
    low, high = np.full((len(seen), 3), np.inf), np.full((len(seen), 3), -np.inf)
    np.minimum.at(low, model.facet_object, boxes.low)
    np.maximum.at(high, model.facet_object, boxes.high)
    wrong &= ~(model.closed_objects & ((low < camera.centre) & (camera.centre < high)).all(axis=1))
    if wrong.any():
        told = _listed([repr(model.objects[i]) for i in np.flatnonzero(wrong)])
        yield f"the camera sees only the backs of faces that should show their fronts: {told} may be inside out"


def _flat(model, boxes):
    """(O,) bool: objects whose corners all lie in one plane."""
    owner = model.facet_object[model.triangle_facet]
    first = np.unique(model.facet_object, return_index=True)[1]
    height = np.abs(
        np.einsum("tcj,tj->tc", model.corners(), model.facet_normal[first[owner]])
        - model.facet_offset[first[owner], None]
    ).max(axis=1)
    farthest = np.zeros(len(model.objects))
    np.maximum.at(farthest, owner, height)
    return farthest <= NEAR * boxes.diagonal


def _pair(model, a, b):
    """Facets a and b by the names of their objects."""
    one, other = (model.objects[model.facet_object[f]] for f in (a, b))
    return f"{one!r} and {other!r}" if one != other else f"{one!r} twice"


def _listed(names, most=5):
    names = list(dict.fromkeys(names))
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
