"""A camera that plays the images of a folder: a capture, or any images in the order of their names."""

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.files.capture import (
    HEADER_NAME,
    CaptureHeader,
    Folder,
    ImageReader,
    ImageRef,
    LaserTable,
    open_capture,
)
from jaxscan.stripes import finest_steps, join_levels
from scanrig.cameras.camera import Camera, CameraIdentity, CameraSettings, Features, Frame, require, wanted
from scanrig.errors import CameraError, CameraLost


MAX_FILES = 100_000
"""Most entries that a folder may have."""
_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class FolderCamera(Camera):
    """Returns the images one after another, laser-on before laser-off, until none is left.

    It does not expose: no frames wait in it, so `drop` discards none, and a trigger has no effect.
    """

    def __init__(self, settings: CameraSettings) -> None:
        """The images of `settings.id`.

        Raises:
            CameraError: If there are none, or the capture has another size or pixel format.
        """
        self.settings, self._path = settings, Path(settings.id)
        self.identity = CameraIdentity("folder", self._path.name, "")
        self._closed = False
        self._open()

    def _open(self) -> None:
        try:
            if (self._path / HEADER_NAME).exists():
                self._header, self._images = _of_capture(self._path)
            elif self.settings.bits > 8:
                raise CameraError(
                    f"{self._path}: found no capture, but pictures are played in 8 bits; import these with "
                    "`jaxscan import`, and play the capture."
                )
            else:
                self._header, self._images = _header(self.settings), _of_pictures(self._path)
        except CaptureError as problem:
            raise CameraError(f"{self._path}: cannot be played: {problem}") from problem
        require(self.features(), wanted(self.settings), name=str(self._path))
        self._reader = ImageReader(self._path, self._header)
        self._number = 0

    def features(self) -> Features:
        camera = self._header.camera
        pixel_format = f"{camera.pixel_format.removesuffix('8')}{camera.bits or 8}"
        return {"width": camera.width, "height": camera.height, "pixel_format": pixel_format}

    def start(self) -> None:
        if self._closed:
            raise CameraLost(f"{self._path}: the camera is closed.")

    def drop(self) -> int:
        return 0

    def next(self, timeout_s: float) -> Frame:
        """The next image.

        Raises:
            CameraError: If none is left, or the file is missing, damaged or of another size.
            CameraLost: If the camera is closed.
        """
        del timeout_s
        self.start()
        if self._number >= len(self._images):
            raise CameraError(f"{self._path}: all {len(self._images)} images were played; there are no more.")
        references, bits = self._images[self._number], self._header.camera.bits or 8
        try:
            image = self._reader.frame(references)
        except CaptureError as problem:
            raise CameraError(f"{self._path}: {problem}") from problem
        if image is None:
            raise CameraError(f"{self._path}: frame {self._number} has no image.")
        if bits > 8:
            image = join_levels(image, bits) * np.uint16((1 << bits - 8) // finest_steps(bits))
        self._number += 1
        note = " ".join(map(str, references))
        return Frame(image, self._number, complete=True, note=note, bits=bits)

    def trigger(self) -> None:
        if self.trigger_mode != "software":
            raise CameraError(f'{self._path}: trigger is "{self.trigger_mode}", software triggers need "software".')

    def reopen(self) -> None:
        self._open()
        self._closed = False

    def close(self) -> None:
        self._closed = True


def _of_capture(path: Path) -> tuple[CaptureHeader, Sequence[Sequence[ImageRef]]]:
    """The images of a capture, record after record, laser-on first; the levels of a frame together."""
    capture = open_capture(path)
    frames = [frame for record in capture.records for frame in (record.on, record.off) if frame]
    return capture.header, frames if capture.bits > 8 else [(image,) for frame in frames for image in frame]


def _of_pictures(path: Path) -> Sequence[Sequence[ImageRef]]:
    """The images of a folder in the order of their names; "on" comes before "off" where only that differs."""
    try:
        with os.scandir(path) as entries:
            names = [entry.name for entry, _ in zip(entries, range(MAX_FILES + 1), strict=False)]
    except OSError as problem:
        raise CameraError(f"{path}: cannot be read: {problem.strerror}.") from problem
    if len(names) > MAX_FILES:
        raise CameraError(f"{path}: found more than {MAX_FILES} files; split them into several folders.")
    pictures = sorted((name for name in names if name.lower().endswith(_SUFFIXES)), key=_order)
    if not pictures:
        raise CameraError(f"{path}: found no images, expected files that end with {', '.join(_SUFFIXES)}.")
    inside = Folder(path)
    references = [ImageRef(name) for name in pictures]
    for reference in references:
        inside.locate(reference)
    return [(reference,) for reference in references]


def _order(name: str) -> tuple[str, int, str]:
    stem = name.rsplit(".", 1)[0]
    match = re.fullmatch(r"(.*?)[-_ ]?(on|off)", stem, re.IGNORECASE)
    return (match[1], int(match[2].lower() == "off"), name) if match else (stem, 0, name)


def _header(settings: CameraSettings) -> CaptureHeader:
    """A capture header for plain images."""
    return CaptureHeader(kind="sweep", camera=settings.table, laser=(LaserTable(),))
