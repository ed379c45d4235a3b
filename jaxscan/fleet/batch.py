"""The steps of a project on a Dask cluster: ready ones are handed out, and their rows go into the catalogue.

This process keeps the graph and writes the catalogue; the scheduler hands out tasks, and gives those of a worker that
died to another.
"""

import asyncio
import concurrent.futures
import contextlib
import secrets
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import distributed

from jaxscan.errors import FleetError
from jaxscan.fleet.absence import Absence
from jaxscan.fleet.work import TOPIC, do_order, sees
from jaxscan.project import Catalogue, Order, Row, failed_row, row_from_json


MOST_AT_ONCE = 512
"""Tasks that are handed out at a time; more would only take memory of the scheduler."""


ACCELERATOR = "GPU"
"""Resource that a worker with an accelerator of its own names: `dask worker --resources GPU=1`."""
_FINDS_STRIPES = ("stripes", "cloud", "station")
_LOST = "the cluster's scheduler is lost; start it again and call the same command, which goes on where it was."
_POLL_S = 0.01
_WRITTEN_S = 0.5
"""Between two transactions of the catalogue."""


@runtime_checkable
class Show(Protocol):
    """Hears of a batch while it goes on."""

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


def run_batch(
    todo: Sequence[Order],
    catalogue: Catalogue,
    client: distributed.Client,
    show: Show,
    *,
    patience_s: float = 300.0,
    work: Callable[[str], str] = do_order,
) -> Report:
    """Do steps, each after those that it needs.

    Args:
        todo: For the steps that are not done; inputs come first.
        catalogue: Gets a row for each step as it comes back.
        client: Of the cluster.
        show: Is told what goes on.
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
    running: dict[distributed.Future, str] = {}
    coming = distributed.as_completed(loop=client.loop)
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    accelerated = any(ACCELERATOR in worker["resources"] for worker in workers)
    absence = Absence(client, patience_s)
    with _Written(catalogue) as written, _said_if_lost(), _progress(client, show):
        while ready or running:
            if ready and len(running) <= MOST_AT_ONCE // 2:
                # Many at a time: the scheduler takes a hundred in the time of ten single ones.
                keys = [ready.popleft() for _ in range(min(len(ready), MOST_AT_ONCE - len(running)))]
                given = dict(_handed_out(client, work, [orders[key] for key in keys], accelerated=accelerated))
                running |= given
                coming.update(given)
            ended = _next_batch(coming, absence)
            for row in _rows_of(client, {future: orders[running.pop(future)] for future in ended}):
                written.add(row)
                rows.append(row)
                show.finished(row)
                for key in after[row.key] if row.state == "done" else ():
                    before[key].discard(row.key)
                    if not before[key]:
                        ready.append(key)
                if row.state == "failed":
                    left |= dict.fromkeys(_behind(row.key, after), row.key)
            if not coming.has_ready():
                written.flush()
    return Report(tuple(rows), left)


def _handed_out(
    client: distributed.Client, work: Callable[[str], str], orders: Sequence[Order], *, accelerated: bool
) -> Iterator[tuple[distributed.Future, str]]:
    """Tasks for some orders, each with its key."""
    for resources, some in by_resource(orders, accelerated=accelerated):
        names = [f"{order.step.key}-{order.digest[7:23]}" for order in some]
        texts = [order.to_json() for order in some]
        futures = client.map(work, texts, key=names, pure=False, batch_size=None, resources=resources)
        yield from zip(futures, (order.step.key for order in some), strict=True)


def by_resource(orders: Sequence[Order], *, accelerated: bool) -> list[tuple[dict[str, int] | None, list[Order]]]:
    """Orders by what their worker needs: those that find stripes go to accelerators, where there are any."""
    special = [order for order in orders if accelerated and order.step.kind in _FINDS_STRIPES]
    others = [order for order in orders if not (accelerated and order.step.kind in _FINDS_STRIPES)]
    parts: tuple[tuple[dict[str, int] | None, list[Order]], ...] = (({ACCELERATOR: 1}, special), (None, others))
    return [(resources, some) for resources, some in parts if some]


class _Written:
    """Rows on their way to the catalogue, many in one transaction; those of the last moment are done again if lost."""

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue, self._rows, self._last = catalogue, list[Row](), time.monotonic()

    def __enter__(self) -> "_Written":
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()

    def add(self, row: Row) -> None:
        """Take a row, and write all after some time in which there is no pause."""
        self._rows.append(row)
        if time.monotonic() - self._last > _WRITTEN_S:
            self.flush()

    def flush(self) -> None:
        """Write all rows now."""
        self._catalogue.write(self._rows)
        self._rows, self._last = [], time.monotonic()


def check_sight(client: distributed.Client, output: Path) -> None:
    """Check that every worker sees the folder of the products, before any work.

    Raises:
        FleetError: With the worker that does not.
    """
    name = f".seen-{secrets.token_hex(8)}"
    (output / name).touch()
    try:
        seen = client.run(sees, str(output), name)
    finally:
        (output / name).unlink()
    blind = next((worker for worker, sight in seen.items() if not sight), None)
    if blind is not None:
        raise FleetError(f"{output}: the worker {blind} cannot write there; all workers need this folder at this path.")


@contextlib.contextmanager
def _said_if_lost() -> Iterator[None]:
    """Dask's many ways to end without its scheduler, in one line."""
    try:
        yield
    except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError) as problem:
        raise FleetError(_LOST) from problem


def _next_batch(coming: distributed.as_completed, absence: Absence) -> list[distributed.Future]:
    """The tasks that ended since, at least one."""
    while not coming.has_ready():
        absence.look()
        time.sleep(_POLL_S)
    return list(coming.next_batch(block=False))


def _rows_of(client: distributed.Client, ended: Mapping[distributed.Future, Order]) -> list[Row]:
    """The rows of orders that ended.

    Raises:
        FleetError: If the scheduler is lost.
    """
    done = [future for future in ended if future.status == "finished"]
    # One question for all of them.
    rows = [_by_own_clock(row_from_json(text)) for text in client.gather(done)]
    return rows + [_not_done(future, order) for future, order in ended.items() if future not in done]


def _by_own_clock(row: Row) -> Row:
    """A row with its time by the clock of this machine: the catalogue has the oldest first, whoever did them."""
    return row._replace(started_s=time.time() - row.seconds)


def _not_done(future: distributed.Future, order: Order) -> Row:
    """The row of an order that no worker brought to an end."""
    if future.cancelled():
        raise FleetError(_LOST)
    problem = future.exception()
    if isinstance(problem, distributed.KilledWorker):
        message = "its workers died, most often because it needs more memory than they have (--memory-gib)."
    else:
        message = f"the cluster could not do it: {type(problem).__name__}: {problem}".splitlines()[0]
    return failed_row(order, message)


def _behind(key: str, after: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """All steps that need a step, also by way of others."""
    waiting, seen = deque(after.get(key, ())), set()
    while waiting:
        one = waiting.popleft()
        if one not in seen:
            seen.add(one)
            yield one
            waiting.extend(after.get(one, ()))


@contextlib.contextmanager
def _progress(client: distributed.Client, show: Show) -> Iterator[None]:
    def heard(event: tuple[float, tuple[str, int, int]]) -> None:
        show.working(*event[1])

    client.subscribe_topic(TOPIC, heard)
    try:
        yield
    finally:
        if client.status == "running":
            client.unsubscribe_topic(TOPIC)
