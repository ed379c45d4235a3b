"""A recalibration as a calibration of its own."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jaxscan.calibration import Calibration, CalibrationSettings, Quality, Verdict
from jaxscan.calibration.verdict import Lengths, measure_good_to, predict_lengths, refusal
from jaxscan.geometry import Scanner, root_of
from jaxscan.recalibration.result import Recalibration


def renew_calibration(result: Recalibration, provenance: Mapping[str, Any]) -> Recalibration:
    """The result; where the scanner was updated, with the new calibration.

    Args:
        result: As `recalibrate` gives it.
        provenance: Of the new calibration: captures, settings, versions.
    """
    scanner = result.scanner
    if scanner.covariance is None or result.adjusted.prior.covariance is None:
        return result
    if not result.updated:
        return result
    calibration = Calibration(
        camera=scanner.camera,
        scanner=scanner,
        order=scanner.parameter_names(),
        covariance=np.asarray(scanner.covariance, np.float64),
        quality=_quality(result, scanner, predict_lengths(scanner)),
        provenance=dict(provenance),
    )
    return replace(result, calibration=calibration)


def _quality(result: Recalibration, scanner: Scanner, lengths: Lengths) -> Quality:
    steps = root_of(np.asarray(scanner.covariance, np.float64))
    good_to, _ = measure_good_to(scanner.camera, scanner, steps, (), None)
    refused = refusal(good_to, scanner.camera, CalibrationSettings())
    return Quality(
        converged=result.adjusted.converged,
        steps=result.adjusted.steps,
        angle_sigma=result.adjusted.stop_sigma,
        lengths=lengths,
        verdict=Verdict(refused is None, good_to, refused),
    )
