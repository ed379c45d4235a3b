"""Frames of a video file, one after the other, by OpenCV."""

import os
from typing import BinaryIO

import cv2
import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.geometry import MAX_PIXELS


MOST_FRAMES = 1_000_000
BEGINNING_BYTES = 12
"""Bytes of a file that say whether it is a video."""
_EBML, _SEGMENT = b"\x1a\x45\xdf\xa3", b"\x18\x53\x80\x67"
"""How a Matroska file, and all of it behind its header, begin."""
_OPEN_RIFF = 0xFFFF_FFFF
_MOST_PARTS = 100_000
"""Most parts of a file that are examined; a video of a whole day has fewer."""


class Video:
    """A video that is read forwards; frames are counted from 0."""

    def __init__(self, path: str, beginning: bytes) -> None:
        """Open a video.

        Args:
            path: Absolute path of a regular file; it stands in messages too.
            beginning: Its first 12 bytes. Lists of other files, which a decoder would open too, are refused by them.

        Raises:
            CaptureError: If it is no video that can be read.
        """
        self._path, self._next = path, 0
        if not _is_video(beginning):
            raise CaptureError(f"{path}: found another kind of file, expected a video: AVI, MP4, MOV, MKV or WebM.")
        self._video = cv2.VideoCapture(path, cv2.CAP_FFMPEG)
        width, height = (int(self._video.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        # Frames are taken as the sensor stored them, whatever the file says about how the camera was held.
        self._video.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if not self._video.isOpened() or width < 1 or height < 1:
            self.close()
            raise CaptureError(f"{path}: cannot be decoded; the file is damaged, or its codec is not known.")
        if width * height > MAX_PIXELS:
            self.close()
            raise CaptureError(f"{path}: found {width} x {height} px, more than {MAX_PIXELS // 1_000_000} megapixels.")
        announced = self._video.get(cv2.CAP_PROP_FRAME_COUNT)
        self.announced = int(announced) if 0 < announced <= MOST_FRAMES else 0
        """Number of the frames that the file says it has, which may be an estimate; 0 if it does not say."""

    def count(self) -> int:
        """Number of the frames from here to the end, all of which are read: what a file says of itself may be wrong.

        Raises:
            CaptureError: If there are too many.
        """
        found = 0
        while self._video.grab():
            found += 1
            if found > MOST_FRAMES:
                raise CaptureError(f"{self._path}: holds more than {MOST_FRAMES} frames; cut the video.")
        self._next += found
        return found

    def frame(self, number: int) -> np.ndarray:
        """A frame, RGB uint8 [rows, columns, 3]; frames must be read in ascending order.

        Raises:
            CaptureError: If the video ends before it, or the frame is damaged.
        """
        if number < self._next:
            raise ValueError(f"Frame {number} is behind frame {self._next}: a video is read forwards.")
        found = True
        while found and self._next <= number:
            found = self._video.grab()
            self._next += 1
        image = self._video.retrieve()[1] if found else None
        if image is None or image.dtype != np.uint8 or image.ndim not in (2, 3):
            raise CaptureError(f"{self._path}: frame {number} cannot be decoded; the file is damaged.")
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB if image.ndim == 2 else cv2.COLOR_BGR2RGB))

    def close(self) -> None:
        """Close the file."""
        self._video.release()


def is_cut_short(file: BinaryIO) -> bool:
    """Whether a video is shorter than its outermost sizes say; decoders return the rest without an error.

    Args:
        file: An open AVI, MP4, MOV, MKV or WebM. A size that was left open, as by a streaming recorder,
            tells nothing.
    """
    end = file.seek(0, os.SEEK_END)
    file.seek(0)
    head = file.read(8)
    if head[:4] == b"RIFF":
        return _riff_is_short(file, end)
    if head[:4] == _EBML:
        return _segment_is_short(file, end)
    return _box_is_short(file, end)


def _riff_is_short(file: BinaryIO, end: int) -> bool:
    # A long AVI is several of these chunks, one after the other; others may stand behind the last.
    at = 0
    for _ in range(_MOST_PARTS):
        file.seek(at)
        head = file.read(8)
        size = int.from_bytes(head[4:], "little")
        if len(head) < 8 or head[:4] != b"RIFF" or size in (0, _OPEN_RIFF):
            return False
        at += 8 + size
        if at > end:
            return True
        at += size % 2
    return False


def _box_is_short(file: BinaryIO, end: int) -> bool:
    at = 0
    for _ in range(_MOST_PARTS):
        file.seek(at)
        head = file.read(16)
        size, least = int.from_bytes(head[:4], "big"), 8
        if size == 1:
            size, least = int.from_bytes(head[8:], "big"), 16
        # The last box may have no size; bytes that are no box name follow the last box.
        if len(head) < 8 or size < least or not head[4:8].isalnum():
            return False
        at += size
        if at > end:
            return True
    return False


def _segment_is_short(file: BinaryIO, end: int) -> bool:
    file.seek(len(_EBML))
    header = _ebml_size(file)
    if header is None:
        return False
    file.seek(header, os.SEEK_CUR)
    if file.read(len(_SEGMENT)) != _SEGMENT:
        return False
    size = _ebml_size(file)
    return size is not None and file.tell() + size > end


def _ebml_size(file: BinaryIO) -> int | None:
    """The size that stands next in a Matroska file; None if it was left open."""
    first = file.read(1)
    length = 9 - first[0].bit_length() if first else 9
    if length > 8:
        return None
    bits = 7 * length
    size = int.from_bytes(first + file.read(length - 1), "big") & ((1 << bits) - 1)
    return None if size == (1 << bits) - 1 else min(size, 1 << 62)


def _is_video(beginning: bytes) -> bool:
    riff = beginning[:4] == b"RIFF" and beginning[8:12] == b"AVI "
    # ISO media, old QuickTime, and Matroska.
    return riff or beginning[4:8] in (b"ftyp", b"moov", b"mdat", b"wide") or beginning[:4] == _EBML
