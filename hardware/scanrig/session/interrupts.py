"""Ctrl-C, and the other signals that end a session: the first after the step, the second now."""

import contextlib
import os
import signal
from types import FrameType, TracebackType
from typing import Any


NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_ANSWER = b"jaxscan: ends after this step; Ctrl-C again ends at once\n"


class Interrupts:
    """Within `with`, the first SIGINT, SIGTERM or SIGHUP is only noted and answered with a line, and the second
    raises KeyboardInterrupt.

    Pass it as `should_stop`. Further signals do nothing, so that switching the laser off is not interrupted.
    Works only in the main thread, as all signal handlers of Python.

    After the terminal has hung up, output is discarded, so that printing raises no error and the session ends in order.
    Only a line that is being printed in that very moment fails with OSError.
    """

    def __init__(self) -> None:
        self.received: list[str] = []
        self._before: dict[int, Any] = {}
        self._terminals: list[int] = []

    def __call__(self) -> bool:
        """Whether the session is to end."""
        return bool(self.received)

    def __enter__(self) -> "Interrupts":
        self._terminals = [number for number in (0, 1, 2) if os.isatty(number)]
        for name in NAMES:
            number = getattr(signal, name, None)  # Windows has no SIGHUP.
            if number is not None:
                self._before[number] = signal.signal(number, self._on_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        self._before.clear()
        if isinstance(problem, KeyboardInterrupt) and not problem.args:
            # Raised where the request was seen, which does not know the signal.
            problem.args = tuple(self.received[:1])

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self.received.append(signal.Signals(number).name)
        self._let_go_of_dead_terminals()
        if len(self.received) == 1:
            # Not through `sys.stderr`, which the signal may have interrupted; below a bar that is being drawn.
            with contextlib.suppress(OSError):
                os.write(2, b"\n" * os.isatty(2) + _ANSWER)
        if len(self.received) == 2:
            raise KeyboardInterrupt(f"{self.received[0]}, then {self.received[1]}")

    def _let_go_of_dead_terminals(self) -> None:
        for number in self._terminals:
            # A terminal that hung up is no terminal any more.
            if not os.isatty(number):
                nowhere = os.open(os.devnull, os.O_RDWR)
                os.dup2(nowhere, number)
                os.close(nowhere)
