"""Light by way of other surfaces: mirrors on walls, and the glow that the stripe throws."""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.lit import (
    Hits,
    LitScene,
    albedo_at,
    along,
    band,
    cast,
    in_band,
    landing,
    laser_channel,
    light_at,
)


class Mirrored(NamedTuple):
    """The points that some of n rays see in a mirror."""

    at: np.ndarray
    """Which rays meet a mirror, indices [m]."""
    share: np.ndarray
    """Share of the light that the mirror reflects [m]."""
    hits: Hits
    """The surfaces behind, camera frame [m]."""
    beside: np.ndarray
    """How far they lie beside the sheet [m]; far where there is nothing."""


class Glass(NamedTuple):
    """A mirror's plane, camera frame."""

    place: np.ndarray
    normal: np.ndarray

    def turned(self, vectors: np.ndarray) -> np.ndarray:
        """Directions [n, 3] in the mirror."""
        return (vectors - 2 * (vectors @ self.normal)[:, None] * self.normal).astype(vectors.dtype)

    def picture(self, points: np.ndarray) -> np.ndarray:
        """Points [n, 3] in the mirror."""
        shift = 2 * (self.place @ self.normal) * self.normal
        return (self.turned(points) + shift).astype(points.dtype)


_FAR = 1e3
_WAYS = 256
"""Directions in the fan that are tried for a mirror."""


def look(shot: LitScene, rays: np.ndarray) -> Mirrored:
    """The points that the camera's rays [3, n] see in mirrors."""
    first, pose = cast(shot, rays), shot.pose
    glass = shot.scene.mirror[first.triangle] * ~first.on_board
    at = np.flatnonzero(glass)
    far, triangle, points = shot.scene.reflect(pose.translation, pose.apply(first.points[at]), first.triangle[at])
    back = pose.inverse()
    points, normal = back.apply(points), back.turn(shot.scene.normal[triangle])
    away = np.sum(normal * (points - first.points[at]), -1) > 0
    normal = np.where(away[:, None], -normal, normal)
    there = np.isfinite(far)
    beside = np.where(there, shot.sheet.slope_at(*points.T) - shot.sheet.distance, _FAR).astype(np.float32)
    hits = Hits(np.where(there, far, 0), points, normal, triangle, np.zeros(len(at), bool), np.zeros((2, len(at))))
    return Mirrored(at, glass[at], hits, beside)


def mirrored_light(shot: LitScene, rays: np.ndarray) -> np.ndarray:
    """Light of the laser that rays [3, n] see in mirrors, float32 [n], DN on a pixel filled with it."""
    light = np.zeros(rays.shape[1], np.float32)
    seen = look(shot, rays)
    light[seen.at] = seen.share * light_at(shot, seen.hits, seen.beside)
    return light


def mirrored_sheet(shot: LitScene, glass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the sheet, and half width of its lit band, at the points that pixels see in mirrors.

    Args:
        glass: Pixels that see a mirror, bool [height, width].

    Returns:
        float32 [height, width], m; far where there is no mirror.
    """
    place = np.flatnonzero(glass)
    seen = look(shot, np.ascontiguousarray(shot.rig.rays.vectors[place].T))
    signed, limit = np.full(glass.size, _FAR, np.float32), np.zeros(glass.size, np.float32)
    signed[place[seen.at]] = seen.beside
    legs = np.linalg.norm(seen.hits.points - shot.sheet.origin, axis=-1)
    limit[place[seen.at]] = band(shot.sheet) * shot.sheet.thickness(legs)
    return signed.reshape(glass.shape), limit.reshape(glass.shape)


def lit_mirrors(shot: LitScene) -> list[Glass]:
    """Mirrors that the laser's sheet meets."""
    sheet, back = shot.sheet, shot.pose.inverse()
    half = np.deg2rad(sheet.spec.fan_deg) / 2
    angle = np.linspace(-half, half, _WAYS)[:, None]
    ways = np.cos(angle) * sheet.ahead + np.sin(angle) * sheet.across
    _, triangle = shot.scene.cast(shot.pose.apply(sheet.origin), shot.pose.turn(ways))
    met = shot.scene.normal[np.unique(triangle[shot.scene.mirror[triangle] > 0])]
    planes = shot.scene.glass()
    return [
        Glass(back.apply(place), back.turn(normal.astype(np.float64)))
        for place, normal in planes
        if np.any(np.abs(met @ normal) > 1 - 1e-6)
    ]


def thrown_light(shot: LitScene, glass: Glass, rays: np.ndarray) -> np.ndarray:
    """Light along rays [3, n] that the laser throws by way of a mirror, float32 [n], DN on a pixel filled with it."""
    hits, pose = cast(shot, rays), shot.pose
    seen, beside = _in_mirror(shot, glass, hits)
    light = np.zeros(rays.shape[1], np.float32)
    lit = in_band(shot.sheet, seen, beside)
    # Back along the light: the first thing on the way has to be the mirror, and it must see the laser.
    points, origin = hits.points[lit], shot.sheet.origin
    ways = glass.picture(origin[None].astype(points.dtype)) - points
    start = pose.apply(points + np.float32(1e-3) * hits.normal[lit])
    far, triangle = shot.scene.cast(start, pose.turn(ways))
    share = shot.scene.mirror[triangle] * (far < 1)
    met = start + np.where(np.isfinite(far), far, 0)[:, None] * pose.turn(ways)
    share = share * ~shot.scene.blocked(pose.apply(origin), met, skin=5e-3)
    light[lit] = share * landing(shot.sheet, seen, beside, lit) * albedo_at(shot, hits, lit)
    return light


def thrown_sheet(shot: LitScene, glass: Glass, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Like `mirrored_sheet`, but for the light that the laser throws by way of a mirror.

    Args:
        depth: Depth along the ray of every pixel's centre, float32 [height, width]; inf where nothing is.
    """
    reached = np.where(np.isfinite(depth), depth, np.float32(0)).reshape(-1, 1)
    points = glass.picture(shot.rig.rays.vectors * reached)
    beside = shot.sheet.slope_at(*points.T) - shot.sheet.distance
    thickness = shot.sheet.thickness(np.linalg.norm(points - shot.sheet.origin, axis=-1))
    beside = np.where(np.isfinite(depth).ravel(), beside, _FAR)
    return beside.reshape(depth.shape).astype(np.float32), band(shot.sheet) * thickness.reshape(depth.shape)


def _in_mirror(shot: LitScene, glass: Glass, hits: Hits) -> tuple[Hits, np.ndarray]:
    """Surfaces as the laser would see them through the mirror, and how far they lie beside its sheet [m]."""
    points, sheet = glass.picture(hits.points), shot.sheet
    seen = hits._replace(points=points, normal=glass.turned(hits.normal))
    return seen, (sheet.slope_at(*points.T) - sheet.distance).astype(np.float32)


# The laser's light that comes back: its line lights the other walls, floor and furniture, once and diffusely.
#
# The line is cut into pieces by angle in the fan. A piece of the angle dphi receives the power P fan(phi) dphi,
# whatever its distance and slant, and gives the share of its albedo back, by the cosine. The vector irradiance of
# all pieces that a point sees is smooth; so it is found on a coarse grid of pixels and interpolated, and every
# pixel takes its part along its own normal.

PIECES = 48
GRID = 8
"""Pixels from one point of the grid to the next."""
_LENGTH = 0.03
"""A piece has a size: nearer than about this [m] its light does not grow any more."""
_FAINT = 1e-3
"""Light of one piece [DN] below which shadows are not tested; all such pieces together give about 0.01 DN."""
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
    """Normal of the surface, towards the laser."""
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


def returned_field(shot: LitScene, pieces: Pieces, points: Callable[..., np.ndarray]) -> np.ndarray:
    """Vector irradiance of the pieces on every pixel, on a coarse grid and interpolated.

    Args:
        points: Gives the points that pixels see, float32 [..., 3], scanner frame, by their rows and columns.

    Returns:
        float32 [3, height, width]: its part along a normal is the light of a white surface, DN.
    """
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
    # Divided by the distance once for the cosine, and once for the direction.
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
