"""The centres of a sweep, smoothed along its stripes."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy.lib.stride_tricks import sliding_window_view

from jaxscan.reconstruction.ahead import Progress, map_ahead, workers
from jaxscan.reconstruction.sweep import place
from jaxscan.stripes import ProfileRows, ScatterLaw, Sites, Stripes, mosaic_wave, scatter_law, smooth_profiles


_PROFILES = 32
"""Profiles smoothed at a time."""
_ALL_LINES: Mapping[int, Sites] = MappingProxyType({})
_COMMON_LINES = 10
"""Lines on either side with which an error is shared: half of a window."""
_SIDE = 6
"""Sites on either side of a row from which its slope and the change of its brightness are taken."""


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
    """See `Smoothed`."""


def smooth_sweep(stripes: Stripes, sites: Mapping[int, Sites] = _ALL_LINES, progress: Progress = None) -> SmoothedSweep:
    """Smooth the centres of all profiles, with sigmas that the scatter of neighbouring rows confirms.

    Args:
        stripes: One centre of a line at most.
        sites: Where the colour of each laser is seen; on all lines where not given.
    """
    rows = ProfileRows(
        np.array(stripes.u, np.float32),
        np.asarray(stripes.sigma, np.float32),
        np.asarray(stripes.valid),
        np.asarray(stripes.amplitude, np.float32),
    )
    width = np.asarray(stripes.width, np.float32)
    found, done = SmoothedSweep(*(np.zeros(rows.u.shape, np.float32) for _ in SmoothedSweep._fields)), 0
    for laser in np.unique(np.asarray(stripes.laser)).tolist():
        # Noise and colour are those of a laser.
        own, seen = np.flatnonzero(np.asarray(stripes.laser) == laser), sites.get(laser, Sites())
        law = scatter_law(_taken(rows, own), seen.line_step)
        wave = mosaic_wave(_taken(rows, own), law.correlation.near, seen.line_step)
        if wave is not None:
            rows.u[own] -= wave.error
            law = scatter_law(_taken(rows, own), seen.line_step).with_mosaic(wave.left_px)
        blocks = [own[start : start + _PROFILES] for start in range(0, len(own), _PROFILES)]
        smooth = lambda block, law=law, seen=seen: _smooth(_taken(rows, block), width[place(block)], law, seen)
        for block, part in zip(blocks, map_ahead(smooth, blocks, workers()), strict=True):
            for to, field in zip(found, part, strict=True):
                to[place(block)] = field
            done += len(block)
            if progress is not None:
                progress(done, len(rows.u))
    return found


def _taken(rows: ProfileRows, profiles: np.ndarray) -> ProfileRows:
    return ProfileRows(*(field[place(profiles)] for field in rows))


def _smooth(rows: ProfileRows, width: np.ndarray, law: ScatterLaw, sites: Sites) -> SmoothedSweep:
    """Profiles of one laser."""
    scatter = law.of(rows)
    u, valid = rows.u, rows.valid
    sigma = rows.sigma * scatter.scale
    found = smooth_profiles(u, sigma, valid, sites, scatter.correlation)
    common = _spread_out(np.where(valid, scatter.common * sigma**2, 0), valid, _COMMON_LINES * sites.line_step)
    sigma = np.maximum(sigma, np.sqrt(common))
    stated = np.minimum(np.sqrt(found.sigma**2 + common), sigma)
    alone = sigma * np.sqrt(found.alike)
    pull = _pull(found.u, width, rows, sites)
    return SmoothedSweep(found.u - pull, stated, np.where(valid, u - found.u, 0), alone, found.shared_lines)


def _pull(u: np.ndarray, width: np.ndarray, rows: ProfileRows, sites: Sites) -> np.ndarray:
    r"""How far brighter neighbours pull centres [px].

    A stripe of width w is as wide along the image's lines as across: light of line v + k comes to line v with a weight
    that falls as a Gaussian. Where its slope is s and its amplitude A, the centre moves by $w^2 s A' / A$, with w
    measured at right angles to it. At an edge the less steep side counts.
    """
    found = np.zeros_like(u)
    step, lines = sites.line_step, slice(sites.first_line, None, sites.line_step)
    u, width, valid, amplitude = (field[:, lines] for field in (u, width, rows.valid, rows.amplitude))
    size = 2 * _SIDE + 1
    if u.shape[1] < size:
        return found
    middle = slice(_SIDE, -_SIDE)
    there = sliding_window_view(valid, size, 1).all(2)
    before, after = u[:, middle] - u[:, : -2 * _SIDE], u[:, 2 * _SIDE :] - u[:, middle]
    rise = np.where(before * after > 0, np.sign(after) * np.minimum(np.abs(before), np.abs(after)), 0)
    slope = rise / (_SIDE * step)
    k = np.arange(-_SIDE, _SIDE + 1, dtype=u.dtype)
    brighter = sliding_window_view(np.log(np.maximum(amplitude, 1)), size, 1) @ (k / (step * (k @ k)))
    pulled = np.where(there, width[:, middle] ** 2 * slope / (1 + slope**2) * brighter, 0)
    found[:, lines][:, middle] = pulled
    return found


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
