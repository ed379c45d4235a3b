"""Where on each line a stripe can lie at all: between the near and the far limit of the sheet."""

import math

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, across_and_along, lit_points, stripe_pixel
from jaxscan.stripes import LineGate


_PITCH_PX = 8.0
"""Largest distance between the points at which rays meet the sheet [px]."""
_SAFETY = 8.0
"""The interpolation's error is bounded by its second differences, times this."""
_LINES = 64
"""Lines that are looked at together."""


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
        min_range_m: Smallest distance along the ray [m].
        max_range_m: Largest distance along the ray [m]; may be infinite.
        margin_px: How far the gate reaches beyond [px].

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
    incidence = np.asarray(lit_points(rig, stripe_pixel(u, line, stripe_axis), laser)[1])
    distance = float(rig.laser(laser).distance)
    least, most = distance / max_range_m, distance / min_range_m if min_range_m > 0 else math.inf
    row, down = _cells(np.arange(float(lines)), along)
    index, over = _cells(np.arange(-1.0, length + 1.0), across)
    error = _error(incidence)
    # At every coordinate along the lines of the lattice.
    wide = incidence[:, index] + over * (incidence[:, index + 1] - incidence[:, index])
    loose = np.maximum(error[:, index], error[:, index + 1])
    low, high, rise, grown = np.zeros(lines, np.int32), np.zeros(lines, np.int32), 0.0, math.ceil(margin_px)
    for start in range(0, lines, _LINES):
        part = slice(start, start + _LINES)
        above, below = row[part], row[part] + 1
        m = wide[above] + down[part, None] * (wide[below] - wide[above])
        slack = np.maximum(loose[above], loose[below])
        # Interval k lies between coordinates k - 1 and k.
        smaller, larger = np.minimum(m[:, :-1], m[:, 1:]), np.maximum(m[:, :-1], m[:, 1:])
        slack = np.maximum(slack[:, :-1], slack[:, 1:])
        # Written so that a NaN is not excluded; a ray must meet the sheet in front.
        accepted = ~(larger + slack < least) & ~(smaller - slack > most) & ~(larger + slack <= 0.0)
        exists = accepted.any(1)
        first, last = accepted.argmax(1), length - accepted[:, ::-1].argmax(1)
        low[part] = np.where(exists, np.clip(first - 1 - grown, 0, length - 1), 0)
        high[part] = np.where(exists, np.clip(last + grown + 1, 1, length), 0)
        rise += float(np.nansum(np.where(accepted, np.diff(m), 0.0)))
    return LineGate(low, high, 1 if rise >= 0 else -1)


def _nodes(first: float, last: float) -> Float[np.ndarray, " nodes"]:
    """Evenly spaced coordinates from first to last, at most a pitch apart."""
    return np.linspace(first, last, max(2, 1 + math.ceil((last - first) / _PITCH_PX)))


def _cells(
    x: Float[np.ndarray, " n"], nodes: Float[np.ndarray, " m"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """The cell of evenly spaced nodes in which each coordinate lies, and how far it is from the start of that cell."""
    position = (x - nodes[0]) / (nodes[1] - nodes[0]) if nodes[1] > nodes[0] else np.zeros_like(x)
    index = np.clip(np.floor(position).astype(int), 0, len(nodes) - 2)
    return index, position - index


def _error(incidence: Float[np.ndarray, "a b"]) -> Float[np.ndarray, "a b"]:
    """Bound of the error of bilinear interpolation around each lattice point, in either direction.

    Between two points a function departs from its chord by at most an eighth of its largest second difference.
    """
    if min(incidence.shape) < 3:
        return np.full_like(incidence, np.inf)
    total = np.zeros_like(incidence)
    for axis in (0, 1):
        border = [(1, 1) if k == axis else (0, 0) for k in (0, 1)]
        total += np.pad(np.abs(np.diff(incidence, 2, axis=axis)), border, mode="edge") / 8.0
    # The largest of a point and its neighbours: the cell's own curvature is between theirs.
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(total, 1, mode="edge"), (3, 3))
    return _SAFETY * windows.max((-2, -1))
