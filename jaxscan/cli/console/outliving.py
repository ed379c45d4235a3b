"""Threads of the console outlive any error: it is said on the page and in the log, and they go on."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from jaxscan.cli.console.slate import Slate


_LONGEST = 300


@contextmanager
def outlived(slate: Slate, what: str) -> Iterator[None]:
    """Whatever goes wrong within `with` is said, once as long as it stays the same.

    Args:
        slate: Where people read it.
        what: What did not succeed, as they name it.
    """
    try:
        yield
    except Exception as problem:
        said = f"{what}: did not succeed: {' '.join(str(problem).split())[:_LONGEST] or type(problem).__name__}"
        logging.getLogger(f"jaxscan.console.{what}").warning("%s", said)
        slate.say_once(said, "problem")
