"""Sound files of every kind, ways to spoil them, and what reads them.

    for kind in fuzz.KINDS:
        outcomes = fuzz.run(kind, folder, count=1000, seed=1)

A mutation is of bytes, or of what the format means: of JSON's and YAML's values, of a PNG's chunks (with right
checksums), of an archive's arrays. Whatever is accepted must be finite.
"""

import contextlib
import copy
import io
import json
import os
import re
import struct
import zlib
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np

from lib.core.stage import BadInput
from tests.helpers import confined, mistakes, profiles

WIDTH, HEIGHT = mistakes.WIDTH, mistakes.HEIGHT
NUMBERS = (
    *("0", "-1", "-0", "1e308", "1e-320", "-1e200", "nan", "inf", "1e999", "9" * 400, "9" * 5000, "4294967295"),
    *("2147483648", "0.5", "1/0", "0x10", "1_0", "\u0663", "", "99999999999999999999", "1e15", "-2"),
)
WORDS = (
    *("", "\0", "'", '"', "[", "{", "]" * 50, "[" * 5000, "{" * 500, "- " * 300, ":", "#", "\\", "\n", "\r", "\t", ","),
    *("!!bool x", "&a [*a]", "*a", "<<: x", "../../../etc/passwd", "/dev/zero", "\ufeff", "\ud7ff", "%s%n", "null"),
)
VALUES = (
    *(None, True, 0, -1, 10**18, 10**400, 1e308, 5e-324, "", "x", "../../x", [], {}, [[]], [None], {"": None}),
    *([1e308, 1e308, 1e308], [0, 0, 0], "nan", [["x"]], -0.5, 0.5, [1] * 1000, {"a": {"b": {}}}),
)


class Kind(NamedTuple):
    """name : of the file;  content : of a sound one, bytes;  read : takes the path;  change : (Random, bytes) -> bytes
    beside : {name: bytes}, other files that it needs
    """

    name: str
    content: bytes
    read: object
    change: object = None
    beside: dict = {}


# ---- spoiling bytes ----


def spoilt(random, data):
    """The bytes after one to four mutations."""
    data = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        random.choice(BYTES)(random, data)
    return bytes(data)


def _span(random, data, most=64):
    start = random.randrange(len(data) + 1)
    return slice(start, min(len(data), start + random.randint(1, most)))


def _flip(random, data):
    if data:
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def _set(random, data):
    if data:
        data[random.randrange(len(data))] = random.choice((0, 1, 9, 10, 32, 127, 128, 255))


def _cut(random, data):
    del data[_span(random, data)]


def _truncate(random, data):
    del data[random.randrange(len(data) + 1) :]


def _insert(random, data):
    place = random.randrange(len(data) + 1)
    data[place:place] = random.randbytes(random.randint(1, 16))


def _repeat(random, data):
    span = _span(random, data)
    data[span] = bytes(data[span]) * random.choice((2, 3, 100))


def _swap(random, data):
    a, b = _span(random, data), _span(random, data)
    data[a], data[b] = bytes(data[b]), bytes(data[a])


def _extreme(random, data):
    """A binary number of 2, 4 or 8 bytes."""
    form = random.choice(("<H", "<I", ">I", "<Q", "<d", "<f"))
    values = {"d": (np.nan, np.inf, 1e308), "f": (np.nan, np.inf, 3e38)}.get(form[1])
    top = (1 << 8 * struct.calcsize(form)) - 1 if values is None else 0
    if len(data) >= 8:
        value = random.choice(values or (0, 1, top, top // 2, top // 2 + 1, min(top, 10**9)))
        struct.pack_into(form, data, random.randrange(len(data) - 7), value)


def _number(random, data):
    _replaced(random, data, rb"[-+]?[0-9]+\.?[0-9]*(?:[eE][-+]?[0-9]+)?", random.choice(NUMBERS))


def _word(random, data):
    _replaced(random, data, rb"[A-Za-z_]+|[\[\]{}:,'\"]", random.choice(WORDS))


def _replaced(random, data, pattern, text):
    found = [m.span() for m in re.finditer(pattern, bytes(data))]
    if found:
        start, end = random.choice(found)
        data[start:end] = text.encode("utf-8", "surrogatepass")


BYTES = (
    _flip,
    _flip,
    _set,
    _cut,
    _truncate,
    _insert,
    _repeat,
    _swap,
    _extreme,
    _extreme,
    _number,
    _number,
    _number,
    _word,
)
BYTES = (*BYTES, _word)


# ---- spoiling what is meant ----


def of_value(random, value):
    """A tree of lists and tables with one to three places changed."""
    value = copy.deepcopy(value)
    for _ in range(random.choice((1, 1, 2, 3))):
        places = list(_places(value))
        if not places:
            return random.choice(VALUES)
        holder, key = random.choice(places)
        deed = random.randrange(4)
        if deed == 0:
            del holder[key]
        elif deed == 1 and isinstance(holder, dict):
            holder[random.choice((*WORDS, "x"))] = holder.pop(key)
        elif deed == 1:
            holder.append(copy.deepcopy(holder[key]))
        else:
            holder[key] = copy.deepcopy(random.choice(VALUES))
    return value


def _places(value):
    for key, item in value.items() if isinstance(value, dict) else enumerate(value):
        yield value, key
        if isinstance(item, (dict, list)):
            yield from _places(item)


def of_json(random, data):
    return json.dumps(of_value(random, json.loads(data))).encode("utf-8", "surrogatepass")


def of_yaml(random, data):
    import yaml

    return yaml.safe_dump(of_value(random, yaml.safe_load(data))).encode("utf-8", "surrogatepass")


def of_glb(random, data):
    """The JSON of a GLB."""
    length = int.from_bytes(data[12:16], "little")
    words = of_json(random, data[20 : 20 + length])
    words += b" " * (-len(words) % 4)
    rest = data[20 + length :]
    return (
        struct.pack("<4sII", b"glTF", 2, 20 + len(words) + len(rest))
        + struct.pack("<I4s", len(words), b"JSON")
        + words
        + rest
    )


def of_png(random, data):
    """A chunk of a PNG, with its right checksum."""
    chunks, at = [], 8
    while at < len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    k = random.randrange(len(chunks))
    kind, content = chunks[k]
    chunks[k] = random.choice((kind, kind, kind, b"IDAT", b"tRNS", b"PLTE")), spoilt(random, content)
    parts = [struct.pack(">I", len(c)) + t + c + struct.pack(">I", zlib.crc32(t + c)) for t, c in chunks]
    return data[:8] + b"".join(parts)


def of_text(random, data):
    """The text of a PNG that a JPEG was made to: other numbers, or no numbers at all."""
    from lib.given import image, picture_files

    text = picture_files.text_of_png(data, image.JPEG_KEY).encode("latin-1")
    return _of_a_jpeg(random.choice((of_json, spoilt))(random, text))


def _of_a_jpeg(text):
    from lib.given import image, picture_files

    return picture_files.with_text(PNG, image.JPEG_KEY, text.decode("latin-1"))


def _profiled(kind, profile):
    """A photograph of 30 x 20 px with this ICC profile."""
    from PIL import Image

    target, picture = io.BytesIO(), mistakes.picture()[:20, :30]
    if kind == "TIFF":
        import tifffile

        words = {"iccprofile": profile, "photometric": "rgb", "planarconfig": "separate", "compression": "deflate"}
        tifffile.imwrite(target, np.moveaxis(picture, -1, 0).astype(np.uint16) * 257, **words)
        return target.getvalue()
    exif = Image.Exif()
    exif[274] = 6
    exif.get_ifd(0x8769)[0xA001] = 0xFFFF
    Image.fromarray(picture).save(target, kind, icc_profile=profile, exif=exif)
    return target.getvalue()


def of_profile(kind):
    """A change of the profile in a sound file: of its bytes, its tags or its numbers."""

    def change(random, data):
        profile = bytearray(PROFILE)
        if random.random() < 0.5:
            at = random.randrange(128, len(profile) - 4)
            profile[at : at + 4] = struct.pack(">I", random.choice((0, 1, 3, 2**16, 2**31, 2**32 - 1, len(profile))))
            return _profiled(kind, bytes(profile))
        return _profiled(kind, spoilt(random, bytes(profile)))

    return change


def of_tiff(random, data):
    """Numbers of the directory of a TIFF, little-endian, of tifffile's."""
    data = bytearray(data)
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    for _ in range(random.choice((1, 1, 2, 3))):
        place = at + 2 + 12 * random.randrange(count)
        what = random.choice((0, 2, 4, 8))
        size = 2 if what in (0, 2) else 4
        value = random.choice((0, 1, 2, 3, 7, 8, 16, 255, 256, 259, 317, 322, 65535, 2**31, 2**32 - 1, at, len(data)))
        data[place + what : place + what + size] = (value % (1 << 8 * size)).to_bytes(size, "little")
    return bytes(data)


def _parts_of_exr():
    import tempfile

    import OpenEXR

    plane = np.full((20, 30), 0.5, np.float32)
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    colours = {f"beauty.{c}": plane for c in "RGB"}
    p3 = {"chromaticities": (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)}
    parts = [OpenEXR.Part(head | p3, {"Z": plane}, "depth"), OpenEXR.Part(head | p3, colours, "picture")]
    with tempfile.TemporaryDirectory() as folder:
        with OpenEXR.File(parts) as file:
            file.write(f"{folder}/a.exr")
        return Path(f"{folder}/a.exr").read_bytes()


def of_npz(random, data):
    """Arrays of other shapes and kinds, in a sound archive."""
    with np.load(io.BytesIO(data)) as file:
        arrays = {name: file[name] for name in file.files}
    for name in random.sample(sorted(arrays), min(len(arrays), random.choice((1, 1, 2)))):
        a = arrays[name]
        made = (
            *(a.ravel(), a[..., None], a[:0] if a.ndim else a, np.array(3), np.array("x"), a.astype(str)),
            *(np.full(a.shape, np.nan), np.full(a.shape, 2**62), -np.ones(a.shape, int), np.zeros(a.shape, "<f4")),
        )
        arrays[name] = random.choice(made)
        if random.random() < 0.2:
            del arrays[name]
    target = io.BytesIO()
    np.savez(target, **arrays)
    return target.getvalue()


# ---- running ----


def load():
    """What the readers import, before memory is bounded."""
    for kind in KINDS.values():
        with contextlib.suppress(BadInput, OSError):
            kind.read(Path("/nonexistent/file"))


def inputs(kind, count, seed):
    """`count` spoilt files, bytes; the same for the same seed."""
    random = Random(f"{kind.name} {seed}")
    for number in range(count):
        change = kind.change if kind.change and number % 2 else spoilt
        yield change(random, kind.content)


def run(kind, folder, count, seed):
    """[(content, Outcome)] of so many spoilt files, each written to the folder and read."""
    folder = Path(folder)
    for name, content in kind.beside.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    path = folder / kind.name
    path.parent.mkdir(parents=True, exist_ok=True)

    def read(content):
        path.write_bytes(content)
        kind.read(path)

    contents = [kind.content, *inputs(kind, count, seed)]
    outcomes = list(confined.calls([(read, content) for content in contents], keep=False))
    assert outcomes[0].end == "accepted", (kind.name, outcomes[0])
    return list(zip(contents, outcomes, strict=True))[1:]


# ---- the kinds ----


def _finite(*arrays):
    for array in arrays:
        array = np.asarray(array)
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise AssertionError("a value that is not finite was accepted")


def _scene(path):
    from lib.planning import scene
    from lib.planning.pipeline import read_pipeline

    found = scene.read(path.parent, read_pipeline(Path(__file__).parents[2] / "pipeline.yaml"))
    if found.problems:
        raise BadInput(*found.problems)


def _lens(path):
    from lib.given import lenses

    lens = lenses.read(path)
    _finite(lens.intrinsics, lens.T_cam_ref, lens.centre)


def _model(path):
    from lib.given import model

    found = model.load(path)
    _finite(found.vertices, found.facet_normal, found.facet_offset)


def _converted(path):
    from lib.given import foreign_models
    from lib.given.model import mesh
    from lib.given.model.glb import read_glb
    from lib.given.model.obj import read_obj

    files = foreign_models.convert(path)[0]
    foreign_models.emitters(files)
    name = next(name for name in files if name.startswith("model."))
    made = (read_glb if name.endswith(".glb") else read_obj)(name, files[name])
    _finite(mesh.build(name, made).vertices)


def _mitsuba(path):
    from lib.given import mitsuba_camera

    found, _ = mitsuba_camera.read(path, path.read_bytes() if path.is_file() else b"", (640, 480))
    if found:
        _finite(found.intrinsics, found.T)
    _converted(path)


def _usd(path):
    """What usd_models.read does, in a fork of this process instead of a new interpreter: a hundred times as fast."""
    import tempfile

    from lib.given import mesh_files, usd_models, usd_process, usd_stage
    from lib.given.model import mesh
    from lib.given.model.obj import read_obj

    os.environ.update(usd_models.SETTINGS)
    usd_stage.load()
    with tempfile.TemporaryDirectory() as scratch:
        answer = f"{scratch}/answer"
        if (child := os.fork()) == 0:
            try:
                usd_process.main(str(path), str(path.absolute()), answer)
            finally:
                os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        parts, _, _ = usd_models.answered(path, answer, status)
    _finite(mesh.build("model.obj", read_obj("model.obj", mesh_files.obj(parts))).vertices)


def _camera(path):
    from lib.given import foreign_cameras

    found = foreign_cameras.read(path, (640, 480), "left.png" if path.suffix in (".txt", ".bin") else None)
    _finite(found.intrinsics, np.eye(4) if found.T is None else found.T)


def _photograph(path):
    from lib.given import image

    image.format_problem(path)
    _finite(image.read_photograph(path).values)


def _labels(path):
    from lib.given import image

    image.read_labels(path)


def _points(path):
    from lib.given import picks

    found = picks.read(path)
    _finite(found.q, found.p, found.sigma)


def _lines(path):
    from lib.given import picks

    found = picks.read(None, path)
    _finite(found.ends, found.p_ends)


def _corners(path):
    from lib.vision import boards

    boards.read_vnl(path, (2, 2))


def _record(name):
    def read(path):
        from lib.core import record
        from lib.verdict import records

        record.read(path, getattr(records, name))

    return read


def _materials(path):
    from lib.given import materials

    found = materials.read(path)
    materials.write(path.with_name("again.json"), found)


def _curve(path):
    from lib.given import materials

    materials.read_curve(path)


def _facets(path):
    from lib.vision import facets_file

    found = facets_file.read_scene(path)
    _finite(found.m, found.covariance, *found.polygons)


def _report(path):
    from lib.verdict import stage_reports

    stage_reports.read(path)


def _matches(path):
    from lib.vision import matches

    matches.read_matches(path)


def _walk(path):
    from lib.given import motion

    _finite(motion.read_csv(path))


def _arrays(path):
    from lib.core import artefact

    artefact.read_npz(path, "a", "b")


YAML = b"""board: {corners: [9, 6], square_m: 0.03}
lens: LENSMODEL_OPENCV8
camera: {eye: [4, 1, 1.6], at: [1, 3, 1], up: [0, 0, 1], hfov_deg: 60}
lamps: {lamp: {emittance: unknown, lobe: {aim: [0, 0, -1], exponent: 8}, place_sigma_m: 0.1}, sky: [1.0, 2, 3]}
reference: {wall: [0.8, 0.8, 0.8]}
transfer: {gamma: 2.2}
surfaces: {board: diffuse, door: mirror}
goals: [materials.json, rendered.png]
model: {unit: mm, up: y}
explain: [curve, pose]
refine: [objects]
movable: [chair]
photos: {}
augment:
- {name: a, change: {wall: {rho_d: [0.6, 0.1, 0.1]}}}
- {name: b, add: {ellipsoid: [0.2, 0.2, 0.3], at: [2, 1, 1], material: {kind: mirror}}, lamps: {lamp: [2, 2, 4]}}
- {name: c, add: [{sphere: 1.0, at: [1, 0, 0], material: {kind: glossy, rho_d: [0.1, 0.1, 0.1], rho_s: [0.1, 0.1, 0.1],
   alpha: [0.1, 0.1]}}], remove: [carton], move: {chair: [1, 0, 0]}}
exports: [gltf, usd]
params: {segment: {lambda: 0.05}}
"""
LENS = b"""{ 'lensmodel': 'LENSMODEL_OPENCV8', # of mrcal
  'intrinsics': [ 500., 510., 320, 240, .1, -0.01, 1e-3, 0, 0, 0, 0, 0 ],
  'extrinsics': [ 0.1, 0.2, 3.0, -1, 2, 1.5 ], 'imagersize': [ 640, 480 ],
  'optimization_inputs': b'abc' }
"""
PLY = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 1 2
3 0 1 3
"""
XML = b"""<?xml version="1.0"?><scene version="3.0.0"><default name="size" value="2"/><include filename="y.xml"/>
<bsdf type="diffuse" id="white"/><alias id="white" as="paint"/><emitter type="point"/>
<sensor type="perspective"><float name="fov" value="60"/><string name="fov_axis" value="larger"/>
<float name="principal_point_offset_x" value="0.1"/>
<transform name="to_world"><lookat origin="1,1,1" target="0,0,0" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="640"/><integer name="height" value="480"/></film></sensor>
<shape type="rectangle" id="floor"><ref id="paint"/><transform name="to_world"><scale x="$size" y="3"/>
<rotate x="1" y="0" z="0" angle="90"/><translate value="1, 2, 3"/></transform></shape>
<shape type="sphere"><point name="center" x="1" y="2" z="3"/><float name="radius" value="$size"/>
<boolean name="flip_normals" value="true"/></shape>
<shape type="cylinder"><point name="p0" value="1 2 3"/><point name="p1" value="1 2 5"/></shape>
<shape type="shapegroup" id="g"><shape type="disk"/></shape>
<shape type="instance"><ref id="g"/><transform name="to_world"><translate y="1"/></transform></shape>
<shape type="cube" id="box"><bsdf id="red"/><transform name="to_world">
<lookat origin="1,1,1" target="0,0,0" up="0,0,1"/>
<matrix value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/></transform>
<emitter type="area"/></shape></scene>
"""
FSPY = {
    "principalPoint": {"x": 0.01, "y": -0.02},
    "horizontalFieldOfView": 1.0,
    "imageWidth": 640,
    "imageHeight": 480,
    "cameraTransform": {"rows": [[1, 0, 0, 1.5], [0, 0, -1, 2], [0, 1, 0, 1], [0, 0, 0, 1]]},
}


def _segments(x):
    """Two lines from the side x of the picture towards its middle."""
    return [[{"x": x, "y": y}, {"x": 0.5, "y": end}] for y, end in ((0.2, 0.3), (0.8, 0.7))]


PROJECT = {
    "globalSettings": {"calibrationMode": "TwoVanishingPoints"},
    "calibrationSettingsBase": {
        **{"referenceDistanceUnit": "Meters", "referenceDistance": 2.0, "referenceDistanceAxis": "zPositive"},
        **{"firstVanishingPointAxis": "xPositive", "secondVanishingPointAxis": "yPositive", "cameraData": {}},
    },
    "calibrationSettings2VP": {"quadModeEnabled": False, "principalPointMode": "Default"},
    "controlPointsStateBase": {
        "firstVanishingPoint": {"lineSegments": _segments(0.1)},
        "principalPoint": {"x": 0.5, "y": 0.5},
        "origin": {"x": 0.5, "y": 0.6},
        "referenceDistanceAnchor": {"x": 0.4, "y": 0.5},
        "referenceDistanceHandleOffsets": [0.1, 0.3],
    },
    "controlPointsState2VP": {
        "secondVanishingPoint": {"lineSegments": _segments(0.9)},
        "thirdVanishingPoint": {"lineSegments": []},
    },
    "image": {"width": 640, "height": 480},
}  # fmt: skip
BLENDER = {
    **{"type": "PERSP", "lens_px": [500.0, 500.0], "shift_px": [0.0, 0.0], "size_px": [640, 480]},
    "matrix_world": [1, 0, 0, 1, 0, 0, -1, 2, 0, 1, 0, 1, 0, 0, 0, 1],
}
CAMERAS_TXT = b"# Camera list\n1 OPENCV 640 480 500 510 320 240 .1 0 0 0\n"
IMAGES_TXT = b"# Image list\n1 1 0 0 0 1 2 3 1 left.png\n1.5 2.5 -1\n2 .5 .5 .5 .5 1 2 3 1 right.png\n\n"
BARE_IMAGES = b"1 1 0 0 0 1 2 3 1 left.png\n2 .5 .5 .5 .5 1 2 3 1 right.png\n"
CAMERAS_BIN = struct.pack("<Q", 1) + struct.pack("<IiQQ4d", 1, 1, 640, 480, 500, 510, 320, 240)
IMAGES_BIN = (
    struct.pack("<Q", 1) + struct.pack("<I7dI", 1, 1, 0, 0, 0, 1, 2, 3, 1) + b"left.png\0" + struct.pack("<Q", 0)
)
OPENCV_YML = b"""%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500., 0., 320., 0., 510., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ .1, 0., 0., 1e-3, 0. ]
rvec: [ 0.1, 0.2, 0.3 ]
tvec: [ 1., 2., 3. ]
"""
OPENCV_XML = b"""<?xml version="1.0"?><opencv_storage><image_width>640</image_width><image_height>480</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>500. 0. 320. 0. 510. 240. 0. 0. 1.</data></camera_matrix></opencv_storage>
"""
OPENCV_JSON = {
    "camera_matrix": {"rows": 3, "cols": 3, "data": [500, 0, 320, 0, 510, 240, 0, 0, 1.0]},
    "image_width": 640,
}
ROS_YAML = b"""header: {frame_id: cam}
height: 480
width: 640
distortion_model: plumb_bob
d: [0.1, 0.0, 0.0, 0.001, 0.0]
k:
- 500.0
- 0.0
- 320.0
- 0.0
- 510.0
- 240.0
- 0.0
- 0.0
- 1.0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0}
---
"""
KALIBR = b"""cam0:
  camera_model: pinhole
  distortion_coeffs: [0.05, -0.01, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [500.0, 510.0, 320, 240]
  resolution: [640, 480]
  T_cam_imu: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""
NERF = {
    **{"fl_x": 500.0, "fl_y": 510.0, "cx": 320, "cy": 240, "w": 640, "h": 480, "k1": 0.1, "camera_model": "OPENCV"},
    **{"applied_transform": [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]], "applied_scale": 2.0},
    "frames": [{"file_path": "a/left.png", "transform_matrix": np.eye(4).tolist()}],
}
POINTS = b'x_px,y_px,X,Y,Z,sigma_px,name\n1,2,0,0,0,1,a\n3,4,1,0,0,1,b\n# c\n5,6.5,0,1,0,2,"c,d"\n7,8,0,0,1e-1,1,e\n'
LINES = b"x1_px,y1_px,x2_px,y2_px,X1,Y1,Z1,X2,Y2,Z2\n1,2,3,4,0,0,0,1,0,0\n5,6,7,8,0,0,1,1,1,1\n"
VNL = b"# filename x y level\n" + b"".join(
    b"%s-1.png %d 2.5 0\n" % (s, k) for s in (b"left", b"right") for k in range(4)
)
MATERIALS = {
    "status": "converged",
    "groups": {
        "wall": {
            **{"kind": "glossy", "rho_d": [0.7, 0.7, 0.6], "rho_s": [0.1, 0, 0], "alpha": [0.1, 0.1]},
            **{"tangent": [1, 0, 0], "texture": {"3": "textures/a.exr"}, "sigma": {"rho_d": [0.1, 0.1, 0.1]}},
            **{"pixels": 8, "identified": True},
        }
    },
    "lamps": {"lamp": {"emittance": [1, 1, 1], "lobe": {"aim": [0, 0, 1], "exponent": 2}, "sigma": None}},
    "transfer": {"kind": "gamma", "gamma": 2.02, "sigma": 0.01, "asked": "auto", "rivals": {"srgb": 3.0}},
    "scale": "lamps",
    "image": {"rmse": 0.004, "iterations": 4},
    "explained": [{"cause": "pose", "subject": None, "values": {"rt_correction": [0, 0, 0, 0, 0, 0]}, "rivals": []}],
    "why": [{"cause": "units", "subject": None, "text": "x", "evidence_nats": 3.0}],
}  # fmt: skip
CURVE = {"kind": "curve", "linear": [k / 63 for k in range(64)], "display": [(k / 63) ** 0.5 for k in range(64)]}
FACETS = {
    **{"frame": "left", "unit": "m"},
    "facets": [
        {
            **{"left_label": 1, "right_label": 2, "plane": {"n": [0, 0, -1], "d": -2.0}, "overlap": 0.9},
            **{"polygon": [[0, 0, 2], [1, 0, 2], [0, 1, 2]], "covariance": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
        }
    ],
}
POSE = {"rt_cam_world": [0, 0, 0, 1, 2, 3], "status": "unique", "covariance": np.eye(6).tolist(), "ambiguous": []}
REPORT = {
    **{"status": "complete", "wall_s": 1.0, "cpu_s": 1.0, "waited_s": 1.5, "peak_mb": 9.0, "imports_s": 0.1},
    **{"warnings": ["x"], "errors": [{"name": "a", "value": 1.0, "unit": "1"}], "arguments": {"a": 1}},
    **{
        "trace": [{"cpu_s": 1.0, "wall_s": 1.0, "iteration": 0}],
        "timings": {"a": {"cpu_s": 1, "wall_s": 1, "calls": 1}},
    },
}
MATCHES = b"left_label,right_label,similarity\n1,2,0.9\n2,1,0.8\n"
PLACES = b"eye_x,eye_y,eye_z,at_x,at_y,at_z\n0,0,1,1,1,1\n# x\n1,0,1,1,1,1.5\n"


def _stl():
    corners = [(0, 0, 1), (0, 0, 0), (1, 0, 0), (0, 1, 0)]
    facet = struct.pack("<12fH", *(x for p in corners for x in p), 0)
    return b"made by hand".ljust(80) + struct.pack("<I", 2) + facet + facet[:-2] + b"\0\0"


def _text_stl():
    corners = [(0, 0, 1), (0, 0, 0), (1, 0, 0), (0, 1, 0)]
    rows = [" ".join(map(str, p)) for p in corners]
    loop = "outer loop\n" + "".join(f"vertex {row}\n" for row in rows[1:]) + "endloop\nendfacet\n"
    return f"solid a\nfacet normal {rows[0]}\n{loop}endsolid a\nSOLID b\nFACET NORMAL 0 0 1\n{loop}ENDSOLID\n".encode()


def _binary_ply():
    head = PLY[: PLY.index(b"0 0 0")].replace(b"ascii", b"binary_little_endian")
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], "<f4").tobytes()
    return head + points + struct.pack("<B3iB3i", 3, 0, 1, 2, 3, 0, 1, 3)


def _mixed_ply():
    """Big-endian, lists of several lengths, strips."""
    head = PLY[: PLY.index(b"0 0 0")].replace(b"ascii", b"binary_big_endian")
    head = head.replace(b"end_header", b"element tristrips 1\nproperty list int int vertex_indices\nend_header")
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], ">f4").tobytes()
    return head + points + struct.pack(">B3iB4ii5i", 3, 0, 1, 2, 4, 0, 1, 3, 2, 5, 0, 1, 2, -1, 3)


def _glb():
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], "<f4").tobytes()
    binary = points + np.array([0, 1, 2, 0, 1, 3], "<u2").tobytes()
    gltf = {
        **{"asset": {"version": "2.0", "generator": "anasyn"}, "scene": 0, "scenes": [{"nodes": [0]}]},
        "materials": [{"name": "wall"}],
        "nodes": [
            {"name": "room", "mesh": 0, "rotation": [0, 0, 0, 1], "scale": [1, 1, 1], "children": [1]},
            {"mesh": 0, "matrix": np.eye(4).ravel().tolist()},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0, "mode": 4}]}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
        "extras": {"objects": ["room"], "groups": ["wall"], "absent": []},
    }
    return _packed(gltf, binary)


def _rich_glb():
    """What other tools write: integers, sparse values, instances, a skin, a morph target, lights, hidden nodes."""
    parts = [
        np.array([(0, 0, 0, 0), (127, 0, 0, 0), (0, 127, 0, 0), (0, 0, 127, 0)], "<i1"),  # 0: positions, 4 bytes each
        np.array([0, 1, 2, 0, 1, 3], "<u2"),  # 1: indices
        np.array([(0, 0, 0), (2, 0, 0)], "<f4"),  # 2: places of instances
        np.zeros((4, 4), "<u1"),  # 3: joints
        np.tile(np.array([255, 0, 0, 0], "<u1"), (4, 1)),  # 4: weights
        np.array([3], "<u4"),  # 5, 6: one sparse value
        np.array([(0, 0, 0.5)], "<f4"),
    ]
    starts = np.cumsum([0, *(a.nbytes for a in parts)])
    views = [{"buffer": 0, "byteOffset": int(s), "byteLength": a.nbytes} for s, a in zip(starts, parts, strict=False)]
    views[0]["byteStride"] = 4
    of = lambda view, kind, count, width, **more: (
        ({} if view is None else {"bufferView": view}) | {"componentType": kind, "count": count, "type": width} | more
    )
    sparse = {"count": 1, "indices": {"bufferView": 5, "componentType": 5125}, "values": {"bufferView": 6}}
    attributes = {"POSITION": 0, "JOINTS_0": 3, "WEIGHTS_0": 4}
    primitive = {"attributes": attributes, "indices": 1, "material": 0, "targets": [{"POSITION": 5}]}
    plain = {"attributes": {"POSITION": 0}, "indices": 1, "material": 1}
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 2}}}
    gltf = {
        **{"asset": {"version": "2.0"}, "extensionsRequired": ["KHR_mesh_quantization"]},
        "materials": [{"name": "wall"}, {"name": "wall", "emissiveFactor": [1, 1, 1]}],
        "nodes": [
            {"name": "a", "mesh": 0, "skin": 0},
            {"mesh": 1, "extensions": instances, "camera": 0},
            {"extensions": {"KHR_node_visibility": {"visible": False}, "KHR_lights_punctual": {"light": 0}}},
        ],
        "meshes": [{"primitives": [primitive], "weights": [0.5]}, {"primitives": [plain]}],
        "skins": [{"joints": [2]}],
        "cameras": [{"type": "perspective"}],
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "point"}]}},
        "buffers": [{"byteLength": int(starts[-1])}],
        "bufferViews": views,
        "accessors": [
            *(of(0, 5120, 4, "VEC3", normalized=True), of(1, 5123, 6, "SCALAR"), of(2, 5126, 2, "VEC3")),
            *(
                of(3, 5121, 4, "VEC4"),
                of(4, 5121, 4, "VEC4", normalized=True),
                of(None, 5126, 4, "VEC3", sparse=sparse),
            ),
        ],
    }
    return _packed(gltf, b"".join(a.tobytes() for a in parts))


def _packed(gltf, binary):
    words = json.dumps(gltf).encode()
    words += b" " * (-len(words) % 4)
    body = struct.pack("<I4s", len(words), b"JSON") + words + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def _gltf():
    import base64

    data = _glb()
    length = int.from_bytes(data[12:16], "little")
    gltf = json.loads(data[20 : 20 + length])
    gltf["buffers"][0]["uri"] = "data:;base64," + base64.b64encode(data[28 + length :]).decode()
    return json.dumps(gltf).encode()


def _obj():
    lines = ["mtllib model.mtl"]
    for name, (group, points, faces) in _boxes().items():
        lines += [f"o {name}", f"usemtl {group}"]
        lines += [f"v {x} {y} {z}" for x, y, z in points]
        lines += ["f " + " ".join(f"{k - len(points)}/1" for k in face) for face in faces]
    return "\n".join(lines).encode()


def _boxes():
    corners = [(x, y, z) for x in (0, 1.5) for y in (0, 2) for z in (0, 1e0)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return {"a": ("wall", corners, faces), "b": ("lamp", [(x + 3, y, z) for x, y, z in corners], faces)}


def _encoded(suffix, values):
    import cv2

    return cv2.imencode(suffix, values)[1].tobytes()


def _exr():
    import tempfile

    from lib.given import image

    with tempfile.TemporaryDirectory() as folder:
        image.write_exr(f"{folder}/a.exr", mistakes.picture() / 255)
        return Path(f"{folder}/a.exr").read_bytes()


def _npz():
    target = io.BytesIO()
    np.savez(target, a=np.arange(12.0).reshape(3, 4), b=np.array(["x", "yy"]), c=np.array(3))
    return target.getvalue()


def _deflated_npz():
    target = io.BytesIO()
    np.savez_compressed(target, a=np.arange(12.0).reshape(3, 4), b=np.array(["x", "yy"]), c=np.array(3))
    return target.getvalue()


def _json(value):
    return json.dumps(value).encode()


def _project(words):
    return b"fspy" + struct.pack("<III", 1, len(words), 0) + words


def of_project(random, data):
    """The JSON of a project of fSpy's."""
    return _project(of_json(random, data[16:]))


def _beside_obj(path):
    _converted(path.with_suffix(".obj"))


WHOLE_OBJ = b"""mtllib x.mtl "y z.mtl"
# C:\\rooms\\
o a
usemtl wall
v 0 0 0 1
v 1 0 0 0.5 0.5 0.5
v 1 1 0
v 0 1 0 # x
f 1/1/1 2//1 -2 \\
 4
l 1 2
p 1
cstype bspline
deg 1 1
surf 0 1 0 1 1 2 4 3
parm u 0 0 1 1
end
csh -x
fo 1 2 3
"""
MTL = b"newmtl lamp\nKe 1 2.5 3\nnewmtl wall\nKd 1 1 1\nmap_Kd ../x.png\n"
WRITERS = Path(__file__).parents[1] / "data/writers"
USD = (WRITERS / "usd-core/room.usda").read_bytes()
PNG = _encoded(".png", mistakes.picture()[:20, :30])
PROFILE = profiles.icc("Display P3")
BLOCKS = b"[8, 0.004, 0.011, 0.002, 0.001, 0.003, 3.5, 0, 2]"  # as lib.given.jpeg.Blocks writes it
MOTION = _encoded(".jpg", mistakes.picture())
GREY16 = (mistakes.picture(1).astype(np.uint16) * 200)[:20, :30]
KINDS = {
    "scene.yaml": Kind("attic/scene.yaml", YAML, _scene, of_yaml, {"attic/left.png": b"x", "attic/model.obj": b""}),
    "cameramodel": Kind("left.cameramodel", LENS, _lens),
    "OBJ": Kind("model.obj", _obj(), _model),
    "OBJ, all statements": Kind("y.obj", WHOLE_OBJ, _converted),
    "OBJ with MTL": Kind("x.mtl", MTL, _beside_obj, None, {"x.obj": b"mtllib x.mtl\n" + _obj()}),
    "GLB": Kind("model.glb", _glb(), _model, of_glb),
    "GLB of other tools": Kind("y.glb", _rich_glb(), _converted, of_glb),
    "glTF": Kind("x.gltf", _gltf(), _converted, of_json),
    "PLY, text": Kind("x.ply", PLY, _converted),
    "PLY, binary": Kind("y.ply", _binary_ply(), _converted),
    "PLY, mixed": Kind("z.ply", _mixed_ply(), _converted),
    "STL": Kind("x.stl", _stl(), _converted),
    "STL, text": Kind("y.stl", _text_stl(), _converted),
    "Mitsuba": Kind("x.xml", XML, _mitsuba, None, {"y.xml": b'<scene version="3.0.0"><bsdf id="w"/></scene>'}),
    "USD, text": Kind("x.usda", USD, _usd),
    "USD, binary": Kind("x.usdc", (WRITERS / "usd-core/room.usdc").read_bytes(), _usd),
    "USD, package": Kind("x.usdz", (WRITERS / "usd-core/room.usdz").read_bytes(), _usd),
    "fSpy, JSON": Kind("fspy.json", _json(FSPY), _camera, of_json),
    "fSpy, project": Kind("x.fspy", _project(_json(PROJECT)), _camera, of_project),
    "COLMAP, cameras.txt": Kind("a/cameras.txt", CAMERAS_TXT, _camera, None, {"a/images.txt": IMAGES_TXT}),
    "COLMAP, images.txt": Kind("b/images.txt", IMAGES_TXT, _camera, None, {"b/cameras.txt": CAMERAS_TXT}),
    "COLMAP, cameras.bin": Kind("c/cameras.bin", CAMERAS_BIN, _camera, None, {"c/images.bin": IMAGES_BIN}),
    "COLMAP, without points": Kind("e/images.txt", BARE_IMAGES, _camera, None, {"e/cameras.txt": CAMERAS_TXT}),
    "COLMAP, images.bin": Kind("d/images.bin", IMAGES_BIN, _camera, None, {"d/cameras.bin": CAMERAS_BIN}),
    "Blender": Kind("blender.json", _json(BLENDER), _camera, of_json),
    "OpenCV, YAML": Kind("opencv.yml", OPENCV_YML, _camera),
    "OpenCV, XML": Kind("opencv.xml", OPENCV_XML, _camera),
    "OpenCV, JSON": Kind("opencv.json", _json(OPENCV_JSON), _camera, of_json),
    "ROS 2": Kind("topic.yaml", ROS_YAML, _camera),
    "Kalibr": Kind("camchain.yaml", KALIBR, _camera),
    "nerfstudio": Kind("transforms.json", _json(NERF), _camera, of_json),
    "pose.csv": Kind("pose.csv", POINTS, _points),
    "pose-lines.csv": Kind("pose-lines.csv", LINES, _lines),
    "corners.vnl": Kind("corners.vnl", VNL, _corners),
    "materials.json": Kind("materials.json", _json(MATERIALS), _materials, of_json),
    "curve": Kind("curve.json", _json(CURVE), _curve, of_json),
    "legend.json": Kind("legend.json", _json({"groups": ["a", "b"], "objects": ["c"]}), _record("Legend"), of_json),
    "pose.json": Kind("pose.json", _json(POSE), _record("Pose"), of_json),
    "facets.json": Kind("facets.json", _json(FACETS), _facets, of_json),
    "stage report": Kind("fit.report.json", _json(REPORT), _report, of_json),
    "matches.csv": Kind("matches.csv", MATCHES, _matches),
    "places of a walk": Kind("walk.csv", PLACES, _walk),
    "npz": Kind("a.npz", _npz(), _arrays, of_npz),
    "npz, deflated": Kind("b.npz", _deflated_npz(), _arrays),
    "PNG, 8 bit": Kind("left.png", PNG, _photograph, of_png),
    "PNG of a JPEG": Kind("left.png", _of_a_jpeg(BLOCKS), _photograph, of_text),
    "PNG, labels": Kind("group.png", _encoded(".png", GREY16), _labels, of_png),
    "JPEG": Kind("left.jpg", _encoded(".jpg", mistakes.picture()), _photograph),
    "TIFF": Kind("left.tif", _encoded(".tif", GREY16), _photograph),
    "EXR": Kind("left.exr", _exr(), _photograph),
    "EXR, parts": Kind("left.exr", _parts_of_exr(), _photograph),
    "PNG with a profile": Kind("left.png", _profiled("PNG", PROFILE), _photograph, of_profile("PNG")),
    "JPEG with a profile": Kind("left.jpg", _profiled("JPEG", PROFILE), _photograph, of_profile("JPEG")),
    "TIFF with a profile": Kind("left.tif", _profiled("TIFF", PROFILE), _photograph, of_profile("TIFF")),
    "TIFF, planes apart": Kind("left.tif", _profiled("TIFF", PROFILE), _photograph, of_tiff),
    "motion photo": Kind("left.jpg", MOTION + b"\0\0\0\x18ftypmp42" + bytes(500), _photograph),
}  # fmt: skip
