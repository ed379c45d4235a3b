"""The captures that a calibration was made from, along the chain of calibrations before it."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jaxscan.errors import CaptureError


def earlier_captures(provenance: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The ancestors of a new calibration: calibration and captures of each, the oldest first.

    Args:
        provenance: Of the stored calibration.
    """
    own = {"captures": _tables(provenance.get("captures"))}
    origin = provenance.get("calibration")
    if isinstance(origin, Mapping) and origin:
        own["calibration"] = origin  # type: ignore[assignment]
    return [*_tables(provenance.get("earlier")), *([own] if own["captures"] else [])]


def refuse_used(captures: Sequence[tuple[str, str]], provenance: Mapping[str, Any], name: str) -> None:
    """Refuse a capture from which the stored calibration was made, or one before it.

    Its covariance holds all that such a capture tells: used again, every uncertainty would come out too small.

    Args:
        captures: Path and digest of each.
        provenance: Of the stored calibration.
        name: Of the stored calibration, for the message.

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
