"""What one page picks and measures. A page that is loaded again finds it as it was."""

import threading
from collections.abc import Sequence
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
        self._ids = count()
        self.message = ""
        self._first: tuple[int, np.ndarray] | None = None
        """The cloud and the first place of a distance."""
        self._lock = threading.Lock()

    def carry_out(self, order: Order) -> dict[str, Any]:
        """Do what a page asks for; returns what it shows then."""
        with self._lock:
            self.message = ""
            try:
                match order.do:
                    case "choose":
                        self.kind, self._first = order.what, None  # type: ignore[assignment]
                    case "undo":
                        self._undo()
                    case "remove":
                        self.measured = [entry for entry in self.measured if entry.id != order.id]
                    case "clear":
                        self.measured, self._first = [], None
                    case "room":
                        self._room(order)
                    case "pick" if order.ray is not None:
                        self._pick(order, order.ray)
                    case "save":
                        return self._saved(order.what)
            except MeasurementError as problem:
                self._first = None
                self.message = " ".join(str(problem).split())
            return self.state()

    def state(self) -> dict[str, Any]:
        """What a page shows of it."""
        return {
            "kind": self.kind,
            "message": self.message,
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

    def _add(self, number: int, *found: Measured) -> None:
        self.measured += [Entry(number, one, next(self._ids)) for one in found]

    def _undo(self) -> None:
        if self._first is not None:
            self._first = None
        elif self.measured:
            self.measured.pop()

    def _room(self, order: Order) -> None:
        if not order.shifts:
            raise MeasurementError("No cloud is shown.")
        problems = []
        for number, _ in order.shifts:
            try:
                self._add(number, *measure_sides(self._clouds[number], self._scanner))
            except MeasurementError as problem:
                name = f"{self._clouds[number].name}: " if len(order.shifts) > 1 else ""
                problems.append(f"{name}{problem}")
        if problems:
            raise MeasurementError(" ".join(problems))

    def _pick(self, order: Order, ray: Ray) -> None:
        # Between two profiles there may be no point within a finger's breadth.
        hits = self._hits(order, ray) or self._hits(order, ray._replace(cone_rad=_WIDER * ray.cone_rad))
        if not hits:
            self.message = "There is no point: click on the cloud."
            return
        _, number, index = min(hits)
        cloud = self._clouds[number]
        picked = measure_point(cloud, index)
        place = picked.at[0]
        if self.kind == "point":
            self._add(number, picked)
        elif self.kind == "flatness":
            self._add(number, measure_flatness(cloud, place))
        elif self._first is None or self._first[0] != number:
            self._first = (number, place)
            self.message = "Now the other place, in the same cloud."
        else:
            first, self._first = self._first[1], None
            self._add(number, measure_between(cloud, first, place, self._scanner))

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
