"""The joint problem and its whitened residuals: corners, stripes on boards, weak priors."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Float, Int

from jaxscan.calibration.parameters import move_pose
from jaxscan.geometry import AbstractCamera, Array, LaserSheet, Pinhole, Scanner, invert, transform
from jaxscan.geometry.tangent import tangent_basis


class Problem(eqx.Module):
    """Observations, weights, and the point from which steps are counted; arrays only.

    All padding has weight 0. A weight is 1 over the standard deviation that the residual is
    divided by, so a change of weights never recompiles anything.
    """

    scanner: Scanner
    poses: Float[Array, "placements 4 4"]
    """T_cam0_board of every placement."""
    warp: Float[Array, "2"]
    """Height kx, ky [m] of the board's bow along its x and y (z into the board)."""
    scales: Float[Array, " shared"]
    board: Float[Array, "corners 3"]
    """Corners of the flat board [m]."""
    frame: Float[Array, "4"]
    """Centre x, y and half extents in x, y of the corner grid [m]."""
    centre: Float[Array, "2"]
    """Centre of the image [px], about which the principal point is expected."""
    corner_q: Float[Array, "views corners 2"]
    corner_weight: Float[Array, "views corners"]
    """1 / sigma [1 / px]."""
    angle: Float[Array, " views"]
    placement: Int[Array, " views"]
    stripe_q: Float[Array, "stripes points 2"]
    stripe_weight: Float[Array, "stripes points"]
    """1 / (|grad_q e| sigma) [1 / m]."""
    stripe_view: Int[Array, " stripes"]
    stripe_laser: Int[Array, " stripes"]
    prior_weight: Float[Array, " priors"]


class Step(NamedTuple):
    """A step from the point that `Problem` holds, in scaled units."""

    shared: Float[Array, " shared"]
    local: Float[Array, "placements 6"]


class Residuals(NamedTuple):
    """Whitened residuals; corners and stripes lead with the axis of their view or stripe."""

    corner: Float[Array, "views corners 2"]
    stripe: Float[Array, "stripes points"]
    prior: Float[Array, " priors"]


class Measured(NamedTuple):
    """Residuals in the units they come in."""

    corner: Float[Array, "views corners 2"]
    """Projected minus observed corner [px]."""
    offset: Float[Array, "stripes points"]
    """Distance e of a stripe point, lifted to its board, from its sheet [m]."""
    slope: Float[Array, "stripes points"]
    """|grad_q e|: what one pixel across the stripe is worth [m / px]."""


def residuals(step: Step, problem: Problem) -> Residuals:
    r"""All residuals, each in standard deviations.

    Corner: $(\pi(T_\varphi^{-1} T_b X) - q) / \sigma$. Stripe: the Sampson error
    $e / (\|\nabla_q e\| \sigma)$ with $e$ the distance from the laser sheet of the point where
    the ray of $q$ meets the board; it stays a pixel error at all ranges. Its gradient is part of
    the weight, and so constant during a solve.

    Source: PAPER.md equations (5)-(8) and (10), made one problem.
    """
    return measure(step, problem)[0]


def measure(step: Step, problem: Problem) -> tuple[Residuals, Measured]:
    """`residuals`, and the same before whitening, without derivatives."""
    moved = move(step, problem)
    poses = camera_from_board(moved)
    board = warped_board(moved)
    predicted = jax.vmap(lambda pose: jax.vmap(lambda p: moved.scanner.camera.project(transform(pose, p)))(board))(
        poses
    )
    camera_step = (step.shared * problem.scales)[: len(moved.scanner.camera.parameter_names())]
    corner = predicted - problem.corner_q
    offset, slope = stripe_offsets(moved, poses, camera_step)
    whitened = Residuals(
        corner * problem.corner_weight[:, :, None],
        offset * problem.stripe_weight,
        priors(moved) * problem.prior_weight,
    )
    return whitened, Measured(*jax.lax.stop_gradient((corner, offset, slope)))


def move(step: Step, problem: Problem) -> Problem:
    """The same problem seen from the point that `step` leads to."""
    shared = step.shared * problem.scales
    scanner = problem.scanner.retract(shared[:-2])
    poses = jax.vmap(move_pose)(problem.poses, step.local)
    return eqx.tree_at(lambda p: (p.scanner, p.poses, p.warp), problem, (scanner, poses, problem.warp + shared[-2:]))


def camera_from_board(problem: Problem) -> Float[Array, "views 4 4"]:
    """T_cam(phi)_board of every view."""

    def view(angle, placement):
        return invert(problem.scanner.turntable.motion(angle)) @ problem.poses[placement]

    return jax.vmap(view)(problem.angle, problem.placement)


def warped_board(problem: Problem) -> Float[Array, "corners 3"]:
    """Corners of the board with its bow [m]."""
    height = jax.vmap(lambda x: warp_height(problem.frame, problem.warp, x[0], x[1]))(problem.board)
    return problem.board + height[:, None] * jnp.array([[0.0, 0.0, 1.0]], problem.board.dtype)


def warp_height(
    frame: Float[Array, "4"], warp: Float[Array, "2"], x: Float[Array, ""], y: Float[Array, ""]
) -> Float[Array, ""]:
    """z of the bowed board at (x, y): kx (1 - x'^2) + ky (1 - y'^2), with x' = +-1 at the outer corners.

    Source: mrcal's `calobject_warp`.
    """
    centre_x, centre_y, half_x, half_y = (frame[i] for i in range(4))
    a, b = (x - centre_x) / half_x, (y - centre_y) / half_y
    return warp[0] * (1.0 - a * a) + warp[1] * (1.0 - b * b)


def stripe_offsets(
    problem: Problem, poses: Float[Array, "views 4 4"], camera_step: Float[Array, " camera"]
) -> tuple[Float[Array, "stripes points"], Float[Array, "stripes points"]]:
    """Distance e of every stripe point, lifted to its board, from its sheet; and |grad_q e|.

    Thousands of points share the few numbers of a board's pose, a sheet and a camera. So the
    derivative by those numbers is formed once per linearisation, and each direction of the
    Jacobian costs one small matrix product: a third of the time of plain forward mode.

    Returns:
        offset: e [m].
        slope: What one pixel across the stripe is worth [m / px]; without a derivative.
    """
    camera, sheets = jax.lax.stop_gradient((problem.scanner.camera, problem.scanner.lasers))
    camera_moved = camera_step - jax.lax.stop_gradient(camera_step)

    def stripe(q, view, laser):
        basis = sheets.basis[laser]
        sheet = problem.scanner.laser(laser)
        shared, unravel = ravel_pytree((poses[view], sheet.normal, sheet.distance, sheet.bow, problem.warp))
        fixed = jax.lax.stop_gradient(shared)

        def offset(shared, ray):
            pose, normal, distance, bow, warp = unravel(shared)
            return _offset(problem.frame, pose, LaserSheet(normal, distance, bow, basis), warp, ray)

        def one(q):
            ray, by_camera, by_pixel = _ray_and_slopes(camera, len(camera_step), q)
            value, (by_shared, by_ray) = jax.value_and_grad(offset, argnums=(0, 1))(fixed, ray)
            return value, by_shared, by_ray @ by_camera, jnp.linalg.norm(by_ray @ by_pixel)

        value, by_shared, by_camera, slope = jax.lax.stop_gradient(jax.vmap(one)(q))
        return value + by_shared @ (shared - fixed) + by_camera @ camera_moved, slope

    return jax.vmap(stripe)(problem.stripe_q, problem.stripe_view, problem.stripe_laser)


def _offset(
    frame: Float[Array, "4"],
    pose: Float[Array, "4 4"],
    sheet: LaserSheet,
    warp: Float[Array, "2"],
    ray: Float[Array, "3"],
) -> Float[Array, ""]:
    board_from_camera = invert(pose)
    origin = board_from_camera[:3, 3]
    direction = board_from_camera[:3, :3] @ ray
    # A harmless 1 where the ray runs along the board; such a point has no meaning anyway.
    along_z = jnp.where(direction[2] == 0, 1.0, direction[2]).astype(ray.dtype)
    range_m = -origin[2] / along_z
    # Every round leaves the slope of the bow, less than a hundredth, of the error before.
    for _ in range(3):
        p = origin + range_m * direction
        range_m = (warp_height(frame, warp, p[0], p[1]) - origin[2]) / along_z
    return sheet.offset(range_m * ray)


def _ray_and_slopes(
    camera: AbstractCamera, coordinates: int, q: Float[Array, "2"]
) -> tuple[Float[Array, "3"], Float[Array, "3 camera"], Float[Array, "3 2"]]:
    """`camera.unproject(q)`, its derivative by the camera's minimal coordinates, and by the pixel."""
    ray = camera.unproject(q)
    basis = tangent_basis(ray)
    (a, b), (c, d) = jax.jacfwd(lambda t: camera.project(ray + t[0] * basis[0] + t[1] * basis[1]))(jnp.zeros_like(q))
    by_pixel = basis.T @ (jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / (a * d - b * c))
    # Implicit function theorem: where the pixel of a ray moves one way, the ray of a pixel moves back.
    moved = jax.jacfwd(lambda s: camera.retract(s).project(ray))(jnp.zeros(coordinates, q.dtype))
    return ray, -by_pixel @ moved, by_pixel


def prior_names(lasers: int) -> tuple[str, ...]:
    """What each entry of `priors` is about, by shared parameter (of a laser, without its name)."""
    return (
        ("cx", "cy", "fx", "p1", "p2", "k3", "gain", "c1", "s1", "c2", "s2")
        + ("b2", "b3") * lasers
        + (
            "warp.x",
            "warp.y",
        )
    )


def priors(problem: Problem) -> Float[Array, " priors"]:
    """Departure from what is expected before any image, in the unit of each parameter."""
    camera, table = problem.scanner.camera, problem.scanner.turntable
    if not isinstance(camera, Pinhole):
        raise ValueError(f"No priors for a camera of type {type(camera).__name__}.")
    fixed = jnp.stack(
        [
            camera.cx - problem.centre[0],
            camera.cy - problem.centre[1],
            camera.fx / camera.fy - 1.0,
            camera.distortion[2],
            camera.distortion[3],
            camera.distortion[4],
            jnp.abs(table.gain) - 1.0,
        ]
    )
    bows = jnp.asarray(problem.scanner.lasers.bow).ravel()
    return jnp.concatenate([fixed, jnp.asarray(table.harmonics), bows, jnp.asarray(problem.warp)])
