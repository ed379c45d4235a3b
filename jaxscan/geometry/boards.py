"""Calibration boards: their corners and their surface.

The board frame has its origin at a corner, x along the rows of squares, y down the columns, z
into the board, so a board seen upright has the camera's axes. Corner k stands at column
`k % columns`, row `k // columns` of the corners' grid, for every kind.
"""

import abc
import difflib
from typing import Literal, NamedTuple

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


class AprilGrid(AbstractBoard):
    """AprilTags (36h11) in rows, with small black squares between their corners. Origin at the top left tag's corner.

    The four corners of every tag are the board's corners: 2 `columns` by 2 `rows` of them. Tag numbers run along the
    rows from 0, from the bottom left tag upwards as Kalibr prints them, or from the top left one downwards.
    """

    columns: int = eqx.field(static=True)
    """Tags in a row."""
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Side of the small squares, which is the gap between neighbouring tags [m]; Kalibr's `tagSpacing` is square / tag.
    """
    tag: float = eqx.field(static=True)
    """Side of a tag [m]."""

    def grid(self) -> tuple[int, int]:
        return 2 * self.columns, 2 * self.rows

    def places(self) -> np.ndarray:
        number = even_grid(*self.grid())
        return np.floor(number / 2) * (self.tag + self.square) + number % 2 * self.tag

    def describe(self) -> str:
        return f"AprilGrid, {self.columns} x {self.rows} tags, {1e3 * self.tag:g} mm, {1e3 * self.square:g} mm apart"


class Circles(AbstractBoard):
    """Black circles in rows. Origin at circle 0.

    In the asymmetric layout every other row is shifted by half the distance of its circles: circle k stands at
    x = (2 column + row % 2) square, y = row * square, and the number of rows is odd, else the board would look the same
    turned by 180 degrees. In the symmetric layout x = column * square, and it does look the same.
    """

    columns: int = eqx.field(static=True)
    """Circles in a row."""
    rows: int = eqx.field(static=True)
    square: float = eqx.field(static=True)
    """Distance of two rows [m]. Neighbours in a row are as far apart, or, in an asymmetric grid, twice as far."""
    diameter: float = eqx.field(static=True)
    """Diameter of a circle [m]."""
    layout: Literal["asymmetric", "symmetric"] = eqx.field(static=True, default="asymmetric")

    def grid(self) -> tuple[int, int]:
        return self.columns, self.rows

    def places(self) -> np.ndarray:
        column, row = even_grid(self.columns, self.rows).T
        x = column if self.layout == "symmetric" else 2 * column + row % 2
        return np.stack([x, row], -1) * self.square

    def nearest(self) -> float:
        """Distance of a circle's centre to the nearest other one [m]."""
        return self.square * (1.0 if self.layout == "symmetric" else np.sqrt(2.0))

    def describe(self) -> str:
        return f"{self.layout} grid of circles, {self.columns} x {self.rows} circles, {1e3 * self.square:g} mm"


DICTIONARIES: dict[str, int] = {
    **{f"DICT_{bits}X{bits}_{markers}": markers for bits in (4, 5, 6, 7) for markers in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    **{"DICT_APRILTAG_16h5": 30, "DICT_APRILTAG_25h9": 35, "DICT_APRILTAG_36h10": 2320, "DICT_APRILTAG_36h11": 587},
    **{"DICT_APRILTAG_16H5": 30, "DICT_APRILTAG_25H9": 35, "DICT_APRILTAG_36H10": 2320, "DICT_APRILTAG_36H11": 587},
    **{"DICT_ARUCO_MIP_36h12": 250, "DICT_ARUCO_MIP_36H12": 250},
}
"""Number of markers in each of OpenCV's dictionaries."""
SMALLEST_COUNT = 3
"""Least columns and rows: fewer corners show no plane."""
MOST_CORNERS = 10_000
SMALLEST_MARKER = 0.2
"""Least side of a marker, in sides of a square."""
APRIL_TAGS = "DICT_APRILTAG_36h11"
"""The tags of an AprilGrid."""
CIRCLE_SHARES = (0.15, 0.9)
"""Diameters of circles, in distances of their centres."""
GAP_SHARES = (0.1, 2.0)
"""Distances between tags, in sides of a tag."""
SMALLEST_MM, LARGEST_MM = 0.01, 10_000.0
"""Range of the sides of squares and markers, mm."""


def known_dictionary(name: str) -> str:
    """The name of a dictionary, if there is one of this name.

    Raises:
        ValueError: With the closest known name.
    """
    if name in DICTIONARIES:
        return name
    closest = difflib.get_close_matches(name[:64], DICTIONARIES, n=1, cutoff=0.0)
    raise ValueError(f'found "{name[:60]}", expected a dictionary of OpenCV; the closest known one is "{closest[0]}"')


def check_board(board: AbstractBoard) -> None:
    """Check that a board can be printed and found.

    Raises:
        ValueError: If it has too few or too many corners, or more markers than its dictionary, or no usual size.
    """
    columns, rows = board.grid()
    if columns * rows > MOST_CORNERS:
        raise ValueError(f"columns and rows: found {columns} x {rows} inner corners, expected at most {MOST_CORNERS}")
    lengths_mm, least = {"square_mm": 1000 * board.square}, (SMALLEST_COUNT, SMALLEST_COUNT)
    if isinstance(board, Charuco):
        lengths_mm["marker_mm"] = 1000 * board.marker
        _check_markers(board)
        columns, rows = board.columns, board.rows
    elif isinstance(board, Circles):
        lengths_mm = {"spacing_mm": 1000 * board.square, "diameter_mm": 1000 * board.diameter}
        least = (2, SMALLEST_COUNT)
        if board.layout == "asymmetric" and rows % 2 == 0:
            raise ValueError(
                f"rows: found {rows}, expected an odd number: this grid of circles looks the same turned by 180 degrees"
            )
    elif isinstance(board, AprilGrid):
        lengths_mm, least = {"tag_mm": 1000 * board.tag, "gap_mm": 1000 * board.square}, (2, 2)
        columns, rows = board.columns, board.rows
        if columns * rows > DICTIONARIES[APRIL_TAGS]:
            raise ValueError(f"columns and rows: {columns} x {rows} tags, and there are {DICTIONARIES[APRIL_TAGS]}")
    if columns < least[0] or rows < least[1]:
        needed = f"{least[0]} each" if least[0] == least[1] else f"{least[0]} x {least[1]}"
        raise ValueError(f"columns and rows: found {columns} x {rows}, expected at least {needed}")
    for name, length in lengths_mm.items():
        # Metres and back cost a rounding.
        if not SMALLEST_MM * (1 - 1e-9) <= length <= LARGEST_MM * (1 + 1e-9):
            raise ValueError(f"{name}: found {length:g}, expected {SMALLEST_MM:g} to {LARGEST_MM:g}")
    _check_shares(board)


def _check_markers(board: Charuco) -> None:
    needed, there = board.columns * board.rows // 2, DICTIONARIES[known_dictionary(board.dictionary)]
    if needed > there:
        raise ValueError(
            f"dictionary: {board.columns} x {board.rows} squares need {needed} markers, and {board.dictionary} has "
            f"{there}"
        )
    if board.marker >= board.square:
        raise ValueError(
            f"marker_mm = {1000 * board.marker:g} must be smaller than square_mm = {1000 * board.square:g}"
        )


def _check_shares(board: AbstractBoard) -> None:
    """Check that a camera can tell the parts of a board from one another."""
    if isinstance(board, Charuco) and board.marker < SMALLEST_MARKER * board.square:
        raise ValueError(
            f"marker_mm = {1000 * board.marker:g} must be at least {SMALLEST_MARKER:g} of square_mm = "
            f"{1000 * board.square:g}, or no camera reads it"
        )
    if isinstance(board, Circles):
        low, high = (share * board.nearest() for share in CIRCLE_SHARES)
        if not low <= board.diameter <= high:
            raise ValueError(
                f"diameter_mm: found {1000 * board.diameter:g}, expected {1000 * low:g} to {1000 * high:g} for circles "
                f"with spacing_mm = {1000 * board.square:g}"
            )
    if isinstance(board, AprilGrid) and not GAP_SHARES[0] <= board.square / board.tag <= GAP_SHARES[1]:
        raise ValueError(
            f"gap_mm: found {1000 * board.square:g}, expected {1000 * GAP_SHARES[0] * board.tag:g} to "
            f"{1000 * GAP_SHARES[1] * board.tag:g} for tag_mm = {1000 * board.tag:g}"
        )


class BoardPicture(NamedTuple):
    """The printed area as a grid of small elements."""

    paper: Float[np.ndarray, "rows columns"]
    """Share of paper, float32: 0 ink, 1 paper."""
    low: np.ndarray
    """Least x and y of the printed area [2], m."""
    high: np.ndarray
    """Greatest x and y [2], m."""

    @staticmethod
    def of(board: AbstractBoard, paper: Float[np.ndarray, "rows columns"]) -> "BoardPicture":
        """The picture of a board's `outline()`, row 0 at y0, column 0 at x0."""
        outline = board.outline()
        return BoardPicture(np.ascontiguousarray(paper, np.float32), outline.min(0), outline.max(0))

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Share of paper at board coordinates [m], linear between elements; beyond the print that of its rim."""
        rows, columns = self.paper.shape
        across = _element(x, self.low[0], self.high[0], columns)
        down = _element(y, self.low[1], self.high[1], rows)
        j, i = across.astype(np.int32), down.astype(np.int32)
        across -= j
        down -= i
        flat, place = self.paper.ravel(), i * np.int32(columns) + j
        upper, lower = flat[place], flat[place + np.int32(columns)]
        upper += across * (flat[place + 1] - upper)
        lower += across * (flat[place + np.int32(columns + 1)] - lower)
        upper += down * (lower - upper)
        return upper

    def holds(self, xy: np.ndarray) -> np.ndarray:
        """Whether board coordinates [..., 2], m, are on the printed area, bool [...]."""
        return np.all((xy >= self.low) & (xy <= self.high), axis=-1)


def _element(x: np.ndarray, low: float, high: float, count: int) -> np.ndarray:
    """Coordinate in elements, within the picture, float32."""
    scale = count / (high - low)
    return np.clip((x - np.float32(low)) * np.float32(scale) - np.float32(0.5), 0.0, np.float32(count - 1.001))
