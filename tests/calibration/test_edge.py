"""Rays are judged where a lens has light: powers of the angle that run off beyond it are no error of the camera."""

import numpy as np
import pytest

from jaxscan.calibration.other_lens import ray_difference
from jaxscan.calibration.propagate import edge_deg, field_radius, image_places, ray_error
from jaxscan.geometry import Fisheye, Pinhole


K = np.array([-0.03, 0.0, -0.004, 4e-4])
FISHEYE = Fisheye(200.0, 200.0, 399.5, 239.5, K, width=800, height=480)
"""Its image circle ends 290 px from the middle; its polynomial flattens out beyond, and then rises again."""


def slope(theta):
    return 1 + sum((2 * n + 3) * k * theta ** (2 * n + 2) for n, k in enumerate(K))


def radius(theta):
    return 200.0 * (theta + sum(k * theta ** (2 * n + 3) for n, k in enumerate(K)))


def test_the_edge_is_where_the_scale_first_falls_to_half():
    theta = np.radians(np.arange(0.0, 180.0, 0.1))
    edge = theta[np.argmax(slope(theta) < 0.5)]
    assert edge_deg(FISHEYE) == pytest.approx(np.degrees(edge), abs=1.0)
    assert field_radius(FISHEYE) == pytest.approx(radius(edge), abs=2.0)
    # The scale is as large as in the middle again where nothing can be seen any more.
    assert (slope(theta[theta > edge]) > 1.0).any()
    q, _ = image_places(FISHEYE)
    away = np.hypot(*(q - [399.5, 239.5]).T)
    assert 230 < away.max() < field_radius(FISHEYE)


def test_a_lens_with_light_all_over_the_image_has_no_edge():
    camera = Pinhole(400.0, 400.0, 399.5, 239.5, np.array([-0.1, 0.0, 0.0, 0.0, 0.0]), width=800, height=480)
    assert edge_deg(camera) is None
    assert len(image_places(camera)[0]) == 16 * 12 and field_radius(camera) == pytest.approx(np.hypot(400, 240))


def test_a_coefficient_that_the_rim_alone_knows_does_little_harm():
    step = np.zeros((1, 8))
    step[0, 7] = 1e-4
    moved = FISHEYE.retract(step[0])
    said = ray_error(FISHEYE, step)
    # At the edge rays move by 200 px times 1e-4 of the ninth power of the angle, at the corners of the image by a
    # hundred times as much.
    edge = np.radians(edge_deg(FISHEYE))
    assert 0.05 * 0.02 * edge**9 < said < 0.02 * edge**9
    assert said == pytest.approx(ray_difference(FISHEYE, moved), rel=0.1)
