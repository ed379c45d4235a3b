"""Where on each line a stripe can lie at all: between the near and the far limit of the sheet."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import Scanner, StripeAxis, across_and_along, stripe_pixel
from jaxscan.stripes import LineGate


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
    camera, sheet = scanner.camera, scanner.laser(laser)
    length, lines = across_and_along(camera.width, camera.height, stripe_axis)
    across, along = _nodes(-1.0, float(length)), _nodes(0.0, float(lines - 1))
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), (camera, sheet))
        incidence = np.asarray(_incidence(*exact, jnp.asarray(along), jnp.asarray(across), stripe_axis))
    distance = float(np.asarray(sheet.distance))
    least = distance / max_range_m
    most = distance / min_range_m if min_range_m > 0 else math.inf
    places = _cells(np.arange(float(lines)), along), _cells(np.arange(-1.0, length + 1.0), across)
    return _gate(incidence, places, (least, most), math.ceil(margin_px))


def _nodes(first: float, last: float) -> Float[np.ndarray, " nodes"]:
    """Evenly spaced coordinates from first to last, at most a pitch apart."""
    return np.linspace(first, last, max(2, 1 + math.ceil((last - first) / _PITCH_PX)))


@functools.partial(jax.jit, static_argnames="stripe_axis")
def _incidence(camera, sheet, along, across, stripe_axis):
    """m of `LaserSheet.intersect` on the lattice [along, across]."""

    def at(line, u):
        return sheet.intersect(camera.unproject(stripe_pixel(u, line, stripe_axis)))[1]

    return jax.vmap(jax.vmap(at, (None, 0)), (0, None))(along, across)


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
    error, (least, most) = _error(incidence), limits
    (row, down), (index, fraction) = places
    lines, length = len(row), len(index) - 2
    # Lines of the lattice at all pixels, then pairs of these for all lines in between.
    wide = _between(incidence[:, index], incidence[:, index + 1], fraction[None, :])
    loose = np.maximum(error[:, index], error[:, index + 1])
    low, high = np.zeros(lines, np.int32), np.zeros(lines, np.int32)
    rise = 0.0
    for cell in np.unique(row):
        members = np.flatnonzero(row == cell)
        m = _between(wide[cell][None, :], wide[cell + 1][None, :], down[members][:, None])
        slack = np.maximum(loose[cell], loose[cell + 1])
        slack = np.maximum(slack[:-1], slack[1:])[None, :]
        smaller, larger = np.minimum(m[:, :-1], m[:, 1:]), np.maximum(m[:, :-1], m[:, 1:])
        # Written so that a NaN is not excluded; a ray must meet the sheet in front.
        accepted = ~(larger + slack < least) & ~(smaller - slack > most) & ~(larger + slack <= 0.0)
        some = accepted.any(1)
        # Interval k lies between coordinates k - 1 and k.
        first = accepted.argmax(1) - 1
        last = length - accepted[:, ::-1].argmax(1)
        low[members] = np.where(some, np.clip(first - grown, 0, length - 1), 0)
        high[members] = np.where(some, np.clip(last + grown + 1, 1, length), 0)
        rise += np.nansum(np.where(accepted, m[:, 1:] - m[:, :-1], 0.0))
    return LineGate(low, high, 1 if rise >= 0 else -1)


def _cells(x: Float[np.ndarray, " n"], nodes: Float[np.ndarray, " m"]) -> Cells:
    """In which cell of evenly spaced nodes each coordinate lies, and how far from its start."""
    position = (x - nodes[0]) / (nodes[1] - nodes[0]) if nodes[1] > nodes[0] else np.zeros_like(x)
    index = np.clip(np.floor(position).astype(int), 0, len(nodes) - 2)
    return index, position - index


def _between(a: np.ndarray, b: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    return a + fraction * (b - a)
