"""Proves and writes pairs in the background, in order, while the table goes on."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TypeVar


T = TypeVar("T")

AHEAD = 4
"""Pairs that may wait to be proven and written; the table stands still while there are more."""


class Background:
    """Two threads: one proves, one writes. Each does its work in the order in which it was given.

    After the first failure nothing more is written, so that a capture never has a gap that nobody knows of.
    """

    def __init__(self) -> None:
        """No thread runs before there is work."""
        self._prover = ThreadPoolExecutor(1, thread_name_prefix="scanrig-prove")
        self._writer = ThreadPoolExecutor(1, thread_name_prefix="scanrig-write")
        self._failed: BaseException | None = None

    def prove(self, work: Callable[[], T]) -> Future[T]:
        """Begin a proof."""
        return self._prover.submit(work)

    def write(self, work: Callable[[], T]) -> Future[T]:
        """Write something after all that was given before; it may wait for a proof.

        Raises:
            BaseException: What earlier work raised.
        """
        if self._failed is not None:
            raise self._failed
        return self._writer.submit(partial(self._unless_failed, work))

    def wait(self) -> None:
        """Wait until all is written.

        Raises:
            BaseException: What it raised.
        """
        self.write(lambda: None).result()

    def end(self) -> None:
        """Wait for what was given, and end the threads; raises nothing of theirs."""
        self._prover.shutdown()
        self._writer.shutdown()

    def _unless_failed(self, work: Callable[[], T]) -> T:
        if self._failed is not None:
            raise self._failed
        try:
            return work()
        except BaseException as problem:
            self._failed = problem
            raise
