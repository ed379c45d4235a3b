"""What people are told of a session: of an event, and of its end."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrig.session.ending import Ending


def say_end(ending: Ending, folder: Path, *, count: int, planned: int, suspect: Sequence[tuple[int, int]]) -> str:
    """How a session ended, as one line.

    Args:
        ending: The end.
        folder: Of the capture.
        count: Records that are there.
        planned: Records that there will be.
        suspect: Ranges of records in doubt.
    """
    again = "go on with --resume"
    there = f"{count} of {planned} records"
    says = {
        "complete": f"complete, {count} records",
        "suspect": f"steps were lost: the records {_spoken(suspect)} are suspect; take them again with --resume",
        "interrupted": f"interrupted with {there}; {again}",
        "e-stop": f"{ending.message}. {there} are there; release the e-stop, then {again}",
        "disk full": f"{ending.message} {there} are there",
    }[ending.status]
    # What failed may have named the folder already.
    return f"{folder}: {says.removeprefix(f'{folder}: ').rstrip('.')}."


def say_event(name: str, fields: Mapping[str, Any]) -> str:
    """What people are told of an event; "" of most."""
    match name:
        case "retake":
            what = f"step {fields['step']}" if "step" in fields else "a look"
            return f"{what} is taken again: {fields['reason']}"
        case "fault":
            return f"{fields['at']}: {fields['problem']}"
        case "reconnected":
            stands = "knows where it stands" if fields["same_boot"] else "was reset"
            return f"the controller is there again, and {stands}"
        case "camera":
            return f"the camera is there again, at attempt {fields['reopened']}"
        case "suspect":
            runs = _spoken([(first, last) for first, last in fields["records"]])
            return f"records {runs} are suspect: {fields['why']}"
        case _:
            return ""


def _spoken(runs: Sequence[tuple[int, int]]) -> str:
    return ", ".join(f"{first} to {last}" if last > first else str(first) for first, last in runs)
