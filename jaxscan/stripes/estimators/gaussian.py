"""The default estimator: maxima of two matched filters, each fitted with a pixel-integrated Gaussian."""

from jaxscan.geometry import Array
from jaxscan.stripes.fit import fit_peaks
from jaxscan.stripes.frames import Sites
from jaxscan.stripes.peaks import CANDIDATES, find_peaks
from jaxscan.stripes.planes import Plane
from jaxscan.stripes.search import Search
from jaxscan.stripes.stripes import Choice, FrameStripes


class Gaussian:
    """Locate by matched filters, fit by maximum likelihood."""

    candidates = CANDIDATES
    choices: tuple[Choice, ...] = ("path", "brightest", "nearest", "farthest", "all")
    learns = True

    def measure(
        self, on: Plane, off: Plane | None, lamp_ratio: Array, search: Search, sites: Sites, linear: bool
    ) -> FrameStripes:
        """Every candidate fitted and judged."""
        pitch = sites.pitch
        peaks = find_peaks(on, off, lamp_ratio, search.low, search.high, search.thresholds, pitch=pitch)
        return fit_peaks(on, off, lamp_ratio, peaks, search, pitch=pitch, linear=linear)
