"""Frames packed by zstd: what comes back is what went in, and damage gives one error and no picture."""

import io
import struct
import zlib

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxscan.errors import CaptureError
from jaxscan.vision import decode_image, encode_png, encode_zstd
from jaxscan.vision.zstd import MAGIC


ROWS, COLUMNS = 48, 64
HEADER = len(MAGIC) + 20


def picture(rank=2):
    """Smooth with noise of 2 DN, as frames are."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:ROWS, :COLUMNS]
    grey = 90 + 40 * np.sin(column / 30) + 20 * np.cos(row / 20)
    smooth = grey if rank == 2 else np.stack([grey, 0.5 * grey, 200 - 0.5 * grey], -1)
    return np.clip(smooth + rng.normal(0, 2, smooth.shape), 0, 255).astype(np.uint8)


def mosaic():
    """Raw Bayer of a red wall: neighbouring rows differ by 100 DN."""
    image = picture() // 2
    image[::2, ::2] += 100
    return image


def decode(data, rank=2, size=(COLUMNS, ROWS), out=None):
    return decode_image(data, name="on/7.zst", rank=rank, size=size, out=out)


def refused(data):
    with pytest.raises(CaptureError, match=r"^on/7\.zst: .*\.$") as caught:
        decode(data)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def step_of(data):
    return struct.unpack_from("<H", data, len(MAGIC) + 10)[0]


def with_fields(data, *fields):
    """The same frame behind another header whose checksum fits."""
    packed = struct.pack("<IIHHI", *fields)
    return MAGIC + packed + struct.pack("<I", zlib.crc32(packed)) + data[HEADER:]


def around(packed):
    """A header that fits a picture around other data."""
    return with_fields(bytes(HEADER) + packed, COLUMNS, ROWS, 1, 1, len(packed))


@given(
    shape=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    colour=st.booleans(),
    seed=st.integers(0, 1 << 30),
    most=st.sampled_from([0, 1, 20, 255]),
)
@settings(deadline=None)
def test_every_image_comes_back_to_the_bit(shape, colour, seed, most):
    image = np.random.default_rng(seed).integers(0, most + 1, (*shape, 3) if colour else shape, np.uint8)
    data = encode_zstd(image)
    assert np.array_equal(decode(data, image.ndim, shape[::-1]), image)


@pytest.mark.parametrize(
    "image", [picture(), picture(3), mosaic(), picture()[:, ::-2]], ids="grey rgb raw view".split()
)
def test_frames_come_back_into_the_memory_that_is_given(image):
    before, data = image.copy(), encode_zstd(image)
    out = np.full(image.shape, 7, np.uint8)
    assert decode(data, image.ndim, image.shape[1::-1], out) is out and np.array_equal(out, image)
    # Memory of another shape stays as it is.
    other = np.full((3, 3), 7, np.uint8)
    assert np.array_equal(decode(data, image.ndim, image.shape[1::-1], other), image) and (other == 7).all()
    assert np.array_equal(image, before)


@pytest.mark.parametrize("step", [0, 1, 2])
@pytest.mark.parametrize("rows", [1, 2, 3, 31, 32, 33, 63, 64, 65, 129, 200])
def test_differences_are_undone_in_images_of_any_height(rows, step):
    image = np.random.default_rng(rows).integers(0, 256, (rows, COLUMNS), np.uint8)
    differences = image.copy()
    if step:
        differences[step:] -= image[:-step]
    packed = zstandard.ZstdCompressor(write_checksum=True).compress(differences)
    data = with_fields(bytes(HEADER) + packed, COLUMNS, rows, 1, step, len(packed))
    assert np.array_equal(decode(data, 2, (COLUMNS, rows)), image)


def test_the_rows_to_subtract_are_those_that_are_alike():
    assert step_of(encode_zstd(picture())) == 1 and step_of(encode_zstd(mosaic())) == 2
    # Mostly zeros: differences would have twice as many other values.
    dark = (np.random.default_rng(1).random((ROWS, COLUMNS)) < 0.05).astype(np.uint8)
    assert step_of(encode_zstd(dark)) == 0


def test_frames_are_about_as_large_as_png():
    """The entropy of a difference is half a bit more than that of PNG's best filter, of 5 bits here."""
    for image in (picture(), picture(3), mosaic()):
        assert len(encode_zstd(image)) < 1.3 * len(encode_png(image))


@pytest.mark.parametrize("rank", [2, 3])
def test_other_programs_need_zstd_and_a_sum(rank):
    """As docs/formats.md says: the header is a skippable frame, and the differences follow."""
    data, image = encode_zstd(picture(rank)), picture(rank)
    raw = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data), read_across_frames=True).read()
    columns, rows, channels, step = struct.unpack("<IIHH", data[16:28])
    assert (columns, rows, channels, step) == (COLUMNS, ROWS, 1 if rank == 2 else 3, 1)
    differences = np.frombuffer(raw, np.uint8).reshape(rows, -1)
    assert np.array_equal(np.cumsum(differences, 0, np.uint8).reshape(image.shape), image)


def test_every_flipped_bit_is_noticed_or_changes_nothing():
    data, same = bytearray(encode_zstd(picture())), 0
    for place in range(8 * len(data)):
        data[place // 8] ^= 1 << place % 8
        try:
            assert np.array_equal(decode(bytes(data)), picture())
            same += 1
        except CaptureError as problem:
            assert str(problem).startswith("on/7.zst: ") and "\n" not in str(problem)
        data[place // 8] ^= 1 << place % 8
    # Bits that zstd does not use: one in the frame's header, and the rest of a byte in the block's.
    assert same <= 8


def test_files_cut_short_or_too_long_are_refused():
    data = encode_zstd(picture())
    for length in range(len(data)):
        refused(data[:length])
    assert "longer" in refused(data + b"\0")
    packed = data[HEADER:]
    # Where the header says so too; without its last four bytes it lacks no more than the checksum.
    for length in range(len(packed) - 4):
        refused(around(packed[:length]))


def test_sizes_are_compared_before_memory_is_taken():
    data = encode_zstd(picture())
    length = len(data) - HEADER
    assert "found 48 x 64 px" in refused(with_fields(data, ROWS, COLUMNS, 1, 1, length))
    for width, height in ((2**32 - 1, 2**32 - 1), (60_000, 60_000), (0, 0)):
        bad = with_fields(data, width, height, 1, 1, length)
        refused(bad)
        with pytest.raises(CaptureError, match="px"):
            decode(bad, size=None)
    for channels, step in ((0, 1), (2, 1), (4, 1), (1, 3), (1, 65535)):
        assert "header is damaged" in refused(with_fields(data, COLUMNS, ROWS, channels, step, length))
    # Three channels of a third of the columns have the length of the data, and are no grey image.
    with pytest.raises(CaptureError, match="colour"):
        decode(with_fields(encode_zstd(picture(3)), COLUMNS, ROWS, 3, 1, len(encode_zstd(picture(3))) - HEADER))


@pytest.mark.parametrize("size", [0, 1, ROWS * COLUMNS - 1, ROWS * COLUMNS + 1, 10**8])
def test_data_of_another_length_are_refused_before_they_are_unpacked(size):
    packer = zstandard.ZstdCompressor(write_checksum=True)
    assert "another length" in refused(around(packer.compress(bytes(size))))
    # Where the frame does not say its length, as a stream does not.
    stream = packer.compressobj()
    refused(around(stream.compress(bytes(size)) + stream.flush()))


def test_data_without_their_checksum_are_refused():
    packer = zstandard.ZstdCompressor(write_checksum=False)
    refused(around(packer.compress(bytes(ROWS * COLUMNS))))
    assert (decode(around(zstandard.ZstdCompressor(write_checksum=True).compress(bytes(ROWS * COLUMNS)))) == 0).all()


def test_the_decoder_survives_garbage():
    """Damaged data behind a header that fits, so that zstd itself has to judge them."""
    rng = np.random.default_rng(3)
    packed = np.frombuffer(encode_zstd(picture())[HEADER:], np.uint8)
    for _ in range(3000):
        some = packed.copy()
        some[rng.integers(0, len(some), rng.integers(1, 9))] = rng.integers(0, 256)
        if rng.random() < 0.3:
            some = np.roll(some, rng.integers(1, len(some)))
            some[:4] = packed[:4]
        try:
            assert np.array_equal(decode(around(some.tobytes())), picture())
        except CaptureError as problem:
            assert str(problem).startswith("on/7.zst: ") and "\n" not in str(problem)
