"""Notices while a session runs that the rig does not answer, or that no step ends, long before time-outs end it."""

import statistics
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from jaxscan.cli.console.outliving import outlived
from jaxscan.cli.console.slate import Slate


if TYPE_CHECKING:
    from scanrig.controllers import Controller

SILENT_S = 5.0
"""So long the rig may leave questions without an answer: a bad cable costs less."""
STILL_S = 10.0
"""So long a step may take, or `_SLOWER` times as long as those before it."""
_SLOWER, _KEPT = 3.0, 50
_BETWEEN_S = 0.5


class Silence:
    """Keeps "silence" on the slate within `with`: a few words, or "" while all is well."""

    def __init__(self, slate: Slate, controller: "Controller", now: Callable[[], float] = time.monotonic) -> None:
        """Begin to listen.

        Args:
            slate: Where it is told; its picture changes with each step.
            controller: Whose lines are counted.
            now: The time [s].
        """
        self._slate, self._controller, self._now = slate, controller, now
        self._heard_at = now()
        self._picture, self._step_at = slate.picture().version, 0.0
        self._stepping = False
        """Whether a step has ended since the table found home, which takes as long as it takes."""
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
        while not self._end.wait(_BETWEEN_S):
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
