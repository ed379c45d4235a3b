"""Configuration of the calibration board and its views."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, field_validator, model_validator

from jaxscan.geometry import AbstractBoard, AprilGrid, Charuco, Chessboard, check_board, known_dictionary
from jaxscan.simulation.settings.numbers import Albedo, Angle, Distance, Level, Millimetres, Pair, Place, Section, Share


class BoardsSpec(Section):
    """The calibration board and how it is shown to the rig."""

    type: Literal["charuco", "chessboard", "aprilgrid"] = "charuco"
    columns: Annotated[int, Field(ge=1, le=1000)] = 12
    """Squares of a ChArUco board; inner corners of a chessboard; tags of an AprilGrid."""
    rows: Annotated[int, Field(ge=1, le=1000)] = 9
    square_mm: Millimetres = 30.0
    marker_mm: Millimetres = 22.0
    dictionary: Annotated[str, AfterValidator(known_dictionary)] = "DICT_5X5_250"
    tag_mm: Millimetres = 40.0
    """Of an AprilGrid, as is the distance of its tags."""
    gap_mm: Millimetres = 12.0
    border_mm: Annotated[float, Field(ge=0, le=1e4)] = 15.0
    """White margin around the printed area."""
    warp_mm: tuple[Place, Place] = (0.0, 0.0)
    """kx, ky of z = kx (1 - x^2) + ky (1 - y^2), with x, y = +-1 at the outermost corners."""
    ink: Albedo = 0.09
    paper: Albedo = 0.85
    uneven: Share = 0.0
    """How far ink and paper differ over the board, as a share of their albedo."""
    print_blur_mm: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Standard deviation of the print's own blur."""
    gloss: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Lamination: its reflection of lamp and laser in the middle of its lobe, as an albedo."""
    gloss_deg: Annotated[float, Field(ge=0.5, le=45)] = 6.0
    """Width of the lobe (standard deviation): angle between the board's normal and the bisector of light and view."""
    free_views: Annotated[int, Field(ge=0, le=1000)] = 30
    """Two of three are crossed by a stripe; every third fills the rest of the image."""
    placements: Annotated[int, Field(ge=0, le=200)] = 4
    angles: Annotated[int, Field(ge=1, le=360)] = 9
    """Table angles at which each placement is seen, spread over the field of view."""
    range_m: tuple[Distance, Distance] = (0.8, 2.5)
    tilt_deg: tuple[Angle, Angle] = (20.0, 45.0)
    peak_dn: Level = 120.0
    """Peak of the stripe on the board's white: the laser's power is set for each view."""
    white_dn: Level = 105.0
    """Level of a white surface in mean light while boards are shown."""

    @field_validator("range_m", "tilt_deg")
    @classmethod
    def _ascending(cls, value: Pair) -> Pair:
        if value[0] > value[1]:
            raise ValueError(f"must be [smallest, largest], got {list(value)}")
        return value

    @model_validator(mode="after")
    def _possible(self) -> "BoardsSpec":
        check_board(self.board())
        return self

    def table(self) -> dict[str, Any]:
        """The board as the header of a capture describes it."""
        lengths = {
            "charuco": {"square_mm", "marker_mm", "dictionary"},
            "chessboard": {"square_mm"},
            "aprilgrid": {"tag_mm", "gap_mm"},
        }
        return self.model_dump(include={"type", "columns", "rows"} | lengths[self.type])

    def board(self) -> AbstractBoard:
        """The board of the geometry, for corners and outline."""
        columns, rows, square = self.columns, self.rows, self.square_mm / 1000
        if self.type == "chessboard":
            return Chessboard(columns=columns, rows=rows, square=square)
        if self.type == "aprilgrid":
            return AprilGrid(columns=columns, rows=rows, square=self.gap_mm / 1000, tag=self.tag_mm / 1000)
        return Charuco(
            columns=columns, rows=rows, square=square, marker=self.marker_mm / 1000, dictionary=self.dictionary
        )
