"""A box room seen by rays from within, in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest


def box_room(
    size=(6.15, 3.82, 2.6),
    *,
    at=(0.4, -0.3, 1.2),
    grid=(720, 240),
    yaw=0.3,
    tilt=0.02,
    noise=1e-3,
    seed=0,
    elevation=35.0,
    furniture=(),
):
    """A cloud of a room with the floor at z = 0 and its middle at x = y = 0, scanned from `at`.

    The scanner frame is turned by `yaw` about z and tipped by `tilt` [rad]; noise along the ray
    grows as range squared from `noise` [m] at 2.5 m; furniture is boxes (low, high) in the room.
    """
    rng = np.random.default_rng(seed)
    angle = np.linspace(-np.pi, np.pi, grid[0], endpoint=False)
    a, e = np.meshgrid(angle, np.radians(np.linspace(-elevation, elevation, grid[1])), indexing="ij")
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    tip = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    inside = rays @ (turn @ tip)
    inside = np.where(inside == 0, 1e-15, inside)
    low = np.array([-size[0] / 2, -size[1] / 2, 0.0]) - at
    far = np.where(inside > 0, (low + size) / inside, low / inside).min(-1)
    for box in furniture:
        ends = [(np.array(corner) - at) / inside for corner in box]
        enter, leave = np.minimum(*ends).max(-1), np.maximum(*ends).min(-1)
        far = np.where((enter < leave) & (enter > 0) & (enter < far), enter, far)
    sigma = noise * (far / 2.5) ** 2
    far = far + sigma * rng.normal(size=far.shape)
    return SimpleNamespace(
        xyz=(rays * far[..., None]).astype(np.float32),
        sigma_random=sigma.astype(np.float32),
        valid=np.ones(far.shape, bool),
        laser=np.zeros(grid[0], np.int32),
        angle=angle,
    )


FURNITURE = (
    ((-1.5, 1.87, 0.0), (2.5, 1.91, 2.2)),  # a shelf 4 cm deep along two thirds of one wall
    ((-3.075, -0.5, 0.0), (-2.6, 1.2, 1.8)),  # a cupboard
    ((-3.075, -1.91, 0.0), (3.075, -1.895, 0.12)),  # skirting
    ((1.0, -1.91, 0.8), (2.2, -1.89, 1.8)),  # a picture 2 cm deep
    ((3.035, -1.0, 0.0), (3.075, 0.6, 2.1)),  # a door 4 cm in front of its wall
    ((-1.0, -0.4, 0.0), (0.2, -1.4, 0.75)),  # a table: covers nothing beyond the floor
)


@pytest.fixture(scope="session", name="box_room")
def _box_room():
    return box_room


@pytest.fixture(scope="session")
def furnished():
    return box_room(furniture=FURNITURE)
