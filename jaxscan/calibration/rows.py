"""Errors of corners and stripe points, and their derivatives by the few numbers that each view shares.

Thousands of points share the numbers of one camera, one board's pose in one view, one sheet and
one board shape: the *departures* of a view. Derivatives by these are formed once per point; how
departures follow from the unknowns of the joint solve is a small matrix per view.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float

from jaxscan.calibration.problem import (
    LOCAL_SCALE,
    Problem,
    board_points,
    board_surface,
    camera_from_board,
    layout_of,
    move,
    zero_step,
)
from jaxscan.geometry import AbstractCamera, Array, BowedBoard, LaserSheet, invert, transform


# Stripes and views that are evaluated at once; padding is not evaluated.
_STRIPES, _VIEWS = 8, 24


class Rows(NamedTuple):
    """Errors of one kind, and their derivatives by the departures of their view."""

    value: Float[Array, "owners rows"]
    slopes: Float[Array, "owners rows departures"]
    square: Float[Array, "owners departures departures"]
    """S'S of the slopes over the standard deviations of their rows."""
    gradient: Float[Array, "owners departures"]
    """S'r of these and of the errors over the same."""


class Chains(NamedTuple):
    """Derivatives of the departures of every view and stripe by the shared scaled unknowns, then those of its
    placement: the board's pose and the stops."""

    corner: Float[Array, "views departures unknowns"]
    """Camera, pose of the board in the camera frame (translation, rotation; in board axes), board."""
    stripe: Float[Array, "stripes departures unknowns"]
    """The same with the board's heights alone; then normal, distance and bow of the sheet."""


def chains(problem: Problem) -> Chains:
    """How the departures follow the unknowns, in the frames of the point that the problem holds."""
    start = jnp.zeros_like(problem.scales)
    layout = layout_of(problem)

    def numbers(shared):
        moved = move(zero_step(problem)._replace(shared=shared), problem)
        return moved.camera.parameters(), moved.shape, _sheet_numbers(moved.lasers)

    def twist(shared, off):
        # The twist of a motion next to the identity is read off the matrix.
        motion = problem.turntable.retract(shared * problem.scales[layout.turntable])
        moved = eqx.tree_at(lambda p: (p.turntable, p.angle), problem, (motion, problem.angle + off))
        turn = jnp.matmul(jax.lax.stop_gradient(jax.vmap(invert)(camera_from_board(problem))), camera_from_board(moved))
        return jnp.stack([turn[:, 0, 3], turn[:, 1, 3], turn[:, 2, 3], turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], 1)

    camera, board, sheets = (
        jnp.pad(leaf, [(0, 0)] * (leaf.ndim - 1) + [(0, problem.own)]) for leaf in jax.jacfwd(numbers)(start)
    )
    views, stripes = len(problem.corner_q), len(problem.stripe_q)
    # The board's pose moves in its own frame.
    count, there = len(start), (start[layout.turntable], jnp.zeros_like(problem.angle))
    pose = jnp.zeros((views, 6, count + problem.own), start.dtype)
    pose = pose.at[:, :, count : count + 6].set(LOCAL_SCALE * jnp.eye(6))
    pose = pose.at[:, :, layout.turntable].set(jax.jacfwd(twist)(*there))
    by_angle = jax.jvp(lambda off: twist(there[0], off), there[1:], (jnp.ones_like(there[1]),))[1]
    pose = pose.at[:, :, count + 6 :].set(by_angle[:, :, None] * (problem.stop_sigma * problem.stop)[:, None, :])
    spread = lambda values, count: jnp.broadcast_to(values[None], (count, *values.shape))
    corner = jnp.concatenate([spread(camera, views), pose, spread(board, views)], axis=1)
    heights = jnp.concatenate([board[:2], board[3 : 3 + len(problem.modes.height)]])
    sheet = sheets[problem.stripe_laser] if len(sheets) else jnp.zeros((stripes, 6, count + problem.own), start.dtype)
    parts = spread(camera, stripes), pose[problem.stripe_view], spread(heights, stripes), sheet
    return Chains(corner, jnp.concatenate(parts, axis=1))


def _sheet_numbers(sheets: LaserSheet) -> Float[Array, "lasers 6"]:
    return jnp.concatenate([sheets.normal, jnp.asarray(sheets.distance)[:, None], sheets.bow], axis=1)


def corner_rows(problem: Problem) -> Rows:
    r"""Projected minus observed corners [px], $\pi(T X) - q$; rows are u and v of each corner.

    Source: the paper, equations (1)-(3).
    """
    camera, surface = problem.camera, BowedBoard(problem.frame, problem.shape[:3])
    points = board_points(problem)
    count = len(camera.parameter_names())

    def by_shape(flat, modes):
        lift = jnp.concatenate([jnp.zeros((2, 2), flat.dtype), surface.rise(flat[:2])[None]])
        return jnp.concatenate([lift, flat[:, None], modes], axis=1)

    by_shape_points = jax.vmap(by_shape)(jnp.asarray(problem.board), jnp.asarray(problem.modes.corner))

    def corner(pose, point, by_shape_point):
        p = transform(pose, point)
        project = lambda s, p: camera.retract(s).project(p)
        zero = jnp.zeros(count, point.dtype)
        by_camera, by_p = jax.jacfwd(project, argnums=(0, 1))(zero, p)
        turned = by_p @ pose[:3, :3]
        return camera.project(p), jnp.concatenate(
            [by_camera, turned, -turned @ _cross_matrix(point), turned @ by_shape_point], axis=1
        )

    def view(pose, q, weight):
        predicted, slopes = jax.vmap(lambda x, b: corner(pose, x, b))(points, by_shape_points)
        return _rows((predicted - q).ravel(), slopes.reshape(-1, slopes.shape[-1]), jnp.repeat(weight, 2))

    arrays = camera_from_board(problem), jnp.asarray(problem.corner_q), jnp.asarray(problem.corner_weight)
    return _in_parts(view, problem.view_used, arrays, _VIEWS)


def _rows(value: Array, slopes: Array, weight: Array) -> Rows:
    white = weight[:, None] * slopes
    return Rows(value, slopes, white.T @ white, white.T @ (weight * value))


def stripe_rows(problem: Problem) -> tuple[Rows, Float[Array, "stripes points 2"]]:
    r"""Distance e [m] of every stripe point, lifted to its board, from its sheet; and $\nabla_q e$ [m / px].

    With $P = \lambda r$ on the board's surface, whose normal there is $m$ (board frame), a motion of
    the board changes $\lambda$ by $(m \cdot v + (X \times m) \cdot \omega) / (R m \cdot r)$, and a
    turn of the ray by $-\lambda\, (R m \cdot \delta r) / (R m \cdot r)$.

    Source: the paper, equations (5)-(8).
    """
    count = len(problem.camera.parameter_names())
    if len(problem.lasers.distance) == 0:
        numbers = count + 14 + len(problem.modes.height)
        empty = jnp.zeros((*problem.stripe_q.shape[:2], numbers), problem.shape.dtype)
        square = jnp.zeros((len(empty), numbers, numbers), empty.dtype)
        return Rows(empty[..., 0], empty, square, square[..., 0]), empty[..., :2]

    # Stripes say nothing of the pitch, which moves the bow by less than a thousandth of its height.
    board = board_surface(eqx.tree_at(lambda p: p.shape, problem, jnp.asarray(problem.shape).at[2].set(0.0)))

    def stripe(pose, laser, q, weight):
        sheet = jax.tree.map(lambda leaf: leaf[laser], problem.lasers)
        value, slopes, by_q = jax.vmap(lambda q: _stripe_row(problem, board, pose, sheet, q))(q)
        return _rows(value, slopes, weight), by_q

    poses = camera_from_board(problem)[problem.stripe_view]
    arrays = problem.stripe_laser, problem.stripe_q, problem.stripe_weight
    return _in_parts(stripe, problem.stripe_used, (poses, *map(jnp.asarray, arrays)), _STRIPES)


def _in_parts(function: Callable[..., Any], there: Bool[Array, " owners"], arrays: tuple[Array, ...], most: int) -> Any:
    """A function of every owner, some at a time; 0 for owners that are not there, which cost next to nothing."""
    size = max((size for size in range(1, most + 1) if len(there) % size == 0), default=1)
    empty = jax.tree.map(lambda leaf: jnp.zeros((size, *leaf.shape), leaf.dtype), _shape_of_one(function, arrays))
    if not len(there):
        return jax.tree.map(lambda leaf: leaf[:0], empty)

    def some(part):
        there, arrays = part
        found = jax.lax.cond(jnp.any(there), lambda *arrays: jax.vmap(function)(*arrays), lambda *_: empty, *arrays)
        return jax.tree.map(lambda leaf: jnp.where(there.reshape(-1, *(1,) * (leaf.ndim - 1)), leaf, 0), found)

    parts = jax.tree.map(lambda leaf: leaf.reshape(-1, size, *leaf.shape[1:]), (jnp.asarray(there), arrays))
    return jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), jax.lax.map(some, parts))


def _shape_of_one(function: Callable[..., Any], arrays: tuple[Array, ...]) -> Any:
    return jax.eval_shape(function, *(jax.ShapeDtypeStruct(array.shape[1:], array.dtype) for array in arrays))


def _stripe_row(
    problem: Problem, board: BowedBoard, pose: Float[Array, "4 4"], sheet: LaserSheet, q: Float[Array, "2"]
) -> tuple[Float[Array, ""], Float[Array, " departures"], Float[Array, "2"]]:
    # Sums are written out: products of 3 x 3 matrices by the ten thousand are slow.
    camera, count = problem.camera, len(problem.camera.parameter_names())
    ray = camera.unproject(q)
    range_m, point = board.meet(pose, ray)
    normal = board.normal(point[:2])
    value, (by_sheet, by_point) = jax.value_and_grad(LaserSheet.offset, argnums=(0, 1))(sheet, range_m * ray)
    surface = pose[:3, 0] * normal[0] + pose[:3, 1] * normal[1] + pose[:3, 2] * normal[2]
    upright = _dot(surface, ray)
    along = _dot(by_point, ray) / jnp.where(upright == 0, 1.0, upright).astype(ray.dtype)
    by_ray = range_m * (by_point - along * surface)
    by_q = _by_pixel(camera, ray, by_ray)
    by_u, by_v = jax.jacfwd(lambda s: camera.retract(s).project(ray))(jnp.zeros(count, q.dtype))
    slopes = [
        # Implicit function theorem: where the pixel of a ray moves one way, the ray of a pixel moves back.
        -(by_q[0] * by_u + by_q[1] * by_v),
        along * normal,
        along * _cross(point, normal),
        along * board.rise(point[:2]),
        *([along * (problem.modes.height @ board.bends(point[:2]))] if len(problem.modes.height) else []),
        by_sheet.normal,
        by_sheet.distance[None],
        by_sheet.bow,
    ]
    return value, jnp.concatenate(slopes), by_q


def _by_pixel(camera: AbstractCamera, ray: Float[Array, "3"], by_ray: Float[Array, "3"]) -> Float[Array, "2"]:
    """Derivative by the pixel of something whose derivative by the ray is known."""
    # Branch-free tangents of a unit vector. Source: Duff et al., Building an orthonormal basis, revisited (2017).
    x, y, z = ray[0], ray[1], ray[2]
    sign = jnp.where(z >= 0, 1.0, -1.0).astype(ray.dtype)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = jnp.stack([1.0 + sign * x * x * a, sign * b, -sign * x])
    second = jnp.stack([b, sign + y * y * a, -y])
    _, by_first = jax.jvp(camera.project, (ray,), (first,))
    _, by_second = jax.jvp(camera.project, (ray,), (second,))
    det = by_first[0] * by_second[1] - by_second[0] * by_first[1]
    one, two = _dot(by_ray, first) / det, _dot(by_ray, second) / det
    return jnp.stack([one * by_second[1] - two * by_first[1], two * by_first[0] - one * by_second[0]])


def _dot(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, ""]:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "3"]:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _cross_matrix(p: Float[Array, "3"]) -> Float[Array, "3 3"]:
    zero = jnp.zeros_like(p[0])
    return jnp.stack([jnp.stack([zero, -p[2], p[1]]), jnp.stack([p[2], zero, -p[0]]), jnp.stack([-p[1], p[0], zero])])
