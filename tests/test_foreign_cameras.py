"""Cameras of other tools: our projection of the converted camera is the tool's own, to 1e-6 px."""

import io
import json
import struct
import sys
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from lib.core.stage import BadInput
from lib.given import cameras, foreign_cameras, fspy
from tests.helpers import consumers

ROOM = np.random.default_rng(4).uniform((0.5, 0.5, 0), (3.5, 3.0, 2.4), (60, 3))
SIZES = [(640, 480), (480, 640), (1001, 333)]


def pose():
    return cameras.towards((0.2, -2.5, 1.4), (2.1, 2.0, 1.1))


def close(found, p, q, px=1e-6):
    assert np.abs(found.project(p) - q).max() < px


# ---- COLMAP ----

PARAMS = {
    "SIMPLE_PINHOLE": [500.0, 322.0, 237.0],
    "PINHOLE": [500.0, 510.0, 322.0, 237.0],
    "SIMPLE_RADIAL": [500.0, 322.0, 237.0, 0.05],
    "RADIAL": [500.0, 322.0, 237.0, 0.05, -0.02],
    "OPENCV": [500.0, 510.0, 322.0, 237.0, 0.05, -0.02, 0.001, -0.002],
    "FULL_OPENCV": [500.0, 510.0, 322.0, 237.0, 0.05, -0.02, 0.001, -0.002, 0.003, 0.01, 0.02, 0.001],
}


def reconstruction(model, names=("a b.jpg", "other.jpg")):
    pycolmap = pytest.importorskip("pycolmap")
    made = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model=model, width=640, height=480, params=PARAMS[model], camera_id=1)
    made.add_camera_with_trivial_rig(camera)
    for k, name in enumerate(names, 1):
        T = pose()
        T[:3, 3] += [0.1 * (k - 1), 0, 0]
        image = pycolmap.Image(name=name, camera_id=1, image_id=k)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(T[:3]))
    return made, camera


@pytest.mark.parametrize("model", PARAMS)
@pytest.mark.parametrize("form", ["text", "binary"])
def test_colmap(tmp_path, model, form):
    made, camera = reconstruction(model)
    (made.write_text if form == "text" else made.write_binary)(str(tmp_path))
    found = foreign_cameras.read(tmp_path, (640, 480), "a b.jpg")
    p = ROOM @ pose()[:3, :3].T + pose()[:3, 3]
    close(found, ROOM, np.array(camera.img_from_cam(p)) - 0.5)


def test_colmap_asks_which_photograph(tmp_path):
    reconstruction("PINHOLE")[0].write_text(str(tmp_path))
    with pytest.raises(BadInput, match="IMAGE: say which: IMAGE=... is one of a b.jpg, other.jpg"):
        foreign_cameras.read(tmp_path / "images.txt", (640, 480))
    with pytest.raises(BadInput, match="640 x 480 is not the photograph's 320 x 240"):
        foreign_cameras.read(tmp_path, (320, 240), "other.jpg")
    (tmp_path / "cameras.txt").unlink()
    with pytest.raises(BadInput, match="cameras.txt or cameras.bin is missing"):
        foreign_cameras.read(tmp_path, (640, 480), "other.jpg")


# ---- fSpy ----


def plane_of_fspy(p, view, P, f):
    """fSpy's picture plane: y up, 1 at half the longer side; the camera looks along -z."""
    x, y, z = (p @ view[:3, :3].T + view[:3, 3]).T
    return np.stack([P[0] + f * x / -z, P[1] + f * y / -z], 1)


def pixels_of_fspy(plane, width, height):
    """Pixels whose centres are at whole numbers."""
    unit = max(width, height) / 2
    return np.stack([width / 2 + unit * plane[:, 0], height / 2 - unit * plane[:, 1]], 1) - 0.5


def told(width, height, f=1.3, P=(0.04, -0.03)):
    view = fspy.FLIP @ pose()
    rows = {"rows": np.linalg.inv(view).tolist()}
    words = {"cameraTransform": rows, "horizontalFieldOfView": 2 * np.arctan(1 / f), "relativeFocalLength": f}
    return words | {"principalPoint": {"x": P[0], "y": P[1]}, "imageWidth": width, "imageHeight": height}, view


def project_file(path, state, image=b"\x89PNG"):
    words = json.dumps(state).encode()
    path.write_bytes(b"fspy" + struct.pack("<III", 1, len(words), len(image)) + words + image)
    return path


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("form", ["json", "fspy"])
def test_fspy(tmp_path, size, form):
    words, view = told(*size)
    path = tmp_path / f"left.{form}"
    if form == "json":
        path.write_text(json.dumps(words, indent=2))
    else:
        unit = {"referenceDistanceUnit": "Meters"}
        project_file(path, {"cameraParameters": words, "calibrationSettingsBase": unit})
    close(foreign_cameras.read(path, size), ROOM, pixels_of_fspy(plane_of_fspy(ROOM, view, (0.04, -0.03), 1.3), *size))


def test_fspy_in_centimetres(tmp_path):
    words, view = told(640, 480)
    state = {"cameraParameters": words, "calibrationSettingsBase": {"referenceDistanceUnit": "Centimeters"}}
    found = foreign_cameras.read(project_file(tmp_path / "x.fspy", state), (640, 480))
    plane = plane_of_fspy(100 * ROOM, view, (0.04, -0.03), 1.3)
    close(found, ROOM, pixels_of_fspy(plane, 640, 480))


def point(plane, size):
    x, y = (plane * max(size) / np.array([size[0], -size[1]]) + 1) / 2
    return {"x": float(x), "y": float(y)}


def control_points(size, mode, f=1.3, P=(0.0, 0.0)):
    """The state of a project without cameraParameters whose lines are those of the camera; origin (0, 0, 0)."""
    view = fspy.FLIP @ pose()
    see = lambda p: plane_of_fspy(np.array([p], float), view, P, f)[0]
    at = lambda *p: point(see(p), size)
    lines = lambda *ends: {"lineSegments": [[at(*a), at(*b)] for a, b in ends]}
    along_x = lines(((0, 0, 0), (3, 0, 0)), ((0, 1, 2), (3, 1, 2)))
    along_y = lines(((0, 0, 0), (0, 3, 0)), ((3, 0, 2), (3, 3, 2)))
    along_z = lines(((0, 0, 0), (0, 0, 2)), ((3, 2, 0), (3, 2, 2)))
    anchor, ends = at(2, 1, 0), [at(2, 1, 0.5), at(2, 1, 2.0)]
    xy = lambda place: np.array([place["x"], place["y"]])
    rays = [np.array(view[:3, :3] @ axis) for axis in np.eye(3)]
    horizon = [point(P + f * ray[:2] / -ray[2], size) for ray in rays[:2]]
    return {
        "globalSettings": {"calibrationMode": mode},
        "imageState": {"width": size[0], "height": size[1]},
        "cameraParameters": None,
        "calibrationSettingsBase": {
            "referenceDistanceUnit": "No unit",
            "referenceDistance": 1.5,
            "referenceDistanceAxis": "zPositive",
            "cameraData": {"presetId": None, "presetData": None, "customSensorWidth": 36, "customSensorHeight": 24},
            "firstVanishingPointAxis": "xPositive" if rays[0][2] < 0 else "xNegative",
            "secondVanishingPointAxis": "yPositive" if rays[1][2] < 0 else "yNegative",
        },
        "calibrationSettings1VP": {"principalPointMode": "Default", "absoluteFocalLength": f * 18},
        "calibrationSettings2VP": {
            "principalPointMode": "FromThirdVanishingPoint" if any(P) else "Default",
            "quadModeEnabled": False,
        },
        "controlPointsStateBase": {
            "firstVanishingPoint": along_x,
            "principalPoint": {"x": 0.5, "y": 0.5},
            "origin": at(0, 0, 0),
            "referenceDistanceAnchor": anchor,
            "referenceDistanceHandleOffsets": [
                float(
                    np.linalg.norm(xy(end) - xy(anchor))
                    * np.sign((xy(end) - xy(anchor)) @ _to_vp(rays[2], P, f, size, xy(anchor)))
                )
                for end in ends
            ],
        },
        "controlPointsState1VP": {"horizon": horizon},
        "controlPointsState2VP": {"secondVanishingPoint": along_y, "thirdVanishingPoint": along_z},
    }, view


def _to_vp(ray, P, f, size, anchor):
    vp = point(np.array(P) + f * ray[:2] / -ray[2], size)
    return np.array([vp["x"], vp["y"]]) - anchor


@pytest.mark.parametrize("size", SIZES[:2])
@pytest.mark.parametrize(
    ("mode", "P"),
    [("TwoVanishingPoints", (0, 0)), ("TwoVanishingPoints", (0.05, -0.02)), ("OneVanishingPoint", (0, 0))],
)
def test_fspy_without_camera_parameters_is_solved_from_its_control_points(tmp_path, size, mode, P):
    state, view = control_points(size, mode, P=P)
    found = foreign_cameras.read(project_file(tmp_path / "x.fspy", state), size)
    close(found, ROOM, pixels_of_fspy(plane_of_fspy(ROOM, view, P, 1.3), *size))


def embedded(size, turn=1, format="JPEG"):
    """A picture as fSpy embeds it, which EXIF turns."""
    from PIL import Image

    picture, target = Image.new("RGB", size), io.BytesIO()
    exif = picture.getexif()
    exif[274] = turn
    picture.save(target, format, exif=exif)
    return target.getvalue()


@pytest.mark.parametrize("mode", ["TwoVanishingPoints", "OneVanishingPoint"])
@pytest.mark.parametrize(("turn", "format"), [(1, "PNG"), (1, "JPEG"), (6, "JPEG")])
def test_fspy_as_its_projects_are(tmp_path, mode, turn, format):
    """No imageState: the size is that of the picture in the project, as it is stored; a horizon by name."""
    size = (640, 480)
    state, view = control_points(size, mode)
    del state["imageState"], state["cameraParameters"]
    ends = state["controlPointsState1VP"]["horizon"]
    state["controlPointsState1VP"]["horizon"] = {"0": ends[0], "1": ends[1]}
    path = project_file(tmp_path / "x.fspy", state, embedded(size, turn, format))
    q = pixels_of_fspy(plane_of_fspy(ROOM, view, (0, 0), 1.3), *size)
    if turn == 6:  # viewers turn the picture to the right
        q, size = np.stack([479 - q[:, 1], q[:, 0]], 1), (480, 640)
    found = foreign_cameras.read(path, size, turn=turn)
    close(found, ROOM, q)
    assert "no cameraParameters in the project: solved from its control points" in found.said


@pytest.mark.parametrize("mode", ["TwoVanishingPoints", "OneVanishingPoint"])
def test_fspy_with_a_principal_point_set_by_hand(tmp_path, mode):
    size, P = (640, 480), (0.05, -0.02)
    state, view = control_points(size, mode, P=P)
    for way in ("1VP", "2VP"):
        state[f"calibrationSettings{way}"]["principalPointMode"] = "Manual"
    state["controlPointsStateBase"]["principalPoint"] = point(np.array(P), size)
    found = foreign_cameras.read(project_file(tmp_path / "x.fspy", state), size)
    close(found, ROOM, pixels_of_fspy(plane_of_fspy(ROOM, view, P, 1.3), *size))


def test_fspy_quad_mode_and_sensors_by_name(tmp_path):
    """The four ends of two lines are the corners of a rectangle; a sensor's name stands for its sides."""
    size = (640, 480)
    state, view = control_points(size, "TwoVanishingPoints")
    at = lambda *p: point(plane_of_fspy(np.array([p], float), view, np.zeros(2), 1.3)[0], size)
    rectangle = [[at(0, 0, 0), at(3, 0, 0)], [at(0, 2, 0), at(3, 2, 0)]]
    state["controlPointsStateBase"]["firstVanishingPoint"]["lineSegments"] = rectangle
    state["controlPointsState2VP"]["secondVanishingPoint"]["lineSegments"] = []
    state["calibrationSettings2VP"]["quadModeEnabled"] = True
    found = foreign_cameras.read(project_file(tmp_path / "x.fspy", state), size)
    close(found, ROOM, pixels_of_fspy(plane_of_fspy(ROOM, view, (0, 0), 1.3), *size))
    state, view = control_points(size, "OneVanishingPoint")
    state["calibrationSettingsBase"]["cameraData"] = {
        "presetId": "nikon_d90",
        "customSensorWidth": 1,
        "customSensorHeight": 1,
    }
    state["calibrationSettings1VP"]["absoluteFocalLength"] = 1.3 * 23.6 / 2
    found = foreign_cameras.read(project_file(tmp_path / "x.fspy", state), size)
    close(found, ROOM, pixels_of_fspy(plane_of_fspy(ROOM, view, (0, 0), 1.3), *size))


def test_fspy_solves_as_its_own_formulas(tmp_path):
    """Focal length by the foot of the principal point on the line of the vanishing points (Guillou et al., 3.2), and a
    reference distance by rays through the handles that come nearest to the axis."""
    size = (640, 480)
    state, _ = control_points(size, "TwoVanishingPoints")
    random = np.random.default_rng(3)
    base = state["controlPointsStateBase"]
    for place in (base["origin"], base["referenceDistanceAnchor"]):
        place["x"] += random.uniform(-0.02, 0.02)
    for segment in base["firstVanishingPoint"]["lineSegments"]:
        segment[0]["y"] += random.uniform(-0.01, 0.01)
    found = foreign_cameras.read(project_file(tmp_path / "x.fspy", state), size)
    flat = lambda p: np.array([2 * p["x"] - 1, (1 - 2 * p["y"]) / (4 / 3)])
    sides = base["firstVanishingPoint"], state["controlPointsState2VP"]["secondVanishingPoint"]
    U, V = (meeting(*[[flat(p) for p in line] for line in lines["lineSegments"]]) for lines in sides)
    along = (U - V) / np.linalg.norm(U - V)
    foot = V + along * (-V @ along)
    f = np.sqrt(np.linalg.norm(V - foot) * np.linalg.norm(U - foot) - foot @ foot)
    assert abs(found.intrinsics[0] / 320 - f) < 1e-9
    seen = found.project(np.zeros((1, 3)))[0]  # the world's origin lies where its control point does
    assert np.abs((seen + 0.5) / size - [base["origin"]["x"], base["origin"]["y"]]).max() < 1e-9
    axis, anchor = np.array([0, 0, 1.0]), base["referenceDistanceAnchor"]
    centre, vp = -found.T[:3, :3].T @ found.T[:3, 3], (found.T[:3, :3] @ axis)
    vp = (found.intrinsics[:2] * vp[:2] / vp[2] + found.intrinsics[2:4] + 0.5) / size
    xy = np.array([anchor["x"], anchor["y"]])

    def ray(place):
        x = (place * size - 0.5 - found.intrinsics[2:4]) / found.intrinsics[:2]
        return found.T[:3, :3].T @ [*x, 1.0]

    start = centre - ray(xy) * centre[2] / ray(xy)[2]
    heights = []
    for offset in base["referenceDistanceHandleOffsets"]:
        d = ray(xy + offset * (vp - xy) / np.linalg.norm(vp - xy))
        normal = np.cross(axis, d)  # the nearest points of two lines
        heights.append(np.cross(centre - start, d) @ normal / (normal @ normal))
    assert abs(abs(heights[0] - heights[1]) - 1.5) < 1e-6


def meeting(a, b):
    """Where two lines through two points each meet, by the formula of determinants."""
    (x1, y1), (x2, y2), (x3, y3), (x4, y4) = *a, *b
    down = (x1 - x2) * (y3 - y4) - (y1 - y2) * (x3 - x4)
    one, two = x1 * y2 - y1 * x2, x3 * y4 - y3 * x4
    return np.array([one * (x3 - x4) - (x1 - x2) * two, one * (y3 - y4) - (y1 - y2) * two]) / down


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s["controlPointsState1VP"].pop("horizon"), "too little to solve for them: 'horizon' is missing"),
        (lambda s: s.pop("controlPointsStateBase"), "'controlPointsStateBase' is missing"),
        (lambda s: s["globalSettings"].update(calibrationMode="x"), "calibrationMode: 'x' is not known"),
        (
            lambda s: s["calibrationSettingsBase"].update(secondVanishingPointAxis="xNegative"),
            "choose two axes in fSpy",
        ),
        (lambda s: s["calibrationSettingsBase"].update(referenceDistanceUnit="Ells"), "referenceDistanceUnit: 'Ells'"),
    ],
)
def test_fspy_projects_that_tell_too_little(tmp_path, change, words):
    state, _ = control_points((640, 480), "OneVanishingPoint")
    change(state)
    with pytest.raises(BadInput, match=words):
        foreign_cameras.read(project_file(tmp_path / "x.fspy", state), (640, 480))


def test_fspy_lines_that_tell_nothing(tmp_path):
    state, _ = control_points((640, 480), "TwoVanishingPoints")
    corners = [{"x": x, "y": y} for x, y in ((0, 0), (1, 0), (0, 1), (1, 1))]
    state["controlPointsStateBase"]["firstVanishingPoint"]["lineSegments"] = [corners[:2], corners[2:]]
    with pytest.raises(BadInput, match="the lines of a vanishing point are parallel"):
        foreign_cameras.read(project_file(tmp_path / "x.fspy", state), (640, 480))


# ---- Blender ----


def blender(tmp_path, monkeypatch, root, size, fit, aspect, **more):
    """docs/blender_camera.py run beside a stand-in of bpy."""
    matrix = np.linalg.inv(fspy.FLIP @ pose())

    class Matrix(list):
        def normalized(self):
            return self

    data = SimpleNamespace(
        type="PERSP", sensor_fit=fit, sensor_width=36.0, sensor_height=24.0, lens=35.0, shift_x=0.1, shift_y=-0.07
    )
    render = SimpleNamespace(resolution_x=2 * size[0], resolution_y=2 * size[1], resolution_percentage=50, **more)
    render.pixel_aspect_x, render.pixel_aspect_y = aspect
    camera = SimpleNamespace(data=data, matrix_world=Matrix(map(tuple, matrix)))
    scene = SimpleNamespace(render=render, camera=camera, name="Scene")
    path = SimpleNamespace(abspath=lambda name: str(tmp_path / name.removeprefix("//")))
    monkeypatch.setitem(sys.modules, "bpy", SimpleNamespace(context=SimpleNamespace(scene=scene), path=path))
    exec((root / "docs/blender_camera.py").read_text(), {})
    return tmp_path / "Scene.camera.json", data


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("aspect", [(1.0, 1.0), (1.0, 1.2)])
def test_blender(tmp_path, monkeypatch, root, size, fit, aspect):
    """Against the frame of Blender's camera: its sides on the sensor in mm, moved by shift, at the focal length."""
    path, data = blender(tmp_path, monkeypatch, root, size, fit, aspect)
    width, height = size[0] * aspect[0], size[1] * aspect[1]
    wide = fit == "HORIZONTAL" or (fit == "AUTO" and width >= height)
    sensor, side = (data.sensor_height if fit == "VERTICAL" else data.sensor_width), (width if wide else height)
    mm = sensor / side
    x, y, z = (ROOM @ (fspy.FLIP @ pose())[:3, :3].T + (fspy.FLIP @ pose())[:3, 3]).T
    across = data.lens * x / -z - data.shift_x * sensor  # mm from the middle of the frame
    up = data.lens * y / -z - data.shift_y * sensor
    q = np.stack([(across / (width * mm) + 0.5) * size[0], (0.5 - up / (height * mm)) * size[1]], 1) - 0.5
    close(foreign_cameras.read(path, size), ROOM, q)


def test_blenders_stereoscopy_is_refused(tmp_path, monkeypatch, root):
    """Its pictures are of the left and the right eye, and the camera stands between them."""
    with pytest.raises(RuntimeError, match="stereoscopy is on"):
        blender(tmp_path, monkeypatch, root, SIZES[0], "AUTO", (1.0, 1.0), use_multiview=True)
    assert not (tmp_path / "Scene.camera.json").exists()


@pytest.mark.outside
def test_blender_itself(tmp_path):
    """Against the projection that Blender renders with, to what its single precision leaves."""
    if why := consumers.absent("bpy"):
        pytest.skip(why)
    for file, size, p, q in consumers.ask("blender_cameras", tmp_path):
        close(foreign_cameras.read(file, tuple(size)), np.array(p), np.array(q), px=5e-4)


# ---- OpenCV ----


@pytest.mark.parametrize("suffix", ["yml", "json", "xml"])
@pytest.mark.parametrize("count", [0, 4, 5, 8, 12])
def test_opencv(tmp_path, suffix, count):
    K = np.array([[500.0, 0, 322], [0, 510, 237], [0, 0, 1]])
    D = np.array([0.05, -0.02, 0.001, -0.002, 0.003, 0.01, 0.02, 0.001, 0.002, 0.001, -0.001, 0.002])[:count]
    rt = cameras.rt_from_matrix(pose())
    path = tmp_path / f"calibration.{suffix}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", K)
    if count:
        storage.write("distortion_coefficients", D[None])
    storage.write("rvec", rt[:3])
    storage.write("tvec", rt[3:])
    storage.release()
    close(foreign_cameras.read(path, (640, 480)), ROOM, cv2.projectPoints(ROOM, rt[:3], rt[3:], K, D)[0][:, 0])


def test_opencv_without_a_pose_is_a_lens(tmp_path):
    path = tmp_path / "c.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("camera_matrix", np.array([[500.0, 0, 322], [0, 510, 237], [0, 0, 1]]))
    storage.release()
    found = foreign_cameras.read(path, (640, 480))
    assert found.T is None and found.name == "left.cameramodel"


def test_what_is_written_is_read_as_the_same(tmp_path):
    reconstruction("OPENCV")[0].write_text(str(tmp_path))
    found = foreign_cameras.read(tmp_path, (640, 480), "other.jpg")
    found.write(tmp_path / "left.posed.cameramodel")
    again = foreign_cameras.read(tmp_path / "left.posed.cameramodel", (640, 480))
    assert again.kind == "mrcal"
    close(again, ROOM, found.project(ROOM))
