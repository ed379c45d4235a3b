"""Calibration boards: printed, flat or bowed, sampled at 4 x 4 points per pixel before the lens."""

from dataclasses import dataclass, replace

import numpy as np

from jaxscan.errors import ConfigError
from jaxscan.simulation.camera import integrate, psf_weights
from jaxscan.simulation.rays import Numbers
from jaxscan.simulation.rig import Motion, TrueRig
from jaxscan.simulation.settings import BoardsSpec


SAMPLES = 4
INK, PAPER = 0.09, 0.85
"""Albedo of black and white print."""
_RIM = 64
"""White cells round the picture."""
_STRIP = 32
"""Rows rendered at a time: their samples stay in the processor's cache."""
_FAR_M = 1e6
"""Board coordinates beyond this are those of rays that miss."""


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


def make_print(spec: BoardsSpec, texture: np.ndarray) -> Print:
    """The print of a board from its picture.

    Args:
        spec: The board.
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
        np.pad(INK + (PAPER - INK) * texture.astype(np.float32) / 255, _RIM, constant_values=PAPER),
        origin=low + (0.5 - _RIM) * cell,
        cell=cell,
        low=low - margin,
        high=high + margin,
        half=(last - first) / 2,
        middle=(last + first) / 2,
        warp=(spec.warp_mm[0] / 1000, spec.warp_mm[1] / 1000),
        square_cells=round(board.square / cell),
    )


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
        f = np.float32
        rows, columns = p.albedo.shape
        column = np.clip((bx - bx.dtype.type(p.origin[0])) * bx.dtype.type(1 / p.cell), 1, columns - 2).astype(f)
        row = np.clip((by - by.dtype.type(p.origin[1])) * by.dtype.type(1 / p.cell), 1, rows - 2).astype(f)
        j, i = (column + f(0.5)).astype(np.int32), (row + f(0.5)).astype(np.int32)
        across, down = _spline(column - j), _spline(row - i)
        flat = p.albedo.ravel()
        centre = i * np.int32(columns) + j
        total = np.zeros_like(column)
        for m, weight in enumerate(down):
            at = centre + np.int32((m - 1) * columns)
            line = flat[at - 1] * across[0]
            line += flat[at] * across[1]
            line += flat[at + 1] * across[2]
            line *= weight
            total += line
        return total

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


def _spline(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights of the cells before, at and after a place `t` (-1/2 ... 1/2) of the middle one."""
    half = np.float32(0.5)
    return half * (half - t) ** 2, np.float32(0.75) - t * t, half * (half + t) ** 2


def cover(
    rig: TrueRig, board: SeenBoard, depth: np.ndarray
) -> tuple[tuple[slice, slice], np.ndarray, np.ndarray, SeenBoard]:
    """The board through the lens, in the part of the image that it touches.

    Args:
        rig: The rig.
        board: The board.
        depth: Depth of the board at pixel centres, inf where missed [height, width].

    Returns:
        Its place in the image (rows, columns); the share of each pixel that it fills, and its albedo
        times that share, float32 [rows, columns]; and the board with its picture as fine as the pixels need.
    """
    radius = (len(psf_weights(rig.config.sensor.psf_px, SAMPLES)) - 1) // 2
    height, width = rig.rays.shape
    seen = np.isfinite(depth)
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    if len(rows) == 0:
        nothing = np.zeros((0, 0), np.float32)
        return (slice(0, 0), slice(0, 0)), nothing, nothing, board
    top, bottom = max(0, rows[0] - radius - 1), min(height, rows[-1] + radius + 2)
    left, right = max(0, columns[0] - radius - 1), min(width, columns[-1] + radius + 2)
    pixel = float(np.median(depth[seen])) / rig.config.camera.fx
    fine = SeenBoard(board.picture.smoothed(pixel / SAMPLES), board.board_from_camera)
    fills = np.empty((bottom - top, right - left), np.float32)
    albedo = np.empty_like(fills)
    for start in range(top, bottom, _STRIP):
        end = min(start + _STRIP, bottom)
        part = slice(start - top, end - top)
        fills[part], albedo[part] = _strip(rig, fine, slice(start, end), slice(left, right), radius)
    return (slice(top, bottom), slice(left, right)), fills, albedo, fine


def _strip(rig: TrueRig, board: SeenBoard, rows: slice, columns: slice, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Share that the board fills of some pixels, and its albedo times that share; `radius` is the lens's blur [px]."""
    height, width = rig.rays.shape
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
    weights = psf_weights(rig.config.sensor.psf_px, SAMPLES)
    return integrate(inside, weights), integrate(albedo, weights)
