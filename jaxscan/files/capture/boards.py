"""Tables of calibration boards in files; lengths in millimetres."""

from typing import Annotated, Literal

import pydantic

from jaxscan.files.disk import FileModel, Integer, Number
from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, Circles, check_board, known_dictionary


Count = Annotated[Integer, pydantic.Field(ge=1, le=1000)]
Length = Annotated[Number, pydantic.Field(gt=0)]


class CharucoTable(FileModel):
    """A ChArUco board; columns and rows count squares."""

    type: Literal["charuco"] = "charuco"
    columns: Count
    rows: Count
    square_mm: Length
    marker_mm: Length
    dictionary: Annotated[str, pydantic.AfterValidator(known_dictionary)] = "DICT_5X5_250"
    layout: Literal["standard", "legacy"] = "standard"
    """ "legacy": of OpenCV before 4.6; differs where the number of rows is even."""

    @pydantic.model_validator(mode="after")
    def _possible(self) -> "CharucoTable":
        check_board(self.board())
        return self

    def board(self) -> AbstractBoard:
        """The board that the table describes."""
        return Charuco(
            columns=self.columns,
            rows=self.rows,
            square=self.square_mm / 1000,
            marker=self.marker_mm / 1000,
            dictionary=self.dictionary,
            layout=self.layout,
        )


class ChessboardTable(FileModel):
    """A plain chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"] = "chessboard"
    columns: Count
    rows: Count
    square_mm: Length

    @pydantic.model_validator(mode="after")
    def _possible(self) -> "ChessboardTable":
        check_board(self.board())
        return self

    def board(self) -> AbstractBoard:
        """The board that the table describes."""
        return Chessboard(columns=self.columns, rows=self.rows, square=self.square_mm / 1000)


class CirclesTable(FileModel):
    """A grid of circles; columns count the circles of a row."""

    type: Literal["circles"] = "circles"
    columns: Count
    rows: Count
    spacing_mm: Length
    """Distance of two rows; of neighbours in a row too, or, asymmetric, half of that."""
    diameter_mm: Length
    layout: Literal["asymmetric", "symmetric"] = "asymmetric"

    @pydantic.model_validator(mode="after")
    def _possible(self) -> "CirclesTable":
        check_board(self.board())
        return self

    def board(self) -> AbstractBoard:
        """The board that the table describes."""
        return Circles(
            columns=self.columns,
            rows=self.rows,
            square=self.spacing_mm / 1000,
            diameter=self.diameter_mm / 1000,
            layout=self.layout,
        )


class AprilGridTable(FileModel):
    """A grid of AprilTags as Kalibr prints it; columns and rows count tags."""

    type: Literal["aprilgrid"] = "aprilgrid"
    columns: Count
    rows: Count
    tag_mm: Length
    gap_mm: Length
    """Distance of neighbouring tags."""

    @pydantic.model_validator(mode="after")
    def _possible(self) -> "AprilGridTable":
        check_board(self.board())
        return self

    def board(self) -> AbstractBoard:
        """The board that the table describes."""
        return AprilGrid(columns=self.columns, rows=self.rows, square=self.gap_mm / 1000, tag=self.tag_mm / 1000)


BoardTable = Annotated[
    CharucoTable | ChessboardTable | CirclesTable | AprilGridTable, pydantic.Field(discriminator="type")
]
