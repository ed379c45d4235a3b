"""The calibration's part of the sigma of a measured number."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.geometry import DoubleSphere, Fisheye, LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.measurement.samples import Places, Samples
from jaxscan.measurement.systematic import systematic_sigma


MODELS = {Pinhole: [-0.06, 0.02, 4e-4, -3e-4, 0.0], Fisheye: [0.02, -0.005, 0.001, 0.0], DoubleSphere: [-0.2, 0.6]}
TABLE = Turntable.from_axis([0.01, -1.0, 0.02], [0.1, 0.0, -0.05])


@pytest.mark.parametrize("model", MODELS)
def test_sigma_is_the_change_by_a_step_of_the_calibration(model):
    """With the covariance c c^T a number's sigma is the size of its derivative along c."""
    rng, skew = np.random.default_rng(3), (np.asarray(0.0),) if model is Pinhole else ()
    numbers = (*map(np.asarray, (410.0, 411.0, 320.0, 250.0)), np.array(MODELS[model]))
    lens = model(*numbers, 640, 512, *skew)
    rig = Scanner.from_parts(lens, LaserSheet.from_plane([2.2, 0.1, 0.3], 1.0), TABLE)
    q, angle, weights = rng.uniform([340, 100], [600, 400], (40, 2)), rng.uniform(-1, 1, 40), rng.normal(size=(40, 3))
    step = rng.normal(size=len(rig.parameter_names())) * 1e-3

    def number(scanner):
        points = jax.vmap(lambda q, phi: scanner.point(q, 0, phi)[0])(jnp.asarray(q), jnp.asarray(angle))
        return points, float((points * weights).sum())

    points, _ = number(rig)
    h = 1e-3
    derivative = (number(rig.retract(h * step))[1] - number(rig.retract(-h * step))[1]) / (2 * h)
    ones, index = np.ones(40), np.zeros(40, int)
    samples = Samples(np.asarray(points), ones, index, angle, index, index, ones, ones, index, np.zeros((40, 3)))
    places = Places(np.zeros(1, int), np.eye(4)[None], np.zeros((1, 6, 6)))
    known = Scanner(rig.camera, rig.lasers, rig.turntable, np.outer(step, step), rig.laser_names, rig.up)
    # Central differences of a smooth function, over a step of a thousandth of a thousandth.
    assert systematic_sigma(known, places, samples, weights) == pytest.approx(abs(derivative), rel=1e-6)
