"""A mirror on a wall shows the stripe again: the laser's light by way of the mirror to the camera."""

from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.fan import band
from jaxscan.simulation.light.lit import Hits, LitScene, cast, light_at


class Mirrored(NamedTuple):
    """What some of n rays see in a mirror."""

    at: np.ndarray
    """Which rays meet a mirror, indices [m]."""
    share: np.ndarray
    """Share of the light that the mirror reflects [m]."""
    hits: Hits
    """The surfaces behind, camera frame [m]."""
    beside: np.ndarray
    """How far they lie beside the sheet [m]; far for what is not there."""


_FAR = 1e3


def look(shot: LitScene, rays: np.ndarray) -> Mirrored:
    """What the camera's rays [3, n] see in mirrors."""
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
    """Distance from the sheet, and half width of its lit band, at what pixels see in mirrors.

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
