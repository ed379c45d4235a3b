"""Stripes of a chunk to colours and points; compiled together with the extraction."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import UInt8

from jaxscan.geometry import Array
from jaxscan.reconstruction.points.colour import needs_frames, stripe_colours
from jaxscan.reconstruction.points.locate import Aim, Centres, Points, locate_points
from jaxscan.stripes import Continuation, ExtractionSetup, FrameFormat, FrameStripes


class Coloured(NamedTuple):
    """Colours of stripes, and their points where there is an aim."""

    rgb: UInt8[Array, "profiles lines 3"]
    points: Points | None


def coloured(
    frames: FrameFormat, aim: Aim | None = None, phi: Array | None = None, *, records: int = 0
) -> Continuation:
    """The continuation that gives `Coloured`.

    Args:
        frames: How a frame is to be read.
        aim: Rig, laser and limits; None for colours alone.
        phi: The table's angle of each record [rad from home], float32.
        records: As of `Continuation`.
    """
    return Continuation(_coloured, aim, phi, needs_frames(frames), records)


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
    return Coloured(rgb, locate_points(aim, centres, phi, stripe_axis=axis))
