"""Image files: what is written is read again to the last bit; what is damaged is refused in one line."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from lib.buffers.trust import in_blocks
from lib.core.stage import BadInput
from lib.given import image, jpeg, reduced
from lib.planning import files
from tests.helpers import jpegs

RNG = np.random.default_rng(0)
COLOUR8 = RNG.integers(0, 256, (13, 17, 3), dtype=np.uint8)
COLOUR16 = RNG.integers(0, 65536, (13, 17, 3), dtype=np.uint16)


@pytest.mark.parametrize(
    "stored, write, white", [(COLOUR8, image.write_png8, 255), (COLOUR16, image.write_png16, 65535)]
)
def test_png_there_and_back(tmp_path, stored, write, white):
    write(tmp_path / "a.png", stored)
    photograph = image.read_photograph(tmp_path / "a.png")
    assert np.array_equal(photograph.values * white, stored)  # RGB stays RGB
    assert photograph.bits == (8 if white == 255 else 16) and not photograph.linear and photograph.channels_in_file == 3


def test_channel_order(tmp_path):
    """Red is the first channel: written here by hand, as a PNG of one pixel (10, 20, 30)."""
    cv2.imwrite(str(tmp_path / "a.png"), np.array([[[30, 20, 10]]], np.uint8))  # OpenCV stores B, G, R
    assert (image.read_photograph(tmp_path / "a.png").values * 255).ravel().tolist() == [10, 20, 30]


@pytest.mark.parametrize("kind", ["png", "tif"])
def test_three_equal_channels_are_one(tmp_path, kind):
    grey = COLOUR8[..., :1].repeat(3, axis=2)
    cv2.imwrite(str(tmp_path / f"a.{kind}"), grey)
    photograph = image.read_photograph(tmp_path / f"a.{kind}")
    assert photograph.values.shape == (13, 17, 1) and photograph.channels_in_file == 3
    cv2.imwrite(str(tmp_path / f"b.{kind}"), grey[..., 0])
    photograph = image.read_photograph(tmp_path / f"b.{kind}")
    assert photograph.values.shape == (13, 17, 1) and photograph.channels_in_file == 1


def test_opaque_alpha_is_dropped_and_other_refused(tmp_path):
    with_alpha = np.dstack([COLOUR8, np.full((13, 17), 255, np.uint8)])
    cv2.imwrite(str(tmp_path / "a.png"), with_alpha)
    assert image.read_photograph(tmp_path / "a.png").values.shape == (13, 17, 3)
    with_alpha[3, 4, 3] = 254
    cv2.imwrite(str(tmp_path / "a.png"), with_alpha)
    with pytest.raises(BadInput, match="alpha"):
        image.read_photograph(tmp_path / "a.png")


def test_jpeg(tmp_path):
    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((40, 50, 3), (200, 100, 50), np.uint8))
    photograph = image.read_photograph(tmp_path / "a.jpg")
    assert np.abs(photograph.values * 255 - [50, 100, 200]).max() < 3


@pytest.mark.parametrize("shape", [(5, 7), (5, 7, 3)])
def test_exr_there_and_back(tmp_path, shape):
    light = (RNG.lognormal(0, 3, shape) * 10).astype(np.float32)  # values above 1 are light
    image.write_exr(tmp_path / "a.exr", light)
    assert np.array_equal(image.read_exr(tmp_path / "a.exr"), light)
    photograph = image.read_photograph(tmp_path / "a.exr")
    assert photograph.linear and photograph.bits == 0
    assert np.array_equal(photograph.values, light.reshape(5, 7, -1))


def test_depth_is_a_channel_called_Z(tmp_path):
    import OpenEXR

    image.write_exr(tmp_path / "a.exr", np.full((2, 3), 1.25), name="Z")
    with OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True) as file:
        assert list(file.channels()) == ["Z"] and file.channels()["Z"].pixels.dtype == np.float32


def test_labels(tmp_path):
    labels = np.array([[0, 1, 65535], [7, 8, 9]])
    image.write_png16(tmp_path / "a.png", labels)
    again = image.read_labels(tmp_path / "a.png")
    assert again.dtype == np.int32 and np.array_equal(again, labels)
    image.write_png8(tmp_path / "b.png", labels > 6)
    assert image.read_labels(tmp_path / "b.png").tolist() == [[0, 0, 255], [255, 255, 255]]
    image.write_png8(tmp_path / "c.png", COLOUR8)
    with pytest.raises(BadInput, match="one channel"):
        image.read_labels(tmp_path / "c.png")


@pytest.mark.parametrize("wrong", [np.array([[70000]]), np.array([[-1]]), np.array([[0.5]])])
def test_what_does_not_fit_is_not_written(tmp_path, wrong):
    with pytest.raises(ValueError):
        image.write_png16(tmp_path / "a.png", wrong)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("kind", ["png", "jpg", "exr", "tif"])
@pytest.mark.parametrize("part", [0, 1, 20, 0.3, 0.9, 0.995])
def test_truncated(tmp_path, kind, part):
    path = tmp_path / f"a.{kind}"
    noise = RNG.random((60, 80, 3))
    image.write_exr(path, noise) if kind == "exr" else cv2.imwrite(str(path), (noise * 255).astype(np.uint8))
    content = path.read_bytes()
    path.write_bytes(content[: part if part in (0, 1, 20) else int(len(content) * part)])
    with pytest.raises(BadInput) as refusal:
        image.read_photograph(path)
    assert refusal.value.problems[0].startswith(f"{path}: ")


def test_one_wrong_bit_in_a_png(tmp_path):
    image.write_png8(tmp_path / "a.png", COLOUR8)
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(BadInput, match="checksum"):
        image.read_photograph(tmp_path / "a.png")


@pytest.mark.parametrize(
    "name, content, says",
    [
        ("a.png", b"hello", "not a readable image"),
        ("a.exr", b"hello", "not a readable EXR"),
        ("a.jpg", b"\xff\xd8hello", "end of a JPEG"),
    ],
)
def test_not_an_image(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=says):
        image.read_photograph(tmp_path / name)


def test_missing_file(tmp_path):
    with pytest.raises(BadInput, match="none.png"):
        image.read_photograph(tmp_path / "none.png")


def test_exr_that_is_not_finite(tmp_path):
    light = np.ones((4, 5, 3))
    light[2, 3, 1] = np.nan
    image.write_exr(tmp_path / "a.exr", light)
    with pytest.raises(BadInput, match=r"pixel \(3, 2\): channel 1 = nan"):
        image.read_photograph(tmp_path / "a.exr")


def test_float_tiff_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.tif"), RNG.random((4, 5, 3)).astype(np.float32))
    with pytest.raises(BadInput, match="float32"):
        image.read_photograph(tmp_path / "a.tif")


def test_what_rounding_does_to_a_jpeg_of_one_colour(tmp_path):
    """Its error is the same all over: `colour` tells how large it is, over many colours."""
    rng, off, told = np.random.default_rng(2), [], None
    for _ in range(60):
        colour = rng.uniform(90, 170) + rng.uniform(-12, 12, 3)
        light = np.linspace(0.9, 1.1, 128)[None, :, None] + rng.normal(0, 0.003, (128, 128, 1))
        stored = np.round(colour * light).astype(np.uint8)
        path = tmp_path / "flat.jpg"
        cv2.imwrite(str(path), stored[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])
        photograph = image.read_photograph(path)
        off.append(photograph.values.mean(axis=(0, 1)) - stored.mean(axis=(0, 1)) / 255)
        told = photograph.blocks.colour
    found = np.sqrt(np.mean(np.square(off), axis=0))
    assert (found < 1.3 * told).all() and (found > 0.4 * told).all(), (found, told)


@pytest.mark.parametrize("turn", range(1, 9))
def test_the_orientation_of_exif_is_honoured(tmp_path, turn):
    """As Pillow turns it upright; the blocks of the JPEG are where they were stored."""
    from PIL import Image, ImageOps

    stored = Image.fromarray(np.kron(RNG.integers(0, 256, (6, 9, 3)), np.ones((7, 7, 1))).astype(np.uint8))
    exif = Image.Exif()
    exif[274] = turn
    stored.save(tmp_path / "a.jpg", quality=95, subsampling=0, exif=exif)
    photograph = image.read_photograph(tmp_path / "a.jpg")
    with Image.open(tmp_path / "a.jpg") as shown:
        upright = np.asarray(ImageOps.exif_transpose(shown)) / 255
    assert photograph.values.shape == upright.shape
    assert np.abs(photograph.values - upright).max() < 4 / 255  # two decoders
    y, x = photograph.blocks.first
    assert photograph.blocks.px == 8
    assert (y in (0, upright.shape[0] % 8)) and (x in (0, upright.shape[1] % 8))
    edges = np.zeros(upright.shape[:2], bool)
    edges[y, x] = True
    held = in_blocks(edges, photograph.blocks)
    assert held[y : y + 8, x : x + 8].all() and held.sum() == 64


@pytest.mark.parametrize("ending", ["png", "jpg", "tif", "exr"])
def test_a_header_tells_how_many_pixels_there_are(tmp_path, ending):
    path, values = tmp_path / f"a.{ending}", np.full((30, 50, 3), 100, np.uint8)
    image.write_exr(path, values / 255.0) if ending == "exr" else cv2.imwrite(str(path), values)
    assert files.pixels(path) == 1500
    path.write_bytes(path.read_bytes()[:10])
    assert files.pixels(path) is None and files.pixels(tmp_path / "b.png") is None


def test_an_even_picture_of_labels_is_large_and_no_photograph(tmp_path):
    """One facet over 13 megapixels."""
    labels = np.ones((3200, 4100), np.uint16)
    image.write_labels(tmp_path / "facet.png", labels)
    assert np.array_equal(image.read_labels(tmp_path / "facet.png"), labels)
    with pytest.raises(BadInput, match="no photograph"):
        image.read_photograph(tmp_path / "facet.png")


def soft(seed, size=(160, 240)):
    """(H, W, 3) display of soft colours with a sensor's noise."""
    rng = np.random.default_rng(seed)
    values = cv2.GaussianBlur(rng.uniform(0.1, 0.9, (*size, 3)), (0, 0), 12)
    values = 0.5 + 6 * (values - values.mean(axis=(0, 1)))
    return np.clip(values + rng.normal(0, 0.006, values.shape), 0, 1)


@pytest.mark.parametrize("k", [1, 2, 3])
def test_a_smaller_picture_of_a_jpeg_knows_of_it(tmp_path, k):
    """What all pixels of a block share stays, blocks are k times smaller, and ringing averages out in part."""
    taken = jpegs.stored(soft(0), 92)
    image.write_photograph(tmp_path / "a.png", reduced.photograph(taken, k))
    found = image.read_photograph(tmp_path / "a.png")
    assert found.bits == 16 and not found.lost_tables
    np.testing.assert_allclose(found.values, reduced.picture(taken.values, k), atol=1e-5)
    assert found.blocks.px == pytest.approx(taken.blocks.px / k) and found.blocks.first == (0, 0)
    assert found.blocks.noise == taken.blocks.noise and (found.blocks.colour == taken.blocks.colour).all()
    assert taken.blocks.noise <= found.blocks.edge_noise <= taken.blocks.edge_noise
    bent = replace(taken, blocks=taken.blocks._replace(first=None))
    image.write_photograph(tmp_path / "b.png", bent)
    assert image.read_photograph(tmp_path / "b.png").blocks.first is None


WRONG_TEXTS = ["", "[]", "no", "[16, -1, 0, 0, 0]", "[16, .1, .1, .1, 1e999, 0]", '{"a": 1}', "3", "[" * 200_000]
WRONG_TEXTS += [f"[16, .1, .1, .1, .1, .1, {at}]" for at in ("1e999", "-3", "NaN", "7", '"x"')]


@pytest.mark.parametrize("text", WRONG_TEXTS)
def test_a_text_that_is_no_jpeg_is_none(text):
    assert jpeg.of_text(text) is None


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("quality", [75, 90, None])
def test_a_jpeg_under_another_name_is_seen(seed, quality):
    """By steps between its blocks, also where a corner was cut off; none in what was never a JPEG."""
    values = soft(seed) if quality is None else jpegs.stored(soft(seed), quality).values[3:, 5:]
    taken = image.Photograph(values, 8, False, 3)
    assert taken.lost_tables == (quality is not None)
    assert not replace(taken, linear=True).lost_tables


@pytest.mark.parametrize("px, first", [(16.0, (0, 0)), (16 / 3, (1.3, 4.0)), (8.0, (3.0, 0.0)), (8.0, None)])
def test_blocks_that_hold_an_edge(px, first):
    """Every pixel that may share a block with an edge, and none further than a block away."""
    edges = np.zeros((60, 90), bool)
    edges[20, 33] = edges[59, 0] = True
    held = in_blocks(edges, jpeg.Blocks(px, 0.0, 0.0, np.zeros(1), first))
    y, x = np.nonzero(held)
    near = [np.maximum(abs(y - b), abs(x - a)) for b, a in ((20, 33), (59, 0))]
    assert held[20, 33] and held[59, 0] and np.minimum(*near).max() <= 2 * px
    if first is not None:
        rows, columns = (np.floor((np.arange(n) - f + 0.5) / px) for n, f in zip(edges.shape, first, strict=True))
        shares = lambda y, x: (rows == rows[y])[:, None] & (columns == columns[x])
        assert (held == (shares(20, 33) | shares(59, 0))).all()
