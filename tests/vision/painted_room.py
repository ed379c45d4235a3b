"""A box room with painted walls, seen by a turning camera: ray casting with formulas of its own."""

from typing import NamedTuple

import cv2
import numpy as np


SIDE_M, PIXELS = 6.0, 1500
"""Every wall has a picture of this size, in the middle of which the room's origin lies."""
LOW, HIGH = np.array([-1.9, -1.1, -2.4]), np.array([2.3, 1.4, 2.1])
"""Corners of the room in the camera's frame at angle 0 [m]."""


class Rig(NamedTuple):
    """A camera with one radial coefficient on a turntable."""

    width: int = 200
    height: int = 160
    focal: float = 150.0
    centre: tuple[float, float] = (101.3, 78.6)
    k1: float = -0.05
    direction: tuple[float, float, float] = (0.012, -0.99985, 0.008)
    point: tuple[float, float, float] = (0.12, 0.0, -0.06)


def motion(rig: Rig, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and place of the camera, by Rodrigues' formula."""
    a = np.array(rig.direction) / np.linalg.norm(rig.direction)
    cross = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    turn = np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    p = np.array(rig.point)
    return turn, p - turn @ p


def pixel(rig: Rig, p: np.ndarray, angle: float) -> np.ndarray:
    """Pixels of points [n, 3] of the frame at angle 0."""
    turn, place = motion(rig, angle)
    seen = (p - place) @ turn
    xy = seen[:, :2] / seen[:, 2:]
    return rig.focal * xy * (1 + rig.k1 * (xy**2).sum(1, keepdims=True)) + np.array(rig.centre)


def paint(rng: np.random.Generator, contrast: float = 18.0) -> list[np.ndarray]:
    """Pictures of the six walls: clouds of three sizes."""
    walls = []
    for _ in range(6):
        clouds = np.zeros((PIXELS, PIXELS), np.float32)
        for size_m in (0.015, 0.05, 0.2):
            # The larger the clouds, the coarser their noise: blurs of 4 px.
            cells = round(4.0 / size_m * SIDE_M)
            noise = cv2.GaussianBlur(rng.standard_normal((cells, cells), np.float32), (0, 0), 4.0)
            part = cv2.resize(noise, (PIXELS, PIXELS), interpolation=cv2.INTER_CUBIC)
            clouds += part / part.std()
        walls.append(110 + contrast * clouds)
    return walls


def hang(wall: np.ndarray, picture: np.ndarray, centre_m: tuple[float, float], side_m: float) -> None:
    """Put a square picture on a wall, its middle at `centre_m` of the wall's two axes."""
    side = round(side_m / SIDE_M * PIXELS)
    u, v = (round((c / SIDE_M + 0.5) * PIXELS) - side // 2 for c in centre_m)
    wall[v : v + side, u : u + side] = cv2.resize(picture, (side, side), interpolation=cv2.INTER_AREA)


def render(rig: Rig, walls: list[np.ndarray], angle: float, rng: np.random.Generator, noise: float = 1.5) -> np.ndarray:
    """The image at an angle, uint8: two by two rays in a pixel, a lens with a blur of 0.7 px."""
    v, u = (np.mgrid[: 2 * rig.height, : 2 * rig.width] + 0.5) / 2 - 0.5
    x0, y0 = ((u - rig.centre[0]) / rig.focal).ravel(), ((v - rig.centre[1]) / rig.focal).ravel()
    x, y = x0, y0
    for _ in range(8):
        scale = 1 + rig.k1 * (x * x + y * y)
        x, y = x0 / scale, y0 / scale
    turn, place = motion(rig, angle)
    way = np.stack([x, y, np.ones_like(x)], -1) @ turn.T
    far = np.where(way > 0, HIGH - place, LOW - place) / np.where(way == 0, 1e-12, way)
    axis = far.argmin(1)
    p = place + far.min(1)[:, None] * way
    level = np.zeros(len(p), np.float32)
    for number, wall in enumerate(walls):
        mine = (axis == number // 2) & ((way[np.arange(len(p)), axis] > 0) == number % 2)
        others = [k for k in range(3) if k != number // 2]
        at = np.pad((p[mine][:, others] / SIDE_M + 0.5) * PIXELS - 0.5, ((0, -mine.sum() % 200), (0, 0)))
        grid = at.astype(np.float32).reshape(-1, 200, 2)
        if mine.any():
            level[mine] = cv2.remap(wall, grid, None, cv2.INTER_LINEAR).ravel()[: mine.sum()]
    fine = cv2.GaussianBlur(level.reshape(u.shape), (0, 0), 1.4)
    image = fine.reshape(rig.height, 2, rig.width, 2).mean((1, 3))
    return np.clip(np.rint(image + noise * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)
