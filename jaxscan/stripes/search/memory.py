"""Rules and memory of the native search."""

from typing import NamedTuple

import numpy as np


class Rules(NamedTuple):
    """How candidates are found: the search, the samples, and the constants of `candidates`."""

    low: np.ndarray
    high: np.ndarray
    thresholds: np.ndarray
    levels: np.ndarray
    pitch: int
    saturation: int
    candidates: int
    half_span: int
    zone_span: int
    fine_shift: int
    bin_extent: np.float32


class Scratch(NamedTuple):
    """Of one line: the lattice, the fine filter, the response, and the highest response of each group; then of all
    candidates of both lists [2, n]: line, place, extent, samples taken as one."""

    lattice: np.ndarray
    fine: np.ndarray
    response: np.ndarray
    highest: np.ndarray
    line: np.ndarray
    place: np.ndarray
    extent: np.ndarray
    bins: np.ndarray
