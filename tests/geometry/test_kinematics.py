"""Kinematics: NumPy equals JAX, derivatives equal differences, there and back, and NumPy compiles nothing."""

import logging

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import jaxscan
from jaxscan.geometry import (
    DoubleSphere,
    Fisheye,
    LaserSheet,
    LinearStage,
    Pinhole,
    Rig,
    Scanner,
    Still,
    Turntable,
    exponential,
    from_quaternion,
    lit_points,
    nearest_rotation,
    poses,
    quaternion,
    stack_lasers,
)


_FIELDS = (420.0, 418.0, 321.3, 238.8)
CAMERAS = {
    "pinhole": Pinhole(*_FIELDS, np.array([-0.28, 0.09, 0.001, -0.0007, -0.01]), 640, 480, 0.4),
    "rational": Pinhole(*_FIELDS, np.array([0.9, 0.3, 0.0003, -0.0002, 0.05, 1.2, 0.5, 0.09]), 640, 480),
    "fisheye": Fisheye(*_FIELDS, np.array([-0.03, 0.004, -0.001, 0.0001]), 640, 480),
    "double_sphere": DoubleSphere(*_FIELDS, np.array([-0.2, 0.55]), 640, 480),
}
_TABLE = Turntable.from_axis([0.05, -1.0, 0.02], [0.01, 0.0, -0.2], gain=-1.002)
MOTIONS = {
    "turntable": Turntable(
        _TABLE.direction, _TABLE.point, _TABLE.gain, np.array([1e-3, -2e-3, 5e-4, 3e-4]), _TABLE.basis
    ),
    "object": Turntable.from_axis([0.05, -1.0, 0.02], [0.01, 0.0, 0.9], carries="object"),
    "stage": LinearStage.from_direction([1.0, 0.1, -0.05], gain=1.003),
    "still": Still(),
}


def make_rig(camera="pinhole", motion="turntable"):
    flat = [LaserSheet.from_abc(-7.606, -1.685, 1.296), LaserSheet.from_abc(6.2, 0.4, 1.4)]
    sheets = [LaserSheet(s.normal, s.distance, np.array([2e-3, -1e-3]), s.basis) for s in flat]
    return Scanner(CAMERAS[camera], stack_lasers(sheets), MOTIONS[motion]).rig


KINDS = [*((camera, "turntable") for camera in CAMERAS), *(("pinhole", motion) for motion in list(MOTIONS)[1:])]
_FAST = (("pinhole", "turntable"), ("fisheye", "turntable"), ("pinhole", "object"))


@pytest.fixture(
    params=[pytest.param(kind, id="-".join(kind), marks=() if kind in _FAST else pytest.mark.more) for kind in KINDS]
)
def rig(request):
    """Every camera on a turntable, and every other motion with a pinhole camera."""
    return make_rig(*request.param)


def stripes(count=60):
    """Pixels, sheets and positions whose points exist."""
    rng = np.random.default_rng(3)
    laser = rng.integers(0, 2, count)
    # The first sheet is met to the left of the image's middle, the second to the right.
    u = np.where(laser == 0, rng.uniform(40, 240, count), rng.uniform(390, 600, count))
    return np.stack([u, rng.uniform(10, 470, count)], -1), laser, rng.uniform(-2.0, 2.0, count)


def functions(rig, q, laser, phi):
    p = jaxscan.points(rig, q, laser, phi)
    return {
        "rays": jaxscan.rays(rig, q),
        "points": p,
        "slopes": jaxscan.slopes(rig, q, laser, phi),
        "pixels": jaxscan.pixels(rig, p, phi),
    }


def single(tree):
    return jax.tree.map(lambda leaf: leaf.astype(np.float32) if leaf.dtype == np.float64 else leaf, tree)


def test_numpy_equals_jax_in_both_precisions(rig):
    given = rig, *stripes()
    # Rounding of points some metres away, of pixels, and of slopes of some centimetres a pixel.
    for cast, kind, tolerance in ((lambda tree: tree, np.float64, 1e-11), (single, np.float32, 2e-3)):
        one = cast(given)
        compiled = jax.jit(functions)(*one)
        for name, by_numpy in functions(*one).items():
            by_jax = compiled[name]
            assert type(by_numpy) is np.ndarray and by_numpy.dtype == by_jax.dtype == kind, name
            np.testing.assert_allclose(by_numpy, by_jax, atol=tolerance, rtol=tolerance, err_msg=name)


@pytest.mark.more
def test_any_leading_axes(rig):
    q, laser, phi = stripes()
    flat = functions(rig, q, laser, phi)
    shaped = functions(rig, q.reshape(3, 4, 5, 2), laser.reshape(3, 4, 5), phi.reshape(3, 4, 5))
    alone = functions(rig, q[7], int(laser[7]), float(phi[7]))
    mapped = jax.vmap(functions, (None, 0, 0, 0))(jax.tree.map(jnp.asarray, rig), *map(jnp.asarray, (q, laser, phi)))
    for name, expected in flat.items():
        np.testing.assert_array_equal(shaped[name].reshape(expected.shape), expected)
        np.testing.assert_allclose(alone[name], expected[7], rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(mapped[name], expected, rtol=1e-11, atol=1e-11)


def test_positions_broadcast():
    rig, (q, laser, phi) = make_rig(), stripes()
    each = jaxscan.points(rig, q[None], laser[None], phi[:4, None])
    for row, one in zip(each, phi, strict=False):
        np.testing.assert_array_equal(row, jaxscan.points(rig, q, laser, float(one)))


def test_there_and_back(rig):
    q, laser, phi = stripes()
    p = jaxscan.points(rig, q, laser, phi)
    np.testing.assert_allclose(jaxscan.pixels(rig, p, phi), q, atol=1e-9, rtol=0)
    p_cam, incidence = lit_points(rig, q, laser)
    assert (incidence > 0).all()
    np.testing.assert_allclose(rig.laser(laser).offset(p_cam), 0, atol=1e-12)
    centre = poses(rig, phi)[:, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(p - centre, axis=-1), np.linalg.norm(p_cam, axis=-1), rtol=1e-12)


def test_slopes_are_differences(rig):
    q, laser, phi = stripes()
    found = jaxscan.slopes(rig, q, laser, phi)
    for k, step in enumerate(1e-4 * np.eye(2)):
        forth, back = (jaxscan.points(rig, q + sign * step, laser, phi) for sign in (1.0, -1.0))
        # Central differences leave the square of the step, relative to some hundred pixels, and rounding over it.
        np.testing.assert_allclose(found[..., k], (forth - back) / 2e-4, atol=1e-8 + 1e-7 * np.abs(found).max(), rtol=0)


@pytest.mark.more
def test_derivatives_by_everything_are_differences(rig):
    q, laser, phi = (part[:6] for part in stripes())

    def length(rig, q, phi):
        p, by_pixel = jaxscan.points(rig, q, laser, phi), jaxscan.slopes(rig, q, laser, phi)
        seen = jaxscan.pixels(rig, p + 0.1, phi)
        return (p * p).sum() + 100.0 * by_pixel.sum() + 1e-3 * seen.sum()

    given = jax.tree.map(jnp.asarray, (rig, q, phi))
    gradient = jax.jit(jax.grad(length, argnums=(0, 1, 2)))(*given)
    leaves, structure = jax.tree.flatten((rig, q, phi))
    rng, checked = np.random.default_rng(0), 0
    for index, (leaf, by_leaf) in enumerate(zip(leaves, jax.tree.leaves(gradient), strict=True)):
        leaf = np.asarray(leaf)
        step = rng.normal(size=leaf.shape) * 1e-6 * max(1.0, float(np.abs(leaf).max(initial=0.0)))
        ends = []
        for sign in (1.0, -1.0):
            moved = [leaf + sign * step if k == index else other for k, other in enumerate(leaves)]
            ends.append(length(*jax.tree.unflatten(structure, moved)))
        change, expected = (ends[0] - ends[1]) / 2, float((np.asarray(by_leaf) * step).sum())
        # Rounding of sums of about a hundred.
        np.testing.assert_allclose(expected, change, rtol=1e-5, atol=3e-11)
        checked += abs(change) > 1e-9
    assert checked >= 6


def test_rays_that_miss_the_sheet_end_in_the_camera():
    rig = make_rig()
    away = np.array([[500.0, 240.0], [100.0, 240.0]])
    p, by_pixel = jaxscan.points(rig, away, 0, 0.3), jaxscan.slopes(rig, away, 0, 0.3)
    np.testing.assert_allclose(p[0], poses(rig, 0.3)[:3, 3], atol=1e-15)
    assert (by_pixel[0] == 0).all() and (by_pixel[1] != 0).all()
    gradient = jax.grad(lambda q: jaxscan.points(rig, q, 0, 0.3).sum() + jaxscan.slopes(rig, q, 0, 0.3).sum())
    assert np.isfinite(gradient(jnp.asarray(away))).all()


def test_nothing_is_compiled_for_numpy(rig, caplog):
    jax.clear_caches()
    given = stripes()
    with jax.log_compiles(), caplog.at_level(logging.DEBUG, logger="jax"):
        functions(rig, *given)
        rig.retract(np.full(len(rig.layout().names), 1e-4))
        assert not [record for record in caplog.records if "ompiling" in record.getMessage()]
        # The log is not silent for another reason.
        jaxscan.rays(rig, jnp.asarray(given[0]))
        assert [record for record in caplog.records if "ompiling" in record.getMessage()]


def test_one_program_serves_scanners_of_any_name_and_size():
    programs = jax.jit(lambda rig, q: jaxscan.rays(rig, q))
    q = jnp.asarray(stripes()[0])
    for names, width, up in ((("red", "green"), 640, "-v"), (("left", "right"), 1280, "+v")):
        camera = Pinhole(*_FIELDS, np.zeros(5), width, 480)
        scanner = Scanner(camera, make_rig().lasers, MOTIONS["turntable"], np.eye(3), names, up)
        programs(scanner.rig, q)
    assert programs._cache_size() == 1  # noqa: SLF001


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.099, 0.101, 1.0, 3.0, 7.0])
def test_exponential_of_any_twist(angle):
    twist = np.random.default_rng(1).normal(size=6)
    twist[3:] *= angle / np.linalg.norm(twist[3:])
    x, y, z = twist[3:]
    generator = np.zeros((4, 4))
    generator[:3] = np.column_stack([[[0, -z, y], [z, 0, -x], [-y, x, 0]], twist[:3]])
    np.testing.assert_allclose(exponential(twist), expm(generator), atol=1e-13)
    slopes = jax.jacrev(exponential)(jnp.asarray(twist))
    numeric = [(exponential(twist + step) - exponential(twist - step)) / 2e-6 for step in 1e-6 * np.eye(6)]
    # Rounding over the step.
    np.testing.assert_allclose(slopes, np.stack(numeric, -1), atol=2e-9)


def test_quaternions_and_nearest_rotations():
    rotation = exponential(np.array([0.0, 0.0, 0.0, 0.3, -2.0, 1.1]))[:3, :3]
    w, *axis = quaternion(rotation)
    angle = np.linalg.norm([0.3, -2.0, 1.1])
    expected = np.sin(angle / 2) / angle * np.array([0.3, -2.0, 1.1])
    np.testing.assert_allclose([w, *axis], [np.cos(angle / 2), *expected], atol=1e-15)
    np.testing.assert_allclose(from_quaternion(3.0 * np.array([w, *axis])), rotation, atol=1e-15)
    # Stretched along perpendicular axes a matrix keeps its rotation.
    turned = exponential(np.array([0.0, 0.0, 0.0, 0.5, 0.2, 0.4]))[:3, :3]
    stretched = rotation @ turned @ np.diag([1.1, 0.9, 1.2]) @ turned.T
    np.testing.assert_allclose(nearest_rotation(np.stack([stretched, rotation])), [rotation, rotation], atol=1e-14)


def test_the_rig_moves_as_the_scanner_does(rig):
    scanner = Scanner(rig.camera, rig.lasers, rig.motion, laser_names=("one", "two"))
    assert len(rig.layout().names) == len(scanner.parameter_names())
    step = 1e-3 * np.arange(1.0, 1 + len(rig.layout().names))
    moved = rig.retract(step)
    assert isinstance(moved, Rig)
    for ours, theirs in zip(
        jax.tree.leaves(moved), jax.tree.leaves(jax.jit(lambda step: scanner.retract(step))(step).rig), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-14, atol=1e-14)
