"""The functions that run on a worker; they are told names and numbers as text."""

import time
from collections.abc import Callable
from pathlib import Path

import distributed

from jaxscan.project import Order, do_step, row_to_json


TOPIC = "jaxscan-progress"
_QUIET_S = 0.5
"""Between two messages of one step."""


def do_order(text: str) -> str:
    """Do the step of an order, and tell how far it is.

    Args:
        text: As `Order.to_json` has it.

    Returns:
        The row for the catalogue, as `row_to_json` has it.
    """
    order = Order.from_json(text)
    return row_to_json(do_step(order, _teller(order.step.key)))


def sees(folder: str, name: str) -> bool:
    """Whether a worker sees a file of the caller, and may write beside it."""
    path = Path(folder, name)
    try:
        probe = path.with_name(f"{name}.{time.time_ns()}")
        seen = path.is_file()
        probe.touch()
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
