"""Which rig a capture determines: parts that are known before, and the largest of camera, sheets and motion."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from jaxscan.calibration.settings import CAMERA_BLOCKS, CalibrationSettings, RigKind
from jaxscan.errors import CalibrationError
from jaxscan.geometry import MOTIONS, AbstractCamera, AbstractMotion, Carries, LaserSheet
from jaxscan.geometry.laser import LASER_BLOCKS
from jaxscan.geometry.motions import MOTION_BLOCKS
from jaxscan.observation import BoardSource


Part = Literal["camera", "sheet", "axis"]
"""A part that may be known; "axis" is the motion of any rig."""
_BLOCKS_OF: dict[str, tuple[str, ...]] = {
    "camera": CAMERA_BLOCKS,
    "sheet": tuple(block.name for block in LASER_BLOCKS),
    "axis": tuple(block.name for block in MOTION_BLOCKS),
}


@dataclass(frozen=True)
class KnownParts:
    """Parts known from another calibration or a data sheet; one that is not named in `refine` is held."""

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


MIN_VIEWS = 3
"""Views of a board from which a camera can be found."""
IN_JOURNAL = "in the journal"
_LIGHT_MORE = "capture each board pose with the laser on and off"


class Holdings(NamedTuple):
    """The part of a capture, or of its observations, that decides which rig it determines."""

    views: int
    lit: dict[str, bool]
    """Whether each laser of the header is seen."""
    moved: bool
    """Whether a placement was seen from two positions."""
    carries: Carries


@dataclass(frozen=True)
class Rig:
    """The parts of a rig that are solved together with the camera."""

    lasers: tuple[str, ...]
    """Their sheets are solved, or known."""
    moves: bool
    """Whether the motion is solved, or known."""
    carries: Carries = "scanner"
    missing: tuple[str, ...] = ()
    """A sentence for each part that is not solved: why, and the captures that it needs."""

    def words(self) -> str:
        """The parts: "camera, sheet and axis"."""
        parts = ["camera", *_sheets(self.lasers), *([MOTIONS[self.carries].part] if self.moves else [])]
        return f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else "camera alone"


def _sheets(lasers: Sequence[str]) -> list[str]:
    return [] if not lasers else ["sheet"] if len(lasers) == 1 else [f"{len(lasers)} sheets"]


def largest_rig(
    held: Holdings, only: RigKind | None = None, known: KnownParts = NOTHING_KNOWN, *, seen: str = IN_JOURNAL
) -> Rig:
    """The largest rig that a capture determines, or the smaller one that is requested.

    Raises:
        CalibrationError: If not even the camera is determined.
    """
    if known.camera is None and held.views < MIN_VIEWS:
        raise CalibrationError(
            f"The board was found in {held.views} view(s) and a camera needs at least {MIN_VIEWS}: capture 10 or "
            "more, tilted by 20 to 45 degrees in different directions."
        )
    missing: list[str] = []
    lasers: tuple[str, ...] = ()
    if only not in ("camera", "axis"):
        lasers = tuple(name for name, lit in held.lit.items() if lit or known.sheets)
        dark = [name for name in held.lit if name not in lasers]
        if not held.lit:
            missing.append(f"no sheet: the header lists no [[laser]]; list it, and {_LIGHT_MORE}")
        unlit = "no record has it lit" if seen == IN_JOURNAL else f"its stripe was not seen {seen}"
        for name in dark:
            missing.append(f"no sheet of laser {name!r}: {unlit}; {_LIGHT_MORE}")
    moves = only not in ("camera", "profile") and held.carries != "nothing" and (held.moved or known.motion is not None)
    if only not in ("camera", "profile") and held.carries != "nothing" and not moves:
        kind = MOTIONS[held.carries]
        missing.append(f"no {kind.part}: no board placement was seen from two {kind.stops} {seen}; {kind.capture}")
    return Rig(lasers, moves, held.carries, tuple(missing))


def planned_rig(captures: Sequence[BoardSource], only: RigKind | None = None, known: KnownParts = NOTHING_KNOWN) -> Rig:
    """The largest rig by header and journal alone, before any image is read.

    Raises:
        CalibrationError: If not even the camera is determined.
    """
    records = [record for capture in captures for record in capture.records]
    if known.camera is None and len(records) < MIN_VIEWS:
        raise CalibrationError(
            f"The captures have {len(records)} view(s) of the board, and a camera needs at least {MIN_VIEWS}: "
            "capture 10 or more, tilted by 20 to 45 degrees in different directions, or give a known camera."
        )
    first = captures[0]
    lit = {
        line.name: any(record.on and k in record.lasers for record in records) for k, line in enumerate(first.lasers)
    }
    carries = first.carries or "scanner"
    known.check(first.image_size, tuple(lit), carries)
    placed = [
        ((number, record.placement), record.angle)
        for number, capture in enumerate(captures)
        for record in capture.records
        if record.placement is not None and record.angle is not None
    ]
    return largest_rig(Holdings(len(records), lit, has_moved(placed, carries), carries), only, known)


def has_moved(placed: Iterable[tuple[object, float]], carries: Carries) -> bool:
    """Whether a placement was seen from two positions; each view is (placement, position [rad or m])."""
    ends: dict[object, tuple[float, float]] = {}
    for place, at in placed:
        low, high = ends.get(place, (np.inf, -np.inf))
        ends[place] = min(low, at), max(high, at)
    return any(high - low > MOTIONS[carries].least for low, high in ends.values())
