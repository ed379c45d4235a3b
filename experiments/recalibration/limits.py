"""Limits of recalibration, the final seeds and the numbers of trials: written down before any of them was run."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from experiments.report import limits_in_words, rms, within


FINAL_SEEDS = tuple(range(201, 231))
"""Used for nothing while building; 1 to 20 were."""
TRIALS = {
    "paper-like": 30,
    "good": 30,
    "paper-like, features": 30,
    "good, features": 30,
    "paper-like, rough walls": 30,
    "good, rough walls": 30,
    "unkind, paper-like": 30,
    "unkind, good": 30,
    "paper-like, stops": 10,
    "good, stops": 10,
    "laser turned": 10,
    "axis shifted": 10,
    "laser turned since a recalibration": 10,
    "axis shifted since a recalibration": 10,
    "nothing moved since a recalibration": 30,
    "3200 steps for 6400": 5,
    "6400 steps for 3200": 5,
    "a step of 1.8 degrees lost": 5,
    "a step of 0.2 degrees lost": 5,
    "overlap of 30 degrees": 10,
    "a turn known to be closed": 10,
    "a curved wall": 10,
    "a stepped wall": 10,
    "rendered unkind": 30,
    "two stations": 10,
}
"""Of each kind, the first of the final seeds."""

Trials = Sequence[dict[str, Any]]


class Limit(NamedTuple):
    """A figure of all trials of a kind, and its bound."""

    kind: str
    name: str
    figure: Callable[[Trials], float]
    low: float | None = None
    high: float | None = None
    unit: str = ""

    def met(self, trials: Trials) -> bool:
        """Whether the figure is within its bounds."""
        return within(self.figure(trials), self.low, self.high)

    def bounds(self) -> str:
        """The bounds in words."""
        return limits_in_words(self.low, self.high, self.unit) or "none"


def half_turns(trials: Trials, column: str) -> np.ndarray:
    """A column of the lengths across half a turn [trials, lengths]."""
    return np.array([[one[column] for one in trial["lengths"] if one["name"] == "half a turn"] for trial in trials])


def every(trials: Trials, column: str) -> np.ndarray:
    """A column of all lengths [trials, lengths]."""
    return np.array([[one[column] for one in trial["lengths"]] for trial in trials])


def spread(which: int, column: str = "after") -> Callable[[Trials], float]:
    """Root mean square error of a length across half a turn [mm]."""
    return lambda trials: rms(half_turns(trials, column)[:, which])


def better(trials: Trials) -> float:
    """Root mean square error of lengths across half a turn, old over new; the smallest ratio of them."""
    before, after = half_turns(trials, "before"), half_turns(trials, "after")
    return min(rms(before[:, k]) / rms(after[:, k]) for k in range(before.shape[1]))


def honest(which: int, when: str = "after") -> Callable[[Trials], float]:
    """Root mean square of error over stated sigma, of a length across half a turn before or after recalibrating."""
    return lambda trials: rms(half_turns(trials, when)[:, which] / half_turns(trials, f"sigma_{when}")[:, which])


def away(trials: Trials) -> float:
    """The most by which a length of any kind moved away from the truth, in stated sigmas."""
    before, after = (np.abs(every(trials, column)) for column in ("before", "after"))
    return float(np.max((after - before) / every(trials, "sigma_after")))


def quiet(trials: Trials) -> float:
    """Trials whose test for drift says p > 0.01, of 30."""
    return 30 * float(np.mean([trial["drift"]["p"] > 0.01 for trial in trials]))


def largest_p(trials: Trials) -> float:
    """The largest chance that nothing moved."""
    return max(trial["drift"]["p"] for trial in trials)


def named(part: str) -> Callable[[Trials], float]:
    """Share of trials in which the part that moved is named."""
    return lambda trials: float(np.mean([trial["drift"]["part"].startswith(part) for trial in trials]))


def removed(*names: str) -> Callable[[Trials], float]:
    """Root mean square of error over stated sigma, of the parameters of the part that moved."""

    def figure(trials: Trials) -> float:
        parts = [
            trial["parameters"][name][2:] for trial in trials for name in trial["parameters"] if name.endswith(names)
        ]
        return rms([error / sigma for error, sigma in parts])

    return figure


def open_mm(trials: Trials) -> float:
    """The largest gap after a full turn at 2.5 m, by the truth [mm]."""
    return float(max(abs(trial["closure_mm"][1]) for trial in trials))


def apart(trials: Trials, column: str = "after") -> float:
    """Root mean square error of the distances of opposite walls [mm]."""
    return rms([pair[column] for trial in trials for pair in trial["walls"]["apart"]])


def walls_better(trials: Trials) -> float:
    """Old over new of `apart`."""
    return apart(trials, "before") / apart(trials)


def jumps(trials: Trials) -> float:
    """Share of trials in which the one lost step is found, within 2 records and 10 per cent of its angle, and named."""

    def good(trial: dict[str, Any]) -> bool:
        record, angle = trial["lost"]
        found = trial["table"]["jumps"]
        near = [jump for jump in found if abs(jump[1] - record) <= 2 and abs(np.rad2deg(jump[2]) / angle - 1) < 0.1]
        return len(found) == 1 and len(near) == 1 and bool(trial["table"]["sentences"])

    return float(np.mean([good(trial) for trial in trials]))


def of_stations(column: str, over_sigma: bool = False) -> Callable[[Trials], float]:
    """The largest error of the second station's pose, or of the walls that both see."""
    key = column + "_sigmas" if over_sigma else column
    return lambda trials: float(max(abs(trial["station"][key]) for trial in trials))


LIMITS = (
    Limit("paper-like", "across 180 degrees, old / new", better, low=20),
    Limit("paper-like", "std at 3.9 m", spread(0), high=1.0, unit="mm"),
    Limit("paper-like", "std at 6.3 m", spread(1), high=1.5, unit="mm"),
    Limit("paper-like", "observed / stated, 3.9 m", honest(0), 0.8, 1.2),
    Limit("paper-like", "observed / stated, 6.3 m", honest(1), 0.8, 1.2),
    Limit("paper-like", "no drift: trials of 30 with p > 0.01", quiet, low=29),
    Limit("paper-like", "walls apart, old / new", walls_better, low=1),
    Limit("good", "across 180 degrees, old / new", better, low=2),
    Limit("good", "a length moved away by", away, high=2, unit="stated sigmas"),
    Limit("good", "observed / stated, 3.9 m", honest(0), 0.8, 1.2),
    Limit("good", "observed / stated, 6.3 m", honest(1), 0.8, 1.2),
    Limit("good", "no drift: trials of 30 with p > 0.01", quiet, low=29),
    Limit("paper-like, features", "across 180 degrees, old / new", better, low=20),
    Limit("paper-like, features", "std at 3.9 m", spread(0), high=1.0, unit="mm"),
    Limit("paper-like, features", "std at 6.3 m", spread(1), high=1.5, unit="mm"),
    Limit("paper-like, features", "observed / stated, 3.9 m", honest(0), 0.8, 1.2),
    Limit("paper-like, features", "observed / stated, 6.3 m", honest(1), 0.8, 1.2),
    Limit("paper-like, features", "gap at 2.5 m by the truth", open_mm, high=0.3, unit="mm"),
    Limit("good, features", "across 180 degrees, old / new", better, low=2),
    Limit("good, features", "a length moved away by", away, high=2, unit="stated sigmas"),
    Limit("good, features", "observed / stated, 3.9 m", honest(0), 0.8, 1.2),
    Limit("paper-like, rough walls", "observed / stated, 3.9 m", honest(0), 0.8, 1.2),
    Limit("paper-like, rough walls", "observed / stated, 6.3 m", honest(1), 0.8, 1.2),
    Limit("paper-like, rough walls", "across 180 degrees, old / new", better),
    Limit("good, rough walls", "across 180 degrees, old / new", better, low=1),
    Limit("good, rough walls", "a length moved away by", away, high=2, unit="stated sigmas"),
    Limit("paper-like, stops", "observed / stated, 3.9 m", honest(0), 0.7, 1.3),
    Limit("paper-like, stops", "across 180 degrees, old / new", better, low=5),
    Limit("good, stops", "observed / stated before, 3.9 m", honest(0, "before"), 0.7, 1.3),
    Limit("good, stops", "observed / stated, 3.9 m", honest(0), 0.7, 1.3),
    Limit("good, stops", "a length moved away by", away, high=2, unit="stated sigmas"),
    Limit("laser turned", "largest p", largest_p, high=1e-3),
    Limit("laser turned", "trials in which the laser is named", named("laser"), low=1),
    Limit("laser turned", "sheet, observed / stated", removed(".n1", ".n2", ".d"), high=1.25),
    Limit("axis shifted", "largest p", largest_p),
    Limit("axis shifted since a recalibration", "largest p", largest_p, high=1e-3),
    Limit("axis shifted since a recalibration", "trials in which the axis is named", named("axis"), low=1),
    Limit("axis shifted since a recalibration", "axis, observed / stated", removed(".p1", ".p2"), high=1.25),
    Limit("laser turned since a recalibration", "largest p", largest_p, high=1e-3),
    Limit("laser turned since a recalibration", "sheet, observed / stated", removed(".n1", ".n2", ".d"), high=1.25),
    Limit("nothing moved since a recalibration", "trials of 30 with p > 0.01", quiet, low=29),
    Limit("a step of 1.8 degrees lost", "trials in which it is found and named", jumps, low=1),
    Limit("a step of 0.2 degrees lost", "trials in which it is found and named", jumps, low=1),
    Limit("overlap of 30 degrees", "gap at 2.5 m by the truth", open_mm, high=0.3, unit="mm"),
    Limit("a turn known to be closed", "gap at 2.5 m by the truth", open_mm, high=0.3, unit="mm"),
    Limit("paper-like", "gap at 2.5 m by the truth", open_mm, unit="mm"),
    Limit("unkind, paper-like", "across 180 degrees, old / new", better, low=5),
    Limit("unkind, paper-like", "observed / stated", honest(0), 0.75, 1.25),
    Limit("unkind, paper-like", "a length moved away by", away, high=1, unit="stated sigmas"),
    Limit("unkind, paper-like", "no drift: trials of 30 with p > 0.01", quiet, low=29),
    Limit("unkind, good", "a length moved away by", away, high=1, unit="stated sigmas"),
    Limit("unkind, good", "across 180 degrees, old / new", better, low=1),
    Limit("unkind, good", "observed / stated", honest(0), 0.75, 1.25),
    Limit("rendered unkind", "across 180 degrees, old / new", better, low=5),
    Limit("rendered unkind", "observed / stated", honest(0), 0.75, 1.25),
    Limit("rendered unkind", "a length moved away by", away, high=1, unit="stated sigmas"),
    Limit("a curved wall", "a length moved away by", away, high=2, unit="stated sigmas"),
    Limit("a stepped wall", "a length moved away by", away, high=2, unit="stated sigmas"),
    Limit("two stations", "relative place", of_stations("place_mm"), high=1.0, unit="mm"),
    Limit("two stations", "relative place", of_stations("place_mm", True), high=2, unit="stated sigmas"),
    Limit("two stations", "relative turn", of_stations("turn_mrad"), high=0.3, unit="mrad"),
    Limit("two stations", "relative turn", of_stations("turn_mrad", True), high=2, unit="stated sigmas"),
    Limit("two stations", "walls seen by both", of_stations("walls_mm"), high=0.5, unit="mm"),
)
