"""Observations: board corners and stripe points on padded grids of views."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import AbstractBoard, Array, Carries
from jaxscan.geometry.scanner import Up


CONTRAST_CLASSES = 6
"""Number of the contrast classes of stripe points: even print, a weak edge and a strong edge under the stripe; then the
same three for points that were not fitted through the print. The edges under those show in the shift of the centre, and
their errors are of another kind."""


class BoardViews(eqx.Module):
    """Corners of the board, one view per record in which it was found.

    Corners are in the order of `board.corners()`; corners that were not found are not valid.
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
    contrast: Int[Array, "stripes points"] | None = None
    """Contrast class of every point: 0 on even print, 1 at a weak edge, 2 at a strong one; 3 to 5
    are the same classes for points that were not fitted through the print. None if all points are alike."""


class Observations(eqx.Module):
    """Corners and stripes of boards, and the rig that saw them: the input of the joint solve."""

    board: AbstractBoard
    corners: BoardViews
    stripes: StripeViews
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    laser_names: tuple[str, ...] = eqx.field(static=True)
    up: Up = eqx.field(static=True, default="-v")
    carries: Carries = eqx.field(static=True, default="scanner")
    poses: Float[Array, "records 4 4"] | None = None
    """T_base_hand of every record, where poses are given [m]; the angle of a view is the place of its record here."""
    other_lines: StripeViews | None = None
    """Other lines on the same boards that may be the stripes; None once the views have agreed on a sheet."""


def with_lasers(observations: Observations, names: Sequence[str]) -> Observations:
    """The observations with the stripes of some lasers alone."""
    kept = [observations.laser_names.index(name) for name in names]

    def of_kept(stripes: StripeViews) -> StripeViews:
        laser = np.asarray(stripes.laser)
        rows = np.isin(laser, kept)
        own = jax.tree.map(lambda values: np.asarray(values)[rows], stripes)
        return replace(own, laser=np.array([kept.index(number) for number in laser[rows]], np.int32))

    others = None if observations.other_lines is None else of_kept(observations.other_lines)
    stripes = of_kept(observations.stripes)
    return replace(observations, laser_names=tuple(names), stripes=stripes, other_lines=others)
