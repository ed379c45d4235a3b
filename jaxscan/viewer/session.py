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
    measure_area,
    measure_box,
    measure_flatness,
    measure_pair,
    measure_point,
    measure_sides,
)
from jaxscan.viewer.orders import Order, Ray
from jaxscan.viewer.picking import pick
from jaxscan.viewer.shown import ShownCloud


_WIDER, _WIDEST = 4.0, 10.0
"""Factor on the cone of a click that met nothing, and of clicks while the surface between the points is shown."""
_WIDEST_RAD = 0.3
_FAR_M = 1e5
"""Edge of a box of which a side leaves nothing out."""
_MOST_WORKS = 4
_PLANES = 50
"""Planes of flatness that are kept after they were taken out: their colours may be on their way to the page."""
_ASKS: dict[str, str] = {
    "distance": "Now the other place, in the same cloud.",
    "height": "Now the place whose height over it is wanted, in the same cloud.",
    "angle": "Now the other wall, in the same cloud.",
}


class Entry(NamedTuple):
    """A line of the list."""

    cloud: int
    measured: Measured
    id: int
    """Number by which a page names it; never given twice."""


Found = tuple[list[tuple[int, Measured]], str]
"""Measurements, each with the number of its cloud; and why there are none."""
Measure = Callable[[Callable[[], bool]], Found]
"""A measurement in progress whose answer is still wanted."""


class Work(NamedTuple):
    """A measurement that was begun."""

    id: int
    measure: Measure


class Session:
    """The measurements of a page; any thread may call."""

    def __init__(self, clouds: Sequence[ShownCloud], scanner: Scanner | None) -> None:
        """Nothing is measured yet; with the scanner that made the clouds, sigma includes the calibration's part."""
        self._clouds, self._scanner = clouds, scanner
        self.kind: Kind = "point"
        self.measured: list[Entry] = []
        self._ids, self._works = count(), count()
        self._pending: list[int] = []
        """The measurements in progress whose answers are still wanted."""
        self.message = ""
        self._places: list[tuple[int, np.ndarray]] = []
        """The clouds and the places that were clicked of a measurement that needs more of them."""
        self._planes: dict[int, PlaneMeasurement] = {}
        self._lock = threading.Lock()

    def begin(self, order: Order) -> dict[str, Any] | Work:
        """Do what is quick; returns what the page shows then, or the work that is left, for `finish`.

        Works go on beside each other; "cancel", "undo" and "clear" end them.
        """
        with self._lock:
            if order.do == "save":
                return self._saved(order.what)
            self.message = ""
            measure: Measure | None = None
            match order.do:
                case "choose":
                    self.kind, self._places = order.what, []  # type: ignore[assignment]
                case "cancel" | "undo" | "clear" if self._pending:
                    self._pending, self._places = [], []
                    self.message = "Ended: what went on was not measured."
                    if order.do == "clear":
                        self.measured = []
                case "undo":
                    self._undo()
                case "cancel":
                    self._places = []
                case "remove":
                    self.measured = [entry for entry in self.measured if entry.id != order.id]
                case "clear":
                    self.measured, self._places = [], []
                case "room" | "box" | "pick" if not order.shifts:
                    self.message = "No cloud is shown."
                case "room" | "pick" if len(self._pending) >= _MOST_WORKS:
                    self.message = f"{_MOST_WORKS} measurements go on: wait for one of them, or end them by Esc."
                case "room":
                    measure = partial(self._room, order)
                case "box":
                    self._box(order)
                case "close":
                    measure = self._close()
                case "pick" if order.ray is not None:
                    measure = self._pick(order, order.ray)
            if measure is None:
                return self.state()
            work = Work(next(self._works), measure)
            self._pending.append(work.id)
            return work

    def finish(self, work: Work) -> dict[str, Any] | None:
        """Measure what was begun; returns what the page shows then, None where an order has ended it since."""
        wanted = lambda: work.id in self._pending
        if not wanted():
            return None
        found, problem = work.measure(wanted)
        with self._lock:
            if not wanted():
                return None
            self._pending.remove(work.id)
            self.message = problem
            for number, one in found:
                self._add(number, one)
            return self.state()

    def _add(self, number: int, measured: Measured) -> None:
        entry = Entry(number, measured, next(self._ids))
        self.measured.append(entry)
        if measured.plane is not None:
            self._planes[entry.id] = measured.plane
            while len(self._planes) > _PLANES:
                del self._planes[next(iter(self._planes))]

    def state(self) -> dict[str, Any]:
        """What a page shows of it."""
        return {
            "kind": self.kind,
            "message": self.message,
            "measuring": len(self._pending),
            "places": [self._in_scene(*place) for place in self._places],
            "measured": [
                {"id": key, "kind": one.kind, "words": one.words, "command": one.command(), "cloud": number}
                | {"at": [self._in_scene(number, place) for place in one.at], "plane": one.plane is not None}
                for number, one, key in self.measured
            ],
        }

    def _in_scene(self, number: int, place: np.ndarray) -> dict[str, Any]:
        return {"cloud": number, "xyz": (place - self._clouds[number].origin).tolist()}

    def plane(self, key: int) -> PlaneMeasurement | None:
        """The plane of a measurement of flatness, by its id; also of one that was just taken out."""
        return self._planes.get(key)

    def _undo(self) -> None:
        if self._places:
            self._places.pop()
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
        if self.kind == "area" and len(self._places) > 2 and self._meets_first(order, ray):
            return self._close()
        # Between two profiles there may be no point within a finger's breadth.
        cones = [1.0, _WIDER] + [_WIDEST] * order.surface
        hits = next((found for wider in cones if (found := self._hits(order, ray, wider))), None)
        if not hits:
            self.message = "There is no point: click on the cloud."
            return None
        _, number, index = min(hits)
        cloud = self._clouds[number]
        picked = measure_point(cloud, index)
        place = picked.at[0]
        if self.kind == "point":
            self._add(number, picked)
            return None
        if self.kind == "flatness":
            return partial(_one, number, partial(measure_flatness, cloud, place))
        if self._places and self._places[0][0] != number:
            self._places = []
        self._places.append((number, place))
        if self.kind == "area":
            few = len(self._places) < 3
            self.message = "Now the next corner." if few else "Now the next corner, or the first one to close it."
            return None
        if len(self._places) < 2:
            self.message = _ASKS[self.kind]
            return None
        (_, first), self._places = self._places[0], []
        return partial(_one, number, partial(measure_pair, self.kind, cloud, first, place, self._scanner))

    def _meets_first(self, order: Order, ray: Ray) -> bool:
        """Whether a click is on the first corner of the outline."""
        number, place = self._places[0]
        shift = next((shift for one, shift in order.shifts if one == number), None)
        if shift is None:
            return False
        apart = place - self._clouds[number].origin + shift - ray.origin
        along = float(apart @ ray.direction) / float(np.linalg.norm(ray.direction))
        return bool(along > np.cos(2 * ray.cone_rad) * np.linalg.norm(apart))

    def _close(self) -> Measure | None:
        """The area of the outline, whose last corner was clicked."""
        if len(self._places) < 3:
            self.message = "An area has three corners at least: click the next one."
            return None
        number, places = self._places[0][0], [place for _, place in self._places]
        self._places = []
        return partial(_one, number, partial(measure_area, self._clouds[number], places))

    def _box(self, order: Order) -> None:
        """The volume of the box that is shown."""
        if order.section is None:
            return
        size = order.section[1] - order.section[0]
        # A side that leaves nothing out is far away.
        if not 0 < size.max() < _FAR_M or size.min() <= 0:
            self.message = "The box is open: move all of its sides, so that it ends where the volume does."
            return
        number, shift = order.shifts[0]
        points = sum(
            int(np.count_nonzero(inside_section(self._clouds[one], move, order))) for one, move in order.shifts
        )
        cloud = self._clouds[number]
        centre = _turn(order).T @ order.section.mean(0) - shift + cloud.origin
        self._add(number, measure_box(cloud, centre, size, points))

    def _hits(self, order: Order, ray: Ray, wider: float) -> list[tuple[float, int, int]]:
        """The point of each cloud that a ray meets: distance, number of the cloud, point."""
        hits, cone = [], min(wider * ray.cone_rad, _WIDEST_RAD)
        for number, shift in order.shifts:
            xyz, origin = self._clouds[number].xyz, ray.origin - shift
            shown = None if order.section is None else inside_section(self._clouds[number], shift, order)
            sides = None if order.backs else self._clouds[number].sides
            index = pick(xyz, origin, ray.direction, cone_rad=cone, shown=shown, sides=sides)
            if index is not None:
                hits.append((float(np.linalg.norm(xyz[index] - origin)), number, index))
        return hits

    def _saved(self, what: str) -> dict[str, Any]:
        listed = [entry.measured for entry in self.measured]
        data = as_csv(listed) if what == "csv" else as_json(listed)
        return {"file": f"measured.{what}", "text": data.decode()}


def inside_section(cloud: ShownCloud, shift: np.ndarray, order: Order) -> np.ndarray:
    """Which points of a cloud that stands at `shift` are in the section of an order, bool [n]."""
    if order.section is None:
        return np.ones(len(cloud.xyz), np.bool_)
    # Scene to box; the cloud's own shift is taken from the box, whose numbers are few.
    turn = _turn(order)
    low, high = (order.section - turn @ shift).astype(np.float32)
    within = cloud.xyz @ turn.T.astype(np.float32) if order.turn_rad else cloud.xyz
    return np.asarray(((within >= low) & (within <= high)).all(1))


def _turn(order: Order) -> np.ndarray:
    """Rotation from the scene to the frame of the section [3, 3]."""
    c, s = np.cos(order.turn_rad), np.sin(order.turn_rad)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def _one(number: int, measure: Callable[[], Measured], _: Callable[[], bool]) -> Found:
    try:
        return [(number, measure())], ""
    except MeasurementError as problem:
        return [], " ".join(str(problem).split())
