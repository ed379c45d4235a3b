"""Terms to test for: behaviour of lens, board, table and sheet that their models do not have."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.calibration.solve.problem import LEAST_STOP_SIGMA, Problem
from jaxscan.calibration.solve.stops import faults_of_motion
from jaxscan.geometry import AbstractMotion


# Degrees of the polynomials.
_LENS_DEGREE = 6
_RADIAL_POWERS = (4, 5)
_HEIGHT_DEGREE = 4
_PRINT_DEGREE = 3
_SHEET_DEGREES = (5, 1)


class Extents(NamedTuple):
    """Centres and half sizes that make coordinates of image and stripes about -1 ... 1."""

    image: Float[np.ndarray, "2 2"]
    stripe: Float[np.ndarray, "2 2"]


def extents_of(data: Prepared) -> Extents:
    """Those of an image and of the stripes seen in it."""
    half = np.array(data.size) / 2.0
    points = data.stripe_q[data.stripe_valid] if data.stripe_valid.any() else np.zeros((1, 2))
    low, high = points.min(0), points.max(0)
    return Extents(np.stack([half - 0.5, half]), np.stack([(low + high) / 2, np.maximum((high - low) / 2, 1.0)]))


def lens_terms(q: Float[np.ndarray, "views corners 2"], extents: Extents) -> Float[np.ndarray, "views rows terms"]:
    """Displacements of the image that are polynomials of the place in it [px]."""
    where = (q - extents.image[0]) / extents.image[1]
    field = _polynomials(where, _LENS_DEGREE)
    along, across = np.stack([field, np.zeros_like(field)], 2), np.stack([np.zeros_like(field), field], 2)
    terms = np.concatenate([along, across], axis=-1)
    return terms.reshape(terms.shape[0], -1, terms.shape[-1])


def radial_terms(q: Float[np.ndarray, "views corners 2"], extents: Extents) -> Float[np.ndarray, "views rows terms"]:
    """Displacements from the centre of the image as the next powers of the distance from it [px]."""
    away = (q - extents.image[0]) / np.linalg.norm(extents.image[1])
    square = np.sum(away * away, axis=-1)[..., None]
    terms = np.stack([away * square**power for power in _RADIAL_POWERS], axis=-1)
    return terms.reshape(terms.shape[0], -1, terms.shape[-1])


def board_terms(problem: Problem, shift: Float[np.ndarray, "views rows 3"]) -> Float[np.ndarray, "views rows terms"]:
    """Shapes of the board: polynomial heights, and prints that are not true [px]."""
    where = (np.asarray(problem.board)[:, :2] - problem.frame[:2]) / problem.frame[2:]
    heights, prints = _polynomials(where, _HEIGHT_DEGREE), _polynomials(where, _PRINT_DEGREE)
    # A shift along the axes of the board moves a corner as it moves the whole board.
    rows = lambda values: np.repeat(values, 2, axis=0)[None]
    parts = [
        shift[..., 0:1] * rows(prints),
        shift[..., 1:2] * rows(prints),
        shift[..., 2:3] * rows(heights),
    ]
    return np.concatenate(parts, axis=-1)


def sheet_terms(
    q: Float[np.ndarray, "stripes points 2"], problem: Problem, extents: Extents
) -> Float[np.ndarray, "stripes points terms"]:
    """Displacements of the stripe of each laser that are polynomials of the place in the image [px]."""
    where = (q - extents.stripe[0]) / extents.stripe[1]
    # Along the stripe any shape, across it (near and far) little.
    long = int(np.argmax(extents.stripe[1]))
    first, second = where[..., long], where[..., 1 - long]
    along = np.stack([first**i for i in range(_SHEET_DEGREES[0] + 1)], -1)
    across = np.stack([second**i for i in range(_SHEET_DEGREES[1] + 1)], -1)
    field = (along[..., :, None] * across[..., None, :]).reshape(*first.shape, -1)
    lasers = len(problem.lasers.distance)
    own = np.asarray(problem.stripe_laser)[:, None, None, None] == np.arange(lasers)[None, None, :, None]
    return np.where(own, field[:, :, None, :], 0.0).reshape(*first.shape, -1)


def _polynomials(where: Float[np.ndarray, "... 2"], degree: int) -> Float[np.ndarray, "... terms"]:
    # Chebyshev's, which are less alike than powers.
    def chebyshev(x):
        values = [np.ones_like(x), x]
        for _ in range(degree - 1):
            values.append(2.0 * x * values[-1] - values[-2])
        return values

    x, y = chebyshev(where[..., 0]), chebyshev(where[..., 1])
    return np.stack([x[i] * y[j] for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)


def turn_terms(problem: Problem, views: Int[np.ndarray, " views"]) -> Float[np.ndarray, "views terms"]:
    """Errors of the motion's positions at some views [rad or m].

    One of each view's own where stops are exact. Where they err by chance, those that chance does not make.
    """
    if float(problem.stop_sigma) <= LEAST_STOP_SIGMA:
        return np.eye(len(views))
    faults, stop = faults_of_motion(problem), np.asarray(problem.stop)[views]
    return np.einsum("vs,vst->vt", stop, faults[np.asarray(problem.placement)[views]])


def moving_twist(pose: Float[np.ndarray, "... 4 4"], motion: AbstractMotion) -> Float[np.ndarray, "... 6"]:
    """Twist (translation, rotation) of a board, in its own axes, that a motion by 1 rad or 1 m gives it in the image.

    Args:
        pose: T_cam_board; the axis or direction is the same at all positions, seen from the camera.
        motion: Of the camera.
    """
    # The camera moves, so the board moves the other way.
    back = np.swapaxes(pose[..., :3, :3], -1, -2)
    speed, axis = np.split(np.asarray(motion.twist()), 2)
    shift = speed + np.cross(axis, pose[..., :3, 3])
    return -np.concatenate([(back @ shift[..., None])[..., 0], back @ axis], axis=-1)
