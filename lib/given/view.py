"""A photograph with its camera and its model, read together: what one of them says must fit the others.

view = View.read(camera="left.posed.cameramodel", model="model.obj", photograph="left.png", facet="facet.png")
view.facet                              # (H, W) int32, -1 = nothing
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from lib.core.stage import BadInput
from lib.given import cameras, image
from lib.given import model as models
from lib.given.cameras import Camera
from lib.given.image import Photograph
from lib.given.model import Model
from lib.given.transfer import Transfer


@dataclass(frozen=True, eq=False)
class View:
    """What one camera shows. Parts that were not asked for are None.

    facet : (H, W) int32 of the model, -1 = nothing;  trusted : (H, W) bool, pixels that the analysis may use
    """

    camera: Camera
    model: Model | None = None
    photograph: Photograph | None = None
    facet: np.ndarray | None = None
    trusted: np.ndarray | None = None

    @classmethod
    def read(cls, *, camera, model=None, photograph=None, facet=None, trusted=None) -> View:
        """From files, each checked against the others.

        BadInput: a file that cannot be used, a picture whose size is not the camera's, a facet that the model has not.
        """
        posed = cameras.read_cameramodel(camera)
        world = None if model is None else models.load(model)
        shown = None if photograph is None else image.read_photograph(photograph)
        labels, mask = (None if path is None else image.read_labels(path) for path in (facet, trusted))
        for path, values in ((photograph, shown and shown.values), (facet, labels), (trusted, mask)):
            if path is not None and (problem := size_problem(path, values, posed, camera)):
                raise BadInput(problem)
        if labels is not None and world is not None and labels.max(initial=0) > world.n_facets:
            raise BadInput(f"{facet}: value: {labels.max()} is beyond the model's {world.n_facets} facets ({model})")
        return cls(posed, world, shown, None if labels is None else labels - 1, None if mask is None else mask == 255)

    def under_one_curve(self, transfer: Transfer) -> View:
        """The same, photographed by a camera that has one curve for all channels."""
        values = transfer.in_common(self.photograph.values)
        return replace(self, photograph=replace(self.photograph, values=values))

    @property
    def shape(self):
        """(H, W) of the camera."""
        return self.camera.height, self.camera.width

    def pixels(self, index):
        """(M, C) values of the photograph at flat indices (M,)."""
        return self.photograph.values.reshape(-1, self.photograph.values.shape[2])[index]


def size_problem(path, values, camera, camera_path):
    """One line where a picture (H, W, ...) has another size than its camera, or None."""
    height, width = np.shape(values)[:2]
    if (width, height) == (camera.width, camera.height):
        return None
    hint = ""
    if (height, width) == (camera.width, camera.height):
        hint = ": is it turned? viewers turn a photograph as its EXIF says, and the camera's pixels are those"
    return (
        f"{path}: size: {width} x {height} is not the camera's {camera.width} x {camera.height} ({camera_path}){hint}"
    )
