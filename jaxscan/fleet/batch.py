"""The steps of a project on a Dask cluster: ready ones are handed out, and their rows go into the catalogue.

This process keeps the graph and writes the catalogue; the scheduler hands out tasks, and gives those of a worker that
died to another.
"""

import contextlib
import secrets
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import distributed

from jaxscan.errors import FleetError
from jaxscan.files.disk import open_to_write
from jaxscan.fleet.tasks import Tasks
from jaxscan.fleet.work import TOPIC, do_order, sees
from jaxscan.project import Catalogue, Order, Row, begun_row


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
    tasks = Tasks(client, work, patience_s)
    with contextlib.closing(tasks), _Written(catalogue) as written, _progress(client, show):
        while ready or tasks.busy:
            if ready and tasks.room:
                given = [orders[ready.popleft()] for _ in range(min(len(ready), tasks.room))]
                written.begun(given)
                tasks.hand_out(given)
            for row in tasks.ended():
                written.add(row)
                rows.append(row)
                show.finished(row)
                for key in after[row.key] if row.state == "done" else ():
                    before[key].discard(row.key)
                    if not before[key]:
                        ready.append(key)
                if row.state == "failed":
                    left |= dict.fromkeys(_behind(row.key, after), row.key)
            if not tasks.more:
                written.flush()
    return Report(tuple(rows), left)


class _Written:
    """Rows on their way to the catalogue, many in one transaction; those of the last moment are done again if lost."""

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue, self._rows, self._last = catalogue, list[Row](), time.monotonic()

    def __enter__(self) -> "_Written":
        return self

    def __exit__(self, *_: object) -> None:
        self.flush()

    def begun(self, orders: Sequence[Order]) -> None:
        """Write that steps are begun, before they are: what they wrote is not taken for what was there before."""
        self._catalogue.write([*self._rows, *map(begun_row, orders)])
        self._rows, self._last = [], time.monotonic()

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
    open_to_write(output / name, "make").close()
    try:
        # A worker that ends while it is asked is none.
        seen = client.run(sees, str(output), name, on_error="ignore")
    finally:
        (output / name).unlink()
    blind = next((worker for worker, sight in seen.items() if not sight), None)
    if blind is not None:
        raise FleetError(f"{output}: the worker {blind} cannot write there; all workers need this folder at this path.")


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
