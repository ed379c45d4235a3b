"""Calibration boards as files have them: a table each, in millimetres."""

from typing import Annotated, Literal

import pydantic

from jaxscan.errors import CaptureError
from jaxscan.files.disk import FileModel, Integer, Number
from jaxscan.geometry import AbstractBoard, Charuco, Chessboard


Count = Annotated[Integer, pydantic.Field(ge=2, le=1000)]
Length = Annotated[Number, pydantic.Field(gt=0)]


class CharucoTable(FileModel):
    """A ChArUco board; columns and rows count squares."""

    type: Literal["charuco"] = "charuco"
    columns: Count
    rows: Count
    square_mm: Length
    marker_mm: Length
    dictionary: Annotated[str, pydantic.Field(pattern=r"^DICT_\w+$", max_length=64)] = "DICT_5X5_250"

    @pydantic.model_validator(mode="after")
    def _marker_fits(self) -> "CharucoTable":
        if self.marker_mm >= self.square_mm:
            raise ValueError(f"marker_mm = {self.marker_mm:g} must be smaller than square_mm = {self.square_mm:g}")
        return self

    def board(self) -> AbstractBoard:
        """The board of the geometry."""
        return Charuco(self.columns, self.rows, self.square_mm / 1000, self.marker_mm / 1000, self.dictionary)


class ChessboardTable(FileModel):
    """A plain chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"] = "chessboard"
    columns: Count
    rows: Count
    square_mm: Length

    def board(self) -> AbstractBoard:
        """The board of the geometry."""
        return Chessboard(self.columns, self.rows, self.square_mm / 1000)


BoardTable = Annotated[CharucoTable | ChessboardTable, pydantic.Field(discriminator="type")]


def board_table(board: AbstractBoard) -> CharucoTable | ChessboardTable:
    """The table of a board.

    Raises:
        CaptureError: If the board is of a kind that files do not know.
    """
    if isinstance(board, Charuco):
        marker = {"marker_mm": 1000 * board.marker, "dictionary": board.dictionary}
        return CharucoTable(columns=board.columns, rows=board.rows, square_mm=1000 * board.square, **marker)
    if isinstance(board, Chessboard):
        return ChessboardTable(columns=board.columns, rows=board.rows, square_mm=1000 * board.square)
    raise CaptureError(f"A board of type {type(board).__name__} has no place in files yet.")
