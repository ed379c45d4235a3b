"""What neighbouring steps show of the room that a frame sees, where the camera turns with the table.

A point of the room at one of a few distances is seen at known places of two other steps, whose stripes are elsewhere.
Of the distances each place takes the one at which both agree with each other and with the frame; that is a plane
sweep (R. T. Collins, A space-sweep approach to true multi-image matching, CVPR 1996).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, StripeAxis, pixels, poses, rays, stripe_pixel, transform
from jaxscan.stripes import Channels, Sites, box_mean, warped


_NODES_PX = 16
"""Distance between the pixels of which the place in another step is computed [px]."""
_AGREE_DN = 8.0
"""Difference of two steps up to which their mean is taken, and beyond it the darker: one has a stripe there [DN]."""
_MOST_DN = 20.0
"""Residual from which more is not worse [DN]."""
_AROUND = (8, 4)
"""Samples and lines on either side whose residuals choose the distance."""


class Lattice(NamedTuple):
    """Pixels of a plane whose places in another step are computed; the others lie between them."""

    line: Float[np.ndarray, " lines"]
    """Lines of the image [px]."""
    u: Float[np.ndarray, " samples"]
    """Coordinates across [px]."""
    sites: Sites

    @staticmethod
    def of(shape: tuple[int, int], sites: Sites) -> "Lattice":
        """That of a plane [lines, samples]."""
        line, sample = (_NODES_PX * np.arange(-(-size // _NODES_PX) + 1.0) for size in shape)
        return Lattice(sites.first_line + sites.line_step * line, sites.offsets[0] + sites.pitch * sample, sites)


def places(
    scanner: Scanner, phi: tuple[float, float], ranges: Float[np.ndarray, " ranges"], lattice: Lattice, axis: StripeAxis
) -> Float[np.ndarray, "ranges lines samples 2"]:
    """Where the second of two steps sees what the first sees at the lattice's pixels, as (line, sample) of the plane.

    Args:
        scanner: The rig.
        phi: The table's angles of both steps [rad].
        ranges: Distances of the points from the camera [m].
        lattice: Pixels of the first step.
        axis: Whether a line is an image row or an image column.
    """
    rig = scanner.rig
    u, line = np.meshgrid(lattice.u, lattice.line)
    ray = rays(rig, stripe_pixel(u, line, axis))
    at = transform(poses(rig, phi[0]), ranges[:, None, None, None] * ray)
    q = pixels(rig, at, phi[1])
    sites, (u, line) = lattice.sites, (q[..., 0], q[..., 1]) if axis == "rows" else (q[..., 1], q[..., 0])
    found = np.stack([(line - sites.first_line) / sites.line_step, (u - sites.offsets[0]) / sites.pitch], -1)
    # A pixel that is nowhere in the other step is taken from its border, and will not agree.
    return np.nan_to_num(found, nan=-1.0, posinf=1e6, neginf=-1e6).astype(np.float32)


def moved(seen: Channels, neighbours: tuple[Channels, Channels], where: tuple[np.ndarray, np.ndarray]) -> Channels:
    """The frame as two other steps predict it.

    Args:
        seen: The frame, one.
        neighbours: Frames of two other steps; may be the same.
        where: Of `places`, for each of them.
    """
    level = seen.laser[0].astype(np.float32)
    stacks = [np.stack([one.laser[0], *(other[0] for other in one.others)]).astype(np.float32) for one in neighbours]
    own = np.stack([level, *(other[0] for other in seen.others)])
    best, least = own, np.full_like(level, np.inf)
    for number in range(len(where[0])):
        first, second = (warped(stack, place[number], _NODES_PX) for stack, place in zip(stacks, where, strict=True))
        apart, darker = np.abs(first - second), np.minimum(first, second)
        found = np.where(apart < np.float32(_AGREE_DN), 0.5 * (first + second), darker)
        size = np.minimum(apart, np.float32(_MOST_DN)) + np.minimum(np.abs(own - darker), np.float32(_MOST_DN))
        size = box_mean(size.mean(0, keepdims=True), *_AROUND)[0]
        better = size < least
        best, least = np.where(better, found, best), np.minimum(size, least)
    return Channels(best[:1], tuple(plane[None] for plane in best[1:]))
