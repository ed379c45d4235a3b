"""A sweep: pairs of frames at known table angles, in memory or from anywhere else; and its frames laser by laser."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxscan.geometry import Array
from jaxscan.stripes import PIXEL_FORMATS, LaserLine, PixelFormat, Response, check_frames


class FrameChunk(NamedTuple):
    """Consecutive records' frames: uint8 [records, rows, columns] (and colours, for rgb8)."""

    on: Array
    off: Array | None
    """Where a record has several exposures they are a second axis: [records, exposures, ...]."""


@runtime_checkable
class SweepSource(Protocol):
    """The interface of a sweep; `Sweep` and `files.Capture` both have it."""

    @property
    def pixel_format(self) -> PixelFormat: ...
    @property
    def response(self) -> Response: ...
    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The lasers, in the order that `laser` counts them."""

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""

    @property
    def carries(self) -> str | None:
        """ "scanner" or "object", where known."""

    @property
    def angles(self) -> np.ndarray:
        """The table's angle of each record, float64 [records], rad from home."""

    @property
    def poses(self) -> np.ndarray | None:
        """T_base_hand of each record, float64 [records, 4, 4], m, where poses are given; `angles` count the records."""

    @property
    def record(self) -> np.ndarray:
        """The record of each profile, int32 [profiles]: more than one profile where several lasers are lit."""

    @property
    def laser(self) -> np.ndarray:
        """The laser of each profile, int32 [profiles]."""

    @property
    def exposures(self) -> tuple[float, ...]:
        """Relative exposures of the frames of one record; (1.0,) where there is one."""

    @property
    def compression(self) -> str | None:
        """The lossy compression of the images before they were stored, where known."""

    @property
    def bits(self) -> int:
        """Bits of a sample as the camera gave it; with more than 8 the exposures are levels of one frame."""

    def __len__(self) -> int:
        """Number of records."""
        ...

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        """All frames in order, `size` records at a time; the last chunk may be shorter."""
        ...


_NOT_GIVEN: np.ndarray = np.zeros(0, np.int32)


@dataclass(frozen=True)
class Sweep:
    """A sweep whose frames are arrays in memory.

    Args:
        on: Laser-on frames, uint8 [records, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        angles: The table's angle of each record [rad from home].
        response: "linear", or "srgb" or "gamma 2.2" (decoded before the fit).
        lasers: The lasers as the camera sees them.
        laser: The laser of each profile; the first where not given.
        record: The record of each profile; with one laser lit in each record, the record itself.
        exposures: Relative exposures, where `on` and `off` have a second axis over them.
        carries: "scanner" or "object", where known.
        compression: The lossy compression of the frames, where known.
        bits: Bits of a sample as the camera gave it; with more than 8, `exposures` are those of `split_levels`.
        poses: T_base_hand of each record [records, 4, 4], m, where poses are given; `angles` then count the records.

    Raises:
        ValueError: If shapes, type or counts do not fit together.
    """

    on: Array
    off: Array | None
    angles: np.ndarray
    pixel_format: PixelFormat = "mono8"
    response: Response = "linear"
    lasers: tuple[LaserLine, ...] = (LaserLine(),)
    laser: np.ndarray = field(default_factory=lambda: _NOT_GIVEN)
    record: np.ndarray = field(default_factory=lambda: _NOT_GIVEN)
    exposures: tuple[float, ...] = (1.0,)
    carries: str | None = None
    compression: str | None = None
    bits: int = 8
    poses: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.pixel_format not in PIXEL_FORMATS:
            raise ValueError(f"Unknown pixel format {self.pixel_format!r}; known: {', '.join(PIXEL_FORMATS)}.")
        check_frames(self.on, self.off, self.pixel_format, exposures=len(self.exposures))
        if len(self.exposures) > 1 and self.on.shape[1] != len(self.exposures):
            raise ValueError(f"`on` must have {len(self.exposures)} exposures, got shape {tuple(self.on.shape)}.")
        record = np.arange(len(self.on)) if self.record is _NOT_GIVEN else self.record
        laser = np.zeros(len(record)) if self.laser is _NOT_GIVEN else self.laser
        for name, values in (("record", record), ("laser", laser)):
            object.__setattr__(self, name, np.asarray(values, np.int32))
        object.__setattr__(self, "angles", np.asarray(self.angles, np.float64))
        if self.laser.shape != self.record.shape:
            raise ValueError("`laser` and `record` must have one entry per profile each.")
        if len(self.record) and not 0 <= self.record.min() <= self.record.max() < max(len(self.on), 1):
            raise ValueError(f"`record` must be within the {len(self.on)} records.")
        if self.angles.shape != (len(self.on),):
            raise ValueError(f"`angles` must have shape ({len(self.on)},), got {self.angles.shape}.")
        if not np.all(np.isfinite(self.angles)):
            raise ValueError("`angles` must be finite.")

    def __len__(self) -> int:
        return len(self.on)

    @property
    def image_size(self) -> tuple[int, int]:
        rows, columns = self.on.shape[-2:] if self.pixel_format != "rgb8" else self.on.shape[-3:-1]
        return int(columns), int(rows)

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        for start in range(0, len(self), size):
            part = slice(start, start + size)
            yield FrameChunk(self.on[part], None if self.off is None else self.off[part])


def colour_exposure(sweep: SweepSource) -> int:
    """The exposure that gives colours: the longest, or the level that holds the whole range of a frame."""
    return 0 if sweep.bits > 8 else len(sweep.exposures) - 1


class Batch(NamedTuple):
    """Frames of one laser."""

    profiles: np.ndarray
    """Which profiles of the sweep, int [n]."""
    laser: int
    on: Array
    off: Array | None


def batches(sweep: SweepSource, size: int, chunks: Iterable[FrameChunk]) -> Iterator[Batch]:
    """Chunks of a sweep as batches of at most `size` frames of one laser each."""
    start = 0
    for on, off in chunks:
        here = (sweep.record >= start) & (sweep.record < start + len(on))
        for laser in np.unique(sweep.laser):
            profiles = np.flatnonzero(here & (sweep.laser == laser))
            for first in range(0, len(profiles), size):
                some = profiles[first : first + size]
                rows = sweep.record[some] - start
                yield Batch(some, int(laser), _taken(on, rows), None if off is None else _taken(off, rows))
        start += len(on)


def _taken(frames: Array, rows: np.ndarray) -> Array:
    whole = len(rows) == len(frames) and bool(np.all(np.diff(rows) == 1))
    return frames if whole else np.asarray(frames)[rows]


def rows_of(profiles: np.ndarray, each: int) -> np.ndarray:
    """Rows of the grid of so many profiles for each of some profiles of the sweep."""
    return (each * profiles[:, None] + np.arange(each)[None, :]).reshape(-1)


def place(rows: np.ndarray) -> slice | np.ndarray:
    """The same rows, as a slice where they follow each other: nothing is copied then."""
    consecutive = len(rows) > 0 and bool(np.all(np.diff(rows) == 1))
    return slice(rows[0], rows[-1] + 1) if consecutive else rows
