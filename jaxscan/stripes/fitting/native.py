"""`fit_candidates` for a CPU, natively, many times faster than XLA's code; a test holds the two equal."""

import threading

import numpy as np

from jaxscan.stripes.fitting import albedo, fit_blocks, gaussian_fit, window
from jaxscan.stripes.fitting.loops import LANES, ROWS, FitMemory, FitNumbers, fit_lists
from jaxscan.stripes.frames import decode_table
from jaxscan.stripes.search import Located, Search
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes, MeasuredLines, stripes_of_zeros


_STEPS = 1020
"""Steps of a table of the variance of rounding: four of them are one DN."""


class NativeFitter(threading.local):
    """Fits candidates; keeps its memory. Every thread has its own; a result is good until the next call in it."""

    def __init__(self) -> None:
        self._memory: FitMemory | None = None
        self._found: FrameStripes | None = None

    def fit(self, located: Located, lamp_ratio: np.ndarray, search: Search, setup: ExtractionSetup) -> MeasuredLines:
        """Fit every candidate; arguments as of `fit_candidates`, NumPy arrays in blocks of `LANES`."""
        sizes = [found.start.size for found in located.lists]
        if self._memory is None or self._found is None or len(self._found.u) != sum(sizes):
            samples = max(found.on.shape[1] for found in located.lists)
            windows = [np.zeros((samples, LANES), np.float32) for _ in range(2)]
            self._memory = FitMemory(np.zeros(ROWS * LANES, np.float32), *windows)
            self._found = stripes_of_zeros((sum(sizes),))
        levels, slopes = decode_table(setup.frames.response)
        even = np.linspace(0.0, 255.0, _STEPS + 1)
        table = np.interp(even, levels, slopes**2 / 12).astype(np.float32)
        fit_lists(located.lists, np.asarray(lamp_ratio), fit_numbers(search, setup), table, self._memory, self._found)
        return MeasuredLines(self._found, located.slots)


def fit_numbers(search: Search, setup: ExtractionSetup) -> FitNumbers:
    """All numbers of a fit, float32."""
    settings, pitch = setup.settings, setup.sites.pitch
    numbers = {
        "read_variance": float(search.read_dn) ** 2,
        "per_dn": 1.0 / float(search.electrons_per_dn),
        "black": search.black_dn,
        "speckle": search.speckle,
        "log_width": search.log_width,
        "width_information": search.width_information,
        "pitch": pitch,
        "filter_variance": window.FILTER_VARIANCE[pitch],
        "max_width": settings.max_width_px,
        "min_width": settings.min_width_px,
        "least_snr": settings.least_snr,
        "max_sigma": settings.max_sigma_px,
        "max_chi2": settings.max_chi2,
        "max_misfit": settings.max_misfit,
        "rest": fit_blocks.REST,
        "smallest": gaussian_fit.SMALLEST,
        "small_step": gaussian_fit.SMALL_STEP,
        "min_width_told": gaussian_fit.MIN_WIDTH_PX,
        "certain": albedo.CERTAIN,
        "floor": albedo.FLOOR,
        "last_sample": pitch * (setup.plane_size[1] - 1),
    }
    return FitNumbers(
        **{name: np.float32(number) for name, number in numbers.items()},
        iterations=settings.iterations,
        clipped_iterations=settings.clipped_iterations,
        guard_edges=settings.guard_edges,
        linear=setup.frames.response == "linear",
    )
