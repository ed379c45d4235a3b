"""Changes of image files: parts of PNG and of packed frames, other formats and sizes, pixels of others."""

import random
import struct
import zlib

import cv2
import numpy as np
import zstandard

from jaxscan.vision import decode_image
from jaxscan.vision.zstd import MAGIC

from .nasty import pick
from .texts import change_bytes


def change_image(rng: random.Random, data: bytes) -> bytes:
    """An image file that is damaged, of another kind, or shows something else."""
    parts = _chunks_changed if data.startswith(b"\x89PNG") else _packed_changed
    return pick(
        rng,
        lambda: change_bytes(rng, data),
        lambda: parts(rng, data),
        lambda: _other_kind(rng, _pixels(data)),
        lambda: change_bytes(rng, _other_kind(rng, _pixels(data))),
        lambda: _encoded(".png", _other_pixels(rng, _pixels(data))),
    )


def _pixels(data: bytes) -> np.ndarray:
    return decode_image(data, name="image", rank=None, size=None)


def _encoded(suffix: str, image: np.ndarray, options: tuple[int, ...] = ()) -> bytes:
    return cv2.imencode(suffix, image, options)[1].tobytes()


def _other_kind(rng: random.Random, image: np.ndarray) -> bytes:
    """Another format, which may be allowed, or another size, depth or number of channels, which is not."""
    return pick(
        rng,
        lambda: _encoded(rng.choice((".jpg", ".bmp", ".webp")), image),
        lambda: _encoded(".tiff", image, (cv2.IMWRITE_TIFF_COMPRESSION, rng.choice((1, 5, 8, 32773)))),
        lambda: _encoded(".png", image.astype(np.uint16) * 257),
        lambda: _encoded(".png", cv2.merge([image] * 4) if image.ndim == 2 else image[..., 0].copy()),
        lambda: _encoded(".png", image[:-1]),
        # Small in the file, large in memory.
        lambda: _encoded(rng.choice((".jpg", ".png")), np.zeros((6000, 6000), np.uint8)),
    )


def _other_pixels(rng: random.Random, image: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(rng.randrange(1 << 30))
    return pick(
        rng,
        lambda: np.zeros_like(image),
        lambda: np.roll(image, rng.choice((-20, -5, 5, 20)), axis=rng.choice((0, 1))),
        lambda: image[::-1].copy(),
        lambda: noise.integers(0, 256, image.shape, np.uint8),
    )


def _packed_changed(rng: random.Random, data: bytes) -> bytes:
    """A packed frame whose header says something else, with a checksum that fits or not, or with other data."""
    start = len(MAGIC)
    *fields, length, _ = struct.unpack("<IIHHII", data[start : start + 20])
    packed, at = data[start + 20 :], rng.randrange(7)
    if at < 4:
        fields[at] = rng.choice((0, 1, 2, 3, 60000, 65535, fields[1 - at % 2]))
    elif at == 4:
        length = rng.choice((0, 1, length - 1, length + 1, 2**32 - 1))
    else:
        # Data that the decoder must judge, because everything around them fits; small in the file, large in memory.
        bomb = zstandard.ZstdCompressor(write_checksum=True).compress(bytes(rng.choice((1, 10**8))))
        packed = change_bytes(rng, packed) if at == 5 else bomb
        length = len(packed)
    head = struct.pack("<IIHHI", *fields, length)
    return MAGIC + head + struct.pack("<I", zlib.crc32(head) ^ (rng.random() < 0.2)) + packed


def _chunks_changed(rng: random.Random, data: bytes) -> bytes:
    """A PNG whose chunks are left out, doubled, or say something else, with a checksum that fits or not."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    one, other = rng.randrange(len(chunks)), rng.randrange(len(chunks))
    kind, content = chunks[one]
    size = struct.pack(">II", *rng.choice(((60000, 60000), (2**31 - 1, 1), (0, 0), (1, 2**31))))
    strange = (rng.choice((b"tEXt", b"zTXt", b"iCCP", b"eXIf")), rng.randbytes(rng.choice((0, 9, 5000))))
    chunks = pick(
        rng,
        lambda: [*chunks[:one], *chunks[one + 1 :]],
        lambda: [*chunks[:other], (kind, content), *chunks[other:]],
        lambda: [*chunks[:one], (kind, change_bytes(rng, content) if content else b"\0\0"), *chunks[one + 1 :]],
        lambda: [(b"IHDR", rng.choice((rng.randbytes(13), size + chunks[0][1][8:]))), *chunks[1:]],
        lambda: [chunks[0], strange, *chunks[1:]],
    )
    out = data[:8]
    wrong = rng.randrange(len(chunks) * 4) if chunks else -1
    for number, (kind, content) in enumerate(chunks):
        checksum = zlib.crc32(kind + content) ^ (number == wrong)
        out += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)
    return out
