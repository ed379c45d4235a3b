"""The print of a calibration board: albedo of ink and paper, with the blur and the gloss that prints have."""

import math
from dataclasses import dataclass, replace

import numpy as np

from jaxscan.errors import ConfigError
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
    """The quadratic spline over the cells of a picture.

    Args:
        cells: float32 [rows, columns].
        row: Places, float32; those beyond the last cells but one are taken to lie on these.
        column: The same.

    Returns:
        Values there, float32.
    """
    half, most = np.float32(0.5), np.float32(0.75)
    rows, columns = cells.shape
    # What is no number becomes 1.
    y = np.fmin(np.fmax(row, np.float32(1)), np.float32(rows - 2))
    x = np.fmin(np.fmax(column, np.float32(1)), np.float32(columns - 2))
    i, j = ((at + half).astype(np.int32) for at in (y, x))
    y -= i.astype(np.float32)
    x -= j.astype(np.float32)
    flat = cells.ravel()
    # The nine cells about each place, row by row; all of them exist.
    cell = (i.astype(np.intp) - 1) * columns + (j - 1)
    along = half * (half - x) * (half - x), most - x * x, half * (half + x) * (half + x)
    total = np.zeros_like(y)
    for weight in (half * (half - y) * (half - y), most - y * y, half * (half + y) * (half + y)):
        line = np.zeros_like(y)
        for share in along:
            line += share * flat.take(cell, mode="clip")
            cell += 1
        cell += columns - 3
        total += weight * line
    return total


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
