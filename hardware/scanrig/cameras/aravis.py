"""GigE Vision and USB3 Vision cameras, through libaravis."""

import ctypes
import time
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.stripes import frame_rank
from scanrig.cameras.aravis_binding import STATUS, SUCCESS, AravisError, load_aravis, text
from scanrig.cameras.aravis_control import Say
from scanrig.cameras.aravis_setup import apply_settings, connect, read_features
from scanrig.cameras.features import require, wanted
from scanrig.cameras.frame import CameraIdentity, ClosedAtExit, Features, Frame
from scanrig.cameras.numbers import FrameNumbers
from scanrig.cameras.settings import CameraSettings, TriggerMode
from scanrig.errors import CameraError, CameraLost, CameraTimeout


Result = TypeVar("Result")
_BUFFERS = 8
"""Frames that may wait; a step of a sweep has two."""
_QUIET_S, _MOST_PASSING_S = 0.1, 2.0
_SLICE_S = 0.2
"""How often a waiting call checks that the camera is still connected."""


class AravisCamera(ClosedAtExit):
    """A camera that speaks GenICam.

    Its heartbeat shows whether it is still connected; it is also queried when a frame is late. If the camera is gone, a
    call may take 2.5 s longer than its timeout.
    """

    def __init__(self, settings: CameraSettings, say: Say = lambda sentence: None) -> None:
        """Open the camera, apply `settings`, read them back and compare.

        Args:
            settings: Camera and settings.
            say: Called with a sentence before a long wait, at every opening.

        Raises:
            CameraLost: If it is not found.
            CameraError: If several cameras fit, another program uses it, or it does not take a setting.
            DependencyError: If libaravis is not installed.
        """
        self._aravis, self._settings, self._say = load_aravis(), settings, say
        self.trigger_mode: TriggerMode = settings.trigger
        shape = settings.height, settings.width, 3
        self._shape = shape[: frame_rank(settings.pixel_format)]
        self._bytes = int(np.prod(self._shape))
        self._camera: int | None = None
        self._stream: int | None = None
        self._running = self._started = self._lost = False
        self._numbers = FrameNumbers()
        self._missing_before = self._foreign = 0
        self._counts = {"frames": 0, "incomplete": 0, "dropped": 0}
        self._identity = self._open()

    @property
    def identity(self) -> CameraIdentity:
        return self._identity

    def features(self) -> Features:
        return self._ask("read its features", lambda camera: read_features(self._aravis, camera, self._settings))

    def counts(self) -> dict[str, int]:
        """The counts of every camera, and "underruns": frames for which no buffer was free."""
        counts = {**self._counts, "missing": self._missing_before + self._numbers.missing, "underruns": 0}
        if self._stream is not None:
            counts["underruns"] = self._underruns(self._stream) - self._foreign
        return counts

    def _underruns(self, stream: int) -> int:
        numbers = [ctypes.c_uint64() for _ in range(3)]
        self._aravis.stream_get_statistics(stream, *(ctypes.byref(one) for one in numbers))
        return int(numbers[2].value)

    def _pass_by(self, stream: int) -> int:
        """Let packets of other programs pass before there is a buffer that they could be taken for a frame in.

        With the rights of root libaravis reads the whole interface, and until its filter is set it keeps every packet.

        Returns:
            How many there were.
        """
        before, end = -1, time.monotonic() + _MOST_PASSING_S
        while (count := self._underruns(stream)) != before and time.monotonic() < end:
            before = count
            time.sleep(_QUIET_S)
        return count

    def start(self) -> None:
        if not self._running:
            self._ask("start", self._aravis.camera_start_acquisition)
        self._running = self._started = True

    def drop(self) -> int:
        """Discard waiting frames, and of a free-running camera also the frame being exposed."""
        dropped = 0
        while self._stream is not None and (buffer := self._aravis.stream_try_pop_buffer(self._stream)):
            self._release(buffer)
            dropped += 1
        if self.trigger_mode == "free" and self._running:
            dropped += self._flush()
        self._counts["dropped"] += dropped
        return dropped

    def next(self, timeout_s: float) -> Frame:
        buffer = self._pop(timeout_s)
        arrival = time.monotonic()
        try:
            frame = self._frame(buffer, arrival)
        finally:
            self._push(buffer)
        self._counts["frames"] += 1
        self._counts["incomplete"] += not frame.complete
        return frame

    def trigger(self) -> None:
        if self.trigger_mode != "software":
            raise CameraError(f'{self}: trigger is "{self.trigger_mode}", software triggers need "software".')
        self._ask("take a trigger", self._aravis.camera_software_trigger)

    def reopen(self) -> None:
        before = self._identity
        self._let_go()
        found = self._open()
        if found != before:
            self._let_go()
            raise CameraError(f"found the camera {found}, expected {before}; a sweep is of one camera.")
        if self._started:
            self.start()

    def adopt(self, settings: CameraSettings) -> None:
        self._settings = settings
        self.reopen()

    def close(self) -> None:
        self._started = False
        self._let_go()

    def _let_go(self) -> None:
        if self._camera is not None and self._running and not self._lost:
            try:
                self._aravis.camera_stop_acquisition(self._camera)
            except AravisError:
                # It is gone, or it stops by itself when its heartbeat ends.
                self._lost = True
        self._running = False
        stream, self._stream = self._stream, None
        camera, self._camera = self._camera, None
        for one in (stream, camera):
            if one is not None:
                self._aravis.unref(one)

    def __str__(self) -> str:
        return str(getattr(self, "_identity", None) or f"aravis {self._settings.id}".strip())

    def _open(self) -> CameraIdentity:
        camera = self._camera = connect(self._aravis, self._settings.id, self._say)
        self._lost = False
        try:
            identity = CameraIdentity(
                "aravis",
                f"{text(self._aravis.camera_get_vendor_name(camera))} "
                f"{text(self._aravis.camera_get_model_name(camera))}",
                text(self._aravis.camera_get_device_serial_number(camera)),
            )
            apply_settings(self._aravis, camera, self._settings, name=str(identity))
            found = read_features(self._aravis, camera, self._settings)
            require(found, wanted(self._settings), name=str(identity))
            payload = self._aravis.camera_get_payload(camera)
            if payload < self._bytes:
                raise CameraError(f"{identity}: sends {payload} bytes per frame, expected {self._bytes}.")
            self._stream = self._aravis.camera_create_stream(camera, None, None)
            self._foreign = self._pass_by(self._stream)
            for _ in range(_BUFFERS):
                self._push(self._aravis.buffer_new_allocate(payload))
        except AravisError as problem:
            self._lost = True
            self._let_go()
            raise CameraLost(f"{self}: went away while it was set up: {problem}") from problem
        except CameraError:
            self._let_go()
            raise
        self._missing_before += self._numbers.missing
        self._numbers = FrameNumbers()
        return identity

    def _ask(self, action: str, call: Callable[[int], Result]) -> Result:
        """The result of a call to the camera, which must be open; `action` names it in errors."""
        if self._camera is None:
            raise CameraLost(f"{self}: the camera is closed; reopen it.")
        try:
            return call(self._camera)
        except AravisError as problem:
            if self._is_there():
                raise CameraError(f"{self}: cannot {action}: {problem}") from problem
            self._lost = True
            raise CameraLost(f"{self}: the camera is gone: cannot {action}: {problem}") from problem

    def _is_there(self) -> bool:
        """Whether it answers and this program still controls it."""
        try:
            self._aravis.camera_get_integer(self._camera, b"Width")
        except AravisError:
            return False
        return self._is_ours()

    def _is_ours(self) -> bool:
        device = self._aravis.camera_get_device(self._camera)
        return not self._aravis.camera_is_gv_device(self._camera) or bool(self._aravis.gv_device_is_controller(device))

    def _pop(self, timeout_s: float) -> int:
        """The next buffer; the caller must give it back."""
        if self._camera is None or self._stream is None:
            raise CameraLost(f"{self}: the camera is closed; reopen it.")
        end = time.monotonic() + timeout_s
        while True:
            left = max(0.0, end - time.monotonic())
            if buffer := self._aravis.stream_timeout_pop_buffer(self._stream, round(1e6 * min(left, _SLICE_S))):
                return buffer
            if not self._is_ours():
                self._lost = True
                raise CameraLost(f"{self}: the camera is gone: its heartbeat ended.")
            if left <= _SLICE_S:
                break
        if not self._is_there():
            self._lost = True
            raise CameraLost(f"{self}: the camera is gone: it does not answer.")
        raise CameraTimeout(
            f"{self}: no frame within {timeout_s:g} s"
            + (", expected one per trigger; check the trigger wire and trigger_source." * (self.trigger_mode != "free"))
        )

    def _frame(self, buffer: int, arrival: float) -> Frame:
        status = self._aravis.buffer_get_status(buffer)
        number, advance = self._numbers.take(self._aravis.buffer_get_frame_id(buffer))
        size = ctypes.c_size_t()
        data = self._aravis.buffer_get_data(buffer, ctypes.byref(size))
        notes = [] if status == SUCCESS else [STATUS.get(status, f"status {status}")]
        if status == SUCCESS:
            found = self._aravis.buffer_get_image_height(buffer), self._aravis.buffer_get_image_width(buffer)
            if found != self._shape[:2] or size.value < self._bytes:
                notes.append(f"{found[1]} x {found[0]} px and {size.value} bytes, expected {self._bytes}")
        complete = not notes
        if advance != 1:
            notes.append(f"{advance - 1} frames are missing before it" if advance > 1 else "out of order")
        image = np.frombuffer(ctypes.string_at(data, self._bytes), np.uint8).reshape(self._shape).copy()
        stamp = self._aravis.buffer_get_timestamp(buffer)
        return Frame(image, number, stamp * 1e-9 if stamp else None, arrival, complete, "; ".join(notes))

    def _release(self, buffer: int) -> None:
        """Give a buffer back unread; its frame does not count as missing."""
        self._numbers.take(self._aravis.buffer_get_frame_id(buffer))
        self._push(buffer)

    def _push(self, buffer: int) -> None:
        # Zeroed, so that missing parts of the next frame are black and do not show an older frame.
        size = ctypes.c_size_t()
        data = self._aravis.buffer_get_data(buffer, ctypes.byref(size))
        if data:
            ctypes.memset(data, 0, self._bytes)
        self._aravis.stream_push_buffer(self._stream, buffer)

    def _flush(self) -> int:
        """Discard frames of a free-running camera: at least `flush_frames`, and for at least an exposure time."""
        since, flushed = time.monotonic(), 0
        exposure_s = self._settings.exposure_ms * 1e-3
        while flushed < self._settings.flush_frames or time.monotonic() < since + exposure_s:
            buffer = self._pop(10.0 * exposure_s + 1.0)
            self._release(buffer)
            flushed += 1
        return flushed


def found_by_aravis() -> list[str]:
    """One line for each camera that answers on any interface."""
    try:
        aravis = load_aravis()
    except DependencyError as problem:
        return [f"aravis: {problem}"]
    aravis.update_device_list()
    parts = "id", "vendor", "model", "serial_nbr", "address"
    listed = []
    for index in range(aravis.get_n_devices()):
        ident, vendor, model, serial, address = (text(getattr(aravis, f"get_device_{part}")(index)) for part in parts)
        listed.append(f'aravis "{ident}": {vendor} {model}, serial number {serial}, at {address}')
    return listed
