"""The centres of a sweep, smoothed along its stripes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.stripes import Smoothed, Stripes, row_scatter, smooth_profiles


_PROFILES = 32
"""Profiles smoothed at a time."""


class SmoothedSweep(NamedTuple):
    """Centres of a sweep that use their neighbours, and what those of the rows were; grid [profiles, lines]."""

    u: Float[np.ndarray, "profiles lines"]
    """Smoothed centre [px]."""
    sigma: Float[np.ndarray, "profiles lines"]
    """Its standard deviation [px]."""
    shift: Float[np.ndarray, "profiles lines"]
    """Centre of the row itself minus the smoothed one [px]."""
    sigma_row: Float[np.ndarray, "profiles lines"]
    """Standard deviation of the row's own centre [px], as the scatter of the rows has it."""
    shared_lines: Float[np.ndarray, "profiles lines"]
    """As of `Smoothed`."""

    def beside(self, rows: np.ndarray, sigma_random: Float[np.ndarray, "some lines"]) -> dict[str, np.ndarray]:
        """The fields that a cloud has beside its points, of some profiles.

        Args:
            rows: The profiles.
            sigma_random: Of their points, along the ray [m]; 0 where there is none.
        """
        exists = sigma_random > 0
        # What turns px into m is the same for both sigmas.
        ratio = self.sigma_row[rows] / np.where(exists, self.sigma[rows], 1)
        shift, shared = (np.where(exists, field[rows], 0) for field in (self.shift, self.shared_lines))
        return {"sigma_row": sigma_random * ratio, "shift_px": shift, "shared_lines": shared}


def smooth_sweep(stripes: Stripes) -> SmoothedSweep:
    """Smooth the centres of all profiles, with sigmas that the scatter of neighbouring rows confirms."""
    u, sigma, valid = (np.asarray(field) for field in (stripes.u, stripes.sigma, stripes.valid))
    u, sigma = u.astype(np.float32), sigma.astype(np.float32)
    scatter = row_scatter(u, sigma, valid, np.asarray(stripes.amplitude, np.float32))
    sigma *= scatter.scale

    def smooth(start: int) -> Smoothed:
        part = slice(start, start + _PROFILES)
        return smooth_profiles(u[part], sigma[part], valid[part])

    parts = map_ahead(smooth, range(0, len(u), _PROFILES), workers())
    found = Smoothed(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    # The mean of many rows whose next neighbours are alike: 1 + 2 r times the variance of independent ones.
    alike = np.where(found.shared_lines > 1, np.sqrt(1 + 2 * scatter.correlation), 1)
    stated = np.minimum(found.sigma * alike, sigma).astype(np.float32)
    return SmoothedSweep(found.u, stated, np.where(valid, u - found.u, 0), sigma, found.shared_lines)
