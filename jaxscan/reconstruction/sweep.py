"""A sweep: pairs of frames at known table angles, in memory or from anywhere else."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxscan.geometry import Array
from jaxscan.stripes.frames.formats import PIXEL_FORMATS, LaserLine, PixelFormat, Response, frame_rank


class FrameChunk(NamedTuple):
    """Consecutive records' frames: uint8 [records, rows, columns] (and colours, for rgb8)."""

    on: Array
    off: Array | None
    """Where a record has several exposures they are a second axis: [records, exposures, ...]."""


@runtime_checkable
class SweepSource(Protocol):
    """What `reconstruct` needs of a sweep; `Sweep` and `files.Capture` both are one."""

    @property
    def pixel_format(self) -> PixelFormat: ...
    @property
    def response(self) -> Response: ...
    @property
    def lines(self) -> tuple[LaserLine, ...]:
        """The lasers, in the order that `laser` counts them."""

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""

    @property
    def carries(self) -> str | None:
        """What the table carries, where known."""

    @property
    def angles(self) -> np.ndarray:
        """The table's angle of each record, float64 [records], rad from home."""

    @property
    def record(self) -> np.ndarray:
        """The record of each profile, int32 [profiles]: more than one profile where several lasers are lit."""

    @property
    def laser(self) -> np.ndarray:
        """The laser of each profile, int32 [profiles]."""

    @property
    def exposures(self) -> tuple[float, ...]:
        """Relative exposures of the frames of one record; (1.0,) where there is one."""

    def __len__(self) -> int:
        """Number of records."""
        ...

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        """All frames in order, `size` records at a time; the last chunk may be shorter."""
        ...


@dataclass(frozen=True)
class Sweep:
    """A sweep whose frames are arrays in memory.

    Args:
        on: Laser-on frames, uint8 [records, rows, columns] (rgb8: and 3).
        off: Laser-off frames of the same shape, or None.
        angle: The table's angle of each record [rad from home].
        pixel_format: How a frame is to be read.
        response: "linear", or "srgb" (decoded before the fit).
        lines: The lasers as the camera sees them.
        laser_index: The laser of each profile; the first where not given.
        record_index: The record of each profile; with one laser lit in each record, the record itself.
        exposures: Relative exposures, where `on` and `off` have a second axis over them.

    Raises:
        ValueError: If shapes, type or counts do not fit together.
    """

    on: Array
    off: Array | None
    angle: Array
    pixel_format: PixelFormat = "mono8"
    response: Response = "linear"
    lines: tuple[LaserLine, ...] = (LaserLine(),)
    laser_index: Array | None = None
    record_index: Array | None = None
    exposures: tuple[float, ...] = (1.0,)
    carries: str | None = None

    def __post_init__(self) -> None:
        if self.pixel_format not in PIXEL_FORMATS:
            raise ValueError(f"Unknown pixel format {self.pixel_format!r}; known: {', '.join(PIXEL_FORMATS)}.")
        bracket = len(self.exposures) > 1
        rank = 1 + bracket + frame_rank(self.pixel_format)
        if self.on.ndim != rank or self.on.dtype != np.uint8:
            raise ValueError(
                f"`on` must be uint8 with {rank} dimensions for {self.pixel_format}, "
                f"got {self.on.dtype} with shape {tuple(self.on.shape)}."
            )
        if self.off is not None and (self.off.shape != self.on.shape or self.off.dtype != np.uint8):
            raise ValueError(f"`off` must be like `on`, got {self.off.dtype} with shape {tuple(self.off.shape)}.")
        if bracket and self.on.shape[1] != len(self.exposures):
            raise ValueError(f"`on` must have {len(self.exposures)} exposures, got shape {tuple(self.on.shape)}.")
        if np.shape(self.laser) != np.shape(self.record):
            raise ValueError("`laser_index` and `record_index` must have one entry per profile each.")
        if len(self.record) and not 0 <= self.record.min() <= self.record.max() < max(len(self.on), 1):
            raise ValueError(f"`record_index` must be within the {len(self.on)} records.")
        if np.shape(self.angle) != (len(self.on),):
            raise ValueError(f"`angle` must have shape ({len(self.on)},), got {np.shape(self.angle)}.")
        if not np.all(np.isfinite(np.asarray(self.angle))):
            raise ValueError("`angle` must be finite.")

    def __len__(self) -> int:
        return len(self.on)

    @property
    def image_size(self) -> tuple[int, int]:
        rows, columns = self.on.shape[-2:] if self.pixel_format != "rgb8" else self.on.shape[-3:-1]
        return int(columns), int(rows)

    @property
    def angles(self) -> np.ndarray:
        return np.asarray(self.angle, np.float64)

    @property
    def record(self) -> np.ndarray:
        if self.record_index is None:
            return np.arange(len(self), dtype=np.int32)
        return np.asarray(self.record_index, np.int32)

    @property
    def laser(self) -> np.ndarray:
        if self.laser_index is None:
            return np.zeros(len(self.record), np.int32)
        return np.asarray(self.laser_index, np.int32)

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        for start in range(0, len(self), size):
            part = slice(start, start + size)
            yield FrameChunk(self.on[part], None if self.off is None else self.off[part])
