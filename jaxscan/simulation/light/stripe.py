"""The laser's stripe as the camera sees it through the lens.

The light is evaluated on a grid finer than pixels in the band round the sheet, each sample by its own ray, so depth
edges, shadows and printed edges cut the stripe at their true places.
"""

import math
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.camera import Blur, psf_weights, splat
from jaxscan.simulation.light.bounce import (
    FanView,
    lit_mirrors,
    mirrored_light,
    mirrored_sheet,
    thrown_light,
    thrown_sheet,
)
from jaxscan.simulation.light.flat import light_on
from jaxscan.simulation.light.lit import LitScene, band, illuminate, stacked
from jaxscan.simulation.rig import Sheet, TrueRig
from jaxscan.simulation.scene import Plane, Rays


SAMPLES_ALONG = 2
"""Samples per pixel along the stripe."""
_BATCH = 1024
"""Pixels evaluated at a time."""

ON_BOARD = -2
"""In place of a triangle: a pixel sees the board alone."""

FacetAt = Callable[[np.ndarray, np.ndarray], np.ndarray]


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


def lit_samples(shot: LitScene, depth: np.ndarray, blur: Blur, facet_at: FacetAt | None = None) -> LitSamples:
    """The laser's light in the band round its sheet.

    Args:
        shot: The scene and its laser.
        depth: Depth along the ray of every pixel's centre, float32 [height, width]; inf where nothing is.
        blur: Of the lens, in all pixels.
        facet_at: Triangle of the facet that the whole of pixels shows, by their rows and columns; `ON_BOARD` where
            they show the board alone, -1 where it is unknown. There, and without it, a ray is cast for each sample.
    """
    near = _crossed(*_beside(shot.sheet, depth))
    return _sampled(shot, near, blur, lambda rays: illuminate(shot, rays), facet_at)


def mirrored_samples(shot: LitScene, glass: np.ndarray, depth: np.ndarray, blur: Blur) -> list[LitSamples]:
    """The laser's light by way of mirrors: seen in them by the camera, and thrown by them on other surfaces.

    Args:
        shot: The scene and its laser.
        glass: Pixels that see a mirror, bool [height, width].
        depth: As for `lit_samples`.
        blur: Of the lens, in all pixels.
    """
    found = []
    if glass.any():
        near = _crossed(*mirrored_sheet(shot, glass))
        found.append(_sampled(shot, near, blur, lambda rays: mirrored_light(shot, rays)))
    for mirror in lit_mirrors(shot) if shot.scene.mirror.any() else []:
        near = _crossed(*thrown_sheet(shot, mirror, depth))
        found.append(_sampled(shot, near, blur, partial(thrown_light, shot, mirror)))
    return found


def _sampled(
    shot: LitScene,
    near: np.ndarray,
    blur: Blur,
    light_of: Callable[[np.ndarray], np.ndarray],
    facet_at: FacetAt | None = None,
) -> LitSamples:
    """Light along rays through some pixels, bool [height, width]; `light_of` is for those that show several facets."""
    rig = shot.rig
    samples_v, samples_u = SAMPLES_ALONG, samples_across(rig, shot.sheet)
    if shot.sheet.spec.stripe_axis == "columns":
        samples_v, samples_u = samples_u, samples_v
    rows, columns = np.divmod(np.flatnonzero(near), rig.rays.shape[1])
    light: np.ndarray = np.zeros((len(rows), samples_v * samples_u), np.float32)
    dv = ((np.arange(samples_v) + 0.5) / samples_v - 0.5).repeat(samples_u).astype(np.float32)
    du = np.tile((np.arange(samples_u) + 0.5) / samples_u - 0.5, samples_v).astype(np.float32)
    shown = np.full(len(rows), -1) if facet_at is None else facet_at(rows, columns)
    fan = FanView(shot) if facet_at is not None else None
    for triangle, part in _alike(shown):
        x, y, z = rig.rays.at(rows[part], columns[part], None).moved(du, dv)
        if triangle == ON_BOARD:
            light[part] = illuminate(shot, stacked(x, y, z).reshape(3, -1), only_board=True).reshape(len(part), -1)
        elif triangle < 0:
            light[part] = light_of(stacked(x, y, z).reshape(3, -1)).reshape(len(part), -1)
        elif fan is not None and triangle < len(shot.scene.normal) - 1:
            rays = Rays(x, y, z if isinstance(z, np.ndarray) else None)
            light[part] = light_on(shot, Plane.of(shot.scene, triangle, shot.pose), rays, fan)
    return LitSamples(light, rows, columns, (samples_v, samples_u), rig.rays.shape, blur.at(rows, columns))


def _alike(values: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """Every value and the places where it stands, in parts whose samples stay in the processor's cache."""
    order = np.argsort(values, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(values[order])) + 1):
        for start in range(0, len(part), _BATCH):
            yield int(values[part[0]]), part[start : start + _BATCH]


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
