"""USB cameras through OpenCV: opened, set up with every setting read back, and read."""

import os
import re
import stat
import threading
import time
from collections import deque
from pathlib import Path

import cv2
import numpy as np

from scanrig.cameras.camera import Camera, CameraIdentity, CameraSettings, Features, Frame, require
from scanrig.errors import CameraError, CameraLost, CameraTimeout


_MANUAL = 1.0
_PER_S = 1e4
"""V4L2's unit of exposure is 100 µs."""
_DRIVER = "V4L2"
"""The backend whose properties are known; for others their meaning differs from camera to camera."""


def apply_settings(capture: cv2.VideoCapture, settings: CameraSettings, *, name: str) -> Features:
    """Apply the settings that the backend supports, no automatic functions; returns what it must report then."""
    if capture.getBackendName() != _DRIVER:
        return {"width": settings.width, "height": settings.height}
    # The size first, since it may reset the rest. One buffer, if the driver supports that.
    capture.set(cv2.CAP_PROP_FRAME_WIDTH, settings.width)
    capture.set(cv2.CAP_PROP_FRAME_HEIGHT, settings.height)
    capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    # Cameras without these functions refuse, which is fine; functions that stay on show up in the comparison.
    capture.set(cv2.CAP_PROP_AUTO_WB, 0)
    capture.set(cv2.CAP_PROP_AUTOFOCUS, 0)
    if not capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL):
        raise CameraError(f"{name}: auto_exposure: cannot be switched off.")
    if not capture.set(cv2.CAP_PROP_EXPOSURE, round(_PER_S * settings.exposure_ms * 1e-3)):
        raise CameraError(f"{name}: exposure_ms: cannot be set.")
    capture.set(cv2.CAP_PROP_GAIN, settings.gain_db)
    return {
        "width": settings.width,
        "height": settings.height,
        "exposure_s": settings.exposure_ms * 1e-3,
        "gain_db": settings.gain_db,
        "auto_exposure": _MANUAL,
        "auto_white_balance": 0.0,
        "autofocus": 0.0,
    }


def read_features(capture: cv2.VideoCapture, settings: CameraSettings) -> Features:
    """The camera's settings as the backend reports them; settings that it cannot report are absent."""
    features: Features = {
        "width": int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
        "height": int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        "pixel_format": settings.pixel_format,
        "trigger": "free",
        "backend": capture.getBackendName(),
    }
    if features["backend"] != _DRIVER:
        return features
    features["exposure_s"] = capture.get(cv2.CAP_PROP_EXPOSURE) / _PER_S
    features["auto_exposure"] = capture.get(cv2.CAP_PROP_AUTO_EXPOSURE)
    optional = {
        "gain_db": cv2.CAP_PROP_GAIN,
        "auto_white_balance": cv2.CAP_PROP_AUTO_WB,
        "autofocus": cv2.CAP_PROP_AUTOFOCUS,
    }
    # A camera without one reports −1.
    features |= {key: value for key, prop in optional.items() if (value := capture.get(prop)) >= 0}
    return features


def silent(backend: str) -> str:
    """The note for frames whose backend cannot report exposure and gain; "" if it can."""
    return "" if backend == _DRIVER else f"exposure and gain are not known: {backend} does not report them"


_SCHEME = re.compile(r"(https?|rtsps?|rtp|rtmps?|udp|tcp|srt|mms)://", re.IGNORECASE)
"""URLs of streams; FFmpeg's others reach files and pipes, whose reading has no timeout."""
_VIDEO4LINUX = 81
"""Linux' number of the driver of video devices."""
_DEVICES = Path("/sys/class/video4linux")
_OPEN_MS = 5000
_READ_MS = 10_000
"""Longest stall of a stream before OpenCV gives up."""
_WAITING = 4
_ANSWER_S = 2.0
_SAME_CLOCK_S = 5.0
"""A time stamp this near to the monotonic clock comes from that clock: V4L2's do, those of streams do not."""


class OpenCVCamera(Camera):
    """A free-running camera.

    `drop` marks a time; `next` then returns only frames exposed after it. Discarded are the next `flush_frames` frames,
    and all whose arrival or time stamp is less than an exposure time after the mark.
    """

    def __init__(self, settings: CameraSettings) -> None:
        """Open the camera, apply the settings that it supports, read them back and compare. Raises as `open_camera`."""
        self.settings = settings
        self._source = _source(settings.id)
        self._changed = threading.Condition()
        self._queue: deque[Frame] = deque(maxlen=_WAITING)
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._started, self._ended, self._note = False, "", ""
        self._open()

    def features(self) -> Features:
        """Its settings as they were when it was opened: OpenCV allows only one thread, which reads frames by now."""
        if self._stop.is_set():
            raise CameraLost(f"{self.identity}: the camera is closed; reopen it.")
        return dict(self._features)

    def start(self) -> None:
        if self._stop.is_set():
            raise CameraLost(f"{self.identity}: the camera is closed; reopen it.")
        self._started = True
        if self._thread is None:
            self._thread = threading.Thread(target=self._read, args=(self._capture, self._stop), daemon=True)
            self._thread.start()

    def drop(self) -> int:
        with self._changed:
            waiting = len(self._queue)
            self._queue.clear()
            self._since, self._flush = time.monotonic(), self.settings.flush_frames
            return waiting

    def next(self, timeout_s: float) -> Frame:
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._ended, timeout_s)
            if self._queue:
                return self._queue.popleft()
            if self._ended:
                raise CameraLost(f"{self.identity}: {self._ended}")
        raise CameraTimeout(f"{self.identity}: no frame within {timeout_s:g} s.")

    def trigger(self) -> None:
        raise CameraError(f"{self.identity}: runs free and takes no triggers.")

    def reopen(self) -> None:
        started = self._started
        self.close()
        self._stop = threading.Event()
        try:
            self._open()
        except CameraError:
            self._stop.set()
            self._started = started
            raise
        if started:
            self.start()

    def close(self) -> None:
        self._stop.set()
        self._started = False
        with self._changed:
            self._ended = self._ended or "the camera is closed; reopen it."
            self._changed.notify_all()
        thread, self._thread = self._thread, None
        if thread is None:
            self._capture.release()
        else:
            # The thread releases the camera itself; if it is stuck in a read, after the read has given up.
            thread.join(_ANSWER_S)

    def _open(self) -> None:
        name = f'opencv "{self._source}"'
        _require_source(self._source, name)
        timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPEN_MS, cv2.CAP_PROP_READ_TIMEOUT_MSEC, _READ_MS]
        # Timeouts are for streams only; a driver refuses to open with them.
        stream = isinstance(self._source, str) and _SCHEME.match(self._source)
        self._capture = (
            cv2.VideoCapture(self._source, cv2.CAP_FFMPEG, timeouts) if stream else cv2.VideoCapture(self._source)
        )
        if not self._capture.isOpened():
            self._capture.release()
            raise CameraLost(f"{name}: cannot be opened; check that it exists, is not in use, and may be read.")
        backend = self._capture.getBackendName()
        self.identity = CameraIdentity("opencv", backend, str(self._source))
        try:
            expected = apply_settings(self._capture, self.settings, name=str(self.identity))
            self._features = read_features(self._capture, self.settings)
            require(self._features, expected, name=str(self.identity))
        except CameraError:
            self._capture.release()
            raise
        self._note = silent(backend)
        self._ended = ""
        self._since, self._flush = time.monotonic(), self.settings.flush_frames

    def _read(self, capture: cv2.VideoCapture, stop: threading.Event) -> None:
        """Read every frame as it comes, until there are no more."""
        try:
            ended = self._take_all(capture, stop)
        except cv2.error as problem:
            # Reported to the caller that waits for a frame, instead of ending this thread with an error.
            ended = f"its frames cannot be read: {' '.join(str(problem).split())}"
        capture.release()
        with self._changed:
            if not stop.is_set():
                self._ended = ended
            self._changed.notify_all()

    def _take_all(self, capture: cv2.VideoCapture, stop: threading.Event) -> str:
        """Read frames until there are no more; returns the reason."""
        while not stop.is_set():
            taken, pixels = capture.read()
            arrival = time.monotonic()
            if not taken:
                return "the camera is gone: its frames ended."
            image = _image(pixels, self.settings)
            stamp = 1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC)
            if image is None:
                return (
                    f"its frames are {pixels.shape[1]} x {pixels.shape[0]} px, expected "
                    f"{self.settings.width} x {self.settings.height} px."
                )
            with self._changed:
                if stop.is_set():
                    break
                self._arrive(image, stamp, arrival)
                self._changed.notify_all()
        return "the camera is closed; reopen it."

    def _arrive(self, image: np.ndarray, stamp: float, arrival: float) -> None:
        exposed_by = min(stamp, arrival) if abs(stamp - arrival) < _SAME_CLOCK_S else arrival
        latest_start = exposed_by - self.settings.exposure_ms * 1e-3
        if self._flush > 0 or latest_start < self._since:
            self._flush -= 1
            return
        self._queue.append(Frame(image, -1, complete=True, note=self._note))


def _source(name: str) -> int | str:
    """Index, path or URL of a camera; "" is the first one."""
    return int(name or 0) if re.fullmatch("[0-9]{0,4}", name) else name


def _require_source(source: int | str, name: str) -> None:
    """Refuse what is no camera: OpenCV would wait for ever for somebody to write into a pipe."""
    if isinstance(source, int) or _SCHEME.match(source):
        return
    try:
        found = os.stat(source)
    except (OSError, ValueError) as problem:
        why = problem.strerror if isinstance(problem, OSError) else problem
        raise CameraLost(f"{name}: cannot be opened: {why}; expected an index, a device, a file or a URL.") from problem
    video = stat.S_ISCHR(found.st_mode) and os.major(found.st_rdev) == _VIDEO4LINUX
    if not (video or stat.S_ISREG(found.st_mode)):
        raise CameraError(f"{name}: is neither a video device nor a file; `jaxscan doctor` lists the devices.")


def _image(pixels: np.ndarray, settings: CameraSettings) -> np.ndarray | None:
    """A frame in the configured pixel format, with its own memory; None if it has another size."""
    if pixels.shape[:2] != (settings.height, settings.width) or pixels.dtype != np.uint8:
        return None
    colours = 1 if pixels.ndim == 2 else pixels.shape[2]
    if settings.pixel_format == "mono8":
        return pixels.reshape(pixels.shape[:2]).copy() if colours == 1 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY)
    return cv2.cvtColor(pixels, cv2.COLOR_GRAY2RGB if colours == 1 else cv2.COLOR_BGR2RGB)


def found_by_opencv() -> list[str]:
    """One line for each video device of this computer."""
    listed = []
    for folder in sorted(_DEVICES.glob("video*")):
        try:
            # The device chose its name, in any encoding.
            model = (folder / "name").read_bytes().decode(errors="replace").strip()
        except OSError as problem:
            model = f"cannot be asked: {problem.strerror}"
        listed.append(f'opencv "/dev/{folder.name}": {model}')
    return listed
