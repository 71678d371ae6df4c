"""Files that are made to break a reader, each with the words of the line that answers.  Used by tests/test_hostile.py.

A case is a function that spoils a sound scene's folder (tests/helpers/mistakes.py), what then reads it, and a part of
the line that must come; None where the file is good after all.
"""

import io
import json
import struct
import zipfile
import zlib

import numpy as np

from tests.helpers.mistakes import CAMERA, YAML, both, edited, removed, scene, written

__all__ = ["CASES", "scene"]


# ---- what reads the folder ----


def planned(folder):
    """As `make` does before any stage runs."""
    from lib.planning import plan

    plan.main(plan.options().parse_args([folder.name, "--data", str(folder.parent), "--build", str(folder / "build")]))


def converted(name):
    """As `make new-scene MODEL=name` does."""

    def read(folder):
        from lib.given import foreign_models, model

        files = foreign_models.convert(folder / name)[0]
        for file, content in files.items():
            (folder / file).write_bytes(content)
        return model.load(folder / next(file for file in files if file.startswith("model.")))

    return read


def camera_of(name):
    """As `make new-scene CAMERA=name` does."""

    def read(folder):
        from lib.given import foreign_cameras

        return foreign_cameras.read(folder / name, (64, 48))

    return read


def arrays(folder):
    from lib.core import artefact

    return artefact.read_npz(folder / "formfactors.npz", "a")


def materials(folder):
    from lib.given import materials as file

    return file.read(folder / "materials.json")


# ---- what is written into it ----


def yaml(text):
    return written("scene.yaml", YAML + text)


def camera(old, new):
    return edited(CAMERA, old, new)


def glb(gltf, binary=b""):
    """A GLB of any JSON text."""
    words = (gltf if isinstance(gltf, bytes) else json.dumps(gltf).encode()) + b" "
    words += b" " * (-len(words) % 4)
    body = struct.pack("<I4s", len(words), b"JSON") + words
    body += struct.pack("<I4s", len(binary), b"BIN\0") + binary if binary else b""
    return both(removed("model.obj"), written("model.glb", struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body))


def obj(vertices, faces):
    lines = ["o thing", "usemtl wall", *("v " + " ".join(map(str, v)) for v in vertices)]
    lines += ["f " + " ".join(map(str, face)) for face in faces]
    lines += ["o lamp", "usemtl lamp", "v 1 1 2", "v 2 1 2", "v 2 2 2"]
    return written("model.obj", "\n".join([*lines, "f -1 -2 -3", ""]))


def png(width, height, rows=b""):
    """A PNG of 8-bit RGB whose header promises that size; every checksum is right."""
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    parts = (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)), (b"IDAT", rows), (b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunk(*part) for part in parts)


def zeros(count):
    """So many zeros, deflated: one block's bits again and again, for no case may cost seconds where it is only named.

    >>> zlib.decompress(zeros((1 << 22) + 5)) == bytes((1 << 22) + 5)
    True
    """
    packer, length = zlib.compressobj(9), 1 << 22
    head = packer.compress(bytes(length)) + packer.flush(zlib.Z_FULL_FLUSH)  # what follows refers to none of it
    block = packer.compress(bytes(length)) + packer.flush(zlib.Z_FULL_FLUSH)
    whole, left = divmod(count - length, length)
    tail = zlib.compressobj(9, zlib.DEFLATED, -15)
    tail = tail.compress(bytes(left)) + tail.flush()
    return head + whole * block + tail + struct.pack(">I", (count % 65521) << 16 | 1)  # Adler-32 of zeros


def jpeg(folder):
    """A JPEG whose header promises 65,000 x 65,000 pixels."""
    import cv2

    data = cv2.imencode(".jpg", np.full((48, 64, 3), 90, np.uint8))[1].tobytes()
    at = data.index(b"\xff\xc0")
    (folder / "left.jpg").write_bytes(data[: at + 5] + struct.pack(">HH", 65000, 65000) + data[at + 9 :])
    (folder / "left.png").unlink()


def exr(folder):
    """An EXR whose windows promise 100,000 x 100,000 pixels."""
    from lib.given import image

    image.write_exr(folder / "left.exr", np.ones((48, 64, 3)))
    data = (folder / "left.exr").read_bytes()
    small, large = (struct.pack("<4i", 0, 0, *size) for size in ((63, 47), (99999, 99999)))
    assert data.count(small) == 2
    (folder / "left.exr").write_bytes(data.replace(small, large))
    (folder / "left.png").unlink()


def npy(descr="'<f8'", shape="(3,)", data=bytes(24)):
    head = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


def npz(member, change=None, deflate=False):
    """formfactors.npz with one array; change : what is done to the archive's bytes"""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED if deflate else zipfile.ZIP_STORED) as file:
        file.writestr("a.npy", member)
    data = target.getvalue()
    return written("formfactors.npz", change(data) if change else data)


def in_headers(at_local, at_central, value):
    """The 16-bit fields at these places of the archive's two headers become value."""

    def change(data):
        data, central = bytearray(data), data.index(b"PK\1\2")
        struct.pack_into("<H", data, at_local, value)
        struct.pack_into("<H", data, central + at_central, value)
        return bytes(data)

    return change


def bomb(folder):
    """Half a GB of zeros as an array."""
    body = npy(shape="(67108864,)", data=b"")
    archive = zipfile.ZipFile(folder / "formfactors.npz", "w", zipfile.ZIP_DEFLATED)
    with archive as file, file.open("a.npy", "w", force_zip64=True) as member:
        member.write(body)
        for _ in range(128):
            member.write(bytes(1 << 22))


def circle(count, seed=None):
    """Corners of one polygon; in a wild order where there is a seed."""
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    angle = angle if seed is None else np.random.default_rng(seed).permutation(angle)
    return [(2 + np.cos(a), 2 + np.sin(a), 1) for a in angle]


def fan(count):
    """So many triangles around one edge."""
    return obj([(0, 0, 0), (0, 0, 1), *((x, y, 0) for x, y, _ in circle(count))], [(1, 2, k + 3) for k in range(count)])


DEEP = 200_000
NINES = "9" * 5000
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
TAGS = ("bool foo", "int x", "float x", "timestamp x", "binary x", "null x", "set {a, b}", "omap [a, b]", "pairs [a]")
ENTITIES = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghij", strict=True))
XML = f'<?xml version="1.0"?><!DOCTYPE s [<!ENTITY a "aaaaaaaaaa">{ENTITIES}]><scene><shape type="&j;"/></scene>'
EXTERNAL = (
    '<?xml version="1.0"?><!DOCTYPE s [<!ENTITY e SYSTEM "file:///etc/passwd">]><scene><shape type="&e;"/></scene>'
)
ROWS = "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 2000000000\n   cols: 3\n   dt: d\n   data: [ 1 ]\n"
BLENDER = '{"matrix_world": 1, "lens_px": [1, 1], "shift_px": [0, 0], "size_px": [%s, 1]}'
MATERIALS = '{"groups": {"bottom": {"kind": "textured", "texture": {"0": "%s"}}}}'
GLTF = '{"asset": {"version": "2.0"}, "buffers": [{"uri": "%s", "byteLength": 4}]}'

CASES = {
    # ---- scene.yaml
    **{f"!!{tag}": (yaml(f"surfaces: {{wall: !!{tag}}}\n"), planned, f"line 2: !!{tag.split()[0]}") for tag in TAGS},
    "!!python": (yaml("lens: !!python/object/apply:os.getcwd []\n"), planned, "line 2: !!python"),
    "!own": (yaml("lens: !own x\n"), planned, "line 2: !own"),
    "a bomb of aliases": (written("scene.yaml", BOMB), planned, "scene.yaml: line "),
    "a bomb of merges": (
        written("scene.yaml", "a: &a {x: 1}\n" + "".join(f"b{k}: &b{k} {{<<: *a, y{k}: *a}}\n" for k in range(9))),
        planned,
        "is an unknown key",
    ),
    "an alias of itself": (yaml("augment: &a [*a, *a]\n"), planned, "scene.yaml: line 2: "),
    "YAML 200,000 deep": (yaml("goals: " + "[" * DEEP), planned, "scene.yaml: line 2: "),
    "blocks 20,000 deep": (yaml("goals: " + "- " * 20_000 + "x"), planned, "scene.yaml: line 2: "),
    "a key of 10,000 brackets": (yaml("? " * 20_000), planned, "scene.yaml: "),
    "100,000 words": (yaml("goals: [" + "a, " * 100_000 + "a]"), planned, "scene.yaml: "),
    "10 MB of scene.yaml": (yaml("# " + "x" * 10_000_000), planned, "scene.yaml: 10"),
    "a number of 400 digits": (written("scene.yaml", f"lamps: {{lamp: [{'9' * 400}, 1, 1]}}"), planned, "lamps.lamp: "),
    "a number of 5,000 digits": (written("scene.yaml", f"lamps: {{lamp: [{NINES}, 1, 1]}}"), planned, "lamps.lamp: "),
    "a lamp of 1e300": (written("scene.yaml", "lamps: {lamp: [1e300, 1, 1]}"), planned, "line 1: 1e300 is"),
    "a camera 1e300 away": (
        both(removed(CAMERA), yaml("camera: {eye: [1e300, 0, 0], at: [0, 0, 0], hfov_deg: 60}\n")),
        planned,
        "line 2: 1e300 is larger",
    ),
    "a gamma of 400 digits": (yaml(f"transfer: {{gamma: {'9' * 400}}}\n"), planned, "transfer.gamma: "),
    "a binary scene.yaml": (written("scene.yaml", bytes(range(256))), planned, "scene.yaml: "),
    # ---- cameras
    "unary minus": (camera("'LENSMODEL_PINHOLE'", "-{}"), planned, "not a camera model: "),
    "a set as key": (camera("'lensmodel'", "{'a'}"), planned, "not a camera model: "),
    "a list as key": (camera("'lensmodel'", "[]"), planned, "not a camera model: "),
    "a set of sets": (written(CAMERA, "{{}, {()}, {{1}}}"), planned, "not a camera model: "),
    "200,000 brackets": (written(CAMERA, "[" * DEEP), planned, "not a camera model: "),
    "200,000 minus signs": (written(CAMERA, "-" * DEEP + "1"), planned, "not a camera model: "),
    "a sum of 200,000": (written(CAMERA, "+".join("1" * DEEP)), planned, "not a camera model: "),
    "16 MB of numbers": (written(CAMERA, "[" + "1," * 8_000_000 + "]"), planned, "left.posed.cameramodel: "),
    "a null byte": (camera("'LENSMODEL_PINHOLE'", "'\0'"), planned, "left.posed.cameramodel: "),
    "focal length of 400 digits": (camera("45.", "9" * 400 + " + 45."), planned, "left.posed.cameramodel: "),
    "a rotation of 1e200": (edited(CAMERA, "'extrinsics': [ ", "'extrinsics': [ 1e200,"), planned, "extrinsics"),
    "an image of 2e9": (camera("'imagersize': [", "'imagersize': [ 2000000000, 48 ], 'x': ["), planned, "imagersize: "),
    "a focal length of 1e250": (
        camera("'intrinsics': [", "'intrinsics': [ 1e250, 9, 9, 9 ], 'x': ["), planned, "intrinsics: 1e+250",
    ),
    # ---- models
    "a vertex at 1e308": (obj([(0, 0, 0), (1e308, 0, 0), (0, 1e308, 1)], [(1, 2, 3)]), planned, "vertex 2: x = 1e+308"),
    "a vertex of 400 digits": (obj([(0, 0, 0), ("9" * 400, 0, 0), (0, 1, 1)], [(1, 2, 3)]), planned, "vertex x = 99"),
    "an index of 5,000 digits": (obj([(0, 0, 0), (1, 0, 0), (0, 1, 1)], [(1, 2, "9" * 5000)]), planned, "model.obj: "),
    "6,000 polygons on an edge": (fan(6000), planned, None),
    "one face 6,000 times": (obj([(0, 0, 0), (1, 0, 0), (0, 1, 1)], [(1, 2, 3)] * 6000), planned, None),
    "a polygon of 20,000 corners": (obj(circle(20_000), [range(1, 20_001)]), planned, "model.obj: "),
    "20,000 corners in a wild order": (obj(circle(20_000, 1), [range(1, 20_001)]), planned, "model.obj: "),
    "40 wild polygons of 1,000 corners": (obj(circle(1000, 1), [range(1, 1001)] * 40), planned, None),
    "a GLB of a list": (glb([]), planned, "model.glb: "),
    "a GLB of a word": (glb('"x"'), planned, "model.glb: "),
    "a GLB 200,000 deep": (glb(b"[" * DEEP), planned, "model.glb: "),
    "a GLB whose nodes are numbers": (glb({"nodes": [1, 2]}), planned, "model.glb: "),
    "a GLB whose extras are a list": (glb({"nodes": [], "extras": [1]}), planned, "model.glb: "),
    "a GLB with a number of 400 digits": (
        glb(b'{"nodes": [{"translation": [%s, 0, 0], "mesh": 0}], "meshes": [{"primitives": []}]}' % (b"9" * 400)),
        planned,
        "model.glb: ",
    ),
    "a GLB that counts to 1e12": (
        glb(
            {
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"material": 0, "attributes": {"POSITION": 0}}]}],
                "materials": [{}],
                "buffers": [{}],
                "bufferViews": [{"buffer": 0, "byteStride": 0}],
                "accessors": [{"bufferView": 0, "count": 10**12, "type": "VEC3", "componentType": 5126}],
            },
            bytes(64),
        ),
        planned,
        "model.glb: ",
    ),
    "a PLY that counts to 4e9": (
        written("x.ply", "ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\n"
                "property float y\nproperty float z\nelement face 4000000000\nproperty list uchar int vertex_indices\n"
                "end_header\n"),
        converted("x.ply"),
        "x.ply: ",
    ),
    "a PLY of text that counts to 4e9": (
        written("x.ply", "ply\nformat ascii 1.0\nelement vertex 4000000000\nproperty float x\nproperty float y\n"
                "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n"),
        converted("x.ply"),
        "x.ply: ",
    ),
    "an STL with a count of 4e9": (
        written("x.stl", b"solid".ljust(80) + struct.pack("<I", 4_000_000_000) + b"facet" + bytes(200)),
        converted("x.stl"),
        "x.stl: ",
    ),
    "a bomb of entities": (written("x.xml", XML), converted("x.xml"), "x.xml: "),
    "an external entity": (written("x.xml", EXTERNAL), converted("x.xml"), "x.xml: "),
    "XML 200,000 deep": (written("x.xml", "<scene>" + "<shape>" * DEEP), converted("x.xml"), "x.xml: "),
    "a shape from outside": (
        written("x.xml", '<scene><shape type="obj"><string name="filename" value="../../etc/x.obj"/></shape></scene>'),
        converted("x.xml"),
        "lies outside",
    ),
    "a buffer from outside": (written("x.gltf", GLTF % "../../../etc/passwd"), converted("x.gltf"), "lies outside"),
    "a buffer from the root": (written("x.gltf", GLTF % "/etc/passwd"), converted("x.gltf"), "lies outside"),
    # ---- cameras of others
    "COLMAP counts to 2^60": (
        both(written("cameras.bin", struct.pack("<Q", 1 << 60)), written("images.bin", struct.pack("<Q", 1 << 60))),
        camera_of("cameras.bin"),
        "cameras: not readable",
    ),
    "fSpy 200,000 deep": (written("c.json", '{"cameraTransform": ' + "[" * DEEP), camera_of("c.json"), "c.json: "),
    "fSpy with 400 digits": (
        written("c.json", '{"cameraTransform": {"rows": [%s]}}' % ("9" * 400)), camera_of("c.json"), "c.json: ",
    ),
    "Blender with 400 digits": (written("c.json", BLENDER % ("9" * 400)), camera_of("c.json"), "c.json: "),
    "OpenCV 200,000 deep": (
        written("c.yml", "%YAML:1.0\n---\ncamera_matrix: " + "[" * DEEP), camera_of("c.yml"), "c.yml: ",
    ),
    "OpenCV's matrix of 2e9 rows": (written("c.yml", ROWS), camera_of("c.yml"), "c.yml: "),
    # ---- pictures
    "a PNG of 32,000 x 32,000": (written("left.png", png(32000, 32000, zeros(32000 * 96001))), planned, "left.png: "),
    "a PNG that promises 2e9 x 2e9": (written("left.png", png(2**31 - 1, 2**31 - 1, b"")), planned, "left.png: "),
    "a GB of deflate": (written("left.png", png(64, 48, zeros(1 << 30))), planned, "left.png: "),
    "a JPEG of 65,000 x 65,000": (jpeg, planned, "left.jpg: "),
    "an EXR of 100,000 x 100,000": (exr, planned, "left.exr: "),
    # ---- arrays and JSON
    "an array of 1e12": (npz(npy(shape="(1000000000000,)")), arrays, "formfactors.npz: "),
    "an array of -1": (npz(npy(shape="(-1,)")), arrays, "formfactors.npz: "),
    "an array of 1e30": (npz(npy(shape=f"({10**30},)")), arrays, "formfactors.npz: "),
    "an array of objects": (npz(npy(descr="'|O'")), arrays, "formfactors.npz: "),
    "an array of texts of 1e9": (npz(npy(descr="'<U1000000000'")), arrays, "formfactors.npz: "),
    "an array of nothing, 1e12 times": (npz(npy("'|S0'", f"({10**12},)", b"")), arrays, "formfactors.npz: "),
    "an array's header 200,000 deep": (npz(npy(descr="(" * 100)), arrays, "formfactors.npz: "),
    "method 99": (npz(npy(), in_headers(8, 10, 99)), arrays, "formfactors.npz: "),
    "an encrypted array": (npz(npy(), in_headers(6, 8, 1)), arrays, "formfactors.npz: "),
    "an .npy in its place": (written("formfactors.npz", npy()), arrays, "formfactors.npz: "),
    "an array of no kind": (npz(b"hello"), arrays, "formfactors.npz: "),
    "half a GB of zeros as an array": (bomb, arrays, "formfactors.npz: "),
    "given npz, method 99": (npz(npy(), in_headers(8, 10, 99)), planned, "formfactors.npz: "),
    "JSON 200,000 deep": (written("materials.json", "[" * DEEP), materials, "materials.json: "),
    "JSON with 1e999": (written("materials.json", '{"image": {"rmse": 1e999}}'), materials, "materials.json: "),
    "JSON with 400 digits": (
        written("materials.json", '{"image": {"rmse": %s}}' % ("9" * 400)), materials, "materials.json: ",
    ),
    "a texture from outside": (
        written("materials.json", MATERIALS % "../../../../etc/passwd"), materials, "groups.bottom.texture",
    ),
    "a texture from the root": (
        written("materials.json", MATERIALS % "/etc/passwd"), materials, "groups.bottom.texture",
    ),
}  # fmt: skip
