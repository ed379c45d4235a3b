"""Digests in a calibration file: of its own values, and of the observations beside it."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxscan.errors import CalibrationError
from jaxscan.files.calibration.model import CalibrationTable
from jaxscan.files.disk import file_digest


DIGESTS = "digests"
"""Key of the table that holds them."""


def digests_of(tables: Mapping[str, Any], observations: Path | None = None) -> dict[str, str]:
    """The table of digests of a calibration file.

    Args:
        tables: All others, as JSON values.
        observations: The file with the observations, if there is one.

    Raises:
        CalibrationError: If the observations cannot be read.
    """
    digests = {"values": _values_digest(tables)}
    if observations is not None:
        digests["observations"] = file_digest(observations, error=CalibrationError)
    return digests


def values_note(tables: Mapping[str, Any], name: str) -> str:
    """A sentence if the values of a calibration file are not those that its digest was made of; else "".

    A file without a digest, as a person writes it, gives none.
    """
    digests = tables.get(DIGESTS)
    expected = digests.get("values") if isinstance(digests, dict) else None
    if expected is None or expected == _values_digest(tables):
        return ""
    return (
        f"{name}: its values have changed since jaxscan calibrate wrote it, so points may be wrong; calibrate again, "
        f'or, if the change is meant, remove "{DIGESTS}" from the file.'
    )


def require_own(table: CalibrationTable, path: Path, beside: Path, *, found: bool) -> None:
    """Check that the observations beside a calibration file are its own, where it has digests.

    Args:
        table: The calibration.
        path: Its file.
        beside: The file beside it.
        found: Whether that file holds observations.

    Raises:
        CalibrationError: If they are not, or if it names none.
    """
    digests = table.digests
    if digests is None:
        return
    if digests.observations is None:
        # A file of something else may lie beside a calibration without observations.
        own = not (found and digests.values is not None)
    else:
        own = file_digest(beside, error=CalibrationError) == digests.observations
    if not own:
        raise CalibrationError(
            f"{beside}: the observations beside {path.name} belong to another calibration or are damaged: calibrate "
            "again, copy the right file here, or move this one away to use the calibration without observations."
        )


def _values_digest(tables: Mapping[str, Any]) -> str:
    """Of the values as they are, not of the text, which may be set in another way."""
    values = {key: value for key, value in tables.items() if key != DIGESTS}
    return "sha256:" + hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
