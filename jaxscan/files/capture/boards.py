"""Tables of calibration boards in files; lengths in millimetres."""

from typing import Annotated, Literal

import pydantic

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
        """The board that the table describes."""
        return Charuco(
            columns=self.columns,
            rows=self.rows,
            square=self.square_mm / 1000,
            marker=self.marker_mm / 1000,
            dictionary=self.dictionary,
        )


class ChessboardTable(FileModel):
    """A plain chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"] = "chessboard"
    columns: Count
    rows: Count
    square_mm: Length

    def board(self) -> AbstractBoard:
        """The board that the table describes."""
        return Chessboard(columns=self.columns, rows=self.rows, square=self.square_mm / 1000)


BoardTable = Annotated[CharucoTable | ChessboardTable, pydantic.Field(discriminator="type")]
