"""Small models by hand, as OBJ files: rooms, boxes, panels. Shared by the tests of form factors and by the bench."""
from lib import mesh, model


def box(x0, y0, z0, x1, y1, z1, inward=False):
    """{face: corners}, counter-clockwise from outside (or from inside)."""
    def c(i, j, k):
        return ((x0, x1)[i], (y0, y1)[j], (z0, z1)[k])
    faces = {"bottom": [c(0, 0, 0), c(0, 1, 0), c(1, 1, 0), c(1, 0, 0)], "top": [c(0, 0, 1), c(1, 0, 1), c(1, 1, 1), c(0, 1, 1)],
             "west": [c(0, 0, 0), c(0, 0, 1), c(0, 1, 1), c(0, 1, 0)], "east": [c(1, 0, 0), c(1, 1, 0), c(1, 1, 1), c(1, 0, 1)],
             "south": [c(0, 0, 0), c(1, 0, 0), c(1, 0, 1), c(0, 0, 1)], "north": [c(0, 1, 0), c(0, 1, 1), c(1, 1, 1), c(1, 1, 0)]}
    return {name: p[::-1] if inward else p for name, p in faces.items()}


def room(x=4.0, y=3.0, z=2.5):
    """Six groups, an object: floor `bottom`, ceiling `top`, four walls."""
    return {"room": list(box(0, 0, 0, x, y, z, inward=True).items())}


def solid(name, *corners):
    return {name: [(name, p) for p in box(*corners).values()]}


def panel(name, *corners):
    return {name: [(name, corners)]}


LAMP = panel("lamp", (1.5, 1, 2.4), (1.5, 2, 2.4), (2.5, 2, 2.4), (2.5, 1, 2.4))      # hangs, and shines down


def write(path, objects, scale=1.0, offset=(0.0, 0, 0)):
    """objects : {object: [(group, corners), ...]}"""
    lines, count = [], 0
    for name, polygons in objects.items():
        lines.append(f"o {name}")
        for group, corners in polygons:
            lines.append(f"usemtl {group}")
            lines += ["v %.17g %.17g %.17g" % tuple(scale * x + o for x, o in zip(p, offset)) for p in corners]
            lines.append("f " + " ".join(str(count + i + 1) for i in range(len(corners))))
            count += len(corners)
    path.write_text("\n".join(lines) + "\n")
    return path


def surface(path, objects, lamps=("lamp",), **placed):
    m = model.load(write(path, objects, **placed))
    return mesh.surface(m, [name for name in lamps if name in m.groups])


def patches(s, n):
    """n patches if all had equal area."""
    return mesh.build(s, patches=n, max_level=0, contrast=1.0, uniform=True)
