"""Orders on their way through a cluster of Dask: handed out, brought back as rows, and tried again where that helps."""

import asyncio
import concurrent.futures
import contextlib
import hashlib
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import final

import distributed

from jaxscan.errors import FleetError
from jaxscan.fleet.absence import Absence
from jaxscan.fleet.work import UnfitWorker
from jaxscan.project import Order, Row, failed_row, row_from_json


MOST_AT_ONCE = 512
"""Tasks that are handed out at a time; more would only take memory of the scheduler."""
ACCELERATOR = "GPU"
"""Resource that a worker with an accelerator of its own names: `dask worker --resources GPU=1`."""
_FINDS_STRIPES = ("stripes", "cloud", "station")
_LOST = "the cluster's scheduler is lost; start it again and call the same command, which goes on where it was."
_KILLED = "its workers died, most often because it needs more memory than they have (--memory-gib)."
_POLL_S = 0.01


@final
class Tasks:
    """The orders that a cluster has.

    A worker that dies has often been given several tasks, and Dask blames all of them. So an order that is blamed is
    handed out once more when nothing else is at work, and only if its workers die then too it has failed.
    """

    def __init__(self, client: distributed.Client, work: Callable[[str], str], patience_s: float) -> None:
        """Args: the client of the cluster, what a worker does, and how long a worker may be awaited [s]."""
        self._client, self._work = client, work
        self._running: dict[distributed.Future, Order] = {}
        self._coming = distributed.as_completed(loop=client.loop)
        self._blamed = deque[Order]()
        self._alone: Order | None = None
        self._given = 0
        self._unfit = set[str]()
        self._absence = Absence(client, patience_s)
        workers = client.scheduler_info(n_workers=-1)["workers"].values()
        self._accelerated = any(ACCELERATOR in worker["resources"] for worker in workers)
        self._asking = concurrent.futures.ThreadPoolExecutor(1)

    @property
    def busy(self) -> bool:
        """Whether the cluster has orders, or is to get some again."""
        return bool(self._running or self._blamed)

    @property
    def room(self) -> int:
        """How many orders may be handed out now: many or none, for the scheduler takes a hundred in the time of ten."""
        half_empty = len(self._running) <= MOST_AT_ONCE // 2
        return MOST_AT_ONCE - len(self._running) if half_empty and self._alone is None else 0

    def hand_out(self, orders: Sequence[Order]) -> None:
        """Give orders to the cluster."""
        with _said_if_lost():
            for resources, some in by_resource(orders, accelerated=self._accelerated):
                # Each name is new: Dask remembers what became of another.
                self._given += 1
                texts = [order.to_json() for order in some]
                marks = [f"{_short(text)}-{self._given}" for text in texts]
                names = [f"{order.step.key}-{mark}" for order, mark in zip(some, marks, strict=True)]
                futures = self._client.map(
                    self._work, texts, key=names, pure=False, batch_size=None, resources=resources
                )
                self._running |= zip(futures, some, strict=True)
                self._coming.update(futures)

    def ended(self) -> list[Row]:
        """Wait until some tasks have ended; the rows of those that are done or failed for good, perhaps none.

        Raises:
            FleetError: If the scheduler is lost, or no worker is there for too long.
        """
        if not self._running:
            self._alone = self._blamed.popleft()
            self.hand_out([self._alone])
        with _said_if_lost():
            while not self._coming.has_ready():
                self._wait()
            ended = self._coming.next_batch(block=False)
            orders = {future: self._running.pop(future) for future in ended}
            rows = self._gathered([future for future in ended if future.status == "finished"])
            known = {row.key for row in rows}
            left = [(future, order) for future, order in orders.items() if order.step.key not in known]
            return rows + [row for future, order in left for row in self._not_done(future, order)]

    @property
    def more(self) -> bool:
        """Whether others have ended already."""
        return bool(self._coming.has_ready())

    def close(self) -> None:
        """Forget all that is at work."""
        self._asking.shutdown(wait=False, cancel_futures=True)

    def _wait(self) -> None:
        self._absence.look()
        time.sleep(_POLL_S)

    def _gathered(self, futures: Sequence[distributed.Future]) -> list[Row]:
        """The rows of tasks, by one question for all; of those whose worker is gone with its answer there is none."""
        if not futures:
            return []
        # The scheduler has lost tasks done again, for which workers may have to come first.
        answer = self._asking.submit(self._client.gather, list(futures), errors="skip")
        while not answer.done():
            self._wait()
        return [self._settled(_by_own_clock(row_from_json(text))) for text in answer.result()]

    def _settled(self, row: Row) -> Row:
        if self._alone is not None and row.key == self._alone.step.key:
            self._alone = None
        return row

    def _not_done(self, future: distributed.Future, order: Order) -> Iterator[Row]:
        """The row of an order that no worker brought to an end; none if it is tried again."""
        if future.cancelled():
            raise FleetError(_LOST)
        problem = future.exception() if future.status == "error" else None
        if problem is None:
            self._running[future] = order
            self._coming.add(future)
        elif isinstance(problem, UnfitWorker):
            self._send_home(problem)
            self.hand_out([order])
        elif isinstance(problem, distributed.KilledWorker) and order is not self._alone:
            self._blamed.append(order)
        else:
            killed = isinstance(problem, distributed.KilledWorker)
            message = f"the cluster could not do it: {type(problem).__name__}: {problem}".splitlines()[0]
            yield self._settled(failed_row(order, _KILLED if killed else message))

    def _send_home(self, problem: UnfitWorker) -> None:
        """End a worker that can do nothing for this batch; else it would fail all orders in no time."""
        if problem.address not in self._unfit:
            self._unfit.add(problem.address)
            warnings.warn(f"{problem} It gets no more work.", RuntimeWarning, stacklevel=2)
            self._client.retire_workers([problem.address], close_workers=True)


def by_resource(orders: Sequence[Order], *, accelerated: bool) -> list[tuple[dict[str, int] | None, list[Order]]]:
    """Orders by what their worker needs: those that find stripes go to accelerators, where there are any."""
    special = [order for order in orders if accelerated and order.step.kind in _FINDS_STRIPES]
    others = [order for order in orders if not (accelerated and order.step.kind in _FINDS_STRIPES)]
    parts: tuple[tuple[dict[str, int] | None, list[Order]], ...] = (({ACCELERATOR: 1}, special), (None, others))
    return [(resources, some) for resources, some in parts if some]


def _short(text: str) -> str:
    """A digest of an order, its folder included: other batches on the same cluster have other tasks."""
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _by_own_clock(row: Row) -> Row:
    """A row with its time by the clock of this machine: the catalogue has the oldest first, whoever did them."""
    return row._replace(started_s=time.time() - row.seconds)


@contextlib.contextmanager
def _said_if_lost() -> Iterator[None]:
    """Dask's many ways to end without its scheduler, in one line."""
    try:
        yield
    except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError) as problem:
        raise FleetError(_LOST) from problem
