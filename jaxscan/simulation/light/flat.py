"""The stripe on one plane: its light, and its true centre in every line."""

import math
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.bounce import FanView
from jaxscan.simulation.light.lit import (
    LitScene,
    across,
    along,
    band,
    cast,
    illuminate,
    laser_channel,
    stacked,
    widened,
)
from jaxscan.simulation.scene import Plane, Rays


class RowTruth(NamedTuple):
    """The true stripe, one entry per line; entries that are not `valid` are zero."""

    u: np.ndarray
    """Centre of the sheet across the line [px], float64."""
    amplitude: np.ndarray
    """Peak of the stripe's light on one pixel, without noise [DN], float32."""
    xyz: np.ndarray
    """The point of the surface there [m], scanner frame, float64 [lines, 3]."""
    valid: np.ndarray


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


def light_on(shot: LitScene, plane: Plane, rays: Rays, fan: FanView) -> np.ndarray:
    """Light of the laser seen along rays that meet a plane before anything else, behind a board or beside it.

    Args:
        shot: The scene and its laser.
        rays: Of the samples of some pixels [pixels, samples].
        fan: The edges in the laser's way.

    Returns:
        float32 [pixels, samples], DN on a pixel filled with it; as `illuminate`.
    """
    f, sheet = np.float32, shot.sheet
    light = np.zeros(rays.x.shape, np.float32)
    height = float(plane.normal @ shot.pose.apply(sheet.origin)) - plane.offset
    if height <= 0:
        return light
    depth = plane.depth(rays)
    # The way from the laser: along the middle of the fan, across it, and out of the sheet.
    ahead, aside, out = (
        depth * rays.along(axis) - f(axis @ sheet.origin) for axis in (sheet.ahead, sheet.across, sheet.normal)
    )
    r2 = ahead * ahead
    r2 += aside * aside
    r2 += out * out
    r = np.sqrt(r2, out=r2)
    thick = f(band(sheet) * (1 + sheet.spec.widening)) * sheet.thickness(r)
    at = np.flatnonzero(np.abs(out) < thick + f(sheet.bulge) * depth)
    ahead, aside, out, r, depth = (part.ravel()[at] for part in (ahead, aside, out, r, depth))
    some = rays.ravel().at(at)
    beside = out if sheet.spec.bow == (0.0, 0.0) else depth * sheet.slope_at(*some.whole()) - f(sheet.distance)
    angle = np.arctan2(aside, ahead)
    thickness = sheet.thickness(r) * widened(sheet, angle)
    power = along(sheet, angle)
    inside = np.flatnonzero((np.abs(beside) < f(band(sheet)) * thickness) & (power > 0))
    at, some, depth = at[inside], some.at(inside), depth[inside]
    open_ = np.flatnonzero(_open(shot, plane, fan, at // rays.x.shape[-1], (some, depth, angle[inside], r[inside])))
    if shot.board is not None:
        points = np.stack([part * depth[open_] for part in np.broadcast_arrays(*some.at(open_).whole())], -1)
        open_ = open_[~shot.board.blocks(sheet.origin, points)]
    inside, some, depth = inside[open_], some.at(open_), depth[open_]
    beside, r, thickness, power = beside[inside], r[inside], thickness[inside], power[inside]
    energy = f(sheet.power / math.sqrt(2 * math.pi) * height) / (r * r * thickness)
    (albedo,) = plane.albedo(some, depth, laser_channel(shot.sheet))
    light.ravel()[at[open_]] = energy * power * across(sheet, beside / thickness) * albedo
    return light


def _open(
    shot: LitScene,
    plane: Plane,
    fan: FanView,
    pixel: np.ndarray,
    points: tuple[Rays, np.ndarray, np.ndarray, np.ndarray],
) -> np.ndarray:
    """Whether nothing stands between the laser and points of a plane, bool [n].

    Args:
        shot: The scene and its laser.
        fan: The edges in the laser's way.
        pixel: Number of each point's pixel, in order. One point of a pixel stands for all where no shadow can end.
        points: Their rays, depths, angles in the fan and distances from the laser.
    """
    rays, depth, angle, far = points
    if len(pixel) == 0:
        return np.zeros(0, bool)
    starts = np.flatnonzero(np.diff(pixel, prepend=-1))
    low, high = np.minimum.reduceat(angle, starts), np.maximum.reduceat(angle, starts)
    clear = fan.clear(low, high, np.maximum.reduceat(far, starts))
    counts = np.diff(starts, append=len(pixel))
    cast = ~clear.repeat(counts)
    cast[starts[clear]] = True
    found = np.zeros(len(pixel), bool)
    at = np.flatnonzero(cast)
    found[at] = ~shot.scene.blocked(shot.pose.apply(shot.sheet.origin), plane.points(rays.at(at), depth[at]))
    return np.where(clear.repeat(counts), found[starts].repeat(counts), found)
