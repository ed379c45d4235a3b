"""libaravis' fake GigE Vision camera, by ctypes: found, controlled and streamed from over UDP like a real one."""

import contextlib
import ctypes
import ipaddress
import json
import math
import os
import queue
import socket
import sys
import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TextIO

import numpy as np

from bench.camera.rendered import ADDRESS, NOMINAL_EXPOSURE_S, Exposure, LogReader, Plant, View, World
from bench.places import BenchError


LIBRARY = "libaravis-0.8.so.0"

WIDTH, HEIGHT, GAIN, EXPOSURE_US, LEFT, TOP = 0x100, 0x104, 0x110, 0x120, 0x130, 0x134
FRAME_PERIOD_US, TRIGGER_SOFTWARE, ACQUISITION, CONTROL_CHANNEL_PRIVILEGE = 0x138, 0x30C, 0x124, 0xA00
PIXEL_FORMAT, MONO16 = 0x128, 0x01100007
"""Registers of the fake camera, and GenICam's number of a pixel format."""

BROADCAST = "255.255.255.255", 3956

TRIGGERED_PERIOD_US = 4000
"""Grid of the times at which a triggered frame may be sent. libaravis' own, 40 ms, would lose one of two close ones."""

Fill = Callable[[], np.ndarray]


def aravis_is_there() -> bool:
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

    A frame leaves in one of three ways: `deliver` hands over one that the trigger wire requested; a client's software
    trigger, and a client that lets the camera run free, get the frame that `present` returns.
    """

    def __init__(self, present: Fill, *, address: str = ADDRESS) -> None:
        """Start to answer; raises BenchError if libaravis is missing or the address is taken.

        Args:
            present: Returns the view at this moment [rows, columns], uint8 or uint16 by `bits`; called in a thread.
        """
        self._library = _load()
        pointer, number = ctypes.c_void_p, ctypes.c_uint32
        self._gv = self._library.arv_gv_fake_camera_new(address.encode(), b"BENCH")
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
        value = ctypes.c_uint32()
        self._library.arv_fake_camera_read_register(self._camera, address, ctypes.byref(value))
        return value.value

    def write(self, address: int, value: int) -> None:
        self._library.arv_fake_camera_write_register(self._camera, address, value)

    @property
    def bits(self) -> Literal[8, 16]:
        """Bits of a sample that the client requested: those of Mono8 or Mono16."""
        return 16 if self.register(PIXEL_FORMAT) == MONO16 else 8

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
        self.write(FRAME_PERIOD_US, TRIGGERED_PERIOD_US)
        self.write(TRIGGER_SOFTWARE, 1)
        if self._taken.wait(timeout_s):
            return True
        self.write(TRIGGER_SOFTWARE, 0)
        self._handed = None
        return False

    def lose_packets(self, share: float) -> None:
        self._library.g_object_set(
            ctypes.c_void_p(self._gv), b"gvsp-lost-ratio", ctypes.c_double(share), ctypes.c_void_p(None)
        )

    def forget_controller(self) -> None:
        """Lose the client: nobody controls the camera any more, and it stops."""
        self.write(ACQUISITION, 0)
        self.write(CONTROL_CHANNEL_PRIVILEGE, 0)

    def close(self) -> None:
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
            return np.ascontiguousarray(frame)
        window = np.zeros((height, width), frame.dtype)
        part = frame[top : top + height, left : left + width]
        window[: part.shape[0], : part.shape[1]] = part
        return window


POLL_S = 0.002


@dataclass
class Trouble:
    """Faults of the next frames, as ordered by the control socket."""

    lose: int = 0
    swap: bool = False
    flash_dn: float = 0.0
    blur_px: int = 0
    covered: bool = False


@dataclass
class Counts:
    """Counts of the pulses of the trigger wire, by outcome."""

    triggers: int = 0
    not_armed: int = 0
    lost: int = 0
    sent: int = 0
    refused: int = 0


@dataclass
class BenchCamera:
    """Renders and sends the frames that the log requires; `ledger` gets the true view of each."""

    world: World
    edges: Path
    microsteps_per_turn: int
    ledger: TextIO
    address: str = ADDRESS
    board: int | None = None
    trouble: Trouble = field(default_factory=Trouble)
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        self._plant = Plant(self.microsteps_per_turn)
        self._waiting: queue.Queue[tuple[Exposure, View]] = queue.Queue()
        self._held: tuple[Exposure, View, np.ndarray] | None = None
        self._stop = threading.Event()
        self._world_lock = threading.Lock()
        self._wire_lock = threading.Lock()
        self._wire: GvCamera | None = GvCamera(self.present, address=self.address)

    def run(self) -> None:
        """Follow the log until `quit`."""
        developer = threading.Thread(target=self._develop, daemon=True)
        developer.start()
        log, armed = LogReader(self.edges), False
        while not self._stop.is_set():
            lines = log.lines()
            for line in lines:
                rises, ended = self._plant.read(line)
                if rises:
                    wire = self._wire
                    armed = wire is not None and wire.armed()
                elif ended is not None:
                    self._expose(ended, armed)
            if not lines:
                self._stop.wait(POLL_S)
        developer.join(10)
        self._disappear()

    def present(self) -> np.ndarray:
        """The view at this moment, for a client that triggers by software or lets the camera run free."""
        lights = tuple(float(light.on) for light in self._plant.lights.values())
        view = self._view(self._plant.from_home(), lights)
        number = self.counts.sent + self.counts.triggers + 1_000_000
        return self._picture(view, number)

    def answer(self, text: str) -> str:
        """One line of the control socket. Raises BenchError if it is not understood."""
        verb, _, rest = text.partition(" ")
        try:
            return self._answer(verb, rest)
        except ValueError as problem:
            raise BenchError(f"{text!r}: {problem}") from problem

    def _answer(self, verb: str, rest: str) -> str:
        match verb, rest:
            case "board", "none":
                self.board = None
                return json.dumps({"board": None})
            case "board", _:
                return json.dumps(self._show(rest))
            case "poses", "":
                return json.dumps([self.world.describe(number) for number in range(len(self.world.poses()))])
            case "lose", _:
                self.trouble.lose = int(rest)
            case "swap", "":
                self.trouble.swap = True
            case "flash", _:
                self.trouble.flash_dn = float(rest)
            case "blur", _:
                self.trouble.blur_px = int(rest)
            case "cover", _:
                self.trouble.covered = bool(int(rest))
            case "loss", _:
                if self._wire is not None:
                    self._wire.lose_packets(float(rest))
            case "forget", "":
                self.forget_controller()
            case "disappear", "":
                self._disappear()
            case "appear", "":
                with self._wire_lock:
                    self._wire = self._wire or GvCamera(self.present, address=self.address)
            case "state", "":
                return json.dumps(self._state())
            case "quit", "":
                self.stop()
            case _:
                raise BenchError(f"the camera does not know {verb!r}")
        return "ok"

    def _show(self, which: str) -> dict[str, Any]:
        """The board in the pose of a number, in the next one, or in that of "free K" or "placement K"."""
        kind, _, nth = which.rpartition(" ")
        free = sum(pose.number is None for pose in self.world.poses())
        if which == "next":
            number = 0 if self.board is None else self.board + 1
            if number == len(self.world.poses()):
                self.board = None
                return {"board": None}
        elif kind in ("", "free", "placement"):
            number = int(nth) + (free if kind == "placement" else 0)
            if kind == "free" and not 0 <= number < free:
                raise BenchError(f"there is no free view {number}: 0 … {free - 1}")
        else:
            raise BenchError(f"board {which}: expected a number, next, none, free K or placement K")
        described = self.world.describe(number)
        self.board = number
        return described

    def forget_controller(self) -> None:
        """Free the control channel and stop, as a camera whose controller's heartbeat has ended."""
        with self._wire_lock:
            if self._wire is not None:
                self._wire.forget_controller()

    def stop(self) -> None:
        self._stop.set()

    def _state(self) -> dict[str, Any]:
        return {
            **vars(self.counts),
            "waiting": self._waiting.qsize() + (self._held is not None),
            "board": self.board,
            "position": self._plant.from_home(),
            "light": self._plant.lights["light"].on,
            "light_2": self._plant.lights["light_2"].on,
            "there": self._wire is not None,
            "armed": self._wire is not None and self._wire.armed(),
        }

    def _disappear(self) -> None:
        with self._wire_lock:
            wire, self._wire = self._wire, None
            if wire is not None:
                wire.close()

    def _view(self, position: int, lights: tuple[float, ...]) -> View:
        angle = 2 * math.pi * position / self.microsteps_per_turn
        exposure, wire = 1.0, self._wire
        if wire is not None:
            seconds, gain_db = wire.register(EXPOSURE_US) / 1e6, wire.register(GAIN)
            exposure = seconds / NOMINAL_EXPOSURE_S * 10 ** (gain_db / 20)
        return View(angle, lights, self.board, exposure)

    def _expose(self, exposure: Exposure, armed: bool) -> None:
        self.counts.triggers += 1
        if armed:
            self._waiting.put((exposure, self._view(exposure.position, (exposure.light, exposure.light_2))))
        else:
            self.counts.not_armed += 1

    def _develop(self) -> None:
        """Render the exposures and send them, one after the other."""
        while not self._stop.is_set():
            try:
                exposure, view = self._waiting.get(timeout=0.05)
            except queue.Empty:
                continue
            trouble = self.trouble
            if trouble.lose > 0:
                trouble.lose -= 1
                self.counts.lost += 1
                continue
            picture = self._picture(view, exposure.cycle)
            if trouble.swap and self._held is None:
                self._held = (exposure, view, picture)
                continue
            self._send(exposure, view, picture)
            if self._held is not None:
                held, self._held, trouble.swap = self._held, None, False
                self._send(*held)

    def _picture(self, view: View, number: int) -> np.ndarray:
        trouble = self.trouble
        flash, blur = trouble.flash_dn, trouble.blur_px
        trouble.flash_dn, trouble.blur_px = 0.0, 0
        if trouble.covered:
            view = view._replace(exposure=0.0)
        with self._world_lock:
            wire = self._wire
            bits = 8 if wire is None else wire.bits
            return self.world.frame(view, number, flash_dn=flash, blur_px=blur, bits=bits)

    def _send(self, exposure: Exposure, view: View, picture: np.ndarray) -> None:
        with self._wire_lock:
            sent = self._wire is not None and self._wire.deliver(picture)
        self.counts.sent += sent
        self.counts.refused += not sent
        said = {**exposure._asdict(), "angle": view.angle, "board": view.board, "exposure": view.exposure, "sent": sent}
        self.ledger.write(json.dumps(said) + "\n")
        self.ledger.flush()
