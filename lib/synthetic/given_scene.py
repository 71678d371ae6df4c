"""A synthetic scene's folder as it is given: read, and written again with something changed."""

import json
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lib.core.yaml_file import read_yaml
from lib.given import cameras, image
from lib.synthetic.geometry import Polygon
from lib.synthetic.recipe import obj_text
from lib.synthetic.sight import coarse_view

STEP = 4  # px between the rays that look what is seen
ROOM = ("floor", "ceiling", "walls")  # objects that are the room itself
MODEL = ("model.obj", "model.mtl")


@dataclass(frozen=True, eq=False)
class Given:
    """What lies in a scene's folder, and the light and the gamma of its photograph."""

    folder: Path
    polygons: tuple  # of Polygon, in the order of model.obj
    camera: cameras.Camera
    facts: dict  # scene.yaml
    B: np.ndarray  # (H, W, 3) linear radiance of the true photograph
    gamma: float
    photograph: tuple | None = None  # (name of the file, values) of another photograph
    quality: int = 80  # of a JPEG
    seen: dict = field(default_factory=dict)  # objects' pixels; see `of_objects`

    @property
    def lamps(self) -> dict:
        """group -> emittance."""
        return self.facts["lamps"]

    @property
    def size(self) -> tuple:
        return self.camera.width, self.camera.height

    @property
    def eye(self) -> np.ndarray:
        return np.linalg.inv(self.camera.T_cam_world)[:3, 3]

    def objects(self) -> list[str]:
        """Names in the model's order."""
        return list(dict.fromkeys(p.object for p in self.polygons))

    def view(self) -> tuple:
        """(numbers of polygons, points (n, 3) m) that some of the pixels show."""
        return coarse_view(self.polygons, self.camera.K, self.size, self.camera.T_cam_world, STEP)

    def of_objects(self) -> dict[str, int]:
        """object -> how many pixels show it, about; found once."""
        if not self.seen:
            number, _ = self.view()
            count = np.bincount(number[number >= 0], minlength=len(self.polygons)) * STEP**2
            for polygon, pixels in zip(self.polygons, count, strict=True):
                self.seen[polygon.object] = self.seen.get(polygon.object, 0) + int(pixels)
        return self.seen

    def span(self, name) -> tuple:
        """(low, high) m of an object's corners."""
        points = np.concatenate([p.points for p in self.polygons if p.object == name])
        return points.min(0), points.max(0)

    def free(self, pixels=2000, clear=0.04) -> list[str]:
        """Objects on the floor, clear of all others and of walls, that so many pixels show; else the largest."""
        inner_low, inner_high = self.span("walls")
        spans = {name: self.span(name) for name in self.objects() if name not in ROOM}
        alone = []
        for name, (low, high) in spans.items():
            others = [s for other, s in spans.items() if other != name]
            near = any((low - clear < b).all() and (high + clear > a).all() for a, b in others)
            off_walls = (low[:2] - clear > inner_low[:2]).all() and (high[:2] + clear < inner_high[:2]).all()
            if off_walls and not near and abs(low[2] - inner_low[2]) < 1e-3:
                alone.append(name)
        ranked = sorted(alone, key=lambda name: -self.of_objects().get(name, 0))
        return [name for name in ranked if self.of_objects().get(name, 0) >= pixels] or ranked[:1]

    def with_moved(self, offsets) -> "Given":
        """With objects moved: {name: (3,) m}."""
        move = lambda p: replace(p, points=p.points + offsets[p.object]) if p.object in offsets else p
        return replace(self, polygons=tuple(map(move, self.polygons)))


def read(folder) -> Given:
    """Of a folder that stages/synthesise.py wrote with --gather."""
    folder = Path(folder)
    truth = json.loads((folder / "truth" / "materials.json").read_text())
    return Given(
        folder,
        tuple(read_polygons(folder / "model.obj")),
        cameras.read_cameramodel(folder / "left.posed.cameramodel"),
        read_yaml(folder / "scene.yaml"),
        image.read_exr(folder / "truth" / "linear.exr"),
        float(truth["transfer"]["gamma"]),
    )


def read_polygons(path) -> list[Polygon]:
    """The polygons of a model.obj as `recipe.obj_text` writes it: plain indices, every face with a material."""
    vertices, polygons, name, group = [], [], None, None
    for line in Path(path).read_text().splitlines():
        word, _, rest = line.partition(" ")
        if word == "v":
            vertices.append([float(x) for x in rest.split()])
        elif word == "o":
            name = rest
        elif word == "usemtl":
            group = rest
        elif word == "f":
            polygons.append(Polygon(name, group, np.array([vertices[int(i) - 1] for i in rest.split()])))
    return polygons


def write(given, before, out, said):
    """The folder `out`: what `given` has changed since `before` is written, all else is copied byte for byte.

    said : the content of truth/deviation.json
    """
    out = Path(out)
    shutil.copytree(given.folder, out, dirs_exist_ok=True)
    if given.polygons is not before.polygons:
        decimals = 3 if np.abs(given.polygons[0].points).max() > 500 else 6  # millimetres need no more
        (out / "model.obj").write_text(obj_text("deviating from truth; see truth/", given.polygons, decimals))
    if given.camera is not before.camera:
        cameras.write_cameramodel(out / "left.posed.cameramodel", given.camera)
    if given.facts is not before.facts:
        (out / "scene.yaml").write_text(_yaml(given.facts))
    if given.photograph:
        name, values = given.photograph
        (out / "left.png").unlink()
        write_photograph(out / name, values, given.quality)
    (out / "truth" / "deviation.json").write_text(json.dumps(said, indent=1) + "\n")


def write_photograph(path, values, quality=80):
    """8 or 16 bits as the values are; a .jpg of such a quality."""
    if path.suffix == ".jpg":
        import cv2

        _, code = cv2.imencode(".jpg", np.ascontiguousarray(values[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
        path.write_bytes(code.tobytes())
    else:
        (image.write_png8 if values.dtype == np.uint8 else image.write_png16)(path, values)


def _yaml(facts) -> str:
    """scene.yaml with the lamps' emittances; json is YAML."""
    return "".join(f"{key}: {json.dumps(value)}\n" for key, value in facts.items())
