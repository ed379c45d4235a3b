"""A batch: steps done in processes of their own on this machine, each after those that it needs.

Each process does one step at a time. One that dies, for lack of memory say, fails its step alone, and has a successor.
"""

import contextlib
import multiprocessing
import os
import re
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from graphlib import TopologicalSorter
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from jaxscan.errors import ConfigError, JaxscanError
from jaxscan.files.disk import MEGABYTE, forget_partials, open_regular
from jaxscan.project.catalogue import Catalogue, Row
from jaxscan.project.steps import Status
from jaxscan.project.work import begun_row, do_step, failed_row
from jaxscan.reconstruction import Progress


@runtime_checkable
class Show(Protocol):
    """Receives the progress of a batch."""

    def working(self, key: str, done: int, total: int) -> None:
        """How far a step is."""

    def finished(self, row: Row) -> None:
        """A step was done, or failed."""


class Report(NamedTuple):
    """The outcome of a batch."""

    rows: tuple[Row, ...]
    """Rows of the steps that were done or failed."""
    left: Mapping[str, str]
    """Steps that were not begun, with the step that failed before them."""


_WRITTEN_S, _AT_ONCE = 0.5, 64
"""Time between two transactions of the catalogue [s], and the most steps that one marks as begun: each waits for the
disk."""
Work = Callable[[Status, Path, Progress], Row]


def run_batch(
    todo: Sequence[Status], output: Path, catalogue: Catalogue, show: Show, *, workers: int, work: Work = do_step
) -> Report:
    """Do steps, each after those that it needs.

    Args:
        todo: The steps that are not done; inputs come first.
        output: The folder of the products.
        catalogue: Gets a row for each step as it begins and as it ends.
        show: Receives the progress.
        workers: Number of processes.
        work: What a process does with a step; a function of a module.
    """
    steps = {one.step.key: one for one in todo}
    graph = TopologicalSorter({key: [need for need in one.step.inputs if need in steps] for key, one in steps.items()})
    graph.prepare()
    ready, begun, rows, ended, written = deque(graph.get_ready()), deque[Status](), dict[str, Row](), list[Row](), 0.0
    with contextlib.closing(_Workers(min(workers, len(todo)), output, work)) as pool:
        while ready or begun or pool.busy:
            if not begun or time.monotonic() - written > _WRITTEN_S:
                given = [steps[ready.popleft()] for _ in range(0 if begun else min(len(ready), _AT_ONCE))]
                # Written before the work, so that files of an interrupted step do not look older than its row.
                catalogue.write([*ended, *map(begun_row, given)])
                begun.extend(given)
                ended, written = [], time.monotonic()
            while begun and pool.idle:
                pool.begin(begun.popleft())
            for row in pool.ended(show):
                ended.append(row)
                rows[row.key] = row
                show.finished(row)
                if row.state == "done":
                    graph.done(row.key)
            ready.extend(graph.get_ready())
        catalogue.write(ended)
    left: dict[str, str] = {}
    for key, status in steps.items():
        if key not in rows:
            before = next(need for need in status.step.inputs if need in left or rows[need].state == "failed")
            left[key] = left.get(before, before)
    return Report(tuple(rows.values()), left)


class _Workers:
    """Processes that do steps, started when there is work for them."""

    def __init__(self, count: int, output: Path, work: Work) -> None:
        self._output, self._work = output, work
        self._free = list(range(count))
        self._count = count
        self._running: dict[Connection, tuple[int, Status]] = {}
        self._waiting: dict[int, tuple[Connection, multiprocessing.process.BaseProcess]] = {}

    @property
    def busy(self) -> bool:
        return bool(self._running)

    @property
    def idle(self) -> bool:
        return bool(self._free)

    def begin(self, status: Status) -> None:
        """Let a process that is idle do a step."""
        number = self._free.pop(0)
        if number not in self._waiting:
            self._waiting[number] = self._started(number)
        connection, _ = self._waiting[number]
        self._running[connection] = number, status
        with contextlib.suppress(OSError):  # Its end is noticed by `ended`.
            connection.send(status)

    def ended(self, show: Show) -> Iterator[Row]:
        """Wait for news, and give the rows of steps that have ended."""
        for connection in wait(list(self._running)):
            if not isinstance(connection, Connection):
                continue
            number, status = self._running[connection]
            try:
                news = connection.recv()
            except (EOFError, OSError):
                _, process = self._waiting.pop(number)
                process.join()
                connection.close()
                news = failed_row(status, _death(process.exitcode or 0))
            if isinstance(news, Row):
                del self._running[connection]
                self._free.append(number)
                yield news
            else:
                show.working(status.step.key, *news)

    def close(self) -> None:
        """End all processes."""
        for connection, process in self._waiting.values():
            process.kill()
            process.join()
            connection.close()

    def _started(self, number: int) -> "tuple[Connection, multiprocessing.process.BaseProcess]":
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self._output, self._work), daemon=True)
        with _share_of_cores(number, self._count):
            process.start()
        theirs.close()
        return ours, process


def _death(code: int) -> str:
    if code == -signal.SIGKILL:
        return "its process was killed, most often because it needs more memory than there is: --workers with less."
    return f"its process ended with {code}, as by a crash of a library."


@contextlib.contextmanager
def _share_of_cores(number: int, count: int) -> Iterator[None]:
    """Bind this thread, and a process that is started now, to every count-th core.

    JAX starts as many threads as its process may use cores; so no two processes wait for each other.
    """
    if count < 2 or not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    numbered = sorted(cores)
    os.sched_setaffinity(0, set(numbered[number % len(numbered) :: count]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def _serve(connection: Connection, output: Path, work: Work) -> None:
    """Do the steps that come, in a process of its own."""
    # Ctrl-C at a terminal reaches all that was started there. The batch answers it, and this process ends with it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # The end of the batch closes the connection.
    with contextlib.suppress(EOFError, OSError):
        while True:
            status = connection.recv()
            connection.send(work(status, output, lambda done, total: connection.send((int(done), int(total)))))


def _end_with_parent() -> None:
    """End this process, and remove what it has half written, when the batch has ended in any way."""
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
    forget_partials()
    os._exit(1)


LEAST_BYTES = 3 << 30
"""Memory that a process should have: a sweep, its compiled code and its products."""
_MEMORY = {
    "/proc/meminfo": (rb"MemAvailable: +(\d+) kB", 1024),
    "/sys/fs/cgroup/memory.max": (rb"(\d+)", 1),
    "/sys/fs/cgroup/memory/memory.limit_in_bytes": (rb"(\d+)", 1),
}
"""Where Linux says how much memory can be used without swapping, and how much a container may: pattern and unit."""


def default_workers() -> int:
    """A process for each core that may be used; fewer where memory is short."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, free_bytes() // LEAST_BYTES))


def free_bytes() -> int:
    """Free memory [bytes]; a huge number where the system does not say."""
    found = [1 << 50]
    for path, (pattern, unit) in _MEMORY.items():
        with contextlib.suppress(OSError, JaxscanError), open_regular(path, error=ConfigError) as file:
            found += [unit * int(number) for number in re.findall(pattern, file.read(MEGABYTE))]
    return min(found)
