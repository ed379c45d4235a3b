"""The true centre of the stripe in every line."""

from typing import NamedTuple

import numpy as np

from jaxscan.simulation.light.lit import LitScene, cast, illuminate, stacked


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
