"""A capture on disk, read lazily: a sweep for `reconstruct`, or the records of a calibration."""

import dataclasses
import functools
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.bounded import MEGABYTE, read_bounded
from jaxscan.files.decode import decode_ahead
from jaxscan.files.header import HEADER_NAME, board_of, frame_shape, parse_header
from jaxscan.files.header import CaptureHeader as CaptureHeader
from jaxscan.files.journal import JOURNAL_NAME, MAX_JOURNAL_BYTES, read_journal
from jaxscan.files.journal import Record as Record
from jaxscan.files.references import Folder, ImageRef, open_shard
from jaxscan.files.resume import resume_capture as resume_capture
from jaxscan.files.writer import CaptureWriter as CaptureWriter
from jaxscan.files.writer import create_capture as create_capture
from jaxscan.geometry import AbstractBoard
from jaxscan.reconstruction.sweep import FrameChunk
from jaxscan.stripes.frames import LaserLine, PixelFormat, Response, frame_rank


Known = TypeVar("Known")


@dataclass(frozen=True, eq=False)
class Capture:
    """An opened capture; a sweep is a `SweepSource`. Images are read when they are asked for."""

    path: Path
    header: CaptureHeader
    records: tuple[Record, ...]
    """Sorted by their number, one per number."""
    notes: tuple[str, ...]
    """What a reader should know, a sentence each: a torn last line that was left out."""
    _digest: str
    _shards: dict[str, np.ndarray] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.records)

    @property
    def pixel_format(self) -> PixelFormat:
        return self.header.camera.pixel_format

    @property
    def response(self) -> Response:
        return self.header.camera.response

    @property
    def lines(self) -> tuple[LaserLine, ...]:
        """The lasers, in the order that `laser` counts them."""
        return self.header.lines

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.header.camera.width, self.header.camera.height

    @property
    def carries(self) -> str | None:
        """What the table carries, where the header says so."""
        return None if self.header.turntable is None else self.header.turntable.carries

    @property
    def board(self) -> AbstractBoard | None:
        """The calibration board, where the header has one."""
        return board_of(self.header)

    @functools.cached_property
    def angles(self) -> np.ndarray:
        """The table's angle of each record, float64 [records], rad from home.

        Raises:
            CaptureError: If an angle is unknown, as it may be in a calibration capture.
        """
        return np.array([self._known(record, "angle_deg", record.angle) for record in self.records], np.float64)

    @functools.cached_property
    def laser(self) -> np.ndarray:
        """The laser lit in each record, int32 [records].

        Raises:
            CaptureError: If a record has no laser-on image, as it may be in a calibration capture.
        """
        return np.array([self._known(record, "on", record.laser) for record in self.records], np.int32)

    def _known(self, record: Record, key: str, value: Known | None) -> Known:
        if value is None:
            raise CaptureError(f"{self.path}: record {record.i}: {key} is null; only a sweep can be reconstructed.")
        return value

    def digest(self) -> str:
        """The sha256 of header and journal, as "sha256:<hex>"; the same for every `every(n)`."""
        return self._digest

    def every(self, n: int) -> "Capture":
        """Only every `n`-th record, the first included."""
        if n < 1:
            raise ValueError(f"`n` must be at least 1, got {n}.")
        return dataclasses.replace(self, records=self.records[::n])

    def frames(self, index: int) -> tuple[np.ndarray | None, np.ndarray | None]:
        """The laser-on and the laser-off image of one record, each where there is one.

        Args:
            index: Position in `records`.

        Returns:
            on, off: uint8 [rows, columns], or RGB [rows, columns, 3] for rgb8.

        Raises:
            CaptureError: With the name of the file that is missing, damaged or of the wrong size.
        """
        record = self.records[index]
        on, off = (None if ref is None else np.array(self._load(ref)) for ref in (record.on, record.off))
        return on, off

    def chunks(self, size: int) -> Iterator[FrameChunk]:
        """All frames in order, `size` records at a time, decoded ahead by all cores.

        No more than three chunks are in memory. Close the iterator to stop early.

        Raises:
            ValueError: If `size` is not positive.
            CaptureError: With the name of the file, where its chunk would have come.
        """
        if size < 1:
            raise ValueError(f"`size` must be at least 1, got {size}.")
        if self.header.kind != "sweep":
            raise CaptureError(f"{self.path}: is a calibration capture; only a sweep can be reconstructed.")
        with_off = bool(self.records) and all(record.off is not None for record in self.records)

        def load(index: int, chunk: FrameChunk, row: int) -> None:
            record = self.records[index]
            for target, reference in ((chunk.on, record.on), (chunk.off, record.off)):
                if target is not None and reference is not None:
                    target[row] = self._load(reference)

        return decode_ahead(len(self), size, frame_shape(self.header), with_off, load)

    def _load(self, reference: ImageRef) -> np.ndarray:
        if reference.index is not None:
            return self._shards[reference.path][reference.index]
        # Here, so that opening a capture does not load OpenCV.
        from jaxscan.vision.images import decode_image

        name = str(self.path / reference.path)
        # An uncompressed 32-bit image with a megabyte of metadata still fits.
        limit = 4 * self.image_size[0] * self.image_size[1] + MEGABYTE
        data = read_bounded(name, limit, name=name, error=CaptureError)
        return decode_image(data, name=name, rank=frame_rank(self.pixel_format), size=self.image_size)


def open_capture(path: str | Path) -> Capture:
    """Open a capture and check all of it but the contents of its images.

    Args:
        path: The folder.

    Returns:
        The capture; its `notes` say what was left out.

    Raises:
        CaptureError: With the file, and the line or key, that is missing or wrong.
    """
    path = Path(path)
    if not path.is_dir():
        raise CaptureError(
            f"{path}: {'found a file' if path.exists() else 'no such folder'}, expected a capture's folder."
        )
    header_name, journal_name = str(path / HEADER_NAME), str(path / JOURNAL_NAME)
    header_bytes = read_bounded(header_name, MEGABYTE, name=header_name, error=CaptureError)
    header = parse_header(header_bytes, name=header_name)
    journal_bytes = read_bounded(journal_name, MAX_JOURNAL_BYTES, name=journal_name, error=CaptureError)
    names = tuple(laser.name for laser in header.laser)
    records, notes = read_journal(journal_bytes, name=journal_name, kind=header.kind, laser_names=names)
    if not records:
        raise CaptureError(f"{journal_name}: holds no complete record.")
    without_off = [record for record in records if record.off is None]
    if header.kind == "sweep" and 0 < len(without_off) < len(records):
        raise CaptureError(
            f"{journal_name}: record {without_off[0].i} has no laser-off image, but others have; "
            f"a sweep needs them all, or none."
        )
    digest = "sha256:" + hashlib.sha256(header_bytes + journal_bytes).hexdigest()
    return Capture(path, header, records, notes, digest, _check_images(path, header, records))


def _check_images(path: Path, header: CaptureHeader, records: tuple[Record, ...]) -> dict[str, np.ndarray]:
    """See that every image exists inside the folder; map the shards, and see that they reach far enough."""
    folder, shards = Folder(path), dict[str, np.ndarray]()
    for record, reference in [(one, image) for one in records for image in (one.on, one.off) if image]:
        try:
            located = folder.locate(reference)
            if reference.index is None:
                continue
            if reference.path not in shards:
                shards[reference.path] = open_shard(located, name=reference.path, shape=frame_shape(header))
            if reference.index >= len(shards[reference.path]):
                raise CaptureError(f"{reference}: the shard has only {len(shards[reference.path])} images.")
        except CaptureError as problem:
            raise CaptureError(f"{path}: record {record.i}: {problem}") from problem
    return shards
