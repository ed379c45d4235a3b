"""The functions that run on a worker; they are told names and numbers as text."""

import os
import time
from collections.abc import Callable
from pathlib import Path

import distributed

from jaxscan.files.disk import open_to_write
from jaxscan.project import Order, code_digest, do_step, row_to_json


TOPIC = "jaxscan-progress"
_QUIET_S = 0.5
"""Between two messages of one step."""


class UnfitWorker(Exception):
    """A worker that can do nothing for a batch: one that joined later than those that were compared at its start."""

    def __init__(self, address: str, reason: str) -> None:
        """Args: where the worker is, and what it lacks."""
        super().__init__(address, reason)
        self.address, self.reason = address, reason

    def __str__(self) -> str:
        return f"the worker {self.address} {self.reason}."


def do_order(text: str) -> str:
    """Do the step of an order, and tell how far it is.

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
    return row_to_json(do_step(order, _teller(order.step.key)))


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


def _teller(key: str) -> Callable[[int, int], None]:
    worker, last = distributed.get_worker(), 0.0

    def tell(done: int, total: int) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > _QUIET_S:
            last = now
            worker.log_event(TOPIC, [key, int(done), int(total)])

    return tell
