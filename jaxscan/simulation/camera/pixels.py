"""Pixels that differ: in gain, in offset, and some that are hot. They are the camera's own: the same in all frames."""

from functools import lru_cache

import numpy as np

from jaxscan.simulation.settings import SensorSpec, SimulationConfig


_STREAM = 5
"""Of random numbers that are drawn from the configuration's seed."""


def flawed(light: np.ndarray, config: SimulationConfig) -> np.ndarray:
    """Light as the camera's pixels count it: times their gain, plus their offset.

    Args:
        light: Linear light in DN, float32 [rows, columns] (rgb8: and 3).
        config: The camera, and the seed of its flaws.
    """
    sensor = config.sensor
    if sensor.gain_spread == sensor.offset_spread_dn == sensor.hot_pixels == 0:
        return light
    gain, offset = _flaws(sensor, light.shape, config.seed)
    return light * gain + offset


@lru_cache(maxsize=4)
def _flaws(sensor: SensorSpec, shape: tuple[int, ...], seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, _STREAM])))
    gain = 1 + np.float32(sensor.gain_spread) * rng.standard_normal(shape, np.float32)
    offset = np.float32(sensor.offset_spread_dn) * rng.standard_normal(shape, np.float32)
    # Dark currents of hot pixels reach over decades.
    hot = rng.random(shape, np.float32) < sensor.hot_pixels
    offset[hot] += np.float32(sensor.hot_dn) * rng.standard_exponential(int(hot.sum()), np.float32)
    return np.maximum(gain, np.float32(0)), offset
