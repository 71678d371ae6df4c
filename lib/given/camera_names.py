"""Cameras of tools that are not read: by the first bytes of their files, each with its name and the way out."""

from __future__ import annotations

import re
from typing import NamedTuple

from lib.given.formats import Format

COLMAP = "export COLMAP's cameras.txt and images.txt"
BLENDER = "open it in Blender and run docs/blender_camera.py"
NUMBERS = "write fx, fy, cx, cy and the pose as OpenCV's JSON: camera_matrix, rvec, tvec"
COLUMNS = f"its matrices are written by columns: {NUMBERS}"


class Known(NamedTuple):
    """signs : each must stand in the head of the file;  what : its name;  way : what to do instead"""

    what: str
    way: str
    signs: tuple[str, ...]


# The first that fits. Signs are patterns of text; ^ is the start of a line, \A that of the file.
KNOWN = (
    # by their first bytes
    Known("a PNG picture", "CAMERA= is the camera's file", (r"\A\x89PNG",)),
    Known("a JPEG picture", "CAMERA= is the camera's file", (r"\A\xff\xd8\xff",)),
    Known("COLMAP's database", "give the folder of the reconstruction (sparse/0)", (r"\ASQLite format 3",)),
    Known("a .blend file", BLENDER, (r"\ABLENDER",)),
    Known("packed (zstd), perhaps a .blend file", BLENDER, (r"\A\x28\xb5\x2f\xfd",)),
    Known("packed (gzip)", "unpack it first", (r"\A\x1f\x8b",)),
    Known("an archive (zip: NumPy's .npz, Metashape's .psz, ...)", NUMBERS, (r"\APK\x03\x04",)),
    Known("NumPy's array (.npy; LLFF's poses_bounds.npy)", NUMBERS, (r"\A\x93NUMPY",)),
    Known("a Python pickle", f"a pickle can run programs: {NUMBERS}", (r"\A\x80[\x02-\x05]",)),
    Known("a MATLAB file", NUMBERS, (r"\AMATLAB \d",)),
    Known("an HDF5 file (MATLAB's .mat)", NUMBERS, (r"\A\x89HDF",)),
    Known("an FBX file", BLENDER, (r"\A(Kaydara FBX|; FBX)",)),
    Known("an Alembic file", BLENDER, (r"\AOgawa",)),
    Known("glTF's binary", BLENDER, (r"\AglTF",)),
    Known("USD", BLENDER, (r"\A(PXR-USDC|#usda)",)),
    # XML
    Known("Metashape's cameras", "File > Export > Export Cameras, as COLMAP", (r"<document\b", r"<chunk|<sensors")),
    Known("Metashape's project", "File > Export > Export Cameras, as COLMAP", (r"<document\b", r"\.files|psx")),
    Known("Agisoft's lens", "Tools > Camera Calibration > Save, as OpenCV XML", (r"<calibration>", r"<projection>")),
    Known("RealityCapture's XMP", "Export > Registration, as COLMAP", (r"xcr:|capturingreality",)),
    Known("an XMP file without a camera", COLMAP, (r"<x:xmpmeta",)),
    Known("ContextCapture's blocks", COLMAP, (r"<BlocksExchange",)),
    Known("MicMac's orientation", NUMBERS, (r"<ExportAPERO|OrientationC",)),
    Known("MeshLab's project", COLMAP, (r"<!DOCTYPE MeshLab|<MeshLabProject|<VCGCamera",)),
    Known("COLLADA", BLENDER, (r"<COLLADA",)),
    Known("Mitsuba's scene", "give it as MODEL, without CAMERA: its sensor is the camera", (r"<scene\b", r"<sensor\b")),
    Known("Mitsuba's scene", "it has no sensor: give it as MODEL, and the camera's file as CAMERA", (r"<scene\b",)),
    # JSON
    Known("OpenMVG's sfm_data", "export to COLMAP (openMVG_main_openMVG2Colmap)", (r'"sfm_data_version"',)),
    Known("Meshroom's cameras.sfm", "export to COLMAP (ExportColmap)", (r'"(featuresFolders|poseId|viewId)"',)),
    Known("Meshroom's project", "export its result to COLMAP (ExportColmap)", (r'"(nodesVersions|fileVersion)"',)),
    Known("OpenSfM's reconstruction", "export to COLMAP (opensfm export_colmap)", (r'"shots"', r'"projection_type"')),
    Known("OpenSfM's cameras", "export to COLMAP (opensfm export_colmap)", (r'"projection_type"',)),
    Known("SDFStudio's meta_data.json", "export to COLMAP, or to transforms.json", (r'"camtoworld"',)),
    Known("Polycam's camera", "run ns-process-data polycam, and give its transforms.json", (r'"t_00"', r'"t_23"')),
    Known("Basalt's calibration", NUMBERS, (r'"value0"', r'"T_imu_cam"')),
    Known("Open3D's camera", COLUMNS, (r'"intrinsic_matrix"', r'"(width|extrinsic)"')),
    Known("Open3D's camera", COLUMNS, (r'"class_name" *: *"PinholeCamera',)),
    Known("Gaussian Splatting's cameras.json", "give the COLMAP folder that it is of", (r'"img_name"', r'"fx"')),
    Known("ARKit's frame", "run ns-process-data, and give its transforms.json", (r'"cameraPoseARFrame"',)),
    Known("RealSense's intrinsics", NUMBERS, (r'"ppx" *:', r'"coeffs" *:')),
    Known("BOP's cameras", NUMBERS, (r'"cam_K" *:',)),
    Known("glTF", BLENDER, (r'"asset" *:', r'"(accessors|scenes|meshes|cameras)" *:')),
    # text
    Known("Bundler's bundle.out", f"it does not say its pictures' sizes: {COLMAP}", (r"\A# Bundle file",)),
    Known("VisualSFM's NVM", COLMAP, (r"\ANVM_V3",)),
    Known("RealityCapture's registration", "Export > Registration, as COLMAP", (r"\A#(cameras \d|name,x,y|image)",)),
    Known("Pix4D's calibrated cameras", COLMAP, (r"\AfileName imageWidth imageHeight",)),
    Known("Pix4D's lens", COLMAP, (r"^F \d[-\d.]* *\r?\nPx ",)),
    Known("KITTI's calibration", f"of P2 take fx, cx, fy, cy: {NUMBERS}", (r"^(P0|P_rect_00|K_00) *:",)),
    Known("Middlebury's calib.txt", NUMBERS, (r"^cam0 *= *\[",)),
    Known("MVSNet's camera", NUMBERS, (r"\Aextrinsic\s*\n", r"^intrinsic\s*$")),
    Known("OKVIS's settings", NUMBERS, (r"^cameras *:", r"T_SC *:")),
    Known("a fisheye of OCamCalib", "undistort the photograph first", (r"\A#polynomial coefficients",)),
    Known("PMVS's projection matrix", COLMAP, (r"\ACONTOUR\s",)),
    Known("ROS's older .ini", "convert it with camera_calibration_parsers", (r"^\[image\]", r"^camera matrix")),
    Known("MVE's meta.ini", COLMAP, (r"^\[camera\]", r"^focal_length *=")),
    Known("JPL's CAHVOR", "convert it with mrcal's mrcal-to-cameramodel", (r"^Model *= *CAHV",)),
    Known("Hugin's or PTGui's project", NUMBERS, (r"\A# ?(hugin project|ptGui project)",)),
    Known("a path of poses (TUM)", f"it has no lens: {NUMBERS}", (r"\A# *timestamp\S* +tx ty tz qx qy qz qw",)),
    Known("a path of poses (EuRoC)", f"it has no lens: {NUMBERS}", (r"\A# *timestamp\S*, *p_RS",)),
    Known("a path of poses (TUM)", f"it has no lens: {NUMBERS}", (r"\A *\d+\.\d+( +-?\d\S*){7} *$",)),
    Known("Nuke's or a .chan camera", BLENDER, (r"\A#! .*nuke|^Camera\d? \{",)),
)  # fmt: skip

FORMAT = Format(
    "cameras that are known by name",
    (),
    tuple(dict.fromkeys((known.what, known.way) for known in KNOWN)),
)


def of(head) -> str | None:
    """What a file is that is not read, with the way out: "OpenMVG's sfm_data: not read: export ...". None: not known

    head : its first bytes

    >>> of(b"# Bundle file v0.3")[:32]
    "Bundler's bundle.out: not read: "
    """
    text = head.removeprefix(b"\xef\xbb\xbf").decode("latin-1")
    for known in KNOWN:
        if all(re.search(sign, text, re.M) for sign in known.signs):
            return f"{known.what}: not read: {known.way}"
    return None
