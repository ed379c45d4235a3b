"""Where the camera sits on a hand whose poses are given, and how far these poses scatter.

Poses of a robot or a tracker err by more than boards do: a hundredth of a degree is as much as a corner's noise. So
camera and sheets are solved with a pose of its own for every view, and the given poses meet those of the views here:

$$\\exp(\\epsilon) = F^{-1}\\, Y\\, C^{-1} X^{-1},$$

with $F$ the given pose of the hand, $X$ the camera on it, $Y$ the board in the base and $C$ the board as the camera
saw it. The twist $\\epsilon$ is the error of the given pose, and of the seen one, whose covariance is known.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from jaxscan.calibration.adjust import Adjustment
from jaxscan.calibration.problem import LOCAL_SCALE, layout_of
from jaxscan.calibration.result import Calibration
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractMotion, Array, Hand, Scanner, compose, exponential, invert, namespace
from jaxscan.leastsq import Group, Prior, fit
from jaxscan.observation import Observations


# First standard deviations of a pose [m, rad], and rounds in which they are learned.
_FIRST, _ROUNDS = (1e-3, 1e-3), 6
# Information that holds the camera where it is known to sit.
_HELD = 1e16
# Less than this is nothing [m, rad].
_LEAST = (1e-7, 1e-7)
# Poses that the best camera misses by more are no poses of this hand [m, rad].
_MOST = (0.05, 0.1)


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
    used = np.flatnonzero(result.view_inlier & result.data.fixes_pose)
    seen = np.asarray(result.linearised.view_poses)[used]
    given = path[np.round(np.asarray(observations.corners.angle)[used]).astype(int)]
    board = np.unique(np.asarray(observations.corners.placement)[used], return_inverse=True)[1]
    twists = (
        LOCAL_SCALE**2 * np.asarray(result.linearised.covariance.alone)[np.asarray(problem.placement)[used], :6, :6]
    )
    hand_cam = np.asarray(first.frame(), np.float64)
    boards = _first_boards(given @ hand_cam @ seen, board)
    of_seen = _carried(np.linalg.inv(given) @ boards[board], twists)
    scatter = np.array(_FIRST)
    prior = Prior(np.zeros(6), _HELD * np.eye(6)) if held else None
    for _ in range(_ROUNDS):
        whole = of_seen + np.diag(np.repeat(scatter**2, 3))
        root = np.linalg.inv(np.linalg.cholesky(whole))
        data = (invert(given), np.linalg.inv(seen), boards[board], root, np.broadcast_to(hand_cam, seen.shape))
        group = Group(_misfit, data, block=board)
        found = fit(np.zeros(6), [group], blocks=np.zeros((len(boards), 6)), prior=prior)
        error = np.linalg.solve(root, found.residuals[0][..., None])[..., 0]
        left = 1.0 - np.mean(found.leverages[0])
        before, chance = scatter, np.mean(np.diagonal(of_seen, axis1=1, axis2=2).reshape(-1, 2, 3), axis=(0, 2))
        square = np.mean(error.reshape(-1, 2, 3) ** 2, axis=(0, 2)) / max(left, 0.05)
        scatter = np.sqrt(np.maximum(square - chance, np.square(_LEAST)))
        if np.allclose(scatter, before, rtol=0.02):
            break
    if (np.sqrt(square) > _MOST).any():
        raise CalibrationError(
            f"The given poses miss the boards by {1e3 * np.sqrt(square[0]):.0f} mm and "
            f"{np.degrees(np.sqrt(square[1])):.1f} degrees, root mean square: check that a pose is that of its image, "
            "its units, the order of its numbers (`--pose-format`), and that records with the same `placement` saw the "
            "board unmoved."
        )
    motion, own, parts = Hand(hand_cam, scatter, path), Hand.blocks[0].parameters, len(calibration.order)
    names, covariance = (*calibration.order, *own), np.zeros((parts + 6, parts + 6))
    covariance[:parts, :parts] = calibration.covariance
    if not held:
        motion = motion.retract(found.shared)
        # An error of the camera turns and shifts it as seen by all boards alike.
        every = layout_of(problem).names
        there = [at for at, name in enumerate(calibration.order) if name in every]
        columns = [every.index(calibration.order[at]) for at in there]
        moved = -np.asarray(result.linearised.covariance.coupling)[np.asarray(problem.placement)[used], :6][
            ..., columns
        ]
        scales = np.asarray(problem.scales)[columns]
        moved = LOCAL_SCALE * moved / np.where(scales > 0, scales, np.inf)
        changed = -root @ _adjoint(np.linalg.inv(given) @ boards[board]) @ moved
        slopes = np.zeros((len(used), 6, 6 + 6 * len(boards)))
        slopes[:, :, :6] = found.slopes[0][:, :, :6]
        for view, number in enumerate(board):
            slopes[view, :, 6 + 6 * number : 12 + 6 * number] = found.slopes[0][view, :, 6:]
        follow = -np.linalg.lstsq(slopes.reshape(-1, slopes.shape[-1]), changed.reshape(-1, len(columns)), rcond=None)[
            0
        ]
        cross = follow[:6] @ calibration.covariance[there]
        covariance[parts:, :parts], covariance[:parts, parts:] = cross, cross.T
        covariance[parts:, parts:] = found.covariance.shared + cross[:, there] @ follow[:6].T
    scanner = calibration.scanner
    if scanner is None:
        scanner = Scanner(calibration.camera, problem.lasers, motion, covariance, (), observations.up)
    scanner = replace(scanner, turntable=motion, covariance=covariance)
    return replace(calibration, scanner=scanner, order=names, covariance=covariance)


def _misfit(step: Array, own: Array, data: tuple[Array, ...]) -> Array:
    """Error of one given pose in standard deviations [6]."""
    back, unseen, board, root, hand_cam = data
    camera = compose(hand_cam, exponential(step))
    off = compose(compose(back, compose(board, exponential(own))), compose(unseen, invert(camera)))
    turned = off[:3, :3]
    # Of a small turn.
    xp = namespace(off)
    rotation = 0.5 * xp.stack([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    return root @ xp.concatenate([off[:3, 3], rotation])


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


def _carried(
    pose: Float[np.ndarray, "views 4 4"], covariance: Float[np.ndarray, "views 6 6"]
) -> Float[np.ndarray, "views 6 6"]:
    """Covariance of a twist in the frame a of poses T_ab, of one in the frame b."""
    adjoint = _adjoint(pose)
    return adjoint @ covariance @ np.swapaxes(adjoint, 1, 2)


def _adjoint(pose: Float[np.ndarray, "views 4 4"]) -> Float[np.ndarray, "views 6 6"]:
    turn, at = pose[:, :3, :3], pose[:, :3, 3]
    adjoint = np.zeros((len(pose), 6, 6))
    adjoint[:, :3, :3] = adjoint[:, 3:, 3:] = turn
    adjoint[:, :3, 3:] = np.cross(at[:, None, :], np.swapaxes(turn, 1, 2)).swapaxes(1, 2)
    return adjoint
