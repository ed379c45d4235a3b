"""The design's table of signs: the paper's rig, from Table I and Table II to the room."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, point_up, stack_lasers


TR = np.array(
    [
        [0.9994, 4.0e-05, -0.0345, -7.3403e-3],
        [-1.845e-05, 0.9999997, 0.00063, 3.1e-9],
        [0.03458, -0.00063, 0.99940, 0.21142e-3],
        [0.0, 0.0, 0.0, 1.0],
    ]
)


@pytest.fixture
def scanner():
    camera = Pinhole(*map(np.float64, (2894.462, 2887.338, 1016.814, 817.261)), np.zeros(5), 2048, 1638)
    laser = LaserSheet.from_abc(-7.606, -1.685, 1.296203)
    return Scanner(camera, stack_lasers([laser]), point_up(Turntable.from_tr(TR), "-v"))


# The table is printed to a micrometre (and 1e-6), so half a unit of its last digit is the tolerance.
TABLE = 0.6e-6


def test_axis(scanner):
    np.testing.assert_allclose(scanner.turntable.direction, [-0.018237, -0.999833, -0.000846], atol=TABLE)
    np.testing.assert_allclose(scanner.turntable.point, [-0.009786, 0.000358, -0.212275], atol=TABLE)
    np.testing.assert_allclose(np.dot(scanner.turntable.direction, scanner.turntable.point), 0, atol=1e-15)


def test_point_in_the_camera_frame(scanner):
    ray = scanner.camera.unproject(jnp.array([1200.0, 800.0]))
    range_m, incidence = scanner.laser(0).intersect(ray)
    assert incidence > 0
    np.testing.assert_allclose(range_m * ray, [0.155163, -0.014657, 2.451674], atol=TABLE)


@pytest.mark.parametrize(
    ("theta_deg", "expected"),
    [(0.0, [2.663958, -0.165195, 0.009750]), (30.0, [2.389653, 1.188916, 0.009750])],
)
def test_point_in_the_scanner_frame(scanner, theta_deg, expected):
    p, _ = scanner.point(jnp.array([1200.0, 800.0]), 0, jnp.array(np.deg2rad(theta_deg)))
    np.testing.assert_allclose(p, expected, atol=TABLE)
