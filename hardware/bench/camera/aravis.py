"""libaravis' fake GigE Vision camera, through ctypes: found, controlled and streamed from over UDP like a real one."""

import contextlib
import ctypes
import ipaddress
import os
import socket
import sys
import threading
import traceback
from collections.abc import Callable

import numpy as np

from bench.errors import BenchError


LIBRARY = "libaravis-0.8.so.0"

WIDTH, HEIGHT, GAIN, EXPOSURE_US, LEFT, TOP = 0x100, 0x104, 0x110, 0x120, 0x130, 0x134
FRAME_PERIOD_US, TRIGGER_SOFTWARE, ACQUISITION, CONTROL_CHANNEL_PRIVILEGE = 0x138, 0x30C, 0x124, 0xA00
"""Registers of the fake camera."""

BROADCAST = "255.255.255.255", 3956

TRIGGERED_PERIOD_US = 4000
"""Grid of the times at which a triggered frame may be sent. libaravis' own, 40 ms, would lose one of two close ones."""

Fill = Callable[[], np.ndarray]


def aravis_is_there() -> bool:
    """Whether the library is installed."""
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return False
    return True


def _load() -> ctypes.CDLL:
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError as problem:
        raise BenchError(
            f"The camera on loopback needs libaravis-0.8-0: {problem}. Type `make bench-deps`."
        ) from problem
    pointer, number, text = ctypes.c_void_p, ctypes.c_uint32, ctypes.c_char_p
    for name, result, arguments in (
        ("arv_gv_fake_camera_new", pointer, [text, text]),
        ("arv_gv_fake_camera_is_running", ctypes.c_int, [pointer]),
        ("arv_gv_fake_camera_get_fake_camera", pointer, [pointer]),
        ("arv_fake_camera_read_register", ctypes.c_int, [pointer, number, ctypes.POINTER(number)]),
        ("arv_fake_camera_write_register", ctypes.c_int, [pointer, number, number]),
        ("arv_fake_camera_get_acquisition_status", number, [pointer]),
        ("arv_fake_camera_get_control_channel_privilege", number, [pointer]),
        ("arv_fake_camera_is_in_free_running_mode", ctypes.c_int, [pointer]),
        ("arv_fake_camera_is_in_software_trigger_mode", ctypes.c_int, [pointer]),
        ("arv_buffer_get_data", pointer, [pointer, ctypes.POINTER(ctypes.c_size_t)]),
        ("g_object_unref", None, [pointer]),
        ("g_object_set", None, None),
    ):
        function = getattr(library, name)
        function.restype = result
        if arguments is not None:
            function.argtypes = arguments
    return library


def _keep_to_loopback() -> None:
    """Take this process's discovery socket off the network: libaravis binds one to the broadcast address, at which
    anybody's commands would reach the camera; programs of this machine still find it there."""
    for name in os.listdir("/proc/self/fd"):
        with contextlib.suppress(OSError):  # Closed meanwhile, or a kernel before 5.7.
            if os.readlink(f"/proc/self/fd/{name}").startswith("socket:"):
                with socket.socket(fileno=os.dup(int(name))) as one:
                    if one.family == socket.AF_INET and one.getsockname() == BROADCAST:
                        one.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")


class GvCamera:
    """A GigE Vision camera on a local address; there can be one per machine, port 3956 is the standard's.

    A frame leaves in one of three ways: `deliver` hands over one that a trigger's wire asked for; a client's software
    trigger, and a client that lets the camera run free, get the frame that `present` returns.
    """

    def __init__(self, present: Fill, *, address: str = "127.0.0.1", serial: str = "BENCH") -> None:
        """Start to answer.

        Args:
            present: Returns the view at this moment, uint8 [rows, columns]; called in a thread of libaravis.
            address: Of a local network interface.
            serial: Serial number by which it is found.

        Raises:
            BenchError: If libaravis is missing or the address is taken.
        """
        self._library = _load()
        pointer, number = ctypes.c_void_p, ctypes.c_uint32
        self._gv = self._library.arv_gv_fake_camera_new(address.encode(), serial.encode())
        if not self._gv or not self._library.arv_gv_fake_camera_is_running(self._gv):
            raise BenchError(f"No camera can be started at {address}: is one running there already?")
        if ipaddress.ip_address(address).is_loopback:
            _keep_to_loopback()
        self._camera = self._library.arv_gv_fake_camera_get_fake_camera(self._gv)
        self._present = present
        self._handed: np.ndarray | None = None
        self._taken = threading.Event()
        callback = ctypes.CFUNCTYPE(None, pointer, pointer, number, number, number)
        self._library.arv_fake_camera_set_fill_pattern.argtypes = [pointer, callback, pointer]
        self._callback = callback(self._fill)  # libaravis keeps no reference.
        self._library.arv_fake_camera_set_fill_pattern(self._camera, self._callback, None)

    def register(self, address: int) -> int:
        """Content of a register."""
        value = ctypes.c_uint32()
        self._library.arv_fake_camera_read_register(self._camera, address, ctypes.byref(value))
        return value.value

    def write(self, address: int, value: int) -> None:
        """Set a register."""
        self._library.arv_fake_camera_write_register(self._camera, address, value)

    def armed(self) -> bool:
        """Whether a trigger would be taken: a client acquires, and has switched triggering on."""
        library, camera = self._library, self._camera
        return bool(
            library.arv_fake_camera_get_control_channel_privilege(camera)
            and library.arv_fake_camera_get_acquisition_status(camera)
            and library.arv_fake_camera_is_in_software_trigger_mode(camera)
        )

    def deliver(self, frame: np.ndarray, *, timeout_s: float = 2.0) -> bool:
        """Send one frame to the client. False if it has stopped acquiring."""
        self._taken.clear()
        self._handed = frame
        self._library.arv_fake_camera_write_register(self._camera, FRAME_PERIOD_US, TRIGGERED_PERIOD_US)
        self._library.arv_fake_camera_write_register(self._camera, TRIGGER_SOFTWARE, 1)
        if self._taken.wait(timeout_s):
            return True
        self._library.arv_fake_camera_write_register(self._camera, TRIGGER_SOFTWARE, 0)
        self._handed = None
        return False

    def lose_packets(self, share: float) -> None:
        """Lose this share of the stream's packets."""
        self._library.g_object_set(
            ctypes.c_void_p(self._gv), b"gvsp-lost-ratio", ctypes.c_double(share), ctypes.c_void_p(None)
        )

    def forget_controller(self) -> None:
        """Lose the client: nobody controls the camera any more, and it stops."""
        self.write(ACQUISITION, 0)
        self.write(CONTROL_CHANNEL_PRIVILEGE, 0)

    def close(self) -> None:
        """Disappear."""
        if self._gv:
            self._library.g_object_unref(self._gv)
            self._gv = None

    def _fill(self, buffer: int, _data: int, _exposure_us: int, _gain: int, _format: int) -> None:
        handed, self._handed = self._handed, None
        try:
            # libaravis would return the size of received data, which is 0 on this side of the wire.
            start = self._library.arv_buffer_get_data(buffer, ctypes.byref(ctypes.c_size_t()))
            window = self._window(handed if handed is not None else self._present())
            ctypes.memmove(start, window.ctypes.data, window.nbytes)
        except Exception:
            # Nothing may be raised into C; the client gets the frame before, and the log says why.
            traceback.print_exc(file=sys.stderr)
        if handed is not None:
            self._taken.set()

    def _window(self, frame: np.ndarray) -> np.ndarray:
        """The client's region of interest; black where it reaches beyond the sensor."""
        width, height, left, top = (self.register(address) for address in (WIDTH, HEIGHT, LEFT, TOP))
        if (height, width, left, top) == (*frame.shape, 0, 0):
            return np.ascontiguousarray(frame, np.uint8)
        window = np.zeros((height, width), np.uint8)
        part = frame[top : top + height, left : left + width]
        window[: part.shape[0], : part.shape[1]] = part
        return window
