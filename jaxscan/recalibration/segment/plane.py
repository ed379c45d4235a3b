"""A plane through cells whose calibration may bend it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.recalibration.segment.local import ROUGH_M


_MOST = 1500
"""Points of one fit."""


class BentPlane(NamedTuple):
    """A plane `normal . p = distance` through points as they are, and how the calibration may have bent it."""

    normal: Float[np.ndarray, "3"]
    """Towards the scanner."""
    distance: float
    centre: Float[np.ndarray, "3"]
    axes: Float[np.ndarray, "2 3"]
    likely: Float[np.ndarray, " directions"]
    """Likely steps of the calibration that take off most of the bend."""
    rest: Float[np.ndarray, "3"]
    """How far these steps shift (at the centre [m]) and tilt (along the axes) the plane."""
    taken: Float[np.ndarray, "3 directions"]
    """The same of each likely step by itself."""
    curvature: float
    """Largest curvature of the points as they are, before the calibration is moved [1/m]."""
    curvature_sigma: float
    """Standard deviation of the curvature, by noise and by the likely steps [1/m]."""

    def error(self, p: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """Distances [n] of points [n, 3] from the bent plane; `bend` [n, 3, directions] as of `bending`."""
        shift = (bend @ self.likely) @ self.normal - self.rest[0] - (p - self.centre) @ (self.rest[1:] @ self.axes)
        return p @ self.normal - self.distance - shift


def bent_plane(
    p: Float[np.ndarray, "points 3"],
    sigma: Float[np.ndarray, " points"],
    bend: Float[np.ndarray, "points 3 directions"],
) -> BentPlane:
    """Least squares of a plane and of the likely steps of the calibration, whose prior is one standard deviation.

    Args:
        p: Points [m].
        sigma: Their standard deviations along the normal [m].
        bend: Shifts of the points by the likely steps [m].
    """
    some = np.unique(np.linspace(0, len(p) - 1, min(len(p), _MOST)).round().astype(int))
    p, bend, weight = p[some], bend[some], 1.0 / (sigma[some] ** 2 + ROUGH_M**2)
    centre = weight @ p / weight.sum()
    apart = p - centre
    vectors = np.linalg.eigh((apart * weight[:, None]).T @ apart)[1]
    normal, axes = vectors[:, 0], vectors[:, :0:-1].T
    normal = -normal if normal @ centre > 0 else normal
    s, t = apart @ axes.T[:, 0], apart @ axes.T[:, 1]
    flat = np.column_stack([np.ones(len(p)), s, t])
    height = apart @ normal
    shifts = np.einsum("nik,i->nk", bend, normal)
    # The part of the shifts that is a plane itself is the plane's: a point of each region stays where it is.
    plain = np.linalg.solve((flat * weight[:, None]).T @ flat, (flat * weight[:, None]).T)
    offset, taken = plain @ height, plain @ shifts
    bent = shifts - flat @ taken
    information = (bent * weight[:, None]).T @ bent + np.eye(bent.shape[1])
    likely = np.linalg.solve(information, (bent * weight[:, None]).T @ (height - flat @ offset))
    curved = np.column_stack([flat, s * s, s * t, t * t])
    inverse = np.linalg.pinv((curved * weight[:, None]).T @ curved)
    fit = inverse @ (curved * weight[:, None]).T
    c, by_likely = fit @ height, (fit @ shifts)[3:]
    hessian = np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])
    curvature = float(np.abs(np.linalg.eigvalsh(hessian)).max())
    doubt = 2.0 * float(np.sqrt(max(inverse[3, 3], inverse[5, 5]) + (by_likely**2).sum(1).max(initial=0.0)))
    tilted = normal - offset[1] * axes[0] - offset[2] * axes[1]
    tilted = tilted / np.linalg.norm(tilted)
    middle = centre + offset[0] * normal
    first = axes[0] - (axes[0] @ tilted) * tilted
    first = first / np.linalg.norm(first)
    second = np.cross(tilted, first)
    frame = np.stack([first, second if second @ axes[1] > 0 else -second])
    return BentPlane(tilted, float(tilted @ middle), middle, frame, likely, taken @ likely, taken, curvature, doubt)
