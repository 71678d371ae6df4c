"""Small models by hand, as OBJ files: rooms, boxes, panels; and their light."""

import numpy as np

from lib.given import model
from lib.light import adapt, form_factors, radiosity
from lib.light.lamps import patch_direct
from lib.light.surface import surface as surface_of


def box(x0, y0, z0, x1, y1, z1, inward=False):
    """{face: corners}, counter-clockwise from outside (or from inside)."""

    def c(i, j, k):
        return ((x0, x1)[i], (y0, y1)[j], (z0, z1)[k])

    faces = {
        "bottom": [c(0, 0, 0), c(0, 1, 0), c(1, 1, 0), c(1, 0, 0)],
        "top": [c(0, 0, 1), c(1, 0, 1), c(1, 1, 1), c(0, 1, 1)],
        "west": [c(0, 0, 0), c(0, 0, 1), c(0, 1, 1), c(0, 1, 0)],
        "east": [c(1, 0, 0), c(1, 1, 0), c(1, 1, 1), c(1, 0, 1)],
        "south": [c(0, 0, 0), c(1, 0, 0), c(1, 0, 1), c(0, 0, 1)],
        "north": [c(0, 1, 0), c(0, 1, 1), c(1, 1, 1), c(1, 1, 0)],
    }
    return {name: p[::-1] if inward else p for name, p in faces.items()}


def room(x=4.0, y=3.0, z=2.5):
    """Six groups, an object: floor `bottom`, ceiling `top`, four walls."""
    return {"room": list(box(0, 0, 0, x, y, z, inward=True).items())}


def solid(name, *corners):
    return {name: [(name, p) for p in box(*corners).values()]}


def panel(name, *corners):
    return {name: [(name, corners)]}


LAMP = panel("lamp", (1.5, 1, 2.4), (1.5, 2, 2.4), (2.5, 2, 2.4), (2.5, 1, 2.4))  # hangs, and shines down


def write(path, objects, scale=1.0, offset=(0.0, 0, 0)):
    """objects : {object: [(group, corners), ...]}"""
    lines, count = [], 0
    for name, polygons in objects.items():
        lines.append(f"o {name}")
        for group, corners in polygons:
            lines.append(f"usemtl {group}")
            for p in corners:
                lines.append("v " + " ".join(f"{scale * x + o:.17g}" for x, o in zip(p, offset, strict=True)))
            lines.append("f " + " ".join(str(count + i + 1) for i in range(len(corners))))
            count += len(corners)
    path.write_text("\n".join(lines) + "\n")
    return path


def surface(path, objects, lamps=("lamp",), **placed):
    m = model.load(write(path, objects, **placed))
    return surface_of(m, [name for name in lamps if name in m.groups])


def patches(s, n):
    """n patches if all had equal area."""
    return adapt.build(s, patches=n, max_level=0, contrast=1.0, uniform=True)


def light_of(s, m, lamps, n_rays, rho=0.6):
    """Irradiance of each patch, all groups alike, the lamp black; and the share of each patch outside solids."""
    D = patch_direct(s, m, lamps, 1, n_points=64, n_samples=4)[:, 0]
    rows = form_factors.rays(s, m, n_rays=n_rays)
    F = rows.matrix()
    b = radiosity.solve(rho * D, np.full(len(m), rho), F, tolerance=1e-5).B
    return D + F @ b, rows.exposed


def constant_light_error(s, m, light, fine, reference, exposed):
    """Error of patch-constant light, root mean square over the open area, relative to the mean.

    The light of a coarse patch is compared with the reference at each fine patch whose centre lies on it.
    """
    f = fine.side // 2
    relative = fine.centre - s.origin[f]
    shape = m.table_shape[fine.side]
    place = lambda a: np.einsum("ij,ij->i", relative, s.axes[f, a]) / s.size[f, a] * shape[:, a]
    at = [np.clip(place(a).astype(int), 0, shape[:, a] - 1) for a in (0, 1)]
    patch = m.leaf[m.table_start[fine.side] + at[0] * shape[:, 1] + at[1]]
    good = (patch >= 0) & (m.table_start[fine.side] >= 0) & (exposed > 0.9)
    w, right = fine.area[good], reference[good]
    return float(np.sqrt((w * (light[patch[good]] - right) ** 2).sum() / w.sum()) / ((w * right).sum() / w.sum()))


def group_light(s, m, light, exposed):
    """Mean irradiance of each group over its open area, and that area."""
    group, w = s.group[m.side // 2], m.area * exposed
    area = np.bincount(group, w, len(s.groups))
    return np.bincount(group, w * light, len(s.groups)) / np.maximum(area, 1e-300), area
