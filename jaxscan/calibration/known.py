"""Parts of a rig that are known before a calibration: held as they are, or refined from there."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from jaxscan.calibration.parameters import CAMERA_BLOCKS
from jaxscan.calibration.settings import CalibrationSettings
from jaxscan.errors import CalibrationError
from jaxscan.geometry import AbstractCamera, AbstractMotion, LaserSheet
from jaxscan.geometry.laser import LASER_BLOCKS
from jaxscan.geometry.motions import MOTION_BLOCKS


Part = Literal["camera", "sheet", "axis"]
"""A part that may be known; "axis" is the motion of any rig."""
_BLOCKS_OF: dict[str, tuple[str, ...]] = {
    "camera": CAMERA_BLOCKS,
    "sheet": tuple(block.name for block in LASER_BLOCKS),
    "axis": tuple(block.name for block in MOTION_BLOCKS),
}


@dataclass(frozen=True)
class KnownParts:
    """What another calibration or a data sheet says; a part that is not named in `refine` is held."""

    camera: AbstractCamera | None = None
    sheets: tuple[LaserSheet, ...] = ()
    """One for each laser, in their order."""
    motion: AbstractMotion | None = None
    """Camera frame at position 0."""
    refine: tuple[Part, ...] = ()
    """Parts that are estimated, with the known values as the first ones."""

    def held(self) -> tuple[Part, ...]:
        """The parts that are not estimated."""
        given: dict[Part, object] = {"camera": self.camera, "sheet": self.sheets, "axis": self.motion}
        return tuple(part for part, value in given.items() if value and part not in self.refine)

    def free(self, settings: CalibrationSettings) -> tuple[str, ...]:
        """The blocks of the settings that are estimated."""
        held = {block for part in self.held() for block in _BLOCKS_OF[part]}
        return tuple(block for block in settings.free if block not in held)

    def check(self, size: tuple[int, int], laser_names: Sequence[str], carries: str) -> None:
        """Refuse parts of another rig.

        Args:
            size: Width and height of its images [px].
            laser_names: Of the lasers that it has.
            carries: Its kind of motion.

        Raises:
            CalibrationError: With the values found and expected.
        """
        camera = self.camera
        if camera is not None and (camera.width, camera.height) != size:
            raise CalibrationError(
                f"The known camera has images of {camera.width} x {camera.height} px, the capture of {size[0]} x "
                f"{size[1]} px; give the calibration of this camera mode."
            )
        count = len(laser_names)
        if self.sheets and len(self.sheets) != count:
            raise CalibrationError(
                f"{len(self.sheets)} known sheets were given for {count} lasers of the capture "
                f"({', '.join(laser_names) or 'its header lists no [[laser]]'}); give one for each, in "
                "their order."
            )
        if self.motion is not None and self.motion.carries != carries:
            raise CalibrationError(
                f'The known axis belongs to carries = "{self.motion.carries}", the capture says '
                f'"{carries}"; give the axis of this arrangement.'
            )


NOTHING_KNOWN = KnownParts()
