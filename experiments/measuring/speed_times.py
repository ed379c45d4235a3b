"""Shared by the speed experiments: times taken in turn, memory without mapped files, figures with limits."""

import os
import platform
import statistics
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from typing import NamedTuple


class Times(NamedTuple):
    """Times of several runs of one function [s]."""

    best: float
    median: float
    processor: float
    """Least time of all cores together; unlike wall time, it hardly depends on the load of the machine."""


class Figure(NamedTuple):
    """A number and its limit."""

    key: str
    value: float
    unit: str
    direction: str
    """Which way is better: "lower", "higher" or "none"."""
    tolerance: float
    """Relative change that is not significant."""
    asked: float | None = None
    """Limit on the side that `direction` says."""

    def met(self) -> bool | None:
        """Whether it keeps its limit, where there is one."""
        if self.asked is None:
            return None
        return self.value <= self.asked if self.direction == "lower" else self.value >= self.asked


class Contestant(NamedTuple):
    """A pipeline beside others."""

    name: str
    gives: str
    """Its results, in words."""
    times: Times
    """Of one pair [s]."""
    points: float | None = None
    """Share of the lines that got a point."""
    right: float | None = None
    """Share of the lines with a stripe whose centre is within 1 px of it."""


def take_turns(functions: dict[str, Callable[[], object]], repeats: int) -> dict[str, Times]:
    """Times of all functions, taken in turn, after one run each to compile and to touch the memory."""
    runs: dict[str, list[tuple[float, float]]] = {name: [] for name in functions}
    for repeat in range(repeats + 1):
        for name, function in functions.items():
            start, used = time.perf_counter(), time.process_time()
            function()
            if repeat > 0:
                runs[name].append((time.perf_counter() - start, time.process_time() - used))
    return {name: summary(*zip(*found, strict=True)) for name, found in runs.items()}


def summary(walls: tuple[float, ...], processor: tuple[float, ...] = (0.0,)) -> Times:
    """Best and median of some runs."""
    return Times(min(walls), statistics.median(walls), min(processor))


class Watch:
    """Largest anonymous memory of this process while open; pages of mapped files do not count."""

    def __init__(self) -> None:
        self.peak = anonymous_bytes()
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *problem: object) -> None:
        self._done.set()
        self._thread.join()

    def _look(self) -> None:
        while not self._done.wait(0.005):
            self.peak = max(self.peak, anonymous_bytes())


def anonymous_bytes() -> int:
    """Resident memory of this process that belongs to no file [bytes]."""
    with open("/proc/self/status") as status:
        fields = dict(line.split(":", 1) for line in status)
    return 1024 * sum(int(fields[name].split()[0]) for name in ("RssAnon", "RssShmem"))


def machine() -> dict[str, str]:
    """Date, processor, versions and load of this run."""
    with open("/proc/cpuinfo") as info:
        names = [line.split(":", 1)[1].strip() for line in info if line.startswith("model name")]
    packages = ("jax", "numpy", "opencv-python-headless")
    versions = [f"Python {platform.python_version()}", *(f"{name} {version(name)}" for name in packages)]
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "processor": f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores",
        "versions": ", ".join(versions),
        "load": load(),
    }


def load() -> str:
    """Load average of the last minute."""
    return f"{os.getloadavg()[0]:.2f}"
