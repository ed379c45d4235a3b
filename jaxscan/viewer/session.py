"""What one page picks and measures. A page that is loaded again finds it as it was."""

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
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
        self.measured: list[tuple[int, Measured]] = []
        """With the number of the cloud."""
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
                {"kind": one.kind, "words": one.words, "command": one.command(), "cloud": number}
                | {"at": [self._in_scene(number, place) for place in one.at], "plane": one.plane is not None}
                for number, one in self.measured
            ],
        }

    def _in_scene(self, number: int, place: np.ndarray) -> dict[str, Any]:
        return {"cloud": number, "xyz": (place - self._clouds[number].origin).tolist()}

    def plane(self, number: int) -> Measured | None:
        """A measurement of flatness by its place in the list."""
        found = self.measured[number][1] if 0 <= number < len(self.measured) else None
        return found if found is not None and found.plane is not None else None

    def _undo(self) -> None:
        if self._first is not None:
            self._first = None
        elif self.measured:
            self.measured.pop()

    def _room(self, order: Order) -> None:
        if not order.shifts:
            raise MeasurementError("No cloud is shown.")
        number = order.shifts[0][0]
        self.measured += [(number, side) for side in measure_sides(self._clouds[number], self._scanner)]

    def _pick(self, order: Order, ray: Ray) -> None:
        hits = []
        for number, shift in order.shifts:
            xyz, origin = self._clouds[number].xyz, ray.origin - shift
            shown = None
            if order.section is not None:
                low, high = (order.section - shift).astype(np.float32)
                shown = ((xyz >= low) & (xyz <= high)).all(1)
            index = pick(xyz, origin, ray.direction, cone_rad=ray.cone_rad, shown=shown)
            if index is not None:
                hits.append((float(np.linalg.norm(xyz[index] - origin)), number, index))
        if not hits:
            self.message = "There is no point: click on the cloud."
            return
        _, number, index = min(hits)
        cloud = self._clouds[number]
        picked = measure_point(cloud, index)
        place = picked.at[0]
        if self.kind == "point":
            self.measured.append((number, picked))
        elif self.kind == "flatness":
            self.measured.append((number, measure_flatness(cloud, place)))
        elif self._first is None or self._first[0] != number:
            self._first = (number, place)
            self.message = "Now the other place, in the same cloud."
        else:
            first, self._first = self._first[1], None
            self.measured.append((number, measure_between(cloud, first, place, self._scanner)))

    def _saved(self, what: str) -> dict[str, Any]:
        listed = [one for _, one in self.measured]
        data = as_csv(listed) if what == "csv" else as_json(listed)
        return {"file": f"measured.{what}", "text": data.decode()}
