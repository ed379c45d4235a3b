"""The laser's light on the surfaces that rays hit.

At a point p at distance r from the laser, with s its distance from the sheet,

    E = P fan(phi) cos(i) albedo / (r sqrt(2 pi) w(r)) exp(-s^2 / (2 w(r)^2))

falls off with 1/r (the fan spreads in one direction only) and with the sheet's thickness w(r).
It is evaluated on a grid finer than pixels in the band round the sheet, each sample by its own
ray, so depth edges, shadows and printed edges cut the stripe at their true places.
"""

import math
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.boards import SeenBoard
from jaxscan.simulation.camera import COLOURS
from jaxscan.simulation.light.fan import across, along, band, widened
from jaxscan.simulation.light.gloss import lobe
from jaxscan.simulation.rays import Numbers
from jaxscan.simulation.rig import Motion, Sheet, TrueRig
from jaxscan.simulation.scene import Scene


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
    """What each of n rays meets first."""

    depth: np.ndarray
    """inf where nothing is."""
    triangle: np.ndarray
    on_board: np.ndarray
    place: np.ndarray
    """As in `Hits`."""


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


def illuminate(shot: LitScene, rays: np.ndarray, *, only_board: bool = False) -> np.ndarray:
    """Light of the laser seen along rays [3, n], float32 [n], DN on a pixel filled with it; as for `cast`."""
    met = _meet(shot, rays, only_board)
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


def cast(shot: LitScene, rays: np.ndarray, *, only_board: bool = False) -> Hits:
    """First surface on each of the camera's rays [3, n]; with `only_board`, they meet nothing before the board."""
    return _hits(shot, rays, _meet(shot, rays, only_board))


def _meet(shot: LitScene, rays: np.ndarray, only_board: bool) -> Met:
    """What rays [3, n] meet first; as for `cast`."""
    scene, pose, board = shot.scene, shot.pose, shot.board
    if only_board:
        depth = np.full(rays.shape[1], np.inf, np.float32)
        triangle = np.full(rays.shape[1], len(scene.normal) - 1)
    else:
        depth, triangle = scene.cast(pose.translation, pose.turn(np.ascontiguousarray(rays.T)))
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
