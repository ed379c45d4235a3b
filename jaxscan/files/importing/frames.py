"""The frames that a plan names, decoded: image files by all cores, videos forwards."""

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import cores
from jaxscan.files.disk import MEGABYTE, open_regular, read_bounded
from jaxscan.files.importing.plan import PlannedRecord, Source
from jaxscan.geometry import MAX_PIXELS


if TYPE_CHECKING:
    from jaxscan.vision import Video


class FrameKind(NamedTuple):
    """Size and kind of the images, as the first one has them."""

    width: int
    height: int
    rank: int
    """2 for grey or raw Bayer, 3 for colour."""
    compression: str | None
    """"jpeg", "video", or None."""


class FrameReader:
    """Reads the images of a plan; a context manager."""

    def __init__(self, folder: Path) -> None:
        self._folder = Path(os.path.abspath(folder))
        self._videos: dict[str, Video] = {}
        self._last: dict[str, tuple[int | None, np.ndarray]] = {}
        self._kind: FrameKind | None = None

    def __enter__(self) -> "FrameReader":
        return self

    def __exit__(self, *exception: object) -> None:
        for video in self._videos.values():
            video.close()

    def kind(self, source: Source) -> FrameKind:
        """The kind of an image, which all others must have.

        Raises:
            CaptureError: If it cannot be read.
        """
        from jaxscan.vision import is_jpeg

        compression: str | None = "video"
        if source.frame is not None:
            video = open_video(self._folder, source.name)
            image = video.frame(source.frame)
            video.close()
        else:
            data = self._bytes(source, 4 * MAX_PIXELS + MEGABYTE)
            image, compression = self._decoded(data, source), "jpeg" if is_jpeg(data) else None
        self._kind = FrameKind(image.shape[1], image.shape[0], image.ndim, compression)
        return self._kind

    def records(
        self, records: Sequence[PlannedRecord]
    ) -> Iterator[tuple[PlannedRecord, list[np.ndarray], list[np.ndarray]]]:
        """All records with their laser-on and laser-off images, decoded ahead.

        Yields:
            The record, and its images, uint8 [rows, columns(, 3)].

        Raises:
            CaptureError: With the name of the image that cannot be read or is of another kind.
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
        return self._decoded(self._bytes(source, 4 * kind.width * kind.height + MEGABYTE), source)

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

        rank, size = (None, None) if self._kind is None else (self._kind.rank, self._kind[:2])
        return decode_image(data, name=str(self._folder / source.name), rank=rank, size=size)


def open_video(folder: Path, name: str) -> "Video":
    """A video in a stranger's folder.

    Raises:
        CaptureError: If it is a link, no regular file, or no video.
    """
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
