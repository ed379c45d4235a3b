"""A capture that is read: a sweep for `reconstruct`, or the records of a calibration."""

import dataclasses
import functools
import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, cast

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture.header import CaptureHeader
from jaxscan.files.capture.images import ImageReader, Look, RecordFrames, check_exposures, decode_ahead, exposure_levels
from jaxscan.files.capture.journal import JOURNAL_NAME, ImageRef, Record, read_texts
from jaxscan.files.capture.seals import require_whole, sealing
from jaxscan.files.disk import COPY_FIRST, is_address, shown
from jaxscan.geometry import MOTIONS, AbstractBoard, Carries
from jaxscan.geometry.scanner import Up
from jaxscan.reconstruction import FrameChunk, journal_doubts
from jaxscan.stripes import LaserLine, PixelFormat, Response


@dataclass(frozen=True, eq=False)
class Capture:
    """An opened capture; a sweep is a `SweepSource`. Images are read when they are needed."""

    path: Path
    header: CaptureHeader
    records: tuple[Record, ...]
    notes: tuple[str, ...]
    """Doubts of the reader, a sentence each: a torn last line that was left out, records that no seal covers."""
    _digest: str
    _reader: ImageReader = dataclasses.field(repr=False)
    _look: Look | None = dataclasses.field(default=None, repr=False)
    stripes_at: Path | None = None
    """Where its stripes are kept; None for beside the journal."""

    def __len__(self) -> int:
        return len(self.records)

    @property
    def pixel_format(self) -> PixelFormat:
        return self.header.camera.pixel_format

    @property
    def response(self) -> Response:
        return self.header.camera.response

    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The lasers, in the order that `laser` counts them."""
        return self.header.lasers

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.header.camera.width, self.header.camera.height

    @property
    def compared(self) -> bool:
        """Whether images are compared with their digests when they are read."""
        return self._reader.compared

    @property
    def carries(self) -> Carries | None:
        """What moves: "scanner", "object", "linear" or "nothing"; None if the header does not say."""
        return None if self.header.turntable is None else self.header.turntable.carries

    @property
    def stop_sigma(self) -> float | None:
        """Standard deviation of stops about the positions of their records [rad or m]; None if the header is silent."""
        return None if self.header.turntable is None else self.header.turntable.stop_sigma

    @property
    def compression(self) -> str | None:
        """The lossy compression of the images: as the header says, else "jpeg" by the first image's name."""
        return _compression(self.header, self.records)

    @property
    def up(self) -> Up:
        """Which direction of the image is up."""
        return self.header.camera.up

    @property
    def board(self) -> AbstractBoard | None:
        """The calibration board, where the header has one."""
        return None if self.header.board is None else self.header.board.board()

    @property
    def angles(self) -> np.ndarray:
        """The table's angle of each record, float64 [records], rad from home; for a linear stage its position [m].

        Raises:
            CaptureError: If one is unknown, as it may be in a calibration capture.
        """
        return self._angles

    # A plain property returns it: type checkers would not match a `cached_property` with that of `SweepSource`.
    @functools.cached_property
    def _angles(self) -> np.ndarray:
        if self.carries == "nothing":
            return np.zeros(len(self.records))
        if MOTIONS[self.carries or "scanner"].unit == "pose":
            # The places of the records in `poses`.
            return np.arange(len(self.records), dtype=np.float64)
        key = MOTIONS[self.carries or "scanner"].key
        for record in self.records:
            if record.angle is None:
                raise CaptureError(f"{self.path}: record {record.i}: {key} is null; only a sweep can be reconstructed.")
        return np.array([record.angle for record in self.records], np.float64)

    @property
    def poses(self) -> np.ndarray | None:
        """T_base_hand of every record, float64 [records, 4, 4], m, where poses are given; the identity for none."""
        if MOTIONS[self.carries or "scanner"].unit != "pose":
            return None
        poses = np.tile(np.eye(4), (len(self.records), 1, 1))
        for at, record in enumerate(self.records):
            if record.pose is not None:
                poses[at, :3] = np.reshape(record.pose, (3, 4))
        return poses

    @property
    def record(self) -> np.ndarray:
        """Which record each profile comes from, int32 [profiles]: its position in `records`.

        A record with two lasers lit has two profiles, one after the other.

        Raises:
            CaptureError: If a record has no laser-on image, as it may be in a calibration capture.
        """
        return self._profiles[0]

    @property
    def laser(self) -> np.ndarray:
        """Which laser each profile shows, int32 [profiles]: its position in `lines`.

        Raises:
            CaptureError: If a record has no laser-on image, as it may be in a calibration capture.
        """
        return self._profiles[1]

    @functools.cached_property
    def _profiles(self) -> tuple[np.ndarray, np.ndarray]:
        for record in self.records:
            if not record.on:
                raise CaptureError(f"{self.path}: record {record.i}: on is null; only a sweep can be reconstructed.")
        pairs = [(index, laser) for index, record in enumerate(self.records) for laser in record.lasers]
        columns = np.array(pairs, np.int32).reshape(-1, 2).T.copy()
        return columns[0], columns[1]

    @property
    def exposures(self) -> tuple[float, ...]:
        """The different exposures of a frame [s], ascending; `(1.0,)` where the records do not say.

        More than one is a bracket, the same in every record of a sweep. Repetitions of one
        exposure are averaged when they are read and do not count.
        """
        return self._exposures

    @functools.cached_property
    def _exposures(self) -> tuple[float, ...]:
        images = [image for record in self.records for image in (*record.on, *record.off)]
        return exposure_levels(images) or (1.0,)

    @property
    def bits(self) -> int:
        """Bits of a sample as the camera gave it; with more than 8 the exposures are levels of one frame."""
        return self.header.camera.bits or 8

    def digest(self) -> str:
        """The sha256 of header and journal, as "sha256:<hex>"; the same for every `every(n)`."""
        return self._digest

    def every(self, n: int) -> "Capture":
        """Only every `n`-th record, the first included."""
        if n < 1:
            raise ValueError(f"`n` must be at least 1, got {n}.")
        return dataclasses.replace(self, records=self.records[::n])

    def watched(self, look: Look) -> "Capture":
        """The same capture; `look` sees each record and its frames whenever `chunks` reads them."""
        return dataclasses.replace(self, _look=look)

    def keeping(self, stripes_at: Path) -> "Capture":
        """The same capture, whose stripes are kept in a file elsewhere: nothing is written into its folder."""
        return dataclasses.replace(self, stripes_at=stripes_at)

    def frames(self, index: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The laser-on and the laser-off image of one record, each where there is one.

        Args:
            index: Position in `records`.

        Returns:
            on, off: uint8 [rows, columns], or RGB [rows, columns, 3] for rgb8; where a sweep has a
                bracket, or the camera gave more than 8 bits, [exposures, rows, columns(, 3)].

        Raises:
            CaptureError: With the name of the file that is missing, damaged or of the wrong size;
                and where a calibration capture has a bracket.
        """
        record = self.records[index]
        if self.header.kind == "calibration" and self.bits == 8:
            levels = exposure_levels((*record.on, *record.off))
            if len(levels) > 1:
                raise CaptureError(
                    f"{self.path}: record {record.i}: found a bracket of {len(levels)} exposures; a calibration reads "
                    "images of one exposure."
                )
        return self._reader.frame(record.on), self._reader.frame(record.off)

    def pictures(self, index: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The images of one record for people, uint8 [rows, columns(, 3)]: as `frames`, but of a bracket the middle
        exposure, and of more than 8 bits the level that has their whole range."""
        shown = 0 if self.bits > 8 else len(self.exposures) // 2
        several = len(self.exposures) > 1
        on, off = (one if one is None or not several else one[shown] for one in self.frames(index))
        return on, off

    def off_frame(self, index: int) -> np.ndarray | None:
        """The laser-off image of one record, where there is one, as in `frames`; no other image is read."""
        return self._reader.frame(self.records[index].off)

    def image(self, reference: ImageRef) -> np.ndarray:
        """One image of a record as it is stored, uint8 [rows, columns(, 3)], perhaps read-only.

        Raises:
            CaptureError: With the name of the file that is missing, damaged or of the wrong size.
        """
        return self._reader.image(reference)

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        """All frames in order, `size` records at a time, decoded ahead by all cores.

        Frames that lie one after another in one shard are read-only views of the file; others are
        decoded or copied. No more than three chunks exist beside those that are in use. Close the iterator to stop
        early.

        Yields:
            uint8 [records, rows, columns(, 3)], or [records, exposures, rows, columns(, 3)] where
            there are several `exposures`.

        Raises:
            ValueError: If `size` is not positive.
            CaptureError: With the name of the file, where its chunk would have come.
        """
        if size < 1:
            raise ValueError(f"`size` must be at least 1, got {size}.")
        if self.header.kind != "sweep":
            raise CaptureError(f"{self.path}: is a calibration capture; only a sweep can be reconstructed.")
        levels = len(self.exposures)
        shape = (levels, *self._reader.shape) if levels > 1 else self._reader.shape
        on = RecordFrames(self._reader, [record.on for record in self.records])
        offs = [record.off for record in self.records]
        off = RecordFrames(self._reader, offs) if offs and all(offs) else None
        return decode_ahead(len(self), min(size, max(1, len(self))), shape, on, off, self._look)


def open_capture(path: str | Path, *, compare: bool = True) -> Capture:
    """Open a capture and check everything except the contents of its images.

    Args:
        path: The folder.
        compare: Whether images are compared with their digests when they are read. A frame of a shard takes less time
            to read than to compare; header and journal are compared with their seals in any case.

    Returns:
        The capture; its `notes` name any line that was left out.

    Raises:
        CaptureError: With the file, and the line or key, that is missing or wrong, or has changed since the capture
            was sealed.
    """
    path = Path(path)
    if not os.path.isdir(path):
        found = "found a file" if os.path.exists(path) else "no such folder"
        remedy = f"; {COPY_FIRST}" if is_address(path) else ""
        raise CaptureError(f"{shown(path)}: {found}, expected a capture's folder{remedy}.")
    journal_name, texts = str(path / JOURNAL_NAME), read_texts(path)
    header, records, seals = texts.header, texts.records, sealing(texts, path)
    require_whole(seals)
    if not records:
        raise CaptureError(f"{journal_name}: holds no complete record.")
    without_off = [record for record in records if not record.off]
    if header.kind == "sweep" and 0 < len(without_off) < len(records):
        raise CaptureError(
            f"{journal_name}: record {without_off[0].i} has no laser-off image, but others have; "
            f"a sweep needs them all, or none."
        )
    if header.kind == "sweep" or header.camera.bits is not None:
        check_exposures(records, name=journal_name, bits=header.camera.bits)
    reader = ImageReader(path, header, compare=compare)
    reader.check(records)
    notes = [*texts.notes, *((seals.note,) if seals.note else ()), *header.camera.notes(_compression(header, records))]
    if header.kind == "sweep":
        turns = header.turntable is None or header.turntable.carries in ("scanner", "object")
        degrees = np.degrees([record.angle or 0.0 for record in records]) if turns else None
        lit = [record.lasers for record in records]
        planned = None if header.plan is None else header.plan.steps
        doubts = journal_doubts([record.i for record in records], degrees, lit, planned)
        notes += [f"{journal_name}: {doubt}" for doubt in doubts]
    return Capture(path, header, records, tuple(notes), texts.digest(), reader)


def _compression(header: CaptureHeader, records: tuple[Record, ...]) -> Literal["jpeg", "video"] | None:
    first = (*records[0].on, *records[0].off)[0].path.lower()
    return header.camera.compression or ("jpeg" if first.endswith((".jpg", ".jpeg")) else None)


def common_board(captures: Sequence[Capture], *, single_lasers: bool) -> AbstractBoard:
    """The common board of captures that are calibrated together; all must come from one rig.

    Args:
        single_lasers: No record may show several lasers at once, since their stripes cannot be told apart.

    Raises:
        CaptureError: With the capture that differs from the first, that is given twice, or the record with several
            lasers.
    """
    first = captures[0]
    for capture in captures:
        if capture.board is None:
            raise CaptureError(f"{capture.path}: is a sweep; a calibration needs captures of a board.")
        for table in ("camera", "laser", "turntable", "board"):
            if getattr(capture.header, table) != getattr(first.header, table):
                raise CaptureError(
                    f"{capture.path}: its [{table}] is not the same as in {first.path}; "
                    "captures calibrated together must show the same board to the same rig."
                )
    refuse_copies(captures)
    for capture in captures if single_lasers else ():
        for record in capture.records:
            if len(record.lasers) > 1:
                names = ", ".join(capture.lasers[laser].name for laser in record.lasers)
                raise CaptureError(
                    f"{capture.path}: record {record.i}: several lasers are lit at once ({names}), but a calibration "
                    'needs one per record; capture a record for each, and name it there: "lasers": ["..."].'
                )
    return cast(AbstractBoard, first.board)


def refuse_copies(captures: Sequence[Capture]) -> None:
    """Refuse a capture that is given twice, by another name or as a copy.

    Raises:
        CaptureError: With both names.
    """
    for one, other in itertools.combinations(captures, 2):
        if _are_copies(one, other):
            raise CaptureError(
                f"{other.path}: is the same capture as {one.path}; its images would count twice, and every uncertainty "
                "would come out too small. Give each capture once."
            )


def _are_copies(one: Capture, other: Capture) -> bool:
    """Whether two captures hold the same images, under two names or as copies.

    Equal header and journal are not enough: two captures written by hand may differ in their images alone.
    """
    if one.path.samefile(other.path):
        return True
    if one.digest() != other.digest():
        return False
    record = one.records[0]
    return all(np.array_equal(one.image(image), other.image(image)) for image in (*record.on, *record.off))
