"""The limits, and the seeds of the final measure: both were written down before any of these seeds was judged."""

from typing import Any, NamedTuple

import numpy as np


FINAL_SEEDS = tuple(range(101, 111))
"""Seeds of both worlds that were used for nothing while building; 1 to 20 were."""


class Limit(NamedTuple):
    """A figure and the bounds it has to keep in every seed."""

    name: str
    path: tuple[str, ...]
    low: float = -np.inf
    high: float = np.inf
    classes: bool = False
    """Whether `path` leads to classes, each of which has the figure `last`."""
    last: str = ""


LIMITS = (
    Limit("points on boards: error / stated", ("boards", "classes"), 0.9, 1.15, True, "error_over_stated"),
    Limit("laser plane at 2.5 m [px]", ("rig", "sheet_px"), high=0.03),
    Limit("sweep: RMS / row-wise bound", ("smooth", "over_bound"), high=0.6),
    Limit("step: width / row-wise width", ("step", "ratio"), high=1.2),
    Limit("rows found", ("smooth", "found_share"), low=0.99),
    Limit("sweep: stated / true", ("smooth", "classes"), 0.9, 1.1, True, "stated_over_true"),
    Limit("farther than 5 sigmas", ("smooth", "far_share"), high=0.001),
)
"""In every seed. Walls have a limit over all seeds: 95 % within two stated sigmas."""
WALLS_WITHIN_TWO = 0.95

RIVALS = (
    ("rays [px]", ("rig", "rays_px"), 1),
    ("axis direction [deg]", ("rig", "axis_deg"), 1),
    ("axis point [mm]", ("rig", "axis_mm"), 1),
    ("laser plane at 2.5 m [px]", ("rig", "sheet_px"), 1),
    ("points on boards, RMS [px]", ("boards", "rms_px"), 1),
    ("sweep, RMS of errors under 2 px [px]", ("smooth", "rms_near_px"), 1),
    ("rows found", ("smooth", "found_share"), -1),
    ("walls, RMS [mm]", ("walls", "rms_mm"), 1),
)
"""Figures in which jaxscan may be worse than the plain pipeline in no seed; -1 where more is better."""


def figure(measured: dict[str, Any], path: tuple[str, ...]) -> Any:
    """A figure by its path, NaN where it was not measured; the ratio of the step's widths is computed."""
    if path == ("step", "ratio"):
        return measured["step"]["smooth"] / measured["step"]["rows"]
    found: Any = measured
    for key in path:
        if key not in found:
            return float("nan")
        found = found[key]
    return found


def values(measured: dict[str, Any], limit: Limit) -> dict[str, float]:
    """The values that a limit is about, by class; one, named "", where it has none. Unknown ones are left out."""
    found = figure(measured, limit.path)
    each = {name: one[limit.last] for name, one in found.items()} if limit.classes else {"": found}
    return {name: value for name, value in each.items() if np.isfinite(value)}


def broken(measured: dict[str, Any], limit: Limit) -> list[str]:
    """The values outside of a limit's bounds, as text."""
    found = values(measured, limit)
    out = {name: value for name, value in found.items() if not limit.low <= value <= limit.high}
    return [f"{name + ': ' if name else ''}{value:.4g}" for name, value in out.items()]


def worse(measured: dict[str, Any], plain: dict[str, Any]) -> list[str]:
    """Figures in which jaxscan is worse than the plain pipeline, or has none where that has one."""
    found = []
    for name, path, sign in RIVALS:
        own, other = figure(measured, path), figure(plain, path)
        if np.isfinite(other) and not sign * own <= sign * other:
            found.append(f"{name} {own:.4g} against {other:.4g}")
    return found
