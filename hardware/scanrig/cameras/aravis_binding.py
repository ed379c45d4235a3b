"""The functions of libaravis-0.8 that a camera needs, through ctypes; each GError becomes an exception."""

import ctypes
import functools
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
from typing import Any

from jaxscan.errors import DependencyError


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
"""The meaning of a buffer's status (ArvBufferStatus)."""
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
    "arv_camera_get_device_id": (c_char_p, (c_void_p,)),
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
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
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
    """Load the library.

    Raises:
        DependencyError: If it is not installed.
    """
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
