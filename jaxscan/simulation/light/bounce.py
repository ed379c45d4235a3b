"""The laser's light that comes back: its line lights the other walls, floor and furniture, once and diffusely.

The line is cut into pieces by angle in the fan. A piece of the angle dphi receives the power P fan(phi) dphi,
whatever its distance and slant, and gives the share of its albedo back, by the cosine. The vector irradiance of
all pieces that a point sees is smooth; so it is found on a coarse grid of pixels and interpolated, and every
pixel takes its part along its own normal.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.fan import along
from jaxscan.simulation.light.lit import LitScene, laser_channel


PIECES = 48
GRID = 8
"""Pixels from one point of the grid to the next."""
_LENGTH = 0.03
"""A piece is no point: nearer than about this [m] its light does not grow any more."""
_FAINT = 1e-3
"""Light of one piece that nothing is taken to stand in the way of [DN]; all such of a place are about 0.01 DN."""
_BATCH = 1024
"""Places evaluated at a time."""
_ROWS = 64
_SKIN = 2e-3
"""Height over a surface from which pieces shine [m]."""


class Pieces(NamedTuple):
    """Pieces of the lit line as lamps, scanner frame."""

    points: np.ndarray
    """float32 [n, 3], m."""
    normal: np.ndarray
    """Of the surface, towards the laser."""
    power: np.ndarray
    """Light that is given back, float32 [n], DN m^2."""


def line_pieces(shot: LitScene) -> Pieces:
    """Where the laser's sheet lands, in the whole fan, and the light that comes back from there."""
    sheet, scene = shot.sheet, shot.scene
    half = math.radians(sheet.spec.fan_deg) / 2
    angle = ((np.arange(PIECES) + 0.5) / PIECES * 2 - 1) * half
    ways = np.cos(angle)[:, None] * sheet.ahead + np.sin(angle)[:, None] * sheet.across
    origin, directions = shot.pose.apply(sheet.origin), shot.pose.turn(ways)
    far, triangle = scene.cast(origin, directions)
    normal = scene.normal[triangle].astype(np.float64)
    places = (origin + far[:, None] * directions).astype(np.float32)
    (albedo,), _ = scene.look(triangle, places, laser_channel(shot.sheet))
    if shot.board is not None:
        start, way = shot.board.board_from_camera.apply(sheet.origin), shot.board.board_from_camera.turn(ways)
        nearer = -start[2] / np.where(np.abs(way[:, 2]) < 1e-9, 1e-9, way[:, 2])
        place = (start[:2] + nearer[:, None] * way[:, :2]).T
        low, high = shot.board.picture.low[:, None], shot.board.picture.high[:, None]
        on = (nearer > 0) & (nearer < far) & np.all((place >= low) & (place <= high), 0)
        far, albedo = np.where(on, nearer, far), np.where(on, shot.board.albedo(*place), albedo)
        normal = np.where(on[:, None], shot.pose.turn(shot.board.normal()), normal)
    normal *= np.where(np.sum(normal * directions, -1, keepdims=True) > 0, -1, 1)
    power = sheet.power * 2 * half / PIECES * along(sheet, angle) * albedo
    hit = np.isfinite(far) & (power > 0)
    points = origin + far[hit, None] * directions[hit] + _SKIN * normal[hit]
    return Pieces(*(part.astype(np.float32) for part in (points, normal[hit], power[hit])))


def returned_light(shot: LitScene, pieces: Pieces, points: np.ndarray) -> np.ndarray:
    """Vector irradiance of the pieces on every pixel, on a coarse grid and interpolated.

    Args:
        shot: The scene and its laser.
        pieces: The lamps.
        points: Point that every pixel sees, float32 [height, width, 3], scanner frame.

    Returns:
        float32 [height, width, 3]: its part along a normal is the light of a white surface, DN.
    """
    return np.moveaxis(returned_field(shot, pieces, points.__getitem__), 0, -1)


def returned_field(shot: LitScene, pieces: Pieces, points: Callable[..., np.ndarray]) -> np.ndarray:
    """As `returned_light`, float32 [3, height, width]; `points` gives those of pixels by their rows and columns."""
    height, width = shot.rig.rays.shape
    rows, columns = (np.linspace(0, size - 1, max(2, size // GRID + 1)) for size in (height, width))
    places = points((np.rint(rows).astype(int)[:, None], np.rint(columns).astype(int))).reshape(-1, 3)
    parts = [_field(shot, pieces, places[at : at + _BATCH]) for at in range(0, len(places), _BATCH)]
    field = np.ascontiguousarray(np.concatenate(parts).T)
    return _between(field.reshape(3, len(rows), len(columns)), height, width)


def _field(shot: LitScene, pieces: Pieces, places: np.ndarray) -> np.ndarray:
    """Vector irradiance of the pieces on places [n, 3], float32 [n, 3]."""
    legs = [pieces.points[:, axis, None] - places[:, axis] for axis in range(3)]
    distance2 = legs[0] * legs[0] + legs[1] * legs[1] + legs[2] * legs[2]
    np.maximum(distance2, np.float32(1e-12), out=distance2)
    leaving = -sum(leg * pieces.normal[:, axis, None] for axis, leg in enumerate(legs))
    # By the distance once for the cosine, and once more for the direction.
    strength = np.maximum(leaving, 0)
    strength *= pieces.power[:, None]
    strength /= distance2 * (distance2 + np.float32(_LENGTH**2)) * np.float32(np.pi)
    # Places are looked at from the piece: hidden ones get nothing.
    bounce = max(shot.rig.config.light.bounce, 1e-9)
    which, at = np.nonzero(strength * np.sqrt(distance2) > np.float32(_FAINT / bounce))
    dark = shot.scene.blocked(pieces.points[which], places[at], skin=5e-3)
    strength[which[dark], at[dark]] = 0
    return np.stack([np.einsum("kn,kn->n", strength, leg) for leg in legs], -1)


def _between(grid: np.ndarray, height: int, width: int) -> np.ndarray:
    """Values [3, height, width] at all pixels from those of an even grid over the image, bilinear."""
    for axis, size in ((2, width), (1, height)):
        at = np.arange(size, dtype=np.float32) * ((grid.shape[axis] - 1) / (size - 1))
        low = np.minimum(at.astype(np.intp), grid.shape[axis] - 2)
        share = (at - low).astype(np.float32).reshape((-1, 1) if axis == 1 else (1, -1))
        rise = np.diff(grid, axis=axis)
        out = np.empty((3, height, width) if axis == 1 else (3, grid.shape[1], width), np.float32)
        for plane, values, steps in zip(out, grid, rise, strict=True):
            # Part by part, in the processor's cache.
            for start in range(0, plane.shape[0], _ROWS):
                part = np.s_[start : start + _ROWS]
                if axis == 1:
                    plane[part] = values.take(low[part], 0) + steps.take(low[part], 0) * share[part]
                else:
                    plane[part] = values[part].take(low, 1) + steps[part].take(low, 1) * share
        grid = out
    return grid
