"""The setup of an extraction."""

from typing import NamedTuple

from jaxtyping import UInt8

from jaxscan.geometry import Array, across_and_along
from jaxscan.stripes.frames import FrameFormat, LaserLine, Sites, laser_plane, laser_sites
from jaxscan.stripes.stripes import StripeSettings


class ExtractionSetup(NamedTuple):
    """Frames of one kind, a laser as they show it, and the settings."""

    image_size: tuple[int, int]
    """Width and height of a frame [px]."""
    frames: FrameFormat
    line: LaserLine
    settings: StripeSettings
    exposures: tuple[float, ...] = (1.0,)
    """Relative exposures of the frames of one record."""
    level: int | None = None
    """Where the exposures are levels of one frame of more than 8 bits, the one that this engine reads."""
    all_candidates: bool = False
    """Whether the other candidates of a line are given too, beside the number of the chosen one."""

    @property
    def several(self) -> bool:
        """Whether a frame gives a profile for each of its candidates."""
        return self.all_candidates or self.settings.choice == "all"

    @property
    def sites(self) -> Sites:
        """Which pixels of a frame carry the laser's colour."""
        return laser_sites(self.frames.pixel_format, self.line)

    @property
    def image_lines(self) -> int:
        """Lines of a profile."""
        return across_and_along(*self.image_size, self.line.stripe_axis)[1]

    @property
    def plane_size(self) -> tuple[int, int]:
        """Lines of the plane of the laser's colour, and samples of a line."""
        across, lines = across_and_along(*self.image_size, self.line.stripe_axis)
        sites = self.sites
        if sites.pitch == 1:
            return lines, across
        return lines // 2 * 2 // sites.line_step, across // 2

    def plane(self, frames: Array) -> UInt8[Array, "frames lines samples"]:
        """The samples of the laser's colour of frames uint8 [frames, rows, columns] (rgb8: and 3)."""
        return laser_plane(frames, pixel_format=self.frames.pixel_format, line=self.line)
