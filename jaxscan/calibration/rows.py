"""Errors of corners and stripe points, and their derivatives by the few numbers that each view shares.

Thousands of points share the numbers of one camera, one board's pose in one view, one sheet and
one board shape: the *departures* of a view. Derivatives by these are formed once per point; how
departures follow from the unknowns of the joint solve is a small matrix per view.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float

from jaxscan.calibration.problem import Problem, Step, board_points, camera_from_board, move, warp_height
from jaxscan.geometry import AbstractCamera, Array, LaserSheet, invert, transform
from jaxscan.geometry.tangent import tangent_basis


_RAY_ITERATIONS = 3


class Rows(NamedTuple):
    """Errors of one kind, and their derivatives by the departures of their view."""

    value: Float[Array, "owners rows"]
    slopes: Float[Array, "owners rows departures"]


class Departures(NamedTuple):
    """First-order departures from a point: zero in value, right in derivative."""

    corner: Float[Array, "views departures"]
    """Camera, pose of the board in the camera frame (translation, rotation; in board axes), board."""
    stripe: Float[Array, "stripes departures"]
    """The same without the board's pitch; then normal, distance and bow of the sheet."""


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
    stripe = [spread(camera, stripes), twist[problem.stripe_view], spread(board[:2], stripes)]
    stripe.append(sheets[problem.stripe_laser] if len(sheets) else jnp.zeros((stripes, 6), twist.dtype))
    return Departures(corner, jnp.concatenate(stripe, axis=1))


def _sheet_numbers(sheets: LaserSheet) -> Float[Array, "lasers 6"]:
    return jnp.concatenate([sheets.normal, jnp.asarray(sheets.distance)[:, None], sheets.bow], axis=1)


def corner_rows(problem: Problem) -> Rows:
    r"""Projected minus observed corners [px], $\pi(T X) - q$; rows are u and v of each corner.

    Source: PAPER.md equations (1), (2), (4).
    """
    camera, frame, shape = problem.camera, problem.frame, problem.shape
    points = board_points(problem)
    count = len(camera.parameter_names())

    def by_shape(flat):
        a, b = (flat[0] - frame[0]) / frame[2], (flat[1] - frame[1]) / frame[3]
        rise = jnp.stack([1.0 - a * a, 1.0 - b * b])
        lift = jnp.concatenate([jnp.zeros((2, 2), flat.dtype), rise[None]])
        return jnp.concatenate([lift, flat[:, None]], axis=1)

    by_shape_points = jax.vmap(by_shape)(jnp.asarray(problem.board))

    def corner(pose, point, by_shape_point):
        p = transform(pose, point)
        project = lambda s, p: camera.retract(s).project(p)
        zero = jnp.zeros(count, shape.dtype)
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


def stripe_rows(problem: Problem) -> tuple[Rows, Float[Array, "stripes points"]]:
    r"""Distance e [m] of every stripe point, lifted to its board, from its sheet; and $|\nabla_q e|$ [m / px].

    Source: PAPER.md equations (5)-(8).
    """
    camera, frame = problem.camera, problem.frame
    count = len(camera.parameter_names())

    def one(pose, sheet, q, ray):
        ray, by_pixel = refine_ray(camera, q, ray)
        value, (by_pose, by_sheet, by_shape, by_ray) = jax.value_and_grad(_offset, argnums=(1, 2, 3, 4))(
            frame, pose[:3], sheet, problem.shape, ray
        )
        # Implicit function theorem: where the pixel of a ray moves one way, the ray of a pixel moves back.
        by_q = by_ray @ by_pixel
        moved = jax.jacfwd(lambda s: camera.retract(s).project(ray))(jnp.zeros(count, q.dtype))
        turned = pose[:3, :3].T @ by_pose
        rotation = turned[:, :3]
        twist = jnp.stack(
            [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
        )
        sheet_slopes = jnp.concatenate([by_sheet.normal, by_sheet.distance[None], by_sheet.bow])
        slopes = jnp.concatenate([-by_q @ moved, turned[:, 3], twist, by_shape[:2], sheet_slopes])
        return value, slopes, jnp.linalg.norm(by_q)

    def stripe(pose, laser, q, ray):
        sheet = jax.tree.map(lambda leaf: leaf[laser], problem.lasers)
        return jax.vmap(lambda q, ray: one(pose, sheet, q, ray))(q, ray)

    poses = camera_from_board(problem)
    if len(problem.lasers.distance) == 0:
        shape = problem.stripe_q.shape[:2]
        empty = jnp.zeros((*shape, count + 14), problem.shape.dtype)
        return Rows(empty[..., 0], empty), empty[..., 0]
    value, slopes, worth = jax.vmap(stripe)(
        poses[problem.stripe_view], problem.stripe_laser, problem.stripe_q, problem.stripe_ray
    )
    return Rows(value, slopes), worth


def stripe_rays(camera: AbstractCamera, q: Float[Array, "stripes points 2"]) -> Float[Array, "stripes points 3"]:
    """Rays of stripe points, for `Problem.stripe_ray`."""
    return jax.vmap(jax.vmap(camera.unproject))(jnp.asarray(q))


def refine_ray(
    camera: AbstractCamera, q: Float[Array, "2"], ray: Float[Array, "3"]
) -> tuple[Float[Array, "3"], Float[Array, "3 2"]]:
    """The unit ray of a pixel by Newton's method from a near one, and its derivative by the pixel.

    Three steps from a start that is right to a few hundredths of a radian reach 1e-10 px.
    """

    def slope(ray):
        basis = tangent_basis(ray)
        project = lambda t: camera.project(ray + t @ basis)
        seen, by_u = jax.jvp(project, (jnp.zeros_like(q),), (jnp.zeros_like(q).at[0].set(1.0),))
        _, by_v = jax.jvp(project, (jnp.zeros_like(q),), (jnp.zeros_like(q).at[1].set(1.0),))
        det = by_u[0] * by_v[1] - by_v[0] * by_u[1]
        inverse = jnp.stack([jnp.stack([by_v[1], -by_v[0]]), jnp.stack([-by_u[1], by_u[0]])]) / det
        return seen, basis.T @ inverse

    for _ in range(_RAY_ITERATIONS):
        seen, by_pixel = slope(ray)
        ray = ray + by_pixel @ (q - seen)
        ray = ray / jnp.linalg.norm(ray)
    return ray, slope(ray)[1]


def _offset(
    frame: Float[Array, "4"],
    pose: Float[Array, "3 4"],
    sheet: LaserSheet,
    shape: Float[Array, "3"],
    ray: Float[Array, "3"],
) -> Float[Array, ""]:
    rotation, origin = pose[:, :3], -pose[:, :3].T @ pose[:, 3]
    direction = rotation.T @ ray
    # A harmless 1 where the ray runs along the board; such a point has no meaning anyway.
    along_z = jnp.where(direction[2] == 0, 1.0, direction[2]).astype(ray.dtype)
    range_m = -origin[2] / along_z
    # Every round leaves the slope of the bow, less than a hundredth, of the error before.
    for _ in range(3):
        p = origin + range_m * direction
        range_m = (warp_height(frame, shape, p[0], p[1]) - origin[2]) / along_z
    return sheet.offset(range_m * ray)


def _cross_matrix(p: Float[Array, "3"]) -> Float[Array, "3 3"]:
    zero = jnp.zeros_like(p[0])
    return jnp.stack([jnp.stack([zero, -p[2], p[1]]), jnp.stack([p[2], zero, -p[0]]), jnp.stack([-p[1], p[0], zero])])
