"""Loops over samples, compiled: a board's print at places between its cells."""

from typing import no_type_check

import numba
import numpy as np


_compiled = numba.njit(nogil=True, cache=True)


@_compiled
@no_type_check
def between_cells(cells: np.ndarray, row: np.ndarray, column: np.ndarray, out: np.ndarray) -> None:
    """The quadratic spline over the cells of a picture.

    Args:
        cells: float32 [rows, columns].
        row: Places, float32 [n]; those beyond the last cells but one are taken to lie on these.
        column: The same.
        out: float32 [n], to be filled.
    """
    half, three = np.float32(0.5), np.float32(0.75)
    last_row, last_column = np.float32(cells.shape[0] - 2), np.float32(cells.shape[1] - 2)
    width = np.int64(cells.shape[1])
    flat = cells.ravel()
    for n in range(len(out)):
        # In this order of arguments, what is no number becomes 1.
        y = min(last_row, max(np.float32(1), row[n]))
        x = min(last_column, max(np.float32(1), column[n]))
        # Truncation to 32 bits, which has an instruction for many at once.
        i, j = np.int32(y + half), np.int32(x + half)
        y -= np.float32(i)
        x -= np.float32(j)
        before, at, after = half * (half - x) * (half - x), three - x * x, half * (half + x) * (half + x)
        k = np.int64(i) * width + np.int64(j)
        up, down = k - width, k + width
        total = (half * (half - y) * (half - y)) * (before * flat[up - 1] + at * flat[up] + after * flat[up + 1])
        total += (three - y * y) * (before * flat[k - 1] + at * flat[k] + after * flat[k + 1])
        total += (half * (half + y) * (half + y)) * (before * flat[down - 1] + at * flat[down] + after * flat[down + 1])
        out[n] = total
