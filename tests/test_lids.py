"""Lids: objects drawn without the faces on which they stand or with which they lean are solids all the same."""

import json

import numpy as np
import pytest

from lib.given import model
from lib.given.model.lids import lids as find_lids
from lib.light import adapt, form_factors, hemicube
from lib.light.lamps import emitters, patch_direct
from lib.light.surface import covered, group_areas, lids, surface
from tests.helpers import rooms
from tests.helpers.growth import growth
from tests.helpers.small_scenes import finish

ROOM = rooms.room() | rooms.LAMP  # 4 x 3 x 2.5 m


def box(name, corners, *without, **turned):
    return {name: [(name, p) for face, p in rooms.box(*corners, **turned).items() if face not in without]}


# name: the box, and the faces that are not drawn, which lie on the room or on the other things
OPEN = {
    "on the floor": ((1, 1, 0, 2, 1.7, 0.8), ["bottom"]),
    "on a wall": ((1, 0, 1, 2, 0.3, 2), ["south"]),
    "under the ceiling": ((0.5, 1, 2, 1.2, 2, 2.5), ["top"]),
    "a pillar": ((1, 1, 0, 1.3, 1.3, 2.5), ["bottom", "top"]),
    "on the floor at a wall": ((1, 0, 0, 2, 0.6, 1.8), ["bottom", "south"]),
    "in a corner": ((0, 0, 0, 1, 0.6, 1.8), ["bottom", "south", "west"]),
    "from wall to wall": ((0, 0, 0, 4, 0.5, 1), ["bottom", "south", "west", "east"]),
    "a beam at a wall": ((0, 0, 1, 4, 0.3, 1.3), ["south", "west", "east"]),
    "a pillar in a corner": ((0, 0, 0, 0.4, 0.4, 2.5), ["bottom", "top", "south", "west"]),
}
every_box = pytest.mark.parametrize("corners, without", OPEN.values(), ids=OPEN)


def found(path, objects, **placed):
    """The lids of a model, and the names of the objects that they close."""
    m = model.load(rooms.write(path, objects, **placed))
    return m.lids.faces, sorted(m.objects[thing] for thing in m.lids.objects)


def area(lid):
    v = np.cross(lid.corners[:, 1] - lid.corners[:, 0], lid.corners[:, 2] - lid.corners[:, 0])
    return np.linalg.norm(v, axis=1).sum() / 2


@every_box
def test_lids_are_the_faces_that_were_left_out(tmp_path, corners, without):
    """Their areas and directions; however large the model is, and wherever it stands."""
    for scale, offset in ((1, (0, 0, 0)), (1e-3, (5, 5, 5)), (50, (1e5, -1e5, 1e4))):
        found_, names = found(tmp_path / "m.obj", ROOM | box("box", corners, *without), scale=scale, offset=offset)
        assert names == ["box"] and len(found_) == len(without)
        faces = [np.array(p, float) for face, p in rooms.box(*corners).items() if face in without]
        wanted = sorted(np.cross(p[1] - p[0], p[3] - p[0]).round(6).tolist() for p in faces)
        turned = [
            (np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]).sum(axis=0) / 2 / scale**2).round(6).tolist()
            for _, t in found_
        ]
        assert np.allclose(sorted(turned), wanted, atol=1e-5)


@every_box
def test_light_is_that_of_the_closed_box(tmp_path, corners, without):
    """The same patches; the same factors between them and to the lamp, but for rays that pass a rim within rounding."""
    made = []
    for name, faces in (("closed", ()), ("open", without)):
        s = rooms.surface(tmp_path / f"{name}.obj", ROOM | box("box", corners, *faces))
        m = adapt.build(s, patches=200, max_level=2, contrast=0.02, emitters=emitters(s, ["lamp"]))
        rows = form_factors.rays(s, m, n_rays=256)
        made.append((s, m, rows, patch_direct(s, m, emitters(s, ["lamp"]), 1, n_points=16)))
    (_, closed, F, D), (s, m, F_open, D_open) = made
    assert len(m) == len(closed) and np.allclose(m.centre, closed.centre)
    assert np.abs(F.matrix() - F_open.matrix()).sum() <= 1e-4 * len(m)
    assert np.allclose(D, D_open, atol=1e-6) and np.allclose(F.exposed, F_open.exposed, atol=0.01)
    assert len(lids(s)) == len(without) and len(m.table_start) == 2 * (s.group >= 0).sum()


def test_hemicubes_drop_what_they_see_through_a_lid(tmp_path):
    """Where the centre of a patch is covered its hemicube stands beside the box, with lids as without."""
    made = []
    for name, without in (("closed", ()), ("open", ["bottom", "top"])):
        s = rooms.surface(tmp_path / f"{name}.obj", ROOM | box("box", (1, 1, 0, 1.8, 1.8, 2.5), *without))
        made.append(hemicube.rows(s, rooms.patches(s, 60), resolution=32))
    closed, opened = made
    assert np.allclose(closed.matrix().toarray(), opened.matrix().toarray(), atol=1e-3)
    assert np.allclose(closed.exposed, opened.exposed) and closed.exposed.min() < 0.9


def test_a_lid_is_no_mirror_and_no_lamp(tmp_path):
    """A mirror that stands on the floor, and a lamp that does: their lids have no group."""
    things = box("mirror", (1, 1, 0, 2, 2, 1), "bottom") | box("glow", (3, 1, 0, 3.3, 1.3, 0.4), "bottom")
    s = rooms.surface(tmp_path / "m.obj", rooms.room() | things, lamps=("glow",))
    of, _ = finish(s, mirror="mirror").facets(s)
    assert len(lids(s)) == 2 and (of >= 0).sum() == 5 and (s.group[of >= 0] == s.groups.index("mirror")).all()
    assert sum(len(lamp.corners) for lamp in emitters(s, ["glow"])) == 10
    assert np.allclose(group_areas(s) * s.local.diagonal**2, [12, 12, 7.5, 7.5, 10, 10, 5, 4 * 0.12 + 0.09])


@every_box
def test_what_lies_under_a_lid_is_covered(tmp_path, corners, without):
    s = rooms.surface(tmp_path / "m.obj", ROOM | box("box", corners, *without))
    for face in without:
        p = np.array(rooms.box(*corners)[face], float)
        n = np.cross(p[1] - p[0], p[3] - p[0])
        n /= -np.linalg.norm(n)  # of the wall or the floor
        u = np.random.default_rng(0).uniform(0.02, 0.98, (500, 2))
        points = s.local.points(p[0] + u[:, :1] * (p[1] - p[0]) + u[:, 1:] * (p[3] - p[0]))
        assert covered(s, points, np.broadcast_to(n, points.shape)).all()


def test_things_on_things(tmp_path):
    """A carton on an open carton, on a table of one polygon; legs of one object; a little over the edge."""
    things = (
        box("lower", (1, 1, 0, 2, 2, 0.5), "bottom")
        | box("upper", (1.2, 1.2, 0.5, 1.7, 2.004, 0.9), "bottom")
        | rooms.panel("table", (2.5, 0.5, 0.7), (3.5, 0.5, 0.7), (3.5, 1.5, 0.7), (2.5, 1.5, 0.7))
        | box("vase", (2.8, 0.8, 0.7, 3, 1, 1), "bottom")
        | {
            "legs": [
                p for x in (2.5, 3.4) for p in box("legs", (x, 0.5, 0, x + 0.1, 0.6, 0.7), "bottom", "top")["legs"]
            ]
        }
    )
    found_, names = found(tmp_path / "m.obj", ROOM | things)
    assert names == ["legs", "lower", "upper", "vase"] and len(found_) == 7


def test_a_lid_has_the_hole_of_its_loop(tmp_path):
    """Thick walls without floor and ceiling, drawn around a yard: a solid, and the floor of the yard is not covered."""
    ring = box("walls", (0.5, 0.5, 0, 3.5, 2.5, 2.5), "bottom", "top")["walls"]
    ring += [("walls", p[::-1]) for _, p in box("walls", (1, 1, 0, 3, 2, 2.5), "bottom", "top")["walls"]]
    objects = rooms.room() | {"walls": ring} | rooms.LAMP
    found_, names = found(tmp_path / "m.obj", objects)
    assert names == ["walls"] and np.allclose([area(lid) for lid in found_], 3 * 2 - 2 * 1)
    s = rooms.surface(tmp_path / "n.obj", objects)
    p = s.local.points(np.array([[2, 1.5, 0], [0.7, 1.5, 0], [0.2, 1.5, 0]]))
    assert covered(s, p, np.tile([0.0, 0, 1], (3, 1))).tolist() == [False, True, False]


def test_a_t_junction_needs_no_lid(tmp_path):
    """The front of two polygons, beside a top of one."""
    faces = dict(rooms.box(1, 1, 0, 2, 2, 1))
    halves = [[(1, 1, 0), (1.4, 1, 0), (1.4, 1, 1), (1, 1, 1)], [(1.4, 1, 0), (2, 1, 0), (2, 1, 1), (1.4, 1, 1)]]
    box_ = {"box": [("box", p) for face, p in faces.items() if face not in ("bottom", "south")]}
    box_["box"] += [("box", p) for p in halves]
    found_, names = found(tmp_path / "m.obj", ROOM | box_)
    assert names == ["box"] and len(found_) == 1
    box_["box"].append(("box", faces["bottom"]))
    assert found(tmp_path / "m.obj", ROOM | box_) == ((), ["box"])


def test_an_object_that_overlaps_another(tmp_path):
    """Rays that start in one solid and first meet the outside of the other are dropped, with lids as without."""
    made = []
    for name, without in (("closed", ()), ("open", ["bottom"])):
        two = box("a", (1, 1, 0, 2, 2, 0.7), *without) | box("b", (1.5, 1.5, 0, 2.5, 2.3, 1), *without)
        s = rooms.surface(tmp_path / f"{name}.obj", ROOM | two)
        m = rooms.patches(s, 200)
        made.append((m, form_factors.rays(s, m, n_rays=256)))
    (m, F), (m_open, F_open) = made
    assert len(m) == len(m_open) and np.abs(F.matrix() - F_open.matrix()).sum() <= 1e-4 * len(m)


REFUSED = {
    "hangs free": box("shade", (1, 1, 1, 2, 2, 1.5), "bottom"),
    "hangs free, open at both ends": box("shade", (1, 1, 1, 2, 2, 1.5), "bottom", "top"),
    "stands half on a table": rooms.panel("table", (1, 1, 0.7), (1.5, 1, 0.7), (1.5, 2, 0.7), (1, 2, 0.7))
    | box("shade", (1, 1, 0.7, 2, 2, 1), "bottom"),
    "a finger above the floor": box("shade", (1, 1, 0.02, 2, 2, 1), "bottom"),
    "leaves a gap at the wall": box("shade", (1, 0.02, 0, 2, 0.6, 1.8), "bottom", "south"),
    "open at the top, too": box("shade", (1, 1, 0, 2, 2, 1), "bottom", "top"),
    "looks inwards": box("shade", (1, 1, 0, 2, 2, 1), "bottom", inward=True),
    "has no height": rooms.panel("shade", (1, 1, 0), (2, 1, 0), (2, 2, 0), (1, 2, 0)),
    "a sheet before a wall": rooms.panel("shade", (1, 0.001, 1), (2, 0.001, 1), (2, 0.001, 2), (1, 0.001, 2)),
}


@pytest.mark.parametrize("objects", REFUSED.values(), ids=REFUSED)
def test_what_gets_no_lid(tmp_path, objects):
    assert found(tmp_path / "m.obj", ROOM | objects) == ((), [])


def test_a_niche_gets_no_lid(tmp_path):
    """A wall with a hole, a niche behind it, and a door before it that closes the niche: it looks inwards."""
    room = rooms.room()
    niche = box("niche", (1, -0.5, 0, 2, 0, 2), "north", inward=True)
    door = rooms.panel("door", (1, 0, 0), (1, 0, 2), (2, 0, 2), (2, 0, 0))
    assert found(tmp_path / "m.obj", room | rooms.LAMP | niche | door)[1] == []


def test_faces_turned_opposite_ways_get_no_lid(tmp_path):
    shade = box("shade", (1, 1, 0, 2, 2, 1), "bottom")["shade"]
    shade[0] = ("shade", shade[0][1][::-1])
    assert found(tmp_path / "m.obj", ROOM | {"shade": shade}) == ((), [])


def test_a_room_without_floor_is_no_solid(tmp_path):
    """Walls that look outwards by mistake, on a floor and under a ceiling of their own: the lamp shines in them."""
    walls = box("walls", (0, 0, 0, 4, 3, 2.5), "bottom", "top")
    rest = {name: [f for f in rooms.room()["room"] if f[0] == name] for name in ("bottom", "top")}
    m = model.load(rooms.write(tmp_path / "m.obj", rest | walls | rooms.LAMP))
    assert m.solid_objects().tolist() == [False, False, True, False]
    assert not m.solid_objects(camera_centre=(1, 1, 1)).any() and not m.solid_objects(lamps=["lamp"]).any()
    s = rooms.surface(tmp_path / "n.obj", rest | walls | rooms.LAMP)
    assert not s.inside.any() and not len(lids(s))


def vases(sides, many=20):
    """Open cups of many sides upside down on the floor, one beside the other."""
    angle = 2 * np.pi * np.arange(sides) / sides
    result = {}
    for k in range(many):
        x, y = 0.3 + 0.7 * (k % 5), 0.3 + 0.7 * (k // 5)
        ring = np.column_stack([x + 0.2 * np.cos(angle), y + 0.2 * np.sin(angle)])
        low, high = (np.column_stack([ring, np.full(sides, z)]) for z in (0.0, 0.5))
        polygons = [[low[i - 1], low[i], high[i], high[i - 1]] for i in range(sides)]
        result[f"vase{k}"] = [("vase", p) for p in [*polygons, list(high)]]
    return result


def test_lids_of_many_facets(tmp_path):
    """420 facets to 6,720: near-linear; it was quadratic, and 67 s of a hall of 11,000."""
    small, large = (model.load(rooms.write(tmp_path / f"{n}.obj", rooms.room(4, 4, 2.5) | vases(n))) for n in (20, 320))
    assert len(find_lids(small).faces) == len(find_lids(large).faces) == 20
    assert growth(lambda: find_lids(small), lambda: find_lids(large)) < 16**1.2


def shelf(rng):
    """Boxes of one shelf on a grid of centimetres: boards between sides or into them, things on the boards."""
    cm = lambda low, high: round(int(rng.integers(100 * low, 100 * high)) / 100, 2)
    x0, y0, wide, deep, high = cm(1, 2), cm(1, 1.5), cm(0.5, 1.3), cm(0.2, 0.5), cm(0.8, 1.8)
    side = cm(0.02, 0.06)
    parts = [(x0, y0, 0, x0 + side, y0 + deep, high), (x0 + wide, y0, 0, x0 + wide + side, y0 + deep, high)]
    into = cm(0.01, 0.04) if rng.random() < 0.5 else 0.0  # boards that run into the sides
    for z in np.linspace(0, high - 0.1, int(rng.integers(2, 6))):
        z = round(float(z), 2)
        front = 0.0 if into == 0 else cm(0.01, 0.05)
        parts.append((x0 + side - into, y0 + front, z, x0 + wide + into, y0 + deep - front, z + 0.04))
        if rng.random() < 0.5:
            a, b = cm(0.02, 0.1), cm(0.02, 0.1)
            parts.append((x0 + side + a, y0 + 0.05, z + 0.04, x0 + side + a + b, y0 + 0.15, z + 0.07))
    return [tuple(np.round(part, 2)) for part in parts]


@pytest.mark.parametrize("seed", range(40))
def test_touching_boxes_of_one_object(tmp_path, seed):
    """What looks into one of the boxes at all its places is inside, and nothing else: by hand.

    Where they only touch one polygon may be turned the wrong way.
    """
    rng = np.random.default_rng(seed)
    parts = shelf(rng)
    polygons = [p for part in parts for p in rooms.box(*part).values()]
    if seed % 5 == 0 and parts[2][0] == parts[0][3]:
        k = int(rng.integers(len(polygons)))
        polygons[k] = polygons[k][::-1]
    objects = rooms.room() | {"shelf": [("wood", p) for p in polygons]}
    m = model.load(rooms.write(tmp_path / "m.obj", objects))
    s = surface(m)
    low, high = np.array(parts)[:, :3], np.array(parts)[:, 3:]
    rng = np.random.default_rng(1000 + seed)
    for f in np.flatnonzero(m.facet_object == m.objects.index("shelf")):
        corners = m.vertices[m.triangles[m.triangle_facet == f]]
        u = rng.random((len(corners), 400, 2))
        u = np.where(u.sum(axis=2, keepdims=True) > 1, 1 - u, u)
        p = (
            corners[:, :1]
            + u[..., :1] * (corners[:, 1:2] - corners[:, :1])
            + u[..., 1:] * (corners[:, 2:] - corners[:, :1])
        )
        for back in (0, 1):
            q = p.reshape(-1, 1, 3) + (1 - 2 * back) * 1e-4 * m.facet_normal[f]
            share = ((q > low) & (q < high)).all(axis=2).any(axis=1).mean()
            if not 0.8 < share < 1:
                assert s.inside[2 * f + back] == (share == 1), (f, back, share)


def test_a_housing_that_its_lamp_closes(tmp_path):
    """A lamp that shines out of an open box closes it; one that shines into it does not."""
    housing = box("housing", (1, 1, 2, 2, 2, 2.4), "bottom")
    for corners, n in (
        (rooms.box(1, 1, 2, 2, 2, 2.4)["bottom"], 1),
        (rooms.box(1, 1, 2, 2, 2, 2.4)["bottom"][::-1], 0),
    ):
        s = rooms.surface(tmp_path / "m.obj", rooms.room() | housing | rooms.panel("lamp", *corners))
        assert len(lids(s)) == n and s.inside.any() == bool(n)


def test_the_report_names_them(run, tmp_path):
    path = rooms.write(tmp_path / "model.obj", ROOM | box("plinth", (1, 1, 0, 2, 2, 1), "bottom"))
    out, report = tmp_path / "formfactors.npz", tmp_path / "report.json"
    words = ["--model", path, "--lamps", '["lamp"]', "--formfactors", out, "--report", report, "--rays", "64"]
    result = run("stages/formfactors.py", *words)
    assert result.returncode == 0, result.stderr
    said = json.loads(report.read_text())
    assert said["lids"] == {"count": 1, "objects": ["plinth"]} and said["solids"] == 1 and said["warnings"] == []


def test_an_open_model_is_said_to_be_open(run, tmp_path):
    """A room without a wall is; two closed rooms whose outer walls see each other are not."""
    room = {"room": [face for face in rooms.room()["room"] if face[0] != "south"]}
    beside = box("beside", (0, 3.5, 0, 4, 6, 2.5), inward=True)
    for objects, n in ((room, 1), (rooms.room() | beside, 0)):
        path = rooms.write(tmp_path / "model.obj", objects | rooms.LAMP)
        out, report = tmp_path / "formfactors.npz", tmp_path / "report.json"
        words = ["--model", path, "--lamps", '["lamp"]', "--formfactors", out, "--report", report, "--rays", "64"]
        assert run("stages/formfactors.py", *words).returncode == 0
        said = json.loads(report.read_text())
        opening = {error["name"]: error["value"] for error in said["errors"]}["row_sum.largest_opening"]
        assert opening > 0.1 and len(said["warnings"]) == n
        assert all(line.startswith("the model is open: ") and "is missing" in line for line in said["warnings"])


def test_the_surface_of_a_model_is_kept_for_the_same_lamps(root):
    room = model.load(root / "data/office/model.obj")
    kept = surface(room, ("lamp",))
    assert surface(room, ("lamp",)) is kept and surface(room, ()) is not kept
    assert (
        surface(room, ("lamp", "none")) is kept
        and surface(model.load(root / "data/office/model.obj"), ("lamp",)) is not kept
    )
