"""Ways in which a photograph deviates from the usual one: response, lens, noise, file.

Each takes a `Given` and a generator, and returns (the one with another photograph, {what was changed}).
"""

from dataclasses import replace

import numpy as np

from lib.given.transfer import srgb_from_linear
from lib.synthetic import deviating_geometry as geometry
from lib.synthetic.given_scene import Given

MIXED = (-0.15, 0.2)  # beside the diagonal
CORNER_DEG = 37.0
PHONE_CORNER_DEG = (15.0, 30.0)
SATURATED = (0.0, 0.3)
DARK, BRIGHT = 0.2, 2.5
GAMMAS = (1.0, 2.8)
FULL_WELL, READ_NOISE = 6000.0, 0.0015  # electrons at white; of white


def _display(given, B) -> np.ndarray:
    return np.clip(B, 0, 1) ** (1 / given.gamma)


def _bits8(display) -> np.ndarray:
    return np.round(255 * np.clip(display, 0, 1)).astype(np.uint8)


def _shown(given, display, name="left.png") -> Given:
    return replace(given, photograph=(name, _bits8(display)))


# ---- response ----


def srgb(given, random):
    """An ordinary sRGB photograph."""
    return _shown(given, srgb_from_linear(np.clip(given.B, 0, 1))), {"transfer": {"kind": "srgb"}}


def tone(given, random):
    """A smooth S-shaped tone curve with T(0) = 0 and T(1) = 1, one of several kinds."""
    name, curve = tone_curve(random)
    x = np.linspace(0, 1, 256) ** 2  # denser where it is dark
    transfer = {"kind": "curve", "linear": x.tolist(), "display": curve(x).tolist()}
    return _shown(given, curve(np.clip(given.B, 0, 1))), {"curve": name, "transfer": transfer}


def tone_curve(random) -> tuple:
    """(its kind and numbers in words, T: [0, 1] -> [0, 1], monotone)."""
    kind = ("filmic", "logistic", "sine", "toe")[random.integers(4)]
    g, a = float(random.uniform(1.9, 2.4)), float(random.uniform(0.25, 0.6))
    if kind == "filmic":  # Hable's rational curve, then gamma
        gain = 2 + 4 * a
        rational = lambda x: (x * (0.22 * x + 0.03) + 0.002) / (x * (0.22 * x + 0.3) + 0.06) - 1 / 30
        T = lambda x: np.maximum(rational(gain * x) / rational(gain), 0) ** (1 / g)
    elif kind == "logistic":  # Naka and Rushton's, of the displayed value
        n, k = 1.2 + a, 0.45
        naka = lambda y: y**n / (y**n + k**n) * (1 + k**n)
        T = lambda x: naka(x ** (1 / g))
    elif kind == "sine":  # more contrast in the middle
        T = lambda x: x ** (1 / g) - a * np.sin(2 * np.pi * x ** (1 / g)) / (2 * np.pi)
    else:  # a toe and a shoulder of the first EMoR kind: one gamma in the dark, another in the light
        T = lambda x: (1 - x) * x ** (1 / (g + a)) + x * x ** (1 / (g - a))
    return f"{kind}, gamma {g:.3f}, strength {a:.3f}", T


def saturated(display, more):
    """As phones and editors do it: colours farther from their pixel's mean by such a share, in displayed values."""
    mean = display.mean(axis=2, keepdims=True)
    return np.clip(mean + (1 + more) * (display - mean), 0, 1)


def saturation(given, random):
    """Colours 0 to 30 % farther from grey."""
    more = float(random.uniform(*SATURATED))
    return _shown(given, saturated(_display(given, given.B), more)), {"saturation": more}


def phone(given, random):
    """sRGB or a tone curve, the lens's shadow, colours 0 to 30 % farther from grey, a JPEG of quality 85, and one thing
    that the model has too many or too few."""
    change = geometry.missing_object if random.integers(2) else geometry.extra_object
    given, said = change(given, random)
    shade, lens = lens_shadow(given.B.shape[:2], float(random.uniform(*PHONE_CORNER_DEG)))
    more = float(random.uniform(*SATURATED))
    name, curve = ("srgb", srgb_from_linear) if random.integers(2) else tone_curve(random)
    light = np.clip(given.B * shade, 0, 1)
    shown = _shown(given, saturated(curve(light), more), "left.jpg")
    return replace(shown, quality=85), said | {"lens": lens, "saturation": more, "curve": name}


# ---- light ----


def colours(given, random):
    """A camera that mixes colours: a matrix whose rows sum to 1 before the transfer function."""
    M = random.uniform(*MIXED, (3, 3))
    np.fill_diagonal(M, 0)
    M += np.diag(1 - M.sum(axis=1))
    return _shown(given, _display(given, given.B @ M.T)), {"matrix": M.tolist()}


def vignetting(given, random):
    """cos^4 with 37 degrees at the picture's corners."""
    factor, said = lens_shadow(given.B.shape[:2], CORNER_DEG)
    return _shown(given, _display(given, given.B * factor)), said


def lens_shadow(shape, corner_deg):
    """((H, W, 1) cos^4 with so many degrees at the corners, {what it is})."""
    H, W = shape
    x, y = np.meshgrid(np.arange(W) - (W - 1) / 2, np.arange(H) - (H - 1) / 2)
    tangent = np.hypot(x, y) / np.hypot((W - 1) / 2, (H - 1) / 2) * np.tan(np.radians(corner_deg))
    factor = np.cos(np.arctan(tangent)) ** 4
    said = {"corner_deg": corner_deg, "corner": float(factor.min()), "centre_px": [(W - 1) / 2, (H - 1) / 2]}
    return factor[..., None], said


def _exposed(given, factor):
    """Another exposure; the lamps' emittances, which are what the camera sees, change with it."""
    lamps = {group: [round(factor * x, 4) for x in E] for group, E in given.lamps.items()}
    given = replace(given, facts={**given.facts, "lamps": lamps})
    return _shown(given, _display(given, factor * given.B)), {"factor": factor, "lamps": lamps}


def exposure_dark(given, random):
    """A fifth of the light."""
    return _exposed(given, DARK)


def exposure_bright(given, random):
    """Two and a half times the light: bright places saturate."""
    return _exposed(given, BRIGHT)


def gamma(given, random):
    """A gamma from 1 to 2.8 at one of three exposures: dark, as it is, bright."""
    told = round(float(random.uniform(*GAMMAS)), 3)
    shown, said = _exposed(replace(given, gamma=told), (DARK, 1.0, BRIGHT)[random.integers(3)])
    return shown, {"gamma": told, **said}


# ---- noise and files ----


def _noisy(given, random, sigma):
    display = _display(given, given.B)
    noise = random.normal(0, sigma, display.shape)
    return _shown(given, display + noise), {"sigma_of_display": sigma}


def noise_3(given, random):
    """Noise of 3 % of the full scale, in displayed values."""
    return _noisy(given, random, 0.03)


def noise_10(given, random):
    """Noise of 10 % of the full scale, in displayed values."""
    return _noisy(given, random, 0.10)


def bayer(given, random):
    """A sensor under a Bayer mosaic: noise of electrons and of reading, then each colour filled in."""
    import cv2

    B = np.clip(given.B, 0, 1)
    rows, columns = np.indices(B.shape[:2]) % 2
    mosaic = np.choose(rows + columns, [B[..., 0], B[..., 1], B[..., 2]])  # R G / G B
    electrons = random.poisson(FULL_WELL * mosaic) / FULL_WELL
    seen = np.clip(electrons + random.normal(0, READ_NOISE, mosaic.shape), 0, 1)
    filled = cv2.demosaicing(np.round(65535 * seen).astype(np.uint16), cv2.COLOR_BayerBG2RGB) / 65535
    said = {"full_well": FULL_WELL, "read_noise": READ_NOISE, "pattern": "RGGB", "filled": "bilinear"}
    return _shown(given, _display(given, filled)), said


def jpeg(given, random):
    """A JPEG of quality 80."""
    return _shown(given, _display(given, given.B), "left.jpg"), {"quality": 80}


def twelve_in_sixteen(given, random):
    """12-bit data in a 16-bit PNG, not scaled."""
    values = np.round(4095 * _display(given, given.B)).astype(np.uint16)
    return replace(given, photograph=("left.png", values)), {"white": 4095}
