"""Stripes whose truth is known: rendered by numerical integration, with the noise of a sensor.

Nothing here comes from the code under test.
"""

from dataclasses import dataclass

import numpy as np
import pytest


SUBSAMPLES = 32


def stripe_profile(u, width, amplitude, columns, pitch=1, first=0):
    """Mean level over each pixel of a Gaussian stripe, [rows, samples], by the midpoint rule."""
    centre = first + pitch * np.arange(columns)
    inside = (np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5
    total = np.zeros((len(u), columns))
    for step in inside:
        total += np.exp(-0.5 * ((centre[None, :] + step - u[:, None]) / width) ** 2)
    return amplitude * total / SUBSAMPLES


@dataclass
class Sensor:
    """Shot noise, read noise, rounding, clipping."""

    read_dn: float = 1.0
    electrons_per_dn: float = 40.0
    seed: int = 0

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)

    def expose(self, level):
        electrons = self.rng.poisson(np.maximum(level, 0.0) * self.electrons_per_dn)
        noisy = electrons / self.electrons_per_dn + self.read_dn * self.rng.normal(size=np.shape(level))
        return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


@dataclass
class Scene:
    """One pair of frames [1, rows, columns] and the truth of every row."""

    on: np.ndarray
    off: np.ndarray
    u: np.ndarray


def kept(render):
    """A scene is rendered once for all tests, which may not change it."""
    drawn = {}

    def of(width, amplitude, *, u=None, **words):
        key = (width, amplitude, None if u is None else u.tobytes(), *sorted(words.items()))
        if key not in drawn:
            drawn[key] = render(width, amplitude, u=u, **words)
            for array in vars(drawn[key]).values():
                array.flags.writeable = False
        return drawn[key]

    return of


@kept
def render_stripes(width, amplitude, *, rows=2048, columns=96, ambient=10.0, seed=0, u=None, noise=True):
    """A frame with one stripe per row, at random phases unless `u` is given."""
    sensor = Sensor(seed=seed)
    if u is None:
        u = sensor.rng.uniform(columns / 2 - 8, columns / 2 + 8, rows)
    on = stripe_profile(u, width, amplitude, columns) + ambient
    off = np.full_like(on, ambient)
    if noise:
        return Scene(sensor.expose(on)[None], sensor.expose(off)[None], u)
    quantise = lambda level: np.clip(np.round(level), 0, 255).astype(np.uint8)[None]
    return Scene(quantise(on), quantise(off), u)


def centre_bound(width, amplitude, *, ambient=10.0, read_dn=1.0, electrons_per_dn=40.0, columns=61, has_off=True):
    """Cramer-Rao bound of the centre [px], root mean square over its phase.

    Amplitude and width (and the background, without a laser-off frame) are unknown too; clipped
    pixels tell nothing.
    """
    bounds = []
    for phase in np.linspace(-0.5, 0.5, 20, endpoint=False):
        truth = np.array([columns // 2 + phase, width, amplitude])
        level = lambda p: stripe_profile(p[:1], p[1], p[2], columns)[0]
        step = 1e-4 * np.eye(3)
        jacobian = np.stack([(level(truth + d) - level(truth - d)) / 2e-4 for d in step], 1)
        if not has_off:
            jacobian = np.column_stack([jacobian, np.ones(columns)])
        stripe, frames = level(truth), 2 if has_off else 1
        variance = frames * (read_dn**2 + ambient / electrons_per_dn + 1 / 12) + stripe / electrons_per_dn
        seen = stripe + ambient < 254.5
        information = jacobian[seen].T @ (jacobian[seen] / variance[seen, None])
        bounds.append(np.linalg.inv(information)[0, 0])
    return float(np.sqrt(np.mean(bounds)))


@pytest.fixture(scope="session")
def render():
    return render_stripes


@pytest.fixture(scope="session")
def profile():
    return stripe_profile


@pytest.fixture(scope="session")
def bound():
    return centre_bound


@pytest.fixture(scope="session")
def sensor():
    return Sensor
