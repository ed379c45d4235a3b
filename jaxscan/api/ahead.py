"""Jobs that another thread does in advance: they compile code while images are read."""

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any, final

from jaxscan.errors import JaxscanError


_LOOK_S = 0.25
"""A wait says so often that it goes on."""


def tell(progress: object, words: str) -> None:
    """Tell a progress display what is being done, if it has a method `doing` that takes words."""
    doing = getattr(progress, "doing", None)
    if doing is not None:
        doing(words)


@final
class Ahead:
    """Jobs done one after the other by another thread; leaving `with` drops those that have not begun.

    Compiling lets go of Python's lock, so two threads use two cores. A job fails by itself: its error is a warning
    when its end is awaited or `with` is left, and a `JaxscanError`, by which a rehearsal refuses its own made-up
    input, is none.
    """

    def __init__(self, jobs: Sequence[tuple[str, Callable[[], Any]]]) -> None:
        """Begin the jobs, each with its name."""
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="ahead")
        self._jobs: dict[str, Future[Any]] = {name: self._pool.submit(job) for name, job in jobs}
        self._told: set[str] = set()

    def __enter__(self) -> "Ahead":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Nobody waits for a job that nobody needs any more.
        self._pool.shutdown(wait=False, cancel_futures=True)
        if problem is None:
            for name, job in self._jobs.items():
                if job.done() and not job.cancelled():
                    self._tell_error(name, job.exception())

    def wait(self, name: str, progress: object = None) -> None:
        """Wait for the end of a job, and of those before it, while `progress` is told which one is being done.

        Args:
            name: The job; nothing is waited for where there is none of that name.
            progress: As for `tell`.
        """
        if name not in self._jobs:
            return
        for number, (other, job) in enumerate(self._jobs.items(), 1):
            while not job.done():
                tell(progress, f"compiling {number} of {len(self._jobs)}: {other}")
                try:
                    self._tell_error(other, job.exception(timeout=_LOOK_S))
                except TimeoutError:
                    continue
            self._tell_error(other, job.exception())
            if other == name:
                return

    def _tell_error(self, name: str, problem: BaseException | None) -> None:
        if problem is None or isinstance(problem, JaxscanError) or name in self._told:
            return
        self._told.add(name)
        said = f"compiling ahead ({name}) failed, so it is done when needed: {type(problem).__name__}: {problem}"
        warnings.warn(said, RuntimeWarning, stacklevel=3)
