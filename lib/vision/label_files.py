"""Files of labels: left.regions.png, left.surfaces.png."""

from pathlib import Path

import numpy as np

from lib.core import artefact
from lib.core.stage import BadInput
from lib.given import image

MOST = 65535  # labels that 16 bits hold


def read_beside(photograph, path):
    """(Photograph, (H, W) labels). BadInput where their sizes differ."""
    picture, labels = image.read_photograph(photograph), image.read_labels(path)
    (height, width), (H, W) = labels.shape, picture.values.shape[:2]
    if (height, width) != (H, W):
        raise BadInput(f"{path}: size: {width} x {height} is not the photograph's {W} x {H} ({photograph})")
    return picture, labels


def write(pictures):
    """All of {path: (H, W) labels from 1}, or none.

    More labels than 16 bits hold go to the same name but .tif, and the .png is a link to it, for Make and for the
    stages below.
    """
    wide = {Path(path): int(np.max(labels, initial=0)) > MOST for path, labels in pictures.items()}
    files = [path.with_suffix(".tif") if is_wide else path for path, is_wide in wide.items()]
    with artefact.writing_all(*files) as partials:
        for partial, labels in zip(partials, pictures.values(), strict=True):
            image.write_labels(partial, labels)
    for path, is_wide in wide.items():
        if is_wide:
            path.unlink(missing_ok=True)
            path.symlink_to(path.with_suffix(".tif").name)
        else:
            path.with_suffix(".tif").unlink(missing_ok=True)  # of an earlier run
