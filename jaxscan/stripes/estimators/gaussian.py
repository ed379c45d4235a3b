"""The default estimator: maxima of two matched filters, each fitted with a pixel-integrated Gaussian."""

import functools

from jaxtyping import Float

from jaxscan.geometry import Array
from jaxscan.stripes.fitting import fit_candidates
from jaxscan.stripes.search import CANDIDATES, Located, Planes, Search, locate
from jaxscan.stripes.setup import ExtractionSetup
from jaxscan.stripes.stripes import Choice, MeasuredLines


class Gaussian:
    """Locate by matched filters, fit by maximum likelihood."""

    candidates = CANDIDATES
    choices: tuple[Choice, ...] = ("path", "brightest", "nearest", "farthest", "all")
    learns = True

    def locate(self, planes: Planes, search: Search, setup: ExtractionSetup) -> Located:
        """The highest maxima of every line, by XLA."""
        return locate(planes, search, pitch=setup.sites.pitch, saturation=setup.settings.saturation)

    def locate_natively(self, planes: Planes, search: Search, setup: ExtractionSetup) -> Located:
        """The same maxima, many times faster on a CPU."""
        return _native().locate(planes, search, pitch=setup.sites.pitch, saturation=setup.settings.saturation)

    def measure(
        self, located: Located, lamp_ratio: Float[Array, " frames"], search: Search, setup: ExtractionSetup
    ) -> MeasuredLines:
        """Every candidate fitted and judged."""
        return MeasuredLines(fit_candidates(located.lists, lamp_ratio, search, setup), located.slots)


@functools.cache
def _native():
    # Here, because it loads numba: whoever finds no stripe does not wait for that.
    from jaxscan.stripes.search.native import NativeLocator

    return NativeLocator()
