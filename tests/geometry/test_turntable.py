"""The turn: closed forms, the paper's matrices, and the two ways a table can carry."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, exponential, point_up, stack_lasers, transform


def rodrigues(axis, angle):
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


AXIS = np.array([0.1, -0.98, 0.17]) / np.linalg.norm([0.1, -0.98, 0.17])
TABLE = Turntable.from_axis(AXIS, [0.2, 0.5, -0.05])


@pytest.mark.parametrize("phi", [0.0, 1e-9, 0.3, -2.0, 7.0])
def test_motion_turns_about_the_axis(phi):
    rotation = rodrigues(AXIS, phi)
    motion = TABLE.motion(jnp.array(phi))
    np.testing.assert_allclose(motion[:3, :3], rotation, atol=1e-13)
    np.testing.assert_allclose(motion[:3, 3], TABLE.point - rotation @ TABLE.point, atol=1e-13)


@pytest.mark.parametrize("phi", [0.0, 1e-9, 0.3, -2.0, 7.0])
def test_motion_is_the_exponential_of_its_twist(phi):
    step = np.linspace(-0.02, 0.02, 9)
    for difference in _apart(step, np.array(phi)):
        np.testing.assert_allclose(difference, 0, atol=1e-13)


@jax.jit
def _apart(step, phi):
    def apart(step):
        table = TABLE.retract(step)
        return table.motion(phi) - exponential(table.angle(phi) * table.twist())

    return apart(step), jax.jacfwd(apart)(step)


def test_foot_point_is_perpendicular():
    np.testing.assert_allclose(TABLE.point @ AXIS, 0, atol=1e-16)
    # A point of the axis stays where it is.
    p = jnp.asarray(TABLE.point + 0.7 * AXIS)
    np.testing.assert_allclose(transform(TABLE.motion(jnp.array(1.1)), p), p, atol=1e-14)


def test_angle_model():
    table = Turntable(AXIS, TABLE.point, np.array(-1.001), np.array([1e-3, 2e-3, -3e-4, 5e-4]), TABLE.basis)
    phi = 0.8
    expected = -1.001 * phi + 1e-3 * (np.cos(phi) - 1) + 2e-3 * np.sin(phi)
    expected += -3e-4 * (np.cos(2 * phi) - 1) + 5e-4 * np.sin(2 * phi)
    np.testing.assert_allclose(table.angle(jnp.array(phi)), expected, atol=1e-15)
    assert table.angle(jnp.array(0.0)) == 0


def test_axis_of_its_own_tr():
    again = Turntable.from_tr(TABLE.tr(0.05))
    np.testing.assert_allclose(again.direction, AXIS, atol=1e-12)
    np.testing.assert_allclose(again.point, TABLE.point, atol=1e-12)


def test_tr_that_does_not_turn_is_refused():
    with pytest.raises(ValueError, match="identity"):
        Turntable.from_tr(np.eye(4))


def test_a_table_that_carries_the_object_turns_the_other_way():
    carried = Turntable(AXIS, TABLE.point, TABLE.gain, TABLE.harmonics, TABLE.basis, "object")
    np.testing.assert_allclose(carried.motion(jnp.array(0.4)), TABLE.motion(jnp.array(-0.4)), atol=1e-15)


def test_retract_keeps_its_constraints_and_its_derivative():
    step = jnp.array([0.02, -0.01, 0.003, 0.004, 1e-3, 1e-4, 2e-4, 3e-4, 4e-4])
    moved = TABLE.retract(step)
    np.testing.assert_allclose(jnp.linalg.norm(moved.direction), 1, atol=1e-15)
    np.testing.assert_allclose(moved.direction @ moved.point, 0, atol=1e-15)
    frame = jnp.vstack([moved.basis, moved.direction])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)
    jacobian = jax.jacfwd(lambda s: TABLE.retract(s).direction)(jnp.zeros(9))
    np.testing.assert_allclose(jacobian[:, :2].T, TABLE.basis, atol=1e-14)


@pytest.mark.parametrize("up", ["-v", "+v", "+u", "-u"])
def test_point_up_changes_names_and_no_motion(up):
    flipped = point_up(TABLE, up)
    np.testing.assert_allclose(flipped.motion(jnp.array(0.3)), TABLE.motion(jnp.array(0.3)), atol=1e-15)
    vector = {"-v": [0, -1, 0], "+v": [0, 1, 0], "+u": [1, 0, 0], "-u": [-1, 0, 0]}[up]
    assert flipped.direction @ np.array(vector) >= 0


def test_scanner_frame():
    camera = Pinhole(*map(np.float64, (800, 800, 640, 512)), np.zeros(5), 1280, 1024)
    scanner = Scanner(camera, stack_lasers([LaserSheet.from_abc(-7.0, 0.0, 1.3)]), point_up(TABLE, "-v"))
    T = scanner.scanner_from_camera()
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(T[:3, :3]), 1, atol=1e-14)
    # The axis is z through the origin, and the camera looks along +x.
    np.testing.assert_allclose(T[:3, :3] @ scanner.turntable.direction, [0, 0, 1], atol=1e-14)
    np.testing.assert_allclose(T[:3, :3] @ scanner.turntable.point + T[:3, 3], 0, atol=1e-14)
    assert T[0, 2] > 0
    np.testing.assert_allclose(T[1, 2], 0, atol=1e-14)
    # Turning is right-handed about z.
    turned = scanner.pose(jnp.array(0.5))
    rz = rodrigues([0, 0, 1], 0.5)
    np.testing.assert_allclose(turned[:3, :3], rz @ T[:3, :3], atol=1e-14)
    np.testing.assert_allclose(turned[:3, 3], rz @ T[:3, 3], atol=1e-14)
