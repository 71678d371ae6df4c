"""The folder photos/ of a scene as it is read, and photos.json with the cameras beside it as they are written."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import cameras, image, lenses
from lib.given.cameras import Camera
from lib.given.image import Photograph
from lib.given.view import size_problem
from lib.planning.files import Further
from lib.vision.location.locate import FIRST_FOCAL, Taken


@dataclass(frozen=True, eq=False)
class Picture:
    """A photograph of photos/ as a pinhole shows it.

    path : of the file;  camera : posed, or with the lens alone, or None;  is_posed : the first of these
    is_flat : the lens is a pinhole, and the photograph as it was taken
    """

    name: str
    path: Path
    photograph: Photograph
    camera: Camera | None
    is_posed: bool
    is_flat: bool

    @property
    def grey(self):
        return grey(self.photograph)


def grey(photograph):
    """(H, W) uint8."""
    values = np.clip(photograph.display, 0, 1).reshape(*photograph.values.shape[:2], -1)
    return np.rint(255 * values.mean(axis=2)).astype(np.uint8)


def read(one: Further) -> Picture:
    """A lib.planning.files.Further, read. BadInput: a file that cannot be used, sizes that differ."""
    photograph = image.read_photograph(one.picture)
    path = one.posed or one.lens
    if path is None:
        return Picture(one.name, one.picture, photograph, None, False, True)
    lens = lenses.read(path)
    if problem := size_problem(one.picture, photograph.values, lens, path):
        raise BadInput(problem)
    camera, is_flat = lenses.pinhole_of(path), lens.model == "LENSMODEL_PINHOLE"
    if not is_flat:
        photograph = replace(photograph, values=lenses.resample(photograph.values, lens, camera), blocks=None)
    return Picture(one.name, one.picture, photograph, camera, one.posed is not None, is_flat)


def taken(picture, said, left) -> Taken:
    """A picture without a pose.  said : photos of scene.yaml;  left : Camera, whose lens may have been this one's"""
    height, width = picture.photograph.values.shape[:2]
    camera = picture.camera
    if camera is None and (left.width, left.height) == (width, height):
        camera = left
    elif camera is None:
        camera = Camera(cameras.intrinsics(FIRST_FOCAL * max(width, height), width, height), width, height, np.eye(4))
    other_lamps = bool(said.get(picture.name, {}).get("lamps"))
    return Taken(
        picture.name,
        picture.photograph,
        picture.grey,
        replace(camera, T_cam_world=np.eye(4)),
        picture.camera is not None,
        other_lamps,
    )


def entry(picture, place, shown) -> dict:
    """What photos.json says of one photograph.  place : locate.Place;  shown : session.Shown of one with a pose"""
    camera = picture.camera if place is None else place.camera
    out = {
        "status": "given" if place is None else "found" if camera else "not found",
        "rt_cam_world": None if camera is None else cameras.rt_from_matrix(camera.T_cam_world),
        "focal_px": None if camera is None else float(camera.K[0, 0]),
    }
    if place is None:
        return out | {"edges_found": shown.share, "evidence_nats": shown.nats}
    found = camera is not None
    return out | {
        "covariance": place.covariance if found else None,
        "focal_sigma_px": place.focal_sigma * camera.K[0, 0] if found and place.focal_sigma else None,
        "rms_px": place.rms_px if found else None,
        "edges_found": place.support,
        "evidence_nats": place.evidence,
        "needed_nats": place.needed,
        "likeness": place.likeness,
        "matches": place.matches or {},
        "ambiguous": list(place.ambiguous),
        "why": place.why or None,
    }


def write(path, pictures, places, shown):
    """photos.json, and photos/ beside it with the cameras that were found and the photographs that were made pinhole.

    places, shown : {name: ...} as of `entry`
    """
    with artefact.writing_folders(Path(path).parent / "photos") as (folder,):
        for picture in pictures:
            place = places.get(picture.name)
            camera = picture.camera if place is None else place.camera
            if camera is None or (place is None and picture.is_flat):
                continue
            cameras.write_cameramodel(Path(folder) / f"{picture.name}.posed.cameramodel", camera)
            if not picture.is_flat:
                _write_pinhole(Path(folder) / f"{picture.name}.pinhole", picture.photograph)
    entries = {p.name: entry(p, places.get(p.name), shown.get(p.name)) for p in pictures}
    artefact.write_json(
        path,
        {"perturbation": "T = exp(omega, tau) T_hat, the camera's axes, rad and m", "photographs": entries},
    )


def _write_pinhole(stem, photograph):
    if photograph.linear:
        image.write_exr(f"{stem}.exr", np.maximum(photograph.values, 0))
    else:
        image.write_png16(f"{stem}.png", np.rint(np.clip(photograph.values, 0, 1) * 65535).astype(np.uint16))
