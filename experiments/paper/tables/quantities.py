"""Numbers that calibrations of both methods have, and lengths measured with them."""

from typing import NamedTuple

import jax
import numpy as np

from experiments.paper.methods.equations import power
from experiments.paper.methods.paper_way import PaperWay, points_on_sheet
from experiments.paper.rendering.boards import PAIR_DEG
from jaxscan.calibration import Length, measure_lengths, stripe_pixels
from jaxscan.geometry import Scanner, Turntable
from jaxscan.simulation import SimulationConfig, true_scanner


WALLS_M = (3.82, 6.15)
"""Distances of opposite walls of the paper's room."""


class Quantity(NamedTuple):
    """A number of Table I, or one derived from it."""

    key: str
    title: str
    unit: str
    paper: float | None = None
    """As the paper reports it, or as it follows from its Tr."""


QUANTITIES = (
    Quantity("fx", "focal length α", "px", 2894.462),
    Quantity("fy", "focal length β", "px", 2887.338),
    Quantity("cx", "principal point u0", "px", 1016.814),
    Quantity("cy", "principal point v0", "px", 817.261),
    Quantity("k1", "radial coefficient k", "1"),
    Quantity("turn", "turn of Tr", "deg", 1.98),
    Quantity("axis_distance", "distance of the axis from the camera", "mm", 212.5),
    Quantity("axis_sideways", "tilt of the axis sideways", "deg"),
    Quantity("axis_forwards", "tilt of the axis forwards", "deg"),
    Quantity("length_3820", "a length of 3.82 m across 180°", "mm"),
    Quantity("length_6150", "a length of 6.15 m across 180°", "mm"),
)


def across_half_a_turn(config: SimulationConfig) -> list[Length]:
    """Lengths from one wall to the opposite one, in the middle of the image, at the pixels of the true rig.

    No noise of a sweep takes part, so that an error of the length is the calibration's alone.
    """
    true = true_scanner(config)
    found = []
    for wall in WALLS_M:
        depths = np.linspace(0.4, 0.6, 11) * wall
        lengths = [_half_turn(true, depth) for depth in depths]
        found.append(_half_turn(true, float(np.interp(wall, measure_lengths(true, lengths), depths))))
    return found


def of_scanner(scanner: Scanner, lengths: list[Length]) -> np.ndarray:
    """`QUANTITIES` of a calibration, in their units.

    Args:
        scanner: The calibration.
        lengths: Of `across_half_a_turn`.

    Raises:
        TypeError: If it has no turntable.
    """
    table = scanner.turntable
    if not isinstance(table, Turntable):
        raise TypeError("A calibration with a turntable is needed.")
    with jax.enable_x64(True):
        camera = dict(zip(scanner.camera.parameter_names(), np.asarray(scanner.camera.parameters()), strict=True))
        turn = np.rad2deg(float(table.angle(np.asarray(np.deg2rad(PAIR_DEG)))))
    lens = [camera[name] for name in ("fx", "fy", "cx", "cy", "k1")]
    return np.array([*lens, abs(turn), *_axis(table), *(1000 * measure_lengths(scanner, lengths))])


def of_paper_way(way: PaperWay, lengths: list[Length]) -> np.ndarray:
    """`QUANTITIES` of a calibration by the paper's method, in their units."""
    table = Turntable.from_tr(way.tr)
    # The axis points to the upper side of the image, as in all calibrations.
    table = table.pointed(np.array([0.0, -1.0, 0.0]))
    turn = np.rad2deg(np.arccos(np.clip((np.trace(way.tr[:3, :3]) - 1) / 2, -1, 1)))
    matrix = way.matrix
    lens = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], way.k]
    return np.array([*lens, turn, *_axis(table), *(1000 * _paper_length(way, length) for length in lengths)])


def true_values(config: SimulationConfig, lengths: list[Length]) -> np.ndarray:
    """`QUANTITIES` of the true rig."""
    return of_scanner(true_scanner(config), lengths)


def _half_turn(scanner: Scanner, depth: float) -> Length:
    q = stripe_pixels(scanner, 0, depth)
    return Length("half a turn", depth, 0, np.tile(q[len(q) // 2], (2, 1)), np.array([0.0, np.pi]))


def _axis(table: Turntable) -> tuple[float, float, float]:
    """Distance from the camera [mm], and tilts against the image's columns, sideways and forwards [deg]."""
    x, y, z = np.asarray(table.direction)
    return 1000 * float(np.linalg.norm(table.point)), *(float(np.rad2deg(np.arctan2(part, -y))) for part in (x, z))


def _paper_length(way: PaperWay, length: Length) -> float:
    points = points_on_sheet(way, length.q)
    motion = power(way.tr, length.angle / way.pair_angle)
    ends = np.einsum("nij,nj->ni", motion[:, :3, :3], points) + motion[:, :3, 3]
    return float(np.linalg.norm(ends[1] - ends[0]))
