"""Control of a GigE Vision camera: one program has it, until it lets go or its heartbeat ends."""

import contextlib
import ctypes
import ipaddress
import time
from collections.abc import Callable

from scanrig.cameras.aravis_binding import Aravis, AravisError
from scanrig.errors import CameraError


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
    nothing can be set, and no frame would ever come.

    Raises:
        CameraError: If another program keeps the control.
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
