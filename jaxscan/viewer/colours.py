"""What the colours of the points mean, and which colour is how much."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8


Colouring = Literal["photograph", "height", "intensity", "sigma", "normals", "deviation"]
COLOURINGS: tuple[Colouring, ...] = ("photograph", "height", "intensity", "sigma", "normals", "deviation")
_SEQUENTIAL = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
"""Dark to bright, even to the eye: anchors of viridis (van der Walt and Smith, 2015)."""
_DIVERGING = np.array([[33, 102, 172], [146, 197, 222], [247, 247, 247], [244, 165, 130], [178, 24, 43]], float)
"""Two ways from white: anchors of RdBu (Brewer, 2003)."""
UNKNOWN = np.array([127, 127, 127], np.uint8)
"""The colour of a point of which the number is not known."""
_OUTSIDE = 1.0
"""Percent of the points on either side that the scale leaves out."""
_WHITE, _MOST_GAIN = 235.0, 6.0


class Scale(NamedTuple):
    """What the ends of a scale mean."""

    low: float
    high: float
    unit: str
    diverging: bool = False

    def words(self) -> str:
        """The ends as a legend shows them."""
        return f"{self.low:.3g} … {self.high:.3g} {self.unit}".replace("-", "−")

    def coloured(self, values: Float[np.ndarray, " n"]) -> UInt8[np.ndarray, "n 3"]:
        """The colours of values; those outside have that of the nearer end."""
        anchors = _DIVERGING if self.diverging else _SEQUENTIAL
        span = max(self.high - self.low, 1e-12)
        table = np.stack(
            [np.interp(np.linspace(0, len(anchors) - 1, 256), np.arange(len(anchors)), a) for a in anchors.T], 1
        )
        index = np.clip((values - self.low) * (255 / span), 0, 255)
        return table.astype(np.uint8)[np.nan_to_num(index).astype(np.uint8)]


def scale_of(values: Float[np.ndarray, " n"], unit: str) -> Scale:
    """A scale over values, without their outermost hundredth."""
    low, high = (float(value) for value in np.percentile(values[:: max(1, len(values) // 100_000)], [_OUTSIDE, 99.0]))
    return Scale(low, high, unit)


def coloured_normals(normals: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 3"]:
    """Normals as colours: x, y, z from -1 to 1 are red, green, blue; grey where there is none."""
    return (127.5 * (normals + 1.0)).astype(np.uint8)


def brightened(rgb: UInt8[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours so bright that hardly any is lost; rooms are dark while they are scanned."""
    most = float(np.percentile(rgb[:: max(1, len(rgb) // 100_000)].max(1), 99.0)) if len(rgb) else 255.0
    gain = np.clip(_WHITE / max(most, 1.0), 1.0, _MOST_GAIN)
    table = np.minimum(np.arange(256) * gain, 255).astype(np.uint8)
    return np.asarray(table[rgb])
