"""Numbers of records of other programs: a journal may count milliseconds."""

from types import SimpleNamespace

import numpy as np

from jaxscan.geometry import Chessboard
from jaxscan.observation import FoundCorners, to_observations


def test_a_number_beyond_32_bits_is_kept():
    board = Chessboard(3, 3, 0.03)
    corners = FoundCorners(np.zeros((9, 2)), np.ones(9), np.ones(9, bool))
    numbers = [3_000_000_000, (1 << 53) - 1]
    records = [
        SimpleNamespace(
            record=SimpleNamespace(i=i, angle=0.0), corners=corners, placement=None, stripes=(), laser=0, capture=0
        )
        for i in numbers
    ]
    look = SimpleNamespace(board=board, records=records)
    capture = SimpleNamespace(image_size=(64, 48), lasers=(), up="-v", carries="scanner", poses=None)
    build = getattr(to_observations, "__wrapped__", to_observations)
    assert build([capture], look).corners.record.tolist() == numbers
