"""Frames with Gaussian stripes at known places, and the noise of a sensor: nothing here is code under test."""

import numpy as np


READ_DN, ELECTRONS_PER_DN = 1.0, 40.0
WIDTH_PX = 1.5


def stripe(u, seen, amplitude, columns):
    """Light of one stripe per line [DN], [frames, lines, columns]; amplitude by line, or one for all."""
    inside = (np.arange(8) + 0.5) / 8 - 0.5
    x = np.arange(columns)[:, None] + inside - u[..., None, None]
    light = np.exp(-0.5 * (x / WIDTH_PX) ** 2).mean(-1)
    return np.where(seen, np.broadcast_to(amplitude, u.shape), 0.0)[..., None] * light


def expose(light, seed=0):
    """What a sensor makes of light [DN]."""
    rng = np.random.default_rng(seed)
    level = rng.poisson(light * ELECTRONS_PER_DN) / ELECTRONS_PER_DN + READ_DN * rng.normal(size=light.shape)
    return np.clip(np.round(level), 0, 255).astype(np.uint8)


def pairs(light, ambient=12.0, seed=0):
    """Laser-on and laser-off frames of stripes in an evenly lit room."""
    return expose(light + ambient, seed), expose(np.full(light.shape, ambient), seed + 1)
