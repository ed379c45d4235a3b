"""Stripes of a chunk to colours and points; compiled together with the extraction."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import UInt8

from jaxscan.geometry import Array, StripeAxis
from jaxscan.reconstruction.points.colour import needs_frames, stripe_colours
from jaxscan.reconstruction.points.locate import Centres, Points, Rig, locate_points
from jaxscan.reconstruction.points.triangulate import Limits
from jaxscan.stripes import Continuation, ExtractionSetup, FrameFormat, FrameStripes


class Aim(NamedTuple):
    """Where the points of one laser go; arrays, so a change compiles nothing."""

    rig: Rig
    laser: Array
    """Which sheet, int32 []."""
    limits: Limits


class Coloured(NamedTuple):
    """Colours of stripes, and their points where there is an aim."""

    rgb: UInt8[Array, "profiles lines 3"]
    points: Points | None


def coloured(frames: FrameFormat, aim: Aim | None = None, phi: Array | None = None) -> Continuation:
    """The continuation that gives `Coloured`.

    Args:
        frames: How a frame is to be read.
        aim: Rig, laser and limits; None for colours alone.
        phi: The table's angle of each record [rad from home], float32.
    """
    return Continuation(_coloured, aim, phi, needs_frames(frames))


def _coloured(
    stripes: FrameStripes, off: Array | None, aim: Aim | None, phi: Array | None, setup: ExtractionSetup
) -> Coloured:
    axis = setup.line.stripe_axis
    rgb = stripe_colours(stripes, off, frames=setup.frames, stripe_axis=axis)
    if aim is None or phi is None:
        return Coloured(rgb, None)
    profiles = len(stripes.u)
    phi = jnp.repeat(phi, profiles // len(phi), total_repeat_length=profiles)
    centres = Centres(stripes.u, stripes.sigma, stripes.valid)
    return Coloured(rgb, points_of_centres(centres, aim, phi, stripe_axis=axis))


def points_of_centres(centres: Centres, aim: Aim, phi: Array, *, stripe_axis: StripeAxis) -> Points:
    """Points of stripe centres, an angle for each profile."""
    laser = jnp.broadcast_to(aim.laser, (len(phi),))
    return locate_points(aim.rig, centres, laser, phi, stripe_axis=stripe_axis, limits=aim.limits)


points_alone = jax.jit(points_of_centres, static_argnames="stripe_axis")
"""`points_of_centres`, compiled."""
