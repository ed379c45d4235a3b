"""Ends the process on a signal: within two seconds, with one line, and with no file half written.

Unwinding by KeyboardInterrupt does not do that: compiled code does not notice it, imports and libraries swallow it or
answer with tracebacks, and threads of XLA crash while the interpreter ends. So the process ends where it is, after its
partial files are removed. Only a rig in use is left by unwinding, so that its laser is switched off first.

Imports nothing that has to be loaded, because a signal may come while the interpreter starts.
"""

import _signal  # type: ignore[import-not-found]
import _thread
import os
import sys
import time


TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType, TracebackType

CODES = {"SIGINT": 130, "SIGTERM": 143, "SIGHUP": 129}
"""Exit codes, as a shell gives them."""
GRACE_S = 0.3
"""After this time without an answer of the main thread, which may be in compiled code, another thread answers."""
CLEANING_S = 1.2
"""Longest time that removing partial files may take."""

_ending = _thread.allocate_lock()
_screen = [b""]
_rigs: "list[RigInUse]" = []


def listen() -> None:
    """Answer signals from now on. Those that the caller of this process ignores stay ignored (nohup, `&`)."""
    numbers = {getattr(_signal, name): name for name in CODES if hasattr(_signal, name)}
    heard = {number: name for number, name in numbers.items() if _signal.getsignal(number) != _signal.SIG_IGN}

    def answer(number: int, frame: "FrameType | None") -> None:
        if _rigs:
            _rigs[-1].interrupt(heard[number])
        else:
            _end(heard[number])

    for number in heard:
        _signal.signal(number, answer)
    if os.name != "posix":
        return
    # The system writes the signal's number here at once, whatever the main thread does.
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    _signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    _thread.start_new_thread(_watch, (reading, heard))


def exit_code(interrupt: KeyboardInterrupt) -> int:
    """The exit code after an interrupt, whose text begins with the signal's name; SIGINT if it has none."""
    return CODES.get(str(interrupt).partition(",")[0], CODES["SIGINT"])


def leave_behind(screen: bytes) -> None:
    """Set the bytes that are written to standard error before the process ends by a signal: they put the terminal in
    order.
    """
    _screen[0] = screen


class RigInUse:
    """Within `with`, a signal raises KeyboardInterrupt, so that the laser goes off and the devices are closed."""

    def __init__(self) -> None:
        self._closing = False
        self._noted = ""

    def __enter__(self) -> "RigInUse":
        _rigs.append(self)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: "TracebackType | None"
    ) -> None:
        _rigs.remove(self)
        if self._noted and problem is None:
            raise KeyboardInterrupt(self._noted)

    def closing(self, *_: object) -> None:
        """From now on the devices are closed: a signal is noted, and raised when they are."""
        self._closing = True

    def interrupt(self, name: str) -> None:
        """Answer a signal.

        Raises:
            KeyboardInterrupt: Unless the devices are being closed.
        """
        if not self._closing:
            raise KeyboardInterrupt(name)
        self._noted = self._noted or name


def _watch(reading: int, heard: dict[int, str]) -> None:
    """Answer where the main thread cannot: in compiled code, which does not look for signals."""
    while True:
        names = [heard[number] for number in os.read(reading, 64) if number in heard]
        if names and not _rigs:
            time.sleep(GRACE_S)
            if not _rigs and not _end(names[0]):
                time.sleep(CLEANING_S)
                os._exit(CODES[names[0]])


def _end(name: str) -> bool:
    """Print the line, remove partial files and end the process; False if another thread is doing so."""
    if not _ending.acquire(False):
        return False
    try:
        os.write(2, _screen[0] + b"jaxscan: interrupted\n")
    except OSError:
        pass  # Nobody listens.
    try:
        # Looked up, not imported: a module that is not loaded has no partial files.
        clean = getattr(sys.modules.get("jaxscan.files.disk.writing"), "forget_partials", None)
        if clean is not None:
            clean()
    finally:
        os._exit(CODES[name])
