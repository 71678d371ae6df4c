"""Cameras that look at a place, and a panel to look at."""

import numpy as np

from lib.given.cameras import Camera
from tests.helpers import rooms

SIZE = (64, 48)
SQUARE = rooms.panel("panel", (0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0))
FRONT = ((0.5, 0.5, 1.1), (0.5, 0.5001, 0))  # eye, target


def look(eye, target, size=SIZE, focal=40.0, centre=None, up=(0, 0, 1.0)):
    """A pinhole at eye that looks at target, focal and centre in px; up points up in the picture."""
    z = np.subtract(target, eye) / np.linalg.norm(np.subtract(target, eye))
    x = np.cross(z, up) / np.linalg.norm(np.cross(z, up))
    T = np.eye(4)
    T[:3, :3] = [x, np.cross(z, x), z]
    T[:3, 3] = -T[:3, :3] @ eye
    cx, cy = centre or ((size[0] - 1) / 2, (size[1] - 1) / 2)
    return Camera(np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]]), *size, T)
