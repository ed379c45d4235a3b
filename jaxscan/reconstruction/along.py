"""The centres of a sweep, smoothed along its stripes."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.stripes import ProfileRows, Sites, Smoothed, Stripes, row_scatter, smooth_profiles


_PROFILES = 32
"""Profiles smoothed at a time."""
_ALL_LINES: Mapping[int, Sites] = MappingProxyType({})
_COMMON_LINES = 10
"""Lines on either side with which an error is shared: half of a window."""


class SmoothedSweep(NamedTuple):
    """Centres of a sweep that use their neighbours, and those of the rows; grid [profiles, lines]."""

    u: Float[np.ndarray, "profiles lines"]
    """Smoothed centre [px]."""
    sigma: Float[np.ndarray, "profiles lines"]
    """Its standard deviation [px]."""
    shift: Float[np.ndarray, "profiles lines"]
    """Centre of the row itself minus the smoothed one [px]."""
    sigma_row: Float[np.ndarray, "profiles lines"]
    """Standard deviation of the row's own centre [px], as the scatter of the rows has it; where next rows are alike it
    is so much larger that an average computed as of independent rows is as good as stated."""
    shared_lines: Float[np.ndarray, "profiles lines"]
    """As of `Smoothed`."""

    def beside(self, rows: np.ndarray, sigma_random: Float[np.ndarray, "some lines"]) -> dict[str, np.ndarray]:
        """The fields that a cloud has beside its points, of some profiles.

        Args:
            rows: The profiles.
            sigma_random: Of their points, along the ray [m]; 0 where there is none.
        """
        exists = sigma_random > 0
        # The same factor turns both sigmas from px into m.
        ratio = self.sigma_row[rows] / np.where(exists, self.sigma[rows], 1)
        shift, shared = (np.where(exists, field[rows], 0) for field in (self.shift, self.shared_lines))
        return {"sigma_row": sigma_random * ratio, "shift_px": shift, "shared_lines": shared}


def smooth_sweep(stripes: Stripes, sites: Mapping[int, Sites] = _ALL_LINES) -> SmoothedSweep:
    """Smooth the centres of all profiles, with sigmas that the scatter of neighbouring rows confirms.

    Args:
        stripes: One centre of a line at most.
        sites: Where the colour of each laser is seen; on all lines where not given.

    Returns:
        Centres and sigmas, float32.
    """
    u, sigma, valid = (np.asarray(field) for field in (stripes.u, stripes.sigma, stripes.valid))
    u, sigma, laser = u.astype(np.float32), sigma.astype(np.float32), np.asarray(stripes.laser)
    amplitude = np.asarray(stripes.amplitude, np.float32)
    found = SmoothedSweep(*(np.zeros(u.shape, np.float32) for _ in SmoothedSweep._fields))
    # Noise and colour are those of a laser.
    for number in np.unique(laser):
        own = np.flatnonzero(laser == number)
        part = _smooth(ProfileRows(u[own], sigma[own], valid[own], amplitude[own]), sites.get(int(number), Sites()))
        for to, field in zip(found, part, strict=True):
            to[own] = field
    return found


def _smooth(rows: ProfileRows, sites: Sites) -> SmoothedSweep:
    """The profiles of one laser."""
    scatter = row_scatter(rows, sites.line_step)
    u, valid = rows.u, rows.valid
    sigma = rows.sigma * scatter.scale

    def smooth(start: int) -> Smoothed:
        part = slice(start, start + _PROFILES)
        return smooth_profiles(u[part], sigma[part], valid[part], sites)

    parts = map_ahead(smooth, range(0, len(u), _PROFILES), workers())
    found = Smoothed(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))
    # The mean of many rows whose next neighbours are alike: 1 + 2 r times the variance of independent ones.
    alike = np.float32(np.sqrt(1 + 2 * scatter.correlation))
    common = _spread_out(np.where(valid, scatter.common * sigma**2, 0), valid, _COMMON_LINES * sites.line_step)
    sigma = np.maximum(sigma, np.sqrt(common))
    stated = np.minimum(np.sqrt((found.sigma * alike) ** 2 + common), sigma)
    return SmoothedSweep(found.u, stated, np.where(valid, u - found.u, 0), sigma * alike, found.shared_lines)


def _spread_out(
    variance: Float[np.ndarray, "profiles lines"], valid: Bool[np.ndarray, "profiles lines"], reach: int
) -> Float[np.ndarray, "profiles lines"]:
    """A variance that neighbours share, also of those of them that do not know: at least its mean over the window."""
    if not variance.any():
        return variance

    def total(field: np.ndarray) -> np.ndarray:
        sums = np.pad(np.cumsum(field, 1, dtype=np.float32), ((0, 0), (reach + 1, reach)), mode="edge")
        sums[:, : reach + 1] = 0
        return sums[:, 2 * reach + 1 :] - sums[:, : -2 * reach - 1]

    mean = total(variance) / np.maximum(total(valid), 1)
    return np.where(valid, np.maximum(variance, mean), 0)
