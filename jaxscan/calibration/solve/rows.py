"""Errors of corners and stripe points, and their derivatives by the few numbers that each view shares.

Thousands of points share the numbers of one camera, one board's pose in one view, one sheet and
one board shape: the *departures* of a view. Derivatives by these are formed once per point; how
departures follow from the unknowns of the joint solve is a small matrix per view.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.calibration.solve.problem import Problem, Step, board_points, board_surface, camera_from_board, move
from jaxscan.geometry import AbstractCamera, Array, BowedBoard, LaserSheet, invert, transform


class Rows(NamedTuple):
    """Errors of one kind, and their derivatives by the departures of their view."""

    value: Float[Array, "owners rows"]
    slopes: Float[Array, "owners rows departures"]


class Departures(NamedTuple):
    """First-order departures from a point: zero in value, right in derivative."""

    corner: Float[Array, "views departures"]
    """Camera, pose of the board in the camera frame (translation, rotation; in board axes), board."""
    stripe: Float[Array, "stripes departures"]
    """The same with the board's heights alone; then normal, distance and bow of the sheet."""


def departures(step: Step, problem: Problem) -> Departures:
    """How the departures of every view and stripe follow from a step of the unknowns."""
    moved = move(step, problem)
    fixed = jax.lax.stop_gradient(moved)
    camera = moved.camera.parameters() - fixed.camera.parameters()
    board = moved.shape - fixed.shape
    poses = camera_from_board(moved)
    turn = jnp.matmul(jax.vmap(invert)(jax.lax.stop_gradient(poses)), poses)
    # Of a motion next to the identity, the twist is read off the matrix.
    twist = jnp.stack([turn[:, 0, 3], turn[:, 1, 3], turn[:, 2, 3], turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], 1)
    twist = twist - jax.lax.stop_gradient(twist)
    spread = lambda values, count: jnp.broadcast_to(values[None], (count, values.shape[0]))
    views, stripes = len(problem.corner_q), len(problem.stripe_q)
    corner = jnp.concatenate([spread(camera, views), twist, spread(board, views)], axis=1)
    sheets = _sheet_numbers(moved.lasers) - _sheet_numbers(fixed.lasers)
    sheet = sheets[problem.stripe_laser] if len(sheets) else jnp.zeros((stripes, 6), twist.dtype)
    heights = jnp.concatenate([board[:2], board[3 : 3 + len(problem.modes.height)]])
    stripe = jnp.concatenate([spread(camera, stripes), twist[problem.stripe_view], spread(heights, stripes), sheet], 1)
    return Departures(corner, stripe)


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

    predicted, slopes = jax.vmap(lambda pose: jax.vmap(lambda x, b: corner(pose, x, b))(points, by_shape_points))(
        camera_from_board(problem)
    )
    views = len(problem.corner_q)
    return Rows((predicted - problem.corner_q).reshape(views, -1), slopes.reshape(views, -1, slopes.shape[-1]))


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
        return Rows(empty[..., 0], empty), empty[..., :2]

    # Stripes say nothing of the pitch, which moves the bow by less than a thousandth of its height.
    board = board_surface(eqx.tree_at(lambda p: p.shape, problem, jnp.asarray(problem.shape).at[2].set(0.0)))

    def stripe(pose, laser, q):
        sheet = jax.tree.map(lambda leaf: leaf[laser], problem.lasers)
        return jax.vmap(lambda q: _stripe_row(problem, board, pose, sheet, q))(q)

    poses = camera_from_board(problem)[problem.stripe_view]
    value, slopes, by_q = jax.vmap(stripe)(poses, problem.stripe_laser, problem.stripe_q)
    return Rows(value, slopes), by_q


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
