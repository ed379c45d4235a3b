"""Stop: another thread ends what the main thread does with the rig, at once, as a second Ctrl-C does."""

import signal
import threading
import time
from types import FrameType, TracebackType


PAGE = "Stop on the page"
_SIGNAL = getattr(signal, "SIGUSR1", None)
"""Wakes the main thread from whatever it waits for; Windows has none."""
_AGAIN_S = 0.05
"""Until the signal is sent once more."""


class Stopping:
    """Within `with`, in the main thread, `stop` raises KeyboardInterrupt there while `begin` and `end` allow it.

    The handler stays for the whole time, so that a signal that comes late does nothing.
    """

    def __init__(self) -> None:
        """Nothing is stopped yet."""
        self._allowed = False
        self._session = self._asked = 0
        self._main = threading.main_thread().ident
        self._before: object = None

    def __enter__(self) -> "Stopping":
        if _SIGNAL is not None:
            self._before = signal.signal(_SIGNAL, self._on_signal)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        if _SIGNAL is not None:
            signal.signal(_SIGNAL, self._before or signal.SIG_DFL)  # type: ignore[arg-type]

    def begin(self) -> None:
        """From now on an order to stop interrupts the main thread."""
        self._session += 1
        self._allowed = True

    def end(self) -> None:
        """From now on it does nothing: the devices are being closed."""
        self._allowed = False

    def stop(self) -> None:
        """Interrupt the main thread, from another one."""
        self._asked = self._session
        threading.Thread(target=self._insist, args=(self._session,), daemon=True).start()

    def _insist(self, session: int) -> None:
        """Send the signal until it was heard: one that comes in the moment before the main thread begins to wait does
        not end that wait.
        """
        while _SIGNAL is not None and self._main is not None and self._allowed and self._session == session:
            # Also where it waits for a port or a camera, which a flag would not end.
            signal.pthread_kill(self._main, _SIGNAL)
            time.sleep(_AGAIN_S)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._allowed and self._asked == self._session:
            # Once: switching the laser off is not interrupted.
            self._allowed = False
            raise KeyboardInterrupt(PAGE)
