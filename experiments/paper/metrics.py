"""Figures of an experiment: names, units, directions, limits, and tolerances against the baseline."""

import json
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np


Direction = Literal["less", "more", "near", "none"]
"""Better are smaller ("less") or larger ("more") values; "near": no change is wanted; "none": it only describes."""
BASELINE = Path(__file__).with_name("baseline")
"""Folder of the committed baseline: a file for each world, and for each quick one."""


class Metric(NamedTuple):
    """One figure."""

    key: str
    """Short name with underscores, unique in its experiment."""
    value: float
    unit: str
    direction: Direction = "none"
    tolerance: float = 0.0
    """How much worse than the baseline it may be, in its unit."""
    paper: float | None = None
    """The paper's figure."""
    low: float | None = None
    high: float | None = None
    """Limits: at least `low`, at most `high`."""
    label: str = ""
    """Its line in the table of results: the method, then the quantity."""

    def met(self) -> bool:
        """Whether it is finite and within its limits, if it has any."""
        if not np.isfinite(self.value):
            return False
        return (self.low is None or self.value >= self.low) and (self.high is None or self.value <= self.high)

    def wanted(self) -> str:
        """Its limits in words."""
        if self.low is not None and self.high is not None:
            return f"{self.low:g} ... {self.high:g}"
        return f"≤ {self.high:g}" if self.high is not None else f"≥ {self.low:g}" if self.low is not None else ""

    def worse_than(self, baseline: float, tolerance: float) -> bool:
        """Whether it is worse than the baseline by more than the baseline's tolerance."""
        if self.direction == "none":
            return False
        change = self.value - baseline
        if not np.isfinite(change):
            return True
        worse = {"less": change, "more": -change, "near": abs(change)}[self.direction]
        return bool(worse > tolerance)


def shown(value: float) -> str:
    """A value for people: four digits, or two decimals of 1000 and more, so that a room keeps its tenths of a mm."""
    return f"{value:.4g}" if abs(value) < 1000 else f"{value:.2f}"


def rms(values: np.ndarray) -> float:
    """Root mean square of all values, in their unit; NaN if there is none."""
    values = np.asarray(values)
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else np.nan


def line(metric: Metric) -> str:
    """A figure as it is printed."""
    words = {"less": "less is better", "more": "more is better", "near": "no change wanted", "none": ""}
    notes = [words[metric.direction], f"within {metric.tolerance:.2g}" if metric.tolerance else ""]
    notes += [f"paper {metric.paper:g}" if metric.paper is not None else "", metric.wanted()]
    notes += ["" if metric.met() else "MISSED"]
    return f"{metric.key:>44} {shown(metric.value):>12} {metric.unit:<10} " + ", ".join(note for note in notes if note)


def load_baseline(part: str) -> dict[str, tuple[float, float]]:
    """Committed values and tolerances by "experiment.key", of one `part`: a world, or "quick kind"."""
    path = _baseline_path(part)
    return (
        {key: (value, tolerance) for key, (value, tolerance) in json.loads(path.read_text()).items()}
        if path.exists()
        else {}
    )


def save_baseline(part: str, experiment: str, metrics: list[Metric]) -> None:
    """Replace the figures of one experiment; others stay. A figure of which less is better may at most double."""
    kept = {key: value for key, value in load_baseline(part).items() if not key.startswith(f"{experiment}.")}
    for one in metrics:
        tolerance = min(one.tolerance, abs(one.value)) if one.direction == "less" else one.tolerance
        kept[f"{experiment}.{one.key}"] = one.value, tolerance
    BASELINE.mkdir(exist_ok=True)
    lines = [f"{json.dumps(key)}: {json.dumps(value)}" for key, value in sorted(kept.items())]
    _baseline_path(part).write_text("{\n" + ",\n".join(lines) + "\n}\n")


def _baseline_path(part: str) -> Path:
    return BASELINE / f"{part.replace(' ', '_')}.json"
