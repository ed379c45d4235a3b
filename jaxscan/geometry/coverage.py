"""Coverage that a calibration asks of views of a board: parts of the image, tilts, depths."""

import numpy as np
from jaxtyping import Float, Int


ROWS, COLUMNS = 3, 4
"""Cells of the image that should all have seen corners."""
MIN_IN_CELL = 8
MIN_TILT_DEG = 20.0
MIN_DEPTH_RATIO = 1.5
"""Of the farthest board with a stripe to the nearest."""
MIN_STRIPES = 4
MIN_PLACEMENTS = 3

# Sentences that are the same before and after a calibration, each with a place for the views so far.
ASK_FOR_PARTS = "bring the board into the {} of the image: too few corners lie there"
ASK_FOR_TILT = "tilt the board by 20 to 45 degrees: {}"
ASK_FOR_STRIPES = "capture the stripe on more boards: it was seen on {}"
ASK_FOR_DEPTHS = "capture the stripe nearer and farther: all boards with a stripe stand at {}"
ASK_FOR_PLACEMENTS = f"leave the board standing in {MIN_PLACEMENTS} or more places while the table turns: there is {{}}"

_VERTICAL, _HORIZONTAL = ("upper", "middle", "lower"), ("left", "centre", "centre", "right")


def count_cells(q: Float[np.ndarray, "n 2"], image_size: tuple[int, int]) -> Int[np.ndarray, "rows columns"]:
    """Corners in every cell of an image of this width and height [px]."""
    width, height = image_size
    limits = ((-0.5, height - 0.5), (-0.5, width - 0.5))
    return np.histogram2d(q[:, 1], q[:, 0], bins=(ROWS, COLUMNS), range=limits)[0].astype(int)


def empty_parts(counts: Int[np.ndarray, "rows columns"]) -> tuple[str, ...]:
    """Parts of the image with too few corners, the emptiest first, in words."""
    cells = sorted(np.argwhere(counts < MIN_IN_CELL).tolist(), key=lambda cell: counts[tuple(cell)])
    return tuple(dict.fromkeys(f"{_VERTICAL[row]} {_HORIZONTAL[column]}" for row, column in cells))
