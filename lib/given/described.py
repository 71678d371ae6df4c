"""What a picture's file says of its pixels, before one of them is believed.

`describe` (lib/given/picture_files.py) makes it of a PNG, a JPEG or a TIFF. What is on no short list is refused there.
"""

from __future__ import annotations

from dataclasses import dataclass

from lib.core.stage import BadInput
from lib.given import colour_profiles
from lib.given.colour_profiles import Refused, Space

UNTURNED = 1
SRGB, ADOBE, UNCALIBRATED = 1, 2, 0xFFFF  # EXIF's ColorSpace
LARGEST_EXIF = 1 << 20  # bytes


@dataclass(frozen=True)
class Described:
    """size : (width, height) px as stored;  samples : channels stored, alpha among them;  bits : of a sample
    turn : EXIF's orientation, 1 to 8;  space : None where the colours are sRGB's, or nobody says which they are
    white : the largest value that a sample may have, where the file tells another than 2^bits - 1
    end : bytes of the file that are the picture's;  clear : the grey value that is transparent, or None
    notes : what is left out, no doubt;  doubts : to look at
    """

    format: str
    size: tuple[int, int]
    samples: int
    bits: int
    end: int
    turn: int = UNTURNED
    space: Space | None = None
    white: int | None = None
    clear: int | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Exif:
    """turn : 1 to 8;  colours : ColorSpace, or None;  interop : as R03, or nothing"""

    turn: int = UNTURNED
    colours: int | None = None
    interop: str = ""


def exif_of(data) -> Exif:
    """Of a block of EXIF, b"Exif\\0\\0" before it or not; of a damaged one what can be read. XMP is no EXIF."""
    if not data or len(data) > LARGEST_EXIF:
        return Exif()
    from PIL import Image

    exif = Image.Exif()
    try:
        exif.load(data)
        turn = exif.get(274)
    except Exception:  # whatever damaged EXIF makes of it: decoding says what matters
        return Exif()
    turn = turn if turn in range(1, 9) else UNTURNED
    try:
        more = exif.get_ifd(0x8769)
        return Exif(turn, more.get(0xA001), str(exif.get_ifd(0xA005).get(1, "")).strip("\0 "))
    except Exception:  # the same
        return Exif(turn)


def colours_of(path, profile, samples, exif, others=()) -> tuple[Space | None, tuple, tuple]:
    """(space, notes, doubts) of a profile, where there is one; else of what the format has; else of EXIF.

    samples : channels without alpha, 1 or 3;  others : functions that give a Space or None, the first that says it
    """
    way_out = "nothing is converted: reflectances are those of its own R, G, B, not of sRGB's. Convert it to sRGB"
    try:
        if profile:
            name = colour_profiles.name_of_icc(profile)
            if samples == 1:
                return None, (f"ICC profile {name} of a grey photograph: not read, its curve is found",), ()
            space = colour_profiles.of_icc(profile)
        else:
            name = "of its colours"
            space = next((space for other in others if (space := other())), None)
            space = space or _of_exif(exif)
        if space is None and not profile and exif.colours == UNCALIBRATED and samples == 3 and not others:
            return None, (), (f"EXIF: ColorSpace: uncalibrated, and there is no profile: {way_out}",)
    except Refused as refused:
        raise BadInput(f"{path}: {refused.args[0]}: {refused.args[1]}") from None
    except ValueError as error:
        kind = "ICC profile" if profile else "what the file says"
        return None, (), (f"{kind} {name}: {error}: {way_out}",)
    if space is None or samples == 1 or space.is_srgb:
        return None, (), ()
    return space, (), ()


def _of_exif(exif):
    if exif.interop == "R03" or exif.colours == ADOBE:
        return colour_profiles.adobe("EXIF" + (" (R03)" if exif.interop == "R03" else ""))
    return None
