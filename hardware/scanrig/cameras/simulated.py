"""A camera without hardware, and frames without a renderer: a Gaussian laser line on a textured wall, with noise."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8, UInt16

from jaxscan.geometry import StripeAxis
from jaxscan.stripes import Colour, PixelFormat, frame_rank
from scanrig.cameras.camera import Camera, CameraIdentity, CameraSettings, Features, Frame, wanted
from scanrig.errors import CameraError, CameraLost, CameraTimeout


_CHANNEL = {"red": 0, "green": 1, "blue": 2}


@dataclass(frozen=True)
class SyntheticScene:
    """The scene of the simulated camera."""

    colour: Colour = "red"
    stripe_axis: StripeAxis = "rows"
    peak_dn: float = 120.0
    """Peak of the line above the wall [DN]."""
    width_px: float = 1.8
    """Standard deviation of the line [px]."""
    share: float = 1.0
    ambient_dn: float = 30.0
    """Mean level of the wall [DN]."""
    contrast: float = 0.4
    """Amplitude of the wall's texture over its mean [1]."""
    turn_px: float = 6000.0
    """How far the wall moves through the frame in one turn [px]."""
    apart_px: float = 40.0
    """Distance of the second laser's line from the first's [px]."""
    read_dn: float = 1.0
    electrons_per_dn: float = 40.0
    """Conversion gain [e-/DN]."""
    microsteps_per_turn: int = 28800
    seed: int = 0


class FrameShape(NamedTuple):
    """Size and pixel format of a frame."""

    width: int
    height: int
    pixel_format: PixelFormat = "mono8"
    bits: int = 8


def stripe_centre(scene: SyntheticScene, position: float, lines: int, samples: int) -> Float[np.ndarray, " lines"]:
    """Centre of the first laser on each line of the frame [px]: a bowed wall in the middle of the frame."""
    k = np.linspace(-1.0, 1.0, lines)
    phase = 2.0 * np.pi * position / scene.microsteps_per_turn
    return samples * (0.5 + 0.06 * np.sin(3.0 * phase) + 0.05 * k + 0.03 * k**2 * np.cos(5.0 * phase))


def wall(scene: SyntheticScene, position: float, lines: int, samples: int) -> Float[np.ndarray, "lines samples"]:
    """Light of the room [DN]: blocks and waves that move as the table turns."""
    x = np.arange(samples, dtype=np.float32)[None, :] + np.float32(scene.turn_px * position / scene.microsteps_per_turn)
    y = np.arange(lines, dtype=np.float32)[:, None]
    waves = np.sin(x / 23.0) * np.cos(y / 31.0) + 0.5 * np.sin((x + 2.0 * y) / 7.0)
    blocks = 1.0 - 2.0 * ((np.floor(x / 64.0) + np.floor(y / 64.0)) % 2)
    return np.maximum(scene.ambient_dn * (1.0 + scene.contrast * (0.4 * waves + 0.4 * blocks)), 0.0)


def line_light(
    scene: SyntheticScene, position: float, lines: int, samples: int, laser: int = 1
) -> Float[np.ndarray, "lines samples"]:
    """Light of a laser (from 1) [DN] on the first `share` of the lines."""
    centre = (stripe_centre(scene, position, lines, samples) + (laser - 1) * scene.apart_px).astype(np.float32)
    offset = np.arange(samples, dtype=np.float32)[None, :] - centre[:, None]
    met = np.arange(lines)[:, None] < scene.share * lines
    return np.float32(scene.peak_dn) * np.exp(np.float32(-0.5) * (offset / np.float32(scene.width_px)) ** 2) * met


def draw(
    scene: SyntheticScene,
    position: float,
    lit: int,
    shape: FrameShape,
    generator: np.random.Generator,
) -> UInt8[np.ndarray, "rows columns *three"] | UInt16[np.ndarray, "rows columns"]:
    """One frame at a position of the table [microsteps], with a laser on, from 1; 0: none.

    Of more than 8 bits it has the light and the noise of one of 8, in finer steps.
    """
    width, height, pixel_format, bits = shape
    across = scene.stripe_axis == "columns"
    lines, samples = (width, height) if across else (height, width)
    room = wall(scene, position, lines, samples)
    laser = line_light(scene, position, lines, samples, lit) if lit else np.zeros_like(room)
    if across:
        room, laser = room.T, laser.T
    if pixel_format == "mono8":
        light = room + laser
    else:
        light = room[..., None] + laser[..., None] * (np.arange(3) == _CHANNEL[scene.colour])
        light = light if frame_rank(pixel_format) == 3 else _mosaic(light, pixel_format)
    # With more than a few electrons the noise is nearly Gaussian, which is drawn ten times as fast.
    variance = light * np.float32(1.0 / scene.electrons_per_dn) + np.float32(scene.read_dn**2)
    noisy = light + np.sqrt(variance) * generator.standard_normal(light.shape, np.float32)
    finer = 1 << bits - 8
    return np.clip(np.rint(noisy * np.float32(finer)), 0, 256 * finer - 1).astype(np.uint16 if bits > 8 else np.uint8)


def _mosaic(light: Float[np.ndarray, "rows columns 3"], pixel_format: str) -> Float[np.ndarray, "rows columns"]:
    tile = pixel_format[6:10]
    seen = np.empty(light.shape[:2], light.dtype)
    for place, letter in enumerate(tile):
        row, column = divmod(place, 2)
        seen[row::2, column::2] = light[row::2, column::2, "rgb".index(letter)]
    return seen


Scene = Callable[[float, int], UInt8[np.ndarray, "rows columns *three"] | UInt16[np.ndarray, "rows columns"]]
"""Draws the frame at a position of the table [microsteps], with a laser on (from 1; 0: none)."""


class SimulatedCamera(Camera):
    """Exposes when `expose` is called (a wire), `trigger` (software), or `next` (free-running).

    Software triggers and free-running frames get position and laser from `world`; for `expose` they are arguments.
    """

    patience_s = float("inf")
    """Longest real wait of `next`, whatever its timeout."""

    def __init__(
        self,
        settings: CameraSettings,
        scene: Scene | SyntheticScene | None = None,
        *,
        world: Callable[[], tuple[float, int]] | None = None,
    ) -> None:
        """An open camera.

        Args:
            world: Position and laser at this moment; by default laser on and off in turn.
        """
        self.settings = settings
        self.identity = CameraIdentity("simulated", "synthetic", "SIM1")
        self.device: Features = wanted(settings)
        self.exposures = 0
        """Exposures so far; the number of the last."""
        self._scene = _drawn(scene or SyntheticScene(), settings) if not callable(scene) else scene
        alternation = _alternation()
        self._world = world or (lambda: next(alternation))
        self._changed = threading.Condition()
        self._queue: deque[Frame] = deque()
        self._running = self._closed = False

    def features(self) -> Features:
        self._require_open()
        return dict(self.device)

    def start(self) -> None:
        self._require_open()
        self._running = True

    def drop(self) -> int:
        with self._changed:
            waiting = len(self._queue)
            self._queue.clear()
            return waiting

    def next(self, timeout_s: float) -> Frame:
        self._require_open()
        if self.trigger_mode == "free" and self._running and not self._queue:
            self.expose(*self._world())
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._gone(), min(timeout_s, self.patience_s))
            self._require_open()
            if not self._queue:
                raise CameraTimeout(f"{self.identity}: no frame within {timeout_s:g} s; expected one per trigger.")
            return self._queue.popleft()

    def trigger(self) -> None:
        self._require_open()
        if self.trigger_mode != "software":
            raise CameraError(f'{self.identity}: trigger is "{self.trigger_mode}", software triggers need "software".')
        self.expose(*self._world())

    def expose(self, position: float, lit: int) -> None:
        """An edge on the trigger wire: one exposure. From any thread."""
        with self._changed:
            if not self._running or self._gone():
                return
            self.exposures += 1
            self._arrive(self._scene(position, lit))
            self._changed.notify_all()

    def reopen(self) -> None:
        if self._closed:
            raise CameraLost(f"{self.identity}: not found; check its power and cable.")
        with self._changed:
            self._queue.clear()
        self.device = wanted(self.settings)

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._running = False
            self._queue.clear()
            self._changed.notify_all()

    def _gone(self) -> str:
        """Why no more frames come; "" if they do."""
        return "closed" if self._closed else ""

    def _require_open(self) -> None:
        if not self._queue and (gone := self._gone()):
            raise CameraLost(f"{self.identity}: the camera is {gone}.")

    def _arrive(self, image: np.ndarray) -> None:
        """Append the frame of this exposure to the queue."""
        self._queue.append(Frame(image, self.exposures, complete=True, bits=self.settings.bits))


def _drawn(scene: SyntheticScene, settings: CameraSettings) -> Scene:
    generator = np.random.default_rng(scene.seed)
    shape = FrameShape(settings.width, settings.height, settings.layout, settings.bits)
    return lambda position, lit: draw(scene, position, lit, shape, generator)


def _alternation() -> Iterator[tuple[float, int]]:
    """Positions and laser states of successive frames: at each position laser on, then off."""
    return ((float(8 * (k // 2)), 1 - k % 2) for k in count())
