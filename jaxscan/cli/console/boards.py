"""Captures of the board from the page: a person places it and says so there, or a command does."""

import queue
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.cli.boards import CommandOperator
from jaxscan.cli.console.guidance import guidance
from jaxscan.cli.console.painter import Painter, Seen
from jaxscan.cli.console.slate import Slate


if TYPE_CHECKING:
    from scanrig.checks.guide import Guide
    from scanrig.config import RigConfig
    from scanrig.session import PlacementRequest

_BETWEEN_S = 0.1
"""Rest between two looks."""


class PageOperator:
    """An `Operator` of `scanrig.session.run`: a person at the page."""

    def __init__(self, guide: "Guide", painter: Painter, slate: Slate, should_stop: Callable[[], bool]) -> None:
        """Ask on the slate; `answer` brings the answers from another thread."""
        self._guide, self._painter, self._slate = guide, painter, slate
        self._should_stop = should_stop
        self._answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._enough = False
        self.command: CommandOperator | None = None
        """Places the board in place of a person."""
        self.before: Callable[[PlacementRequest], None] = lambda request: None
        """Called before the board is placed."""
        self.placing: PlacementRequest | None = None
        """The request for which the board is placed now."""

    def answer(self, word: str) -> None:
        """An answer of the person: "take", "enough" (of this kind), or "enough of all"."""
        self._answers.put(word)

    def place(self, request: "PlacementRequest") -> bool:
        """Look, and show what is seen, until the person takes it or says that it is enough."""
        if self._enough:
            return False
        self.placing = request
        self.before(request)
        asked = {"kind": request.kind, "number": request.number, "total": request.total, "at_deg": request.at_deg}
        if self.command is not None:
            self._slate.write(doing="boards", placing=asked)
            return self.command.place(request)
        while not self._answers.empty():
            # Pressed too early, it would take the board while it is moved to the next pose.
            self._answers.get()
        # The session has opened the contactor, because somebody is in front of the laser.
        self._slate.write(doing="placing", placing=asked, laser="off")
        while not self._should_stop():
            self._look(request)
            try:
                word = self._answers.get(timeout=_BETWEEN_S)
            except queue.Empty:
                continue
            if word != "take":
                self._enough = word == "enough of all"
                return False
            if self._look(request):
                self._slate.write(doing="boards", laser="may shine")
                return True
        return False

    def _look(self, request: "PlacementRequest") -> bool:
        """Show what is seen now, and whether the board is."""
        frame = request.look()
        look = self._guide.look(None, frame)
        self._painter.show(Seen(None, frame, 0, {}))
        self._slate.write(guide=guidance(self._guide, look, request.kind))
        return look.view is not None


def on_board_pair(
    rig: "RigConfig", guide: "Guide", operator: PageOperator, painter: Painter, slate: Slate
) -> Callable[[int, float, np.ndarray, np.ndarray], None]:
    """The hook of a session that counts each pose in the guide, and shows it."""

    def on_pair(number: int, angle: float, on: np.ndarray, off: np.ndarray) -> None:
        request, laser = operator.placing, rig.laser_of(number)
        kind = "free" if request is None else request.kind
        seen = guide.look(on, off, laser)
        guide.keep(seen, request.number if kind == "placement" and request is not None else None)
        facts: dict[str, Any] = {"record": number}
        painter.show(Seen(on, off, laser, facts))
        slate.write(guide=guidance(guide, seen, kind))

    return on_pair
