"""What a calibration sees: board corners and stripe points, on padded grids of views."""

import equinox as eqx
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import AbstractBoard, Array
from jaxscan.geometry.scanner import Up
from jaxscan.geometry.turntable import Carries


class BoardViews(eqx.Module):
    """Corners of the board, one view per record in which it was found.

    The corner axis is the board's own (`board.corners()`); corners not seen are not valid.
    """

    q: Float[Array, "views corners 2"]
    """Corner (u, v) [px]."""
    sigma: Float[Array, "views corners"]
    """Standard deviation of each coordinate of `q` [px]."""
    valid: Bool[Array, "views corners"]
    angle: Float[Array, " views"]
    """The table's angle [rad from home]; 0 where unknown."""
    placement: Int[Array, " views"]
    """Views with the same number saw the same unmoved board, 0 ... placements - 1."""
    record: Int[Array, " views"]
    """The record's own number `i`, for messages and reports."""


class StripeViews(eqx.Module):
    """Stripe points on the board, padded; one row per (view, laser) with a stripe."""

    q: Float[Array, "stripes points 2"]
    """Stripe centre (u, v) [px]."""
    sigma: Float[Array, "stripes points"]
    """Standard deviation of `q` across the stripe [px]."""
    valid: Bool[Array, "stripes points"]
    view: Int[Array, " stripes"]
    """Row of `BoardViews` whose board the stripe lies on."""
    laser: Int[Array, " stripes"]


class Observations(eqx.Module):
    """All that the joint solve reads."""

    board: AbstractBoard
    corners: BoardViews
    stripes: StripeViews
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    laser_names: tuple[str, ...] = eqx.field(static=True)
    up: Up = eqx.field(static=True, default="-v")
    carries: Carries = eqx.field(static=True, default="scanner")
