"""Files that are nearly what a scene needs: under another name, or of another kind. Without NumPy."""

import difflib
from pathlib import Path

CAMERA = ".cameramodel"
RENAMED = {".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg", ".jfif": ".jpg", ".tif": ".tif", ".tiff": ".tif"}
RENAMED |= {".exr": ".exr", ".obj": ".obj", ".glb": ".glb"}
PICTURES = (".png", ".jpg", ".jpeg", ".jfif", ".tif", ".tiff", ".exr")
MODELS = (".obj", ".glb")
RAW = (".dng", ".arw", ".nef", ".cr2", ".cr3", ".orf", ".rw2", ".raf")
OTHER_PICTURES = (".heic", ".heif", ".webp", ".gif", ".bmp", ".avif", ".pdf", ".psd", ".jxl")
CONVERTED = (".gltf", ".ply", ".stl", ".xml")  # by new-scene
OTHER_MODELS = (".fbx", ".blend", ".dae", ".3ds", ".skp", ".usd", ".usda", ".usdc", ".usdz", ".max", ".ifc", ".step")
CAMERAS = ("cameras.txt", "images.txt", "cameras.bin", "images.bin")


def alike(word, known) -> str:
    """`; do you mean lamps?`, or nothing.

    >>> alike("lamp", ["board", "lamps"]), alike("bogus", ["board", "lamps"])
    ('; do you mean lamps?', '')
    """
    same = [name for name in known if str(word).lower() == name.lower()]
    near = same or difflib.get_close_matches(str(word), list(known), 1, 0.75)
    return f"; do you mean {near[0]}?" if near else ""


def photograph(folder, side, made=()) -> list[str]:
    """Lines about files that may be meant for the photograph of a side. made : names that stages write"""
    named = [path for path in _files(folder) if path.name.lower().startswith(f"{side}.") and path.suffix]
    kinds = (*PICTURES, *RAW, *OTHER_PICTURES)
    named = [path for path in named if path.suffix.lower() in kinds and path.stem.lower() == side]
    if not named and side == "left":
        other = lambda path: path.name in made or path.name.lower().startswith(("left.", "right."))
        named = [path for path in _files(folder) if path.suffix.lower() in kinds and not other(path)]
    return [_picture(path, side) for path in named]


def _picture(path, side):
    kind = path.suffix.lower()
    if kind in RAW:
        return f"{path}: RAW is not read yet: develop it, without tone curve or sharpening, to {side}.tif of 16 bits"
    if kind in OTHER_PICTURES:
        return f"{path}: {kind[1:].upper()} is not read: convert it to {side}.png"
    return f"{path}: is not read: rename it to {side}{RENAMED[kind]}"


def model(folder) -> list[str]:
    """Lines about files that may be meant for the model."""
    lines = []
    for path in _files(folder):
        kind = path.suffix.lower()
        if kind in MODELS:
            lines.append(f"{path}: is not read: rename it to model{kind}")
        elif kind in CONVERTED:
            lines.append(f"{path}: is not read: make new-scene MODEL={path.name} converts it")
        elif kind in OTHER_MODELS:
            lines.append(f"{path}: {kind[1:].upper()} is not read: export it as OBJ or GLB, with its materials")
    return lines


def pose(folder) -> list[str]:
    """Lines about files that may be meant for the pose of the left photograph; at least one."""
    lines = []
    for path in _files(folder):
        name = path.name.lower()
        if name == "left.cameramodel":
            told = "rename it to left.posed.cameramodel if its extrinsics are relative to the model"
            lines.append(f"{path}: left.cameramodel tells the lens alone: {told}; else add pose.csv")
        elif "cameramodel" in name.replace("_", "").replace(" ", "") and not name.startswith("right"):
            lines.append(f"{path}: is not read: rename it to left.posed.cameramodel")
        elif name in CAMERAS or "fspy" in name:
            lines.append(f"{path}: is not read: make new-scene CAMERA={path.name} converts it")
    if not lines:
        ways = "left.posed.cameramodel, or `camera:` in scene.yaml, or pose.csv (places picked in the photograph)"
        lines.append(f"{folder}: the pose of left is not known: give {ways}, or a second photograph, right.png")
    return lines


def scene_yaml(folder) -> list[str]:
    """Lines about files that may be meant for scene.yaml."""
    names = ("scene.yml", "scene.yaml.txt", "scene.txt", "scene.json")
    return [f"{p}: is not read: rename it to scene.yaml" for p in _files(folder) if p.name.lower() in names] or [
        f"{p}: is not read: rename it to scene.yaml" for p in _files(folder) if p.name.lower() == "scene.yaml"
    ]


def _files(folder):
    return sorted(path for path in Path(folder).iterdir() if path.is_file())
