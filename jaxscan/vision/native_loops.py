"""Loops over the bytes of image files, compiled: undoing differences of rows, and the lengths of packed data."""

from typing import no_type_check

import numba
import numpy as np


_compiled = numba.njit(nogil=True, cache=True)


@_compiled
@no_type_check
def unfilter(rows: np.ndarray, pixel: int, out: np.ndarray) -> bool:
    """Undo the filters of a PNG's rows.

    Args:
        rows: uint8 [rows, 1 + bytes]: the filter's number, then the filtered bytes.
        pixel: Bytes of a pixel.
        out: uint8 [rows, bytes], to be filled.

    Returns:
        Whether all filters are known.

    Source: PNG specification (third edition), section 9.
    """
    height, width = out.shape
    zero, one, byte = np.uint32(0), np.uint32(1), np.uint32(255)
    last = np.zeros(width, np.uint8)
    for r in range(height):
        kind, row, new = rows[r, 0], rows[r, 1:], out[r]
        if kind > 4:
            return False
        for i in range(pixel):
            # Zeros stand to the left.
            new[i] = row[i] + (last[i] if kind in (2, 4) else last[i] >> one if kind == 3 else zero)
        if kind == 0:
            for i in range(pixel, width):
                new[i] = row[i]
        elif kind == 1:
            for i in range(pixel, width):
                new[i] = row[i] + new[i - pixel]
        elif kind == 2:
            for i in range(pixel, width):
                new[i] = row[i] + last[i]
        elif kind == 3 and pixel == 1:
            # In registers: waiting for the memory of the last pixel would cost as much again.
            left = np.uint32(new[0])
            for i in range(1, width):
                left = (row[i] + ((last[i] + left) >> one)) & byte
                new[i] = left
        elif kind == 3 and pixel == 3:
            red, green, blue = np.uint32(new[0]), np.uint32(new[1]), np.uint32(new[2])
            for i in range(3, width, 3):
                red = (row[i] + ((last[i] + red) >> one)) & byte
                green = (row[i + 1] + ((last[i + 1] + green) >> one)) & byte
                blue = (row[i + 2] + ((last[i + 2] + blue) >> one)) & byte
                new[i], new[i + 1], new[i + 2] = red, green, blue
        elif kind == 3:
            for i in range(pixel, width):
                new[i] = row[i] + ((np.uint32(last[i]) + new[i - pixel]) >> one)
        else:
            for i in range(pixel, width):
                left, corner, above = np.int32(new[i - pixel]), np.int32(last[i - pixel]), np.int32(last[i])
                by_left, by_above = abs(above - corner), abs(left - corner)
                by_corner = abs(left + above - corner - corner)
                nearest = above if by_above <= by_corner else corner
                nearest = left if by_left <= by_above and by_left <= by_corner else nearest
                new[i] = row[i] + nearest
        last = new
    return True


@_compiled
@no_type_check
def add_rows(differences: np.ndarray, step: int, out: np.ndarray) -> None:
    """Undo differences to the row `step` above, modulo 256; zeros stand above.

    Args:
        differences: uint8 [rows, bytes].
        step: 1 or more.
        out: uint8 [rows, bytes], to be filled.
    """
    height, width = out.shape
    # Pixel by pixel: to assign a whole row takes numba's checks of shapes, which compile for seconds.
    for r in range(min(step, height)):
        for i in range(width):
            out[r, i] = differences[r, i]
    # A loop of its own, without a branch: so it takes 16 bytes and more at a time.
    for r in range(step, height):
        row, above, new = differences[r], out[r - step], out[r]
        for i in range(width):
            new[i] = row[i] + above[i]


@_compiled
@no_type_check
def packbits_length(data: np.ndarray) -> int:
    """Number of bytes that a PackBits stream, uint8 [n], unpacks to; -1 where it ends within a run."""
    at, length = 0, 0
    while at < len(data):
        control = np.int64(data[at])
        at += 1
        if control < 128:
            at += control + 1
            length += control + 1
        elif control > 128:
            at += 1
            length += 257 - control
    return length if at == len(data) else -1


@_compiled
@no_type_check
def lzw_length(data: np.ndarray, most: int) -> int:
    """Number of bytes that a TIFF's LZW stream, uint8 [n], unpacks to; -1 where it is damaged.

    A stream may end without its last code.

    Args:
        data: Codes of 9 to 12 bits, the highest bit first: 256 clears the table, 257 ends the stream.
        most: The count stops above this number.

    Source: TIFF 6.0, section 13.
    """
    lengths = np.ones(4096, np.int64)
    bits, held, at = 0, 0, 0
    width, known, before, total = 9, 258, -1, 0
    while total <= most:
        while bits < width:
            if at == len(data):
                return total
            held = (held << 8 | np.int64(data[at])) & 0xFFFFFF
            at += 1
            bits += 8
        bits -= width
        code = (held >> bits) & ((1 << width) - 1)
        if code == 257:
            return total
        if code == 256:
            width, known, before = 9, 258, -1
            continue
        # The first code of a table stands for itself.
        if code > known or (before < 0 and code > 255):
            return -1
        if before >= 0 and known < 4096:
            lengths[known] = lengths[before] + 1
            known += 1
            if known + 1 >= 1 << width and width < 12:
                width += 1
        total += lengths[code] if code > 257 else 1
        before = code
    return total
