"""What people get wrong at first, each with the words of the line that answers.  Used by tests/test_mistakes.py.

A mistake is a function of a sound scene's folder, and a part of the line that must come.
"""

import json
import struct

import cv2
import numpy as np

from lib.given import cameras
from tests.helpers import rooms

EYE, AT, WIDTH, HEIGHT = (0.4, 0.4, 1.5), (3, 2, 1), 64, 48
YAML = "lamps: {lamp: unknown}\n"


def picture(channels=3):
    """(H, W, C) uint8, in OpenCV's order."""
    values = np.random.default_rng(1).integers(60, 180, (HEIGHT, WIDTH, channels), np.uint8)
    return values[..., 0] if channels == 1 else values


def camera():
    return cameras.look_at(EYE, AT, 70, WIDTH, HEIGHT)


def scene(folder):
    """A room with a lamp, seen by a camera of known pose: planned without a word."""
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "left.png"), picture())
    cameras.write_cameramodel(folder / "left.posed.cameramodel", camera())
    rooms.write(folder / "model.obj", {**rooms.room(), **rooms.LAMP})
    (folder / "scene.yaml").write_text(YAML)
    return folder


def renamed(old, new):
    return lambda folder: (folder / old).rename(folder / new)


def removed(name):
    return lambda folder: (folder / name).unlink()


def written(name, content):
    """content : text or bytes"""
    data = content.encode() if isinstance(content, str) else content
    return lambda folder: (folder / name).write_bytes(data)


def edited(name, old, new):
    def edit(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return edit


def yaml(text):
    return written("scene.yaml", YAML + text)


def both(*steps):
    return lambda folder: [step(folder) for step in steps]


def pillow(name, mode, **options):
    """The photograph in another mode or format of Pillow's."""

    def save(folder):
        from PIL import Image

        where = folder / options.pop("named", name)
        Image.open(folder / "left.png").convert(mode).save(folder / name, **options)
        (folder / "left.png").unlink()
        if where != folder / name:
            (folder / name).rename(where)

    return save


def as_photograph(content):
    return written("left.png", content)


def grey(folder):
    cv2.imwrite(str(folder / "left.png"), picture(1))


def turned(folder):
    """The photograph as stored by a camera held upright: EXIF says so, and viewers turn it."""
    from PIL import Image

    with Image.open(folder / "left.png") as shown:
        exif = Image.Exif()
        exif[274] = 6
        shown.convert("RGB").save(folder / "left.jpg", exif=exif)
    (folder / "left.png").unlink()


def posed(T):
    """The camera's pose replaced: T (4, 4) of the right one -> that of the mistake."""

    def write(folder):
        right = camera()
        wrong = cameras.Camera(right.K, WIDTH, HEIGHT, T(right.T_cam_world))
        cameras.write_cameramodel(folder / "left.posed.cameramodel", wrong)

    return write


def table(folder):
    """A thing in front of the camera, instead of a room around it."""
    rooms.write(folder / "model.obj", {**rooms.solid("table", 2, 1, 0.4, 3.4, 2.6, 1.2), **rooms.LAMP})


def encoded(codec):
    return lambda folder: (folder / "model.obj").write_bytes((folder / "model.obj").read_text().encode(codec))


COLMAP = "# Camera list with one line of data per camera:\n1 PINHOLE 64 48 45.7 45.7 32 24\n"
FSPY = json.dumps({"principalPoint": {"x": 0, "y": 0}, "cameraTransform": {"rows": np.eye(4).tolist()}})
OPENCV = "%YAML:1.0\n---\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n"
STL = b"made by hand".ljust(80, b" ") + struct.pack("<I", 1) + bytes(50)
BOARD = "board: {corners: [9, 6], square_m: %s}\n"
CAMERA = "left.posed.cameramodel"
FLIP = np.diag([1.0, -1, -1, 1])

MISTAKES = {
    # ---- the photograph
    "photograph not there": (removed("left.png"), "materials.json needs left.png or left.jpg"),
    "photo.png": (renamed("left.png", "photo.png"), "photo.png: is not read: rename it to left.png"),
    "left.jpeg": (pillow("left.jpeg", "RGB"), "left.jpeg: is not read: rename it to left.jpg"),
    "left.JPG": (pillow("left.JPG", "RGB"), "left.JPG: is not read: rename it to left.jpg"),
    "left.tiff": (pillow("left.tiff", "RGB"), "left.tiff: is not read: rename it to left.tif"),
    "Left.png": (renamed("left.png", "Left.png"), "Left.png: is not read: rename it to left.png"),
    "left.heic": (renamed("left.png", "left.heic"), "left.heic: HEIC is not read: convert it to left.png"),
    "left.webp": (pillow("left.webp", "RGB"), "left.webp: WEBP is not read: convert it to left.png"),
    "left.dng": (renamed("left.png", "left.dng"), "left.dng: RAW is not read yet: develop it"),
    "two photographs": (
        lambda folder: cv2.imwrite(str(folder / "left.jpg"), picture()),
        "left.png and left.jpg: only one of them may be given",
    ),
    "a GIF named .png": (pillow("left.gif", "P", named="left.png"), "left.png: format: GIF"),
    "a JPEG named .png": (pillow("left.jpg", "RGB", named="left.png"), "left.png: format: JPEG: rename it to left.jpg"),
    "CMYK": (pillow("left.jpg", "CMYK"), "left.jpg: colours: CMYK"),
    "LAB": (pillow("left.tif", "LAB"), "left.tif: colours: LAB"),
    "a web page saved as picture": (as_photograph("<!DOCTYPE html><html>"), "left.png: is a web page"),
    "a pointer of Git LFS": (
        as_photograph("version https://git-lfs.github.com/spec/v1\noid sha256:0\n"),
        "left.png: is a pointer of Git LFS: git lfs pull",
    ),
    "cut off": (
        lambda folder: (folder / "left.png").write_bytes((folder / "left.png").read_bytes()[:500]),
        "left.png: truncated",
    ),
    "empty photograph": (as_photograph(b""), "left.png: the file is empty"),
    "photograph upright by EXIF": (turned, "48 x 64 is not the camera's 64 x 48"),
    "photograph scaled": (
        lambda folder: cv2.imwrite(str(folder / "left.png"), picture()[::2, ::2]),
        "32 x 24 is not the camera's 64 x 48 (",
    ),
    "grey photograph, coloured lamp": (
        both(grey, written("scene.yaml", "lamps: {lamp: [3, 2, 1]}\n")),
        "lamps.lamp: [3, 2, 1] is coloured, but left.png is grey",
    ),
    "grey photograph, coloured reference": (
        both(grey, yaml("reference: {top: [.8, .7, .6]}\n")),
        "reference.top: [0.8, 0.7, 0.6] is coloured, but left.png is grey",
    ),
    # ---- the camera
    "camera under another name": (
        renamed(CAMERA, "camera.cameramodel"),
        "camera.cameramodel: is not read: rename it to left.posed.cameramodel",
    ),
    "camera with an underscore": (
        renamed(CAMERA, "left_posed.cameramodel"),
        "left_posed.cameramodel: is not read: rename it to left.posed.cameramodel",
    ),
    "camera with .txt": (
        renamed(CAMERA, "left.posed.cameramodel.txt"),
        "left.posed.cameramodel.txt: is not read: rename it to left.posed.cameramodel",
    ),
    "camera not there": (removed(CAMERA), "the pose of left is not known: give left.posed.cameramodel"),
    "lens without pose": (
        renamed(CAMERA, "left.cameramodel"),
        "left.cameramodel tells the lens alone: rename it to left.posed.cameramodel if",
    ),
    "COLMAP's cameras.txt": (written(CAMERA, COLMAP), "looks like COLMAP's cameras.txt: make new-scene"),
    "COLMAP's images.txt": (
        written(CAMERA, "# Image list\n1 1 0 0 0 0 0 0 1 left.png\n\n"),
        "looks like COLMAP's images.txt: make new-scene",
    ),
    "fSpy's JSON": (written(CAMERA, FSPY), "looks like fSpy's JSON: make new-scene"),
    "OpenCV's YAML": (written(CAMERA, OPENCV), "looks like OpenCV's YAML: make new-scene"),
    "a matrix of numbers": (
        written(CAMERA, "1 0 0 0\n0 1 0 0\n0 0 1 0\n"),
        "is a table of numbers: not a camera model",
    ),
    "empty camera": (written(CAMERA, ""), "left.posed.cameramodel: the file is empty"),
    "a name in the camera": (edited(CAMERA, "45.", "nan,"), "name nan where a number, a text or a list should be"),
    "no extrinsics": (edited(CAMERA, "'extrinsics'", "'pose'"), "extrinsics: is missing"),
    "camera-to-world": (posed(np.linalg.inv), "is it camera-to-world? extrinsics are world-to-camera"),
    "looks along -z": (both(table, posed(lambda T: FLIP @ T)), "does it look along -z? x right, y down, z forward"),
    "pose in millimetres": (
        posed(lambda T: np.block([[T[:3, :3], 1000 * T[:3, 3:]], [np.array([0, 0, 0, 1.0])]])),
        "no pixel can show the model: is its translation in mm? metres are needed",
    ),
    "two poses": (
        yaml("camera: {eye: [1, 1, 1], at: [2, 2, 1], hfov_deg: 60}\n"),
        "only one of them may tell the pose of left",
    ),
    "three picked points": (
        both(removed(CAMERA), written("pose.csv", "x_px,y_px,X,Y,Z\n1,2,0,0,0\n3,4,1,0,0\n5,6,0,1,0\n")),
        "pose.csv: 3 picked places: at least 4 are needed",
    ),
    "semicolons": (
        both(removed(CAMERA), written("pose.csv", "x_px;y_px;X;Y;Z\n1;2;0;0;0\n")),
        "pose.csv: header: 'x_px;y_px;X;Y;Z' is parted by semicolons: use commas, and a point for decimals",
    ),
    "picked points in centimetres": (
        both(
            removed(CAMERA),
            written("pose.csv", "x_px,y_px,X,Y,Z\n1,2,400,0,0\n3,4,400,300,0\n5,6,400,300,250\n9,8,400,0,250\n"),
        ),
        "pose.csv: X,Y,Z: as metres of the model's frame few are corners of the model; 4 of 4 are if they are in cm",
    ),
    # ---- the model
    "model not there": (removed("model.obj"), "needs model.obj or model.glb"),
    "room.obj": (renamed("model.obj", "room.obj"), "room.obj: is not read: rename it to model.obj"),
    "model.OBJ": (renamed("model.obj", "model.OBJ"), "model.OBJ: is not read: rename it to model.obj"),
    "model.gltf": (renamed("model.obj", "model.gltf"), "model.gltf: is not read: make new-scene"),
    "model.fbx": (renamed("model.obj", "model.fbx"), "model.fbx: FBX is not read: export it as OBJ or GLB"),
    "decimal commas": (edited("model.obj", "v 0 0 0", "v 0,0 0,5 0,0"), "0,0 has a decimal comma: write 0.0"),
    "commas between": (edited("model.obj", "v 0 0 0", "v 0, 0, 0"), "0, has a comma: blanks part the coordinates"),
    "UTF-16": (encoded("utf-16"), "model.obj: is UTF-16: save it as UTF-8"),
    "no material": (edited("model.obj", "usemtl bottom", ""), "has no material (usemtl)"),
    "an STL as OBJ": (written("model.obj", STL), "model.obj: is an STL file: make new-scene"),
    "a PLY as OBJ": (written("model.obj", "ply\nformat ascii 1.0\n"), "model.obj: is a PLY file: make new-scene"),
    "an FBX as OBJ": (written("model.obj", b"Kaydara FBX Binary  \0"), "model.obj: is an FBX file: export it as OBJ"),
    "points alone": (written("model.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "model.obj: faces: the model has none"),
    # ---- scene.yaml
    "scene.yml": (renamed("scene.yaml", "scene.yml"), "scene.yml: is not read: rename it to scene.yaml"),
    "a tab": (yaml("reference:\n\ttop: [.8, .8, .8]\n"), "line 3: a tab: indent with blanks"),
    "no blank after the colon": (yaml("reference:{top: [.8, .8, .8]}\n"), "line 2: a blank is missing after the colon"),
    "lamp:": (
        written("scene.yaml", "lamp: {lamp: unknown}\n"),
        'lamp: {"lamp": "unknown"} is an unknown key; do you mean lamps?',
    ),
    "Lamp": (written("scene.yaml", "lamps: {Lamp: unknown}\n"), "names no group of model.obj; do you mean lamp?"),
    "a lamp without a value": (written("scene.yaml", "lamps: lamp\n"), "write lamps: {lamp: unknown}"),
    "one number": (written("scene.yaml", "lamps: {lamp: 5}\n"), "5 is not a list of three numbers or `unknown`"),
    "no lamps": (written("scene.yaml", ""), "lamps: missing, and edges needs to know which groups emit"),
    "80 %": (yaml("reference: {top: [80, 80, 80]}\n"), "[80, 80, 80] is outside [0, 1]: 80 % is 0.8"),
    "unknown method": (yaml("params: {fit: {method: magic}}\n"), 'params.fit.method: "magic" is none of gauss-newton'),
    "number out of range": (yaml("params: {render: {rays: -5}}\n"), "params.render.rays: -5 is less than 1"),
    "squares of 40 m": (yaml(BOARD % "40"), "board.square_m: 40 is in metres: 40 mm are 0.04"),
    "material.json": (
        yaml("goals: [material.json]\n"),
        '"material.json" is neither made by a stage nor given; do you mean materials.json?',
    ),
    # ---- given results
    "given npz": (written("formfactors.npz", "none"), "formfactors.npz: not a readable .npz file"),
    "given png": (
        both(written("facet.png", "none"), yaml("goals: [materials.json]\n")),
        "facet.png: not a readable image",
    ),
    "given png of another size": (
        both(lambda folder: cv2.imwrite(str(folder / "facet.png"), np.ones((5, 4), np.uint16)), yaml("")),
        "facet.png: size: 4 x 5 is not the camera's 64 x 48",
    ),
    "given JSON": (written("legend.json", "{"), "legend.json: not readable JSON"),
    "truth": (
        both(lambda folder: (folder / "truth").mkdir(), written("truth/materials.json", "{'wall': 1}")),
        "truth/materials.json: not readable JSON",
    ),
}
