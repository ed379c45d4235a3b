"""GenICam cameras through libaravis-0.8, by ctypes: found, taken over from a process that is gone, set up, and read."""

import contextlib
import ctypes
import functools
import ipaddress
import time
from collections.abc import Callable
from ctypes import (
    CDLL,
    POINTER,
    Structure,
    byref,
    c_char_p,
    c_double,
    c_int,
    c_int64,
    c_size_t,
    c_uint,
    c_uint32,
    c_uint64,
    c_void_p,
)
from typing import Any, TypeVar

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.stripes import DEEP_BITS, frame_rank
from scanrig.cameras.camera import Camera, CameraIdentity, CameraSettings, Features, Frame, require, wanted
from scanrig.errors import CameraError, CameraLost, CameraTimeout


LIBRARY = "libaravis-0.8.so.0"
SUCCESS = 0
STATUS = {
    -1: "unknown status",
    0: "complete",
    1: "empty",
    2: "not all of it came in time",
    3: "packets are missing",
    4: "packets are out of order",
    5: "of another size than announced",
    6: "still being filled",
    7: "aborted",
    8: "of an unknown kind",
}
RANGE_CHECK = 1
ACCESS_CHECK = 1


class AravisError(Exception):
    """An error of libaravis; callers turn it into an error with the camera's name."""


class _GError(Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


_WITH_ERROR: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_camera_new": (c_void_p, (c_char_p,)),
    "arv_camera_get_vendor_name": (c_char_p, (c_void_p,)),
    "arv_camera_get_model_name": (c_char_p, (c_void_p,)),
    "arv_camera_get_device_serial_number": (c_char_p, (c_void_p,)),
    "arv_camera_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p)),
    "arv_camera_get_payload": (c_uint, (c_void_p,)),
    "arv_camera_start_acquisition": (None, (c_void_p,)),
    "arv_camera_stop_acquisition": (None, (c_void_p,)),
    "arv_camera_software_trigger": (None, (c_void_p,)),
    "arv_camera_clear_triggers": (None, (c_void_p,)),
    "arv_camera_set_region": (None, (c_void_p, c_int, c_int, c_int, c_int)),
    "arv_camera_get_region": (None, (c_void_p, POINTER(c_int), POINTER(c_int), POINTER(c_int), POINTER(c_int))),
    "arv_camera_is_feature_available": (c_int, (c_void_p, c_char_p)),
    "arv_camera_is_exposure_time_available": (c_int, (c_void_p,)),
    "arv_camera_is_gain_available": (c_int, (c_void_p,)),
    "arv_camera_set_exposure_time": (None, (c_void_p, c_double)),
    "arv_camera_get_exposure_time": (c_double, (c_void_p,)),
    "arv_camera_set_gain": (None, (c_void_p, c_double)),
    "arv_camera_get_gain": (c_double, (c_void_p,)),
    "arv_camera_set_string": (None, (c_void_p, c_char_p, c_char_p)),
    "arv_camera_get_string": (c_char_p, (c_void_p, c_char_p)),
    "arv_camera_get_integer": (c_int64, (c_void_p, c_char_p)),
    "arv_camera_gv_set_packet_size": (None, (c_void_p, c_int)),
    "arv_camera_gv_get_packet_size": (c_uint, (c_void_p,)),
    "arv_device_read_register": (c_int, (c_void_p, c_uint64, POINTER(c_uint32))),
    "arv_device_write_register": (c_int, (c_void_p, c_uint64, c_uint32)),
    "arv_gv_device_take_control": (c_int, (c_void_p,)),
}
"""Functions whose last argument is a GError**: their results, and their arguments without it."""

_PLAIN: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c_uint, ()),
    "arv_get_device_id": (c_char_p, (c_uint,)),
    "arv_get_device_physical_id": (c_char_p, (c_uint,)),
    "arv_get_device_address": (c_char_p, (c_uint,)),
    "arv_get_device_vendor": (c_char_p, (c_uint,)),
    "arv_get_device_model": (c_char_p, (c_uint,)),
    "arv_get_device_serial_nbr": (c_char_p, (c_uint,)),
    "arv_camera_get_device": (c_void_p, (c_void_p,)),
    "arv_camera_is_gv_device": (c_int, (c_void_p,)),
    "arv_camera_set_range_check_policy": (None, (c_void_p, c_int)),
    "arv_camera_set_access_check_policy": (None, (c_void_p, c_int)),
    "arv_gv_device_is_controller": (c_int, (c_void_p,)),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p)),
    "arv_stream_try_pop_buffer": (c_void_p, (c_void_p,)),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64)),
    "arv_stream_get_statistics": (None, (c_void_p, POINTER(c_uint64), POINTER(c_uint64), POINTER(c_uint64))),
    "arv_buffer_new_allocate": (c_void_p, (c_size_t,)),
    "arv_buffer_get_status": (c_int, (c_void_p,)),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_buffer_get_image_width": (c_int, (c_void_p,)),
    "arv_buffer_get_image_height": (c_int, (c_void_p,)),
    "g_object_unref": (None, (c_void_p,)),
    "g_clear_error": (None, (c_void_p,)),
}


class Aravis:
    """The functions by short names: `camera_get_gain` is `arv_camera_get_gain`, `unref` is `g_object_unref`."""

    def __init__(self, library: CDLL) -> None:
        self._library = library
        for name, (result, arguments) in _PLAIN.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
            setattr(self, _short(name), function)
        for name, (result, arguments) in _WITH_ERROR.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, (*arguments, POINTER(POINTER(_GError)))
            setattr(self, _short(name), functools.partial(self._checked, function))

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"libaravis: {name} is not declared")

    def _checked(self, function: Any, *arguments: Any) -> Any:
        problem = POINTER(_GError)()
        result = function(*arguments, byref(problem))
        if problem:
            message = text(problem.contents.message)
            self._library.g_clear_error(byref(problem))
            raise AravisError(message or "no reason given")
        return result


def _short(name: str) -> str:
    return name.removeprefix("arv_").removeprefix("g_object_").removeprefix("g_")


@functools.cache
def load_aravis() -> Aravis:
    """Load the library. Raises DependencyError."""
    try:
        return Aravis(CDLL(LIBRARY))
    except (OSError, AttributeError) as problem:
        raise DependencyError(
            f"{LIBRARY}: cannot be loaded ({problem}); on Debian or Ubuntu: apt-get install libaravis-0.8-0."
        ) from problem


def text(value: bytes | None) -> str:
    """A string from the library, "" for none. Unprintable characters are replaced, since it may reach a terminal."""
    letters = (value or b"").decode("utf-8", "replace")
    return "".join(letter if letter.isprintable() else "?" for letter in letters)


Say = Callable[[str], None]
"""Called with a sentence for people, before a long wait."""

HEARTBEAT_MS = 3000
"""The camera frees itself so long after its program was killed."""
_HEARTBEAT_TIMEOUT, _APPLICATION_ADDRESS = 0x0938, 0x0A14
"""Bootstrap registers of GigE Vision: milliseconds, and the address of the program that has control."""
_MARGIN_S = 2.0
_LONGEST_S = 60.0
"""Longest wait, also for a camera that names a longer heartbeat timeout."""
_AGAIN_S = 0.25


def take_control(aravis: Aravis, camera: int, *, name: str, say: Say) -> None:
    """Make sure that this program controls a camera; wait until another one that has ended holds it no longer.

    A program that was killed leaves the camera under its control until the camera misses its heartbeat. Without control
    nothing can be set, and no frame would ever come. Raises CameraError if another program keeps the control.
    """
    if not aravis.camera_is_gv_device(camera):
        return
    device = aravis.camera_get_device(camera)
    if not aravis.gv_device_is_controller(device):
        _await_control(aravis, device, name, say)
    timeout_ms = _register(aravis, device, _HEARTBEAT_TIMEOUT)
    if timeout_ms is not None and timeout_ms > HEARTBEAT_MS:
        # Cameras that do not allow it keep their own.
        with contextlib.suppress(AravisError):
            aravis.device_write_register(device, _HEARTBEAT_TIMEOUT, HEARTBEAT_MS)


def _await_control(aravis: Aravis, device: int, name: str, say: Say) -> None:
    timeout_ms = _register(aravis, device, _HEARTBEAT_TIMEOUT) or HEARTBEAT_MS
    patience = min(1e-3 * timeout_ms + _MARGIN_S, _LONGEST_S)
    holder = _holder(aravis, device)
    say(f"{name}: {holder} controls it; if that one has ended, the camera is free in at most {patience:.0f} s.")
    end = time.monotonic() + patience
    while True:
        try:
            if aravis.gv_device_take_control(device):
                return
        except AravisError:
            pass  # Refused, as long as the other one's heartbeat lasts.
        if time.monotonic() > end:
            raise CameraError(f"{name}: {holder} controls it, and still did after {patience:.0f} s; close that one.")
        time.sleep(_AGAIN_S)


def _holder(aravis: Aravis, device: int) -> str:
    address = _register(aravis, device, _APPLICATION_ADDRESS)
    return f"another program at {ipaddress.IPv4Address(address)}" if address else "another program"


def _register(aravis: Aravis, device: int, address: int) -> int | None:
    """A register's content; None if the camera does not have it."""
    value = ctypes.c_uint32()
    try:
        aravis.device_read_register(device, address, ctypes.byref(value))
    except AravisError:
        return None
    return value.value


_BAYER = {"rggb": "RG", "bggr": "BG", "grbg": "GR", "gbrg": "GB"}
PIXEL_FORMATS: dict[str, tuple[str, ...]] = {
    "rgb8": ("RGB8", "RGB8Packed"),
    **{f"mono{bits}": (f"Mono{bits}",) for bits in (8, *DEEP_BITS)},
    **{f"bayer_{one}{bits}": (f"Bayer{tile}{bits}",) for one, tile in _BAYER.items() for bits in (8, *DEEP_BITS)},
}
"""GenICam's names of the pixel formats; the second name is used by older cameras. Those of more than 8 bits have
two bytes for each sample, the lower first; the packed ones ("Mono12p", "Mono12Packed") are never requested."""

AUTOMATICS = ("ExposureAuto", "GainAuto", "BalanceWhiteAuto", "BlackLevelAuto")


def connect(aravis: Aravis, wanted: str, say: Say) -> int:
    """Connect to a camera, take control of it, and end an acquisition that a killed program left running.

    Args:
        wanted: Device id, serial number or address; "" for the only camera.

    Raises:
        CameraLost: If it is not found.
        CameraError: If several cameras fit, or another program keeps control of it.
    """
    name = wanted if _is_address(wanted) else _found(aravis, wanted)
    try:
        camera = aravis.camera_new(name.encode())
    except AravisError as problem:
        raise CameraLost(f'camera "{name}": not found: {problem}; see that it has power and its cable.') from problem
    try:
        take_control(aravis, camera, name=f'camera "{name}"', say=say)
    except CameraError:
        aravis.unref(camera)
        raise
    # An acquisition that still runs would go on sending its frames to the program that began it.
    with contextlib.suppress(AravisError):
        aravis.camera_stop_acquisition(camera)
    return camera


def _is_address(name: str) -> bool:
    # An address needs no search; a search takes a second and does not cross routers.
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _devices(aravis: Aravis, *facts: str) -> list[list[str]]:
    aravis.update_device_list()
    return [[text(getattr(aravis, f"get_device_{fact}")(k)) for fact in facts] for k in range(aravis.get_n_devices())]


def _found(aravis: Aravis, wanted: str) -> str:
    """Device id of the wanted camera."""
    every = _devices(aravis, "id", "physical_id", "serial_nbr", "address")
    meant = [names for names in every if wanted in names] if wanted else every
    listed = ", ".join(f'"{names[0]}" (serial number {names[2]}, {names[3]})' for names in every) or "none"
    if not meant:
        which = f'camera "{wanted}"' if wanted else "a camera"
        raise CameraLost(f"{which}: not found; found: {listed}. See that it has power and its cable.")
    if len(meant) > 1:
        raise CameraError(f"found {len(meant)} cameras: {listed}; give the `id` of one in [camera].")
    return meant[0][0]


_WRAP = 65535
"""GigE Vision counts frames 1 … 65535, then 1 again; 0 is not used."""


class FrameNumbers:
    """Turns a camera's wrapping frame ids into increasing numbers."""

    def __init__(self) -> None:
        self._last: int | None = None
        self._raw, self._period = 0, _WRAP

    def take(self, raw: int) -> tuple[int, int]:
        """The number of a frame by its id, and its difference to the highest so far: 1 for the next frame."""
        if self._last is None:
            self._last, self._raw = raw, raw
            return raw, 1
        advance = raw - self._raw
        # Some cameras also use 0.
        self._period = _WRAP + 1 if raw == 0 else self._period
        if max(raw, self._raw) <= _WRAP and abs(advance) > _WRAP // 2:
            advance += self._period if advance < 0 else -self._period
        number = self._last + advance
        if advance > 0:
            self._last, self._raw = number, raw
        return number, advance


Result = TypeVar("Result")
_BUFFERS = 8
"""Frames that may wait; a step of a sweep has two."""
_QUIET_S, _MOST_PASSING_S = 0.1, 2.0
_SLICE_S = 0.2


class AravisCamera(Camera):
    """A camera that speaks GenICam.

    Its heartbeat shows whether it is still connected; it is also queried when a frame is late. If the camera is gone, a
    call may take 2.5 s longer than its timeout.
    """

    def __init__(self, settings: CameraSettings, say: Say = lambda sentence: None) -> None:
        """Open the camera, apply the settings, read them back and compare. Raises as `open_camera`."""
        self._aravis, self.settings, self._say = load_aravis(), settings, say
        shape = settings.height, settings.width, 3
        self._shape = shape[: frame_rank(settings.layout)]
        self._type = np.dtype("<u2" if settings.bits > 8 else np.uint8)
        self._bytes = int(np.prod(self._shape)) * self._type.itemsize
        self._camera: int | None = None
        self._stream: int | None = None
        self._running = self._started = self._lost = False
        self._numbers = FrameNumbers()
        self.identity = self._open()

    def features(self) -> Features:
        return self._ask("read its features", self.read)

    def _underruns(self, stream: int) -> int:
        numbers = [ctypes.c_uint64() for _ in range(3)]
        self._aravis.stream_get_statistics(stream, *(ctypes.byref(one) for one in numbers))
        return int(numbers[2].value)

    def _pass_by(self, stream: int) -> None:
        """Let packets of other programs pass before there is a buffer that they could be taken for a frame in.

        With the rights of root libaravis reads the whole interface, and until its filter is set it keeps every packet.
        """
        before, end = -1, time.monotonic() + _MOST_PASSING_S
        while (count := self._underruns(stream)) != before and time.monotonic() < end:
            before = count
            time.sleep(_QUIET_S)

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
        return dropped

    def next(self, timeout_s: float) -> Frame:
        buffer = self._pop(timeout_s)
        try:
            return self._frame(buffer)
        finally:
            self._push(buffer)

    def trigger(self) -> None:
        if self.trigger_mode != "software":
            raise CameraError(f'{self}: trigger is "{self.trigger_mode}", software triggers need "software".')
        self._ask("take a trigger", self._aravis.camera_software_trigger)

    def reopen(self) -> None:
        before = self.identity
        self._let_go()
        found = self._open()
        if found != before:
            self._let_go()
            raise CameraError(f"found the camera {found}, expected {before}; a sweep is of one camera.")
        if self._started:
            self.start()

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
        return str(getattr(self, "identity", None) or f"aravis {self.settings.id}".strip())

    def _open(self) -> CameraIdentity:
        camera = self._camera = connect(self._aravis, self.settings.id, self._say)
        self._lost = False
        try:
            identity = CameraIdentity(
                "aravis",
                f"{text(self._aravis.camera_get_vendor_name(camera))} "
                f"{text(self._aravis.camera_get_model_name(camera))}",
                text(self._aravis.camera_get_device_serial_number(camera)),
            )
            self._apply(camera, str(identity))
            require(self.read(camera), wanted(self.settings), name=str(identity))
            payload = self._aravis.camera_get_payload(camera)
            if payload < self._bytes:
                raise CameraError(f"{identity}: sends {payload} bytes per frame, expected {self._bytes}.")
            self._stream = self._aravis.camera_create_stream(camera, None, None)
            self._pass_by(self._stream)
            for _ in range(_BUFFERS):
                self._push(self._aravis.buffer_new_allocate(payload))
        except AravisError as problem:
            self._lost = True
            self._let_go()
            raise CameraLost(f"{self}: went away while it was set up: {problem}") from problem
        except CameraError:
            self._let_go()
            raise
        self._numbers = FrameNumbers()
        return identity

    def _apply(self, camera: int, name: str) -> None:
        """Apply all settings, and switch automatic functions off; CameraError names one that the camera refuses."""
        aravis, settings = self._aravis, self.settings
        aravis.camera_set_range_check_policy(camera, RANGE_CHECK)
        aravis.camera_set_access_check_policy(camera, ACCESS_CHECK)

        def attempt(failure: str, call: Callable[..., None], *arguments: float | bytes) -> None:
            try:
                call(camera, *arguments)
            except AravisError as problem:
                raise CameraError(f"{name}: {failure}: {problem}") from problem

        def set_text(feature: str, value: str) -> None:
            attempt(f'{feature}: does not take "{value}"', aravis.camera_set_string, feature.encode(), value.encode())

        def set_pixel_format(camera: int) -> None:
            *older, last = PIXEL_FORMATS[settings.pixel_format]
            for known in older:
                with contextlib.suppress(AravisError):
                    aravis.camera_set_string(camera, b"PixelFormat", known.encode())
                    return
            aravis.camera_set_string(camera, b"PixelFormat", last.encode())

        set_text("AcquisitionMode", "Continuous")
        attempt(f'does not take pixel_format = "{settings.pixel_format}"', set_pixel_format)
        size = settings.width, settings.height
        attempt(f"does not take {size[0]} x {size[1]} px", aravis.camera_set_region, 0, 0, *size)
        for feature in AUTOMATICS:
            if self._has(camera, feature):
                set_text(feature, "Off")
        exposure_us = 1000.0 * settings.exposure_ms
        attempt(f"does not take exposure_ms = {settings.exposure_ms:g}", aravis.camera_set_exposure_time, exposure_us)
        if aravis.camera_is_gain_available(camera):
            attempt(f"does not take gain_db = {settings.gain_db:g}", aravis.camera_set_gain, settings.gain_db)
        attempt("its triggers cannot be switched off", aravis.camera_clear_triggers)
        if settings.trigger != "free":
            set_text("TriggerSelector", "FrameStart")
            set_text("TriggerSource", "Software" if settings.trigger == "software" else settings.trigger_source)
            if settings.trigger == "hardware" and self._has(camera, "TriggerActivation"):
                set_text("TriggerActivation", "RisingEdge")
            set_text("TriggerMode", "On")
        if settings.packet_size is not None and aravis.camera_is_gv_device(camera):
            attempt("does not take its packet_size", aravis.camera_gv_set_packet_size, settings.packet_size)

    def read(self, camera: int) -> Features:
        """The camera's settings, read back from it; settings that it cannot report are absent."""
        aravis = self._aravis
        region = [ctypes.c_int() for _ in range(4)]
        aravis.camera_get_region(camera, *(ctypes.byref(one) for one in region))
        found = self._text(camera, "PixelFormat")
        features: Features = {
            "width": region[2].value,
            "height": region[3].value,
            "offset_x": region[0].value,
            "offset_y": region[1].value,
            "pixel_format": next((name for name, known in PIXEL_FORMATS.items() if found in known), found),
            "exposure_s": 1e-6 * aravis.camera_get_exposure_time(camera),
            "trigger": "free",
        }
        if aravis.camera_is_gain_available(camera):
            features["gain_db"] = float(aravis.camera_get_gain(camera))
        features |= {name: self._text(camera, name) for name in AUTOMATICS if self._has(camera, name)}
        if self._has(camera, "TriggerMode"):
            aravis.camera_set_string(camera, b"TriggerSelector", b"FrameStart")
            if self._text(camera, "TriggerMode") == "On":
                # "hardware" where it listens to `trigger_source`.
                source = self._text(camera, "TriggerSource")
                known = {"Software": "software", self.settings.trigger_source: "hardware"}
                features |= {"trigger": known.get(source, source), "trigger_source": source}
        if aravis.camera_is_gv_device(camera):
            features["packet_size"] = int(aravis.camera_gv_get_packet_size(camera))
        return features

    def _has(self, camera: int, feature: str) -> bool:
        return bool(self._aravis.camera_is_feature_available(camera, feature.encode()))

    def _text(self, camera: int, feature: str) -> str:
        return text(self._aravis.camera_get_string(camera, feature.encode()))

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

    def _frame(self, buffer: int) -> Frame:
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
        image = np.frombuffer(ctypes.string_at(data, self._bytes), self._type).reshape(self._shape).copy()
        return Frame(image, number, complete, "; ".join(notes), self.settings.bits)

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
        exposure_s = self.settings.exposure_ms * 1e-3
        while flushed < self.settings.flush_frames or time.monotonic() < since + exposure_s:
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
    listed = _devices(aravis, "id", "vendor", "model", "serial_nbr", "address")
    return [f'aravis "{one[0]}": {one[1]} {one[2]}, serial number {one[3]}, at {one[4]}' for one in listed]
