"""A camera in software: a callable draws its frames, and faults can be injected."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import UInt8

from jaxscan.files.disk import load_toml
from scanrig.cameras.features import require, wanted
from scanrig.cameras.frame import CameraIdentity, ClosedAtExit, Features, Frame
from scanrig.cameras.settings import CameraSettings, TriggerMode
from scanrig.cameras.synthetic import FrameShape, SyntheticScene, draw
from scanrig.clock import Clock, SystemClock
from scanrig.errors import CameraError, CameraLost, CameraTimeout


Fault = Literal["missing", "duplicate", "incomplete", "stale", "swapped", "late", "lost"]
"""Faults of an exposure: its frame is not delivered; delivered twice; half delivered; replaced by the one before;
exchanged with the one after; delivered only with the one after; and: the camera is gone from here on."""
Scene = Callable[[float, int], UInt8[np.ndarray, "rows columns *three"]]
"""Draws the frame at a position of the table [microsteps], with a laser on (from 1; 0: none)."""


class SimulatedCamera(ClosedAtExit):
    """Exposes when `expose` is called (a wire), `trigger` (software), or `next` (free-running).

    Software triggers and free-running frames get position and laser from `world`; for `expose` they are arguments.
    """

    def __init__(
        self,
        settings: CameraSettings,
        scene: Scene | SyntheticScene | None = None,
        *,
        world: Callable[[], tuple[float, int]] | None = None,
        faults: dict[int, Fault] | None = None,
        clock: Clock | None = None,
        patience_s: float = float("inf"),
    ) -> None:
        """An open camera.

        Args:
            settings: Its settings.
            scene: The scene; by default a synthetic one.
            world: Position and laser at this moment; by default laser on and off in turn.
            faults: Faults by the number of the exposure, from 1; may be changed at any time.
            clock: For time stamps.
            patience_s: Longest real wait of `next`, whatever its timeout: 0 if the test exposes before it calls `next`.
        """
        self.settings, self.faults = settings, dict(faults or {})
        self.identity = CameraIdentity("simulated", "synthetic", "SIM1")
        self.trigger_mode: TriggerMode = settings.trigger
        self.device: Features = wanted(settings)
        """The camera's features; a test may change them."""
        self.after_reopen: Features = {}
        """Features that the camera has after `reopen` regardless of its settings."""
        self.reachable = True
        """Whether `reopen` finds it."""
        self.exposures = 0
        """Exposures so far; the number of the last."""
        self._scene = _drawn(scene or SyntheticScene(), settings) if not callable(scene) else scene
        alternation = _alternation()
        self._world = world or (lambda: next(alternation))
        self._clock, self._patience_s = clock or SystemClock(), patience_s
        self._changed = threading.Condition()
        self._queue: deque[Frame] = deque()
        self._held: list[Frame] = []
        self._last: np.ndarray | None = None
        self._seen = 0
        self._counts = {"frames": 0, "incomplete": 0, "missing": 0, "dropped": 0}
        self._running = self._lost = self._closed = False

    def features(self) -> Features:
        self._require_open()
        return dict(self.device)

    def counts(self) -> dict[str, int]:
        return dict(self._counts)

    def start(self) -> None:
        self._require_open()
        self._running = True

    def drop(self) -> int:
        with self._changed:
            waiting = len(self._queue)
            self._queue.clear()
            self._counts["dropped"] += waiting
            return waiting

    def next(self, timeout_s: float) -> Frame:
        self._require_open()
        if self.trigger_mode == "free" and self._running and not self._queue:
            self.expose(*self._world())
        with self._changed:
            here = self._changed.wait_for(lambda: self._queue or self._lost, min(timeout_s, self._patience_s))
            if self._lost and not self._queue:
                raise CameraLost(f"{self.identity}: the camera is gone (simulated).")
            if not here:
                raise CameraTimeout(f"{self.identity}: no frame within {timeout_s:g} s; expected one per trigger.")
            frame = self._queue.popleft()
        self._counts["frames"] += 1
        self._counts["incomplete"] += not frame.complete
        self._counts["missing"] += max(0, frame.number - self._seen - 1)
        self._seen = max(self._seen, frame.number)
        return frame

    def trigger(self) -> None:
        self._require_open()
        if self.trigger_mode != "software":
            raise CameraError(f'{self.identity}: trigger is "{self.trigger_mode}", software triggers need "software".')
        self.expose(*self._world())

    def expose(self, position: float, lit: int) -> None:
        """An edge on the trigger wire: one exposure, with its fault if any. From any thread."""
        with self._changed:
            if not self._running or self._lost:
                return
            self.exposures += 1
            image = self._scene(position, lit)
            self._arrive(image, self.faults.get(self.exposures))
            self._last = image
            self._changed.notify_all()

    def push(self, frame: Frame) -> None:
        """Append a frame as it is. From any thread."""
        with self._changed:
            self._queue.append(frame)
            self._changed.notify_all()

    def reopen(self) -> None:
        if self._closed or not self.reachable:
            raise CameraLost(f"{self.identity}: not found; check its power and cable.")
        with self._changed:
            self._queue.clear()
            self._held.clear()
            self._lost = False
        self.device = {**wanted(self.settings), **self.after_reopen}
        require(self.device, wanted(self.settings), name=str(self.identity))

    def adopt(self, settings: CameraSettings) -> None:
        self.settings = settings
        self.reopen()

    def close(self) -> None:
        with self._changed:
            self._closed = self._lost = True
            self._running = False
            self._changed.notify_all()

    def _require_open(self) -> None:
        if self._closed or (self._lost and not self._queue):
            raise CameraLost(f"{self.identity}: the camera is {'closed' if self._closed else 'gone (simulated)'}.")

    def _arrive(self, image: np.ndarray, fault: Fault | None) -> None:
        """Append the frame of this exposure, changed by its fault, to the queue."""
        held, self._held = self._held, []
        frame = self._frame(image)
        match fault:
            case "missing":
                arriving = []
            case "duplicate":
                arriving = [frame, frame]
            case "incomplete":
                torn = image.copy()
                torn[len(torn) // 2 :] = 0
                arriving = [self._frame(torn, complete=False, note="half of its packets are missing (simulated)")]
            case "stale":
                arriving = [self._frame(image if self._last is None else self._last)]
            case "swapped" | "late":
                self._held, arriving = [frame], []
            case "lost":
                self._lost, arriving = True, []
            case None:
                arriving = [frame]
        for waiting in held:
            if self.faults.get(waiting.number) == "late":
                self._queue.append(waiting)
            else:  # Swapped: the numbers are in order, the images are exchanged.
                self._queue.append(self._frame(image, number=waiting.number))
                arriving = [self._frame(waiting.image)]
        self._queue.extend(arriving)

    def _frame(self, image: np.ndarray, *, number: int | None = None, complete: bool = True, note: str = "") -> Frame:
        now = self._clock.now()
        return Frame(image, self.exposures if number is None else number, now, now, complete, note)


def open_simulated(settings: CameraSettings) -> SimulatedCamera:
    """A camera in front of the synthetic scene in the file `settings.id`, or of the default scene.

    Raises:
        ConfigError: If the file does not describe a scene.
    """
    scene = load_toml(Path(settings.id), SyntheticScene) if settings.id else SyntheticScene()
    return SimulatedCamera(settings, scene)


def _drawn(scene: SyntheticScene, settings: CameraSettings) -> Scene:
    generator = np.random.default_rng(scene.seed)
    shape = FrameShape(settings.width, settings.height, settings.pixel_format)
    return lambda position, lit: draw(scene, position, lit, shape, generator)


def _alternation() -> Iterator[tuple[float, int]]:
    """At each position in turn: laser on, then off."""
    return ((float(8 * (k // 2)), 1 - k % 2) for k in count())
