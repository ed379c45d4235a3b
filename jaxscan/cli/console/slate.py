"""What all pages show: written by the threads that know it, and read by that of the server."""

import json
import logging
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np


MOST_LINES = 200
MOST_POINTS = 300_000
"""Points of a growing cloud that are kept for pages."""
_LONGEST = 300


class Picture(NamedTuple):
    """A picture, and a version that changes with it."""

    version: int
    jpeg: bytes


class Slate:
    """Fields that can be written as JSON, a picture, and a growing cloud; any thread may call."""

    def __init__(self, **fields: Any) -> None:
        self._lock = threading.Lock()
        self._fields = fields
        self._lines: deque[dict[str, Any]] = deque(maxlen=MOST_LINES)
        self._version = 1
        self._picture = Picture(0, b"")
        self._chunks: list[bytes] = []
        self._cloud, self._stride = 0, 1

    def write(self, **fields: Any) -> None:
        """Change fields."""
        with self._lock:
            if any(self._fields.get(name) != value for name, value in fields.items()):
                self._fields.update(fields)
                self._version += 1

    def say(self, sentence: str, kind: str = "note", *, once: bool = False) -> None:
        """Add a sentence on an event: a "note", a "retake" or a "problem"; if once, not while it is listed already."""
        with self._lock:
            if once and any(line["says"] == sentence for line in self._lines):
                return
            self._lines.append({"at": time.time(), "kind": kind, "says": sentence})
            self._version += 1

    def read(self, name: str) -> Any:
        """One field."""
        with self._lock:
            return self._fields.get(name)

    def state(self, since: int) -> tuple[int, dict[str, Any] | None]:
        """The version, and all fields if it is not `since`."""
        with self._lock:
            if self._version == since:
                return since, None
            return self._version, {**self._fields, "lines": list(self._lines)}

    def show(self, jpeg: bytes) -> None:
        """Change the picture."""
        with self._lock:
            self._picture = Picture(self._picture.version + 1, jpeg)

    def picture(self) -> Picture:
        """The present picture."""
        with self._lock:
            return self._picture

    def clear_cloud(self, expected: int) -> None:
        """Begin a cloud of about this many points; if they are more than can be shown, every n-th is kept."""
        with self._lock:
            self._chunks, self._cloud = [], self._cloud + 1
            self._stride = max(1, -(-expected // MOST_POINTS))

    def grow(self, xyz: np.ndarray, rgb: np.ndarray) -> None:
        """Add points [n, 3] in metres with their colours [n, 3]."""
        with self._lock:
            self._chunks.append(pack_points(xyz[:: self._stride], rgb[:: self._stride]))

    def cloud(self, number: int, known: int) -> tuple[int, list[bytes]]:
        """The number of the present cloud, and its chunks that a page with `known` chunks of `number` lacks."""
        with self._lock:
            return self._cloud, self._chunks[known if number == self._cloud else 0 :]


def pack_points(xyz: np.ndarray, rgb: np.ndarray) -> bytes:
    """Points for a page: all coordinates as little-endian float32, then all colours as bytes."""
    return np.ascontiguousarray(xyz, "<f4").tobytes() + np.ascontiguousarray(rgb, np.uint8).tobytes()


def as_json(message: dict[str, Any]) -> str:
    """A message for a page."""
    return json.dumps(message, allow_nan=False)


def one_line(problem: BaseException) -> str:
    """The sentence of an exception in one line."""
    return " ".join(str(problem).split())


@contextmanager
def outlived(slate: Slate, what: str) -> Iterator[None]:
    """Let a thread outlive any error within `with`: it is logged, and shown on the page once.

    Args:
        slate: Where people read it.
        what: What did not succeed, as they name it.
    """
    try:
        yield
    except Exception as problem:
        said = f"{what}: did not succeed: {one_line(problem)[:_LONGEST] or type(problem).__name__}"
        logging.getLogger(f"jaxscan.console.{what}").warning("%s", said)
        slate.say(said, "problem", once=True)
