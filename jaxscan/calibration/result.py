"""The result of a calibration."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jaxscan.calibration.fit import Fit
from jaxscan.calibration.verdict import Quality
from jaxscan.geometry import AbstractCamera, Scanner
from jaxscan.observation import Observations


@dataclass(frozen=True)
class Calibration:
    """A calibrated rig and everything needed to judge it or to solve it again."""

    camera: AbstractCamera
    scanner: Scanner | None
    """None where only the camera was calibrated; otherwise it carries `covariance` too. It has no sheets where only
    camera and motion were calibrated."""
    order: tuple[str, ...]
    """Names of the minimal coordinates that `covariance` refers to."""
    covariance: np.ndarray
    """Covariance [params, params] in the units px, rad, m; zero for parameters held fixed."""
    quality: Quality = field(default_factory=Quality)
    """Numbers by which to judge the result: whether it converged, residuals, counts, verdict, ..."""
    observations: Observations | None = None
    missing: tuple[str, ...] = ()
    """A sentence for each part that was not solved: why, and the captures that it needs."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Inputs by digest, settings, versions."""
    fit: Fit | None = None
    """Known after a solve; files hold the observations instead, from which it is found again."""
