"""Where the camera sits on a hand whose poses are given, and how far these poses scatter.

Poses of a robot or a tracker err by more than boards do: a hundredth of a degree is as much as a corner's noise. So
camera and sheets are solved with a pose of its own for every view, and the given poses meet those of the views here:

$$\\exp(\\epsilon) = F^{-1}\\, Y\\, C^{-1} X^{-1},$$

with $F$ the given pose of the hand, $X$ the camera on it, $Y$ the board in the base and $C$ the board as the camera
saw it. The twist $\\epsilon$ is the error of the given pose, and of the seen one, whose covariance is known. While the
scatter of the given poses is learned, the camera is free within its own covariance, for its errors move every view
otherwise; the place of the camera is then solved for the camera as it was found.
"""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.problem import LOCAL_SCALE, layout_of
from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.geometry import (
    AbstractMotion,
    Array,
    Hand,
    Scanner,
    compose,
    exponential,
    invert,
    namespace,
    nearest_rotation,
    rotation_vectors,
)
from jaxscan.leastsq import Fit, Group, Prior, fit
from jaxscan.observation import Observations


# First standard deviations of a pose [m, rad], and rounds in which they are learned.
_FIRST, _ROUNDS = (1e-3, 1e-3), 12
# Information that holds what is known.
_HELD = 1e16
# Less than this is nothing [m, rad].
_LEAST = (1e-7, 1e-7)
# Poses that the best camera misses by more are no poses of this hand [m, rad].
_MOST = (0.05, 0.1)
# A board of another size, or other poses, must fit this much better to be named; sizes nearer than this are one; and
# with fewer views a better fit may be chance.
_BETTER, _SIZES, _VIEWS = 0.5, 0.02, 4


def with_hand(
    calibration: Calibration, result: Adjustment, observations: Observations, first: AbstractMotion, *, held: bool
) -> Calibration:
    """The calibration of camera and sheets with the motion of the hand that carries them; call in 64 bit.

    Args:
        calibration: Solved with a pose of its own for each view.
        result: The solve.
        observations: With the given poses of the hand.
        first: First values; where they are `held`, only the scatter of the poses is learned.

    Raises:
        CalibrationError: If the poses are not those of the views.
    """
    problem, path = result.problem, np.asarray(observations.poses, np.float64)
    used, placement = np.flatnonzero(result.view_inlier & result.data.fixes_pose), observations.corners.placement
    # A board that was seen once says nothing of the hand.
    used = used[np.bincount(np.asarray(placement)[used])[np.asarray(placement)[used]] > 1]
    seen = np.asarray(result.linearised.view_poses)[used]
    given = path[np.round(np.asarray(observations.corners.angle)[used]).astype(int)]
    board = np.unique(np.asarray(placement)[used], return_inverse=True)[1]
    own = np.asarray(problem.placement)[used]
    check_poses(given, seen, board)
    twists = LOCAL_SCALE**2 * np.asarray(result.linearised.covariance.alone)[own, :6, :6]
    hand_cam = np.asarray(first.frame(), np.float64)
    boards = _first_boards(given @ hand_cam @ seen, board)
    to_hand = _adjoint(np.linalg.inv(given) @ boards[board])
    of_seen = to_hand @ twists @ np.swapaxes(to_hand, 1, 2)
    there, by_camera, half = _by_camera(calibration, result, observations.laser_names, own)
    by_camera = -to_hand @ by_camera
    free = half.shape[1]

    def solved(scatter: np.ndarray, camera: float) -> tuple[np.ndarray, Fit]:
        root = np.linalg.inv(np.linalg.cholesky(of_seen + np.diag(np.repeat(scatter**2, 3))))
        place = np.broadcast_to(hand_cam, seen.shape)
        group = Group(_misfit, (invert(given), np.linalg.inv(seen), boards[board], root, place, by_camera), block=board)
        prior = Prior(np.zeros(6 + free), np.diag(np.repeat([_HELD if held else 0.0, camera], [6, free])))
        return root, fit(np.zeros(6 + free), [group], blocks=np.zeros((len(boards), 6)), prior=prior)

    scatter = np.array(_FIRST)
    for _ in range(_ROUNDS):
        root, found = solved(scatter, 1.0)
        # Likeliest where residuals pull as much as they may; Rao and Kleffe, Estimation of variance components (1988).
        pull = np.square(np.swapaxes(root, 1, 2) @ found.residuals[0][..., None])[..., 0]
        left = 1.0 - np.mean(found.leverages[0])
        share = np.sum(np.square(root), axis=1) * max(left, 0.05)
        of_kind = lambda values: np.sum(values.reshape(-1, 2, 3), axis=(0, 2))
        before = scatter
        scatter = np.maximum(scatter * np.sqrt(of_kind(pull) / of_kind(share)), _LEAST)
        if np.allclose(scatter, before, rtol=0.02):
            break
    root, found = solved(scatter, _HELD)
    error = np.linalg.solve(root, found.residuals[0][..., None])[..., 0]
    square = np.mean(error.reshape(-1, 2, 3) ** 2, axis=(0, 2))
    if (np.sqrt(square) > _MOST).any():
        raise CalibrationError(
            f"The given poses miss the boards by {1e3 * np.sqrt(square[0]):.0f} mm and "
            f"{np.degrees(np.sqrt(square[1])):.1f} degrees, root mean square: check that a pose is that of its image, "
            "its units, the order of its numbers (`--pose-format`), and that records with the same `placement` saw the "
            "board unmoved."
        )
    motion, coordinates, parts = Hand(hand_cam, scatter, path), Hand.blocks[0].parameters, len(calibration.order)
    names, covariance = (*calibration.order, *coordinates), np.zeros((parts + 6, parts + 6))
    covariance[:parts, :parts] = calibration.covariance
    if not held:
        motion = motion.retract(found.shared[:6])
        # An error of the camera turns and shifts it as seen by all boards alike.
        slopes = np.zeros((len(used), 6, 6 + 6 * len(boards)))
        slopes[:, :, :6] = found.slopes[0][:, :, :6]
        for view, number in enumerate(board):
            slopes[view, :, 6 + 6 * number : 12 + 6 * number] = found.slopes[0][view, :, 6 + free :]
        changed = (root @ by_camera).reshape(-1, free)
        follow = -np.linalg.lstsq(slopes.reshape(-1, slopes.shape[-1]), changed, rcond=None)[0][:6]
        covariance[parts:, :parts] = follow @ np.linalg.pinv(half) @ calibration.covariance[there]
        covariance[:parts, parts:] = covariance[parts:, :parts].T
        covariance[parts:, parts:] = found.covariance.shared[:6, :6] + follow @ follow.T
    scanner = calibration.scanner
    if scanner is None:
        scanner = Scanner(calibration.camera, problem.lasers, motion, covariance, (), observations.up)
    scanner = replace(scanner, turntable=motion, covariance=covariance)
    return replace(calibration, scanner=scanner, order=names, covariance=covariance)


def check_poses(
    given: Float[np.ndarray, "views 4 4"], seen: Float[np.ndarray, "views 4 4"], board: Int[np.ndarray, " views"]
) -> None:
    """See that the mistakes that can be told from poses were not made.

    Args:
        given: Of the hand, T_base_hand.
        seen: Of the boards, T_cam_board.
        board: The board that each view shows.

    Raises:
        CalibrationError: If the poses are those of a hand that carries the board, or fit a board of another size.
    """
    if len(given) < _VIEWS:
        return
    found, other = (_closed_form(poses, seen, board) for poses in (given, np.linalg.inv(given)))
    if other.fits and other.angle < _BETTER * found.angle and other.resized < _BETTER * found.resized:
        raise CalibrationError(
            f"The given poses turn otherwise than the boards, by {np.degrees(found.angle):.2g} degrees, and fit to "
            f"{np.degrees(other.angle):.2g} degrees if the hand carried the board before a camera that stood still: "
            "give the inverse of every pose (those of the base, seen from the hand); the place that is then found is "
            "that of the camera in the robot's base, and points are those of the hand."
        )
    if found.fits and abs(found.size - 1.0) > _SIZES and found.resized < _BETTER * found.place:
        raise CalibrationError(
            f"The given poses fit a board that is {found.size:.3g} times as large as `[board]` says: to "
            f"{1e3 * found.resized:.2g} mm, and to {1e3 * found.place:.2g} mm as it is. Check its sizes in "
            "capture.toml (of a grid of circles, `spacing_mm` is the distance of the rows) and the unit of the poses "
            "(`--pose-unit`)."
        )


class _ClosedForm(NamedTuple):
    """How well given poses are those of a hand that carries the camera, root mean squares over pairs of views."""

    angle: float
    """Between turns of the hand and of the camera [rad]."""
    place: float
    """Between their ways [m] ..."""
    resized: float
    """... and between them if the board is so many times as large [m]:"""
    size: float

    @property
    def fits(self) -> bool:
        """Whether this is a hand, and a board of some size."""
        return self.angle < _MOST[1] and self.resized < _MOST[0] and self.size > 0


def _closed_form(given: np.ndarray, seen: np.ndarray, board: np.ndarray) -> _ClosedForm:
    """Solve $A X = X B$ as `Hand.of_boards` does, with the board as it is and of any size."""
    pairs = [(i, j) for i, j in itertools.combinations(range(len(board)), 2) if board[i] == board[j]]
    first, second = np.array(pairs).T
    hand, camera = np.linalg.inv(given[second]) @ given[first], seen[second] @ np.linalg.inv(seen[first])
    by_hand, by_camera = rotation_vectors(hand), rotation_vectors(camera)
    rotation = nearest_rotation(by_hand.T @ by_camera)
    off = by_hand - by_camera @ rotation.T
    left, way = (hand[:, :3, :3] - np.eye(3)).reshape(-1, 3), (camera[:, :3, 3] @ rotation.T).ravel()
    right, resized = -hand[:, :3, 3].ravel(), np.column_stack([left, -way])
    solved = np.linalg.lstsq(resized, right, rcond=None)[0]
    as_it_is = left @ np.linalg.lstsq(left, right + way, rcond=None)[0] - way
    size = lambda error: float(np.sqrt(np.mean(np.sum(error.reshape(-1, 3) ** 2, axis=1))))
    return _ClosedForm(size(off), size(as_it_is - right), size(resized @ solved - right), float(solved[3]))


def _by_camera(
    calibration: Calibration, result: Adjustment, lasers: Sequence[str], own: Int[np.ndarray, " views"]
) -> tuple[Int[np.ndarray, " parts"], Float[np.ndarray, "views 6 parts"], Float[np.ndarray, "parts parts"]]:
    """Which parts of the calibration boards see; how standard errors of these move the seen boards; their covariance's
    root."""
    every = list(layout_of(result.problem).names)
    for number, name in enumerate(lasers):
        every = [one.replace(f"laser.{number}.", f"laser.{name}.") for one in every]
    there = np.array([at for at, name in enumerate(calibration.order) if name in every], int)
    columns = [every.index(calibration.order[at]) for at in there]
    scales = np.asarray(result.problem.scales)[columns]
    moved = -LOCAL_SCALE * np.asarray(result.linearised.covariance.coupling)[own, :6][..., columns]
    spread, direction = np.linalg.eigh(np.asarray(calibration.covariance, np.float64)[np.ix_(there, there)])
    half = direction * np.sqrt(np.maximum(spread, 0.0))
    return there, moved / np.where(scales > 0, scales, np.inf) @ half, half


def _misfit(step: Array, own: Array, data: tuple[Array, ...]) -> Array:
    """Error of one given pose in standard deviations [6]; behind the twist are errors of the camera, likewise."""
    back, unseen, board, root, hand_cam, by_camera = data
    camera = compose(hand_cam, exponential(step[:6]))
    off = compose(compose(back, compose(board, exponential(own))), compose(unseen, invert(camera)))
    turned = off[:3, :3]
    # The rotation vector of a small turn.
    xp = namespace(off)
    rotation = 0.5 * xp.stack([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    return root @ (xp.concatenate([off[:3, 3], rotation]) + by_camera @ step[6:])


def _first_boards(
    poses: Float[np.ndarray, "views 4 4"], board: Int[np.ndarray, " views"]
) -> Float[np.ndarray, "b 4 4"]:
    """T_base_board of every placement: of its views the one in the middle."""
    found = []
    for number in range(int(board.max()) + 1):
        own = poses[board == number]
        away = np.linalg.norm(own[:, None, :3, 3] - own[None, :, :3, 3], axis=-1).sum(1)
        found.append(own[np.argmin(away)])
    return np.stack(found)


def _adjoint(pose: Float[np.ndarray, "views 4 4"]) -> Float[np.ndarray, "views 6 6"]:
    """Matrices that take twists from the frame b of poses T_ab to the frame a."""
    turn, at = pose[:, :3, :3], pose[:, :3, 3]
    adjoint = np.zeros((len(pose), 6, 6))
    adjoint[:, :3, :3] = adjoint[:, 3:, 3:] = turn
    adjoint[:, :3, 3:] = np.cross(at[:, None, :], np.swapaxes(turn, 1, 2)).swapaxes(1, 2)
    return adjoint
