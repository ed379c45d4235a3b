"""Calibration boards of a simulated rig: their print, and how the camera sees it."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.camera import Blur, blurred, integrate, psf_weights
from jaxscan.simulation.rig import Motion, Numbers, TrueRig
from jaxscan.simulation.settings import BoardsSpec


_RIM = 64
"""White cells round the picture."""


@dataclass(frozen=True, eq=False)
class Print:
    """A board's picture as albedo, with a white rim, and its place on the board."""

    albedo: np.ndarray
    """float32 [rows, columns]."""
    origin: np.ndarray
    """Board coordinates of the centre of the first cell [2], m."""
    cell: float
    """Side of a cell of the picture [m]."""
    low: np.ndarray
    """Smallest x, y of the board with its white border [2], m."""
    high: np.ndarray
    half: np.ndarray
    """Half the extent of the corners [2], m, which the warp refers to."""
    middle: np.ndarray
    """Middle of the corners [2], m."""
    warp: tuple[float, float]
    """kx, ky [m]."""
    square_cells: int
    """Cells along a square's side."""
    gloss: float
    """Light that the lamination reflects at the middle of its lobe, as an albedo."""
    gloss_rad: float
    """Standard deviation of the lobe: of the angle between normal and bisector of light and view."""

    def smoothed(self, step: float) -> "Print":
        """The picture averaged to cells about as large as `step` [m], the distance of samples.

        A quadratic spline over such cells spreads a printed edge over three steps, so sampling
        it does not alias (by less than 1e-3 px) and the edge does not lock onto the samples.
        Only blocks of which a whole number makes a square are averaged, so that edges of
        squares stay on the borders of cells, and in place.
        """
        factors = (k for k in range(1, _RIM // 2) if self.square_cells % k == 0 and k * self.cell >= 0.9 * step)
        factor = next(factors, 1)
        if factor == 1:
            return self
        skip = _RIM % factor
        rows, columns = ((size - skip) // factor for size in self.albedo.shape)
        whole = self.albedo[skip : skip + rows * factor, skip : skip + columns * factor]
        albedo = whole.reshape(rows, factor, columns, factor).mean((1, 3))
        origin = self.origin + (skip + (factor - 1) / 2) * self.cell
        return replace(self, albedo=albedo, origin=origin, cell=self.cell * factor)


def between_cells(cells: np.ndarray, row: np.ndarray, column: np.ndarray) -> np.ndarray:
    """The quadratic spline over the cells of a picture, float32; places beyond the last but one lie on these."""
    from scipy.ndimage import map_coordinates  # type: ignore[import-untyped]

    # NaN becomes 1.
    places = [np.fmin(np.fmax(at, 1), size - 2) for at, size in zip((row, column), cells.shape, strict=True)]
    return map_coordinates(cells, places, order=2, prefilter=False)


def make_print(spec: BoardsSpec, texture: np.ndarray) -> Print:
    """The print of a board from its picture.

    Args:
        texture: uint8 [rows, columns], the printed area (`board.outline()`), row 0 at y0.

    Raises:
        ConfigError: If the picture does not have the shape of the board.
    """
    board = spec.board()
    outline, corners = board.outline(), board.corners()[:, :2]
    low, high = outline.min(0), outline.max(0)
    cells = (high - low) / np.array(texture.shape[::-1])
    if texture.ndim != 2 or abs(cells[0] / cells[1] - 1) > 1e-6:
        raise ConfigError(
            f"The board's picture has shape {texture.shape}; a grey picture of {high[0] - low[0]:.4g} x "
            f"{high[1] - low[1]:.4g} m with square cells is needed."
        )
    cell, margin = float(cells[0]), spec.border_mm / 1000
    first, last = corners.min(0), corners.max(0)
    return Print(
        # Places outside the picture take the last cell of the white rim.
        _printed(spec, texture, cell),
        origin=low + (0.5 - _RIM) * cell,
        cell=cell,
        low=low - margin,
        high=high + margin,
        half=(last - first) / 2,
        middle=(last + first) / 2,
        warp=(spec.warp_mm[0] / 1000, spec.warp_mm[1] / 1000),
        square_cells=round(board.square / cell),
        gloss=spec.gloss,
        gloss_rad=math.radians(spec.gloss_deg),
    )


def _printed(spec: BoardsSpec, texture: np.ndarray, cell: float) -> np.ndarray:
    """Albedo of the print and its rim, float32; `cell` is the side of a cell [m]."""
    ink, paper = spec.ink, spec.paper
    albedo = np.pad(ink + (paper - ink) * texture.astype(np.float32) / 255, _RIM, constant_values=paper)
    if spec.print_blur_mm > 0:
        sigma = spec.print_blur_mm / 1000 / cell
        reach = min(math.ceil(4 * sigma), _RIM)
        kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
        kernel = (kernel / kernel.sum()).astype(np.float32)
        for axis in (0, 1):
            albedo = np.apply_along_axis(
                np.convolve, axis, np.pad(albedo, _beside(reach, axis), "edge"), kernel, "valid"
            )
    if spec.uneven > 0:
        # Slow waves over half a board and more: ink and coating are never spread evenly.
        y, x = (np.linspace(0, 2 * np.pi, size, dtype=np.float32) for size in albedo.shape)
        wave = np.sin(1.3 * x[None] + 0.7 * y[:, None]) * np.sin(0.6 * x[None] - 1.9 * y[:, None] + 1)
        albedo = albedo * (1 + np.float32(spec.uneven) * wave)
    return albedo.astype(np.float32)


def _beside(reach: int, axis: int) -> tuple[tuple[int, int], tuple[int, int]]:
    return ((reach, reach), (0, 0)) if axis == 0 else ((0, 0), (reach, reach))


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
            # The bow is shallow, so each round divides the error by ten or more.
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
        depth: Depth of the board at pixel centres, inf where missed [height, width].
        blur: Blur of the lens, in all pixels.

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
