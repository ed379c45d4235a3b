"""`choose_stripes` for a CPU, natively; a test holds the two equal."""

import numpy as np

from jaxscan.stripes.choosing import path
from jaxscan.stripes.choosing.native_loops import PathMemory, PathNumbers, choose_lines
from jaxscan.stripes.search import Search
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import FrameStripes, MeasuredLines, stripes_of_zeros


_RULES = ("path", "brightest", "nearest", "farthest", "all")


class ChosenLines:
    """Stripes of the frames of a chunk, filled some frames at a time."""

    def __init__(self, frames: int, candidates: int, search: Search, setup: ExtractionSetup) -> None:
        """
        Args:
            frames: Of the chunk.
            candidates: Of a line.
            search: Which side is near.
            setup: Frames, laser and settings.
        """
        settings, sites = setup.settings, setup.sites
        self._each = candidates if setup.several else 1
        grid = (frames * self._each, setup.image_lines)
        self.stripes = stripes_of_zeros(grid)
        self._number = np.full((frames, setup.image_lines), -1, np.int8)
        self.number = self._number if setup.several and settings.choice != "all" else None
        lines = setup.plane_size[0]
        self._memory = PathMemory(np.zeros((lines, candidates + 1), np.int8), np.zeros(lines, np.int8))
        self._sites = sites.first_line, sites.line_step, np.asarray(sites.offsets, np.float32)
        numbers = (
            float(search.near_side),
            settings.min_snr,
            0.5 * (settings.min_snr**2 - settings.continued_snr**2),
            0.5 * settings.min_snr**2,
            *path.COSTS,
        )
        self._numbers = PathNumbers(_RULES.index(settings.choice), *(np.float32(number) for number in numbers))

    def put(self, first: int, found: MeasuredLines) -> None:
        """Choose among the candidates of the frames from `first` on."""
        count = len(found.slots)
        rows = slice(first * self._each, (first + count) * self._each)
        stripes = FrameStripes(*(field[rows] for field in self.stripes))
        out = stripes, self._number[first : first + count], self._each > 1
        choose_lines(found.measured, found.slots, self._numbers, self._memory, self._sites, out)
