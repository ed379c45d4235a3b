"""The default estimator: maxima of two matched filters, each fitted with a pixel-integrated Gaussian."""

import functools

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.estimators.estimator import Found
from jaxscan.stripes.fitting import fit_candidates
from jaxscan.stripes.search import CANDIDATES, Located, Planes, Search, locate
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import Choice, MeasuredLines


_AT_ONCE = 4
"""Frames that are searched before their candidates are fitted: their windows stay in a core's own cache."""


class Gaussian:
    """Locate by matched filters, fit by maximum likelihood."""

    candidates = CANDIDATES
    choices: tuple[Choice, ...] = ("path", "brightest", "nearest", "farthest", "all")
    learns = True

    def locate(self, planes: Planes, search: Search, setup: ExtractionSetup) -> Located:
        """The highest maxima of every line, by XLA."""
        return locate(planes, search, pitch=setup.sites.pitch, saturation=setup.settings.saturation)

    def find_natively(self, planes: Planes, search: Search, setup: ExtractionSetup) -> Found:
        """The same maxima, fits and choice, many times faster on a CPU: some frames at a time, while they are near."""
        locator, fitter, chosen_lines = _native()
        on, off = np.asarray(planes.on), np.asarray(planes.off)
        frames = len(on)
        chosen = chosen_lines(frames, CANDIDATES, search, setup)
        how = {"pitch": setup.sites.pitch, "saturation": setup.settings.saturation}
        for first in range(0, frames, _AT_ONCE):
            some = slice(first, first + _AT_ONCE)
            ratio = np.asarray(planes.lamp_ratio)[some]
            located = locator.locate(Planes(on[some], off[some], ratio), search, **how)
            chosen.put(first, fitter.fit(located, ratio, search, setup))
        return Found(chosen.stripes, chosen.number)

    def measure(
        self, located: Located, lamp_ratio: Float[Array, " frames"], search: Search, setup: ExtractionSetup
    ) -> MeasuredLines:
        """Every candidate fitted and judged."""
        return MeasuredLines(fit_candidates(located.lists, lamp_ratio, search, setup), located.slots)


@functools.cache
def _native():
    # Here, because it loads numba: whoever finds no stripe does not wait for that.
    from jaxscan.stripes.choosing.native import ChosenLines
    from jaxscan.stripes.fitting.native import NativeFitter
    from jaxscan.stripes.search.native import NativeLocator

    return NativeLocator(), NativeFitter(), ChosenLines
