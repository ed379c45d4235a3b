"""Angles of corners and heights against closed forms."""

import numpy as np
import pytest

from jaxscan.errors import MeasurementError
from jaxscan.measurement import measure_angle, measure_height

from .test_distances import wall_cloud


A, B = [2.1, -0.4, 0.0], [2.1, 0.4, 0.0]


def corner(slope, **kwargs):
    """Two walls that meet at y = 0, away from the scanner; the angle between them is 2 atan(1 / slope)."""
    return wall_cloud(lambda y, z: 2.5 - slope * np.abs(y), **kwargs)


@pytest.mark.parametrize("slope", [1.0, 0.3])
def test_the_angle_of_a_corner(slope):
    places = [np.array([2.5 - slope * 0.4, y, 0.0]) for y in (-0.4, 0.4)]
    found = measure_angle(corner(slope), *places)
    assert found.value_deg == pytest.approx(np.degrees(2 * np.arctan(1 / slope)), abs=4 * found.sigma_deg)
    assert 0 < found.sigma_deg < 0.1 and min(found.points) > 500 and max(found.rms_m) < 1.2e-3


def test_one_wall_has_a_straight_angle():
    found = measure_angle(wall_cloud(lambda y, z: 2.1 + 0 * y), A, B)
    assert found.value_deg == pytest.approx(180.0, abs=4 * found.sigma_deg) and found.sigma_deg < 0.1


def test_its_sigma_is_honest(box_room):
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    # On two walls of the room that meet, as the scanner has them.
    wanted = [np.append((np.array(place) - [0.4, -0.3]) @ turn, 0.0) for place in ((3.075, 0.5), (0.5, 1.91))]
    whitened = []
    for seed in range(40):
        cloud = box_room(seed=seed, grid=(360, 120), tilt=0.0)
        points = cloud.xyz.reshape(-1, 3)
        places = [points[np.argmin(np.linalg.norm(points - place, axis=1))] for place in wanted]
        found = measure_angle(cloud, *places)
        whitened.append((found.value_deg - 90) / found.sigma_deg)
    # 40 values: a root mean square within 1 +- 3 / sqrt(80).
    assert np.sqrt(np.mean(np.square(whitened))) == pytest.approx(1.0, abs=0.34)


def test_what_hangs_on_a_wall_does_not_turn_it():
    hung = wall_cloud(lambda y, z: 2.5 - np.abs(y) - 0.03 * ((y > 0.3) & (z > 0.02)))
    found = measure_angle(hung, A, B)
    assert found.value_deg == pytest.approx(90.0, abs=4 * found.sigma_deg) and found.sigma_deg < 0.1


def test_two_profiles_on_a_wall_and_two_on_a_picture_are_refused():
    """Through any two profiles goes a plane: through one on the wall and one on the picture a slanted one."""
    # Profiles are 0.1 m apart.
    hung = wall_cloud(lambda y, z: 2.1 - 0.03 * (y > 0.35), shape=(21, 100))
    with pytest.raises(MeasurementError, match="profiles within"):
        measure_angle(hung, A, [2.1, 0.38, 0.0], radius_m=0.19)


def test_a_rough_place_has_a_larger_sigma():
    def with_waves(high):
        return wall_cloud(lambda y, z: 2.5 - np.abs(y) + high * np.sin(90 * y) * np.sin(80 * z))

    found = measure_angle(with_waves(0.01), A, B)
    assert found.sigma_deg > 3 * measure_angle(with_waves(0.0), A, B).sigma_deg
    assert found.value_deg == pytest.approx(90.0, abs=3 * found.sigma_deg)


def test_a_place_without_a_plane_is_refused():
    rough = wall_cloud(lambda y, z: 2.1 + 0.2 * np.sin(40 * y) * np.sin(35 * z))
    with pytest.raises(MeasurementError, match="flat place"):
        measure_angle(rough, A, B)
    with pytest.raises(MeasurementError, match="Only 0 points"):
        measure_angle(corner(1.0), A, [9.0, 0.0, 0.0])


def test_a_height_is_that_along_z():
    cloud = wall_cloud(lambda y, z: 2.0 + 0.1 * z)
    found = measure_height(cloud, [1.98, 0.3, -0.2], [2.02, -0.5, 0.2])
    assert found.value_m == pytest.approx(0.4, abs=0.01) and 0 < found.sigma_m < 1e-3
    down = measure_height(cloud, [2.02, -0.5, 0.2], [1.98, 0.3, -0.2])
    assert down.value_m == -found.value_m and down.words().startswith("the second is lower by 0.")
