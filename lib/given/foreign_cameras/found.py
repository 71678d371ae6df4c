"""A camera of another tool as it was found, and the same camera in a photograph that EXIF turns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from lib.core.stage import BadInput
from lib.given import lenses
from lib.given.cameras import FARTHEST, SHORTEST_PX, rt_from_matrix

# Camera axes of a viewer's picture from those of the stored one, by EXIF's orientation: half a turn, quarters of one
TURNS = {3: ((-1, 0), (0, -1)), 6: ((0, -1), (1, 0)), 8: ((0, 1), (-1, 0))}
OF_OPENCV = ("LENSMODEL_OPENCV4", "LENSMODEL_OPENCV5", "LENSMODEL_OPENCV8", "LENSMODEL_OPENCV12")
TURNABLE = ("LENSMODEL_PINHOLE", "LENSMODEL_STEREOGRAPHIC", *OF_OPENCV)
# A lens's axis meets the sensor within some hundredths of its sides from the middle. Beyond this share of the distance
# from the corner to the middle, the numbers are likely those of another picture
OFF_MIDDLE = 0.15
SAME_FACTOR = 0.08  # that the factors along x and y may differ, and are still one
ROUND_FACTOR = 0.03  # that a factor may be off a simple fraction, for the same reason
UNTURNED = "save the photograph as viewers show it, without EXIF's note, and give a camera of that"


@dataclass(frozen=True, eq=False)
class Found:
    """intrinsics : fx, fy, cx, cy, then the lens's own;  T : (4, 4) model to camera, None where only a lens is told

    width, height : px; None where the file tells none.  said : lines for the user
    stored : the tool counts the pixels as the file stores them, not as EXIF turns them
    other : the camera if the tool counted the other pixels, where the size does not tell; it says so
    """

    kind: str
    lens: str
    intrinsics: np.ndarray
    width: int | None
    height: int | None
    T: np.ndarray | None
    said: tuple[str, ...] = ()
    stored: bool = True
    other: Found | None = None

    @property
    def name(self):
        """Of the file in the scene's folder."""
        return "left.cameramodel" if self.T is None else "left.posed.cameramodel"

    def write(self, path):
        """As mrcal would."""
        rt = np.zeros(6) if self.T is None else rt_from_matrix(self.T)
        row = lambda values: " ".join(f"{float(v)!r}," for v in values)
        Path(path).write_text(
            f"# from {self.kind}\n{{ 'lensmodel': '{self.lens}',\n  'intrinsics': [ {row(self.intrinsics)} ],\n"
            f"  'extrinsics': [ {row(rt)} ],\n  'imagersize': [ {self.width}, {self.height} ] }}\n",
            encoding="utf-8",
        )

    def project(self, p):
        """(N, 3) m, model -> (N, 2) px."""
        T = np.eye(4) if self.T is None else self.T
        lens = lenses.Lens(self.lens, self.intrinsics, self.width, self.height, T, self.kind)
        return lens.project(np.asarray(p, float) @ T[:3, :3].T + T[:3, 3])

    def saying(self, *lines):
        """The same with more lines to say."""
        return replace(self, said=(*self.said, *lines))


def check(path, found):
    """BadInput: numbers that no camera has, or a pose that is no rotation and translation."""
    T = np.eye(4) if found.T is None else found.T
    for name, values in (("intrinsics", found.intrinsics), ("pose", T)):
        if not (np.abs(values) <= FARTHEST).all():
            raise BadInput(f"{path}: {name}: {np.ravel(values).tolist()!r:.80} are not numbers of at most {FARTHEST:g}")
    if min(found.intrinsics[:2]) < SHORTEST_PX:
        raise BadInput(f"{path}: focal length: {found.intrinsics[:2].tolist()} px is not positive")
    if not np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max() < 1e-3 or np.linalg.det(T[:3, :3]) < 0:
        raise BadInput(f"{path}: pose: {T[:3, :3].ravel().tolist()!r:.80} is no rotation")


def of_photograph(path, found, size, turn) -> Found:
    """The camera in the pixels that viewers show.

    size : (width, height) px as viewers show it;  turn : EXIF's orientation, 1 to 8
    BadInput: of another size, or a camera that cannot be turned as the photograph is
    """
    shown = tuple(size)
    stored = shown[::-1] if turn >= 5 else shown
    if found.width is None or found.height is None:
        found = _sized(path, found, shown, stored)
    told = (found.width, found.height)
    if told not in (shown, stored):
        raise BadInput(
            f"{path}: size: {told[0]} x {told[1]} is not the photograph's {shown[0]} x {shown[1]}{_factor(told, shown)}"
            ": a camera is of one photograph, at its full size, turned as viewers turn it"
        )
    if turn == 1:
        return found
    why = f"viewers turn the photograph (EXIF's orientation {turn}), and {found.kind}'s pixels are those that they show"
    if told != shown or (found.stored and told == stored):
        turned = _turned(path, found, turn)
        return replace(turned, other=found.saying(why)) if told == shown else turned
    return found.saying(
        f"{why}: taken as they are; if {found.kind} showed it otherwise, save the photograph without EXIF's note"
    )


def _factor(told, shown):
    """Words for a camera of the same picture in another size; none where it is of another shape."""
    if not all(0 < side < FARTHEST for side in told):
        return ""
    across, down = (a / b for a, b in zip(told, shown, strict=True))
    return f" ({across:.4g} times as large)" if abs(across / down - 1) < 0.01 else ""


def _sized(path, found, shown, stored):
    """With the size of the photograph, where the file tells none. BadInput: it can only be of another size."""
    middle = 2 * found.intrinsics[2:4] + 1  # the size in whose middle the principal point would lie
    off = [float(np.abs(middle / side - 1).max()) for side in (shown, stored)]
    size = stored if found.stored and off[1] <= off[0] else shown
    if line := _doubt(found.intrinsics, size):
        raise BadInput(f"{path}: {line} The file tells no size: if cx, cy are right, write its size into it")
    line = f"the file tells no size: taken to be of the photograph's {size[0]} x {size[1]}"
    return replace(found, width=size[0], height=size[1]).saying(line)


def _doubt(intrinsics, size):
    """Why the principal point may be one of another picture; None where it lies about the middle."""
    (cx, cy), middle = intrinsics[2:4], 2 * intrinsics[2:4] + 1
    factors = middle / size
    if np.abs(factors - 1).max() <= OFF_MIDDLE:
        return None
    why = f"cx, cy = {cx:g}, {cy:g} is far from the middle of {size[0]} x {size[1]}"
    if np.ptp(factors) > SAME_FACTOR * abs(factors.max()) or factors.min() <= 0:
        return f"{why}: is it of another photograph, or of a part of one?"
    factor = float(factors.mean())
    simple = float(Fraction(factor).limit_denominator(4)) or factor
    factor = simple if abs(simple / factor - 1) < ROUND_FACTOR else factor
    width, height = (round(factor * side) for side in size)
    return f"{why}: is it of a photograph of {width} x {height} ({factor:.4g} times as large)?"


def doubted(found) -> Found:
    """With a line where the principal point is one of another size."""
    line = _doubt(found.intrinsics, (found.width, found.height)) if found.stored else None
    return found.saying(line) if line else found


def _turned(path, found, turn):
    """The camera of the stored pixels in those that viewers show."""
    what = f"{found.kind}'s pixels are those that the file stores, and viewers"
    if turn not in TURNS:
        raise BadInput(
            f"{path}: {what} mirror the photograph (EXIF's orientation {turn}): no camera sees that: {UNTURNED}"
        )
    if found.lens not in TURNABLE:
        raise BadInput(f"{path}: {what} turn it (EXIF's orientation {turn}): {found.lens} cannot be turned: {UNTURNED}")
    R = np.array(TURNS[turn], float)
    fx, fy, cx, cy = found.intrinsics[:4]
    focal = np.abs(R) @ [fx, fy]
    last = np.array([found.width - 1, found.height - 1], float)
    principal = R @ (np.array([cx, cy]) - last / 2) + np.abs(R) @ last / 2
    more = _turned_lens(found.intrinsics[4:], R)
    width, height = (found.width, found.height) if turn == 3 else (found.height, found.width)
    T = None
    if found.T is not None:
        T = np.array(found.T, float)
        T[:2] = R @ T[:2]
    line = f"{what} turn it (EXIF's orientation {turn}): the camera is turned with it"
    numbers = np.concatenate([focal, principal, more])
    return replace(found, intrinsics=numbers, width=width, height=height, T=T).saying(line)


def _turned_lens(k, R):
    """OpenCV's coefficients about turned axes. (p2, p1), (s1, s3) and (s2, s4) are vectors of the picture's plane."""
    k = np.array(k, float)
    for pair in ((3, 2), (8, 10), (9, 11)):
        if max(pair) < len(k):
            k[list(pair)] = R @ k[list(pair)]
    return k
