"""Short sweeps of a furnished, textured room, with and without the laser; nothing here is code under test."""

import itertools
import tomllib
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.simulation import SimulationConfig, expose, render_sweep, true_scanner


WIDTH, HEIGHT, STEPS = 320, 256, 24


class Room(NamedTuple):
    """A sweep, its rig, and where the stripe is."""

    on: np.ndarray
    off: np.ndarray
    dark: np.ndarray
    """A second laser-off frame of every step: a laser-on frame of a laser that is not lit."""
    angles: np.ndarray
    u: np.ndarray
    seen: np.ndarray
    scanner: Scanner


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
    records = list(itertools.islice(render_sweep(spec, seed=seed), STEPS))
    stack = lambda name: np.stack([getattr(record, name) for record in records])
    off, rng = stack("off"), np.random.default_rng([seed, 1])
    # Developed again: noisier than a frame, by its own noise.
    dark = expose(off.astype(np.float32), spec.sensor, rng)
    truth = [record.truth for record in records]
    u, seen = (np.stack([getattr(one, name) for one in truth]) for name in ("u", "valid"))
    return Room(stack("on"), off, dark, np.array([record.angle for record in records]), u, seen, true_scanner(spec))


def moving_light(frames: np.ndarray, seed: int) -> np.ndarray:
    """Frames in which a soft shadow of a few per cent moves about."""
    rng = np.random.default_rng([seed, 2])
    x = np.linspace(0.0, 1.0, frames.shape[2])[None, None, :]
    centre = rng.uniform(0.0, 1.0, (len(frames), 1, 1))
    shade = 1.0 - 0.06 * np.exp(-0.5 * ((x - centre) / 0.15) ** 2)
    shade = shade if frames.ndim == 3 else shade[..., None]
    return np.clip(np.rint(frames * shade), 0, 255).astype(np.uint8)
