"""A step as text that travels to the process that does it, and what it answers."""

import json
import os
import platform
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jaxscan
from jaxscan.errors import CaptureError, JaxscanError
from jaxscan.files.disk import file_digest
from jaxscan.project.catalogue import Output, Row
from jaxscan.project.states import Status
from jaxscan.project.steps import Step
from jaxscan.project.work.desk import Desk, desk_of, publish
from jaxscan.project.work.groups import merge_e57, merge_plan, merge_tiles, place_station, refine_rig, register_stations
from jaxscan.project.work.products import draw_panorama, draw_room, make_mesh, measure, write_report
from jaxscan.project.work.sweeps import calibrate_rig, find_part, reconstruct_sweep
from jaxscan.reconstruction import Progress


WORK: Mapping[str, Callable[[Desk], None]] = {
    "calibration": calibrate_rig,
    "recalibration": refine_rig,
    "stripes": find_part,
    "cloud": reconstruct_sweep,
    "measures": measure,
    "mesh": make_mesh,
    "plan": draw_room,
    "panorama": draw_panorama,
    "report": write_report,
    "register": register_stations,
    "station": place_station,
    "merged e57": merge_e57,
    "merged tiles": merge_tiles,
    "merged plan": merge_plan,
}
"""The function for each kind of step."""
_LONGEST = 2000


class Order(NamedTuple):
    """A step, and where it is done."""

    step: Step
    digest: str
    parts: Mapping[str, str]
    output: str
    """The folder of the products."""

    def to_json(self) -> str:
        """For its way to a worker."""
        return json.dumps(self._asdict() | {"step": self.step._asdict()}, allow_nan=False)

    @staticmethod
    def from_json(text: str) -> "Order":
        """The order of a text."""
        fields = json.loads(text)
        step = fields.pop("step")
        lists = {name: tuple(step[name]) for name in ("inputs", "outputs")}
        return Order(Step(**{**step, **lists}), **fields)


def order_of(status: Status, output: Path) -> Order:
    """The order to do a step."""
    return Order(status.step, status.digest, status.parts, str(output))


def do_step(order: Order, progress: Progress = None) -> Row:
    """Do one step, and say how it went: no error leaves, so one failed capture does not stop the others.

    Args:
        order: The step.
        progress: Called with (done, in all).
    """
    started = time.perf_counter()
    try:
        outputs, notes = _done(order, progress)
    except JaxscanError as problem:
        return failed_row(order, str(problem), seconds=time.perf_counter() - started)
    except Exception as problem:
        # A defect of jaxscan is the failure of one step too; where it arose is kept in the catalogue.
        message = f"unexpected {type(problem).__name__}: {problem}".splitlines()[0]
        return failed_row(order, message, seconds=time.perf_counter() - started, details=traceback.format_exc())
    return _row(order, "done", _sentences(notes), time.perf_counter() - started)._replace(outputs=outputs)


def _sentences(notes: Sequence[str]) -> str:
    """Notes in one line, each with its full stop."""
    return " ".join(note if note.endswith((".", "!", "?")) else f"{note}." for note in map(str.strip, notes) if note)


def begun_row(order: Order) -> Row:
    """The row of a step that is handed out now."""
    return _row(order, "begun", "", 0.0)


def failed_row(order: Order, message: str, *, seconds: float = 0.0, details: str = "") -> Row:
    """The row of a step that failed now, after some time, with the line that says why."""
    return _row(order, "failed", message, seconds)._replace(details=details)


def _row(order: Order, state: str, message: str, seconds: float) -> Row:
    host = f"{platform.node()} {os.getpid()}"
    return Row(
        order.step.key,
        order.digest,
        state,
        message[:_LONGEST],
        order.parts,
        (),
        started_s=time.time() - seconds,
        seconds=seconds,
        host=host,
        version=jaxscan.__version__,
    )


def _done(order: Order, progress: Progress) -> tuple[tuple[Output, ...], list[str]]:
    output = Path(order.output)
    with desk_of(order.step, output, progress) as desk:
        WORK[order.step.kind](desk)
        missing = next((name for name in order.step.outputs if name not in desk.made()), None)
        if missing is not None:
            raise CaptureError(f"{order.step.key}: {missing} was not written.")
        written = tuple(_described(path, desk) for path in desk.made())
        publish(desk)
        return written, desk.notes


def _described(path: str, desk: Desk) -> Output:
    file = desk.beside(path)
    return Output(path, file.stat().st_size, file_digest(file))
