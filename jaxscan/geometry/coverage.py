"""Coverage that a calibration needs of the views of a board: parts of the image, tilts, depths."""

import numpy as np
from jaxtyping import Float, Int


ROWS, COLUMNS = 3, 4
"""Grid of image cells, all of which should contain corners."""
MIN_IN_CELL = 8
MIN_TILT_DEG = 20.0
MIN_DEPTH_RATIO = 1.5
"""Smallest ratio of the depths of the farthest and the nearest board with a stripe."""
MIN_STRIPES = 4
MIN_PLACEMENTS = 3

# Requests for more views; the braces take the state so far.
ASK_FOR_PARTS = "bring the board into the {} of the image: too few corners lie there"
ASK_FOR_TILT = "tilt the board by 20 to 45 degrees: {}"
ASK_FOR_STRIPES = "capture the stripe on more boards: it was seen on {}"
ASK_FOR_DEPTHS = "capture the stripe nearer and farther: all boards with a stripe stand at {}"
ASK_FOR_PLACEMENTS = f"leave the board standing in {MIN_PLACEMENTS} or more places while the table turns: there is {{}}"

_VERTICAL, _HORIZONTAL = ("upper", "middle", "lower"), ("left", "centre", "centre", "right")


def count_cells(q: Float[np.ndarray, "n 2"], image_size: tuple[int, int]) -> Int[np.ndarray, "rows columns"]:
    """Number of corners in every cell of an image of this width and height [px]."""
    width, height = image_size
    limits = ((-0.5, height - 0.5), (-0.5, width - 0.5))
    return np.histogram2d(q[:, 1], q[:, 0], bins=(ROWS, COLUMNS), range=limits)[0].astype(int)


def empty_parts(counts: Int[np.ndarray, "rows columns"]) -> tuple[str, ...]:
    """Names of the parts of the image with too few corners, the emptiest first."""
    cells = sorted(np.argwhere(counts < MIN_IN_CELL).tolist(), key=lambda cell: counts[tuple(cell)])
    return tuple(dict.fromkeys(f"{_VERTICAL[row]} {_HORIZONTAL[column]}" for row, column in cells))
