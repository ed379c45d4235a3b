"""A room with furniture, scanned by rays in closed form, and how far a place is from its surfaces."""

import dataclasses

import numpy as np
import pytest

from jaxscan.reconstruction import PointCloud, grid_normals


ROOM = ((-2.5, -2.0, -1.2), (2.5, 2.0, 1.4))
BOXES = (
    ((1.2, -1.5, -1.2), (1.9, -0.7, -0.4)),  # a chest
    ((-2.5, 0.5, -1.2), (-2.1, 1.6, 0.9)),  # a shelf
    ((-0.4, 1.3, -1.2), (0.6, 1.7, -0.45)),  # a table
    ((-1.5, -1.6, -1.2), (-1.42, -1.52, 0.2)),  # a post
)
SIGMA = 3e-4


def cast(eyes, rays):
    """Distance along unit rays to the room, from inside of it."""
    low, high = np.array(ROOM)
    with np.errstate(divide="ignore"):
        depth = np.where(rays > 0, (high - eyes) / rays, (low - eyes) / rays).min(-1)
        for corners in BOXES:
            low, high = np.array(corners)
            one, other = (low - eyes) / rays, (high - eyes) / rays
            near, far = np.minimum(one, other).max(-1), np.maximum(one, other).min(-1)
            depth = np.where((near < far) & (near > 0), np.minimum(depth, near), depth)
    return depth


def surface_distance(places):
    """Distance of places to the nearest surface [m]."""
    return np.min([_to_box(places, corners) for corners in (ROOM, *BOXES)], 0)


def _to_box(places, corners):
    low, high = np.array(corners)
    beyond = np.maximum(np.maximum(low - places, places - high), 0)
    inside = np.minimum(places - low, high - places).min(-1)
    return np.where(inside > 0, inside, np.linalg.norm(beyond, axis=-1))


def parts(places):
    """Body of each place (0 is the room, then the boxes), and its side: low x, y and z, then high x, y and z."""
    bodies = np.array([ROOM, *BOXES])
    body = np.argmin([_to_box(places, corners) for corners in bodies], 0)
    ends = bodies[body].reshape(len(places), 6)
    return body, np.abs(np.concatenate([places, places], 1) - ends).argmin(1)


def scan(profiles, lines, *, turn=2 * np.pi, laser=0, first=0.0, cast=cast):
    """A cloud of the room, and where the camera was at each profile."""
    step = turn / profiles
    angle = first + step * np.arange(profiles)
    down = np.radians(np.linspace(38, -38, lines))
    eyes = 0.2 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    a, e = np.meshgrid(angle + 0.3, down, indexing="ij")
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1)
    noise = SIGMA * np.random.default_rng(laser).standard_normal(a.shape)
    xyz = (eyes[:, None] + (cast(eyes[:, None], rays) + noise)[..., None] * rays).astype(np.float32)
    sigmas, valid = np.full(a.shape, SIGMA, np.float32), np.ones(a.shape, np.bool_)
    normals = grid_normals(
        xyz, sigmas, valid, eyes.astype(np.float32), line_step=float(down[0] - down[1]), profile_step=float(step)
    )
    cloud = PointCloud(
        xyz=xyz,
        rgb=np.clip(128 + 100 * normals, 0, 255).astype(np.uint8),
        intensity=100 + 0 * sigmas,
        normals=normals,
        sigma_random=sigmas,
        sigma_systematic=sigmas,
        valid=valid,
        record=np.arange(profiles, dtype=np.int32),
        laser=np.full(profiles, laser, np.int32),
        angle=angle,
    )
    return cloud, eyes


def stacked(*clouds):
    """Profiles of several clouds, one after the other."""
    names = [field.name for field in dataclasses.fields(PointCloud) if getattr(clouds[0], field.name) is not None]
    return PointCloud(**{name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in names})


@pytest.fixture(scope="session")
def room():
    """Cloud and places of the camera: steps of 1 degree, lines of 0.5 degrees."""
    return scan(360, 152)
