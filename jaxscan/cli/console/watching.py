"""Threads beside a session: one draws what the camera sees, one notices that the rig does not answer."""

import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxscan.cli.boards import line_finder
from jaxscan.cli.console.captures import grey_jpeg
from jaxscan.cli.console.slate import Slate, outlived


if TYPE_CHECKING:
    from scanrig.config import RigConfig
    from scanrig.controllers import Controller

WIDTH = 960
_POINTS = 256
_BINS = 64
"""Bins of the histogram: each has four of the 256 levels."""
_BETWEEN_PICTURES_S = 0.25


class Seen(NamedTuple):
    """Frames to show."""

    on: np.ndarray | None
    off: np.ndarray
    laser: int
    facts: Mapping[str, Any]


class Painter:
    """Shows the newest frames on the slate, and drops those that come too fast; within `with`."""

    def __init__(self, rig: "RigConfig", slate: Slate) -> None:
        self._rig, self._slate = rig, slate
        self._newest: Seen | None = None
        self._come, self._end = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._paint, name="jaxscan-painter", daemon=True)

    def __enter__(self) -> "Painter":
        self._rehearse()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._come.set()
        self._thread.join()

    def show(self, seen: Seen) -> None:
        """Show these frames; returns at once."""
        on = None if seen.on is None else np.array(seen.on)
        # Copies: the camera may use the memory of its frames again.
        self._newest = seen._replace(on=on, off=np.array(seen.off))
        self._come.set()

    def _rehearse(self) -> None:
        """Compile what finds the stripe: later, while the laser may be on, this would hold up an order to stop."""
        camera = self._rig.camera
        shape = (camera.height, camera.width) + ((3,) if camera.layout == "rgb8" else ())
        off = np.random.default_rng(0).integers(10, 20, shape, np.uint8)
        on = off.copy()
        on[:, camera.width // 2] += 200
        for laser in range(len(self._rig.laser)):
            self._draw(Seen(on, off, laser, {}))

    def _paint(self) -> None:
        while not self._end.is_set():
            self._come.wait()
            self._come.clear()
            seen = self._newest
            if seen is None or self._end.is_set():
                continue
            with outlived(self._slate, "the camera's picture"):
                jpeg, live = self._draw(seen)
                self._slate.show(jpeg)
                self._slate.write(live=live)
            self._end.wait(_BETWEEN_PICTURES_S)

    def _draw(self, seen: Seen) -> tuple[bytes, dict[str, Any]]:
        """The picture as JPEG; the stripe in it, and its level."""
        from scanrig.doctor import stripe_level

        camera = self._rig.camera
        frame = seen.off if seen.on is None else seen.on
        jpeg, grey = grey_jpeg(frame, camera.layout, -(-frame.shape[1] // WIDTH))
        live = {"width": camera.width, "height": camera.height, "stripe": [], **seen.facts}
        live["histogram"] = np.bincount(grey.ravel() >> 2, minlength=_BINS).tolist()
        if seen.on is not None:
            peak, clipped = stripe_level(seen.on, seen.off, self._rig, seen.laser)
            points = line_finder(self._rig, self._rig.laser[seen.laser].line)(seen.on, seen.off)
            few = points[:: -(-len(points) // _POINTS) or 1]
            live |= {"peak_dn": peak, "clipped": clipped, "stripe": few.round(1).tolist()}
        return jpeg, live


SILENT_S = 5.0
"""The rig may be silent for so long [s]; retries over a bad cable take less."""
STILL_S = 10.0
"""A step may take so long [s], or `_SLOWER` times as long as those before it."""
_SLOWER, _KEPT = 3.0, 50
_BETWEEN_LOOKS_S = 0.5


class Silence:
    """Keeps "silence" on the slate within `with`, long before time-outs end the session: "" while all is well."""

    def __init__(self, slate: Slate, controller: "Controller", now: Callable[[], float] = time.monotonic) -> None:
        """Begin to listen.

        Args:
            slate: Where it is said; its picture changes with each step.
            controller: Whose lines are counted.
            now: The time [s].
        """
        self._slate, self._controller, self._now = slate, controller, now
        self._heard_at = now()
        self._picture, self._step_at = slate.picture().version, 0.0
        self._stepping = False
        """Whether a step has ended since homing, whose duration is unknown."""
        self._took: deque[float] = deque(maxlen=_KEPT)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="jaxscan-silence", daemon=True)

    def __enter__(self) -> "Silence":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        self._slate.write(silence="")

    def look(self) -> str:
        """The words that are true now, "" while all is well."""
        return self._answers() or self._steps()

    def _watch(self) -> None:
        while not self._end.wait(_BETWEEN_LOOKS_S):
            with outlived(self._slate, "the watch over the rig"):
                self._slate.write(silence=self.look())

    def _answers(self) -> str:
        now = self._now()
        # While it waits for a person or a camera the host may ask nothing.
        if not self._controller.link_counts.unanswered:
            self._heard_at = now
        return _since("no answer from the rig", now - self._heard_at, SILENT_S)

    def _steps(self) -> str:
        picture, now = self._slate.picture().version, self._now()
        if picture != self._picture:
            if self._stepping:
                self._took.append(now - self._step_at)
            self._picture, self._step_at, self._stepping = picture, now, True
        # A person has a part in poses of the board; after the last step the capture is verified.
        done, planned = self._slate.read("done") or 0, self._slate.read("planned") or 0
        doing = self._slate.read("doing")
        if not self._stepping or not (doing == "aim" or (doing == "sweep" and done < planned)):
            return ""
        allowed = max(STILL_S, _SLOWER * statistics.median(self._took or [0.0]))
        return _since("no finished step", now - self._step_at, allowed)


def _since(what: str, seconds: float, allowed: float) -> str:
    return f"{what} for {seconds:.0f} s" if seconds >= allowed else ""
