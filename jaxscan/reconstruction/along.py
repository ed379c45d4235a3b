"""The centres of a sweep, smoothed along its stripes."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.stripes import ProfileRows, ScatterLaw, Sites, Stripes, scatter_law, smooth_profiles


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

    def beside(self, sigma_random: Float[np.ndarray, "profiles lines"]) -> dict[str, np.ndarray]:
        """The fields that a cloud has beside its points.

        Args:
            sigma_random: Of the points, along the ray [m]; 0 where there is none.
        """
        exists = sigma_random > 0
        # The same factor turns both sigmas from px into m.
        ratio = self.sigma_row / np.where(exists, self.sigma, 1)
        shift, shared = (np.where(exists, field, 0) for field in (self.shift, self.shared_lines))
        return {"sigma_row": sigma_random * ratio, "shift_px": shift, "shared_lines": shared}


class SweepSmoother:
    """Smooths profiles of a sweep, by what all its rows tell about their scatter; in threads and in any order."""

    def __init__(self, stripes: Stripes, sites: Mapping[int, Sites] = _ALL_LINES) -> None:
        """
        Args:
            stripes: One centre of a line at most.
            sites: Where the colour of each laser is seen; on all lines where not given.
        """
        self._rows = ProfileRows(
            np.asarray(stripes.u, np.float32),
            np.asarray(stripes.sigma, np.float32),
            np.asarray(stripes.valid),
            np.asarray(stripes.amplitude, np.float32),
        )
        laser = np.asarray(stripes.laser)
        numbers = [int(number) for number in np.unique(laser)]
        self._sites = {number: sites.get(number, Sites()) for number in numbers}
        # Noise and colour are those of a laser.
        self._laws = {
            number: scatter_law(self._of(np.flatnonzero(laser == number)), self._sites[number].line_step)
            for number in numbers
        }

    def smooth(self, laser: int, profiles: np.ndarray) -> SmoothedSweep:
        """Some profiles of a laser."""
        return _smooth(self._of(profiles), self._laws[laser], self._sites[laser])

    def _of(self, profiles: np.ndarray) -> ProfileRows:
        consecutive = len(profiles) > 0 and profiles[-1] - profiles[0] + 1 == len(profiles)
        part = slice(profiles[0], profiles[-1] + 1) if consecutive else profiles
        return ProfileRows(*(field[part] for field in self._rows))


def smooth_sweep(stripes: Stripes, sites: Mapping[int, Sites] = _ALL_LINES) -> SmoothedSweep:
    """Smooth the centres of all profiles, with sigmas that the scatter of neighbouring rows confirms.

    Args:
        stripes: One centre of a line at most.
        sites: Where the colour of each laser is seen; on all lines where not given.

    Returns:
        Centres and sigmas, float32.
    """
    smoother, laser = SweepSmoother(stripes, sites), np.asarray(stripes.laser)
    found = SmoothedSweep(*(np.zeros(np.shape(stripes.u), np.float32) for _ in SmoothedSweep._fields))
    blocks = []
    for number in np.unique(laser):
        own = np.flatnonzero(laser == number)
        blocks += [(int(number), own[start : start + _PROFILES]) for start in range(0, len(own), _PROFILES)]
    for (_, own), part in zip(blocks, map_ahead(lambda block: smoother.smooth(*block), blocks, workers()), strict=True):
        for to, field in zip(found, part, strict=True):
            to[own] = field
    return found


def _smooth(rows: ProfileRows, law: ScatterLaw, sites: Sites) -> SmoothedSweep:
    """Profiles of one laser."""
    scatter = law.of(rows)
    u, valid = rows.u, rows.valid
    sigma = rows.sigma * scatter.scale
    found = smooth_profiles(u, sigma, valid, sites)
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
