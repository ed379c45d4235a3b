"""The joint problem: unknowns, observations and their weights, priors, scales."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.parameters import board_blocks, move_poses
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.calibration.solve.prepare import Prepared
from jaxscan.geometry import (
    AbstractCamera,
    AbstractMotion,
    Array,
    BowedBoard,
    LaserSheet,
    Layout,
    bend_functions,
    compose,
    corner_frame,
    invert,
    make_layout,
    namespace,
    transform,
)
from jaxscan.leastsq import Unknowns


# Stops that are as good as exact: a millionth of a metre at 10 m [rad or m].
LEAST_STOP_SIGMA = 1e-7


class BoardModes(eqx.Module):
    """Departures of a board from a parabola whose sizes may be unknowns, each of the size that its prior expects."""

    corner: Float[Array, "corners 3 modes"]
    """Displacement of every corner by one unit of each mode [m]."""
    height: Float[Array, "heights functions"]
    """Coefficients of `bend_functions` for the first modes, which are heights between the corners too [m]."""


def no_modes(corners: int) -> BoardModes:
    """A board that is a parabola."""
    return BoardModes(np.zeros((corners, 3, 0)), np.zeros((0, 0)))


class Problem(eqx.Module):
    """Observations, weights, and the point from which steps are counted; arrays only.

    All padding has weight 0. A weight is 1 over the standard deviation that the residual is
    divided by, so a change of weights never recompiles anything.
    """

    camera: AbstractCamera
    lasers: LaserSheet
    """All sheets stacked; of length 0 where none is sought."""
    turntable: AbstractMotion
    """The motion between the views of a placement; `Still` where every view is a placement of its own."""
    poses: Float[Array, "placements 4 4"]
    """T_cam0_board of every placement."""
    stops: Float[Array, "placements stops"]
    """How far the motion stood from the positions of a placement's records, in standard deviations [1]."""
    shape: Float[Array, " numbers"]
    """Height kx, ky [m] of the board's bow along its x and y (z into the board), the relative error
    of its pitch [1], and sizes of the modes [1]."""
    scales: Float[Array, " shared"]
    expected: Float[Array, " shared"]
    """Expected value of each shared unknown before any image, in the terms of `shared_values`."""
    prior_weight: Float[Array, " shared"]
    board: Float[Array, "corners 3"]
    """Corners of the flat board [m]."""
    frame: Float[Array, "4"]
    """Centre x, y and half extents in x, y of the corner grid [m]."""
    modes: BoardModes
    """The modes of the board's shape; none for a board that is a parabola."""
    corner_q: Float[Array, "views corners 2"]
    corner_weight: Float[Array, "views corners"]
    """1 / sigma [1 / px]."""
    angle: Float[Array, " views"]
    """Where the motion was told to stand: an observation like any other [rad or m]."""
    stop: Float[Array, "views stops"]
    """1 for the stop of each view among those of its placement; 0 where the pose of the board alone tells it."""
    stop_sigma: Float[Array, ""]
    """Standard deviation of a stop about its position [rad or m]."""
    placement: Int[Array, " views"]
    seen: Bool[Array, " views"]
    """Views with corners; the others are padding, and nothing is evaluated for them."""
    stripe_q: Float[Array, "stripes points 2"]
    stripe_weight: Float[Array, "stripes points"]
    """1 / (|grad_q e| sigma) [1 / m]."""
    stripe_view: Int[Array, " stripes"]
    stripe_laser: Int[Array, " stripes"]
    lit: Bool[Array, " stripes"]
    """Stripes with points; the others are padding, and nothing is evaluated for them."""

    @property
    def own(self) -> int:
        """Unknowns of a placement: the pose of its board, and its stops."""
        return 6 + self.stops.shape[1]

    @property
    def stood(self) -> Float[Array, " views"]:
        """Where the motion stood [rad or m]."""
        return self.angle + self.stop_sigma * (self.stop * namespace(self).asarray(self.stops)[self.placement]).sum(-1)

    def stripe_placement(self) -> Int[Array, " stripes"]:
        """The placement whose board each stripe lies on."""
        return self.placement[self.stripe_view]


def problem_layout(camera: AbstractCamera, lasers: LaserSheet, motion: AbstractMotion, modes: int = 0) -> Layout:
    """Where the shared unknowns of each part stand; `lasers` are stacked, and their names do not matter."""
    names = tuple(map(str, range(len(lasers.distance))))
    return make_layout(camera, names, motion=motion.blocks, board=board_blocks(modes))


def layout_of(problem: Problem) -> Layout:
    """Where the shared unknowns of a problem stand."""
    return problem_layout(problem.camera, problem.lasers, problem.turntable, problem.modes.corner.shape[-1])


def zero_step(problem: Problem) -> Unknowns:
    """No step, in the shapes of the problem."""
    return Unknowns(jnp.zeros_like(problem.scales), jnp.zeros((len(problem.poses), problem.own), problem.scales.dtype))


def move(step: Unknowns, problem: Problem) -> Problem:
    """The same problem seen from the point that a step in scaled units leads to, poses in the boards' own frames."""
    shared = step.shared * problem.scales
    layout = layout_of(problem)
    moved = (
        problem.camera.retract(shared[layout.camera]),
        problem.lasers.retract(shared[layout.lasers].reshape(-1, 5)),
        problem.turntable.retract(shared[layout.turntable]),
        move_poses(problem.poses, step.local[:, :6]),
        problem.stops + step.local[:, 6:],
        problem.shape + shared[layout.board],
    )
    return eqx.tree_at(moving, problem, moved)


def moving(problem: Problem) -> Any:
    """All that a step moves."""
    return problem.camera, problem.lasers, problem.turntable, problem.poses, problem.stops, problem.shape


def with_stop_sigma(problem: Problem, sigma: float) -> Problem:
    """The same problem at the same point, with another standard deviation of stops."""
    return replace(problem, stops=problem.stops * problem.stop_sigma / sigma, stop_sigma=np.asarray(sigma))


def camera_from_board(problem: Problem) -> Float[Array, "views 4 4"]:
    """T_cam(phi)_board of every view."""
    back = invert(problem.turntable.motion(problem.stood))
    return compose(back, namespace(problem).asarray(problem.poses)[problem.placement])


def board_points(problem: Problem) -> Float[Array, "corners 3"]:
    """Corners of the board as it is: of its true pitch, bowed, and shaped by its modes [m]."""
    xp = namespace(problem)
    parabola = BowedBoard(problem.frame, problem.shape[:3])
    points = parabola.point(xp.asarray(problem.board)[:, :2])
    return points + xp.asarray(problem.modes.corner) @ xp.asarray(problem.shape[3:])


def corner_pixels(problem: Problem) -> Float[Array, "views corners 2"]:
    """Where all corners should be seen [px]; of an array at the place of a view without corners nothing is promised."""
    points, poses = board_points(problem), camera_from_board(problem)
    return problem.camera.project(transform(poses[:, None], points[None]))


def bend_of(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the bend [functions], and places of the corners beside the bent surface [corners, 3], m."""
    modes, sizes, board = problem.modes, np.asarray(problem.shape)[3:], np.asarray(problem.board)
    if not len(modes.height):
        return np.zeros(0), np.zeros((0, 3))
    bend = sizes[: len(modes.height)] @ modes.height
    offset = modes.corner @ sizes
    frame = np.asarray(problem.frame)
    offset[:, 2] -= np.stack(bend_functions((board[:, :2] - frame[:2]) / frame[2:]), axis=-1) @ bend
    return np.asarray(bend), np.asarray(offset)


def board_surface(problem: Problem) -> BowedBoard:
    """The surface of the board between its corners."""
    heights = problem.modes.height
    return BowedBoard(problem.frame, problem.shape[:3], problem.shape[3 : 3 + len(heights)] @ heights)


def shared_values(problem: Problem) -> Float[Array, " shared"]:
    """The values that priors speak of, one per shared unknown.

    Those of the minimal coordinates; for fx the aspect fx / fy, for the gain its size, and 0
    for directions, points and distances, of which nothing is known beforehand.
    """
    bow = jnp.asarray(problem.lasers.bow)
    parts = [problem.camera.prior_values(), jnp.pad(bow, ((0, 0), (3, 0))).ravel()]
    return jnp.concatenate([*parts, problem.turntable.prior_values(), jnp.asarray(problem.shape)])


def make_problem(
    camera: AbstractCamera,
    lasers: LaserSheet,
    motion: AbstractMotion,
    poses: np.ndarray,
    data: Prepared,
    settings: CalibrationSettings,
) -> Problem:
    """The least-squares problem of these observations, seen from first values; its weights are still 0.

    Args:
        camera: First camera.
        lasers: First sheets, stacked, perhaps none.
        motion: First motion between the records; `Still` where every view has a pose of its own.
        poses: T_cam0_board of every placement, as many as views [views, 4, 4].
        data: Of `prepare`.
        settings: Free blocks and priors.
    """
    layout = problem_layout(camera, lasers, motion)
    centre = {"cx": (data.size[0] - 1) / 2, "cy": (data.size[1] - 1) / 2}
    return Problem(
        # A problem of its own for each size would be compiled again for each.
        camera=camera.without_size(),
        lasers=lasers,
        turntable=motion.carrying("scanner"),
        poses=poses,
        stops=np.zeros((len(poses), data.stop.shape[1])),
        shape=np.zeros(3),
        scales=parameter_scales(layout, settings.free),
        expected=np.array([centre.get(name, block.expected) for name, block in zip(*layout[:2], strict=True)]),
        prior_weight=prior_weights(layout, settings),
        board=data.board,
        frame=corner_frame(data.board),
        modes=no_modes(len(data.board)),
        corner_q=data.corner_q,
        corner_weight=np.zeros(data.corner_valid.shape),
        angle=data.angle,
        stop=data.stop,
        stop_sigma=np.asarray(settings.angle_sigma or LEAST_STOP_SIGMA),
        placement=data.placement,
        seen=np.any(data.corner_valid, axis=1),
        stripe_q=data.stripe_q,
        stripe_weight=np.zeros(data.stripe_valid.shape),
        stripe_view=data.stripe_view,
        stripe_laser=data.stripe_laser,
        lit=np.any(data.stripe_valid, axis=1),
    )


def used_stops(problem: Problem) -> Bool[np.ndarray, "placements stops"]:
    """Which of the unknown stops there are."""
    used, (view, stop) = np.zeros(np.shape(problem.stops), bool), np.nonzero(problem.stop)
    used[np.asarray(problem.placement)[view], stop] = True
    return used


def with_modes(problem: Problem, modes: BoardModes, settings: CalibrationSettings) -> Problem:
    """The same problem with more modes of the board's shape, which begin at 0; modes that move nothing are held."""
    layout = problem_layout(problem.camera, problem.lasers, problem.turntable, modes.corner.shape[-1])
    count = layout.board.start + 3
    there = np.concatenate([np.ones(count), np.any(modes.corner != 0, axis=(0, 1))])
    expected = np.zeros(len(there))
    expected[:count] = problem.expected[:count]
    return replace(
        problem,
        shape=np.pad(np.asarray(problem.shape), (0, len(there) - count + 3 - len(problem.shape))),
        scales=parameter_scales(layout, settings.free) * there,
        expected=expected,
        prior_weight=prior_weights(layout, settings) * there,
        modes=modes,
    )


def parameter_scales(layout: Layout, free: tuple[str, ...]) -> np.ndarray:
    """Size of one scaled unit of each shared unknown [px, 1, rad, m]; 0 where it is held.

    The damping is scale-invariant; the scales make tolerances mean the same for all.
    """
    return np.array([block.scale * (block.name in free) for block in layout.blocks])


def prior_weights(layout: Layout, settings: CalibrationSettings) -> np.ndarray:
    """1 / standard deviation of every prior; 0 where there is none, and for unknowns that are held."""
    return np.array(
        [(block.name in settings.free) / settings.priors.get(block.prior, block.sigma) for block in layout.blocks]
    )
