"""Table angles and image columns at which the stripe meets the targets: only these are scanned."""

from typing import NamedTuple

import numpy as np

from experiments.paper.beyond.targets import Hall
from jaxscan import Scanner


_NEAR_M = 1.9
"""Spheres nearer than this are a part of their own: there the stripe lies in other columns."""


class Part(NamedTuple):
    """A part of the scan."""

    angles: np.ndarray
    """Of the table [rad]."""
    first: int
    """First column that is read out [px]."""
    stop: int


def aim(hall: Hall, scanner: Scanner, step_deg: float, plate_every: int | None) -> list[Part]:
    """Parts of a scan that together see every target: near spheres, other spheres, plates.

    All parts read equally many columns.

    Args:
        hall: The targets where they nominally are.
        scanner: The calibration.
        step_deg: Step of the table where spheres are.
        plate_every: Where plates are, only every so many steps are taken; None: all is one part in equal steps.

    Returns:
        The parts, angles ascending. Their columns hold the stripe on the targets, with a margin.
    """
    balls = [(np.array(ball.centre), ball.diameter / 2) for ball in hall.balls.values()]
    spheres = np.array([_on_sphere(*ball) for ball in balls])
    near = np.array([np.linalg.norm(centre) < _NEAR_M for centre, _ in balls])
    plates = np.concatenate([_on_plate(plate.centre, plate.edges) for plate in hall.plates])
    clouds = [(spheres[near].reshape(-1, 3), 1), (spheres[~near].reshape(-1, 3), 1), (plates, plate_every or 1)]
    if plate_every is None:
        clouds = [(np.concatenate([points for points, _ in clouds]), 1)]
    angles = np.deg2rad(np.arange(0.0, 360.0, step_deg))
    poses = np.asarray(scanner.pose(angles))
    met = [_met(scanner, points, angles[::every], poses[::every]) for points, every in clouds]
    width = max(int(np.ceil(high - low)) for _, low, high in met)
    width = min(-(-width // 32) * 32, scanner.camera.width)
    parts = []
    for angles, low, high in met:
        first = int(np.clip((low + high - width) / 2, 0, scanner.camera.width - width))
        parts.append(Part(angles, first, first + width))
    return parts


def _met(
    scanner: Scanner, points: np.ndarray, angles: np.ndarray, poses: np.ndarray
) -> tuple[np.ndarray, float, float]:
    """Angles [rad] at which the sheet meets points [n, 3], and the columns between which it then lies [px]."""
    local = np.einsum("kji,kni->knj", np.swapaxes(poses[:, :3, :3], 1, 2), points - poses[:, None, :3, 3])
    sheet, camera = scanner.laser(0), scanner.camera
    beside = local @ np.asarray(sheet.normal) - float(sheet.distance)
    # Between two steps the sheet moves by this much.
    reach = 0.6 * (angles[1] - angles[0]) * np.linalg.norm(points, axis=1)
    lit = (np.abs(beside) < np.maximum(reach, 0.004)) & (local[..., 2] > 0.3)
    # The margin is for the lens's distortion and the sheet's bow.
    u, margin = camera.fx * local[lit][:, 0] / local[lit][:, 2] + camera.cx, 0.012 * camera.fx
    return angles[lit.any(1)], float(u.min() - margin), float(u.max() + margin)


def _on_sphere(centre: np.ndarray, radius: float) -> np.ndarray:
    """Points all over a sphere [n, 3]."""
    count = 600
    height = 1 - 2 * (np.arange(count) + 0.5) / count
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - height**2)
    return centre + radius * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], -1)


def _on_plate(centre: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Points all over a plate [n, 3]."""
    a, b = np.meshgrid(np.linspace(-0.5, 0.5, 25), np.linspace(-0.5, 0.5, 50))
    return centre + np.stack([a.ravel(), b.ravel()], -1) @ edges
