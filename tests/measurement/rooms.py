"""Rooms of any shape seen by rays from within, in closed form."""

from types import SimpleNamespace

import numpy as np


L_SHAPE = ((0.0, 0.0), (6.0, 0.0), (6.0, 2.5), (3.5, 2.5), (3.5, 5.0), (0.0, 5.0))
"""Corners of a room [m], anticlockwise."""
HEIGHT = 2.6
AT = np.array([1.7, 1.4, 1.3])
DOOR = (1, 0.8, 1.7, 0.0, 2.05, 0.15)
"""Wall, left and right along it, bottom and top above the floor, how deep it is behind the wall [m]."""
WINDOW = (5, 1.2, 2.6, 0.9, 2.1, 0.2)
CUPBOARD = ((4.2, 0.0, 0.0), (5.4, 0.5, 1.8))


def seen_room(
    corners=L_SHAPE, *, at=AT, grid=(360, 120), noise=1e-3, seed=0, yaw=0.4, elevation=55.0, niches=(), boxes=()
):
    """A cloud of a room on its floor z = 0, with niches in its walls and boxes in it, from `at`.

    Its frame is turned by `yaw` about z; the noise along the ray is even.
    """
    angle = np.linspace(-np.pi, np.pi, grid[0], endpoint=False)
    a, e = np.meshgrid(angle, np.radians(np.linspace(-elevation, elevation, grid[1])), indexing="ij")
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    way = rays @ turn.T
    far = reach_of(corners, at, way, niches=niches, boxes=boxes)
    sigma = np.full(far.shape, max(noise, 1e-6))
    far = far + noise * np.random.default_rng(seed).normal(size=far.shape)
    return SimpleNamespace(
        xyz=(rays * far[..., None]).astype(np.float32),
        sigma_random=sigma.astype(np.float32),
        rgb=np.full((*far.shape, 3), 128, np.uint8),
        valid=np.ones(far.shape, bool),
        laser=np.zeros(grid[0], np.int32),
        angle=angle,
    )


def reach_of(corners, at, way, *, niches=(), boxes=()):
    """How far rays [..., 3] from places [3] or [..., 3] within a room go, in units of their length [...]."""
    way = np.where(np.abs(way) < 1e-12, 1e-12, way)
    far = np.where(way[..., 2] > 0, (HEIGHT - at[..., 2]) / way[..., 2], -at[..., 2] / way[..., 2])
    points = np.array(corners)
    for wall, (start, end) in enumerate(zip(points, np.roll(points, -1, 0), strict=True)):
        length = np.linalg.norm(end - start)
        along = (end - start) / length
        out = np.array([along[1], -along[0]])
        slope = way[..., :2] @ out
        # A niche is where the ray meets the wall within it; its own sides are not seen.
        reach = ((start - at[..., :2]) @ out) / np.where(slope > 0, slope, np.nan)
        met = at + reach[..., None] * way
        s, z = (met[..., :2] - start) @ along, met[..., 2]
        here = (reach > 0) & (s >= 0) & (s <= length)
        for number, left, right, bottom, top, deep in niches:
            within = here & (number == wall) & (s > left) & (s < right) & (z > bottom) & (z < top)
            reach = np.where(within, reach + deep / np.where(slope > 0, slope, 1.0), reach)
        far = np.where(here & (reach < far), reach, far)
    for box in boxes:
        ends = [(np.array(corner) - at) / way for corner in box]
        enter, leave = np.minimum(*ends).max(-1), np.maximum(*ends).min(-1)
        far = np.where((enter < leave) & (enter > 0) & (enter < far), enter, far)
    return far
