"""The laser's light that comes back: its line lights the other walls, floor and furniture, once and diffusely.

The line is cut into pieces by angle in the fan. A piece of the angle dphi receives the power P fan(phi) dphi,
whatever its distance and slant, and gives the share of its albedo back, by the cosine. The vector irradiance of
all pieces that a point sees is smooth; so it is found on a coarse grid of pixels and interpolated, and every
pixel takes its part along its own normal.
"""

import math
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.fan import along
from jaxscan.simulation.light.lit import LitScene, laser_channel


PIECES = 48
GRID = 8
"""Pixels from one point of the grid to the next."""
_LENGTH = 0.03
"""A piece is no point: nearer than about this [m] its light does not grow any more."""
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
    (albedo,), _ = scene.look(triangle, (origin + far[:, None] * directions).astype(np.float32), laser_channel(shot))
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
    height, width = points.shape[:2]
    rows, columns = (np.linspace(0, size - 1, max(2, size // GRID + 1)) for size in (height, width))
    places = points[np.rint(rows).astype(int)[:, None], np.rint(columns).astype(int)].reshape(-1, 3)
    legs = pieces.points - places[:, None]
    distance2 = np.sum(np.square(legs), -1)
    distance = np.sqrt(distance2)
    cosine = np.maximum(-np.sum(legs * pieces.normal, -1), 0) / np.maximum(distance, 1e-6)
    strength = pieces.power * cosine / (np.float32(np.pi) * (distance2 + np.float32(_LENGTH**2)))
    # Places are looked at from the piece: hidden ones get nothing.
    dark = shot.scene.blocked(
        np.tile(pieces.points, (len(places), 1)), np.repeat(places, len(pieces.points), 0), skin=5e-3
    )
    strength[dark.reshape(strength.shape)] = 0
    field = np.sum((strength / np.maximum(distance, 1e-6))[..., None] * legs, 1)
    return _between(field.reshape(len(rows), len(columns), 3), height, width)


def _between(grid: np.ndarray, height: int, width: int) -> np.ndarray:
    """Values at all pixels from those of an even grid over the image, bilinear."""
    for axis, size in ((0, height), (1, width)):
        at = np.arange(size, dtype=np.float32) * ((grid.shape[axis] - 1) / (size - 1))
        low = np.minimum(at.astype(np.intp), grid.shape[axis] - 2)
        share = (at - low).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        grid = grid.take(low, axis) * (1 - share) + grid.take(low + 1, axis) * share
    return grid
