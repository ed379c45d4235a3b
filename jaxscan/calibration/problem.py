"""The joint problem: observations made ready, unknowns, weights, priors, scales."""

from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.settings import CalibrationSettings, board_blocks
from jaxscan.geometry import (
    AbstractCamera,
    AbstractMotion,
    Array,
    BowedBoard,
    LaserSheet,
    Layout,
    bend_functions,
    carrying,
    compose,
    corner_frame,
    exponential,
    fixes_plane,
    invert,
    make_layout,
    namespace,
    transform,
)
from jaxscan.leastsq import Unknowns
from jaxscan.observation import Observations


# Shapes are rounded up to these, few, so that captures of unlike sizes share a compilation, which costs
# more than many solves; the first are where the time of a solve begins to be more than overhead.
_VIEWS = (24, 72, 216, 648, 1944, 5832)
_POINTS = (64, 128, 256, 512, 1024, 2048, 4096)
_CORNERS = (96, 192, 384, 768, 1536)
_STOPS = (0, 12, 36, 108, 324)


class Prepared(NamedTuple):
    """Host arrays in float64; everything that is not valid is harmless."""

    size: tuple[int, int]
    """Width and height of the images [px]."""
    board: np.ndarray
    """Corners of the flat board [corners, 3]; padding repeats the first."""
    corner_q: np.ndarray
    corner_sigma: np.ndarray
    corner_valid: np.ndarray
    angle: np.ndarray
    placement: np.ndarray
    """Compact numbers 0 ... placements - 1; 0 for padding."""
    stop: np.ndarray
    """1 for the position of a view [views, stops] among those of its placement; 0 where that has one alone."""
    fixes_pose: np.ndarray
    """Views [views] with enough corners to fix a pose; the others are not valid anywhere."""
    stripe_q: np.ndarray
    stripe_sigma: np.ndarray
    stripe_valid: np.ndarray
    stripe_view: np.ndarray
    stripe_laser: np.ndarray
    stripe_contrast: np.ndarray
    """Contrast class of every stripe point, 0 for padding; see `StripeViews`."""


def prepare(observations: Observations) -> Prepared:
    """Drop unusable observations and pad views, stripes and points to the next bucket."""
    corners, stripes = observations.corners, observations.stripes
    board = np.asarray(observations.board.corners(), np.float64)
    centre = np.array([(observations.width - 1) / 2, (observations.height - 1) / 2])
    q, sigma, valid = _clean(corners.q, corners.sigma, corners.valid, centre)
    fixes_pose = np.array([fixes_plane(board[seen, :2]) for seen in valid], bool)
    valid &= fixes_pose[:, None]
    stripe_q, stripe_sigma, stripe_valid = _clean(stripes.q, stripes.sigma, stripes.valid, centre)
    view = np.asarray(stripes.view, np.int32)
    contrast = np.zeros(stripe_valid.shape, np.int8)
    if stripes.contrast is not None:
        # Used as an index, by points that are not valid too.
        contrast = np.where(stripe_valid, stripes.contrast, 0).astype(np.int8)
    if len(view) and len(fixes_pose):
        stripe_valid &= fixes_pose[view][:, None]
    placement = np.zeros(len(fixes_pose), np.int32)
    if fixes_pose.any():
        placement[fixes_pose] = np.unique(np.asarray(corners.placement)[fixes_pose], return_inverse=True)[1]
    angle = np.where(fixes_pose, np.asarray(corners.angle, np.float64), 0.0)
    stop = _stops(angle, placement, fixes_pose)
    views, rows = _bucket(len(fixes_pose), _VIEWS), _bucket(len(view), _VIEWS)
    points, count = _bucket(stripe_q.shape[1], _POINTS), _bucket(len(board), _CORNERS)
    return Prepared(
        size=(observations.width, observations.height),
        board=_pad(board, (count,), board[0]),
        corner_q=_pad(q, (views, count), centre),
        corner_sigma=_pad(sigma, (views, count), 1.0),
        corner_valid=_pad(valid, (views, count), False),
        angle=_pad(angle, (views,), 0.0),
        placement=_pad(placement, (views,), 0),
        stop=_pad(stop, (views,), 0.0),
        fixes_pose=_pad(fixes_pose, (views,), False),
        stripe_q=_pad(stripe_q, (rows, points), centre),
        stripe_sigma=_pad(stripe_sigma, (rows, points), 1.0),
        stripe_valid=_pad(stripe_valid, (rows, points), False),
        stripe_view=_pad(view, (rows,), 0),
        stripe_laser=_pad(np.asarray(stripes.laser, np.int32), (rows,), 0),
        stripe_contrast=_pad(contrast, (rows, points), 0),
    )


def _stops(angle: np.ndarray, placement: np.ndarray, fixes_pose: np.ndarray) -> np.ndarray:
    number, most = np.full(len(angle), -1), 0
    for one in np.unique(placement[fixes_pose]):
        views = np.flatnonzero(fixes_pose & (placement == one))
        positions, place = np.unique(angle[views], return_inverse=True)
        # The pose of a board that was seen from one position alone takes up any error of it.
        if len(positions) > 1:
            number[views], most = place, max(most, len(positions))
    return (number[:, None] == np.arange(_bucket(most, _STOPS))).astype(np.float64)


def _clean(q: Array, sigma: Array, valid: Array, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pixel, noise = np.asarray(q, np.float64), np.asarray(sigma, np.float64)
    good = np.asarray(valid, bool) & np.isfinite(pixel).all(-1) & np.isfinite(noise) & (noise > 0)
    # An entry that is not valid must not reach any arithmetic: 0 x NaN is NaN.
    return np.where(good[..., None], pixel, centre), np.where(good, noise, 1.0), good


def _bucket(count: int, sizes: tuple[int, ...]) -> int:
    return next((size for size in sizes if size >= count), count)


def _pad(array: np.ndarray, shape: tuple[int, ...], fill: np.ndarray | float | int) -> np.ndarray:
    padded = np.empty(shape + array.shape[len(shape) :], array.dtype)
    padded[...] = fill
    padded[tuple(slice(0, n) for n in array.shape[: len(shape)])] = array
    return padded


# Stops that are as good as exact: a millionth of a metre at 10 m [rad or m].
LEAST_STOP_SIGMA = 1e-7


LOCAL_SCALE = 1e-2
"""Unit of a board's pose steps [m, rad]."""


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
    """Commanded position of the motion: an observation like any other [rad or m]."""
    stop: Float[Array, "views stops"]
    """1 for the stop of each view among those of its placement; 0 where only the pose of the board shows it."""
    stop_sigma: Float[Array, ""]
    """Standard deviation of a stop about its position [rad or m]."""
    placement: Int[Array, " views"]
    view_used: Bool[Array, " views"]
    """Views with corners; the others are padding, and nothing is evaluated for them."""
    stripe_q: Float[Array, "stripes points 2"]
    stripe_weight: Float[Array, "stripes points"]
    """1 / (|grad_q e| sigma) [1 / m]."""
    stripe_view: Int[Array, " stripes"]
    stripe_laser: Int[Array, " stripes"]
    stripe_used: Bool[Array, " stripes"]
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
    return replace(
        problem,
        camera=problem.camera.retract(shared[layout.camera]),
        lasers=problem.lasers.retract(shared[layout.lasers].reshape(-1, 5)),
        turntable=problem.turntable.retract(shared[layout.turntable]),
        poses=move_poses(problem.poses, step.local[:, :6]),
        stops=problem.stops + step.local[:, 6:],
        shape=problem.shape + shared[layout.board],
    )


def move_poses(poses: Float[Array, "*n 4 4"], steps: Float[Array, "*n 6"]) -> Float[Array, "*n 4 4"]:
    """T_cam0_board moved by scaled steps (translation, rotation) in the boards' own frames."""
    return compose(poses, exponential(LOCAL_SCALE * steps))


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
    """Where all corners should be seen [px]; values of a view without corners have no meaning."""
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
        data: The result of `prepare`.
        settings: Free blocks and priors.
    """
    layout = problem_layout(camera, lasers, motion)
    centre = {"cx": (data.size[0] - 1) / 2, "cy": (data.size[1] - 1) / 2}
    return Problem(
        # A problem of its own for each size would be compiled again for each.
        camera=camera.without_size(),
        lasers=lasers,
        turntable=carrying(motion, "scanner"),
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
        view_used=np.any(data.corner_valid, axis=1),
        stripe_q=data.stripe_q,
        stripe_weight=np.zeros(data.stripe_valid.shape),
        stripe_view=data.stripe_view,
        stripe_laser=data.stripe_laser,
        stripe_used=np.any(data.stripe_valid, axis=1),
    )


def used_stops(problem: Problem) -> Bool[np.ndarray, "placements stops"]:
    """Which of the unknown stops exist."""
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
