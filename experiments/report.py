"""What all experiments share at their ends: the options, figures with limits, tables, and files of figures."""

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np


class Figure(NamedTuple):
    """A number and its limits, if any."""

    key: str
    value: float
    unit: str
    low: float | None = None
    high: float | None = None

    def met(self) -> bool:
        """Whether it is finite and within its limits."""
        above = self.low is None or self.value >= self.low
        return bool(np.isfinite(self.value) and above and (self.high is None or self.value <= self.high))

    def target(self) -> str:
        """Its limits in words."""
        if self.low is None:
            return "" if self.high is None else f"<= {self.high:g}"
        return f">= {self.low:g}" if self.high is None else f"{self.low:g} ... {self.high:g}"


def command_line(description: str | None, *, quick: str = "", json: bool = False) -> argparse.ArgumentParser:
    """A parser that shows the whole docstring; `quick` is the help of --quick, if there is one."""
    made = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if quick:
        made.add_argument("--quick", action="store_true", help=quick)
    if json:
        made.add_argument("--json", metavar="FILE", help="write the figures to a file (- for standard output)")
    return made


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


def conclude(name: str, figures: list[Figure], json_file: str | None) -> int:
    """Print all figures beside their limits; 1 if one is missed, else 0."""
    width = max(len(figure.key) for figure in figures)
    out = sys.stderr if json_file == "-" else sys.stdout
    for figure in figures:
        verdict = "" if not figure.target() else ("met" if figure.met() else "MISSED")
        print(f"{figure.key:<{width}} {figure.value:10.4g} {figure.unit:<8} {figure.target():<18} {verdict}", file=out)
    missed = [figure.key for figure in figures if not figure.met()]
    print(f"{name}: " + (f"{len(missed)} missed: {', '.join(missed)}" if missed else "all targets met"), file=out)
    rows = [figure._asdict() | {"met": figure.met()} for figure in figures]
    write_json(json_file, {"format": f"jaxscan-{name}/1", "figures": rows})
    return 1 if missed else 0
