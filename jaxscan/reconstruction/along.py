"""The centres of a sweep, smoothed along its stripes."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.reconstruction.ahead import Progress, map_ahead, workers
from jaxscan.reconstruction.sweep import place
from jaxscan.stripes import ProfileRows, ScatterLaw, Sites, Stripes, scatter_law, smooth_profiles


_PROFILES = 32
"""Profiles smoothed at a time."""
_ALL_LINES: Mapping[int, Sites] = MappingProxyType({})
_COMMON_LINES = 10
"""Lines on either side with which an error is shared: half of a window."""


class SmoothedSweep(NamedTuple):
    """Centres of a sweep that use their neighbours, and those of the rows; float32 on the grid [profiles, lines]."""

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


def smooth_sweep(stripes: Stripes, sites: Mapping[int, Sites] = _ALL_LINES, progress: Progress = None) -> SmoothedSweep:
    """Smooth the centres of all profiles, with sigmas that the scatter of neighbouring rows confirms.

    Args:
        stripes: One centre of a line at most.
        sites: Where the colour of each laser is seen; on all lines where not given.
    """
    rows = ProfileRows(
        np.asarray(stripes.u, np.float32),
        np.asarray(stripes.sigma, np.float32),
        np.asarray(stripes.valid),
        np.asarray(stripes.amplitude, np.float32),
    )
    found, done = SmoothedSweep(*(np.zeros(rows.u.shape, np.float32) for _ in SmoothedSweep._fields)), 0
    for laser in np.unique(np.asarray(stripes.laser)).tolist():
        # Noise and colour are those of a laser.
        own, seen = np.flatnonzero(np.asarray(stripes.laser) == laser), sites.get(laser, Sites())
        law = scatter_law(_taken(rows, own), seen.line_step)
        blocks = [own[start : start + _PROFILES] for start in range(0, len(own), _PROFILES)]
        smooth = lambda block, law=law, seen=seen: _smooth(_taken(rows, block), law, seen)
        for block, part in zip(blocks, map_ahead(smooth, blocks, workers()), strict=True):
            for to, field in zip(found, part, strict=True):
                to[place(block)] = field
            done += len(block)
            if progress is not None:
                progress(done, len(rows.u))
    return found


def _taken(rows: ProfileRows, profiles: np.ndarray) -> ProfileRows:
    return ProfileRows(*(field[place(profiles)] for field in rows))


def _smooth(rows: ProfileRows, law: ScatterLaw, sites: Sites) -> SmoothedSweep:
    """Profiles of one laser."""
    scatter = law.of(rows)
    u, valid = rows.u, rows.valid
    sigma = rows.sigma * scatter.scale
    found = smooth_profiles(u, sigma, valid, sites, scatter.correlation)
    common = _spread_out(np.where(valid, scatter.common * sigma**2, 0), valid, _COMMON_LINES * sites.line_step)
    sigma = np.maximum(sigma, np.sqrt(common))
    stated = np.minimum(np.sqrt(found.sigma**2 + common), sigma)
    alone = sigma * np.sqrt(found.alike)
    return SmoothedSweep(found.u, stated, np.where(valid, u - found.u, 0), alone, found.shared_lines)


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
