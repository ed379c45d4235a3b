"""The paper's own method: one step after the other, each taking the result of the one before as exact."""

from typing import NamedTuple

import numpy as np


class PaperWay(NamedTuple):
    """A calibration by the paper's method, and what it was made from. Lengths in metres."""

    matrix: np.ndarray
    """A of equation (1), [3, 3]; px."""
    k: float
    """The one radial coefficient of equation (3)."""
    pose: np.ndarray
    """T_cam_board of every view [views, 4, 4]; NaN where no board was found."""
    stripe: list[np.ndarray]
    """Pixels (u, v) of the stripe on the board [n, 2], of every view; empty where the view shows none."""
    linear: np.ndarray
    """a, b, c of equations (4) and (8): a X + b Y + Z = c [3]; c in metres."""
    total: np.ndarray
    """The same plane by total least squares [3]."""
    tr: np.ndarray
    """Tr of equation (10): the camera's motion from one table position to the other [4, 4]."""
    pair_angle: float
    """The table's angle between both positions, as commanded [rad]."""
