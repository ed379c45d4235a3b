"""Runs a verb, and answers every way in which it may end with at most one line and an exit code."""

import contextlib
import logging
import os
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxscan.cli import environment
from jaxscan.cli.options import inputs_in_words
from jaxscan.cli.signals import exit_code
from jaxscan.cli.verbs import parse
from jaxscan.errors import JaxscanError
from jaxscan.printable import printable


DEFECT, UNREAD = 70, 141
"""Exit codes: a defect of jaxscan; nobody reads the output (as after SIGPIPE)."""
_LONGEST = 300
"""Longest message of an unexpected error, or of another library, that is quoted."""
_SELDOM_S = 60.0
"""A kind of message of other libraries is printed once in that time."""
_DEFECT = "this is a defect of jaxscan"


def run_function(words: Sequence[str]) -> int:
    """Run one verb in a process of the caller, and return the exit code.

    Raises:
        SystemExit: After a request for help, or a mistake in the words.
        Exception: With `--debug`, of any error.
    """
    debug = "--debug" in words
    try:
        work = parse([word for word in words if word != "--debug"])
        environment.keep_compiled_code()
        work()
        if sys.stdout is not None:
            sys.stdout.flush()
    except SystemExit as left:
        # rich leaves this way where nobody reads its output.
        if isinstance(left.__context__, BrokenPipeError):
            return UNREAD
        raise
    except (Exception, KeyboardInterrupt) as problem:
        if debug:
            raise
        return _answer(problem)
    return 0


def run_process(words: Sequence[str]) -> int:
    """Run one verb in a process of its own, and close its output."""
    environment.open_standard_files()
    environment.hush_libraries()
    environment.choose_caches()
    environment.one_thread_per_product()
    if "--debug" not in words:
        _keep_to_lines()
    try:
        code = run_function(words)
    except SystemExit as left:
        code = left.code if isinstance(left.code, int) else int(left.code is not None)
    except (Exception, KeyboardInterrupt) as problem:
        for line in "".join(traceback.format_exception(problem)).splitlines():
            say_line(line)
        code = 1
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (OSError, ValueError) as problem:
        code = code or _answer(problem)
        # The interpreter tries again while it ends, and would say so.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    return code


def _answer(problem: BaseException) -> int:
    """Print one line on an error, and return the exit code."""
    if isinstance(problem, KeyboardInterrupt):
        say_line("interrupted")
        return exit_code(problem)
    if isinstance(problem, BrokenPipeError):
        return UNREAD
    said = answer_in_words(problem)
    say_line(said)
    return DEFECT if said.startswith(_DEFECT) else 1


def answer_in_words(problem: BaseException) -> str:
    """One line on an error that ended a verb, or a part of it."""
    if isinstance(problem, JaxscanError):
        # Messages of other libraries may have several lines.
        return " ".join(str(problem).split())
    if isinstance(problem, MemoryError) or "RESOURCE_EXHAUSTED" in str(problem)[:_LONGEST]:
        return f"{inputs_in_words()}: too large for the memory of this machine."
    if isinstance(problem, RecursionError):
        return f"{inputs_in_words()}: nested too deeply to be read."
    if isinstance(problem, OSError) and problem.strerror:
        return f"{problem.filename or 'standard output'}: {problem.strerror}."
    return _defect(problem)


def _defect(problem: BaseException) -> str:
    """An error that nobody foresaw, with its place and message, for a report."""
    places = [frame for frame in traceback.extract_tb(problem.__traceback__) if _is_ours(frame.filename)]
    where = f" in {Path(places[-1].filename).name}, line {places[-1].lineno}" if places else ""
    said = " ".join(str(problem).split())
    said = f": {said[:_LONGEST]}" if said else ""
    return (
        f"{_DEFECT}, not of your files: {type(problem).__name__}{where}{said}. Please report this "
        "line and the command; the same command with --debug shows more."
    )


def _is_ours(file: str) -> bool:
    return any(folder in Path(file).parts for folder in ("jaxscan", "scanrig"))


def say_line(line: str) -> None:
    """Print a line on standard error, if anybody listens."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):
            print(f"jaxscan: {printable(line)}", file=sys.stderr, flush=True)


class LogLines:
    """Takes the place of `logging.lastResort`: of each kind of message one line a minute, with the number of others.

    Requests of strangers to a server are logged too, and there may be many. A kind is the place in the program that
    logged it, so there are few.
    """

    level = logging.WARNING

    def __init__(self, say: Callable[[str], None], now: Callable[[], float] = time.monotonic) -> None:
        """Print lines by `say`; `now` gives the time [s]."""
        self._say, self._now = say, now
        self._lock = threading.Lock()
        self._said: dict[tuple[str, str, int], tuple[float, int]] = {}
        """When a kind was printed, and how many others came since."""

    def handle(self, record: logging.LogRecord) -> None:
        """Print a message, or count it."""
        kind, now = (record.name, record.pathname, record.lineno), self._now()
        with self._lock:
            at, others = self._said.get(kind, (-_SELDOM_S, 0))
            if now - at < _SELDOM_S:
                self._said[kind] = at, others + 1
                return
            self._said[kind] = now, 0
        message = " ".join(record.getMessage().split())[:_LONGEST]
        self._say(f"note: {message}" + (f" ({others} more of this kind since the last line)" if others else ""))


def _keep_to_lines() -> None:
    """Print messages of other libraries and of threads as lines of ours, with nothing for the terminal to obey."""

    def show_warning(message: Warning | str, category: type[Warning], *_: object) -> None:
        say_line(f"note: {category.__name__}: {' '.join(str(message).split())}")

    def show_unheard(unheard: Any) -> None:
        if unheard.exc_value is not None and not isinstance(unheard.exc_value, KeyboardInterrupt):
            say_line(_defect(unheard.exc_value))

    warnings.showwarning = show_warning  # type: ignore[assignment]
    logging.lastResort = LogLines(say_line)  # type: ignore[assignment]
    threading.excepthook = sys.unraisablehook = show_unheard
