"""Observations: board corners and stripe points on padded grids of views."""

from collections.abc import Sequence
from dataclasses import replace

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import AbstractBoard, Array
from jaxscan.geometry.motions import Carries
from jaxscan.geometry.scanner import Up
from jaxscan.observation.first_look import Look
from jaxscan.observation.records import BoardSource
from jaxscan.observation.stripes_on_board import MOST_POINTS, BoardStripe


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
    """Contrast class of every point: 0 on even print, 1 at a weak edge, 2 at a strong one; 3 to 5 the
    same of points that were not fitted through the print. None: all alike."""


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
    other_lines: StripeViews | None = None
    """Other lines on the same boards that may be the stripes; None once the views have agreed on a sheet."""


def to_observations(captures: Sequence[BoardSource], look: Look) -> Observations:
    """The observations of the records in which the board was found."""
    first = captures[0]
    views = [view for view in look.records if view.corners is not None]
    q, sigma, valid = map(np.stack, zip(*(view.corners for view in views if view.corners is not None), strict=True))
    keys = [view.placement or f"alone {index}" for index, view in enumerate(views)]
    number = {key: index for index, key in enumerate(dict.fromkeys(keys))}
    lines = [[(stripe, index, view.laser) for stripe in view.stripes] for index, view in enumerate(views)]
    others = [line for found in lines for line in found[1:]]
    width, height = first.image_size
    return Observations(
        board=look.board,
        corners=BoardViews(
            q=q,
            sigma=sigma,
            valid=valid,
            angle=np.array([view.record.angle or 0.0 for view in views]),
            placement=np.array([number[key] for key in keys], np.int32),
            # 64 bits: a journal of another program may count milliseconds.
            record=np.array([view.record.i for view in views], np.int64),
        ),
        stripes=stack_stripes([found[0] for found in lines if found]),
        width=width,
        height=height,
        laser_names=tuple(line.name for line in first.lasers),
        up=first.up,
        carries=first.carries or "scanner",
        other_lines=stack_stripes(others) if others else None,
    )


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


def stack_stripes(stripes: Sequence[tuple[BoardStripe, int, int]], points: int = MOST_POINTS) -> StripeViews:
    """All stripes of a capture, given as (stripe, row of `BoardViews`, laser); empty ones are left out."""
    kept = [(stripe, view, laser) for stripe, view, laser in stripes if stripe.valid.any()]
    q, sigma, valid = np.zeros((0, points, 2)), np.zeros((0, points)), np.zeros((0, points), bool)
    contrast = np.zeros((0, points), np.int8)
    if kept:
        q, sigma, valid, contrast = map(np.stack, zip(*(stripe for stripe, _, _ in kept), strict=True))
    view, laser = (np.array([entry[k] for entry in kept], np.int32) for k in (1, 2))
    return StripeViews(q, sigma, valid, view, laser, contrast)
