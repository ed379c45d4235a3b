"""The block-arrow solver against dense linear algebra and numerical derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import CalibrationSettings
from jaxscan.calibration.adjust import prior_weights
from jaxscan.calibration.parameters import block_of, parameter_scales, shared_names
from jaxscan.calibration.prepare import prepare
from jaxscan.calibration.residuals import Problem, Step, residuals
from jaxscan.calibration.solve import form_blocks, jacobian_columns, schur_step, zero_step
from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, exponential, stack_lasers


@pytest.fixture(scope="module")
def problem(world):
    """Small, far from its minimum, everything free, with a bowed sheet and board."""
    rig = world.Rig()
    observed = world.observe(rig, free=3, placements=1, angles=2, points=20)
    data = prepare(observed)
    # A few corners and points are as good as many.
    pick = np.linspace(0, 62, 9).astype(int)
    camera = Pinhole(1190.0, 1195.0, 640.0, 500.0, np.array([-0.08, 0.05, 1e-3, -1e-3, 0.02]), 1280, 1024)
    sheet = LaserSheet.from_plane(rig.normal() + np.array([0.0, 0.01, 0.0]), 0.21)
    sheet = eqx.tree_at(lambda s: s.bow, sheet, np.array([2e-3, -1e-3]))
    table = Turntable.from_axis(rig.direction(), rig.foot() + 0.01, gain=1.001)
    table = eqx.tree_at(lambda t: t.harmonics, table, np.array([1e-3, 2e-3, -1e-3, 5e-4]))
    scanner = Scanner(camera, stack_lasers([sheet]), table)
    names = shared_names(scanner)
    free = tuple({block_of(name) for name in names})
    poses = np.array(
        [np.asarray(exponential(np.array([-0.1, -0.1, 0.9 + 0.1 * i, 0.3, -0.2 * i, 0.1]))) for i in range(4)]
    )
    half = np.ptp(rig.board.corners()[:, :2], axis=0) / 2
    return Problem(
        scanner=scanner,
        poses=poses,
        warp=np.array([1e-3, -5e-4]),
        scales=parameter_scales(names, free),
        board=data.board[pick],
        frame=np.concatenate([half, half]),
        centre=np.array([639.5, 511.5]),
        corner_q=data.corner_q[:5, pick],
        corner_weight=np.full((5, 9), 10.0),
        angle=data.angle[:5],
        placement=data.placement[:5],
        stripe_q=data.stripe_q[:4, :12],
        stripe_weight=np.where(data.stripe_valid[:4, :12], 2000.0, 0.0),
        stripe_view=data.stripe_view[:4],
        stripe_laser=data.stripe_laser[:4],
        prior_weight=np.asarray(prior_weights(names, 1, free, CalibrationSettings())),
    )


@pytest.fixture(scope="module")
def dense(problem):
    """Residual vector and dense Jacobian [residuals, shared + local]."""
    start = zero_step(problem)
    flat, unravel = jax.flatten_util.ravel_pytree(start)
    vector = jax.jit(lambda y: jax.flatten_util.ravel_pytree(residuals(unravel(y), problem))[0])
    return vector, np.asarray(jax.jit(jax.jacfwd(vector))(flat)), np.asarray(flat)


@jax.jit
def linearised(problem):
    """Residuals and the blocks of the normal equations."""
    start = zero_step(problem)
    residual, product = jax.linearize(lambda step: residuals(step, problem), start)
    owner = problem.placement[problem.stripe_view]
    return form_blocks(*jacobian_columns(product, start), residual, problem.placement, owner, 4)


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
    blocks = linearised(jax.tree.map(jnp.asarray, problem))
    for damping in (0.0, 1e-3, 1.0):
        shared, local = schur_step(blocks, jnp.asarray(damping))
        ours = np.concatenate([np.asarray(shared), np.asarray(local).ravel()])
        damped = np.sqrt(damping) * np.diag(np.sqrt(np.sum(jacobian**2, axis=0)))
        system = np.concatenate([jacobian, damped])
        target = np.concatenate([np.asarray(vector(flat)), np.zeros(len(flat))])
        # Columns of one size, or lstsq's own cut-off counts small units as null directions.
        size = np.linalg.norm(system, axis=0)
        theirs = np.linalg.lstsq(system / size, target, rcond=None)[0] / size
        # Normal equations square the condition number: 1e-9 of the step, where it is known well.
        tolerance = 1e-9 if damping else 1e-6
        assert np.abs(ours - theirs).max() < tolerance * np.abs(theirs).max()


def test_held_parameters_do_not_move(problem):
    names = shared_names(problem.scanner)
    held = eqx.tree_at(lambda p: p.scales, problem, parameter_scales(names, ("focal", "laser")))
    blocks = linearised(jax.tree.map(jnp.asarray, held))
    shared, _ = schur_step(blocks, jnp.asarray(1e-3))
    moved = {name for name, value in zip(names, np.asarray(shared), strict=True) if value != 0}
    assert moved == {"fx", "fy", "laser.laser.n1", "laser.laser.n2", "laser.laser.d"}


def test_a_step_moves_the_scanner_as_it_says(problem):
    from jaxscan.calibration.residuals import move

    names = shared_names(problem.scanner)
    step = np.zeros(len(names))
    step[names.index("cx")] = 1.0
    moved = move(Step(jnp.asarray(step), jnp.zeros((4, 6))), problem)
    assert float(moved.scanner.camera.cx) == pytest.approx(640.0 + problem.scales[names.index("cx")])
    np.testing.assert_allclose(moved.poses, problem.poses, atol=1e-15)
