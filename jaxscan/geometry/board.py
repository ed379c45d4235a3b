"""Calibration boards: their corners and their surface.

The board frame has its origin at a corner, x along the rows of squares, y down the columns, z
into the board, so a board seen upright has the camera's axes. Corner k stands at column
`k % columns`, row `k // columns` of the corners' grid, for every kind.
"""

import abc
from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry.arrays import Array, ArrayModule, namespace
from jaxscan.geometry.rigid import invert, turn


_ROUNDS = 4
"""Iterations of the intersection of a ray and a bowed board; each divides the error by a hundred or more."""
BEND_DEGREE = 6
"""Highest degree of the polynomials that a board's height may have."""


class AbstractBoard(ArrayModule):
    """A flat printed target with point features, called corners also where they are centres of circles."""

    square: eqx.AbstractVar[float]
    """Side of a square, or the least distance of neighbouring corners along an axis [m]."""

    @abc.abstractmethod
    def grid(self) -> tuple[int, int]:
        """Columns and rows of corners."""

    @abc.abstractmethod
    def places(self) -> np.ndarray:
        """Board coordinates (x, y) of all corners, float64 [columns * rows, 2], m."""

    @abc.abstractmethod
    def describe(self) -> str:
        """The board in words, for messages and reports."""

    def corners(self) -> np.ndarray:
        """All corners, float64 [columns * rows, 3], metres, board frame."""
        flat = self.places()
        return np.column_stack([flat, np.zeros(len(flat))])

    def outline(self) -> np.ndarray:
        """Corners of the printed area, float64 [4, 2], metres: x0 y0, x1 y0, x1 y1, x0 y1."""
        flat = self.places()
        (x0, y0), (x1, y1) = flat.min(0) - self.square, flat.max(0) + self.square
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])


def even_grid(columns: int, rows: int) -> np.ndarray:
    """Column and row of every corner of a grid, in the order of corners, float64 [columns * rows, 2]."""
    x, y = np.meshgrid(np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64))
    return np.stack([x.ravel(), y.ravel()], -1)


class Chessboard(AbstractBoard):
    """A plain chessboard; `columns` and `rows` count inner corners. Origin at corner 0.

    A symmetric board (both counts even or both odd) looks the same turned by 180 degrees.
    """

    columns: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Side of a square [m]."""

    def grid(self) -> tuple[int, int]:
        return self.columns, self.rows

    def places(self) -> np.ndarray:
        return even_grid(self.columns, self.rows) * self.square

    def describe(self) -> str:
        return f"chessboard, {self.columns} x {self.rows} inner corners, {1e3 * self.square:g} mm"


class Charuco(AbstractBoard):
    """A chessboard with ArUco markers in its white squares; `columns` and `rows` count squares.

    Origin at the corner of the printed area beside marker 0, as in OpenCV.
    """

    columns: int = eqx.field(static=True)
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Side of a square [m]."""
    marker: float = eqx.field(static=True)
    """Side of a marker [m]."""
    dictionary: str = eqx.field(static=True, default="DICT_5X5_250")
    layout: Literal["standard", "legacy"] = eqx.field(static=True, default="standard")
    """ "legacy": as OpenCV printed boards before version 4.6, and others still do: with an even number of rows, the
    first square is white."""

    def grid(self) -> tuple[int, int]:
        return self.columns - 1, self.rows - 1

    def white(self) -> np.ndarray:
        """The squares that have markers, numbered along the rows, bool [rows, columns]."""
        first = self.layout == "legacy" and self.rows % 2 == 0
        return (np.add.outer(np.arange(self.rows), np.arange(self.columns)) + first) % 2 == 1

    def places(self) -> np.ndarray:
        return even_grid(*self.grid()) * self.square + self.square

    def describe(self) -> str:
        columns, rows = self.grid()
        legacy = ", legacy layout" if self.layout == "legacy" else ""
        return f"ChArUco board, {columns} x {rows} inner corners, {1e3 * self.square:g} mm{legacy}"


class BowedBoard(ArrayModule):
    """The true surface of a board, with its bow, its bend and its true pitch.

    (x, y) are coordinates on the board as drawn [m].
    """

    frame: Float[Array, "4"]
    """Centre x, y and half extents in x, y of the corner grid [m]; see `corner_frame`."""
    shape: Float[Array, "3"]
    """Height kx, ky [m] of the bow along x and y (z into the board), and the relative error of the pitch [1]."""
    bend: Float[Array, " functions"] = eqx.field(default_factory=lambda: np.zeros(0))
    """Coefficients [m] of `bend_functions`, heights beside the bow; empty for a board that is a parabola."""

    def height(self, xy: Float[Array, "*n 2"]) -> Float[Array, "*n"]:
        """z [m]: kx (1 - x'^2) + ky (1 - y'^2) and the bend, with x', y' = +-1 at the outer corners.

        Source: mrcal's `calobject_warp`.
        """
        rise = self.rise(xy)
        z = self.shape[0] * rise[..., 0] + self.shape[1] * rise[..., 1]
        if self.bend.shape[0]:
            bends = self.bends(xy)
            z = z + sum(self.bend[k] * bends[..., k] for k in range(self.bend.shape[0]))
        return namespace(z).asarray(z)

    def bends(self, xy: Float[Array, "*n 2"]) -> Float[Array, "*n functions"]:
        """Derivatives of the height by the coefficients of the bend [1]."""
        return namespace(self, xy).stack(bend_functions(self._place(xy)), -1)

    def rise(self, xy: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
        """Derivatives of the height by kx and ky [1]."""
        a = self._place(xy)
        return 1.0 - a * a

    def point(self, xy: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """Points of the board [m], board frame."""
        pitch = 1.0 + self.shape[2]
        return namespace(self, xy).stack([xy[..., 0] * pitch, xy[..., 1] * pitch, self.height(xy)], -1)

    def slope(self, xy: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
        """Derivatives of the height by x and y [1]."""
        xp, place = namespace(self, xy), self._place(xy)
        by = [-2.0 * self.shape[k] * place[..., k] for k in range(2)]
        if self.bend.shape[0]:
            values, slopes = _polynomials(place)
            ways = ((slopes, values), (values, slopes))
            bends = [_products(along, across) for along, across in ways]
            by = [by[k] + sum(self.bend[n] * one for n, one in enumerate(bends[k])) for k in range(2)]
        return xp.stack([by[k] / self.frame[2 + k] for k in range(2)], -1)

    def normal(self, xy: Float[Array, "*n 2"]) -> Float[Array, "*n 3"]:
        """The surface's normal, scaled to z = 1, board frame; the error of the pitch is neglected."""
        slope = self.slope(xy)
        xp = namespace(slope)
        return xp.concatenate([-slope, xp.ones_like(slope[..., :1])], -1)

    def meet(
        self, pose: Float[Array, "... 4 4"], ray: Float[Array, "... 3"]
    ) -> tuple[Float[Array, "..."], Float[Array, "... 3"]]:
        """Intersection of rays from the camera and the board.

        Args:
            pose: T_cam_board.
            ray: Unit rays, camera frame.

        Returns:
            range_m: Distance along the ray [m]; undefined for a ray parallel to the board.
            point: In the board frame [m].
        """
        xp, back = namespace(self, pose, ray), invert(pose)
        origin, direction = back[..., :3, 3], turn(back[..., :3, :3], ray)
        along_z = xp.where(direction[..., 2] == 0, 1.0, direction[..., 2]).astype(direction.dtype)
        range_m = -origin[..., 2] / along_z
        for _ in range(_ROUNDS):
            xy = (origin[..., :2] + range_m[..., None] * direction[..., :2]) / (1.0 + self.shape[2])
            range_m = (self.height(xy) - origin[..., 2]) / along_z
        return xp.asarray(range_m), origin + range_m[..., None] * direction

    def _place(self, xy: Array) -> Array:
        """Coordinates that are +-1 at the outer corners [1]."""
        parts = [(xy[..., k] - self.frame[k]) / self.frame[2 + k] for k in range(2)]
        return namespace(self, xy).stack(parts, -1)


def bend_functions(place: Array) -> list[Array]:
    """Products of Chebyshev polynomials, up to `BEND_DEGREE` in total, the lowest degrees first.

    Beyond the outer corners each polynomial goes on as a straight line: nothing holds a higher power there.

    Args:
        place: Coordinates [..., 2], +-1 at the outer corners [1].

    Returns:
        28 arrays [...].
    """
    values, _ = _polynomials(place)
    return _products(values, values)


def _polynomials(place: Array) -> tuple[list[Array], list[Array]]:
    """Chebyshev polynomials of both coordinates, and their slopes [..., 2]."""
    inside = place.clip(-1.0, 1.0)
    values, slopes = [inside * 0.0 + 1.0, inside], [inside * 0.0, inside * 0.0 + 1.0]
    for _ in range(BEND_DEGREE - 1):
        slopes.append(2.0 * values[-1] + 2.0 * inside * slopes[-1] - slopes[-2])
        values.append(2.0 * inside * values[-1] - values[-2])
    return [value + (place - inside) * slope for value, slope in zip(values, slopes, strict=True)], slopes


def _products(along: list[Array], across: list[Array]) -> list[Array]:
    return [along[d - j][..., 0] * across[j][..., 1] for d in range(BEND_DEGREE + 1) for j in range(d + 1)]


def corner_frame(corners: Float[np.ndarray, "corners 3"]) -> Float[np.ndarray, "4"]:
    """Centre x, y and half extents in x, y of a board's corners [m]."""
    xy = corners[:, :2]
    return np.concatenate([(xy.min(0) + xy.max(0)) / 2, np.maximum(np.ptp(xy, axis=0) / 2, 1e-12)])
