"""Intact files of ordinary tools that were misread once: cameras. The files are in tests/data/cases, by number."""

import json
import shutil
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from lib.core.stage import BadInput
from lib.given import cameras, foreign_cameras, lenses, picks
from tests.helpers import consumers

DATA = Path(__file__).parent / "data"
CASES, BASE, WRITERS = DATA / "cases", DATA / "cases/base", DATA / "writers"
SIZE = (320, 240)
AHEAD = np.random.default_rng(5).uniform((-1, -1, 2), (1, 1, 4), (40, 3))  # of a camera without a pose
POINTS = np.random.default_rng(4).uniform((0.5, 1.5, 0), (3.5, 3.0, 2.4), (40, 3))


@pytest.fixture(scope="module")
def right():
    """The camera of the base scene."""
    return lenses.read(BASE / "room.cameramodel")


def seen(lens):
    return lens.project(POINTS @ lens.T_cam_ref[:3, :3].T + lens.T_cam_ref[:3, 3])


def refused(path, *words, size=SIZE, **more):
    with pytest.raises(BadInput) as caught:
        foreign_cameras.read(path, size, **more)
    (line,) = caught.value.problems
    assert str(path.parent) in line and "\n" not in line and all(word in line for word in words), line


def near(found, q, px=1e-6):
    assert np.abs(found.project(POINTS if found.T is not None else AHEAD) - q).max() < px


def projected(K, D, at=AHEAD):
    """By OpenCV: (N, 3) camera -> (N, 2) px."""
    return cv2.projectPoints(at, np.zeros(3), np.zeros(3), np.array(K), np.array(D, float))[0][:, 0]


# ---- 28: a fisheye is no k1 k2 p1 p2 ----


def test_28_a_fisheye_is_refused_where_the_file_says_so():
    folder = CASES / "28-opencv-fisheye-as-radtan"
    refused(folder / "fisheye.yml", "fisheye_model: a fisheye: undistort first")
    refused(folder / "ros.yaml", "distortion_model: equidistant: a fisheye: undistort first")


K = [[228.5, 0, 160.5], [0, 230.0, 118.5], [0, 0, 1.0]]


def written(path, size=True, **values):
    """As cv2.FileStorage writes it."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    sides = dict(zip(("image_width", "image_height"), SIZE, strict=True)) if size else {}
    for name, value in (sides | {"camera_matrix": K} | values).items():
        storage.write(name, np.array(value, float) if isinstance(value, list) else value)
    storage.release()
    return path


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
@pytest.mark.parametrize(
    ("values", "word"),
    [
        ({"fisheye_model": 1}, "fisheye_model: a fisheye"),
        ({"distortion_model": "fisheye"}, "distortion_model: fisheye: a fisheye"),
        ({"distortion_model": "KANNALA_BRANDT"}, "a fisheye"),
        ({"camera_model": "omni"}, "camera_model: omni: a fisheye"),
        ({"xi": 1.2}, "xi: an omnidirectional lens"),
        ({"flags": 10}, "flags: say that there is no tangential distortion"),
        ({"distortion_model": "division"}, "distortion_model: division is not known"),
        ({"distortion_model": "radial division"}, "distortion_model: radial division is not known"),
        ({"model": "distortion.inverse_brown_conrady"}, "inverse_brown_conrady is not known"),
    ],
)
def test_28_other_ways_to_say_it(tmp_path, suffix, values, word):
    path = written(tmp_path / f"a.{suffix}", distortion_coefficients=[[0.05, -0.01, 0.003, -0.001]], **values)
    refused(path, word)


def test_28_a_maker_s_name_is_no_model_of_a_lens(tmp_path):
    path = written(tmp_path / "a.yml", camera_model="Omnivision OV5640", distortion_model="plumb_bob")
    assert foreign_cameras.read(path, SIZE).kind == "OpenCV"


def test_28_flags_in_a_comment(tmp_path):
    path = written(tmp_path / "a.yml", distortion_coefficients=[[0.05, -0.01, 0.003, -0.001]])
    path.write_text(path.read_text().replace("---\n", "---\n# flags: +fix_skew +recompute_extrinsic\n", 1))
    refused(path, "flags: those of a fisheye")


def test_28_four_bare_numbers_are_said(tmp_path):
    path = written(tmp_path / "a.yml", distortion_coefficients=[[0.05, -0.01, 0.003, -0.001]])
    (line,) = foreign_cameras.read(path, SIZE).said
    assert line.startswith("4 distortion coefficients, read as k1 k2 p1 p2")
    path = written(
        path, distortion_coefficients=[[0.05, -0.01, 0.003, -0.001]], fisheye_model=0, distortion_model="radtan"
    )
    assert foreign_cameras.read(path, SIZE).said == ()


# ---- 30: a calibration of another size, and other matrices that are none of ours ----


@pytest.mark.parametrize(
    ("name", "size"), [("calib15.json", "480 x 360 (1.5 times"), ("calib.json", "1280 x 960 (4 times")]
)
def test_30_a_calibration_of_another_size_is_asked_about(name, size):
    refused(CASES / "30-opencv-other-resolution" / name, f"is it of a photograph of {size} as large)?")


def test_30_of_its_own_size_it_is_read(right):
    found = foreign_cameras.read(CASES / "30-opencv-other-resolution/calib15.json", (480, 360))
    near(found, 1.5 * seen(right))
    assert found.said == ("the file tells no size: taken to be of the photograph's 480 x 360",)


def dumped(path, K, **more):
    """As Python dumps it."""
    path.write_text(json.dumps({"camera_matrix": np.array(K).tolist(), **more}))
    return path


def test_30_where_the_file_tells_its_size(tmp_path):
    more = {"image_width": 320, "image_height": 240}
    path = dumped(tmp_path / "a.json", [[343, 0, 239.25], [0, 343, 179.25], [0, 0, 1]], **more)
    (line,) = foreign_cameras.read(path, SIZE).said
    assert "is it of a photograph of 480 x 360 (1.5 times as large)?" in line
    refused(path, "320 x 240 is not the photograph's 640 x 480 (0.5 times as large)", size=(640, 480))
    half = dumped(tmp_path / "b.json", [[114, 0, 79.5], [0, 114, 59.5], [0, 0, 1]])
    refused(half, "is it of a photograph of 160 x 120 (0.5 times as large)?")
    part = dumped(tmp_path / "c.json", [[228, 0, 60.5], [0, 228, 119.5], [0, 0, 1]])
    refused(part, "is it of another photograph, or of a part of one?")


@pytest.mark.parametrize(
    ("K", "word"),
    [
        ([[228.5, 2.5, 160], [0, 230, 118], [0, 0, 1]], "skew: K[0][1] = 2.5 px is not 0"),
        ([[228.5, 0, 0], [0, 230, 0], [160, 118, 1]], "is written by columns"),
        ([[0.714, 0, 0.5], [0, 0.952, 0.5], [0, 0, 1]], "are shares of the picture's width"),
        ([[228.5, 0, 160], [0, 230, 118], [0, 0, 2]], "is not fx 0 cx, 0 fy cy, 0 0 1"),
        ([[228.5, 0, 160], [0, 230, 118]], "3 x 3 numbers are needed"),
        ([[228.5, 0, 160], [0, -230, 118], [0, 0, 1]], "is not positive"),
    ],
)
def test_30_matrices_that_are_no_camera_s(tmp_path, K, word):
    refused(dumped(tmp_path / "a.json", K), word)


def test_30_tilt_binning_and_parts(tmp_path):
    D = [0.05, -0.01, 0.001, 0.002, 0.003, 0.01, 0.02, 0.001, 0.002, 0.001, -0.001, 0.002]
    flat = foreign_cameras.read(dumped(tmp_path / "a.json", K, dist=[[*D, 0, 0]], r=1), SIZE)
    near(flat, projected(K, D))
    refused(dumped(tmp_path / "b.json", K, dist=[[*D, 0.01, 0]]), "tilt the sensor")
    refused(dumped(tmp_path / "c.json", K, binning_x=2), "binning_x")
    refused(dumped(tmp_path / "d.json", K, roi={"x_offset": 8, "height": 100}), "roi: the picture is a part")
    left = foreign_cameras.read(dumped(tmp_path / "e.json", K, rvecs=[[1]], projection_matrix=[1], R=[1], t=[2]), SIZE)
    assert "1 board pose table, 1 rectification value: not read" in left.said
    assert any(line.startswith("R and T are not read") for line in left.said)
    far = dumped(tmp_path / "f.json", K, rvec=[0, 0, 0], tvec=[0, 0, 2114.0])
    assert any("is it in mm?" in line for line in foreign_cameras.read(far, SIZE).said)


# ---- 31: tools by their names ----

STEREO = CASES / "31-foreign-cameras-unnamed/intrinsics.yml"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("bundle.out", "is Bundler's bundle.out: not read: "),
        ("metashape.xml", "is Metashape's cameras: not read: File > Export > Export Cameras, as COLMAP"),
        ("room.xmp", "is RealityCapture's XMP: not read: Export > Registration, as COLMAP"),
        ("sfm_data.json", "is OpenMVG's sfm_data: not read: export to COLMAP"),
        ("topic.yaml", "distortion_model: equidistant: a fisheye: undistort first"),
        ("intrinsics.yml", "IMAGE: the file has the cameras of a stereo pair: say IMAGE=left or IMAGE=right"),
    ],
)
def test_31_refused_by_name(name, words):
    refused(CASES / "31-foreign-cameras-unnamed" / name, words)


@pytest.mark.parametrize(
    ("name", "kind", "image"),
    [
        ("camchain.yaml", "Kalibr", None),
        ("mtx.json", "OpenCV", None),
        ("intrinsics.yml", "OpenCV", "left"),
        ("transforms.json", "nerfstudio", None),
        ("transforms.json", "nerfstudio", "room.png"),
    ],
)
def test_31_read(right, name, kind, image):
    found = foreign_cameras.read(CASES / "31-foreign-cameras-unnamed" / name, SIZE, image)
    assert found.kind == kind and np.abs(found.intrinsics[:4] - right.intrinsics).max() < 1e-9
    if kind == "nerfstudio":
        near(found, seen(right))


def test_31_numbers_of_numpy_2():
    path = CASES / "31-foreign-cameras-unnamed/np2.cameramodel"
    assert foreign_cameras.read(path, SIZE).intrinsics.tolist() == [228.5, 228.5, 159.5, 119.5]
    assert lenses.read(path).intrinsics.tolist() == [228.5, 228.5, 159.5, 119.5]


KNOWN = {
    "cameras.sfm": b'{"version": ["1","2"], "views": [{"viewId": "1"}]}',
    "reconstruction.json": b'[{"cameras": {"a": {"projection_type": "perspective"}}, "shots": {}}]',
    "scene.nvm": b"NVM_V3\n\n2\n",
    "calib.txt": b"P0: 7.07e+02 0 6.0e+02 0 0 7.07e+02 1.8e+02 0 0 0 1 0\n",
    "a.npz": b"PK\x03\x04abc",
    "a.npy": b"\x93NUMPY\x01\x00",
    "a.pkl": b"\x80\x04\x95",
    "a.mat": b"MATLAB 5.0 MAT-file",
    "room.blend": b"BLENDER-v300",
    "a.yml.gz": b"\x1f\x8b\x08",
    "database.db": b"SQLite format 3\x00",
    "cam.fbx": b"Kaydara FBX Binary",
    "photo.png": b"\x89PNG\r\n",
    "lens.xml": b'<?xml version="1.0"?><calibration><projection>frame</projection></calibration>',
    "calibrated_camera_parameters.txt": b"fileName imageWidth imageHeight \n",
    "meta_data.json": b'{"frames": [{"camtoworld": []}]}',
    "intrinsic.json": b'{"width": 640, "height": 480, "intrinsic_matrix": [500, 0, 0, 0, 500, 0, 320, 240, 1]}',
    "traj.txt": b"1305031102.17 1.3 0.6 1.6 0.6 0.6 -0.2 -0.2\n",
    "blocks.xml": b"<BlocksExchange version='3'/>",
    "camera.gltf": b'{"asset": {"version": "2.0"}, "cameras": []}',
}


@pytest.mark.parametrize("name", KNOWN)
def test_31_more_tools_by_name(tmp_path, name):
    (tmp_path / name).write_bytes(KNOWN[name])
    refused(tmp_path / name, ": is ", ": not read: ")
    (tmp_path / "left.cameramodel").write_bytes(KNOWN[name])
    with pytest.raises(BadInput, match="not a camera model: is .*: not read: "):
        lenses.read(tmp_path / "left.cameramodel")


def test_31_k1_of_a_lens_is_no_matrix_of_a_pair(tmp_path):
    (tmp_path / "a.yml").write_text("k1: 0.1\nk2: 0.2\n")
    refused(tmp_path / "a.yml", "is no camera that is known (k1, k2)")


def test_31_what_no_tool_is_known_for(tmp_path):
    for text in ("hello\n", '{"a": 1}', "a: 1\n", "<a><b/></a>"):
        (tmp_path / "x").write_text(text)
        refused(tmp_path / "x", "read are mrcal, COLMAP, OpenCV")


def test_31_a_stereo_pair_of_opencv(tmp_path):
    path = written(
        tmp_path / "a.yml", M1=K, D1=[0.1, 0, 0, 0, 0], M2=[[300, 0, 150], [0, 300, 119], [0, 0, 1]], camera_matrix=0
    )
    path.write_text(path.read_text().replace("camera_matrix: 0\n", ""))
    for image, fx in (("left", 228.5), ("right", 300), ("2", 300)):
        found = foreign_cameras.read(path, SIZE, image)
        assert (
            found.intrinsics[0] == fx and f"the {'left' if fx < 300 else 'right'} camera of a stereo pair" in found.said
        )
    assert foreign_cameras.read(path, SIZE, "left").intrinsics[4] == 0.1


ROS2 = """header:
  stamp: {sec: 1, nanosec: 2}
  frame_id: cam
height: 240
width: 320
distortion_model: MODEL
d:
- 0.05
- -0.01
- 0.001
- 0.002
- 0.003
k:
- 228.5
- 0.0
- 160.5
- 0.0
- 230.0
- 118.5
- 0.0
- 0.0
- 1.0
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
p: [200.0, 0.0, 160.5, 0.0, 0.0, 200.0, 118.5, 0.0, 0.0, 0.0, 1.0, 0.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
"""
KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.05, -0.01, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [228.5, 230.0, 160.5, 118.5]
  resolution: [320, 240]
cam1:
  T_cn_cnm1: [[1, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
  camera_model: MODEL
  distortion_coeffs: [0.05, -0.01, 0.001, 0.002]
  distortion_model: equidistant
  intrinsics: [228.5, 230.0, 160.5, 118.5]
  resolution: [320, 240]
"""
EUROC = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
resolution: [320, 240]
camera_model: pinhole
intrinsics: [228.5, 230.0, 160.5, 118.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [0.05, -0.01, 0.001, 0.002]
"""
SLAM = """%YAML:1.0
Camera.type: "PinHole"
Camera.fx: 228.5
Camera.fy: 230.0
Camera.cx: 160.5
Camera.cy: 118.5
Camera.k1: 0.05
Camera.k2: -0.01
Camera.p1: 0.001
Camera.p2: 0.002
Camera.width: 320
Camera.height: 240
ORBextractor.nFeatures: 1200
"""
VINS = """%YAML:1.0
---
model_type: PINHOLE
camera_name: camera
image_width: 320
image_height: 240
distortion_parameters:
   k1: 0.05
   k2: -0.01
   p1: 0.001
   p2: 0.002
projection_parameters:
   fx: 228.5
   fy: 230.0
   cx: 160.5
   cy: 118.5
"""


@pytest.mark.parametrize(
    ("text", "kind", "image"),
    [
        (ROS2.replace("MODEL", "plumb_bob"), "OpenCV", None),
        (2 * ROS2.replace("MODEL", "plumb_bob"), "OpenCV", None),
        (KALIBR, "Kalibr", "cam0"),
        (EUROC, "EuRoC", None),
        (SLAM, "ORB-SLAM", None),
        (VINS, "VINS", None),
    ],
)
def test_31_lenses_of_robotics(tmp_path, text, kind, image):
    (tmp_path / "a.yaml").write_text(text)
    found = foreign_cameras.read(tmp_path / "a.yaml", SIZE, image)
    D = np.array([0.05, -0.01, 0.001, 0.002, 0.003][: 5 if kind == "OpenCV" else 4])
    assert found.kind == kind and found.T is None
    near(found, projected(K, D))


def test_31_fisheyes_of_robotics(tmp_path):
    path = tmp_path / "a.yaml"
    path.write_text(KALIBR)
    refused(path, "IMAGE: say which camera: IMAGE=cam0 or IMAGE=cam1")
    refused(path, "camera_model: model", "undistort first", image="cam1")
    path.write_text(KALIBR.replace("MODEL", "pinhole"))
    refused(path, "distortion_model: equidistant is not radtan: undistort first", image="cam1")
    for text in (
        SLAM.replace("PinHole", "KannalaBrandt8"),
        VINS.replace("PINHOLE", "MEI"),
        ROS2.replace("MODEL", "equidistant"),
    ):
        path.write_text(text)
        refused(path, "a fisheye: undistort first")


def nerf(path, right, frame=None, **more):
    T = np.linalg.inv(np.diag([1.0, -1, -1, 1]) @ right.T_cam_ref)
    told = {"fl_x": 228.5, "fl_y": 230.0, "cx": 161.0, "cy": 119.0, "w": 320, "h": 240}
    frames = [{"file_path": f"images/{name}", "transform_matrix": T.tolist()} for name in ("a.png", "b.jpg")]
    frames[1] |= frame or {}
    path.write_text(json.dumps({**told, **more, "frames": frames}))
    return path


def test_31_nerfstudio(tmp_path, right):
    T, path = right.T_cam_ref, tmp_path / "transforms.json"
    at = POINTS @ T[:3, :3].T + T[:3, 3]
    of = lambda D, K=K: projected(K, D, at)
    near(foreign_cameras.read(nerf(path, right), SIZE, "b.jpg"), of([0, 0, 0, 0]))
    D = {"k1": 0.05, "k2": -0.01, "p1": 0.001, "p2": 0.002}
    near(foreign_cameras.read(nerf(path, right, camera_model="OPENCV", **D), SIZE, "b"), of(list(D.values())))
    near(foreign_cameras.read(nerf(path, right, D | {"k3": 0.02}), SIZE, "b.jpg"), of([*D.values(), 0.02]))
    refused(path, "IMAGE: say which: IMAGE=... is one of images/a.png, images/b.jpg")
    refused(path, "c.png is not there", image="c.png")
    for more in ({"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}, {"k4": 0.1}):
        refused(nerf(path, right, **more), "undistort first", image="b.jpg")
    angle = {"camera_angle_x": 2 * np.arctan(160 / 228.5), "fl_x": None, "fl_y": None, "cx": 161, "cy": 119}
    square = [[228.5, 0, 160.5], [0, 228.5, 118.5], [0, 0, 1]]
    near(foreign_cameras.read(nerf(path, right, **angle), SIZE, "b.jpg"), of([0, 0, 0, 0], square))
    near(foreign_cameras.read(nerf(path, right, w=None, h=None), SIZE, "b.jpg"), of([0, 0, 0, 0]))
    refused(nerf(path, right, w=None, h=None), "640 x 480", "320 x 240 (0.5", size=(640, 480), image="b.jpg")


def test_31_nerfstudio_s_own_frame_is_undone(tmp_path, right):
    """x' = 2 A x, as nerfstudio's process_data says it: the camera stands in the frame of x."""
    A = np.array([[0, 1, 0, 0.5], [1, 0, 0, 0], [0, 0, -1.0, 2]])
    T = np.linalg.inv(np.diag([1.0, -1, -1, 1]) @ right.T_cam_ref)
    moved = np.vstack([A, [0, 0, 0, 1]]) @ T
    moved[:3, 3] *= 2
    frame = {"transform_matrix": moved.tolist(), "applied_transform": A.tolist(), "applied_scale": 2.0}
    found = foreign_cameras.read(nerf(tmp_path / "t.json", right, frame), SIZE, "b.jpg")
    assert np.abs(found.T - right.T_cam_ref).max() < 1e-12
    assert any("applied_transform is undone" in line for line in found.said)


# ---- 32 and 34: COLMAP ----


def test_32_another_camera_spoils_nothing(right):
    folder = CASES / "32-colmap-one-camera-spoils-all/mixed"
    for path in (folder, folder / "images.bin", folder / "txt", folder / "txt/rigs.txt"):
        found = foreign_cameras.read(path, SIZE, "phone/IMG_1.png")
        D = np.array([-0.05, 0.01, 0.001, -0.002])
        f = 228.50368107873834
        own = np.array([[f, 0, 159.5], [0, 1.01 * f, 119.5], [0, 0, 1]])
        T = right.T_cam_ref
        at = POINTS @ T[:3, :3].T + T[:3, 3]
        near(found, projected(own, D, at))
        refused(path, "camera 2: OPENCV_FISHEYE: run COLMAP's image_undistorter", image="gopro/G1.png")
    (line,) = foreign_cameras.read(folder, SIZE, "img_1.png").said
    assert line == "IMAGE: img_1.png is phone/IMG_1.png"


@pytest.fixture(scope="module")
def made():
    """A reconstruction of pycolmap's with a camera of each of its models, and a rig of two."""
    pycolmap = pytest.importorskip("pycolmap")
    rec, T = pycolmap.Reconstruction(), cameras.towards((0.2, -2.5, 1.4), (2.1, 2.0, 1.1))
    names = [name for name in pycolmap.CameraModelId.__members__ if name != "INVALID"]
    for k, name in enumerate(names, 1):
        model = getattr(pycolmap.CameraModelId, name)
        camera = pycolmap.Camera.create_from_model_id(k, model, 300.0, *SIZE)
        params = np.array(camera.params)
        if name in foreign_cameras.colmap.READ:
            params[len(foreign_cameras.colmap.READ[name][0]) - (name.startswith("S") or name == "RADIAL") :] += 0.002
            camera.params = params
        rec.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(name=f"{name} a.jpg", camera_id=k, image_id=k)
        rec.add_image_with_trivial_frame(image, pycolmap.Rigid3d(T[:3]))
    return rec, names, T


def test_32_all_models_of_colmap(made, tmp_path):
    """Their numbers and parameters are those that pycolmap writes; those that are read are projected as it does."""
    rec, names, T = made
    assert len(names) == len(foreign_cameras.colmap.MODELS) == 18
    (tmp_path / "bin").mkdir(), (tmp_path / "txt").mkdir()
    rec.write_binary(str(tmp_path / "bin")), rec.write_text(str(tmp_path / "txt"))
    at = POINTS @ T[:3, :3].T + T[:3, 3]
    for k, name in enumerate(names, 1):
        for form in ("bin", "txt"):
            if name not in foreign_cameras.colmap.READ:
                refused(tmp_path / form, f"camera {k}: {name}: run COLMAP's image_undistorter", image=f"{name} a.jpg")
                continue
            found = foreign_cameras.read(tmp_path / form, SIZE, f"{name} a.jpg")
            near(found, np.array(rec.camera(k).img_from_cam(at)) - 0.5)


def test_32_images_of_a_rig_keep_their_own_poses(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    rec, sensor = pycolmap.Reconstruction(), lambda k: pycolmap.sensor_t(pycolmap.SensorType.CAMERA, k)
    for k in (1, 2):
        rec.add_camera(pycolmap.Camera.create_from_model_id(k, pycolmap.CameraModelId.PINHOLE, 300.0, *SIZE))
    rig = pycolmap.Rig(rig_id=1)
    rig.add_ref_sensor(sensor(1))
    turn = pycolmap.Rotation3d(np.array([0, 0.05, 0.1, 0.99]))
    rig.add_sensor(sensor(2), pycolmap.Rigid3d(turn, np.array([0.5, 0, 0])))
    rec.add_rig(rig)
    frame = pycolmap.Frame(frame_id=1, rig_id=1)
    for k in (1, 2):
        frame.add_data_id(pycolmap.data_t(sensor(k), k))
    frame.rig_from_world = pycolmap.Rigid3d(cameras.towards((0.2, -2.5, 1.4), (2.1, 2.0, 1.1))[:3])
    rec.add_frame(frame)
    for k in (1, 2):
        image = pycolmap.Image(name=f"cam{k}/a.jpg", camera_id=k, image_id=k)
        image.frame_id = 1
        rec.add_image(image)
    rec.register_frame(1)
    for write in (rec.write_binary, rec.write_text):
        write(str(tmp_path))
        found = foreign_cameras.read(tmp_path, SIZE, "cam2/a.jpg")
        at = np.array([rec.image(2).cam_from_world() * p for p in POINTS])
        near(found, np.array(rec.camera(2).img_from_cam(at)) - 0.5)
    assert found.said == ("both .bin and .txt are there: the .bin files are read, as COLMAP does",)
    refused(tmp_path, "a.jpg is several: say which", image="a.jpg")


def test_32_models_below_the_folder(tmp_path):
    source = CASES / "34-colmap-images-without-points/nopoints"
    shutil.copytree(source, tmp_path / "one/sparse/0")
    found = foreign_cameras.read(tmp_path / "one", SIZE, "IMG_2.png")
    assert found.said == ("read of sparse/0",)
    foreign_cameras.read(tmp_path / "one/sparse", SIZE, "IMG_2.png")
    for k in (0, 1):
        shutil.copytree(source, tmp_path / f"two/sparse/{k}")
    refused(
        tmp_path / "two",
        "2 of them have IMG_2.png: give one as CAMERA=: sparse/0 (5 images), sparse/1",
        image="IMG_2.png",
    )
    refused(tmp_path / "two", "IMAGE is not told")
    text = (source / "images.txt").read_text().replace("IMG_2.png", "IMG_9.png")
    (tmp_path / "two/sparse/1/images.txt").write_text(text)
    found = foreign_cameras.read(tmp_path / "two", SIZE, "IMG_9.png")
    assert found.said == ("read of sparse/1, which alone has IMG_9.png",)
    (tmp_path / "none").mkdir()
    refused(tmp_path / "none", "no reconstruction of COLMAP's")


def test_34_images_without_points(right):
    folder = CASES / "34-colmap-images-without-points/nopoints"
    for k in range(1, 6):
        found = foreign_cameras.read(folder, SIZE, f"IMG_{k}.png")
        assert np.abs(found.intrinsics - [228.50368107873834, 230.78871788952571, 162.5, 117.5]).max() < 1e-12
        assert np.abs(found.T - right.T_cam_ref).max() < 1e-9
    refused(folder, "IMG_1.png, IMG_2.png, IMG_3.png, IMG_4.png, IMG_5.png", image="x.png")


@pytest.mark.parametrize("points", ["", "\n", "10.5 20.5 -1 3 4 7 1 2 3 4 5 6\n", "\n\n"])
def test_34_any_second_lines(tmp_path, points):
    """Also with blanks or digits alone in names, and lines that Windows ends."""
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 320 240 228.5 230 163 118\n")
    names = ["a b.png", "0001", "12 3.png", "c.png"]
    lines = [f"{k} 1 0 0 0 {k} 0 0 1 {name}\n{points}" for k, name in enumerate(names, 1)]
    for text in ("".join(lines), "# Image list\n" + "".join(lines).replace("\n", "\r\n")):
        (tmp_path / "images.txt").write_text(text)
        for k, name in enumerate(names, 1):
            assert foreign_cameras.read(tmp_path, SIZE, name).T[0, 3] == k


def test_34_lines_that_are_neither(tmp_path):
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 320 240 228.5 230 163 118\n")
    for text in ("1 1 0 0 0 0 0 0 1 a.png\n1 2\n", "1 1 0 0 0 0 0 0 a.png\n"):
        (tmp_path / "images.txt").write_text(text)
        refused(tmp_path, "neither an image of ten columns nor the points of one", image="a.png")
    (tmp_path / "images.txt").write_text(2 * "1 1 0 0 0 0 0 0 1 a.png\n\n")
    refused(tmp_path, "a.png is there twice", image="a.png")


# ---- 35: fSpy's real projects ----


@pytest.mark.parametrize("name", ["one", "two"])
def test_35_size_of_the_picture_and_both_forms_of_the_horizon(tmp_path, right, name):
    state = (CASES / f"35-fspy-project-without-parameters/{name}.json").read_bytes()
    picture = (BASE / "room.png").read_bytes()
    path = tmp_path / f"{name}.fspy"
    path.write_bytes(b"fspy" + struct.pack("<III", 1, len(state), len(picture)) + state + picture)
    found = foreign_cameras.read(path, SIZE)
    assert np.abs(found.intrinsics - right.intrinsics).max() < 1e-6
    # x is told to point to where its lines meet, which lies to the left: x and so z point the other way
    R = found.T[:3, :3] @ np.diag([-1.0, 1, -1])
    assert np.abs(R - right.T_cam_ref[:3, :3]).max() < 1e-6
    assert abs(np.linalg.norm(found.T[2, 3]) - 10) < 1e-9 and "no reference distance is set" in found.said[0]
    bare = b"fspy" + struct.pack("<III", 1, len(state), 0) + state
    path.write_bytes(bare)
    refused(path, "neither cameraParameters nor a picture", "open it in fSpy 1.0.3 and save it")
    path.write_bytes(bare + b"GIF89a")
    refused(path, "its picture is not readable", "open it in fSpy 1.0.3 and save it")


# ---- 39: Blender ----


@pytest.mark.parametrize(
    ("type", "words"),
    [
        (None, "run docs/blender_camera.py again"),
        ("ORTHO", "is orthographic: set it to Perspective"),
        ("PANO", "is panoramic"),
    ],
)
def test_39_only_perspective_cameras(tmp_path, type, words):
    told = json.loads((CASES / "39-blender-orthographic-camera/ortho.camera.json").read_text())
    path = tmp_path / "ortho.camera.json"
    path.write_text(json.dumps(told if type is None else {"type": type, **told}))
    refused(path, f"{path}: type: ", words)


def test_39_written_by_blender(tmp_path):
    told = json.loads((WRITERS / "blender/seen.json").read_text())
    found = foreign_cameras.read(WRITERS / "blender/room.camera.json", SIZE)
    assert np.abs(found.project(told["p"]) - told["q"]).max() < 5e-4  # of Blender's single precision


@pytest.mark.outside
def test_39_the_script_refuses(tmp_path):
    if why := consumers.absent("bpy"):
        pytest.skip(why)
    told = consumers.ask("blender_refusals", tmp_path)
    assert told["ORTHO"] == "the camera is orthographic: set it to Perspective"
    assert told["PANO"] == "the camera is panoramic: set it to Perspective"
    assert told["none"].startswith("the scene has no camera") and told["written"] == []


# ---- mrcal's own files, and orientation ----


@pytest.mark.parametrize("name", ["pinhole", "opencv5", "opencv8", "stereographic"])
def test_written_by_mrcal(name):
    told = json.loads((WRITERS / "mrcal/seen.json").read_text())
    found = foreign_cameras.read(WRITERS / f"mrcal/{name}.cameramodel", SIZE)
    assert np.abs(found.project(told["p"]) - told["q"][name]).max() < 1e-6


def as_shown(turn):
    """(H, W, 2) for each pixel that a viewer shows, by Pillow, the (x, y) that is stored there."""
    from PIL import Image, ImageOps

    maps = []
    for values in np.meshgrid(np.arange(320.0), np.arange(240.0)):
        picture = Image.fromarray(values.astype("f4"))
        picture.getexif()[274] = turn
        maps.append(np.array(ImageOps.exif_transpose(picture)))
    return np.stack(maps, -1)


@pytest.mark.parametrize("turn", [1, 3, 6, 8])
@pytest.mark.parametrize("count", [0, 5, 12])
def test_a_camera_of_stored_pixels_is_turned_with_the_photograph(tmp_path, right, turn, count):
    D = [0.05, -0.02, 0.01, -0.02, 0.003, 0.01, 0.02, 0.001, 0.02, 0.01, -0.01, 0.02][:count]
    rt = cameras.rt_from_matrix(right.T_cam_ref)
    path = written(
        tmp_path / "a.yml", distortion_coefficients=[D or [0.0] * 4], rvec=rt[:3].tolist(), tvec=rt[3:].tolist()
    )
    stored = cv2.projectPoints(POINTS, rt[:3], rt[3:], np.array(K), np.array(D or [0.0] * 4))[0][:, 0]
    shown = as_shown(turn)
    found = foreign_cameras.read(path, shown.shape[1::-1], turn=turn)
    assert any(f"EXIF's orientation {turn}" in line for line in found.said) == (turn > 1)
    q = found.project(POINTS)
    inside = ((q > 0) & (q < np.array(shown.shape[1::-1]) - 1)).all(1)
    at = cv2.remap(shown.astype("f4"), q[None].astype("f4"), None, cv2.INTER_LINEAR)[0]
    assert inside.sum() > 10 and np.abs(at - stored)[inside].max() < 0.04  # OpenCV interpolates in steps of 1/32 px
    origin, right_, down = shown[0, 0], shown[0, 1] - shown[0, 0], shown[1, 0] - shown[0, 0]
    assert np.abs(origin + q[:, :1] * right_ + q[:, 1:] * down - stored).max() < 1e-9


@pytest.mark.parametrize("turn", [2, 4, 5, 7])
def test_mirrored_photographs_are_refused(tmp_path, turn):
    size = SIZE if turn < 5 else SIZE[::-1]
    refused(written(tmp_path / "a.yml"), f"mirror the photograph (EXIF's orientation {turn})", size=size, turn=turn)


def test_the_size_tells_which_pixels_are_meant(tmp_path):
    """COLMAP's later versions turn the photograph themselves; fSpy counts what it shows."""
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 240 320 228.5 230 118 163\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    found = foreign_cameras.read(tmp_path, (240, 320), turn=6)
    assert found.T[0, 0] == 1 and "taken as they are" in found.said[0]
    view = {"rows": np.eye(4).tolist()}
    told = {"cameraTransform": view, "horizontalFieldOfView": 1.0, "principalPoint": {"x": 0.1, "y": 0}}
    (tmp_path / "a.fspy.json").write_text(json.dumps(told | {"imageWidth": 320, "imageHeight": 240}))
    found = foreign_cameras.read(tmp_path / "a.fspy.json", SIZE, turn=3)
    assert abs(found.intrinsics[2] - (159.5 + 16)) < 1e-9 and "taken as they are" in found.said[-1]


def test_a_lens_that_cannot_be_turned(tmp_path):
    numbers = ", ".join(["228.5", "230", "160", "118", "0.1", "0.1", "0", "0", "0"])
    path = tmp_path / "a.cameramodel"
    path.write_text(
        f"{{'lensmodel': 'LENSMODEL_CAHVOR', 'intrinsics': [{numbers}], 'extrinsics': [0, 0, 0, 0, 0, 0], "
        "'imagersize': [320, 240]}"
    )
    refused(path, "LENSMODEL_CAHVOR cannot be turned", turn=3)


def test_new_scene_turns_the_camera_and_says_so(run, tmp_path):
    """A photograph that EXIF turns by half, and mrcal's camera of the stored pixels."""
    from PIL import Image

    picture = Image.open(BASE / "room.png").convert("RGB").rotate(180)
    exif = picture.getexif()
    exif[274] = 3
    picture.save(tmp_path / "room.jpg", exif=exif, quality=95)
    told = lenses.read(BASE / "room.cameramodel")
    T = np.diag([-1.0, -1, 1, 1]) @ told.T_cam_ref
    camera = cameras.Camera(told.K, 320, 240, T)
    cameras.write_cameramodel(tmp_path / "room.cameramodel", camera)
    for name in ("room.obj", "room.mtl"):
        shutil.copy(BASE / name, tmp_path)
    files = {"model": "room.obj", "photo": "room.jpg", "camera": "room.cameramodel"}
    options = [word for key, name in files.items() for word in (f"--{key}", tmp_path / name)]
    done = run("stages/new_scene.py", "--data", tmp_path / "data", "--name", "a", *options)
    assert done.returncode == 0 and "the camera is turned with it" in done.stdout, done.stdout + done.stderr
    made = lenses.read(tmp_path / "data/a/left.posed.cameramodel")
    assert np.abs(seen(made) - seen(told)).max() < 1e-6


@pytest.mark.parametrize("counts", ["stored", "shown"])
def test_01_edges_tell_which_pixels_a_camera_of_a_turned_photograph_counts(run, tmp_path, counts):
    """EXIF 3 keeps the size: a camera of mrcal's is turned with the picture, unless the picture says otherwise."""
    exif = Image.Exif()
    exif[274] = 3
    Image.open(BASE / "room.png").convert("RGB").rotate(180).save(tmp_path / "a.jpg", quality=95, exif=exif)
    foreign_cameras.read(BASE / "room.cameramodel", (320, 240), turn=3).write(tmp_path / "stored.cameramodel")
    shutil.copy(BASE / "room.cameramodel", tmp_path / "shown.cameramodel")
    words = [f"--model={BASE / 'room.obj'}", f"--photo={tmp_path / 'a.jpg'}", "--name=x", f"--data={tmp_path}"]
    done = run("stages/new_scene.py", *words, f"--camera={tmp_path / counts}.cameramodel")
    assert done.returncode == 0, done
    right, found = (
        cameras.read_cameramodel(p) for p in (BASE / "room.cameramodel", tmp_path / "x/left.posed.cameramodel")
    )
    p = np.array([[1.0, 3, 1], [2, 3, 0.5], [3, 4, 2]])
    assert np.abs(right.project(p) - found.project(p)).max() < 1e-6
    assert ("so say the photograph's edges" in done.stdout) == (counts == "shown")


# ---- what else ordinary tools write ----

KNOWN_NUMBERS = "write fx, fy, cx, cy and the pose as OpenCV's JSON"


@pytest.mark.parametrize(
    "text, says",
    [
        ('{"width": 320, "fx": 1, "ppx": 2, "model": "brown", "coeffs": [0]}', "RealSense's intrinsics: not read"),
        ('{"0": {"cam_K": [1, 0, 2], "cam_t_w2c": [1, 2, 3]}}', "BOP's cameras: not read"),
        ('{"intrinsics": {"fx": 1, "fy": 2, "cx": 3, "cy": 4}, "dist": [0]}', KNOWN_NUMBERS),
        ('{"fx": 300, "fy": 305, "cx": 170, "cy": 115}', KNOWN_NUMBERS),
        (
            "# oST version 5.0 parameters\n\n[image]\n\nwidth\n320\n\n[cam]\n\ncamera matrix\n3 0 1\n",
            "camera_calibration",
        ),
        ("image_width: 320\n".encode("utf-16"), "not UTF-8 but UTF-16: save it as UTF-8"),
    ],
    ids=["RealSense", "BOP", "intrinsics by name", "bare numbers", "ROS's .ini", "UTF-16"],
)
def test_the_way_out_of_more_cameras(tmp_path, text, says):
    path = tmp_path / "a.yaml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(BadInput) as bad:
        foreign_cameras.read(path, (320, 240))
    assert says in str(bad.value)


def test_dim_is_a_size(tmp_path):
    """As the scripts that everyone copies write it: a calibration at twice the size is not taken for one of it."""
    path = tmp_path / "a.yaml"
    path.write_text("DIM: [640, 480]\nK: [[300, 0, 170], [0, 300, 115], [0, 0, 1]]\nD: [0.1, 0, 0, 0, 0]\n")
    with pytest.raises(BadInput, match="640 x 480 is not the photograph's 320 x 240"):
        foreign_cameras.read(path, (320, 240))


# ---- picks as spreadsheets write them ----

PICKED = "x_px,y_px,X,Y,Z\n100.5,50.25,0,0,0\n200,60,1.5,0,0\n120,150,0,2,0\n50,70,0,0,2.5\n"


@pytest.mark.parametrize(
    "text",
    [
        PICKED.replace("\n", "\r\n"),
        "\ufeff" + PICKED,
        '"x_px","y_px","X","Y","Z"\n' + PICKED.partition("\n")[2],
        PICKED.replace("\n", ",,\n"),
        PICKED + ",,,,\n,,,,\n",
    ],
    ids=["CRLF", "mark of the order", "quoted", "empty columns", "empty rows"],
)
def test_picks_of_a_spreadsheet(tmp_path, text):
    (tmp_path / "a.csv").write_bytes(text.encode())
    found = picks.read(tmp_path / "a.csv")
    assert np.array_equal(found.q, [[100.5, 50.25], [200, 60], [120, 150], [50, 70]])
    assert np.array_equal(found.p, [[0, 0, 0], [1.5, 0, 0], [0, 2, 0], [0, 0, 2.5]])


@pytest.mark.parametrize(
    "content, says",
    [
        (PICKED.replace(",", ";").replace(".", ",").encode(), "semicolons: use commas"),
        (PICKED.replace(",", "\t").encode(), "tabs: use commas"),
        (PICKED.encode("utf-16"), "not UTF-8 but UTF-16: save it as UTF-8"),
        (b"PK\x03\x04" + bytes(99), "is a spreadsheet: save it as CSV"),
        (PICKED.replace("200", '"1,200"').encode(), "'1,200' is not a number"),
    ],
    ids=["German", "tabs", "UTF-16", "xlsx", "thousands"],
)
def test_picks_that_would_be_misread(tmp_path, content, says):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(BadInput) as bad:
        picks.read(tmp_path / "a.csv")
    assert says in str(bad.value)


def test_rows_that_a_sign_hides_are_counted(tmp_path):
    """#1 is a name for a person, and a comment for the reader."""
    (tmp_path / "a.csv").write_text("name,x_px,y_px,X,Y,Z\n# by hand\n#1,1,2,3,4,5\n#2,2,2,3,4,5\nc,3,2,3,4,5\n")
    assert picks.commented(tmp_path / "a.csv") == 2
    assert len(picks.read(tmp_path / "a.csv").q) == 1


def test_a_sensor_whose_sides_nobody_knows_is_no_other_one(tmp_path):
    """The sides beside its name are those of the last sensor that was told by numbers."""
    state = json.loads((CASES / "35-fspy-project-without-parameters/one.json").read_bytes())
    state["calibrationSettingsBase"]["cameraData"] |= {"presetId": "of_tomorrow", "presetData": None}
    told, picture = json.dumps(state).encode(), (BASE / "room.png").read_bytes()
    head = b"fspy" + struct.pack("<III", 1, len(told), len(picture))
    (tmp_path / "a.fspy").write_bytes(head + told + picture)
    with pytest.raises(BadInput, match="sensor 'of_tomorrow' are not told: open it in fSpy"):
        foreign_cameras.read(tmp_path / "a.fspy", (320, 240))
