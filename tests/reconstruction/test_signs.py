"""The table of signs of the design: the paper's rig, one pixel, two angles."""

import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, point_up, stack_lasers
from jaxscan.reconstruction import Sweep, reconstruct
from jaxscan.stripes import NoiseModel, Stripes


pytestmark = pytest.mark.more


WIDTH, HEIGHT = 2048, 1638
TR = np.array(
    [
        [0.9994, 4.0e-05, -0.0345, -7.3403e-3],
        [-1.845e-05, 0.9999997, 0.00063, 3.1e-9],
        [0.03458, -0.00063, 0.99940, 0.21142e-3],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
EXPECTED = {0.0: (2.663958, -0.165195, 0.009750), 30.0: (2.389653, 1.188916, 0.009750)}


@pytest.fixture(scope="module")
def paper() -> Scanner:
    camera = Pinhole(
        *(np.float64(x) for x in (2894.462, 2887.338, 1016.814, 817.261)), np.zeros(5), width=WIDTH, height=HEIGHT
    )
    turntable = point_up(Turntable.from_tr(TR), "-v")
    return Scanner(camera, stack_lasers([LaserSheet.from_abc(-7.606, -1.685, 1.296203)]), turntable)


@pytest.fixture(scope="module")
def angles(paper) -> np.ndarray:
    return np.radians(list(EXPECTED)) / float(paper.turntable.gain)


def check(cloud, tolerance):
    assert cloud.valid[:, 800].all()
    for point, expected in zip(cloud.xyz[:, 800], EXPECTED.values(), strict=True):
        np.testing.assert_allclose(point, expected, atol=tolerance)


@pytest.mark.more
def test_signs_from_stripes(paper, angles):
    shape = (2, HEIGHT)
    valid = np.zeros(shape, bool)
    valid[:, 800] = True
    # Poison wherever there is no stripe: nothing of it may come through.
    u = np.where(valid, 1200.0, np.nan)
    ones = np.where(valid, 1.0, np.nan)
    stripes = Stripes(u, ones, ones, ones, ones, ones, np.zeros(shape, np.uint8), valid, np.arange(2), np.zeros(2, int))
    frames = np.full((2, HEIGHT, WIDTH), 7, np.uint8)
    cloud = reconstruct(Sweep(frames, frames, angles), paper, stripes=stripes)
    # The table has six digits; float32 keeps 1e-6 of 2.7 m.
    check(cloud, 4e-6)
    assert cloud.valid.sum() == 2
    np.testing.assert_array_equal(cloud.rgb[:, 800], 7)
    assert not cloud.xyz[:, :800].any() and not cloud.sigma_random[:, 801:].any()


def test_signs_from_frames(paper, angles):
    on = np.zeros((2, HEIGHT, WIDTH), np.uint8)
    profile = 200.0 * np.exp(-0.5 * ((np.arange(WIDTH) - 1200.0) / 2.0) ** 2)
    on[:, 800] = np.round(profile)
    cloud = reconstruct(Sweep(on, np.zeros_like(on), angles), paper, noise=NoiseModel())
    # Rounding to whole DN moves the centre by less than 0.005 px, at 14 mm/px here.
    check(cloud, 1e-4)
