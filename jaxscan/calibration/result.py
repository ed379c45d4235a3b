"""What a calibration gives back."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxscan.geometry import AbstractCamera, Scanner
from jaxscan.observation import Observations


@dataclass(frozen=True)
class Fit:
    """What became of every observation: for residual plots, predictions and tests of the model.

    Arrays have the shapes of the observations; what is not valid there is 0 here.
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
    """Of the shared unknowns and of the board: `Calibration.order`, then warp.x, warp.y, pitch."""


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig and everything needed to judge it or to solve it again."""

    camera: AbstractCamera
    scanner: Scanner | None
    """None where only the camera was calibrated; otherwise it carries `covariance` too."""
    order: tuple[str, ...]
    """Names of the minimal coordinates that `covariance` refers to."""
    covariance: np.ndarray
    """Covariance [params, params] in the units px, rad, m; zero for parameters held fixed."""
    quality: dict[str, Any]
    """Numbers by which to judge the result, ready for JSON: whitened RMS per group, counts, ..."""
    observations: Observations | None = None
    provenance: dict[str, Any] = field(default_factory=dict)
    """Inputs by digest, settings, versions."""
    fit: Fit | None = None
    """Known after a solve; files hold the observations instead, from which it is found again."""
