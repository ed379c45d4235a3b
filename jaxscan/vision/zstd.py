"""Frames as differences of rows, packed by Zstandard: decoded ten times as fast as PNG, files about as large.

Noise of the sensor leaves nothing to find but the distribution of the differences, for which zstd has a Huffman code
that is decoded at gigabytes a second; a difference to the row above, not to the pixel before, is undone at the speed
of memory.
"""

import struct
import threading
import zlib

import numpy as np
import zstandard

from jaxscan.vision.frames import check_frame


MAGIC = b"\x53\x2a\x4d\x18\x1c\x00\x00\x00jaxframe"
"""The beginning of a file: a skippable frame of zstd, which other programs pass over, of 28 bytes, and our name."""
_FIELDS = struct.Struct("<IIHHII")
"""Columns, rows, channels, step, the length of the packed differences, and the CRC-32 of these fields."""
_START = len(MAGIC) + _FIELDS.size
_STEPS = (0, 1, 2)
_SAMPLE = 32
"""Rows from which the step is chosen."""
_CLEARLY = 0.05
"""How much less another step must need, bits of a pixel."""
_LEVEL = 1
_BLOCK = 32
"""Lines whose differences are undone together; about the square root of their number costs least."""
_LOCAL = threading.local()


def encode_zstd(image: np.ndarray) -> bytes:
    """One frame as differences to the row above, or to the second row above where that is less, as in a mosaic.

    Returns:
        The bytes of the file: a header and one frame of zstd with its checksum (docs/formats.md).

    Raises:
        ValueError: If the array is not such an image.
    """
    check_frame(image)
    rows = np.ascontiguousarray(image).reshape(image.shape[0], -1)
    step = _best_step(rows)
    if step:
        rows = np.concatenate([rows[:step], rows[step:] - rows[:-step]])
    if not hasattr(_LOCAL, "packer"):
        _LOCAL.packer = zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True, write_content_size=True)
    packed = _LOCAL.packer.compress(rows)
    channels = 1 if image.ndim == 2 else 3
    fields = _FIELDS.pack(image.shape[1], image.shape[0], channels, step, len(packed), 0)[:-4]
    return b"".join((MAGIC, fields, zlib.crc32(fields).to_bytes(4, "little"), packed))


def zstd_size(data: bytes) -> tuple[int, int]:
    """Width and height in the header [px].

    Raises:
        ValueError: If the header is damaged.
    """
    columns, rows, _, _ = _header(data)
    return columns, rows


def decode_zstd(data: bytes, out: np.ndarray | None = None) -> np.ndarray:
    """The pixels of a frame, after header, lengths and checksum have been compared.

    Args:
        data: The whole file. The caller has checked its size.
        out: Filled and returned where it has the shape of the image.

    Returns:
        uint8 [rows, columns], or RGB [rows, columns, 3].

    Raises:
        ValueError: With the damage.
    """
    columns, rows, channels, step = _header(data)
    packed = memoryview(data)[_START:]
    shape = (rows, columns) if channels == 1 else (rows, columns, channels)
    if not hasattr(_LOCAL, "unpacker"):
        _LOCAL.unpacker = zstandard.ZstdDecompressor()
    try:
        found = zstandard.get_frame_parameters(packed)
        # Without its checksum, or with another length, the file was changed.
        if found.content_size != rows * columns * channels or not found.has_checksum or found.dict_id:
            raise ValueError("its data have another length than its rows")
        if out is None or out.shape != shape or not out.flags.c_contiguous:
            out = np.empty(shape, np.uint8)
        # Straight into the image: memory of its own for the differences would take as long as to undo them.
        reader = _LOCAL.unpacker.stream_reader(packed)
        # The checksum is compared when a reader reaches the end.
        if reader.readinto(out.reshape(-1)) != out.size or reader.read(1):
            raise ValueError("its data have another length than its rows")
    except zstandard.ZstdError as problem:
        raise ValueError(f"its data cannot be unpacked: {problem}"[:200]) from problem
    if step:
        _add_rows(out.reshape(rows, -1), step)
    return out


def _add_rows(rows: np.ndarray, step: int) -> None:
    """Undo differences to the row `step` above, modulo 256, in place; uint8 [rows, bytes]."""
    blocks = len(rows) // (_BLOCK * step)
    first = blocks * _BLOCK * step
    # `step` rows that follow each other are one line, so that lines differ from the line above.
    lines = rows[:first].reshape(blocks, _BLOCK, step * rows.shape[1])
    for line in range(1, _BLOCK):
        lines[:, line] += lines[:, line - 1]
    for block in range(1, blocks):
        lines[block] += lines[block - 1, -1]
    for row in range(max(first, step), len(rows)):
        rows[row] += rows[row - step]


def _header(data: bytes) -> tuple[int, int, int, int]:
    """Columns, rows, channels and step."""
    if len(data) < _START or not data.startswith(MAGIC):
        raise ValueError("it has no header")
    columns, rows, channels, step, length, checksum = _FIELDS.unpack(data[len(MAGIC) : _START])
    if zlib.crc32(data[len(MAGIC) : _START - 4]) != checksum or channels not in (1, 3) or step not in _STEPS:
        raise ValueError("its header is damaged")
    if length != len(data) - _START:
        raise ValueError(f"it is {'cut short' if length > len(data) - _START else 'longer than its header says'}")
    return columns, rows, channels, step


def _best_step(rows: np.ndarray) -> int:
    """The distance of rows, or 0 for none, at which differences have the least entropy."""
    if len(rows) < 3:
        return len(rows) - 1
    some = np.unique(np.linspace(2, len(rows) - 1, _SAMPLE).astype(int))
    least = _entropy(rows[some] - rows[some - 1])
    others = {2: _entropy(rows[some] - rows[some - 2]), 0: _entropy(rows[some])}
    best = min(others, key=lambda step: others[step])
    return best if others[best] < least - _CLEARLY else 1


def _entropy(values: np.ndarray) -> float:
    share = np.bincount(values.reshape(-1), minlength=256) / values.size
    share = share[share > 0]
    return float(-(share * np.log2(share)).sum())
