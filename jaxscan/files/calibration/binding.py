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


def digests_of(tables: Mapping[str, Any], observations: Path | None) -> dict[str, str]:
    """The table of digests of a calibration file.

    Args:
        tables: All others, as JSON values.
        observations: The file beside it, if there is one.

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


def require_own(table: CalibrationTable, path: Path, observations: Path) -> None:
    """Check that the observations beside a calibration file are its own, where it names their digest.

    Raises:
        CalibrationError: If they are not.
    """
    expected = None if table.digests is None else table.digests.observations
    if expected is not None and file_digest(observations, error=CalibrationError) != expected:
        raise CalibrationError(
            f"{observations}: the observations beside {path.name} belong to another calibration or are damaged: copy "
            "the right file here, or move this one away to use the calibration without observations."
        )


def _values_digest(tables: Mapping[str, Any]) -> str:
    """Of the values as they are, not of the text, which may be set in another way."""
    values = {key: value for key, value in tables.items() if key != DIGESTS}
    return "sha256:" + hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()
