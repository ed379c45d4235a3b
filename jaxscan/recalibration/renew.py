"""Stored calibrations: what a recalibration requires of one, and the new one that it makes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxscan.calibration import (
    Calibration,
    CalibrationSettings,
    Lengths,
    Quality,
    Verdict,
    measure_good_to,
    predict_lengths,
    refusal,
)
from jaxscan.errors import CalibrationError, CaptureError
from jaxscan.geometry import Scanner, Turntable, root_of
from jaxscan.recalibration.result import Recalibration


def require_prior(stored: Calibration, name: str = "the calibration") -> Scanner:
    """The scanner of a calibration that can be refined: camera, sheet, table and their covariance.

    Raises:
        CalibrationError: With the name of the calibration and the part that is missing.
    """
    scanner = stored.scanner
    if scanner is None or not scanner.laser_names:
        parts = "a camera alone" if scanner is None else "camera and axis, without a laser sheet"
        raise CalibrationError(
            f"{name}: holds {parts}; sweeps refine a whole rig: calibrate it once with a board and the laser."
        )
    if not isinstance(scanner.turntable, Turntable):
        moves = {"linear": "a linear stage", "poses": "a camera on a hand"}.get(
            scanner.turntable.carries, "a scanner that stands still"
        )
        raise CalibrationError(
            f"{name}: is that of {moves}; only sweeps of a turntable refine their rig: calibrate with boards."
        )
    if scanner.turntable.carries != "scanner":
        raise CalibrationError(
            f"{name}: is that of a table that carries the {scanner.turntable.carries}, expected one that turns the "
            "scanner in its room; calibrate with boards."
        )
    if scanner.covariance is None or not np.any(np.diag(np.asarray(scanner.covariance)) > 0):
        raise CalibrationError(
            f"{name}: has no covariance, so nothing holds the two scales that walls leave open; sweeps refine a "
            "calibration that jaxscan calibrate wrote: calibrate once with a board."
        )
    return scanner


def earlier_captures(provenance: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The ancestors of a new calibration, by its provenance: calibration and captures of each, the oldest first."""
    own = {"captures": _tables(provenance.get("captures"))}
    origin = provenance.get("calibration")
    if isinstance(origin, Mapping) and origin:
        own["calibration"] = origin  # type: ignore[assignment]
    return [*_tables(provenance.get("earlier")), *([own] if own["captures"] else [])]


def refuse_used(captures: Sequence[tuple[str, str]], provenance: Mapping[str, Any], name: str) -> None:
    """Refuse a capture (path, digest) from which the stored calibration was made, or one before it.

    Its covariance holds all that such a capture tells: used again, every uncertainty would come out too small.

    Raises:
        CaptureError: With the capture.
    """
    used = {digest for one in earlier_captures(provenance) for digest in _digests(one.get("captures"))}
    for path, digest in captures:
        if digest in used:
            raise CaptureError(
                f"{path}: was already used for {name} or a calibration before it, expected a capture that is new to "
                "it: every uncertainty would come out too small; take a new one, or start from the older calibration."
            )


def _digests(captures: object) -> Iterator[str]:
    return (one["digest"] for one in _tables(captures) if isinstance(one.get("digest"), str))


def _tables(found: object) -> list[Any]:
    """The tables of a list; a file that a person wrote may have anything there."""
    return [one for one in found if isinstance(one, Mapping)] if isinstance(found, list | tuple) else []


def renew_calibration(result: Recalibration, provenance: Mapping[str, Any]) -> Recalibration:
    """The result; where the scanner was updated, with the new calibration."""
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
