"""A batch on a cluster: orders go to workers, rows come back, and absent or unfit workers are noticed.

This process keeps the graph of steps and writes the catalogue. Dask's scheduler hands tasks to workers, and gives those
of a worker that died to another.
"""

import asyncio
import concurrent.futures
import contextlib
import hashlib
import os
import secrets
import time
import warnings
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, final, runtime_checkable

import distributed

from jaxscan.errors import FleetError
from jaxscan.files.disk import open_to_write
from jaxscan.project import (
    Catalogue,
    Order,
    Row,
    begun_row,
    code_digest,
    do_step,
    failed_row,
    row_from_json,
    row_to_json,
)


PATIENCE_S = 300.0
"""How long a batch waits where no worker is there."""


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
    """Of the steps that were done or failed."""
    left: Mapping[str, str]
    """Steps that were not begun, with the step that failed before them."""

    @property
    def failed(self) -> tuple[Row, ...]:
        """The steps that failed."""
        return tuple(row for row in self.rows if row.state == "failed")


def do_order(text: str) -> str:
    """Do the step of an order in a worker, and report its progress.

    Args:
        text: As `Order.to_json` has it.

    Returns:
        The row for the catalogue, as `row_to_json` has it.

    Raises:
        UnfitWorker: If this worker has other code than the batch, or cannot write into the folder of the products.
    """
    order = Order.from_json(text)
    if code_digest(order.step.kind) != order.parts["code"]:
        raise UnfitWorker(distributed.get_worker().address, "runs other code of jaxscan than the batch")
    if not os.access(order.output, os.W_OK | os.X_OK):
        raise UnfitWorker(distributed.get_worker().address, f"cannot write in {order.output}")
    return row_to_json(do_step(order, _reporter(order.step.key)))


class UnfitWorker(Exception):
    """A worker that can do nothing for a batch: it joined after the versions were compared."""

    def __init__(self, address: str, reason: str) -> None:
        """Args: where the worker is, and what it lacks."""
        super().__init__(address, reason)
        self.address, self.reason = address, reason

    def __str__(self) -> str:
        return f"the worker {self.address} {self.reason}."


def run_batch(
    todo: Sequence[Order],
    catalogue: Catalogue,
    client: distributed.Client,
    show: Show,
    *,
    patience_s: float = PATIENCE_S,
    work: Callable[[str], str] = do_order,
) -> Report:
    """Do steps, each after those that it needs.

    Args:
        todo: For the steps that are not done; inputs come first.
        catalogue: Gets a row for each step as it comes back.
        client: Of the cluster.
        show: Receives the progress.
        patience_s: How long it waits where no worker is there.
        work: What a worker does with an order; a function of a module.

    Raises:
        FleetError: If the scheduler is lost, or no worker is there for too long. What was done is in the catalogue.
    """
    orders = {order.step.key: order for order in todo}
    before = {key: {need for need in order.step.inputs if need in orders} for key, order in orders.items()}
    after: dict[str, list[str]] = defaultdict(list)
    for key, needs in before.items():
        for need in needs:
            after[need].append(key)
    ready = deque(key for key, needs in before.items() if not needs)
    rows: list[Row] = []
    left: dict[str, str] = {}
    tasks = Tasks(client, work, patience_s)
    with contextlib.closing(tasks), _Writer(catalogue) as writer, _progress(client, show):
        while ready or tasks.busy:
            if ready and tasks.room:
                given = [orders[ready.popleft()] for _ in range(min(len(ready), tasks.room))]
                writer.begun(given)
                tasks.hand_out(given)
            for row in tasks.ended():
                writer.add(row)
                rows.append(row)
                show.finished(row)
                for key in after[row.key] if row.state == "done" else ():
                    before[key].discard(row.key)
                    if not before[key]:
                        ready.append(key)
                if row.state == "failed":
                    left |= dict.fromkeys(_behind(row.key, after), row.key)
            if not tasks.more:
                writer.flush()
    return Report(tuple(rows), left)


def check_sight(client: distributed.Client, output: Path) -> None:
    """Check that every worker sees the folder of the products, before any work.

    Raises:
        FleetError: With the worker that does not.
    """
    name = f".seen-{secrets.token_hex(8)}"
    open_to_write(output / name, "make").close()
    try:
        # A worker that ends meanwhile needs no sight.
        seen = client.run(sees, str(output), name, on_error="ignore")
    finally:
        (output / name).unlink()
    blind = next((worker for worker, sight in seen.items() if not sight), None)
    if blind is not None:
        raise FleetError(f"{output}: the worker {blind} cannot write there; all workers need this folder at this path.")


def sees(folder: str, name: str) -> bool:
    """Whether a worker sees a file of the caller, and may write beside it."""
    path = Path(folder, name)
    try:
        probe = path.with_name(f"{name}.{time.time_ns()}")
        seen = path.is_file()
        open_to_write(probe, "make").close()
        probe.unlink()
    except OSError:
        return False
    return seen


def _behind(key: str, after: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """All steps that need a step, also by way of others."""
    waiting, seen = deque(after.get(key, ())), set()
    while waiting:
        one = waiting.popleft()
        if one not in seen:
            seen.add(one)
            yield one
            waiting.extend(after.get(one, ()))


_WRITTEN_S = 0.5
"""Between two transactions of the catalogue."""


class _Writer:
    """Writes rows to the catalogue, many in one transaction; steps whose row is lost at a crash are done again."""

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue, self._rows, self._last = catalogue, list[Row](), time.monotonic()

    def __enter__(self) -> "_Writer":
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()

    def begun(self, orders: Sequence[Order]) -> None:
        """Write that steps are begun, before they are: files of a step that did not end must not look older."""
        self._catalogue.write([*self._rows, *map(begun_row, orders)])
        self._rows, self._last = [], time.monotonic()

    def add(self, row: Row) -> None:
        """Take a row, and write all rows if the last transaction is a while ago."""
        self._rows.append(row)
        if time.monotonic() - self._last > _WRITTEN_S:
            self.flush()

    def flush(self) -> None:
        """Write all rows now."""
        self._catalogue.write(self._rows)
        self._rows, self._last = [], time.monotonic()


_TOPIC = "jaxscan-progress"
_QUIET_S = 0.5
"""Between two messages of one step."""


def _reporter(key: str) -> Callable[[int, int], None]:
    """A callback in a worker that sends its progress to the client."""
    worker, last = distributed.get_worker(), 0.0

    def report(done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > _QUIET_S:
            last = now
            worker.log_event(_TOPIC, [key, int(done), int(total)])

    return report


@contextlib.contextmanager
def _progress(client: distributed.Client, show: Show) -> Iterator[None]:
    """Show what workers report, until the end of `with`."""

    def heard(event: tuple[float, tuple[str, int, int]]) -> None:
        show.working(*event[1])

    client.subscribe_topic(_TOPIC, heard)
    try:
        yield
    finally:
        if client.status == "running":
            client.unsubscribe_topic(_TOPIC)


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
    handed out once more when nothing else is at work, and fails only if its workers die then too.
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
        with _reported_if_lost():
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
        with _reported_if_lost():
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
        """The rows of tasks, by one request for all; a task whose worker is gone with its result has none."""
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
            self._retire(problem)
            self.hand_out([order])
        elif isinstance(problem, distributed.KilledWorker) and order is not self._alone:
            self._blamed.append(order)
        else:
            killed = isinstance(problem, distributed.KilledWorker)
            message = f"the cluster could not do it: {type(problem).__name__}: {problem}".splitlines()[0]
            yield self._settled(failed_row(order, _KILLED if killed else message))

    def _retire(self, problem: UnfitWorker) -> None:
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
def _reported_if_lost() -> Iterator[None]:
    """One error for the many ways in which Dask ends without its scheduler."""
    try:
        yield
    except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError) as problem:
        raise FleetError(_LOST) from problem


LOOK_S = 5.0
"""Between two questions to the scheduler."""
WARN_S = 60.0
"""After so much time without a worker there is a warning, once for each absence."""


@final
class Absence:
    """How long no worker has had a task of a batch that waits for some."""

    def __init__(self, client: distributed.Client, patience_s: float) -> None:
        """Args: the client of the cluster, and how long a worker may be awaited [s]."""
        self._client, self._patience_s = client, patience_s
        self._looked = self._busy = time.monotonic()
        self._warned = False

    def look(self) -> None:
        """Ask whether somebody works, if the last question was a while ago.

        Raises:
            FleetError: If nobody has worked for as long as was allowed.
        """
        now = time.monotonic()
        if now - self._looked < LOOK_S or self._client.status != "running":
            return
        self._looked = now
        if any(self._client.processing().values()):
            self._busy, self._warned = now, False
        elif now - self._busy > self._patience_s:
            raise FleetError(
                f"no worker of the cluster came for {self._patience_s / 60:.0f} min; start workers and call the same "
                "command, which goes on where it was."
            )
        elif now - self._busy > WARN_S and not self._warned:
            self._warned = True
            warnings.warn(
                f"no worker of the cluster has worked for {WARN_S:.0f} s; the batch waits for one at most "
                f"{self._patience_s / 60:.0f} min.",
                RuntimeWarning,
                stacklevel=2,
            )
