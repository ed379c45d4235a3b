"""A camera in software: shows what a callable draws, and fails where it is told to."""

import threading
from collections import deque
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Literal

import numpy as np
from jaxtyping import UInt8

from jaxscan.files.disk import load_toml
from scanrig.cameras.features import require, wanted
from scanrig.cameras.frame import CameraIdentity, Features, Frame
from scanrig.cameras.settings import CameraSettings, TriggerMode
from scanrig.cameras.synthetic import FrameShape, SyntheticScene, draw
from scanrig.clock import Clock, SystemClock
from scanrig.errors import CameraError, CameraLost, CameraTimeout


Fault = Literal["missing", "duplicate", "incomplete", "stale", "swapped", "late", "lost"]
"""What can befall an exposure: its frame is not delivered; twice; in half; the one before in its place; changed
for the one after; only with the one after; and: the camera is gone from here on."""
Scene = Callable[[float, int], UInt8[np.ndarray, "rows columns *three"]]
"""What the camera sees at a position of the table [microsteps], and with which laser on, from 1; 0: none."""


class SimulatedCamera:
    """Exposes when `expose` is called (a wire), `trigger` (software), or `next` (free-running).

    Software triggers and free-running frames ask `world` for position and laser; `expose` is told.
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
        """A camera that is open.

        Args:
            settings: What it is set to.
            scene: What it sees; a synthetic scene where not given.
            world: Position and laser at this moment; laser on and off in turn where not given.
            faults: What befalls which exposure, counted from 1; may be changed at any time.
            clock: For time stamps.
            patience_s: Longest that `next` really waits, whatever its timeout: 0 where the test exposes
                before it asks.
        """
        self.settings, self.faults = settings, dict(faults or {})
        self.identity = CameraIdentity("simulated", "synthetic", "SIM1")
        self.trigger_mode: TriggerMode = settings.trigger
        self.device: Features = wanted(settings)
        """What the camera holds; a test may spoil it."""
        self.after_reopen: Features = {}
        """What the camera holds after `reopen` whatever it is told: a setting that it does not take."""
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
        """An edge on the trigger's wire: one exposure, and what befalls it. From any thread."""
        with self._changed:
            if not self._running or self._lost:
                return
            self.exposures += 1
            image = self._scene(position, lit)
            self._arrive(image, self.faults.get(self.exposures))
            self._last = image
            self._changed.notify_all()

    def push(self, frame: Frame) -> None:
        """A frame from anywhere else, as it is. From any thread."""
        with self._changed:
            self._queue.append(frame)
            self._changed.notify_all()

    def reopen(self) -> None:
        if self._closed or not self.reachable:
            raise CameraLost(f"{self.identity}: not found; see that it has power and its cable.")
        with self._changed:
            self._queue.clear()
            self._held.clear()
            self._lost = False
        self.device = {**wanted(self.settings), **self.after_reopen}
        require(self.device, wanted(self.settings), name=str(self.identity))

    def close(self) -> None:
        with self._changed:
            self._closed = self._lost = True
            self._running = False
            self._changed.notify_all()

    def __enter__(self) -> "SimulatedCamera":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _require_open(self) -> None:
        if self._closed or (self._lost and not self._queue):
            raise CameraLost(f"{self.identity}: the camera is {'closed' if self._closed else 'gone (simulated)'}.")

    def _arrive(self, image: np.ndarray, fault: Fault | None) -> None:
        """The frame of this exposure into the queue, or what the fault makes of it."""
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
            else:  # Swapped: the camera counts in order, the pictures are the wrong way round.
                self._queue.append(self._frame(image, number=waiting.number))
                arriving = [self._frame(waiting.image)]
        self._queue.extend(arriving)

    def _frame(self, image: np.ndarray, *, number: int | None = None, complete: bool = True, note: str = "") -> Frame:
        now = self._clock.now()
        return Frame(image, self.exposures if number is None else number, now, now, complete, note)


def open_simulated(settings: CameraSettings) -> SimulatedCamera:
    """A camera in front of the synthetic scene that the file `settings.id` describes, or the usual one.

    Raises:
        ConfigError: If the file is not such a description.
    """
    scene = load_toml(Path(settings.id), SyntheticScene) if settings.id else SyntheticScene()
    return SimulatedCamera(settings, scene)


def _drawn(scene: SyntheticScene, settings: CameraSettings) -> Scene:
    generator = np.random.default_rng(scene.seed)
    shape = FrameShape(settings.width, settings.height, settings.pixel_format)
    return lambda position, lit: draw(scene, position, lit, shape, generator)


def _alternation() -> Iterator[tuple[float, int]]:
    """The laser on, then off, at one position after the other."""
    return ((float(8 * (k // 2)), 1 - k % 2) for k in count())
