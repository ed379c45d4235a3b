"""The result of a method for a world, in one form for jaxscan and for the plain pipeline."""

import time
from typing import NamedTuple

import numpy as np


class Rows(NamedTuple):
    """Stripe centres on a grid [records, rows]."""

    u: np.ndarray
    """Centre [px]."""
    sigma: np.ndarray
    """Stated standard deviation [px]; NaN where none is stated."""
    valid: np.ndarray


class Rig(NamedTuple):
    """A calibrated rig in the camera's frame at angle 0."""

    rays: np.ndarray
    """Unit directions [rows, columns, 3] of the pixels of `ray_grid`."""
    at_row: np.ndarray
    """Points [rows, n, 3] of the sheet that are seen at the pixels of `sheet_grid`; m."""
    direction: np.ndarray
    point: np.ndarray


class Dimension(NamedTuple):
    """A measured distance of two walls [m]."""

    value: float
    sigma: float
    true: float


class Estimate(NamedTuple):
    """All that is judged."""

    rig: Rig
    boards: Rows
    """On the board alone; sigma across the stripe, as the solve states it."""
    promised: Rows
    """The same before the solve: all that were found, with the sigma that they were found with."""
    rows: Rows
    """Of the sweep, row by row."""
    smooth: Rows
    """Of the sweep, as the points of the cloud have them."""
    dimensions: list[Dimension]
    seconds: dict[str, float]


def clocks() -> tuple[float, float]:
    """Now, by the wall's clock and by the processor's [s]."""
    return time.perf_counter(), time.process_time()


def passed(start: tuple[float, float], middle: tuple[float, float], end: tuple[float, float]) -> dict[str, float]:
    """Times of calibration and sweep [s]; the processor's say more where others use the machine too."""
    (calibrate, calibrate_cpu), (sweep, sweep_cpu) = (
        tuple(b - a for a, b in zip(*pair, strict=True)) for pair in ((start, middle), (middle, end))
    )
    return {"calibrate": calibrate, "calibrate_cpu": calibrate_cpu, "sweep": sweep, "sweep_cpu": sweep_cpu}


def ray_grid(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u and v [rows, columns] of 13 x 17 pixels over the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 17), np.linspace(0, size[1] - 1, 13))
    return u, v
