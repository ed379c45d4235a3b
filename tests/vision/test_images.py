"""Image files: what comes back is what went in, and nothing else gets through."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from jaxscan.errors import CaptureError
from jaxscan.vision import MAX_PIXELS, decode_image, encode_png, encode_zstd


GREY = np.random.default_rng(1).integers(0, 256, (13, 17), np.uint8)
COLOUR = np.random.default_rng(2).integers(0, 256, (13, 17, 3), np.uint8)


def decode(data, rank=2, size=(17, 13), name="on/000007.png"):
    return decode_image(data, name=name, rank=rank, size=size)


def png_chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_header(width, height, depth=8, colour=0):
    ihdr = png_chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + ihdr + png_chunk(b"IDAT", zlib.compress(b"")) + png_chunk(b"IEND", b"")


@pytest.mark.parametrize("image", [GREY, COLOUR, GREY[:1], COLOUR[:, :1]], ids=["grey", "colour", "row", "column"])
def test_png_comes_back_to_the_bit(image):
    assert np.array_equal(decode(encode_png(image), rank=image.ndim, size=image.shape[1::-1]), image)


def test_png_holds_rgb_in_that_order():
    red = np.zeros((2, 2, 3), np.uint8)
    red[..., 0] = 200
    # An independent reading: the unfiltered rows of the PNG itself.
    data = encode_png(red)
    start = data.index(b"IDAT") + 4
    length = struct.unpack(">I", data[start - 8 : start - 4])[0]
    rows = zlib.decompress(data[start : start + length])
    assert rows[1:4] == bytes([200, 0, 0])


def test_encoding_takes_a_view_and_leaves_it_alone():
    wide = np.concatenate([GREY, GREY], 1)
    before = wide.copy()
    assert np.array_equal(decode(encode_png(wide[:, ::2])), wide[:, ::2])
    assert np.array_equal(wide, before)


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp"])
@pytest.mark.parametrize("image", [GREY, COLOUR], ids=["grey", "colour"])
def test_lossless_formats_of_others(suffix, image):
    stored = image if image.ndim == 2 else image[..., ::-1]
    data = cv2.imencode(suffix, stored)[1].tobytes()
    assert np.array_equal(decode(data, rank=image.ndim), image)


def test_jpeg_is_read_as_rgb():
    flat = np.full((16, 16, 3), (10, 60, 200), np.uint8)
    data = cv2.imencode(".jpg", flat[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    # Quality 100 of a flat colour leaves the rounding of the colour transform, at most 2 DN.
    assert np.abs(decode(data, 3, (16, 16)).astype(int) - flat).max() <= 2


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp", ".jpg"])
def test_wrong_size_is_refused_with_both_sizes(suffix):
    data = cv2.imencode(suffix, GREY)[1].tobytes()
    with pytest.raises(CaptureError, match=r"on/000007.png: found 17 x 13 px, expected 13 x 17 px"):
        decode(data, size=(13, 17))


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".bmp", ".jpg"])
@pytest.mark.parametrize("part", [0.2, 0.5, 0.9])
def test_truncated_files_are_refused(suffix, part):
    data = cv2.imencode(suffix, GREY)[1].tobytes()
    with pytest.raises(CaptureError, match=r"on/000007.png"):
        decode(data[: int(part * len(data))])


@pytest.mark.parametrize("size", [None, (17, 13)])
def test_a_header_that_claims_too_much_is_refused_before_decoding(size, monkeypatch):
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(CaptureError, match=r"megapixels|expected 17 x 13"):
        decode(png_header(MAX_PIXELS, 2), size=size)
    bmp = b"BM" + bytes(16) + struct.pack("<ii", 60000, -60000) + bytes(40)
    with pytest.raises(CaptureError, match=r"megapixels|expected 17 x 13"):
        decode(bmp, size=size)


def test_grey_and_colour_are_not_mixed_up():
    with pytest.raises(CaptureError, match="found a colour image, expected a grey one"):
        decode(encode_png(COLOUR), rank=2)
    with pytest.raises(CaptureError, match="found a grey image, expected a colour one"):
        decode(encode_png(GREY), rank=3)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_an_opaque_alpha_is_left_out(kind):
    pixels = np.dstack([COLOUR[..., ::-1].astype(kind), np.full(COLOUR.shape[:2], np.iinfo(kind).max)])
    opaque = cv2.imencode(".png", pixels.astype(kind))[1].tobytes()
    np.testing.assert_array_equal(decode_image(opaque, name="x", rank=3, size=None, deep=True), COLOUR)


def test_alpha_and_16_bit_are_refused():
    alpha = cv2.imencode(".png", np.zeros((13, 17, 4), np.uint8))[1].tobytes()
    with pytest.raises(CaptureError, match="found 4 channels, expected 3; an alpha"):
        decode(alpha, rank=3)
    deep = cv2.imencode(".png", np.zeros((13, 17), np.uint16))[1].tobytes()
    with pytest.raises(CaptureError, match="found uint16 pixels, expected 8 bit"):
        decode(deep)


@pytest.mark.parametrize("data", [b"", b"GIF89a" + bytes(50), b"\x00" * 100, b"II*\0", b"BM", b"\x89PNG\r\n\x1a\n"])
def test_other_bytes_are_refused(data):
    with pytest.raises(CaptureError, match=r"on/000007.png"):
        decode(data)


@pytest.mark.parametrize("encode", [encode_png, encode_zstd])
@pytest.mark.parametrize(
    "image", [GREY.astype(np.uint16), COLOUR[..., :2], np.zeros((0, 4), np.uint8), np.zeros(4, np.uint8)]
)
def test_what_is_no_frame_is_not_encoded(image, encode):
    with pytest.raises(ValueError, match="An image must"):
        encode(image)
