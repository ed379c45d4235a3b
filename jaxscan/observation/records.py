"""Records of a board: their source, and the corners and stripes found in them."""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxscan.geometry import Carries
from jaxscan.geometry.scanner import Up
from jaxscan.observation.board_map import FoundCorners
from jaxscan.observation.missed import Light
from jaxscan.observation.stripes_on_board import BoardStripe
from jaxscan.stripes import LaserLine, PixelFormat, Response, finest_steps, join_levels


ToGrey = Callable[[np.ndarray, PixelFormat], np.ndarray]
"""Converts a captured frame to [rows, columns] of the same size and type, uint8 or uint16."""


@runtime_checkable
class BoardRecord(Protocol):
    """One record of a capture of a board."""

    @property
    def i(self) -> int:
        """Its own number."""

    @property
    def angle(self) -> float | None:
        """The table's angle [rad from home]; None where unknown."""

    @property
    def placement(self) -> int | None:
        """Records with the same number saw the same unmoved board; None: it stands alone."""

    @property
    def lasers(self) -> tuple[int, ...]:
        """The laser that is lit in the laser-on frame, one at most; empty without such a frame."""

    @property
    def on(self) -> Sequence[object]:
        """Images of the laser-on frame; empty without one."""

    @property
    def off(self) -> Sequence[object]:
        """Images of the laser-off frame; empty without one."""


@runtime_checkable
class BoardSource(Protocol):
    """A capture of a board by one rig; `files.Capture` is one."""

    @property
    def path(self) -> object:
        """The capture's name in messages."""

    @property
    def records(self) -> Sequence[BoardRecord]: ...
    @property
    def pixel_format(self) -> PixelFormat: ...
    @property
    def response(self) -> Response: ...
    @property
    def bits(self) -> int:
        """Bits of a sample as the camera gave it; frames of more than 8 come as their levels."""

    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The lasers, in the order of the numbers in `BoardRecord.lasers`."""

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""

    @property
    def compression(self) -> str | None:
        """The lossy compression of the images before they were stored, where known."""

    @property
    def up(self) -> Up: ...
    @property
    def carries(self) -> Carries | None:
        """Whether the table carries the scanner or the object, where known."""

    @property
    def poses(self) -> np.ndarray | None:
        """T_base_hand of every record [records, 4, 4], where poses are given [m]."""

    def frames(self, index: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The laser-on and the laser-off frame of a record; None where there is none.

        Returns:
            on, off: uint8 [rows, columns(, 3)]; of more than 8 bits [levels, rows, columns(, 3)].
        """
        ...


class SeenRecord(NamedTuple):
    """One record, with the corners and the stripe found in it."""

    capture: int
    """Index of its capture."""
    record: BoardRecord
    on: np.ndarray | None = None
    """Laser-on frame, as from `BoardSource.frames`; those of large captures are dropped after use, to save memory."""
    off: np.ndarray | None = None
    """Laser-off frame."""
    grey: np.ndarray | None = None
    """The laser-off frame in grey, or the laser-on frame where there is no other [DN of 8 bits]: uint8, or float32
    where the camera gives more bits."""
    corners: FoundCorners | None = None
    stripes: tuple[BoardStripe, ...] = ()
    """Straight lines on the board that may be the laser's, the likeliest first."""
    pose: np.ndarray | None = None
    """T_cam_board [4, 4] from a first solve."""
    light: Light | None = None
    """How the image is exposed and focused; None without an image."""

    @staticmethod
    def read(captures: Sequence[BoardSource], number: int, index: int, to_grey: ToGrey) -> "SeenRecord":
        """Record `index` of capture `number` with its frames."""
        capture = captures[number]
        on, off = capture.frames(index)
        shown = on if off is None else off
        if shown is None:
            grey = None
        elif capture.bits > 8:
            joined = to_grey(join_levels(shown, capture.bits), capture.pixel_format)
            grey = joined * np.float32(1.0 / finest_steps(capture.bits))
        else:
            grey = to_grey(shown, capture.pixel_format)
        return SeenRecord(number, capture.records[index], on, off, grey)

    @property
    def placement(self) -> tuple[int, int] | None:
        """Capture and number of its placement; None without a placement or without an angle."""
        number = self.record.placement
        return None if number is None or self.record.angle is None else (self.capture, number)

    @property
    def laser(self) -> int:
        """The one laser that is lit in the laser-on frame."""
        (laser,) = self.record.lasers
        return laser
