"""Geometry of the synthetic rooms: polygons, boxes, prisms, lamps.  z is up; metres."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Polygon:
    """A convex planar polygon, counter-clockwise seen from its front."""

    object: str
    group: str
    points: np.ndarray  # (n, 3) m

    def area(self):
        """m2, one side."""
        edges = self.points - self.points[0]
        return np.linalg.norm(np.cross(edges[1:-1], edges[2:]).sum(0)) / 2

    def normal(self) -> np.ndarray:
        """Unit normal of the front."""
        edges = self.points - self.points[0]
        n = np.cross(edges[1:-1], edges[2:]).sum(0)
        return n / np.linalg.norm(n)


def rectangle(object, group, corner, u, v) -> Polygon:
    """The parallelogram corner, corner + u, corner + u + v, corner + v; its front is where u x v points."""
    c, u, v = (np.asarray(x, float) for x in (corner, u, v))
    return Polygon(object, group, np.array([c, c + u, c + u + v, c + v]))


def prism(object, group, outline, z0, z1, *, top=None, sides=None) -> list[Polygon]:
    """A closed prism over a convex outline (n, 2), counter-clockwise seen from above.

    `top` and `sides[i]` (the side that starts at corner i) may belong to other groups.
    """
    xy, n, sides = np.asarray(outline, float), len(outline), sides or {}
    low, high = np.c_[xy, np.full(n, z0)], np.c_[xy, np.full(n, z1)]
    faces = [Polygon(object, group, low[::-1]), Polygon(object, top or group, high)]
    for i in range(n):
        j = (i + 1) % n
        faces.append(Polygon(object, sides.get(i, group), np.array([low[i], low[j], high[j], high[i]])))
    return faces


def box(object, group, low, high, *, turn=0.0, **groups) -> list[Polygon]:
    """A closed box between two corners, turned about its own vertical axis by `turn` radians.

    Other groups: `top=`, or `sides={i: group}` with i = 0 the side at -y, 1 at +x, 2 at +y, 3 at -x.
    """
    (x0, y0, z0), (x1, y1, z1) = low, high
    outline = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    if turn:
        c, s, middle = np.cos(turn), np.sin(turn), outline.mean(0)
        outline = (outline - middle) @ np.array([[c, s], [-s, c]]) + middle
    return prism(object, group, outline, z0, z1, **groups)


def regular(centre, radius, n, start=0.0) -> np.ndarray:
    """Corners of a regular polygon, counter-clockwise: (n, 2)."""
    a = start + 2 * np.pi * np.arange(n) / n
    return np.asarray(centre) + radius * np.c_[np.cos(a), np.sin(a)]


def room(x, y, z, walls=("wall",) * 4) -> list[Polygon]:
    """Floor, ceiling and four walls (at y = 0, x = x, y = y, x = 0) as single polygons that face inwards."""
    return [
        rectangle("floor", "floor", (0, 0, 0), (x, 0, 0), (0, y, 0)),
        rectangle("ceiling", "ceiling", (0, 0, z), (0, y, 0), (x, 0, 0)),
        rectangle("walls", walls[0], (0, 0, 0), (0, 0, z), (x, 0, 0)),
        rectangle("walls", walls[1], (x, 0, 0), (0, 0, z), (0, y, 0)),
        rectangle("walls", walls[2], (x, y, 0), (0, 0, z), (-x, 0, 0)),
        rectangle("walls", walls[3], (0, y, 0), (0, 0, z), (0, -y, 0)),
    ]


def lamp(object, group, centre, size_x, size_y, z) -> Polygon:
    """A panel that shines downwards."""
    x, y = centre[0] - size_x / 2, centre[1] - size_y / 2
    return rectangle(object, group, (x, y, z), (0, size_y, 0), (size_x, 0, 0))


FRONT_SIDE = {("x", -1): 3, ("x", 1): 1, ("y", -1): 0, ("y", 1): 2}  # a box's side that looks into the room


def on_wall(object, front, edge, wall, along, z, thickness) -> list[Polygon]:
    """A flat closed box that hangs on a wall: its front face is one group, its sides and back another.

    wall: ("x", 5.0, -1) is the plane x = 5, whose room lies towards -x; along, z: (low, high) m.
    """
    axis, at, side = wall
    a, b = sorted((at, at + side * thickness))
    if axis == "x":
        low, high = (a, along[0], z[0]), (b, along[1], z[1])
    else:
        low, high = (along[0], a, z[0]), (along[1], b, z[1])
    return box(object, edge, low, high, sides={FRONT_SIDE[axis, side]: front})


def framed(object, front, edge, wall, along, z, thickness, width=0.05) -> list[Polygon]:
    """The same within a frame of four bars, half as thick again."""
    (a, b), (c, d), thick = along, z, 1.5 * thickness
    bars = (
        ("bottom", (a - width, b + width), (c - width, c)),
        ("top", (a - width, b + width), (d, d + width)),
        ("left", (a - width, a), z),
        ("right", (b, b + width), z),
    )
    out = on_wall(object, front, edge, wall, along, z, thickness)
    for name, *span in bars:
        out += on_wall(f"{object}-{name}", edge, edge, wall, *span, thick)
    return out


def moved(polygons, T, mirror=False) -> list[Polygon]:
    """The polygons displaced by T (4, 4).

    mirror: they are mirrored in x before, and their corners reversed, so that fronts stay fronts.
    """
    turn = (lambda p: (p * (-1, 1, 1))[::-1]) if mirror else (lambda p: p)
    return [Polygon(q.object, q.group, turn(q.points) @ T[:3, :3].T + T[:3, 3]) for q in polygons]


def upright(yaw, translation) -> np.ndarray:
    """(4, 4): a turn about z by `yaw` radians, then a translation."""
    T, c, s = np.eye(4), np.cos(yaw), np.sin(yaw)
    T[:2, :2], T[:3, 3] = [[c, -s], [s, c]], translation
    return T
