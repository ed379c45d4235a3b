"""When a calibration was made."""

import datetime
from pathlib import Path

from jaxscan.calibration import Calibration


def calibration_date(calibration: Calibration, path: Path | None = None) -> str:
    """The day and minute (UTC) of a calibration, or of its file where the calibration does not say; "" if unknown."""
    said = calibration.provenance.get("date")
    if isinstance(said, str):
        try:
            return _shown(datetime.datetime.fromisoformat(said))
        except (ValueError, OverflowError):
            # A file may say anything.
            return ""
    if path is None or not path.is_file():
        return ""
    written = datetime.datetime.fromtimestamp(path.stat().st_mtime, datetime.UTC)
    return f"{_shown(written)}, by the time of its file"


def _shown(when: datetime.datetime) -> str:
    zone = when.astimezone(datetime.UTC) if when.tzinfo else when
    return f"{zone.day} {zone:%B %Y, %H:%M} UTC"
