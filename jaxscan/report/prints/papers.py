"""Sizes of paper, and how many sheets of one a board needs."""

import math
from typing import Literal, NamedTuple, get_args

from jaxscan.errors import OptionError


Paper = Literal["A4", "A3", "A2", "A1", "letter"]
PAPERS: tuple[Paper, ...] = get_args(Paper)
_SIZES_MM: dict[Paper, tuple[float, float]] = {
    "A4": (210.0, 297.0),
    "A3": (297.0, 420.0),
    "A2": (420.0, 594.0),
    "A1": (594.0, 841.0),
    "letter": (215.9, 279.4),
}
"""Width and height."""
MARGIN_MM = 6.0
"""What printers leave white, and a little more."""
GAP_MM, FOOTER_MM = 4.0, 11.0
"""White under the board, and the lines of text below that."""
MARKS_MM = 6.0
"""Room for marks round the part of a board that is cut out of several sheets."""
OVERLAP_MM = 12.0
_MOST_SHEETS = 100
_ROUNDING_MM = 1e-6


class Layout(NamedTuple):
    """Sheets of one size, in columns and rows, and the part of the board on each; millimetres."""

    page: tuple[float, float]
    columns: int
    rows: int
    tile: tuple[float, float]
    """Width and height of the part of a sheet, with what it shares with its neighbours."""

    @property
    def sheets(self) -> int:
        """Number of sheets."""
        return self.columns * self.rows


def lay_out(size: tuple[float, float], paper: Paper) -> Layout:
    """The fewest sheets that hold a board of this size [mm], upright or across.

    Raises:
        OptionError: If there are too many, with a paper that needs fewer.
    """
    layout = _fewest(size, paper)
    if layout.sheets > _MOST_SHEETS:
        raise OptionError(
            f"--paper {paper}: the board of {size[0]:g} x {size[1]:g} mm needs {layout.sheets} sheets, expected at "
            f"most {_MOST_SHEETS}; choose a larger paper or a smaller board."
        )
    return layout


def one_sheet(size: tuple[float, float]) -> Paper | None:
    """The smallest paper that holds a board of this size [mm] in one sheet, if there is one."""
    fitting = [paper for paper in PAPERS if _fewest(size, paper).sheets == 1]
    return min(fitting, key=lambda paper: math.prod(_SIZES_MM[paper]), default=None)


def _fewest(size: tuple[float, float], paper: Paper) -> Layout:
    short, long = _SIZES_MM[paper]
    # Of equals the first: the one that lies as the board does.
    pages = [(short, long), (long, short)] if size[0] <= size[1] else [(long, short), (short, long)]
    return min((_sheets(size, page) for page in pages), key=lambda layout: layout.sheets)


def _sheets(size: tuple[float, float], page: tuple[float, float]) -> Layout:
    free = (page[0] - 2 * MARGIN_MM, page[1] - 2 * MARGIN_MM - GAP_MM - FOOTER_MM)
    if all(length <= room + _ROUNDING_MM for length, room in zip(size, free, strict=True)):
        return Layout(page, 1, 1, size)
    free = (free[0] - 2 * MARKS_MM, free[1] - 2 * MARKS_MM)
    count, tile = [], []
    for length, room in zip(size, free, strict=True):
        count.append(max(1, math.ceil((length - OVERLAP_MM - _ROUNDING_MM) / (room - OVERLAP_MM))))
        tile.append((length + (count[-1] - 1) * OVERLAP_MM) / count[-1])
    return Layout(page, count[0], count[1], (tile[0], tile[1]))
