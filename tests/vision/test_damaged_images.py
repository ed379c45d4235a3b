"""Damaged image files give one error and no picture, and no decoder prints a line of its own."""

import io
import itertools
import struct
import zlib

import cv2
import numpy as np
import pytest
from PIL import Image

from jaxscan.errors import CaptureError
from jaxscan.vision import decode_image, encode_png


ROWS, COLUMNS = 120, 160


def picture(rank=2):
    """Smooth with noise, as frames are: packing finds something, and no two rows are equal."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:ROWS, :COLUMNS]
    grey = 90 + 40 * np.sin(column / 30) + 20 * np.cos(row / 20)
    colour = np.stack([grey, 0.5 * grey, 200 - 0.5 * grey], -1)
    smooth = grey if rank == 2 else colour
    return np.clip(smooth + rng.normal(0, 2, smooth.shape), 0, 255).astype(np.uint8)


def stored(suffix, rank=2, *options):
    image = picture(rank) if rank == 2 else picture(rank)[..., ::-1]
    return cv2.imencode(suffix, image, list(options))[1].tobytes()


def tiff(compression, rank=2, predictor=1):
    return stored(".tiff", rank, cv2.IMWRITE_TIFF_COMPRESSION, compression, cv2.IMWRITE_TIFF_PREDICTOR, predictor)


def by_pillow(format, rank=2, **options):
    file = io.BytesIO()
    Image.fromarray(picture(rank)).save(file, format, **options)
    return file.getvalue()


def decode(data, rank=2, size=(COLUMNS, ROWS)):
    return decode_image(data, name="on/7.png", rank=rank, size=size)


def refused(data, capfd, rank=2, size=(COLUMNS, ROWS)):
    with pytest.raises(CaptureError, match=r"^on/7\.png: .*\.$") as caught:
        decode(data, rank, size)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("rank", [2, 3])
@pytest.mark.parametrize("filters", [cv2.IMWRITE_PNG_FILTER_NONE, 16, 32, 64, 128, cv2.IMWRITE_PNG_ALL_FILTERS])
def test_every_filter_of_png_is_undone(rank, filters):
    data = stored(".png", rank, cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_FILTER, filters)
    assert np.array_equal(decode(data, rank), picture(rank))


@pytest.mark.parametrize("rank", [2, 3])
@pytest.mark.parametrize(("compression", "predictor"), list(itertools.product((1, 5, 8, 32773, 32946), (1, 2))))
def test_every_packing_of_tiff_is_read(rank, compression, predictor):
    assert np.array_equal(decode(tiff(compression, rank, predictor), rank), picture(rank))


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", "packbits", None])
def test_tiff_of_another_writer_is_read(compression):
    assert np.array_equal(decode(by_pillow("TIFF", compression=compression)), picture())


def test_pngs_of_few_bits_are_read_and_those_with_a_palette_or_interlaced_are_refused():
    palette = Image.fromarray(picture(3)).quantize(32)
    file = io.BytesIO()
    palette.save(file, "PNG")
    for data in (file.getvalue(), png(bytes(ROWS * (1 + COLUMNS)), interlaced=1)):
        with pytest.raises(CaptureError, match="expected a plain one of grey or RGB; convert it"):
            decode(data)
    black = Image.fromarray(picture() > 90)
    file = io.BytesIO()
    black.save(file, "PNG")
    assert np.array_equal(decode(file.getvalue()), 255 * np.asarray(black).astype(np.uint8))


@pytest.mark.parametrize("rank", [2, 3])
@pytest.mark.parametrize("compression", [8, 32946])
@pytest.mark.parametrize("part", [0.2, 0.5, 0.8])
def test_zeros_in_a_packed_tiff_are_noticed(compression, rank, part, capfd):
    data = bytearray(tiff(compression, rank))
    at = int(part * len(data))
    data[at : at + 40] = bytes(40)
    refused(bytes(data), capfd, rank)


@pytest.mark.parametrize("rank", [2, 3])
@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"subsampling": 0}], ids=str)
@pytest.mark.parametrize("part", [0.3, 0.5, 0.9])
def test_half_a_jpeg_with_its_end_is_noticed(rank, options, part, capfd):
    data = by_pillow("JPEG", rank, quality=90, **options)
    # Eight grey levels are what this quality leaves of the noise.
    assert np.abs(decode(data, rank).astype(int) - picture(rank)).mean() < 8
    refused(data[: int(part * len(data))] + b"\xff\xd9", capfd, rank)


def test_bytes_between_the_segments_of_a_jpeg_hide_no_size(capfd):
    """OpenCV takes memory for 32000 x 32000 px from a file of 632 bytes."""
    data = by_pillow("JPEG", quality=90)
    at = data.index(b"\xff\xc0")
    giant = data[: at + 5] + struct.pack(">HH", 32000, 32000) + data[at + 9 :]
    refused(giant, capfd)
    refused(giant[:at] + b"\0" + giant[at:], capfd)
    refused(data[:at] + b"\0" + data[at:], capfd)


def test_cmyk_is_refused(capfd):
    file = io.BytesIO()
    Image.fromarray(picture(3)).convert("CMYK").save(file, "JPEG")
    refused(file.getvalue(), capfd, 3)


def entry(data, tag):
    """Where the entry of a tag lies in a little-endian TIFF."""
    (start,) = struct.unpack("<I", data[4:8])
    (count,) = struct.unpack("<H", data[start : start + 2])
    places = range(start + 2, start + 2 + 12 * count, 12)
    return next(at for at in places if struct.unpack("<H", data[at : at + 2])[0] == tag)


def test_the_size_of_a_tiff_is_known_before_it_is_decoded(capfd, monkeypatch):
    data = bytearray(tiff(1))
    width, height = entry(data, 256), entry(data, 257)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    signed = data.copy()
    signed[width : width + 12] = struct.pack("<HHIi", 256, 9, 1, 60000)
    refused(bytes(signed), capfd)
    twice = data.copy()
    twice[height : height + 12] = struct.pack("<HHII", 256, 4, 1, 60000)
    refused(bytes(twice), capfd)
    with pytest.raises(CaptureError, match="megapixels"):
        large = data.copy()
        large[width : width + 12] = struct.pack("<HHII", 256, 4, 1, 1 << 24)
        decode(bytes(large), size=None)
    samples = entry(data, 277)
    many = data.copy()
    many[samples : samples + 12] = struct.pack("<HHII", 277, 4, 1, 60000)
    refused(bytes(many), capfd)


@pytest.mark.parametrize("strategy", [0, 3])
def test_strips_that_overlap_or_lie_outside_are_refused(strategy, capfd):
    data = bytearray(tiff(1))
    sizes = entry(data, 279)
    _, kind, count, value = struct.unpack("<HHII", data[sizes : sizes + 12])
    at, step = (sizes + 8, 4) if count == 1 else (value, 2 if kind == 3 else 4)
    data[at : at + step] = (len(data) + strategy).to_bytes(step, "little")
    refused(bytes(data), capfd)


def with_checksums(data):
    """A PNG whose damage is hidden from the checksums of its chunks."""
    out, at = bytearray(data[:8]), 8
    while at < len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        body = data[at + 4 : at + 8 + length]
        out += data[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + length
    return bytes(out)


@pytest.mark.parametrize("rank", [2, 3])
@pytest.mark.parametrize("mended", [False, True])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_damage_anywhere_in_a_png_is_noticed(rank, mended, part, capfd):
    data = bytearray(encode_png(picture(rank)))
    at = int(part * len(data))
    data[at : at + 40] = bytes(40)
    refused(with_checksums(bytes(data)) if mended else bytes(data), capfd, rank)


def png(rows, *, width=COLUMNS, height=ROWS, depth=8, colour=0, interlaced=0):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def test_a_png_has_as_many_bytes_as_its_header_says(capfd):
    whole = bytes(ROWS * (1 + COLUMNS))
    assert not decode(png(whole)).any()
    for rows in (whole[1:], whole + b"\0", bytes(50 * len(whole)), b"\x05" + whole[1:]):
        refused(png(rows), capfd)
    refused(png(whole, interlaced=2), capfd)
    refused(png(whole, depth=3), capfd)
    refused(png(whole, colour=1), capfd)


@pytest.mark.parametrize("cut", [20, 30, 60, 3000])
def test_a_bitmap_cut_short_is_noticed(cut, capfd):
    refused(stored(".bmp")[:cut], capfd)
