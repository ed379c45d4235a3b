"""Connected parts of a grid."""

import numpy as np
from jaxtyping import Bool, Int


def connected(right: Bool[np.ndarray, "rows columns"], down: Bool[np.ndarray, "rows columns"]) -> Int[np.ndarray, " n"]:
    """The smallest index of the part that each cell of a grid belongs to, [rows * columns].

    Args:
        right: Whether a cell is linked to its right neighbour; the last column is not read.
        down: The same of the neighbour below; the last row is not read.
    """
    index = np.arange(right.size).reshape(right.shape)
    a = np.concatenate([index[:, :-1][right[:, :-1]], index[:-1][down[:-1]]])
    b = np.concatenate([index[:, 1:][right[:, :-1]], index[1:][down[:-1]]])
    label = np.arange(right.size)
    while True:
        low, high = np.minimum(label[a], label[b]), np.maximum(label[a], label[b])
        open_ = low < high
        if not open_.any():
            return label
        a, b = a[open_], b[open_]
        np.minimum.at(label, high[open_], low[open_])
        # Every cell follows its label to the end.
        while True:
            further = label[label]
            if np.array_equal(further, label):
                break
            label = further
