"""The sentences that people read about a session: about events, and about its end."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrig.session.ending import Ending


def say_end(ending: Ending, folder: Path, *, count: int, planned: int, suspect: Sequence[tuple[int, int]]) -> str:
    """How a session ended, as one line.

    Args:
        ending: The end.
        folder: Of the capture.
        count: Records on the disk.
        planned: Records of the complete capture.
        suspect: Ranges of suspect records.
    """
    there = f"{count} of {planned} records"
    says = {
        "complete": f"complete, {count} records",
        "suspect": f"steps were lost: records {_spoken(suspect)} are suspect; resume the capture to take them again",
        "interrupted": f"interrupted with {there}; it can be resumed",
        "e-stop": f"{ending.message}. {there} are there; release the e-stop, then resume the capture",
        "disk full": f"{ending.message} {there} are there",
    }[ending.status]
    # The message of an error may already begin with the folder.
    return f"{folder}: {says.removeprefix(f'{folder}: ').rstrip('.')}."


def say_event(name: str, fields: Mapping[str, Any]) -> str:
    """The sentence about an event; "" for most events."""
    match name:
        case "retake":
            action = f"step {fields['step']}" if "step" in fields else "a look"
            return f"{action} is taken again: {fields['reason']}"
        case "fault":
            return f"{fields['at']}: {fields['problem']}"
        case "reconnected":
            position = "kept its position" if fields["same_boot"] else "was reset"
            return f"the controller is connected again and {position}"
        case "compared" | "closing" if "correlation" not in fields:
            return (
                f"record {fields['record']}, taken again, was compared by the laser's line alone: the laser-off frames "
                "have too little contrast. With more light in the room, lost steps are found more surely."
            )
        case "light":
            return (
                f"record {fields['record']}: the light changed from {fields['was_dn']:.0f} to {fields['is_dn']:.0f} DN."
            )
        case "camera":
            return f"the camera is open again, after {fields['reopened']} attempts"
        case "suspect":
            runs = _spoken([(first, last) for first, last in fields["records"]])
            return f"records {runs} are suspect: {fields['why']}"
        case _:
            return ""


def _spoken(runs: Sequence[tuple[int, int]]) -> str:
    return ", ".join(f"{first} to {last}" if last > first else str(first) for first, last in runs)
