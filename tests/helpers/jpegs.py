"""Pictures as they come back from a JPEG, chroma halved."""

import tempfile
from pathlib import Path

import cv2
import numpy as np

from lib.given import image


def write(path, values, quality):
    """(H, W, C) display values, in [0, 1]."""
    stored = np.round(255 * values).clip(0, 255).astype(np.uint8)
    cv2.imwrite(str(path), stored[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])


def stored(values, quality) -> image.Photograph:
    """As a stage reads it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "photograph.jpg"
        write(path, values, quality)
        return image.read_photograph(str(path))
