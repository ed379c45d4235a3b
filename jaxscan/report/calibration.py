"""A calibration in words and numbers that people read."""

import numpy as np

from jaxscan.calibration import Calibration
from jaxscan.geometry import Pinhole


def parameter_rows(calibration: Calibration) -> list[tuple[str, str, str]]:
    """Name, value and standard deviation of what was estimated, in the units that are read."""
    sigma = dict(zip(calibration.order, np.sqrt(np.maximum(np.diag(calibration.covariance), 0.0)), strict=True))
    camera, rows = calibration.camera, []
    if isinstance(camera, Pinhole):
        for name in ("fx", "fy", "cx", "cy"):
            rows.append((f"{name}, px", f"{float(getattr(camera, name)):.3f}", f"{sigma[name]:.3f}"))
        names = camera.parameter_names()[4:]
        for name, value in zip(names, np.asarray(camera.distortion), strict=True):
            rows.append((name, f"{value:.5f}", f"{sigma[name]:.5f}"))
    if calibration.scanner is None:
        return rows
    for index, name in enumerate(calibration.scanner.laser_names):
        sheet = calibration.scanner.laser(index)
        tilt = 1e3 * np.hypot(sigma[f"laser.{name}.n1"], sigma[f"laser.{name}.n2"])
        rows.append((f"laser {name}: normal", _vector(sheet.normal), f"{tilt:.4f} mrad"))
        distance = 1e3 * float(sheet.distance)
        rows.append((f"laser {name}: distance, mm", f"{distance:.3f}", f"{1e3 * sigma[f'laser.{name}.d']:.3f}"))
    table = calibration.scanner.turntable
    tilt, shift = (np.hypot(sigma[f"axis.{c}1"], sigma[f"axis.{c}2"]) for c in "dp")
    rows.append(("axis: direction", _vector(table.direction), f"{1e3 * tilt:.4f} mrad"))
    rows.append(("axis: nearest point, mm", _vector(1e3 * np.asarray(table.point), 3), f"{1e3 * shift:.3f}"))
    rows.append(("gain of the angle", f"{float(table.gain):+.6f}", f"{sigma['gain']:.6f}"))
    return rows


def quality_lines(calibration: Calibration) -> list[str]:
    """What to judge a calibration by, a line each; the last ones are warnings."""
    quality = calibration.quality
    lines = [
        f"corners: {quality['corners']} in {quality['views']} views, {quality['corners_rejected']} rejected, "
        f"RMS {quality['corner_rms_px']:.3f} px, whitened {quality['corner_rms_whitened']:.3f}"
    ]
    if calibration.scanner is not None:
        lines.append(
            f"stripes: {quality['stripe_points']} points, {quality['stripe_points_rejected']} rejected, "
            f"RMS {quality['stripe_rms_px']:.3f} px, whitened {quality['stripe_rms_whitened']:.3f}"
        )
    return lines + [f"warning: {warning}" for warning in quality["warnings"]]


def _vector(values: object, digits: int = 5) -> str:
    return " ".join(f"{value:.{digits}f}" for value in np.asarray(values))
