"""Where on each line a stripe can lie at all: between the near and the far limit of the sheet."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, StripeAxis, across_and_along, lit_points, stripe_pixel
from jaxscan.stripes import LineGate


_AHEAD = 24
"""Intervals that are looked at together: those of about three cells."""
Cells = tuple[Int[np.ndarray, " _"], Float[np.ndarray, " _"]]
_PITCH_PX = 8.0
"""Largest distance between the points at which rays meet the sheet [px]."""
_SAFETY = 8.0
"""The interpolation's error is bounded by its second differences, times this."""


def line_gate(
    scanner: Scanner,
    laser: int,
    *,
    stripe_axis: StripeAxis = "rows",
    min_range_m: float = 0.05,
    max_range_m: float = 30.0,
    margin_px: float = 2.0,
) -> LineGate:
    r"""The part of every line on which the rays meet a laser's sheet between two ranges.

    The incidence $m = d / \mathrm{range}$ (`LaserSheet.intersect`) is smooth over the image. It is
    computed on a coarse lattice and interpolated. Values within the error of that, bounded by the lattice's
    second differences, count as accepted, and so does an interval between two pixels of which one
    is too near and the other too far. Where the accepted part of a line falls apart, the gate spans all of
    it. No centre that `triangulate` accepts with the same limits is outside.

    Args:
        scanner: Camera and lasers.
        laser: Which of the lasers.
        stripe_axis: Whether a line is an image row or an image column.
        min_range_m: Smallest distance along the ray [m].
        max_range_m: Largest distance along the ray [m]; may be infinite.
        margin_px: How far the gate reaches beyond [px].

    Returns:
        The gate, and which side is near.

    Raises:
        ValueError: If the limits contradict each other.
    """
    if not 0.0 <= min_range_m < max_range_m or not margin_px >= 0.0:
        raise ValueError(
            f"The gate needs 0 <= min_range_m < max_range_m and a margin of at least 0 px, "
            f"got {min_range_m}, {max_range_m} and {margin_px}."
        )
    camera, rig = scanner.camera, scanner.rig
    length, lines = across_and_along(camera.width, camera.height, stripe_axis)
    across, along = _nodes(-1.0, float(length)), _nodes(0.0, float(lines - 1))
    u, line = np.meshgrid(across, along)
    _, incidence = lit_points(rig, stripe_pixel(u, line, stripe_axis), laser)
    distance = float(rig.laser(laser).distance)
    least = distance / max_range_m
    most = distance / min_range_m if min_range_m > 0 else math.inf
    places = _cells(np.arange(float(lines)), along), _cells(np.arange(-1.0, length + 1.0), across)
    return _gate(np.asarray(incidence), places, (least, most), math.ceil(margin_px))


def _nodes(first: float, last: float) -> Float[np.ndarray, " nodes"]:
    """Evenly spaced coordinates from first to last, at most a pitch apart."""
    return np.linspace(first, last, max(2, 1 + math.ceil((last - first) / _PITCH_PX)))


def _error(incidence: Float[np.ndarray, "a b"]) -> Float[np.ndarray, "a b"]:
    """Bound of the error of bilinear interpolation around each lattice point, in either direction.

    Between two points a function departs from its chord by at most an eighth of its largest second
    difference.
    """
    total = np.zeros_like(incidence)
    for axis in (0, 1):
        if incidence.shape[axis] < 3:
            return np.full_like(incidence, np.inf)
        second = np.abs(np.diff(incidence, 2, axis=axis))
        total += np.pad(second, [(1, 1) if i == axis else (0, 0) for i in (0, 1)], mode="edge") / 8.0
    # The largest of a point and its neighbours: the cell's own curvature is between theirs.
    for axis in (0, 1):
        padded = np.pad(total, [(1, 1) if i == axis else (0, 0) for i in (0, 1)], mode="edge")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 3, axis=axis)
        total = windows.max(-1)
    return _SAFETY * total


def _gate(
    incidence: Float[np.ndarray, "a b"], places: tuple[Cells, Cells], limits: tuple[float, float], grown: int
) -> LineGate:
    (row, _), (index, _) = places
    lattice = _Lattice.of(incidence, places, limits)
    lines, length = len(row), len(index) - 2
    possible = lattice.possible()
    some = np.asarray(possible.any(1))[row]
    # Interval k lies between coordinates k - 1 and k. Those of the first and the last cells that may hold an accepted
    # one are looked at, and of few lines all.
    starts = np.searchsorted(index, np.arange(possible.shape[1]))
    before = starts[possible.argmax(1)][row]
    after = starts[possible.shape[1] - 1 - possible[:, ::-1].argmax(1)][row] + _AHEAD
    first = _first(lattice, np.flatnonzero(some), before[some] - 2, 1)
    last = _first(lattice, np.flatnonzero(some), np.minimum(after[some], length), -1)
    low, high = np.zeros(lines, np.int32), np.zeros(lines, np.int32)
    exists = first >= 0
    mine = np.flatnonzero(some)[exists]
    low[mine] = np.clip(first[exists] - 1 - grown, 0, length - 1)
    high[mine] = np.clip(last[exists] + grown + 1, 1, length)
    rise = np.nansum(np.where(possible, np.diff(incidence[:-1] + incidence[1:], axis=1), 0.0))
    return LineGate(low, high, 1 if rise >= 0 else -1)


class _Lattice(NamedTuple):
    """The incidence on the lattice and along its lines, with the bounds of its error."""

    incidence: Float[np.ndarray, "a b"]
    error: Float[np.ndarray, "a b"]
    wide: Float[np.ndarray, "a n"]
    """The incidence at every coordinate along the lines of the lattice."""
    loose: Float[np.ndarray, "a n"]
    """Its error."""
    places: tuple[Cells, Cells]
    limits: tuple[float, float]

    @staticmethod
    def of(incidence: Float[np.ndarray, "a b"], places: tuple[Cells, Cells], limits: tuple[float, float]) -> "_Lattice":
        error, (index, fraction) = _error(incidence), places[1]
        wide = _between(incidence[:, index], incidence[:, index + 1], fraction[None, :])
        return _Lattice(incidence, error, wide, np.maximum(error[:, index], error[:, index + 1]), places, limits)

    def possible(self) -> Bool[np.ndarray, "rows cells"]:
        """Cells in which, or beside which, an interval may be accepted."""

        def around(values: np.ndarray, of: Callable) -> np.ndarray:
            both = of(values[:-1], values[1:])
            padded = np.pad(both, ((0, 0), (1, 1)), mode="edge")
            four = [padded[:, k : k + both.shape[1] - 1] for k in range(4)]
            return np.asarray(of(of(four[0], four[1]), of(four[2], four[3])))

        slack = around(self.error, np.maximum)
        return _accepted(around(self.incidence, np.minimum), around(self.incidence, np.maximum), slack, self.limits)

    def accepted(self, lines: Int[np.ndarray, " m"], interval: Int[np.ndarray, "m w"]) -> Bool[np.ndarray, "m w"]:
        """Whether intervals of lines are accepted."""
        row, down = (place[lines, None] for place in self.places[0])

        def at(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            m = _between(self.wide[row, place], self.wide[row + 1, place], down)
            return m, np.maximum(self.loose[row, place], self.loose[row + 1, place])

        (m, slack), (m_next, slack_next) = at(interval), at(interval + 1)
        return _accepted(np.minimum(m, m_next), np.maximum(m, m_next), np.maximum(slack, slack_next), self.limits)


def _accepted(smaller: np.ndarray, larger: np.ndarray, slack: np.ndarray, limits: tuple[float, float]) -> np.ndarray:
    """Written so that a NaN is not excluded; a ray must meet the sheet in front."""
    least, most = limits
    return np.asarray(~(larger + slack < least) & ~(smaller - slack > most) & ~(larger + slack <= 0.0))


def _first(
    lattice: _Lattice, lines: Int[np.ndarray, " m"], start: Int[np.ndarray, " m"], side: int
) -> Int[np.ndarray, " m"]:
    """The first accepted interval of each line from its start on, towards one side; -1 where there is none."""
    length = lattice.wide.shape[1] - 2
    found = np.full(len(lines), -1)
    waiting = np.arange(len(lines))
    steps = np.arange(_AHEAD)
    for ahead in range(0, length + 2 * _AHEAD, _AHEAD):
        at = start[waiting, None] + side * (ahead + steps)
        inside = (at >= 0) & (at <= length)
        accepted = lattice.accepted(lines[waiting], np.clip(at, 0, length)) & inside
        some = accepted.any(1)
        found[waiting[some]] = at[some, accepted[some].argmax(1)]
        waiting = waiting[~some & inside.any(1)]
        if len(waiting) == 0:
            break
    return found


def _cells(x: Float[np.ndarray, " n"], nodes: Float[np.ndarray, " m"]) -> Cells:
    """In which cell of evenly spaced nodes each coordinate lies, and how far from its start."""
    position = (x - nodes[0]) / (nodes[1] - nodes[0]) if nodes[1] > nodes[0] else np.zeros_like(x)
    index = np.clip(np.floor(position).astype(int), 0, len(nodes) - 2)
    return index, position - index


def _between(a: np.ndarray, b: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    return a + fraction * (b - a)
