"""The laser's sheet on the room: its direct light without noise, and the true centre of the stripe in every row.

Direct light is cast, not sampled by chance: 32 rays per pixel near the stripe, a Gaussian profile across the sheet in
closed form, and three rays to the laser's aperture for soft shadows.
"""

from typing import NamedTuple

import numpy as np

from experiments.unkind.world.rig import Rig, look
from experiments.unkind.world.sensor import FINE
from experiments.unkind.world.tracer import Hits, Light, Tracer


WAIST_M, SPREAD_RAD = 0.0008, 0.0021
"""Standard deviation of the sheet at its source, and its growth: 0.9 px wide at every distance."""
APERTURE_M = 0.0015
SIDE = 2 * FINE
"""Rays per pixel along u; `FINE` along v, each row of them shifted by a part of a sample."""
MARGIN = 8
"""Columns beside the stripe to which the lens may spread its light."""
CROSSINGS = 3
"""Crossings of sheet and surfaces that are kept of a row, the brightest first."""


class Shot(NamedTuple):
    """The rig at one angle of the table in its room."""

    rig: Rig
    tracer: Tracer
    pose: np.ndarray
    """T_room_cam [4, 4]."""

    def turned(self, way: np.ndarray) -> np.ndarray:
        """Directions of the camera's frame in that of the room."""
        return way @ self.pose[:3, :3].T.astype(way.dtype)

    def rays(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Unit directions [n, 3] of pixels, room frame."""
        way = look(self.rig.lens, u, v) @ self.pose[:3, :3].T
        return way / np.linalg.norm(way, axis=-1, keepdims=True)

    def cast(self, u: np.ndarray, v: np.ndarray) -> Hits:
        """First surfaces that pixels see."""
        return self.tracer.cast(self.pose[:3, 3], self.rays(u, v))

    def local(self, p: np.ndarray) -> np.ndarray:
        """Points in the camera's frame."""
        return (p - self.pose[:3, 3]) @ self.pose[:3, :3]

    def beside(self, p: np.ndarray) -> np.ndarray:
        """Signed distance of points of the room from the middle of the sheet [m]."""
        return self.local(p) @ self.rig.normal - self.rig.distance


def fan(rig: Rig, local: np.ndarray) -> np.ndarray:
    """Uneven power of the fan in the direction of points in the camera's frame, 0.5 to 1.3."""
    way = local - rig.source
    angle = np.arctan2(way[:, 1], way[:, 2])
    return 0.9 + 0.3 * np.sin(5.3 * angle + 0.7) + 0.1 * np.sin(17.0 * angle)


def thickness(away: np.ndarray) -> np.ndarray:
    """Standard deviation of the sheet [m] at distances from its source."""
    return np.hypot(WAIST_M, SPREAD_RAD * away)


def lit(shot: Shot, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
    """Direct irradiance [n] (power of the fan per radian is 1), and the visible part of the laser [n]."""
    local = shot.local(hits.p)
    way = shot.rig.source - local
    away = np.linalg.norm(way, axis=1)
    facing = (way / away[:, None] @ shot.pose[:3, :3].T * hits.normal).sum(1)
    width = thickness(away)
    seen = np.zeros(len(local))
    near = (hits.shape >= 0) & (facing > 0)
    upright = np.array([0.0, 1.0, 0.0])
    for step in (-1.0, 0.0, 1.0):
        source = shot.rig.source + step * APERTURE_M * np.cross(shot.rig.normal, upright)
        source = shot.pose[:3, :3] @ source + shot.pose[:3, 3]
        seen[near] += shot.tracer.sees(source, hits.p[near] + 1e-3 * hits.normal[near]) / 3
    profile = np.exp(-0.5 * (shot.beside(hits.p) / width) ** 2) / (np.sqrt(2 * np.pi) * width)
    return fan(shot.rig, local) / away * profile * np.maximum(facing, 0) * seen, seen


class Direct(NamedTuple):
    """Direct light of the laser on the sensor, before the lens."""

    fine: np.ndarray
    """Albedo times irradiance, float32 [FINE rows, FINE part of the columns]."""
    columns: slice
    """Which columns of pixels `fine` holds."""
    shadow: np.ndarray
    """Visible part of the laser on every pixel; 1 beyond the band [rows, columns]."""


def direct(shot: Shot, middle: Hits) -> Direct:
    """The direct light; `middle` has the surfaces that the pixels' middles see."""
    rows, columns = shot.rig.height, shot.rig.width
    shadow = np.ones((rows, columns))
    v, u = np.nonzero(band(shot, middle))
    if not len(u):
        return Direct(np.zeros((FINE * rows, FINE), np.float32), slice(0, 1), shadow)
    first, last = max(int(u.min()) - MARGIN, 0), min(int(u.max()) + MARGIN + 1, columns)
    fine = np.zeros((FINE * rows, FINE * (last - first)), np.float32)
    along = (np.arange(FINE) + 0.5) / FINE - 0.5
    across = (np.arange(SIDE) + 0.5) / SIDE - 0.5
    # Each of the rows of rays is shifted, so that an upright edge of ink falls between them.
    shifted = across[None, :] + (np.arange(FINE)[:, None] - (FINE - 1) / 2) / (FINE * SIDE)
    at_u = (u[:, None, None] + shifted).ravel()
    at_v = np.broadcast_to(v[:, None, None] + along[:, None], (len(v), FINE, SIDE)).ravel()
    hits = shot.cast(at_u, at_v)
    light, seen = lit(shot, hits)
    glow = (light * hits.albedo).reshape(len(u), FINE, FINE, 2).mean(3)
    target = np.arange(FINE)
    fine[(FINE * v)[:, None, None] + target[:, None], (FINE * (u - first))[:, None, None] + target[None, :]] = glow
    shadow[v, u] = seen.reshape(len(u), -1).min(1)
    return Direct(fine, slice(first, last), shadow)


def band(shot: Shot, middle: Hits) -> np.ndarray:
    """Pixels near the stripe, bool [rows, columns]."""
    rows, columns = shot.rig.height, shot.rig.width
    beside = np.where(middle.shape >= 0, shot.beside(middle.p), np.inf).reshape(rows, columns)
    reach = 4.5 * thickness(np.linalg.norm(shot.local(middle.p) - shot.rig.source, axis=1)).reshape(rows, columns)
    near = np.abs(beside) < reach
    jump = (beside[:, :-1] < 0) != (beside[:, 1:] < 0)
    near[:, :-1] |= jump
    near[:, 1:] |= jump
    grown = near.copy()
    for shift in range(1, 3):
        grown[:, shift:] |= near[:, :-shift]
        grown[:, :-shift] |= near[:, shift:]
    grown[1:] |= grown[:-1].copy()
    grown[:-1] |= grown[1:].copy()
    return grown


def light_points(shot: Shot, rng: np.random.Generator, count: int = 80) -> Light:
    """Where the sheet falls, with the flux that is sent on: equal steps of the fan's angle, jittered."""
    rig = shot.rig
    # Downwards in the sheet is y without its part along the normal; forwards is across.
    down = np.array([0.0, 1.0, 0.0]) - rig.normal * rig.normal[1]
    down /= np.linalg.norm(down)
    ahead = np.cross(down, rig.normal)
    ahead *= np.sign(ahead[2])
    half = np.radians(50.0)
    angle = (np.arange(count) + rng.random(count)) / count * 2 * half - half
    way = np.cos(angle)[:, None] * ahead + np.sin(angle)[:, None] * down
    turn = shot.pose[:3, :3]
    hits = shot.tracer.cast(turn @ rig.source + shot.pose[:3, 3], way @ turn.T)
    ok = hits.shape >= 0
    power = fan(rig, shot.local(hits.p)) * 2 * half / count
    return Light(hits.p[ok], hits.normal[ok], (power * hits.albedo)[ok])


class Crossings(NamedTuple):
    """Where the middle of the sheet meets surfaces, in any order [n]."""

    u: np.ndarray
    row: np.ndarray
    p: np.ndarray
    normal: np.ndarray
    shape: np.ndarray


def crossings(shot: Shot, middle: Hits) -> Crossings:
    """The true centres: along the middle of every row, a quarter of a pixel between rays, then linearly."""
    v, u = np.nonzero(band(shot, middle))
    at_u = (u[:, None] + (np.arange(4) / 4 - 0.375)).ravel()
    at_v = np.repeat(v, 4)
    hits = shot.cast(at_u, at_v.astype(float))
    side = np.where(hits.shape >= 0, shot.beside(hits.p), np.nan)
    pair = (np.diff(at_v) == 0) & (np.abs(np.diff(at_u) - 0.25) < 1e-6)
    change = (side[:-1] < 0) != (side[1:] < 0)
    far = np.linalg.norm(np.diff(hits.p, axis=0), axis=1)
    first = np.flatnonzero(pair & change & np.isfinite(side[:-1]) & np.isfinite(side[1:]) & (far < 0.015))
    # A jump of depth is no crossing: there the sheet meets nothing.
    share = side[first] / (side[first] - side[first + 1])
    centre = at_u[first] + 0.25 * share
    again = shot.cast(centre, at_v[first].astype(float))
    real = np.abs(shot.beside(again.p)) < 1e-4
    return Crossings(centre[real], at_v[first][real], again.p[real], again.normal[real], again.shape[real])
