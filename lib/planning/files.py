"""Names of given files, and quick looks into them; the stages read them in earnest."""

import functools
import stat
import struct
from pathlib import Path
from typing import NamedTuple

from lib.core import bounded
from lib.core.stage import BadInput
from lib.given import gltf_file, obj_text

SIDES = ("left", "right")
PHOTOS = "photos/"  # further photographs, and their cameras
PICTURES = (".png", ".jpg", ".tif", ".exr")  # endings of photographs
# Endings of pictures that are not read.
UNREAD = (".jpeg", ".tiff", ".heic", ".heif", ".dng", ".arw", ".nef", ".cr2", ".webp", ".bmp")
PICKED = ("pose.csv", "pose-lines.csv")  # where the model was picked in the left photograph
FSPY = ("left.fspy", "left.fspy.json")  # a camera of fSpy's, of the left photograph
PINHOLE = "LENSMODEL_PINHOLE"
PHOTOGRAPH = "left.png|jpg|tif|exr"
NO_FILE = "-"  # no scene has one of this name
EXPORTS = "exports/"  # the folder of all exports, one in it for each kind


def photograph_of(side) -> str:
    """The photograph of one side, as pipeline.yaml names it.

    >>> photograph_of("right")
    'right.png|jpg|tif|exr'
    """
    return PHOTOGRAPH.replace("left", side)


def alternatives(file) -> list[str]:
    """The names that a file may have.

    >>> alternatives("left.png|jpg"), alternatives("pose.json")
    (['left.png', 'left.jpg'], ['pose.json'])
    """
    stem, dot, extensions = file.rpartition(".")
    return [f"{stem}{dot}{extension}" for extension in extensions.split("|")]


def here(path) -> Path:
    """Paths below the working directory without it: what Make prints stays short, and a project can move."""
    return path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path


def export_kind(file) -> str | None:
    """The kind of export that a file belongs to.

    >>> export_kind("exports/gltf/scene.glb"), export_kind("report.html")
    ('gltf', None)
    """
    return file.split("/")[1] if file.startswith(EXPORTS) else None


# ---- quick looks; where a file cannot be read, the stage that needs it says why ----


def _kept(look):
    """look(path), asked once of each version of a file; None where there is none."""
    again = functools.lru_cache(lambda path, *_: look(path))

    @functools.wraps(look)
    def of_version(path):
        try:
            status = path.stat()
        except OSError:
            return None
        if not stat.S_ISREG(status.st_mode):  # a pipe would be waited for
            return None
        return again(path, status.st_size, status.st_mtime_ns)

    return of_version


@_kept
def pixels(photograph) -> int | None:
    """How many a picture has by its header, or None where that cannot be read."""
    try:
        with open(photograph, "rb") as file:
            head = file.read(24)
        if head.startswith(b"\x89PNG\r\n\x1a\n"):
            width, height = struct.unpack(">II", head[16:24])
            return width * height
        from lib.given import image  # NumPy: a PNG does without

        width, height = image.announced(photograph)
        return width * height
    except (OSError, BadInput, struct.error):
        return None


def _groups_of_obj(data) -> set[str]:
    return set(obj_text.names(data, "usemtl"))


def _groups_of_glb(data) -> set[str] | None:
    gltf = gltf_file.of_glb("model", data)[0]
    return set(gltf_file.groups(gltf)) if all(material["name"] for material in gltf["materials"]) else None


# The formats of models: the groups that a file's text names. Their readers: lib/given/model.
GROUPS_OF = {"obj": _groups_of_obj, "glb": _groups_of_glb}
MODEL = f"model.{'|'.join(GROUPS_OF)}"
OBJECTS = "objects/"  # movable objects that are not in the model, a file each


# Endings of models that objects/ does not take
UNREAD_MODELS = (".gltf", ".ply", ".stl", ".usd", ".usda", ".usdc", ".usdz", ".xml", ".fbx", ".dae", ".3ds", ".blend")


def unread_objects(folder) -> list[Path]:
    """Models in a scene's folder objects/ (or None) that are not read, by name; endings in capitals are none."""
    found = [p for p in folder.iterdir() if p.suffix[1:] not in GROUPS_OF] if folder else []
    return sorted(p for p in found if p.suffix.lower() in (*UNREAD_MODELS, *(f".{end}" for end in GROUPS_OF)))


def object_files(folder) -> list[Path]:
    """The models in a scene's folder objects/ (or None), by name."""
    return sorted(p for p in folder.iterdir() if p.suffix[1:] in GROUPS_OF) if folder else []


class Further(NamedTuple):
    """A photograph of photos/: its name, and the paths of the picture, of its camera in the model's frame, of its lens.

    posed, lens : None where there is none
    """

    name: str
    picture: Path
    posed: Path | None
    lens: Path | None


def further(folder) -> list[Further]:
    """The photographs in a scene's folder photos/ (or None), by name."""
    pictures = sorted(p for p in folder.iterdir() if p.suffix in PICTURES and p.is_file()) if folder else []
    camera = lambda p, kind: path if (path := p.with_name(f"{p.stem}{kind}.cameramodel")).is_file() else None
    return [Further(p.stem, p, camera(p, ".posed"), camera(p, "")) for p in pictures]


def further_files(folder) -> list[Path]:
    """All files of photos/ that are read."""
    return [path for one in further(folder) for path in one[1:] if path]


def model_groups(path) -> set[str] | None:
    """The groups of a model as its text names them, or None where they cannot be told."""
    try:
        return GROUPS_OF[path.suffix[1:]](bounded.content(path))
    except (BadInput, KeyError, TypeError, AttributeError):
        return None


@_kept
def lens_of(path) -> str | None:
    """The lens model that a camera file names, or None where the file cannot be read."""
    try:
        return bounded.literal_of(path, bounded.content(path, bounded.LARGEST_TEXT))["lensmodel"]
    except (BadInput, ValueError, KeyError, TypeError):
        return None


def centre_of(path) -> list[float] | None:
    """The centre of a given camera in its reference frame, or None where the file cannot be read."""
    from lib.given import lenses  # NumPy: most plans do without, see tests/test_layers.py

    try:
        return lenses.read(path).centre.tolist()
    except BadInput:
        return None
