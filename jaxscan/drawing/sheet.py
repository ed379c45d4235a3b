"""The sheet of paper that a drawing is made for: its size, its scale, and what its title block says."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from jaxscan.errors import OptionError
from jaxscan.printable import printable


Size = Literal["a4", "a3", "a2", "a1", "a0"]
SIZES_MM: dict[Size, tuple[float, float]] = {
    "a4": (210.0, 297.0),
    "a3": (297.0, 420.0),
    "a2": (420.0, 594.0),
    "a1": (594.0, 841.0),
    "a0": (841.0, 1189.0),
}
"""The shorter and the longer side (ISO 216)."""
SCALES = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000)
"""Scales of technical drawings (ISO 5455)."""
BINDING_MM, EDGE_MM = 20.0, 10.0
"""Distance from the left edge of the paper to the frame, and from the other edges (ISO 5457)."""
TITLE_MM = (130.0, 42.0)
"""Width and height of the title block, and the height of the strip with the legend."""
BESIDE_MM = 250.0
"""From this width of the frame on the legend is beside the title block; on narrower sheets above it."""
AROUND_MM = 27.0
"""Room for two rows of dimensions on each side of the drawing."""


@dataclass(frozen=True)
class Sheet:
    """The sheet of a drawing. Fields that are None are chosen when the size of the drawing is known."""

    size: Size = "a4"
    scale: int | None = None
    """50 for 1 : 50. None for the largest of `SCALES` at which the drawing fits."""
    landscape: bool | None = None
    project: str = ""
    room: str = ""
    date: str = ""
    made_by: str = "jaxscan"
    north_deg: float | None = None
    """North on the sheet, clockwise from its upper edge [deg]; None if not given: a scan cannot tell it."""

    def __post_init__(self) -> None:
        # Names may come from anywhere, and files of drawings hold no control characters.
        for name in ("project", "room", "date", "made_by"):
            object.__setattr__(self, name, printable(getattr(self, name)))

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the paper."""
        short, long = SIZES_MM[self.size]
        return (long, short) if self.landscape else (short, long)

    @property
    def frame_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower left and upper right corner of the frame [2]."""
        return np.array([BINDING_MM, EDGE_MM]), np.array(self.size_mm) - EDGE_MM

    @property
    def legend_beside(self) -> bool:
        """Whether the legend is beside the title block."""
        low, high = self.frame_mm
        return bool(high[0] - low[0] >= BESIDE_MM)

    @property
    def room_mm(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower left and upper right corner of the part of the paper that the drawing has [2]."""
        low, high = self.frame_mm
        return low + [0.0, TITLE_MM[1] * (1 if self.legend_beside else 2)], high

    @property
    def paper_m(self) -> float:
        """What a millimetre of the paper is in the drawing [m].

        Raises:
            ValueError: If the sheet has no scale.
        """
        if self.scale is None:
            raise ValueError("The sheet has no scale yet; `fitted` gives it one.")
        return self.scale / 1e3

    def fitted(self, size_m: np.ndarray) -> "Sheet":
        """The sheet with a scale, upright or not, on which a drawing of this width and height [2], m, fits.

        Raises:
            OptionError: If the size is unknown, or the drawing does not fit at the scale that was chosen.
        """
        if self.size not in get_args(Size):
            raise OptionError(f"The sheet is {self.size:.20}, expected one of {', '.join(get_args(Size))}.")
        if self.scale is not None and self.scale < 1:
            raise OptionError(f"The scale is 1 : {self.scale}, expected 1 : 1 or smaller, as 50 for 1 : 50.")
        choices = [replace(self, landscape=way) for way in (True, False) if self.landscape in (None, way)]

        def fitting(scales: Sequence[int]) -> Sheet | None:
            """The sheet at the first of the scales at which the drawing fits."""
            for scale in scales:
                for choice in choices:
                    low, high = choice.room_mm
                    if (1e3 / scale * size_m + 2.0 * AROUND_MM <= high - low).all():
                        return replace(choice, scale=scale)
            return None

        found = fitting(SCALES if self.scale is None else (self.scale,))
        if found is not None:
            return found
        other, scale = fitting(SCALES), self.scale or SCALES[-1]
        low, high = (other or choices[0]).room_mm
        needed, there = (f"{a:.0f} x {b:.0f} mm" for a, b in (1e3 / scale * size_m + 2.0 * AROUND_MM, high - low))
        remedy = "choose a larger sheet" if other is None else f"choose 1 : {other.scale} or a larger sheet"
        raise OptionError(f"1 : {scale} takes {needed} with dimensions, {self.size} has {there}: {remedy}.")
