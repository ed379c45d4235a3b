"""The truth of a record's rows: crossings of sheet and surfaces, their light, and edges within a few pixels."""

import numpy as np
from scipy.ndimage import gaussian_filter1d  # type: ignore[import-untyped]

from experiments.unkind.truth import TrueStripes, empty, with_parts
from experiments.unkind.world import light
from experiments.unkind.world.sensor import FINE, to_pixels
from experiments.unkind.world.tracer import Hits


CONTRAST_PX = 4.0
BESIDE_PX, ALONG_ROWS = 4, 2
"""Reach within which an edge counts."""
OFF_PLANE = 0.004
"""Distance from the tangent plane that counts as an edge, as a part of the distance from the camera."""


def stripes(shot: light.Shot, middle: Hits, laser: light.Direct, ambient: np.ndarray) -> TrueStripes:
    """The true stripes [rows, crossings] of one record.

    Args:
        shot: Rig, room and pose.
        middle: The surfaces that the middles of all pixels see.
        laser: The laser's direct light behind the lens [DN].
        ambient: The room's light on every pixel [DN].
    """
    rows, columns = shot.rig.height, shot.rig.width
    found = light.crossings(shot, middle)
    peak, width = _profile(laser.fine, found.u - laser.columns.start, found.row)
    beside = ambient[found.row, np.clip(np.rint(found.u).astype(int), 0, columns - 1)]
    edge = _edges(shot, middle, laser.shadow, found)
    on_board = found.shape == shot.tracer.board if shot.tracer.board >= 0 else np.zeros(len(found.u), bool)
    contrast = np.full(len(found.u), np.nan)
    contrast[on_board] = print_contrast(shot, found.u[on_board], found.row[on_board])
    out = TrueStripes(*(grid[0] for grid in empty(1, rows)))
    order = np.lexsort((-peak, found.row))
    row = found.row[order]
    rank = np.arange(len(row)) - np.searchsorted(row, row, side="left")
    keep = (rank < light.CROSSINGS) & (peak[order] > 0.05)
    at, chosen = (row[keep], rank[keep]), order[keep]
    values = (found.u, peak, width, beside, edge, found.shape, contrast)
    for grid, value in zip(out, values, strict=True):
        grid[at] = value[chosen]
    pixels = np.zeros((rows, columns))
    pixels[:, laser.columns] = to_pixels(laser.fine, FINE)
    return with_parts(out, pixels)


def _profile(laser: np.ndarray, u: np.ndarray, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Peak near each centre and standard deviation of the light there, of the mean over a row's fine lines."""
    lines = laser.reshape(-1, FINE, laser.shape[1]).mean(1)
    reach = 4 * FINE
    centre = np.rint((u + 0.5) * FINE - 0.5).astype(int)
    at = np.clip(centre[:, None] + np.arange(-reach, reach + 1), 0, laser.shape[1] - 1)
    value = lines[row[:, None], at]
    near = value[:, reach - FINE : reach + FINE + 1].max(1)
    place = (at + 0.5) / FINE - 0.5
    total = np.maximum(value.sum(1), 1e-9)
    mean = (value * place).sum(1) / total
    return near, np.sqrt(np.maximum((value * (place - mean[:, None]) ** 2).sum(1) / total, 0.0))


def _edges(shot: light.Shot, middle: Hits, shadow: np.ndarray, found: light.Crossings) -> np.ndarray:
    """Whether a jump, a crease, a shadow or the image's border is near a centre."""
    rows, columns = shot.rig.height, shot.rig.width
    p = middle.p.reshape(rows, columns, 3)
    hit = (middle.shape >= 0).reshape(rows, columns)
    at = np.rint(found.u).astype(int)
    edge = (at < BESIDE_PX) | (at >= columns - BESIDE_PX) | (found.row < ALONG_ROWS) | (found.row >= rows - ALONG_ROWS)
    limit = OFF_PLANE * np.linalg.norm(found.p - shot.pose[:3, 3], axis=1)
    for dv in range(-ALONG_ROWS, ALONG_ROWS + 1):
        for du in range(-BESIDE_PX, BESIDE_PX + 1):
            v, u = np.clip(found.row + dv, 0, rows - 1), np.clip(at + du, 0, columns - 1)
            off = np.abs(((p[v, u] - found.p) * found.normal).sum(1))
            edge |= (off > limit) | ~hit[v, u] | (shadow[v, u] < 0.999)
    return edge


def print_contrast(shot: light.Shot, u: np.ndarray, row: np.ndarray) -> np.ndarray:
    """(max - min) / (max + min) of the surface's paint within 4 px along the row, behind a blur of 0.75 px."""
    steps = np.arange(-CONTRAST_PX - 2, CONTRAST_PX + 2.01, 0.25)
    lines = []
    for dv in (-0.5, 0.0, 0.5):
        hits = shot.cast((u[:, None] + steps).ravel(), np.repeat(row + dv, len(steps)))
        lines.append(np.where(hits.shape == shot.tracer.board, hits.albedo, np.nan).reshape(len(u), len(steps)))
    level = np.mean(lines, axis=0)
    level[~np.isfinite(level).any(1)] = 1.0
    # Beside the board nothing is known of the print; its border is an edge anyway.
    level = np.where(np.isfinite(level), level, np.nanmax(level, axis=1, keepdims=True))
    level = gaussian_filter1d(level, 0.75 / 0.25, axis=1, mode="nearest")[:, 8:-8]
    high, low = level.max(1), level.min(1)
    return (high - low) / (high + low)
