"""A mirror on a wall shows the stripe again, and throws the laser's light onto other surfaces."""

from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.fan import band
from jaxscan.simulation.light.lit import Hits, LitScene, albedo_at, cast, in_band, landing, light_at


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
        shot: The scene and its laser.
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
    """As `mirrored_sheet`, for the light that the laser throws by way of a mirror.

    Args:
        shot: The scene and its laser.
        glass: The mirror.
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
