"""Changes of image files: parts of PNG and of packed frames, other formats and sizes, pixels of others."""

import random
import struct
import zlib

import cv2
import numpy as np
import zstandard

from jaxscan.vision import decode_image
from jaxscan.vision.zstd import MAGIC

from .texts import change_bytes


def change_image(rng: random.Random, data: bytes) -> bytes:
    """An image file that is damaged, of another kind, or shows something else."""
    match rng.randrange(5):
        case 0:
            return change_bytes(rng, data)
        case 1:
            return _chunks_changed(rng, data) if data.startswith(b"\x89PNG") else _packed_changed(rng, data)
        case 2:
            return _other_kind(rng, _pixels(data))
        case 3:
            return change_bytes(rng, _other_kind(rng, _pixels(data)))
        case _:
            return _encoded(".png", _other_pixels(rng, _pixels(data)))


def _pixels(data: bytes) -> np.ndarray:
    return decode_image(data, name="image", rank=None, size=None)


def _encoded(suffix: str, image: np.ndarray, options: tuple[int, ...] = ()) -> bytes:
    return cv2.imencode(suffix, image, options)[1].tobytes()


def _other_kind(rng: random.Random, image: np.ndarray) -> bytes:
    """Another format, which may be allowed, or another size, depth or number of channels, which is not."""
    tiff = cv2.IMWRITE_TIFF_COMPRESSION
    match rng.randrange(9):
        case 0:
            return _encoded(".jpg", image)
        case 1:
            return _encoded(".tiff", image, (tiff, rng.choice((1, 5, 8, 32773))))
        case 2:
            return _encoded(".bmp", image)
        case 3:
            return _encoded(".png", image.astype(np.uint16) * 257)
        case 4:
            return _encoded(".png", cv2.merge([image] * 4) if image.ndim == 2 else image[..., 0].copy())
        case 5:
            return _encoded(".png", image[:-1])
        case 6:
            return _encoded(".webp", image)
        case 7:
            # Small in the file, large in memory.
            return _encoded(".jpg", np.zeros((6000, 6000), np.uint8))
        case _:
            return _encoded(".png", np.zeros((3000, 3000), np.uint8))


def _other_pixels(rng: random.Random, image: np.ndarray) -> np.ndarray:
    match rng.randrange(6):
        case 0:
            return np.zeros_like(image)
        case 1:
            return np.roll(image, rng.choice((-20, -5, 5, 20)), axis=rng.choice((0, 1)))
        case 2:
            return image[::-1].copy()
        case 3:
            return image[:, ::-1].copy()
        case 4:
            noise = np.random.default_rng(rng.randrange(1 << 30)).integers(0, 256, image.shape, np.uint8)
            return noise
        case _:
            return 255 - image


def _packed_changed(rng: random.Random, data: bytes) -> bytes:
    """A packed frame whose header says something else, with a checksum that fits or not, or with other data."""
    start = len(MAGIC)
    columns, rows, channels, step, length, _ = struct.unpack("<IIHHII", data[start : start + 20])
    packed = data[start + 20 :]
    match rng.randrange(7):
        case 0:
            columns, rows = rows, columns
        case 1:
            columns, rows = rng.choice(((60000, 60000), (2**32 - 1, 1), (0, 0), (1, 2**32 - 1)))
        case 2:
            channels = rng.choice((0, 2, 3, 4, 65535))
        case 3:
            step = rng.choice((0, 2, 3, 65535))
        case 4:
            # Data that the decoder must judge, because everything around them fits.
            packed = change_bytes(rng, packed)
            length = len(packed)
        case 5:
            # Small in the file, large in memory.
            packed = zstandard.ZstdCompressor(write_checksum=True).compress(bytes(rng.choice((1, 10**8))))
            length = len(packed)
        case _:
            length = rng.choice((0, 1, length - 1, length + 1, 2**32 - 1))
    fields = struct.pack("<IIHHI", columns, rows, channels, step, length)
    return MAGIC + fields + struct.pack("<I", zlib.crc32(fields) ^ (rng.random() < 0.2)) + packed


def _chunks_changed(rng: random.Random, data: bytes) -> bytes:
    """A PNG whose chunks are left out, doubled, or say something else, with a checksum that fits or not."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (length,) = struct.unpack(">I", data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    one = rng.randrange(len(chunks))
    kind, content = chunks[one]
    match rng.randrange(6):
        case 0:
            del chunks[one]
        case 1:
            chunks.insert(rng.randrange(len(chunks)), (kind, content))
        case 2:
            chunks[one] = (kind, change_bytes(rng, content) if content else b"\0\0")
        case 3:
            chunks[0] = (b"IHDR", rng.randbytes(13))
        case 4:
            size = struct.pack(">II", *rng.choice(((60000, 60000), (2**31 - 1, 1), (0, 0), (1, 2**31))))
            chunks[0] = (b"IHDR", size + chunks[0][1][8:])
        case _:
            chunks.insert(
                1, (rng.choice((b"tEXt", b"zTXt", b"iCCP", b"eXIf")), rng.randbytes(rng.choice((0, 9, 5000))))
            )
    out = data[:8]
    wrong = rng.randrange(len(chunks) * 4) if chunks else -1
    for number, (kind, content) in enumerate(chunks):
        checksum = zlib.crc32(kind + content) ^ (number == wrong)
        out += struct.pack(">I", len(content)) + kind + content + struct.pack(">I", checksum)
    return out
