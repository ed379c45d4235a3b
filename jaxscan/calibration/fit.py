"""Residuals of a finished solve, and how much each observation counted in it."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Fit:
    """Every observation after the solve: for residual plots, predictions and tests of the model.

    Arrays have the shapes of the observations; entries that are not valid there are 0 here.
    """

    pose: np.ndarray
    """T_cam_board of every view at its table angle [views, 4, 4]."""
    warp: np.ndarray
    """Height kx, ky of the board's bow [m]."""
    pitch: float
    """Relative error of the board's squares [1]."""
    corner_error: np.ndarray
    """Projected minus observed corners [views, corners, 2], px."""
    corner_sigma: np.ndarray
    """Estimated standard deviation of each coordinate [views, corners], px."""
    corner_leverage: np.ndarray
    """Share of each whitened residual that the fit takes up [views, corners, 2]."""
    corner_kept: np.ndarray
    """bool [views, corners]."""
    stripe_error: np.ndarray
    """Sampson errors of the stripe points [stripes, points], px."""
    stripe_sigma: np.ndarray
    """Estimated standard deviation [stripes, points], px; correlation along the stripe not included."""
    stripe_leverage: np.ndarray
    stripe_kept: np.ndarray
    covariance: np.ndarray
    """Of the shared unknowns and of the board: `Calibration.order`, then warp.x, warp.y, pitch, and the modes of
    its shape."""
    bend: np.ndarray = field(default_factory=lambda: np.zeros(0))
    """Coefficients of the board's `bend_functions` [m]; empty for a parabola."""
    offset: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    """Where every corner stands beside the bowed and bent surface [corners, 3], m; empty for a parabola."""
