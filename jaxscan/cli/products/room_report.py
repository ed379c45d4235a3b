"""The report of a reconstruction, as `jaxscan report` writes it."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.progress import progress_bar
from jaxscan.errors import OptionError


if TYPE_CHECKING:
    from jaxscan.files.clouds import Unit, Up
    from jaxscan.reconstruction import PointCloud


SAME_RAD = 0.02
"""A table's angle is corrected by less."""


def write_room_report(
    cloud: Path, output: Path, *, calibration: Path | None, capture: Path | None, unit: "Unit | None", up: "Up | None"
) -> dict[str, Any]:
    """Write the report of a cloud.

    Returns:
        Its numbers, for JSON.

    Raises:
        JaxscanError: If an input is not what it should be, or the report cannot be written.
    """
    # Imported here, so that `--help` does not load JAX.
    from jaxscan.api.products.reports import calibration_rows, look_again, save_report
    from jaxscan.files import clouds
    from jaxscan.files.calibration import calibration_notes
    from jaxscan.report import Beside

    if capture is not None and calibration is None:
        raise OptionError("--capture: of a cloud it is looked at with the rig's calibration: give -c calibration.json.")
    stored = clouds.read_cloud(cloud)
    points, notes = clouds.in_metres(stored, unit)
    points, more = clouds.with_z_up(stored, points, up)
    notes = [*notes, *more]
    scanner, rows = None, []
    if calibration is not None:
        scanner = jaxscan.load_scanner(calibration)
        notes += calibration_notes(calibration)
        rows = calibration_rows(calibration, stored.about.calibration)
    elif stored.about.calibration:
        rows = [("digest", stored.about.calibration)]
    doubts, left_out = None, ""
    if capture is not None and scanner is not None:
        sweep = jaxscan.open_capture(capture)
        if not _is_made_of(stored.cloud, sweep.angles):
            raise OptionError(f"--capture: {cloud} was not made of {capture}: its profiles have other angles.")
        with progress_bar("Looking at the capture") as progress:
            doubts, left_out = look_again(sweep, scanner, progress)
    beside = Beside(cloud.name, tuple(notes), tuple(rows), doubts, left_out)
    facts, box = save_report(points, output, scanner=scanner, beside=beside)
    sides = {} if box is None else {"length": box.length, "width": box.width, "height": box.height}
    seen = facts.directions[0]
    return {
        "cloud": str(cloud),
        "report": str(output),
        "points": facts.points,
        "dimensions": {
            name: {"value_m": side.value_m, "sigma_m": side.sigma_m} for name, side in sides.items() if side is not None
        },
        "coverage": seen.share(of_band=True),
        "holes": len(seen.holes()),
        "median_sigma_m": facts.median_sigma_m,
        "doubts": list(facts.doubts if doubts is None else doubts),
        "notes": notes,
    }


def _is_made_of(cloud: "PointCloud", angles: np.ndarray) -> bool:
    """Whether the profiles of a cloud have the angles of a sweep's records [rad]; clouds do not name their capture."""
    record = np.asarray(cloud.record)
    if not (np.ptp(cloud.angle) > 0 and record.min() >= 0 and record.max() < len(angles)):
        return False
    return bool(np.abs(angles[record] - np.asarray(cloud.angle)).max() < SAME_RAD)
