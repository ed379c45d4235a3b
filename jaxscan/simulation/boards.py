"""Calibration boards: printed, flat or bowed, sampled at 4 x 4 points per pixel before the lens."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.camera import Blur, blurred, integrate, psf_weights
from jaxscan.simulation.printing import Print, between_cells
from jaxscan.simulation.rays import Numbers
from jaxscan.simulation.rig import Motion, TrueRig


SAMPLES = 4
_STRIP = 32
"""Rows rendered at a time: their samples stay in the processor's cache."""
_FAR_M = 1e6
"""Board coordinates beyond this are those of rays that miss."""


@dataclass(frozen=True, eq=False)
class SeenBoard:
    """A board held in front of the camera."""

    picture: Print
    board_from_camera: Motion

    def hit(self, x: np.ndarray, y: np.ndarray, z: Numbers = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Depth along (x, y, z), inf where missed, and board coordinates [m]."""
        motion = self.board_from_camera
        r, t = motion.rotation.astype(x.dtype), motion.translation.astype(x.dtype)
        r0, r1, r2 = (row[0] * x + row[1] * y + row[2] * z for row in r)
        towards = np.where(np.abs(r2) < 1e-9, x.dtype.type(1e-9), r2)
        depth = -t[2] / towards
        bx, by = depth * r0 + t[0], depth * r1 + t[1]
        if self.picture.warp != (0.0, 0.0):
            # The bow is shallow: each round divides its error by ten, at the least.
            with np.errstate(over="ignore", invalid="ignore"):
                for _ in range(6):
                    depth = (self.height(bx, by) - t[2]) / towards
                    bx, by = depth * r0 + t[0], depth * r1 + t[1]
            # Rays that graze the board's plane far outside it run away; they miss.
            lost = ~((np.abs(bx) < _FAR_M) & (np.abs(by) < _FAR_M))
            depth, bx, by = (np.where(lost, bx.dtype.type(0), values) for values in (depth, bx, by))
        low, high = self.picture.low.astype(x.dtype), self.picture.high.astype(x.dtype)
        inside = (depth > 0) & (bx >= low[0]) & (bx <= high[0]) & (by >= low[1]) & (by <= high[1])
        return np.where(inside, depth, x.dtype.type(np.inf)), bx, by

    def height(self, bx: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Height of the bowed board at board coordinates [m]."""
        p = self.picture
        kx, ky = (bx.dtype.type(k) for k in p.warp)
        x, y = ((b - b.dtype.type(m)) / b.dtype.type(h) for b, m, h in zip((bx, by), p.middle, p.half, strict=True))
        return kx * (1 - x * x) + ky * (1 - y * y)

    def albedo(self, bx: np.ndarray, by: np.ndarray) -> np.ndarray:
        """Albedo of the print by a quadratic spline over its cells, float32."""
        p = self.picture
        row, column = (
            ((place - place.dtype.type(start)) * place.dtype.type(1 / p.cell)).astype(np.float32, copy=False)
            for place, start in ((by, p.origin[1]), (bx, p.origin[0]))
        )
        return between_cells(p.albedo, row, column)

    def normal(self) -> np.ndarray:
        """Unit normal towards the camera, camera frame."""
        normal = self.board_from_camera.rotation[2]
        return normal * np.sign(self.board_from_camera.translation[2])

    def blocks(self, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Whether the board stands between `origin` [3] and points [n, 3], camera frame."""
        start, ends = self.board_from_camera.apply(origin), self.board_from_camera.apply(points)
        crosses = start[2] * ends[:, 2] < 0
        share = start[2] / np.where(crosses, start[2] - ends[:, 2], 1.0)
        place = start[:2] + share[:, None] * (ends[:, :2] - start[:2])
        return crosses & np.all((place >= self.picture.low) & (place <= self.picture.high), -1)


class Cover(NamedTuple):
    """A board in the part of the image that it touches."""

    where: tuple[slice, slice]
    """Rows and columns."""
    fills: np.ndarray
    """Share of each pixel that it fills, float32 [rows, columns]."""
    albedo: np.ndarray
    """Its albedo times that share."""
    board: SeenBoard
    """The board with its picture as fine as the pixels need."""


def cover(rig: TrueRig, board: SeenBoard, depth: np.ndarray, blur: Blur) -> Cover:
    """The board through the lens, in the part of the image that it touches.

    Args:
        rig: The rig.
        board: The board.
        depth: Depth of the board at pixel centres, inf where missed [height, width].
        blur: Of the lens, in all pixels.

    Returns:
        The pixels that it covers.
    """
    radius = (len(psf_weights(blur.widest, SAMPLES)) - 1) // 2
    height, width = rig.rays.shape
    seen = np.isfinite(depth)
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    if len(rows) == 0:
        nothing = np.zeros((0, 0), np.float32)
        return Cover((slice(0, 0), slice(0, 0)), nothing, nothing, board)
    top, bottom = max(0, rows[0] - radius - 1), min(height, rows[-1] + radius + 2)
    left, right = max(0, columns[0] - radius - 1), min(width, columns[-1] + radius + 2)
    pixel = float(np.median(depth[seen])) / rig.config.camera.fx
    fine = SeenBoard(board.picture.smoothed(pixel / SAMPLES), board.board_from_camera)
    fills = np.zeros((bottom - top, right - left), np.float32)
    albedo = np.zeros_like(fills)
    for start in range(top, bottom, _STRIP):
        end = min(start + _STRIP, bottom)
        # A board that is turned reaches over a part of the columns in each strip.
        beside = np.flatnonzero(seen[max(0, start - radius - 1) : end + radius + 1].any(0))
        if not len(beside):
            continue
        first, last = max(left, beside[0] - radius - 1), min(right, beside[-1] + radius + 2)
        part = slice(start - top, end - top), slice(first - left, last - left)
        fills[part], albedo[part] = _strip(rig, fine, slice(start, end), slice(first, last), blur)
    return Cover((slice(top, bottom), slice(left, right)), fills, albedo, fine)


def _strip(rig: TrueRig, board: SeenBoard, rows: slice, columns: slice, blur: Blur) -> tuple[np.ndarray, np.ndarray]:
    """Share that the board fills of some pixels, and its albedo times that share."""
    height, width = rig.rays.shape
    radius = (len(psf_weights(blur.widest, SAMPLES)) - 1) // 2
    # Pixels beyond the border repeat those on it: light from outside the image is unknown.
    i = np.clip(np.arange(rows.start - radius, rows.stop + radius), 0, height - 1)
    j = np.clip(np.arange(columns.start - radius, columns.stop + radius), 0, width - 1)
    rays = rig.rays.at(*np.ix_(i, j))
    at = ((np.arange(SAMPLES) + 0.5) / SAMPLES - 0.5).astype(np.float32)
    inside = np.empty((SAMPLES, SAMPLES, len(i), len(j)), np.float32)
    albedo = np.empty_like(inside)
    for m, du in enumerate(at):
        for n, dv in enumerate(at):
            depth, bx, by = board.hit(*rays.moved(du, dv))
            inside[m, n] = np.isfinite(depth)
            albedo[m, n] = board.albedo(bx, by)
            albedo[m, n] *= inside[m, n]

    def through(samples: np.ndarray, psf_px: float) -> np.ndarray:
        weights = psf_weights(psf_px, SAMPLES)
        spare = radius - (len(weights) - 1) // 2
        return integrate(samples[..., spare : len(i) - spare, spare : len(j) - spare], weights)

    here = blur.at(rows, columns)
    return blurred(lambda psf: through(inside, psf), here), blurred(lambda psf: through(albedo, psf), here)
