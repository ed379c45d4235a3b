"""The truth of a world, in a file beside its captures, which the judge alone reads; and the result of a method.

Stripes are kept on grids [records, rows, crossings]: where the middle of the sheet meets a surface, brightest first."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.report import command_line


PART_PX, PART_DN = 6.0, 0.5
"""Distance from all crossings, and peak, from which light is a part of a stripe whose middle is hidden."""


class TrueStripes(NamedTuple):
    """True stripes of all records of a capture, [records, rows, crossings]."""

    u: np.ndarray
    """Centre [px], float64; only where `amplitude` is over 0."""
    amplitude: np.ndarray
    """Peak of the laser's direct light behind the lens, before pixels integrate it [DN]."""
    width: np.ndarray
    """Standard deviation of its profile, before pixels integrate it [px]."""
    background: np.ndarray
    """Light beside it above the black level [DN]."""
    edge: np.ndarray
    """Whether a jump, a crease, a shadow's border or the image's border is within a few pixels."""
    surface: np.ndarray
    """Number of the surface; -1 where there is none, or where light falls but the middle of the sheet is hidden."""
    contrast: np.ndarray
    """(max - min) / (max + min) of the print within 4 px, behind the lens, on boards; NaN beside them."""


class Truth(NamedTuple):
    """A world."""

    size: np.ndarray
    """Width and height [px]."""
    lens: np.ndarray
    """fx, fy, cx, cy [px], k1, k2, p1, p2 [1]."""
    normal: np.ndarray
    distance: np.ndarray
    bow: np.ndarray
    """The sheet at angle 0 in the camera's frame, as `jaxscan` writes it; `bow` is b2, b3."""
    direction: np.ndarray
    point: np.ndarray
    """The axis in the camera's frame at angle 0."""
    angles: np.ndarray
    """The table's own angles of the sweep [rad]."""
    turned: np.ndarray
    """The angles that it truly turned by [rad]."""
    dimensions: np.ndarray
    """Distances of the opposite walls [n]; m."""
    wall_normals: np.ndarray
    """Normals of the walls into the room, camera frame at angle 0 [2 n, 3], in pairs."""
    wall_distances: np.ndarray
    """normal . p of their points [2 n]; m."""
    wall_surfaces: np.ndarray
    """Their numbers among the surfaces; -1 where there are none."""
    panels: np.ndarray
    """Numbers (in front, behind) of surfaces [n, 2] between which a level step of 50 mm lies."""
    noise: np.ndarray
    """Electrons per DN, read noise [DN], black level [DN], speckle on one pixel [1]."""


def save(path: Path, truth: Truth, sweep: TrueStripes, boards: TrueStripes) -> None:
    """Write a world's truth."""
    parts = {"": truth, "sweep_": sweep, "boards_": boards}
    np.savez_compressed(path, **{prefix + k: v for prefix, part in parts.items() for k, v in part._asdict().items()})


def load(path: Path) -> tuple[Truth, TrueStripes, TrueStripes]:
    """Read a world's truth, of the sweep, and of the boards."""
    with np.load(path) as file:
        kinds = ((Truth, ""), (TrueStripes, "sweep_"), (TrueStripes, "boards_"))
        return tuple(kind(*(file[prefix + name] for name in kind._fields)) for kind, prefix in kinds)  # type: ignore[return-value]


def with_parts(stripes: TrueStripes, light: np.ndarray) -> TrueStripes:
    """The stripes [rows, crossings] of a record, and the rest of the laser's light as edges.

    Where the middle of the sheet is hidden behind an edge, a part of the stripe still shows.

    Args:
        light: The laser's direct light behind the lens on every pixel [rows, columns]; DN.
    """
    column = np.arange(light.shape[1])
    apart = np.where(stripes.amplitude[..., None] > 0, np.abs(stripes.u[..., None] - column), np.inf).min(1)
    rest = np.where(apart > PART_PX, light, 0.0)
    at, rows = rest.argmax(1), np.arange(len(light))
    some = np.flatnonzero(rest[rows, at] > PART_DN)
    stripes.u[some, -1], stripes.amplitude[some, -1] = at[some], rest[some, at[some]]
    stripes.width[some, -1], stripes.edge[some, -1], stripes.surface[some, -1] = 1.0, True, -1
    return stripes


def empty(records: int, rows: int, crossings: int = 3) -> TrueStripes:
    """Stripes without any crossing."""
    shape = (records, rows, crossings)
    zero = [np.zeros(shape) for _ in range(4)]
    return TrueStripes(*zero, np.zeros(shape, bool), np.full(shape, -1), np.full(shape, np.nan))


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
    observed: Rows
    """The same before the solve: all points of the observation, with its own sigmas."""
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
    """Times of calibration and sweep [s]; if others use the machine, those of the processor are the reliable ones."""
    (calibrate, calibrate_cpu), (sweep, sweep_cpu) = (
        tuple(b - a for a, b in zip(*pair, strict=True)) for pair in ((start, middle), (middle, end))
    )
    return {"calibrate": calibrate, "calibrate_cpu": calibrate_cpu, "sweep": sweep, "sweep_cpu": sweep_cpu}


def ray_grid(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u and v [rows, columns] of 13 x 17 pixels over the image."""
    u, v = np.meshgrid(np.linspace(0, size[0] - 1, 17), np.linspace(0, size[1] - 1, 13))
    return u, v


def render_seed(render: Callable[[int, Path], None], description: str | None) -> None:
    """Write the world of a seed, and say how long it took."""
    parser = command_line(description)
    parser.add_argument("seed", type=int)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    start = time.perf_counter()
    render(options.seed, options.folder)
    print(f"seed {options.seed}: {time.perf_counter() - start:.0f} s")
