"""The laser's stripe as the camera sees it through the lens, and its true centre in every line.

The light is evaluated on a grid finer than pixels in the band round the sheet, each sample by its own ray, so depth
edges, shadows and printed edges cut the stripe at their true places.
"""

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.camera import Blur, psf_weights, splat
from jaxscan.simulation.light.bounce import lit_mirrors, mirrored_light, mirrored_sheet, thrown_light, thrown_sheet
from jaxscan.simulation.light.lit import LitScene, band, cast, illuminate, stacked
from jaxscan.simulation.rig import Sheet, TrueRig


SAMPLES_ALONG = 2
"""Samples per pixel along the stripe."""
_BATCH = 1024
"""Pixels evaluated at a time."""


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
        depth: Depth along the ray of every pixel's centre, float32 [height, width]; inf where nothing is.
    """
    return _sampled(shot, _crossed(*_beside(shot.sheet, depth)), blur, partial(illuminate, shot))


def mirrored_samples(shot: LitScene, glass: np.ndarray, depth: np.ndarray, blur: Blur) -> list[LitSamples]:
    """The laser's light by way of mirrors: seen in them by the camera, and thrown by them on other surfaces.

    Args:
        glass: Pixels that see a mirror, bool [height, width].
    """
    found = []
    if glass.any():
        near = _crossed(*mirrored_sheet(shot, glass))
        found.append(_sampled(shot, near, blur, partial(mirrored_light, shot)))
    for mirror in lit_mirrors(shot) if shot.scene.mirror.any() else []:
        near = _crossed(*thrown_sheet(shot, mirror, depth))
        found.append(_sampled(shot, near, blur, partial(thrown_light, shot, mirror)))
    return found


def _sampled(shot: LitScene, near: np.ndarray, blur: Blur, light_of: Callable[[np.ndarray], np.ndarray]) -> LitSamples:
    """Light along rays through some pixels, bool [height, width]; `light_of` gives that of rays [3, n]."""
    rig = shot.rig
    samples_v, samples_u = SAMPLES_ALONG, samples_across(rig, shot.sheet)
    if shot.sheet.spec.stripe_axis == "columns":
        samples_v, samples_u = samples_u, samples_v
    rows, columns = np.divmod(np.flatnonzero(near), rig.rays.shape[1])
    light: np.ndarray = np.zeros((len(rows), samples_v * samples_u), np.float32)
    dv = ((np.arange(samples_v) + 0.5) / samples_v - 0.5).repeat(samples_u).astype(np.float32)
    du = np.tile((np.arange(samples_u) + 0.5) / samples_u - 0.5, samples_v).astype(np.float32)
    # Some pixels at a time, whose samples stay in the processor's cache.
    for start in range(0, len(rows), _BATCH):
        part = np.s_[start : start + _BATCH]
        x, y, z = rig.rays.at(rows[part], columns[part], None).moved(du, dv)
        light[part] = light_of(stacked(x, y, z).reshape(3, -1)).reshape(len(x), -1)
    return LitSamples(light, rows, columns, (samples_v, samples_u), rig.rays.shape, blur.at(rows, columns))


def laser_image(samples: LitSamples) -> np.ndarray:
    """The laser's light on every pixel, without noise, float32 [height, width], DN."""
    if len(samples.rows) == 0:
        return np.zeros(samples.shape, np.float32)
    total: np.ndarray = np.zeros(samples.shape, np.float32)
    for width, share in zip(samples.blur.widths, samples.blur.shares(), strict=True):
        weights_v, weights_u = (psf_weights(width, count) for count in samples.counts)
        if share is None:
            total += splat(samples.light, samples.rows, samples.columns, weights_v, weights_u, samples.shape)
        elif share.any():
            at = np.flatnonzero(share)
            light = samples.light[at] * share[at, None]
            total += splat(light, samples.rows[at], samples.columns[at], weights_v, weights_u, samples.shape)
    return total


def samples_across(rig: TrueRig, sheet: Sheet) -> int:
    """Samples per pixel across the stripe: 8, or more where the sheet is far thinner than a pixel.

    A Gaussian sampled at steps h is integrated to 2 exp(-2 (pi w / h)^2); w >= 0.6 h keeps that
    below 2e-3, of which the lens leaves nothing.
    """
    z = np.linspace(0.5, 6.0, 12)
    step = np.abs(sheet.normal[0 if sheet.spec.stripe_axis == "rows" else 1]) * z / rig.config.camera.fx
    thinnest = float(np.min(sheet.thickness(z) / np.maximum(step, 1e-9)))
    return int(np.clip(math.ceil(0.6 / thinnest), 8, 32))


def _beside(sheet: Sheet, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the sheet, and a bound on half the width of its lit band, at all pixels [height, width], m."""
    f = np.float32
    z = np.where(np.isfinite(depth), depth, f(1e6))
    waist, divergence = sheet.spec.waist_mm / 1000, sheet.spec.divergence_mrad / 1000
    # The distance from the laser is bounded by that from the camera and their separation.
    apart, focus = f(np.linalg.norm(sheet.origin)), f(sheet.spec.focus_m)
    blurred = np.maximum(np.abs(z - apart - focus), np.abs(z * f(1.5) + apart - focus))
    return z * sheet.slope - f(sheet.distance), f(band(sheet)) * (f(waist) + f(divergence) * blurred)


def _crossed(signed: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """Pixels in which the sheet may light something, bool [height, width]."""
    beside = np.abs(signed)
    near = beside < limit
    for axis, first, second in ((0, np.s_[:-1], np.s_[1:]), (1, np.s_[:, :-1], np.s_[:, 1:])):
        step = np.abs(np.diff(signed, axis=axis))
        reach = np.minimum(beside[first], beside[second]) < limit[first] + step
        near[first] |= reach
        near[second] |= reach
    return near


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
    # At a jump of depth no surface crosses the sheet; a true centre has light.
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
