"""Stripes with known truth, their sensor, and the bound of the accuracy of their centres.

Nothing here shares code with the extraction under test: pixels are integrated by quadrature; noise
is Poisson electrons, Gaussian read noise, rounding and clipping.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtr  # type: ignore[import-untyped]
from scipy.stats import poisson  # type: ignore[import-untyped]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
"""Gauss-Legendre over a pixel: exact to 1e-12 for stripes from 0.7 px on."""
_REACH = 6.5
"""Standard deviations to which a stripe is rendered: beyond is 1e-9 of its peak."""


class Sensor(NamedTuple):
    """Noise of one frame, and the light that is always there."""

    read_dn: float = 1.0
    electrons_per_dn: float = 40.0
    ambient_dn: float = 10.0
    black_dn: float = 0.0
    """Level of a pixel without light."""

    def background_variance(self) -> float:
        """Variance of a pixel beside the stripe, with that of rounding [DN^2]."""
        return self.read_dn**2 + self.ambient_dn / self.electrons_per_dn + 1 / 12

    @classmethod
    def of_difference(cls, sigma_dn: float) -> "Sensor":
        """The sensor whose difference of two dark frames has this standard deviation [DN], all told."""
        usual = cls()
        return usual._replace(
            read_dn=float(np.sqrt(0.5 * sigma_dn**2 - usual._replace(read_dn=0).background_variance()))
        )


class Frames(NamedTuple):
    """Pairs of frames uint8 [frames, rows, columns], and the truth [frames, rows]."""

    on: np.ndarray
    off: np.ndarray
    u: np.ndarray


def stripe_level(u: np.ndarray, column: np.ndarray, width: float, amplitude: float) -> np.ndarray:
    """Mean over a pixel of a Gaussian stripe [DN]; `u` and `column` broadcast."""
    total = np.zeros(np.broadcast_shapes(u.shape, column.shape))
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        total += 0.5 * weight * np.exp(-0.5 * ((column + 0.5 * node - u) / width) ** 2)
    return amplitude * total


def expose(level: np.ndarray, sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """One exposure of an expected light [DN above black], uint8."""
    electrons = rng.poisson(np.maximum(level, 0.0) * sensor.electrons_per_dn)
    noisy = electrons / sensor.electrons_per_dn + sensor.read_dn * rng.standard_normal(level.shape) + sensor.black_dn
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def expose_evenly(shape: tuple[int, ...], sensor: Sensor, rng: np.random.Generator) -> np.ndarray:
    """Exposures of the ambient light alone, uint8: the law of `expose`, by inversion, far faster.

    16 random bits choose the code from a table; where they do not suffice, because a step of the
    cumulative distribution lies between them and the next, more are drawn.
    """
    electrons = np.arange(poisson.isf(1e-15, sensor.ambient_dn * sensor.electrons_per_dn) + 1)
    chance = poisson.pmf(electrons, sensor.ambient_dn * sensor.electrons_per_dn)
    edges = np.arange(255) + 0.5
    steps = chance @ ndtr((edges[None, :] - electrons[:, None] / sensor.electrons_per_dn) / sensor.read_dn)
    low = np.searchsorted(steps, np.arange(65536) / 65536, side="right")
    high = np.searchsorted(steps, np.arange(1, 65537) / 65536, side="left")
    table = low.astype(np.uint8)
    bits = rng.integers(0, 65536, shape, np.uint16)
    codes = table[bits]
    open_ = (low != high)[bits]
    share = (bits[open_] + rng.random(np.count_nonzero(open_))) / 65536
    codes[open_] = np.searchsorted(steps, share, side="right")
    return codes


def scattered_course(frames: int, rows: int, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Centres [frames, rows] on slanted lines, each row moved by up to half a pixel.

    Phases are uniform and independent, so that nothing can be learnt about a row from its
    neighbours but roughly where to look.
    """
    slope = rng.uniform(-0.06, 0.06, (frames, 1))
    middle = rng.uniform(0.35, 0.65, (frames, 1)) * columns
    return middle + slope * (np.arange(rows) - rows / 2) + rng.uniform(-0.5, 0.5, (frames, rows))


def curved_course(frames: int, rows: int, columns: int, rng: np.random.Generator) -> np.ndarray:
    """Centres [frames, rows] of continuous, gently curved stripes."""
    v = (np.arange(rows) - rows / 2) / rows
    middle, tilt, sag = (rng.uniform(low, high, (frames, 1)) for low, high in ((0.3, 0.7), (-0.1, 0.1), (-0.15, 0.15)))
    return columns * (middle + tilt * v + sag * v**2)


def render(
    u: np.ndarray, width: float, amplitude: float, columns: int, sensor: Sensor, rng: np.random.Generator
) -> Frames:
    """Pairs of frames with a stripe at `u` [frames, rows]."""
    on, off = (expose_evenly((*u.shape, columns), sensor, rng) for _ in range(2))
    half = int(np.ceil(_REACH * width + 1))
    column = np.rint(u).astype(np.int64)[..., None] + np.arange(-half, half + 1)
    if column.min() < 0 or column.max() >= columns:
        raise ValueError(f"The stripe leaves the image of {columns} columns.")
    level = sensor.ambient_dn + stripe_level(u[..., None], column, width, amplitude)
    np.put_along_axis(on, column, expose(level, sensor, rng), -1)
    return Frames(on, off, u)


def centre_bound(width: float, amplitude: float, sensor: Sensor) -> float:
    """Cramer-Rao bound of the centre [px], root mean square over its phase.

    Amplitude and width are unknown too; a clipped pixel tells nothing. The variance of a sample of
    the difference is the sum of both frames' with rounding, and the stripe's own shot noise. The
    information in the change of that variance with the centre is neglected: less than 1e-3 at 40 e-/DN.
    """
    half = int(np.ceil(_REACH * width + 2))
    column = np.arange(-half, half + 1).astype(float)
    variances = []
    for phase in np.linspace(-0.5, 0.5, 40, endpoint=False):
        truth = np.array([phase, width, amplitude])

        def level(at):
            return stripe_level(np.array([at[0]]), column, at[1], at[2])

        slopes = np.stack([(level(truth + d) - level(truth - d)) / 2e-4 for d in 1e-4 * np.eye(3)], -1)
        stripe = level(truth)
        variance = 2 * sensor.background_variance() + stripe / sensor.electrons_per_dn
        seen = stripe + sensor.ambient_dn < 254.5
        variances.append(np.linalg.inv(slopes[seen].T @ (slopes[seen] / variance[seen, None]))[0, 0])
    return float(np.sqrt(np.mean(variances)))
