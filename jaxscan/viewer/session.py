"""What one page picks and measures. A page that is loaded again finds it as it was."""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement import PlaneMeasurement
from jaxscan.viewer.measuring import (
    Kind,
    Measured,
    as_csv,
    as_json,
    measure_between,
    measure_flatness,
    measure_point,
    measure_sides,
)
from jaxscan.viewer.orders import Order, Ray
from jaxscan.viewer.picking import pick
from jaxscan.viewer.shown import ShownCloud


_WIDER = 4.0


class Entry(NamedTuple):
    """A line of the list."""

    cloud: int
    """Number of its cloud."""
    measured: Measured
    id: int
    """By which a page names it; never given twice."""


Found = tuple[list[tuple[int, Measured]], str]
"""Measurements, each with the number of its cloud; and why there are none."""
Measure = Callable[[Callable[[], bool]], Found]
"""Measures, as long as its answer is wanted."""


class Work(NamedTuple):
    """A measurement that was begun."""

    id: int
    measure: Measure


class Session:
    """The measurements of a page; any thread may call."""

    def __init__(self, clouds: Sequence[ShownCloud], scanner: Scanner | None) -> None:
        """Nothing is measured yet.

        Args:
            clouds: Those of the scene.
            scanner: With which they were made; sigma then includes the calibration's part.
        """
        self._clouds, self._scanner = clouds, scanner
        self.kind: Kind = "point"
        self.measured: list[Entry] = []
        self._ids, self._works = count(), count()
        self._pending: int | None = None
        """The measurement that goes on and whose answer is wanted."""
        self.message = ""
        self._first: tuple[int, np.ndarray] | None = None
        """The cloud and the first place of a distance."""
        self._lock = threading.Lock()

    def carry_out(self, order: Order) -> dict[str, Any] | None:
        """Do what a page asks for; returns what it shows then, None where another order made it needless."""
        answer = self.begin(order)
        return self.finish(answer) if isinstance(answer, Work) else answer

    def begin(self, order: Order) -> dict[str, Any] | Work:
        """Do what is quick; returns what the page shows then, or the work that is left, for `finish`.

        Whatever comes next but "save" and "remove" makes a work needless that is not finished.
        """
        with self._lock:
            if order.do == "save":
                return self._saved(order.what)
            waited, self.message = self._pending, ""
            if order.do != "remove":
                self._pending = None
            measure: Measure | None = None
            match order.do:
                case "choose":
                    self.kind, self._first = order.what, None  # type: ignore[assignment]
                # Of a measurement that goes on there is nothing else to take back.
                case "undo" if waited is None:
                    self._undo()
                case "undo" | "cancel" if waited is not None:
                    self.message = "Ended: nothing was measured."
                case "remove":
                    self.measured = [entry for entry in self.measured if entry.id != order.id]
                case "clear":
                    self.measured, self._first = [], None
                case "room" if not order.shifts:
                    self.message = "No cloud is shown."
                case "room":
                    measure = partial(self._room, order)
                case "pick" if order.ray is not None:
                    measure = self._pick(order, order.ray)
            if measure is None:
                return self.state()
            self._pending = next(self._works)
            return Work(self._pending, measure)

    def finish(self, work: Work) -> dict[str, Any] | None:
        """Measure what was begun; returns what the page shows then, None where an order has come since."""
        wanted = lambda: self._pending == work.id
        if not wanted():
            return None
        found, problem = work.measure(wanted)
        with self._lock:
            if not wanted():
                return None
            self._pending, self.message = None, problem
            self.measured += [Entry(number, one, next(self._ids)) for number, one in found]
            return self.state()

    def state(self) -> dict[str, Any]:
        """What a page shows of it."""
        return {
            "kind": self.kind,
            "message": self.message,
            "measuring": self._pending is not None,
            "first": None if self._first is None else self._in_scene(*self._first),
            "measured": [
                {"id": key, "kind": one.kind, "words": one.words, "command": one.command(), "cloud": number}
                | {"at": [self._in_scene(number, place) for place in one.at], "plane": one.plane is not None}
                for number, one, key in self.measured
            ],
        }

    def _in_scene(self, number: int, place: np.ndarray) -> dict[str, Any]:
        return {"cloud": number, "xyz": (place - self._clouds[number].origin).tolist()}

    def plane(self, key: int) -> PlaneMeasurement | None:
        """The plane of a measurement of flatness, by its id."""
        return next((entry.measured.plane for entry in self.measured if entry.id == key), None)

    def _undo(self) -> None:
        if self._first is not None:
            self._first = None
        elif self.measured:
            self.measured.pop()

    def _room(self, order: Order, wanted: Callable[[], bool]) -> Found:
        found: list[tuple[int, Measured]] = []
        problems = []
        for number, _ in order.shifts:
            if not wanted():
                break
            try:
                found += [(number, one) for one in measure_sides(self._clouds[number], self._scanner)]
            except MeasurementError as problem:
                name = f"{self._clouds[number].name}: " if len(order.shifts) > 1 else ""
                problems.append(f"{name}{problem}")
        return found, " ".join(" ".join(problems).split())

    def _pick(self, order: Order, ray: Ray) -> Measure | None:
        """The measurement that a click asks for; None where that is done, or nothing was met."""
        # Between two profiles there may be no point within a finger's breadth.
        hits = self._hits(order, ray) or self._hits(order, ray._replace(cone_rad=_WIDER * ray.cone_rad))
        if not hits:
            self.message = "There is no point: click on the cloud."
            return None
        _, number, index = min(hits)
        cloud = self._clouds[number]
        picked = measure_point(cloud, index)
        place = picked.at[0]
        if self.kind == "point":
            self.measured.append(Entry(number, picked, next(self._ids)))
            return None
        if self.kind == "flatness":
            return partial(_one, number, partial(measure_flatness, cloud, place))
        if self._first is None or self._first[0] != number:
            self._first = (number, place)
            self.message = "Now the other place, in the same cloud."
            return None
        first, self._first = self._first[1], None
        return partial(_one, number, partial(measure_between, cloud, first, place, self._scanner))

    def _hits(self, order: Order, ray: Ray) -> list[tuple[float, int, int]]:
        """The point of each cloud that a ray meets: distance, number of the cloud, point."""
        hits = []
        for number, shift in order.shifts:
            xyz, origin = self._clouds[number].xyz, ray.origin - shift
            shown = None
            if order.section is not None:
                c, s = np.cos(order.turn_rad), np.sin(order.turn_rad)
                # Scene to box; the cloud's own shift is taken from the box, whose numbers are few.
                turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
                low, high = (order.section - turn @ shift).astype(np.float32)
                within = xyz @ turn.T.astype(np.float32) if order.turn_rad else xyz
                shown = ((within >= low) & (within <= high)).all(1)
            sides = None if order.backs else self._clouds[number].sides
            index = pick(xyz, origin, ray.direction, cone_rad=ray.cone_rad, shown=shown, sides=sides)
            if index is not None:
                hits.append((float(np.linalg.norm(xyz[index] - origin)), number, index))
        return hits

    def _saved(self, what: str) -> dict[str, Any]:
        listed = [entry.measured for entry in self.measured]
        data = as_csv(listed) if what == "csv" else as_json(listed)
        return {"file": f"measured.{what}", "text": data.decode()}


def _one(number: int, measure: Callable[[], Measured], _: Callable[[], bool]) -> Found:
    try:
        return [(number, measure())], ""
    except MeasurementError as problem:
        return [], " ".join(str(problem).split())
