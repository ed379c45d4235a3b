"""Which point a click means."""

import numpy as np

from jaxscan.viewer.picking import pick


CONE = 0.01
WALL = np.stack(np.meshgrid([2.0], np.linspace(-1, 1, 201), np.linspace(-1, 1, 201), indexing="ij"), -1).reshape(-1, 3)
X = np.array([1.0, 0.0, 0.0])


def test_the_point_nearest_to_the_ray():
    index = pick(WALL, np.zeros(3), np.array([2.0, 0.304, -0.196]), cone_rad=CONE)
    np.testing.assert_allclose(WALL[index], [2.0, 0.30, -0.20], atol=1e-9)


def test_the_wall_in_front_hides_the_one_behind():
    both = np.concatenate([WALL + 0.003 * X + [1.0, 0.0, 0.0], WALL])
    assert both[pick(both, np.zeros(3), X, cone_rad=CONE)][0] == 2.0
    # From behind it is the other way round, whatever the length of the direction.
    assert both[pick(both, 9 * X, -3 * X, cone_rad=CONE)][0] > 3.0


def test_nothing_there():
    assert pick(WALL, np.zeros(3), -X, cone_rad=CONE) is None
    assert pick(WALL, np.zeros(3), np.array([0.0, 0.0, 1.0]), cone_rad=CONE) is None
    assert pick(WALL, np.zeros(3), X, cone_rad=CONE, shown=np.zeros(len(WALL), bool)) is None
    assert pick(np.zeros((0, 3)), np.zeros(3), X, cone_rad=CONE) is None


def test_what_is_not_shown_is_not_picked():
    index = pick(WALL, np.zeros(3), X, cone_rad=CONE, shown=WALL[:, 1] > 0.005)
    np.testing.assert_allclose(WALL[index], [2.0, 0.01, 0.0], atol=1e-9)
