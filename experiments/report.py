"""What all experiments share: options, figures with limits, tables, files of figures, and verbs run as a user does."""

import argparse
import json
import multiprocessing
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np


ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "experiments" / "results"

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class Figure(NamedTuple):
    """A number and its limits, if any."""

    key: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None

    def met(self) -> bool:
        """Whether it is finite and within its limits."""
        return within(self.value, self.low, self.high)

    def target(self) -> str:
        """Its limits in words."""
        return limits_in_words(self.low, self.high)


def within(value: float, low: float | None, high: float | None) -> bool:
    """Whether a value is finite and within limits, if there are any."""
    return bool(np.isfinite(value) and (low is None or value >= low) and (high is None or value <= high))


def limits_in_words(low: float | None, high: float | None, unit: str = "") -> str:
    """Limits as a table shows them; "" where there are none."""
    after = f" {unit}" if unit else ""
    if low is None:
        return "" if high is None else f"≤ {high:g}{after}"
    return f"≥ {low:g}{after}" if high is None else f"{low:g} ... {high:g}{after}"


def command_line(description: str | None, *, quick: str = "", json: bool = False) -> argparse.ArgumentParser:
    """A parser that shows the whole docstring; `quick` is the help of --quick, if there is one."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if quick:
        made.add_argument("--quick", action="store_true", help=quick)
    if json:
        made.add_argument("--json", metavar="FILE", help="write the figures to a file (- for standard output)")
    return made


def in_processes(function: Callable[[_Item], _Result], items: Iterable[_Item], jobs: int = 1) -> list[_Result]:
    """A function of every item, in their order, by so many new processes; by this one where `jobs` is 1.

    Args:
        function: Of a module, so that another process finds it.
    """
    if jobs <= 1:
        return [function(item) for item in items]
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        return list(pool.map(function, items))


def progress(text: str) -> None:
    """A line for people who wait."""
    print(text, file=sys.stderr, flush=True)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], rule: str = "---") -> str:
    """A Markdown table; `rule` stands below every title."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, [rule] * len(head), *rows))


def number(value: Any, form: str = "{:.3f}") -> str:
    """A value as a table shows it: a dash where it is not known."""
    return "–" if value is None or not np.isfinite(value) else form.format(value)


def write_json(path: str | Path | None, document: Any) -> None:
    """Write figures to a file, to standard output (-), or nowhere (None)."""
    if path is None:
        return
    text = json.dumps(document, indent=1) + "\n"
    sys.stdout.write(text) if str(path) == "-" else Path(path).write_text(text)


def rms(values: Any) -> float:
    """Root mean square of all values, in their unit; NaN if there is none."""
    values = np.asarray(values)
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")


def figure_table(figures: Iterable[Figure]) -> str:
    """A Markdown table of figures beside their limits; a missed one is bold."""
    rows = []
    for figure in figures:
        value = f"{figure.value:.4g}"
        rows.append([figure.key, value if figure.met() else f"**{value}**", figure.unit, figure.target()])
    return table(["figure", "value", "unit", "limit"], rows)


def conclude(name: str, figures: list[Figure], json_file: str | Path | None, **about: Any) -> int:
    """Print all figures beside their limits, and write them; 1 if one is missed, else 0."""
    width = max(len(figure.key) for figure in figures)
    out = sys.stderr if str(json_file) == "-" else sys.stdout
    for figure in figures:
        verdict = "" if not figure.target() else ("met" if figure.met() else "MISSED")
        print(f"{figure.key:<{width}} {figure.value:10.4g} {figure.unit:<8} {figure.target():<18} {verdict}", file=out)
    missed = [figure.key for figure in figures if not figure.met()]
    print(f"{name}: " + (f"{len(missed)} missed: {', '.join(missed)}" if missed else "all limits met"), file=out)
    rows = [figure._asdict() | {"met": figure.met()} for figure in figures]
    write_json(json_file, {"format": f"jaxscan-{name}/1", **about, "figures": rows})
    return 1 if missed else 0


def machine() -> str:
    """Date, processor and versions of this run."""
    with open("/proc/cpuinfo") as info:
        names = [line.split(":", 1)[1].strip() for line in info if line.startswith("model name")]
    packages = ", ".join(f"{name} {version(name)}" for name in ("jax", "numpy", "opencv-python-headless"))
    processor = f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores"
    return f"{datetime.now(UTC):%Y-%m-%d}, {processor}, Python {platform.python_version()}, {packages}"


class Ran(NamedTuple):
    """A verb of `jaxscan` that has ended."""

    code: int
    out: str
    problem: str
    """Its standard error."""
    wall_s: float
    processor_s: float
    """Processor time of the process and of those that it waited for."""

    def notes(self) -> list[str]:
        """Its notes."""
        return [line for line in self.out.splitlines() if line.startswith("note: ")]

    def last_words(self) -> str:
        """The last line of its standard error."""
        return (self.problem.strip().splitlines() or [""])[-1]


def verb(*words: str | Path, cores: set[int] | None = None, **environment: str) -> Ran:
    """Run a verb as a user does, in a process of its own.

    Args:
        cores: Cores that it may use; None: all.
    """
    command = [sys.executable, "-m", "jaxscan", *map(str, words)]
    bind = None if cores is None else lambda: os.sched_setaffinity(0, cores)
    start, before = time.perf_counter(), os.times()
    done = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | {"COLUMNS": "200"} | environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        preexec_fn=bind,
    )
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return Ran(done.returncode, done.stdout, done.stderr, time.perf_counter() - start, used)
