"""The block-arrow solver against dense linear algebra and numerical derivatives."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings
from jaxscan.calibration.adjust import noise_by_class
from jaxscan.calibration.joint import linearise, priors, solve
from jaxscan.calibration.problem import (
    BoardModes,
    Problem,
    board_surface,
    camera_from_board,
    corner_pixels,
    move,
    parameter_scales,
    prepare,
    prior_weights,
    shared_values,
    zero_step,
)
from jaxscan.calibration.rows import stripe_rows
from jaxscan.calibration.settings import BLOCKS, board_blocks
from jaxscan.geometry import LaserSheet, Pinhole, Turntable, exponential, make_layout, stack_lasers
from jaxscan.leastsq import Unknowns, solve_arrow


LAYOUT = make_layout(
    Pinhole(1.0, 1.0, 0.0, 0.0, np.zeros(8), 1, 1), ("0",), motion=Turntable.blocks, board=board_blocks(3)
)


@pytest.fixture(scope="module")
def problem(world):
    """Small, far from its minimum, everything free, with a bowed sheet and board."""
    rig = world.Rig()
    observed = world.observe(rig, free=3, placements=1, angles=2, points=20)
    data = prepare(observed)
    # A few corners and points are as good as many.
    pick = np.linspace(0, 62, 9).astype(int)
    lens = np.array([-0.08, 0.05, 1e-3, -1e-3, 0.02, 0.01, -0.01, 0.005])
    camera = Pinhole(1190.0, 1195.0, 640.0, 500.0, lens, 1280, 1024)
    sheet = LaserSheet.from_plane(rig.normal() + np.array([0.0, 0.01, 0.0]), 0.21)
    sheet = eqx.tree_at(lambda s: s.bow, sheet, np.array([2e-3, -1e-3]))
    table = Turntable.from_axis(rig.direction(), rig.foot() + 0.01, gain=1.001)
    table = eqx.tree_at(lambda t: t.harmonics, table, np.array([1e-3, 2e-3, -1e-3, 5e-4]))
    pose = jax.jit(exponential)
    poses = np.array([np.asarray(pose(np.array([-0.1, -0.1, 0.9 + 0.1 * i, 0.3, -0.2 * i, 0.1]))) for i in range(4)])
    half = np.ptp(rig.board.corners()[:, :2], axis=0) / 2
    # A twist, a cubic along x, and a print out of place.
    a, b = ((data.board[pick, :2] - half) / half).T
    coefficients = np.zeros((2, 28))
    coefficients[0, 4], coefficients[1, 6] = 3e-4, 2e-4
    places = np.zeros((9, 3, 3))
    places[:, 2, 0], places[:, 2, 1] = 3e-4 * a * b, 2e-4 * (4 * a**3 - 3 * a)
    places[:, :2, 2] = 1e-4 * np.random.default_rng(0).normal(size=(9, 2))
    settings = CalibrationSettings(free=BLOCKS)
    return Problem(
        camera=camera,
        lasers=stack_lasers([sheet]),
        turntable=table,
        poses=poses,
        stops=np.linspace(-1.0, 1.0, 2 * len(poses)).reshape(-1, 2),
        shape=np.array([1e-3, -5e-4, 2e-4, 0.5, -0.3, 0.2]),
        scales=parameter_scales(LAYOUT, settings.free),
        expected=np.linspace(0, 1, len(LAYOUT.names)),
        prior_weight=prior_weights(LAYOUT, settings),
        board=data.board[pick],
        frame=np.concatenate([half, half]),
        modes=BoardModes(places, coefficients),
        corner_q=data.corner_q[:5, pick],
        corner_weight=np.full((5, 9), 10.0),
        angle=data.angle[:5],
        stop=np.eye(2)[[0, 1, 0, 1, 0]],
        stop_sigma=np.asarray(2e-3),
        placement=data.placement[:5],
        stripe_q=data.stripe_q[:4, :12],
        stripe_weight=np.where(data.stripe_valid[:4, :12], 2000.0, 0.0),
        stripe_view=data.stripe_view[:4],
        stripe_laser=data.stripe_laser[:4],
        view_used=np.ones(5, bool),
        stripe_used=np.ones(4, bool),
    )


def residuals(step, problem):
    """All whitened residuals, as they are defined; a function that can be differentiated."""
    there = move(step, problem)
    corner = (corner_pixels(there) - there.corner_q) * jnp.asarray(there.corner_weight)[..., None]
    poses = camera_from_board(there)[there.stripe_view]
    rays = there.camera.unproject(jnp.asarray(there.stripe_q))
    # Stripes say nothing of the pitch: see `stripe_rows`.
    board = board_surface(eqx.tree_at(lambda p: p.shape, there, jnp.asarray(there.shape).at[2].set(0.0)))
    along, _ = board.meet(poses[:, None], rays)
    sheet = jax.tree.map(lambda leaf: leaf[0], there.lasers)
    return corner, sheet.offset(along[..., None] * rays) * there.stripe_weight, priors(there), there.stops


def dense_jacobian(ours):
    """Of all residuals by the shared unknowns, then the poses and stops of all placements."""
    problem, shared, size = ours.problem, len(LAYOUT.names), ours.problem.own
    rows, count = [], shared + size * len(problem.poses)
    for slopes, chain, owner in (
        (ours.corner_slopes, ours.chains.corner, problem.placement),
        (ours.stripe_slopes, ours.chains.stripe, problem.stripe_placement()),
    ):
        for own, placement in zip(slopes @ chain, owner, strict=True):
            row = np.zeros((len(own), count))
            row[:, :shared], row[:, shared + size * placement :][:, :size] = own[:, :shared], own[:, shared:]
            rows.append(row)
    rows.append(np.pad(ours.prior_slopes, ((0, 0), (0, count - shared))))
    rows.append(np.eye(count)[shared + np.flatnonzero(np.arange(count - shared) % size >= 6)])
    return np.concatenate(rows)


@pytest.fixture(scope="module")
def dense(problem):
    """Residual vector as it is defined, and our dense Jacobian [residuals, shared + local]."""
    flat, unravel = jax.flatten_util.ravel_pytree(zero_step(problem))
    vector = jax.jit(lambda y: jax.flatten_util.ravel_pytree(residuals(unravel(y), problem))[0])
    return vector, dense_jacobian(linearise(problem)), np.asarray(flat)


def test_derivatives_are_those_of_finite_differences(dense):
    vector, jacobian, start = dense
    step = 1e-4
    numeric = np.stack(
        [
            (np.asarray(vector(start + step * e)) - np.asarray(vector(start - step * e))) / (2 * step)
            for e in np.eye(len(start))
        ],
        axis=1,
    )
    size = np.abs(jacobian).max(axis=0)
    assert (size > 0).all()
    # Central differences err by step^2 times the third derivative, some 1e-7 of the first here.
    assert (np.abs(numeric - jacobian).max(axis=0) / size).max() < 1e-6


def test_the_step_is_that_of_dense_least_squares(problem, dense):
    vector, jacobian, flat = dense
    arrow = jax.tree.map(jnp.asarray, linearise(problem).arrow)
    for damping in (0.0, 1e-3, 1.0):
        shared, local = jax.jit(solve_arrow)(arrow, damping)
        ours = np.concatenate([shared, local.ravel()])
        damped = np.sqrt(damping) * np.diag(np.sqrt(np.sum(jacobian**2, axis=0)))
        system = np.concatenate([jacobian, damped])
        target = np.concatenate([np.asarray(vector(flat)), np.zeros(len(flat))])
        # Columns of one size, or lstsq's own cut-off counts small units as null directions.
        size = np.linalg.norm(system, axis=0)
        theirs = np.linalg.lstsq(system / size, target, rcond=None)[0] / size
        # Normal equations square the condition number: 1e-9 of the step, where it is known well.
        tolerance = 1e-9 if damping else 1e-6
        assert np.abs(ours - theirs).max() < tolerance * np.abs(theirs).max()


def test_information_and_leverages_are_those_of_the_dense_jacobian(problem, dense):
    _, jacobian, _ = dense
    ours = linearise(problem)
    # Columns of one size, so that inverting loses no more digits than it must.
    size = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.inv((jacobian / size).T @ (jacobian / size))
    leverage = np.einsum("ri,ij,rj->r", jacobian / size, inverse, jacobian / size)
    corner, stripe = ours.corner_leverage, ours.stripe_leverage
    count = corner.size + stripe.size
    # The condition of this small problem, far from its minimum, costs about eight digits.
    np.testing.assert_allclose(np.concatenate([corner.ravel(), stripe.ravel()]), leverage[:count], atol=1e-6)
    covariance = inverse / np.outer(size, size)
    shared = covariance[: len(LAYOUT.names), : len(LAYOUT.names)]
    sigma = np.sqrt(np.diag(shared))
    for ours_too in (np.linalg.inv(ours.reduced), ours.covariance.shared):
        np.testing.assert_allclose(ours_too / np.outer(sigma, sigma), shared / np.outer(sigma, sigma), atol=1e-6)


def test_the_minimum_is_that_of_dense_least_squares(problem):
    # Observations of the problem's own rig, with noise, seen from a start that is tens of pixels off.
    random, few = np.random.default_rng(0), ("focal", "centre", "laser", "axis", "warp")
    stripe_q = np.asarray(problem.stripe_q)
    for _ in range(4):
        near = linearise(replace(problem, stripe_q=stripe_q))
        stripe_q = stripe_q - near.by_q * (near.offset / np.maximum(near.slope, 1e-9) ** 2)[..., None]
    corner_q = corner_pixels(problem) + 0.1 * random.normal(size=problem.corner_q.shape)
    true = replace(
        problem,
        corner_q=corner_q,
        stripe_q=stripe_q + 0.1 * random.normal(size=stripe_q.shape),
        scales=parameter_scales(LAYOUT, few),
        expected=np.asarray(shared_values(problem)),
        prior_weight=prior_weights(LAYOUT, CalibrationSettings(free=few)),
    )
    off = Unknowns(random.normal(size=len(LAYOUT.names)), 0.3 * random.normal(size=(len(problem.poses), problem.own)))
    begin = move(off, true)
    ours = solve(begin, 1e-4, 1e-9, 100)
    assert ours.converged
    assert np.sqrt(np.mean(linearise(begin).corner_error ** 2)) > 5.0
    # Gauss' and Newton's steps by dense linear algebra, from the truth.
    theirs, free = true, np.flatnonzero(np.append(true.scales, np.ones(true.own * len(true.poses))))
    for _ in range(20):
        at = linearise(theirs)
        jacobian = dense_jacobian(at)[:, free]
        size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        step = np.zeros(len(true.scales) + true.own * len(true.poses))
        step[free] = (
            -np.linalg.lstsq(jacobian / size, np.concatenate([part.ravel() for part in at.residuals]))[0] / size
        )
        theirs = move(Unknowns(step[: len(true.scales)], step[len(true.scales) :].reshape(-1, true.own)), theirs)
    seen = lambda at: np.concatenate([part.ravel() for part in at.residuals])
    np.testing.assert_allclose(seen(ours.linearised), seen(linearise(theirs)), atol=1e-9)
    # Frames of tangents depend on the way.
    parts = lambda p: (p.camera, p.lasers.normal, p.lasers.distance, p.turntable.twist(), p.poses, p.shape)
    both = ours.linearised.problem, theirs
    ours_too, same = (np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(parts(p))]) for p in both)
    np.testing.assert_allclose(ours_too, same, rtol=1e-9, atol=1e-9)


@pytest.mark.more
def test_stripe_rows_are_the_distance_of_the_lifted_point_from_the_sheet(problem):
    rows, by_q = jax.jit(stripe_rows)(jax.tree.map(jnp.asarray, problem))
    poses = np.asarray(jax.jit(camera_from_board)(problem))
    sheet = jax.tree.map(lambda leaf: leaf[0], problem.lasers)
    ray_of, to_sheet = eqx.filter_jit(problem.camera.unproject), eqx.filter_jit(sheet.offset)
    for stripe, point in ((0, 3), (2, 5)):
        q = np.asarray(problem.stripe_q[stripe, point])

        def offset(q, pose=poses[problem.stripe_view[stripe]]):
            ray = np.asarray(ray_of(q))
            still = -pose[:3, :3].T @ pose[:3, 3]
            along = pose[:3, :3].T @ ray
            # The board's height along the ray by bisection, where the solver iterates.
            low, high = 0.1, 5.0
            for _ in range(80):
                middle = 0.5 * (low + high)
                x, y, z = still + middle * along
                a, b = (x - problem.frame[0]) / problem.frame[2], (y - problem.frame[1]) / problem.frame[3]
                cubic = 4 * a**3 - 3 * a if abs(a) <= 1 else np.sign(a) * (1 + 9 * (abs(a) - 1))
                height = problem.shape[0] * (1 - a * a) + problem.shape[1] * (1 - b * b)
                height += 3e-4 * problem.shape[3] * a * b + 2e-4 * problem.shape[4] * cubic
                low, high = (middle, high) if (z - height) * along[2] < 0 else (low, middle)
            return float(to_sheet(middle * ray))

        # Newton's rays are good to 1e-10 px, the bowed board to 1e-6 of its bow.
        assert float(rows.value[stripe, point]) == pytest.approx(offset(q), abs=2e-9)
        numeric = [(offset(q + 1e-3 * e) - offset(q - 1e-3 * e)) / 2e-3 for e in np.eye(2)]
        np.testing.assert_allclose(by_q[stripe, point], numeric, rtol=1e-5, atol=1e-9)


def test_held_parameters_do_not_move(problem):
    held = eqx.tree_at(lambda p: p.scales, problem, parameter_scales(LAYOUT, ("focal", "laser")))
    shared, _ = solve_arrow(linearise(held).arrow, 1e-3)
    free = {name for name, value in zip(LAYOUT.names, shared, strict=True) if value != 0}
    assert free == {"fx", "fy", "laser.0.n1", "laser.0.n2", "laser.0.d"}


@pytest.mark.more
def test_padding_changes_no_sum_and_has_no_error(problem):
    fields = ("corner_q", "corner_weight", "angle", "placement", "stripe_q", "stripe_weight", "stripe_view")
    fields += ("stripe_laser", "view_used", "stripe_used", "stop")

    def more(name):
        values = getattr(problem, name)
        return np.concatenate([values, np.zeros((9, *values.shape[1:]), values.dtype)])

    cost = lambda at: sum(np.sum(part**2) for part in at.residuals)
    padded, ours = linearise(replace(problem, **{name: more(name) for name in fields})), linearise(problem)
    assert cost(padded) == pytest.approx(cost(ours), rel=1e-12)
    for one, other in zip(padded.arrow, ours.arrow, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12 * np.abs(other).max())
    np.testing.assert_allclose(padded.stripe_leverage[:4], ours.stripe_leverage, rtol=1e-9, atol=1e-12)
    assert not padded.corner_error[5:].any() and not padded.offset[4:].any()


def test_a_step_is_the_same_in_numpy_and_in_jax(problem):
    random = np.random.default_rng(0)
    many = replace(problem, poses=np.tile(problem.poses, (20, 1, 1)), stops=np.tile(problem.stops, (20, 1)))
    step = Unknowns(1e-3 * random.normal(size=len(LAYOUT.names)), 1e-2 * random.normal(size=(80, 8)))
    apart, at_once = move(step, many), jax.jit(move)(step, many)
    np.testing.assert_allclose(apart.poses, at_once.poses, atol=1e-15)
    np.testing.assert_allclose(apart.camera.distortion, at_once.camera.distortion, atol=1e-15)


def test_a_step_moves_the_camera_as_it_says(problem):
    step = np.zeros(len(LAYOUT.names))
    step[LAYOUT.names.index("cx")] = 1.0
    moved = jax.jit(move)(Unknowns(jnp.asarray(step), jnp.zeros((4, 8))), problem)
    assert float(moved.camera.cx) == pytest.approx(640.0 + problem.scales[LAYOUT.names.index("cx")])
    np.testing.assert_allclose(moved.poses, problem.poses, atol=1e-15)


def test_a_small_contrast_class_has_the_noise_of_its_kind():
    counts, true = [400, 10, 300, 10, 400, 0], [1.0, 1.0, 3.0, 5.0, 5.0, 5.0]
    contrast = np.repeat(np.arange(6), counts)
    values = np.repeat(true, counts) * np.random.default_rng(0).choice([-1.0, 1.0], len(contrast))
    size = lambda some: float(np.sqrt(np.mean(values[some] ** 2)))
    every = np.ones(len(contrast), bool)
    fitted, other = size(contrast < 3), size(contrast >= 3)
    expected = [1.0, fitted, 3.0, other, 5.0, other]
    np.testing.assert_allclose(noise_by_class(size, contrast, every), expected)
    # Too few of a kind: all points together.
    few = every & ((contrast < 3) | (np.cumsum(contrast >= 3) <= 20))
    np.testing.assert_allclose(noise_by_class(size, contrast, few)[3:], size(few))


def test_contrast_of_points_that_are_not_valid_is_not_looked_up(world):
    perfect = world.observe(world.Rig())
    stripes = perfect.stripes
    for forged in (-1, 7, 127):
        contrast = np.where(stripes.valid, 2, forged).astype(np.int8)
        data = prepare(replace(perfect, stripes=replace(stripes, contrast=contrast)))
        assert (data.stripe_contrast == np.where(data.stripe_valid, 2, 0)).all()
