"""The laser's light on the scene, as the camera sees it through the lens.

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
from jaxscan.simulation.camera import COLOURS, Blur, psf_weights, splat
from jaxscan.simulation.light.fan import across, along, band, widened
from jaxscan.simulation.light.gloss import lobe
from jaxscan.simulation.rays import Numbers
from jaxscan.simulation.rig import Motion, Sheet, TrueRig
from jaxscan.simulation.scene import Scene


SAMPLES_ALONG = 2
"""Samples per pixel along the stripe."""


class RowTruth(NamedTuple):
    """The true stripe, one entry per line; entries that are not `valid` are zero."""

    u: np.ndarray
    """Centre of the sheet across the line [px], float64."""
    amplitude: np.ndarray
    """Peak of the stripe's light on one pixel, without noise [DN], float32."""
    xyz: np.ndarray
    """The point of the surface there [m], scanner frame, float64 [lines, 3]."""
    valid: np.ndarray


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


class LitSamples(NamedTuple):
    """The laser's light before the lens, on a grid finer than pixels, where there is any."""

    light: np.ndarray
    """DN on a pixel filled with it, float32 [pixels, counts[0] * counts[1]]."""
    rows: np.ndarray
    columns: np.ndarray
    """Row and column of each listed pixel."""
    counts: tuple[int, int]
    """Samples per pixel along v and u."""
    shape: tuple[int, int]
    """Height and width of the image."""
    blur: Blur
    """The lens's blur at each listed pixel."""


def lit_samples(shot: LitScene, depth: np.ndarray, blur: Blur) -> LitSamples:
    """The laser's light in the band round its sheet.

    Args:
        shot: The scene and its laser.
        depth: Depth along the ray of every pixel's centre, float32 [height, width]; inf where nothing is.
        blur: Of the lens, in all pixels.
    """
    rig, sheet = shot.rig, shot.sheet
    samples_v, samples_u = SAMPLES_ALONG, samples_across(rig, sheet)
    if sheet.spec.stripe_axis == "columns":
        samples_v, samples_u = samples_u, samples_v
    rows, columns = np.divmod(np.flatnonzero(_band(sheet, rig, depth)), rig.rays.shape[1])
    light: np.ndarray = np.zeros((0, samples_v * samples_u), np.float32)
    if len(rows):
        dv = ((np.arange(samples_v) + 0.5) / samples_v - 0.5).repeat(samples_u).astype(np.float32)
        du = np.tile((np.arange(samples_u) + 0.5) / samples_u - 0.5, samples_v).astype(np.float32)
        rays = stacked(*rig.rays.at(rows, columns, None).moved(du, dv))
        light = illuminate(shot, rays.reshape(3, -1)).reshape(rays.shape[1:])
    return LitSamples(light, rows, columns, (samples_v, samples_u), rig.rays.shape, blur.at(rows, columns))


def laser_image(samples: LitSamples) -> np.ndarray:
    """The laser's light on every pixel, without noise, float32 [height, width], DN."""
    if len(samples.rows) == 0:
        return np.zeros(samples.shape, np.float32)
    total: np.ndarray = np.zeros(samples.shape, np.float32)
    for width, share in zip(samples.blur.widths, samples.blur.shares(), strict=True):
        weights_v, weights_u = (psf_weights(width, count) for count in samples.counts)
        light = samples.light if share is None else samples.light * share[:, None]
        total += splat(light, samples.rows, samples.columns, weights_v, weights_u, samples.shape)
    return total


def stacked(x: np.ndarray, y: np.ndarray, z: Numbers) -> np.ndarray:
    """Rays [3, ...] from their coordinates; z may be the number 1 of a pinhole."""
    return np.stack([x, y, np.broadcast_to(np.asarray(z, x.dtype), x.shape)])


def samples_across(rig: TrueRig, sheet: Sheet) -> int:
    """Samples per pixel across the stripe: 8, or more where the sheet is far thinner than a pixel.

    A Gaussian sampled at steps h is integrated to 2 exp(-2 (pi w / h)^2); w >= 0.6 h keeps that
    below 2e-3, of which the lens leaves nothing.
    """
    z = np.linspace(0.5, 6.0, 12)
    step = np.abs(sheet.normal[0 if sheet.spec.stripe_axis == "rows" else 1]) * z / rig.config.camera.fx
    thinnest = float(np.min(sheet.thickness(z) / np.maximum(step, 1e-9)))
    return int(np.clip(math.ceil(0.6 / thinnest), 8, 32))


def illuminate(shot: LitScene, rays: np.ndarray) -> np.ndarray:
    """Light of the laser seen along rays [3, n], float32 [n], DN on a pixel filled with it."""
    sheet, hits = shot.sheet, cast(shot, rays)
    f = np.float32
    beside = hits.depth * sheet.slope_at(*rays).astype(f) - f(sheet.distance)
    legs = hits.points - sheet.origin.astype(f)
    r = np.sqrt(np.einsum("ij,ij->i", legs, legs))
    angle = sheet.angle(legs)
    thickness = sheet.thickness(r).astype(f) * widened(sheet, angle)
    cosine = -np.einsum("ij,ij->i", legs, hits.normal) / r
    fan = along(sheet, angle)
    lit = np.flatnonzero(
        (np.abs(beside) < f(band(sheet)) * thickness) & (cosine > 0) & (fan > 0) & np.isfinite(hits.depth)
    )
    light = np.zeros(len(beside), f)
    lit = lit[~_shaded(shot, hits.points[lit], hits.on_board[lit])]
    s = beside[lit] / thickness[lit]
    energy = f(sheet.power / math.sqrt(2 * math.pi)) / (r[lit] * thickness[lit])
    light[lit] = energy * cosine[lit] * fan[lit] * across(sheet, s) * _albedo(shot, hits, lit)
    return light


def cast(shot: LitScene, rays: np.ndarray) -> Hits:
    """First surface on each of the camera's rays [3, n]."""
    scene, pose, board = shot.scene, shot.pose, shot.board
    directions = np.ascontiguousarray(rays.T)
    depth, triangle = scene.cast(pose.translation, pose.turn(directions))
    normal = pose.inverse().turn(scene.normal)[triangle]
    on_board, place = np.zeros(len(depth), bool), np.zeros((2, len(depth)))
    if board is not None:
        nearer, bx, by = board.hit(*rays)
        on_board, place = nearer < depth, np.stack([bx, by])
        depth = np.where(on_board, nearer, depth)
        normal = np.where(on_board[:, None], board.normal().astype(np.float32), normal)
    safe = np.where(np.isfinite(depth), depth, 0).astype(directions.dtype)
    points = directions * safe[:, None]
    away = np.einsum("ij,ij->i", normal, points) > 0
    return Hits(safe, points, np.where(away[:, None], -normal, normal), triangle, on_board, place)


def row_truth(shot: LitScene, depth: np.ndarray, light: np.ndarray) -> RowTruth:
    """Centre of the stripe in every line, by following the sheet's zero crossing along it.

    Where a line has several, the brightest counts.

    Args:
        shot: The scene and its laser.
        depth: As for `lit_samples`.
        light: The laser's light on every pixel, of `laser_image` [height, width].
    """
    sheet = shot.sheet
    offset = depth * sheet.slope - np.float32(sheet.distance)
    columns_axis = sheet.spec.stripe_axis == "columns"
    if columns_axis:
        offset, light = offset.T, light.T
    found = np.isfinite(offset[:, :-1]) & np.isfinite(offset[:, 1:])
    line, at = np.nonzero(found & ((offset[:, :-1] < 0) != (offset[:, 1:] < 0)))
    t = shot.rig.rays

    def rays_at(u: np.ndarray) -> np.ndarray:
        fraction = u - at

        def between(table: np.ndarray) -> np.ndarray:
            table = table.T if columns_axis else table
            return table[line, at].astype(np.float64) * (1 - fraction) + table[line, at + 1] * fraction

        return stacked(between(t.x), between(t.y), t.z if isinstance(t.z, float) else between(t.z))

    def beside(rays: np.ndarray) -> np.ndarray:
        return cast(shot, rays).depth * sheet.slope_at(*rays) - sheet.distance

    low, high = at.astype(np.float64), at + 1.0
    f_low, f_high = offset[line, at].astype(np.float64), offset[line, at + 1].astype(np.float64)
    u = low
    for _ in range(4):
        u = low - f_low * (high - low) / np.where(f_high == f_low, 1.0, f_high - f_low)
        value = beside(rays_at(u))
        left = (value < 0) == (f_low < 0)
        low, f_low = np.where(left, u, low), np.where(left, value, f_low)
        high, f_high = np.where(left, high, u), np.where(left, f_high, value)
    rays = rays_at(u)
    # At a jump of depth the sheet is crossed nowhere; a lit centre has light of its own.
    real = (np.abs(beside(rays)) < 2e-5) & (illuminate(shot, rays) > 0)
    peak = np.zeros(len(u), np.float32)
    for step in (-1, 0, 1, 2):
        peak = np.maximum(peak, light[line, np.clip(at + step, 0, light.shape[1] - 1)])
    order = np.argsort(np.where(real, peak, -1.0), kind="stable")
    best = np.full(len(offset), -1)
    best[line[order]] = order
    valid = best >= 0
    valid[valid] &= real[best[valid]]
    chosen = best[valid]
    points = shot.pose.apply(cast(shot, rays[:, chosen]).points)
    truth = RowTruth(np.zeros(len(valid)), np.zeros(len(valid), np.float32), np.zeros((len(valid), 3)), valid)
    truth.u[valid], truth.amplitude[valid], truth.xyz[valid] = u[chosen], peak[chosen], points
    return truth


def _band(sheet: Sheet, rig: TrueRig, depth: np.ndarray) -> np.ndarray:
    """Pixels in which the sheet may light something, bool [height, width]."""
    f = np.float32
    z = np.where(np.isfinite(depth), depth, f(1e6))
    signed = z * sheet.slope - f(sheet.distance)
    beside = np.abs(signed)
    waist, divergence = sheet.spec.waist_mm / 1000, sheet.spec.divergence_mrad / 1000
    # The distance from the laser is bounded by that from the camera and their separation.
    apart, focus = f(np.linalg.norm(sheet.origin)), f(sheet.spec.focus_m)
    blurred = np.maximum(np.abs(z - apart - focus), np.abs(z * f(1.5) + apart - focus))
    limit = f(band(sheet)) * (f(waist) + f(divergence) * blurred)
    near = beside < limit
    for axis, first, second in ((0, np.s_[:-1], np.s_[1:]), (1, np.s_[:, :-1], np.s_[:, 1:])):
        step = np.abs(np.diff(signed, axis=axis))
        reach = np.minimum(beside[first], beside[second]) < limit[first] + step
        near[first] |= reach
        near[second] |= reach
    return near


def _shaded(shot: LitScene, points: np.ndarray, on_board: np.ndarray) -> np.ndarray:
    """Whether something stands between the laser and each of the points [n, 3]."""
    origin = shot.sheet.origin
    shaded = shot.scene.blocked(shot.pose.apply(origin), shot.pose.apply(points))
    if shot.board is not None:
        shaded |= ~on_board & shot.board.blocks(origin, points)
    return shaded


def _albedo(shot: LitScene, hits: Hits, lit: np.ndarray) -> np.ndarray:
    channel = np.eye(3, dtype=np.float32)[:, [COLOURS.index(shot.sheet.spec.colour)]]
    (albedo,), _ = shot.scene.look(hits.triangle[lit], shot.pose.apply(hits.points[lit]), channel)
    if shot.board is not None:
        on_board = hits.on_board[lit]
        albedo[on_board] = shot.board.albedo(*hits.place[:, lit[on_board]])
        picture, points = shot.board.picture, hits.points[lit[on_board]]
        if picture.gloss > 0:
            origin = shot.sheet.origin.astype(np.float32)
            normal = hits.normal[lit[on_board]]
            albedo[on_board] += np.float32(picture.gloss) * lobe(origin - points, -points, normal, picture.gloss_rad)
    return albedo
