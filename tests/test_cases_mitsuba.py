"""Mitsuba scenes that were misread once; geometry and cameras against Mitsuba itself, where it is installed."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import cameras, foreign_models, mitsuba_camera, mitsuba_models
from tests.helpers import consumers, ray_casts, rooms

CASES = Path(__file__).parent / "data/cases"
FLIP = '<boolean name="flip_normals" value="true"/>'
LAMP = '<emitter type="area"><rgb name="radiance" value="1,1,1"/></emitter>'


def scene(body, version="3.0.0"):
    return f'<scene version="{version}">{body}</scene>'


def placed(steps):
    return f'<transform name="to_world">{steps}</transform>'


def shape(kind, steps):
    return f'<shape type="{kind}">{placed(steps)}</shape>'


@pytest.fixture
def read(tmp_path):
    """read(elements of a scene, name of a file=content) -> (parts, emits, lines)"""

    def call(body, version="3.0.0", **beside):
        for name, content in beside.items():
            (tmp_path / name.replace("_", ".")).write_text(content)
        content = scene(body, version)
        return mitsuba_models.read(tmp_path / "room.xml", content.encode())

    return call


def refused(call, *words, **more):
    with pytest.raises(BadInput) as caught:
        call(*words, **more)
    (line,) = caught.value.problems
    assert "\n" not in line
    return line


def normal(part):
    _, _, p, faces = part
    n = np.cross(p[faces[0][1]] - p[faces[0][0]], p[faces[0][2]] - p[faces[0][0]])
    return (n / np.linalg.norm(n)).round(9).tolist()


# ---- the case ----


def test_25_flipped_normals_turn_the_corners_round():
    path = CASES / "25-mitsuba-flip-normals/flip.xml"
    (floor, lamp), emits, said = mitsuba_models.read(path, path.read_bytes())
    assert floor[:2] == ("f", "floor") and normal(floor) == [0, 0, 1]
    assert lamp[:2] == ("L", "lamp-L") and normal(lamp) == [0, 0, -1] and emits == {"lamp-L": True} and said == []
    files, _ = foreign_models.convert(path)
    assert foreign_models.emitters(files) == ["lamp-L"]


# ---- geometry ----

SHAPES = {
    "rectangle": "",
    "disk": "",
    "cube": "",
    "sphere": '<point name="center" x="0.2" y="0.1" z="-0.2"/><float name="radius" value="0.8"/>',
    "cylinder": '<point name="p0" value="0.2,0.1,-0.2"/><point name="p1" x="0.9" y="0.1" z="0.7"/>'
    '<float name="radius" value="0.5"/>',
    "obj": '<string name="filename" value="wedge.obj"/>',
    "ply": '<string name="filename" value="wedge.ply"/>',
}
PLACES = {
    "as it is": "",
    "mirrored in x": '<rotate x="0.6" y="0.8" angle="40"/><scale x="-1"/><translate value="0.2, 0.1 0"/>',
    "mirrored in z": '<scale value="1 1 -1"/><rotate value="1,0,0" angle="50"/>',
    "looking": '<lookat origin="0.1,0.2,0.3" target="1,2,3" up="0,0,1"/>',
    "looking without up": '<lookat origin="0.1,0.2,0.3" target="-1,2,-3"/>',
    "by nine numbers": '<matrix value="0 1 0 -1 0 0 0 0 1"/>',
    "by sixteen": '<matrix value="0 2 0 0.1 0 0 2 0.2 2 0 0 0 0 0 0 1"/>',
}
WEDGE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl a\nf 1 3 2\nf 1 2 4\nusemtl b\nf 1 4 3\nf 2 3 4\n"
WEDGE_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
)
INSTANCES = """<shape type="shapegroup" id="g">
<shape type="cube"><transform name="to_world"><scale value=".3"/></transform></shape>
<shape type="rectangle" id="r"><transform name="to_world"><translate x=".6"/></transform></shape></shape>
<shape type="instance"><ref id="g"/><transform name="to_world"><rotate y="1" angle="30"/></transform></shape>
<shape type="instance"><ref id="g"/><transform name="to_world"><translate y="1"/></transform></shape>
<shape type="merge"><shape type="rectangle"/></shape>"""


@pytest.mark.outside
def test_shapes_stand_and_look_as_in_mitsuba(tmp_path):
    """60 rays through each shape, in each place, with and without flip_normals: the same point, the same normal."""
    if why := consumers.absent("mitsuba"):
        pytest.skip(why)
    (tmp_path / "wedge.obj").write_text(WEDGE)
    (tmp_path / "wedge.ply").write_text(WEDGE_PLY)
    rng = np.random.default_rng(1)
    origins = rng.normal(size=(60, 3))
    origins *= 12 / np.linalg.norm(origins, axis=1, keepdims=True)
    ways = rng.uniform(-1, 1, (60, 3)) - origins
    rays = np.stack([origins, ways / np.linalg.norm(ways, axis=1, keepdims=True)], axis=1)
    (tmp_path / "rays.json").write_text(json.dumps(rays.tolist()))
    bodies = {"instances": INSTANCES}
    for kind, told in SHAPES.items():
        for k, steps in enumerate(PLACES.values()):
            for flip in ("", FLIP):
                bodies[f"{kind}-{k}{'f' if flip else ''}"] = f'<shape type="{kind}">{told}{placed(steps)}{flip}</shape>'
    for name, body in bodies.items():
        (tmp_path / f"{name}.xml").write_text(scene(body))
    for name, (theirs, _) in consumers.ask("mitsuba_rays", tmp_path).items():
        path = tmp_path / f"{name}.xml"
        ours = ray_casts.hits(mitsuba_models.read(path, path.read_bytes())[0], rays)
        both = [(a, b) for a, b in zip(theirs, ours, strict=True) if a and b]
        assert sum((a is None) != (b is None) for a, b in zip(theirs, ours, strict=True)) <= 1 and both, name
        off = np.array([np.abs(np.array(a[0]) - b[0]).max() for a, b in both])
        along = np.array([np.dot(a[1], b[1]) for a, b in both])
        if name.startswith(("sphere", "cylinder")):  # facets; one ray may pass beside
            assert np.median(off) < 0.01 and np.sort(along)[1:].min() > 0.97, name
        else:
            assert off.max() < 1e-4 and along.min() > 1 - 1e-5, name


def test_mirrored_shapes_look_as_mitsuba_has_them(read):
    """The same where Mitsuba is not installed, as it answered (3.9.1): a rectangle turns round, a disk does not."""
    mirrored = {"x": placed('<scale x="-1"/>'), "z": placed('<scale z="-1"/>')}
    looks = {
        kind: [normal(read(f'<shape type="{kind}">{m}</shape>')[0][0])[2] for m in mirrored.values()]
        for kind in ("rectangle", "disk")
    }
    assert looks == {"rectangle": [-1, 1], "disk": [1, -1]}


@pytest.mark.parametrize(
    "kind, area",
    [("sphere", 4 * np.pi), ("cylinder", 2 * np.pi), ("disk", np.pi)],
)
def test_round_shapes_become_facets_and_a_line_says_so(read, kind, area):
    ((_, _, p, faces),), _, said = read(f'<shape type="{kind}"/>')
    fan = [np.cross(p[f[k]] - p[f[0]], p[f[k + 1]] - p[f[0]]) / 2 for f in faces for k in range(1, len(f) - 1)]
    assert 0.98 * area < np.linalg.norm(fan, axis=1).sum() < area
    assert said == ["round shapes became 32 facets around, which lie inside by up to 0.48% of the radius"]


def test_an_axis_that_is_not_of_length_1_shears_in_mitsuba(read):
    body = shape("cube", '<rotate x="1" y="1" angle="30"/>')
    assert "its axis has the length 1.41421" in refused(read, body)
    assert len(read(body, version="0.6.0")[0]) == 1  # which made it unit


@pytest.mark.parametrize("kind, steps", [("sphere", '<scale x="2"/>'), ("cylinder", '<scale x="2"/>')])
def test_what_mitsuba_does_not_stretch_is_refused(read, kind, steps):
    assert "which Mitsuba does not" in refused(read, shape(kind, steps))
    assert len(read(shape("cylinder", '<scale z="3"/>'))[0]) == 1


# ---- the language ----


def test_mitsubas_own_cornell_box_as_it_writes_it():
    """Its extents as Mitsuba 3.9.1 tells them; shapes have names instead of ids there."""
    path = CASES.parent / "writers/mitsuba/cornell_box.xml"
    parts, emits, said = mitsuba_models.read(path, path.read_bytes())
    group = {thing: group for thing, group, _, _ in parts}
    assert group == {
        **{"light": "lamp-light", "floor": "white", "ceiling": "white", "back": "white", "small-box": "white"},
        **{"large-box": "white", "green-wall": "green", "red-wall": "red"},
    }
    assert emits == {"lamp-light": True} and said == []
    looks = {thing: np.round(normal(part), 6).tolist() for part in parts for thing in part[:1]}
    assert looks["light"] == [0, -1, 0] and looks["red-wall"] == [1, 0, 0] and looks["green-wall"] == [-1, 0, 0]
    boxes = np.concatenate([p for thing, _, p, _ in parts if "box" in thing])
    np.testing.assert_allclose(boxes.min(axis=0), (-0.708859, -1.01, -0.658859), atol=1e-6)
    np.testing.assert_allclose(boxes.max(axis=0), (0.709603, 0.21, 0.754603), atol=1e-6)
    found, _ = mitsuba_camera.read(path, path.read_bytes(), (256, 256))
    np.testing.assert_allclose(found.intrinsics[0], 128 / math.tan(math.radians(39.3077 / 2)))


def test_groups_are_the_outermost_materials_that_have_an_id(read):
    body = f"""<bsdf type="twosided" id="paint"><bsdf type="diffuse" id="inner"/></bsdf>
    <bsdf type="diffuse" id="paint 2"/><bsdf type="diffuse" id="paint_2"/><emitter type="area" id="glow"/>
    <shape type="cube" id="a"><ref id="paint"/></shape>
    <shape type="cube" id="b"><bsdf type="twosided"><bsdf type="diffuse" id="nested"/></bsdf></shape>
    <shape type="cube" id="c"><bsdf type="diffuse"/></shape>
    <shape type="cube"><ref id="paint 2" name="bsdf"/></shape>
    <shape type="cube" id="e"><ref id="paint_2"/></shape>
    <shape type="cube" id="f"><bsdf type="mask"><ref id="paint"/></bsdf></shape>
    <shape type="cube" id="g"><ref id="glow"/></shape>
    <shape type="cube" id="h">{LAMP.replace("1,1,1", "0")}<ref id="paint"/></shape>
    <shape type="cube" id="i"><medium name="interior" id="fog" type="homogeneous"/><ref id="paint"/></shape>"""
    parts, emits, said = read(body)
    assert {thing: group for thing, group, _, _ in parts} == {
        **{"a": "paint", "b": "nested", "c": "c", "shape3": "paint_2", "e": "paint_2.2"},
        **{"f": "paint", "g": "lamp-g", "h": "paint", "i": "paint"},
    }
    assert emits == {"lamp-g": True}
    assert said == [
        "bsdf paint 2 and bsdf paint_2 have one name: the second is group paint_2.2",
        "materials that let light through are taken for opaque ones: paint",  # the mask
    ]


def test_parameters_aliases_and_included_files(read):
    body = """<default name="size" value="2"/><default name="sizes" value="$size,$size,1"/>
    <default name="size" value="7"/><include filename="parts_xml"/>
    <alias id="wood" as="oak"/>
    <shape type="rectangle" id="r"><ref id="oak"/><transform name="to_world"><scale value="$sizes"/></transform>
    </shape>"""
    parts_xml = scene('<bsdf type="diffuse" id="wood"/><shape type="cube" id="$size-box"><ref id="wood"/></shape>')
    parts, _, _ = read(body.replace("parts_xml", "parts.xml"), parts_xml=parts_xml)
    assert [part[:2] for part in parts] == [("2-box", "wood"), ("r", "wood")]
    assert np.ptp(parts[1][2], axis=0).tolist() == [4, 4, 0]


def test_files_of_versions_before_2(read):
    """camelCase, as the official scenes of version 0.5 and 0.6 are written; a luminaire is an emitter."""
    body = """<shape type="rectangle" id="r"><boolean name="flipNormals" value="true"/>
    <transform name="toWorld"><lookAt origin="0,0,1" target="0,0,2" up="0,1,0"/></transform>
    <luminaire type="area"/></shape>"""
    (part,), emits, _ = read(body, version="0.5.0")
    assert part[1] == "lamp-r" and emits and normal(part) == [0, 0, -1] and part[2][0].tolist()[2] == 1


@pytest.mark.parametrize(
    "body, words",
    [
        ('<include filename="../a.xml"/>', "lies outside the model's folder"),
        ('<include filename="gone.xml"/>', "there is no such file"),
        ('<include filename="self.xml"/>', "include each other deeper than 15"),
        ('<shape type="obj"><string name="filename" value="/etc/a.obj"/></shape>', "lies outside the model's folder"),
        ('<shape type="ply"><string name="filename" value="gone.ply"/></shape>', "there is no such file"),
        ('<shape type="cube"><ref id="gone"/></shape>', "ref: id gone is not there"),
        ('<alias id="gone" as="a"/>', "alias: id gone is not there"),
        ('<shape type="$kind"/>', r"parameter $kind has no <default>: write its value into the file"),
        ('<shape type="serialized" id="s"/>', "shapes that are not read: s (serialized); export them as PLY or OBJ"),
        ('<shape type="hair"/><shape type="sdfgrid"/>', "shape0 (hair), shape1 (sdfgrid)"),
        ('<shape type="cube"><animation name="to_world"/></shape>', "animation: write one to_world"),
        (shape("cube", '<scale value="nan"/>'), "numbers of at most"),
        (shape("cube", '<bend x="1"/>'), "transform: bend is not known"),
        (shape("cube", '<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1"/>'), "its last row"),
        ('<shape type="sphere"><float name="radius" value="0"/></shape>', "radius = 0 is not positive"),
    ],
)
def test_what_cannot_be_read_is_refused(read, body, words):
    assert words in refused(read, body, self_xml=scene('<include filename="self.xml"/>'))


def test_what_multiplies_is_bounded(read):
    doubled = "".join(f'<default name="p{k}" value="$p{k - 1}$p{k - 1}"/>' for k in range(1, 40))
    assert "longer than 100000" in refused(read, f'<default name="p0" value="xxxx"/>{doubled}')
    levels = {f"l{k}_xml": scene(10 * f'<include filename="l{k + 1}.xml"/>') for k in range(9)}
    assert "include each other" in refused(read, '<include filename="l0.xml"/>', **levels, l9_xml=scene(""))
    groups = '<shape type="shapegroup" id="g0"><shape type="cube"/></shape>'
    for k in range(1, 10):
        inside = 10 * f'<shape type="instance"><ref id="g{k - 1}"/></shape>'
        groups += f'<shape type="shapegroup" id="g{k}">{inside}</shape>'
    assert "more than" in refused(read, f'{groups}<shape type="instance"><ref id="g9"/></shape>')


@pytest.mark.parametrize(
    "radiance",
    [
        '<spectrum type="blackbody" name="radiance"><float name="temperature" value="3000"/></spectrum>',
        '<spectrum type="d65" name="radiance"/>',
        '<blackbody name="radiance" temperature="3000K"/>',
        '<spectrum name="radiance" filename="lamp.spd"/>',
        '<texture type="bitmap" name="radiance"><string name="filename" value="lamp.exr"/></texture>',
    ],
)
def test_a_lamp_whose_radiance_is_no_number_is_one(read, radiance):
    """Such spectra have no value, which was taken for one of 0: the lamp was a wall."""
    _, emits, _ = read(f'<shape type="rectangle" id="l"><emitter type="area">{radiance}</emitter></shape>')
    assert emits == {"lamp-l": True}


def test_what_nothing_shows_is_left_out_and_what_light_passes_is_said(read):
    null = '<bsdf type="null" id="air"/>'
    picture = '<texture type="bitmap" name="reflectance"><string name="filename" value="a.png"/></texture>'
    body = f"""<shape type="cube" id="fog">{null}<medium name="interior" type="homogeneous"/></shape>
    <shape type="rectangle" id="l">{null}{LAMP}</shape>
    <shape type="cube" id="pane"><bsdf type="dielectric" id="glass"/></shape>
    <shape type="cube" id="box"><bsdf type="diffuse" id="paint">{picture}</bsdf></shape>"""
    parts, _, said = read(body)
    assert [(thing, group) for thing, group, _, _ in parts] == [("l", "lamp-l"), ("pane", "glass"), ("box", "paint")]
    assert said == [
        "materials that let light through are taken for opaque ones: glass",
        "1 shape that nothing shows (bsdf null), 1 material picture: not read",
    ]


def test_a_shape_of_several_materials_is_refused(read):
    """Versions before 2 part an OBJ by the names of its materials; the first was taken for all of them."""
    body = '<shape type="cube" id="a"><bsdf type="diffuse" name="x"/><bsdf type="diffuse" name="y"/></shape>'
    line = refused(read, body, version="0.6.0")
    assert line.endswith("shape a: has 2 materials (bsdf): export a shape for each of them")


def test_lights_without_faces_and_further_sensors_are_said(read):
    body = '<shape type="cube"/><emitter type="point"/><emitter type="point"/><emitter type="constant"/>'
    _, _, said = read(f'{body}<sensor type="perspective"/><sensor type="perspective"/>')
    assert said == [
        "lights without faces are left out, draw them: point (2), constant",
        "1 sensor after the first: not read",
    ]


# ---- the camera ----

LOOK = placed('<lookat origin="1,2,3" target="0,0.5,1" up="0,0,1"/>')
WIDE = '<film type="hdrfilm"><integer name="width" value="320"/><integer name="height" value="240"/>'
FILMS = {
    "wide": f"{WIDE}</film>",
    "tall": '<film type="hdrfilm"><integer name="width" value="200"/><integer name="height" value="340"/></film>',
    "cropped": f'{WIDE}<integer name="crop_offset_x" value="20"/><integer name="crop_offset_y" value="30"/>'
    '<integer name="crop_width" value="200"/><integer name="crop_height" value="100"/></film>',
}
SENSORS = {
    **{axis: f'<float name="fov" value="55"/><string name="fov_axis" value="{axis}"/>'
       for axis in ("x", "y", "diagonal", "smaller", "larger")},
    "untold": "",
    "35mm": '<string name="focal_length" value="35mm"/>',
    "shifted": '<float name="fov" value="50"/><float name="principal_point_offset_x" value="0.1"/>'
    '<float name="principal_point_offset_y" value="-0.05"/>',
}  # fmt: skip


def sensor(told, film, kind="perspective", look=LOOK):
    return scene(f'<shape type="cube"/><sensor type="{kind}">{told}{film}{look}</sensor>')


@pytest.mark.outside
def test_sensors_see_what_mitsuba_sees(tmp_path):
    """Points along Mitsuba's own rays, in single precision, fall on the pixels that they went through: 1e-3 px."""
    if why := consumers.absent("mitsuba"):
        pytest.skip(why)
    (tmp_path / "rays.json").write_text("[]")
    for name, told in SENSORS.items():
        for film, words in FILMS.items():
            (tmp_path / f"{name}-{film}.xml").write_text(sensor(told, words))
    thin = '<float name="aperture_radius" value="0.1"/><float name="focus_distance" value="2"/>'
    (tmp_path / "thin.xml").write_text(sensor(thin + SENSORS["y"], FILMS["wide"], "thinlens"))
    (tmp_path / "no film.xml").write_text(sensor("", ""))
    told = consumers.ask("mitsuba_rays", tmp_path)
    assert len(told) == 3 * len(SENSORS) + 2
    for name, (_, seen) in told.items():
        path = tmp_path / f"{name}.xml"
        size = round(seen[3][0]) + 1, round(seen[3][1]) + 1
        found, _ = mitsuba_camera.read(path, path.read_bytes(), size)
        q = found.project([np.array(origin) + 3 * np.array(way) for _, _, origin, way in seen])
        assert np.abs(q - [(x, y) for x, y, _, _ in seen]).max() < 1e-3, name


def test_a_sensor_by_hand(tmp_path):
    """At (0, 0, 5), looking down, y up in the picture: x = 1 is 1 / 5 of the focal length to the right."""
    look = placed('<lookat origin="0,0,5" target="0,0,0" up="0,1,0"/>')
    content = sensor('<float name="fov" value="90"/>', FILMS["wide"], look=look).encode()
    found, said = mitsuba_camera.read(tmp_path / "a.xml", content, (640, 480))
    assert found.width == 640 and said == [
        "taken from the scene's sensor (perspective)",
        "its film of 320 x 240 px is scaled by 2",
    ]
    np.testing.assert_allclose(found.intrinsics, [320, 320, 319.5, 239.5])
    seen = found.project([(0, 0, 0), (1, 0, 0), (0, 1, 0)])
    np.testing.assert_allclose(seen, [(319.5, 239.5), (383.5, 239.5), (319.5, 175.5)])
    old = content.replace(b"3.0.0", b"0.6.0").replace(b"to_world", b"toWorld").replace(b"lookat", b"lookAt")
    again, _ = mitsuba_camera.read(tmp_path / "a.xml", old, (640, 480))
    np.testing.assert_allclose(again.T, found.T)


@pytest.mark.parametrize(
    "body, size, words",
    [
        (
            sensor("", FILMS["wide"], "orthographic"),
            (320, 240),
            "the scene's sensor is orthographic, which is no pinhole",
        ),
        (sensor("", FILMS["wide"]), (320, 200), "320 x 240 px, which is not the shape of the photograph"),
        (scene('<shape type="cube"/>'), (320, 240), None),
    ],
)
def test_sensors_that_are_not_taken(tmp_path, body, size, words):
    found, said = mitsuba_camera.read(tmp_path / "a.xml", body.encode(), size)
    assert found is None and (words is None) == (not said) and (words or "") in " ".join(said)


@pytest.mark.parametrize(
    "told, steps, words",
    [
        ('<float name="fov" value="50"/><string name="focal_length" value="50mm"/>', "", "are both told"),
        ('<float name="fov" value="180"/>', "", "180 degrees"),
        ('<string name="focal_length" value="nan"/>', "", "focal_length"),
        ('<string name="fov_axis" value="w"/><float name="fov" value="50"/>', "", "fov_axis: w is none of"),
        ("", '<scale value="2"/>', "to_world scales"),
        ("", '<scale x="-1"/>', "to_world mirrors the picture"),
    ],
)
def test_sensors_that_no_camera_is_are_refused(tmp_path, told, steps, words):
    content = sensor(told, FILMS["wide"], look=placed(steps)).encode()
    assert words in refused(mitsuba_camera.read, tmp_path / "a.xml", content, (320, 240))


def test_the_sensor_is_the_camera_where_no_other_is_given(run, tmp_path):
    """A room with its lamp and its sensor is a whole scene: nothing is missing."""
    rooms.write(tmp_path / "walls.obj", rooms.room())
    body = '<bsdf type="diffuse" id="BrushedAluminium"/><shape type="obj"><ref id="BrushedAluminium"/>'
    body += f'<string name="filename" value="walls.obj"/></shape><shape type="rectangle" id="p">{LAMP}{FLIP}'
    body += placed('<translate value="2 1.5 2.4"/>') + "</shape>"
    look = placed('<lookat origin="0.4,0.4,1.5" target="3,2,1" up="0,0,1"/>')
    body += f'<sensor type="perspective"><float name="fov" value="60"/>{FILMS["wide"]}{look}</sensor>'
    (tmp_path / "room.xml").write_text(scene(body))
    words = ["--data", tmp_path / "data", "--name", "x", "--model", tmp_path / "room.xml"]
    done = run("stages/new_scene.py", *words, "--photo", CASES / "base/room.png")
    assert done.returncode == 0 and "missing" not in done.stdout, done.stderr + done.stdout
    assert "camera: taken from the scene's sensor (perspective)" in done.stdout
    made = cameras.read_cameramodel(tmp_path / "data/x/left.posed.cameramodel")
    np.testing.assert_allclose(made.centre, (0.4, 0.4, 1.5), atol=1e-9)
    assert np.isclose(made.K[0, 0], 160 / math.tan(math.radians(30)))
    assert "lamps: {lamp-p: unknown}" in (tmp_path / "data/x/scene.yaml").read_text()


def test_a_lamp_is_guessed_by_whole_words_and_said(run, tmp_path):
    rooms.write(tmp_path / "room.obj", {**rooms.room(), **rooms.LAMP})
    text = (tmp_path / "room.obj").read_text()
    groups = sorted({line.split()[1] for line in text.splitlines() if line.startswith("usemtl")} - {"lamp"})
    for old, new in zip(groups, ("BrushedAluminium", "light_oak", "Clamp", "Illuminati"), strict=False):
        text = text.replace(f"usemtl {old}\n", f"usemtl {new}\n")
    (tmp_path / "room.obj").write_text(text.replace("usemtl lamp\n", "usemtl CeilingLamp1\n"))
    words = ["--data", tmp_path / "data", "--name", "x", "--model", tmp_path / "room.obj"]
    done = run("stages/new_scene.py", *words, "--photo", CASES / "base/room.png")
    assert done.returncode == 0, done.stderr
    assert "lamps: guessed by their names: CeilingLamp1\n" in done.stdout
    assert "lamps: {CeilingLamp1: unknown}" in (tmp_path / "data/x/scene.yaml").read_text()
