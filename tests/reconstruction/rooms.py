"""Short sweeps of a furnished, textured room, with and without the laser; nothing here is code under test."""

import itertools
import tomllib
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.simulation import SimulationConfig, develop, expect_sweep, expose, true_scanner


WIDTH, HEIGHT, STEPS = 320, 256, 24


class Room(NamedTuple):
    """A sweep, its rig, and where the stripe is."""

    on: np.ndarray
    off: np.ndarray
    dark: np.ndarray
    """A second laser-off frame of every step: a laser-on frame of a laser that is not lit."""
    angles: np.ndarray
    light: np.ndarray
    """The laser's light without noise [DN], [steps, rows, columns]."""
    scanner: Scanner

    def lit(self, u: np.ndarray, valid: np.ndarray) -> np.ndarray:
        """Of stripes [steps, rows] those that lie on the laser's light: 2 DN of it within 2 px."""
        at = np.clip(np.rint(u).astype(int)[..., None] + np.arange(-2, 3), 0, WIDTH - 1)
        return valid & (np.take_along_axis(self.light, at, 2).max(-1) >= 2.0)


def room(pixel_format: str, peak_dn: float, *, seed: int, yaw_deg: float, white_dn: float = 130.0) -> Room:
    """The demo's rig at half its size, 24 steps of 2 degrees from a yaw on."""
    config = tomllib.loads(files("jaxscan.data").joinpath("demo.toml").read_text())
    camera = config["camera"]
    camera.update(width=WIDTH, height=HEIGHT, **{key: camera[key] / 2 for key in ("fx", "fy", "cx", "cy")})
    config["sensor"]["pixel_format"] = pixel_format
    config["laser"]["peak_dn"] = peak_dn
    config["room"]["yaw_deg"] = yaw_deg
    config["light"]["white_dn"] = white_dn
    spec = SimulationConfig(**config)
    rng = np.random.default_rng(seed)
    expected = list(itertools.islice(expect_sweep(spec), STEPS))
    records = [develop(one, spec, rng) for one in expected]
    on, off = (np.stack(frames) for frames in zip(*((one.on, one.off) for one in records), strict=True))
    dark = np.stack([expose(one.off, spec.sensor, rng) for one in expected])
    light = np.stack([one.laser if one.laser.ndim == 2 else one.laser.max(-1) for one in expected])
    if pixel_format.startswith("bayer"):
        # Where a mosaic has another colour, the light of the laser's pixels around.
        light = np.maximum.reduce([np.roll(light, (i, j), (1, 2)) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    angles = np.array([one.angle for one in records])
    return Room(on, off, dark, angles, light, true_scanner(spec))


def moving_light(frames: np.ndarray, seed: int) -> np.ndarray:
    """Frames in which a soft shadow of a few per cent moves about."""
    rng = np.random.default_rng([seed, 2])
    x = np.linspace(0.0, 1.0, frames.shape[2])[None, None, :]
    centre = rng.uniform(0.0, 1.0, (len(frames), 1, 1))
    shade = 1.0 - 0.06 * np.exp(-0.5 * ((x - centre) / 0.15) ** 2)
    shade = shade if frames.ndim == 3 else shade[..., None]
    return np.clip(np.rint(frames * shade), 0, 255).astype(np.uint8)
