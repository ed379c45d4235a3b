"""The laser's light across its sheet and along its fan, and where it meets surfaces."""

import math
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.boards import SeenBoard
from jaxscan.simulation.camera import COLOURS
from jaxscan.simulation.rig import Motion, Numbers, Sheet, TrueRig
from jaxscan.simulation.scene import Scene


_BAND = 5.5
"""Half width of a Gaussian's sampled band, in its standard deviations: beyond it is 3e-7 of the peak."""
_LENGTHS = (1.5, 8.0)
"""Shortest and longest of the waves, in widths of fine changes."""
_WAVES = 24
"""Number of waves of different lengths that make fine changes along the line."""


def band(sheet: Sheet) -> float:
    """Half width of the band that is lit, in standard deviations of the sheet in the fan's middle."""
    lobes = sheet.spec.lobes_at if any(sheet.spec.side_lobes) else 0.0
    return (_BAND + lobes) * (1 + sheet.spec.widening)


def widened(sheet: Sheet, angle: np.ndarray) -> np.ndarray | np.float32:
    """Factor on the sheet's thickness at an angle in the fan [rad]."""
    if sheet.spec.widening == 0:
        return np.float32(1)
    half = np.float32(math.radians(sheet.spec.fan_deg) / 2)
    return 1 + np.float32(sheet.spec.widening) * np.square(angle / half)


def across(sheet: Sheet, s: np.ndarray) -> np.ndarray:
    """Light at `s` standard deviations beside the sheet; 1 in its middle."""
    f = np.float32
    light = np.exp(f(-0.5) * s * s)
    for share, at in zip(sheet.spec.side_lobes, (-sheet.spec.lobes_at, sheet.spec.lobes_at), strict=True):
        if share > 0:
            light += f(share) * np.exp(f(-0.5) * np.square(s - f(at)))
    return light


def along(sheet: Sheet, angle: np.ndarray) -> np.ndarray:
    """Relative power of the fan at an angle in it [rad]: flat, with soft ends, and as uneven as the laser is."""
    f, spec = np.float32, sheet.spec
    half = f(math.radians(spec.fan_deg) / 2)
    power = np.clip((half - np.abs(angle)) / f(math.radians(2.0)), 0, 1)
    if spec.uneven_slow > 0:
        power = power * (1 + f(spec.uneven_slow) * np.cos(f(5.3) * angle / half + f(0.7)))
    if spec.uneven_fine > 0:
        wave = _ripple(angle / angle.dtype.type(math.radians(spec.fine_deg)))
        power = power * np.maximum(1 + f(spec.uneven_fine) * wave, 0)
    return power


def _ripple(x: np.ndarray) -> np.ndarray:
    """Smooth noise of variance 1 and of about unit width: waves of different lengths, the same every time."""
    rng = np.random.default_rng(7)
    lengths, phases = rng.uniform(*_LENGTHS, _WAVES), rng.uniform(0, 2 * np.pi, _WAVES)
    total = np.zeros_like(x)
    for length, phase in zip(lengths, phases, strict=True):
        total += np.sin(x * x.dtype.type(2 * np.pi / length) + x.dtype.type(phase))
    return total * x.dtype.type(math.sqrt(2 / _WAVES))


def lobe(to_light: np.ndarray, to_eye: np.ndarray, normal: np.ndarray, width: float) -> np.ndarray:
    """Strength of a lobe, 1 in its middle.

    Args:
        to_light: From points to the light [..., 3], of any length.
        to_eye: To the camera.
        normal: Unit normals towards the camera.
        width: Standard deviation of the angle between normal and bisector [rad].
    """
    half = _unit(to_light) + _unit(to_eye)
    cosine = np.clip(np.sum(_unit(half) * normal, -1), -1, 1)
    above = np.sum(to_light * normal, -1) > 0
    return np.where(above, np.exp(-0.5 * np.square(np.arccos(cosine) / width)), 0).astype(np.float32)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


# The laser's light on the surfaces that rays hit.
#
# At a point p at distance r from the laser, with s its distance from the sheet,
#
#     E = P fan(phi) cos(i) albedo / (r sqrt(2 pi) w(r)) exp(-s^2 / (2 w(r)^2))
#
# falls off with 1/r (the fan spreads in one direction only) and with the sheet's thickness w(r).
# It is evaluated on a grid finer than pixels in the band round the sheet, each sample by its own
# ray, so depth edges, shadows and printed edges cut the stripe at their true places.


class LitScene(NamedTuple):
    """A scene at one angle of the table, lit by one laser."""

    rig: TrueRig
    sheet: Sheet
    """The laser that is lit."""
    scene: Scene
    pose: Motion
    """T_scanner_cam."""
    board: SeenBoard | None
    """A board in front of the scene."""


class Met(NamedTuple):
    """First intersections of n rays."""

    depth: np.ndarray
    """inf where nothing is."""
    triangle: np.ndarray
    on_board: np.ndarray
    place: np.ndarray
    """Board coordinates, as in `Hits`."""


class Hits(NamedTuple):
    """First surface on each of n rays, camera frame."""

    depth: np.ndarray
    points: np.ndarray
    normal: np.ndarray
    """Towards the camera."""
    triangle: np.ndarray
    on_board: np.ndarray
    place: np.ndarray
    """Board coordinates [2, n], m; without meaning beside the board."""


def stacked(x: np.ndarray, y: np.ndarray, z: Numbers) -> np.ndarray:
    """Rays [3, ...] from their coordinates; z may be the number 1 of a pinhole."""
    return np.stack([x, y, np.broadcast_to(np.asarray(z, x.dtype), x.shape)])


def laser_channel(sheet: Sheet) -> np.ndarray:
    """Weights [3, 1] of R, G, B for surfaces in the laser's light."""
    return np.eye(3, dtype=np.float32)[:, [COLOURS.index(sheet.spec.colour)]]


def illuminate(shot: LitScene, rays: np.ndarray) -> np.ndarray:
    """Light of the laser seen along rays [3, n], float32 [n], DN on a pixel filled with it."""
    met = _meet(shot, rays)
    depth = np.where(np.isfinite(met.depth), met.depth, np.float32(0))
    beside = depth * shot.sheet.slope_at(*rays).astype(np.float32) - np.float32(shot.sheet.distance)
    light = np.zeros(len(beside), np.float32)
    # Most rays meet something far beside the sheet.
    near = np.flatnonzero((np.abs(beside) < _widest_band(shot.sheet, rays, depth)) & (depth > 0))
    some = Met(met.depth[near], met.triangle[near], met.on_board[near], met.place[:, near])
    light[near] = light_at(shot, _hits(shot, rays[:, near], some), beside[near])
    return light


def _widest_band(sheet: Sheet, rays: np.ndarray, depth: np.ndarray) -> np.float32:
    """Half the width that the lit band has at the most at some depths along rays [3, n], m."""
    reach = np.sqrt(np.einsum("in,in->n", rays, rays)) * depth
    far = float(reach.max(initial=0)) + float(np.linalg.norm(sheet.origin))
    thickest = float(sheet.thickness(np.array([0.0, far])).max())
    return np.float32(1.01 * band(sheet) * (1 + sheet.spec.widening) * thickest)


def light_at(shot: LitScene, hits: Hits, beside: np.ndarray) -> np.ndarray:
    """Light of the laser on n points that lie `beside` its sheet [m], float32 [n]."""
    light = np.zeros(len(beside), np.float32)
    lit = in_band(shot.sheet, hits, beside)
    lit = lit[~_shaded(shot, hits.points[lit], hits.on_board[lit])]
    light[lit] = landing(shot.sheet, hits, beside, lit) * albedo_at(shot, hits, lit)
    return light


def in_band(sheet: Sheet, hits: Hits, beside: np.ndarray) -> np.ndarray:
    """Which points the sheet reaches if nothing shades them, indices."""
    legs = hits.points - sheet.origin.astype(np.float32)
    angle = sheet.angle(legs)
    thickness = _thickness(sheet, legs, angle)
    facing = np.einsum("ij,ij->i", legs, hits.normal) < 0
    near = np.abs(beside) < np.float32(band(sheet)) * thickness
    return np.flatnonzero(near & facing & (along(sheet, angle) > 0) & np.isfinite(hits.depth))


def landing(sheet: Sheet, hits: Hits, beside: np.ndarray, lit: np.ndarray) -> np.ndarray:
    """Light that lands on the `lit` points, as a white surface gives it back, float32 [lit]."""
    f = np.float32
    legs = hits.points[lit] - sheet.origin.astype(f)
    r = np.sqrt(np.einsum("ij,ij->i", legs, legs))
    angle = sheet.angle(legs)
    thickness = _thickness(sheet, legs, angle)
    cosine = -np.einsum("ij,ij->i", legs, hits.normal[lit]) / r
    s = beside[lit] / thickness
    energy = f(sheet.power / math.sqrt(2 * math.pi)) / (r * thickness)
    return energy * cosine * along(sheet, angle) * across(sheet, s)


def _thickness(sheet: Sheet, legs: np.ndarray, angle: np.ndarray) -> np.ndarray:
    r = np.sqrt(np.einsum("ij,ij->i", legs, legs))
    return sheet.thickness(r).astype(np.float32) * widened(sheet, angle)


def cast(shot: LitScene, rays: np.ndarray) -> Hits:
    """First surface on each of the camera's rays [3, n]."""
    return _hits(shot, rays, _meet(shot, rays))


def _meet(shot: LitScene, rays: np.ndarray) -> Met:
    """First intersections of rays [3, n], as `cast` returns them."""
    board = shot.board
    depth, triangle = shot.scene.cast(shot.pose.translation, shot.pose.turn(np.ascontiguousarray(rays.T)))
    if board is None:
        return Met(depth, triangle, np.zeros(len(depth), bool), np.zeros((2, len(depth))))
    nearer, bx, by = board.hit(*rays)
    on_board = nearer < depth
    return Met(np.where(on_board, nearer, depth), triangle, on_board, np.stack([bx, by]))


def _hits(shot: LitScene, rays: np.ndarray, met: Met) -> Hits:
    """The points that rays [3, n] meet, and their normals."""
    directions = np.ascontiguousarray(rays.T)
    depth, triangle, on_board, place = met
    normal = shot.pose.inverse().turn(shot.scene.normal.take(triangle, 0))
    if shot.board is not None:
        normal = np.where(on_board[:, None], shot.board.normal().astype(np.float32), normal)
    safe = np.where(np.isfinite(depth), depth, 0).astype(directions.dtype)
    points = directions * safe[:, None]
    away = np.einsum("ij,ij->i", normal, points) > 0
    return Hits(safe, points, np.where(away[:, None], -normal, normal), triangle, on_board, place)


def _shaded(shot: LitScene, points: np.ndarray, on_board: np.ndarray) -> np.ndarray:
    """Whether something stands between the laser and each of the points [n, 3]."""
    origin = shot.sheet.origin
    shaded = shot.scene.blocked(shot.pose.apply(origin), shot.pose.apply(points))
    if shot.board is not None:
        shaded |= ~on_board & shot.board.blocks(origin, points)
    return shaded


def albedo_at(shot: LitScene, hits: Hits, lit: np.ndarray) -> np.ndarray:
    """Albedo of the `lit` points for the laser's light, float32 [lit]."""
    (albedo,), _ = shot.scene.look(hits.triangle[lit], shot.pose.apply(hits.points[lit]), laser_channel(shot.sheet))
    if shot.board is not None:
        on_board = hits.on_board[lit]
        albedo[on_board] = shot.board.albedo(*hits.place[:, lit[on_board]])
        picture, points = shot.board.picture, hits.points[lit[on_board]]
        if picture.gloss > 0:
            origin = shot.sheet.origin.astype(np.float32)
            normal = hits.normal[lit[on_board]]
            albedo[on_board] += np.float32(picture.gloss) * lobe(origin - points, -points, normal, picture.gloss_rad)
    return albedo
