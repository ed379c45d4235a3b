"""The frames that a plan names, decoded: image files by all cores, videos forwards."""

import itertools
import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError, OptionError
from jaxscan.files.capture import cores
from jaxscan.files.disk import MEGABYTE, open_regular, read_bounded
from jaxscan.files.importing.listing import Source
from jaxscan.files.importing.plan import PlannedRecord
from jaxscan.geometry import MAX_PIXELS
from jaxscan.stripes import DEEP_BITS


if TYPE_CHECKING:
    from jaxscan.vision import Video


class Depth(NamedTuple):
    """The samples of a camera in images of 16 bits."""

    bits: int
    """Bits of a sample of the camera: 8, or one of `DEEP_BITS`."""
    step: int
    """Distance of its levels in the images: more than 1 where they stand at the top of the 16 bits."""
    said: str

    def samples(self, image: np.ndarray, name: str) -> np.ndarray:
        """An image as the camera gave it: uint16, or uint8 of 8 bits."""
        if image.dtype != np.uint16:
            raise CaptureError(f"{name}: found 8 bits, expected 16 like the first image.")
        largest = int(image.max(initial=0))
        if largest > ((1 << self.bits) - 1) * self.step or (self.step > 1 and np.any(image % self.step)):
            raise CaptureError(
                f"{name}: found samples up to {largest}, expected {self.bits} bits in steps of {self.step} as in the "
                "images looked at before; say --bits 10, 12, 14 or 16."
            )
        return (image // self.step).astype(np.uint16 if self.bits > 8 else np.uint8)


def depth_of(images: Iterable[np.ndarray], bits: int | None) -> Depth:
    """Find how images of 16 bits hold the samples of the camera.

    Args:
        images: Some of them, uint16.
        bits: Of the camera, where the user says it.
    """
    used, largest, stretched = 0, 0, True
    for image in images:
        used |= int(np.bitwise_or.reduce(image, axis=None))
        largest = max(largest, int(image.max(initial=0)))
        stretched = stretched and not np.any(image % 257)
    empty = (used & -used).bit_length() - 1 if used else 0
    if bits is not None:
        if largest < 1 << bits:
            return Depth(bits, 1, f"{bits} bits, as --bits says")
        if empty >= 16 - bits:
            return Depth(bits, 1 << 16 - bits, f"{bits} bits at the top of 16, as --bits says")
        raise OptionError(
            f"--bits {bits}: found samples up to {largest}, expected them below {1 << bits}, or multiples of "
            f"{1 << 16 - bits}."
        )
    if stretched and used:
        return Depth(8, 257, "8 bits: all samples are multiples of 257")
    if empty >= 2:
        found = max(8, -(-(16 - empty) // 2) * 2)
        return Depth(found, 1 << 16 - found, f"{found} bits at the top of 16: the last {empty} are always empty")
    found = next(one for one in DEEP_BITS if largest < 1 << one)
    return Depth(found, 1, f"{found} bits: the largest sample is {largest} (otherwise --bits)")


class FrameKind(NamedTuple):
    """Size and kind of the images, as the first one has them."""

    width: int
    height: int
    rank: int
    """2 for grey or raw Bayer, 3 for colour."""
    compression: str | None
    depth: Depth | None = None
    """How the samples are stored; None for images of 8 bits."""


class FrameReader:
    """Reads the images of a plan; a context manager."""

    def __init__(self, folder: Path, kind: FrameKind | None = None) -> None:
        """`kind` is the kind of the images, if it is known already."""
        self._folder = Path(os.path.abspath(folder))
        self._videos: dict[str, Video] = {}
        self._last: dict[str, tuple[int | None, np.ndarray]] = {}
        self._kind = kind
        self._whole = kind is not None
        """Whether the kind is known for good."""

    def __enter__(self) -> "FrameReader":
        return self

    def __exit__(self, *exception: object) -> None:
        for video in self._videos.values():
            video.close()

    def kind(self, source: Source, others: Sequence[Source], bits: int | None) -> FrameKind:
        """The kind of an image, which all others must have.

        Args:
            source: The image.
            others: Some more, of which 16 bits are looked at.
            bits: Bits of the camera's samples, where the user says it.
        """
        from jaxscan.vision import is_jpeg

        compression: str | None = "video"
        if source.frame is not None:
            video = open_video(self._folder, source.name)
            image = video.frame(source.frame)
            video.close()
        else:
            data = self._bytes(source, 8 * MAX_PIXELS + MEGABYTE)
            image, compression = self._decoded(data, source), "jpeg" if is_jpeg(data) else None
        self._kind = FrameKind(image.shape[1], image.shape[0], image.ndim, compression)
        if image.dtype == np.uint16:
            more = (self._file(other) for other in others if other.frame is None)
            depth = depth_of(itertools.chain([image], (one for one in more if one.dtype == np.uint16)), bits)
            self._kind = self._kind._replace(depth=depth)
        elif bits is not None:
            raise OptionError(f"--bits {bits}: found 8 bits in {source.name}, expected images of 16 bits.")
        self._whole = True
        return self._kind

    def records(
        self, records: Sequence[PlannedRecord]
    ) -> Iterator[tuple[PlannedRecord, list[np.ndarray], list[np.ndarray]]]:
        """All records with their laser-on and laser-off images, decoded ahead.

        Yields:
            The record, and its images, uint8 [rows, columns(, 3)]; uint16 of cameras with more than 8 bits.
        """
        with ThreadPoolExecutor(cores(), thread_name_prefix="jaxscan-import") as pool:
            size = 2 * cores()
            for start in range(0, len(records), size):
                batch = records[start : start + size]
                sources = [source for record in batch for source in (*record.on, *record.off)]
                files = dict.fromkeys(source for source in sources if source.frame is None)
                images = dict(zip(files, pool.map(self._file, files), strict=True))
                # A video is read forwards, and each frame once, so in the order of the numbers.
                for source in sorted({source for source in sources if source.frame is not None}):
                    images[source] = self._frame(source)
                for record in batch:
                    yield record, [images[one] for one in record.on], [images[one] for one in record.off]

    def _file(self, source: Source) -> np.ndarray:
        kind = self._known()
        return self._decoded(self._bytes(source, 8 * kind.width * kind.height + MEGABYTE), source)

    def _frame(self, source: Source) -> np.ndarray:
        kind = self._known()
        if source.name not in self._videos:
            self._videos[source.name] = open_video(self._folder, source.name)
        # A laser-off frame may serve several records.
        last, image = self._last.get(source.name, (None, None))
        if image is None or last != source.frame:
            image = self._videos[source.name].frame(source.frame or 0)
            self._last[source.name] = source.frame, image
        if image.shape[:2] != (kind.height, kind.width) or kind.rank != 3:
            raise CaptureError(
                f"{self._folder / source.name}: found {image.shape[1]} x {image.shape[0]} px in colour, expected "
                f"{kind.width} x {kind.height} px like the first image."
            )
        return image

    def _known(self) -> FrameKind:
        if self._kind is None:
            raise ValueError("The kind of the images is looked at first.")
        return self._kind

    def _bytes(self, source: Source, limit: int) -> bytes:
        return read_bounded(self._folder / source.name, limit, error=CaptureError, links="refuse")

    def _decoded(self, data: bytes, source: Source) -> np.ndarray:
        from jaxscan.vision import decode_image

        name, kind = str(self._folder / source.name), self._kind
        rank, size = (None, None) if kind is None else (kind.rank, kind[:2])
        image = decode_image(data, name=name, rank=rank, size=size, deep=True)
        if kind is not None and kind.depth is not None:
            return kind.depth.samples(image, name)
        if kind is not None and self._whole and image.dtype != np.uint8:
            raise CaptureError(f"{name}: found 16 bits, expected 8 like the first image.")
        return image


def open_video(folder: Path, name: str) -> "Video":
    """A video in an untrusted folder."""
    from jaxscan.vision import Video
    from jaxscan.vision.video import BEGINNING_BYTES

    path = Path(os.path.abspath(folder / name))
    with open_regular(path, error=CaptureError, links="refuse") as file:
        beginning = file.read(BEGINNING_BYTES)
    return Video(str(path), beginning)


def count_frames(folder: Path, name: str) -> tuple[int, int]:
    """Number of frames of a video, and the number that the file says it has; 0 if it does not say.

    Raises:
        CaptureError: If it cannot be read, has none, or is cut short.
    """
    from jaxscan.vision.video import is_cut_short

    video = open_video(folder, name)
    try:
        found = video.count()
    finally:
        video.close()
    path = folder / name
    if not found:
        raise CaptureError(f"{path}: no frame can be decoded; the file is damaged, or its codec is not known.")
    with open_regular(path, error=CaptureError, links="refuse") as file:
        short = is_cut_short(file)
    if short:
        of = f"of {video.announced} " if video.announced >= found else ""
        raise CaptureError(
            f"{path}: the file ends before its own header says, in or after frame {found} {of}(the last may be "
            "damaged): copy it again, or cut it cleanly with a video program."
        )
    return found, video.announced
