"""capture.toml: what was recorded, with what, and of which board."""

import abc
import math
import os
from pathlib import Path
from typing import Annotated, Any, Literal

import pydantic
import tomli_w

from jaxscan.errors import CaptureError
from jaxscan.files.disk import (
    MEGABYTE,
    FileModel,
    ImageSize,
    Integer,
    Number,
    check,
    is_deep,
    load_toml,
    parse_toml,
    too_deep,
)
from jaxscan.geometry import (
    MOTIONS,
    AbstractBoard,
    AprilGrid,
    Carries,
    Charuco,
    Chessboard,
    Circles,
    StripeAxis,
    check_board,
    known_dictionary,
)
from jaxscan.geometry.scanner import Up
from jaxscan.stripes import DEEP_FORMATS, LaserColour, LaserLine, PixelFormat, Response, frame_rank, known_response


Count = Annotated[Integer, pydantic.Field(ge=1, le=1000)]
Length = Annotated[Number, pydantic.Field(gt=0)]


class _Board(FileModel):
    """A board of one kind; lengths in millimetres."""

    type: str
    columns: Count
    rows: Count

    @pydantic.model_validator(mode="after")
    def _possible(self) -> "_Board":
        check_board(self.board())
        return self

    @abc.abstractmethod
    def board(self) -> AbstractBoard:
        """The board that the table describes, in metres."""


class CharucoTable(_Board):
    """A ChArUco board; columns and rows count squares."""

    type: Literal["charuco"] = "charuco"
    square_mm: Length
    marker_mm: Length
    dictionary: Annotated[str, pydantic.AfterValidator(known_dictionary)] = "DICT_5X5_250"
    layout: Literal["standard", "legacy"] = "standard"
    """ "legacy": of OpenCV before 4.6; differs where the number of rows is even."""

    def board(self) -> AbstractBoard:
        square, marker = self.square_mm / 1000, self.marker_mm / 1000
        return Charuco(
            columns=self.columns,
            rows=self.rows,
            square=square,
            marker=marker,
            dictionary=self.dictionary,
            layout=self.layout,
        )


class ChessboardTable(_Board):
    """A plain chessboard; columns and rows count inner corners."""

    type: Literal["chessboard"] = "chessboard"
    square_mm: Length

    def board(self) -> AbstractBoard:
        return Chessboard(columns=self.columns, rows=self.rows, square=self.square_mm / 1000)


class CirclesTable(_Board):
    """A grid of circles; columns count the circles of a row."""

    type: Literal["circles"] = "circles"
    spacing_mm: Length
    """Distance of two rows. Neighbours in a row are as far apart, or, in an asymmetric grid, twice as far."""
    diameter_mm: Length
    layout: Literal["asymmetric", "symmetric"] = "asymmetric"

    def board(self) -> AbstractBoard:
        square, diameter = self.spacing_mm / 1000, self.diameter_mm / 1000
        return Circles(columns=self.columns, rows=self.rows, square=square, diameter=diameter, layout=self.layout)


class AprilGridTable(_Board):
    """A grid of AprilTags as Kalibr prints it; columns and rows count tags."""

    type: Literal["aprilgrid"] = "aprilgrid"
    tag_mm: Length
    gap_mm: Length

    def board(self) -> AbstractBoard:
        return AprilGrid(columns=self.columns, rows=self.rows, square=self.gap_mm / 1000, tag=self.tag_mm / 1000)


BoardTable = Annotated[
    CharucoTable | ChessboardTable | CirclesTable | AprilGridTable, pydantic.Field(discriminator="type")
]


CAPTURE_FORMAT: Literal["jaxscan-capture/1"] = "jaxscan-capture/1"
HEADER_NAME = "capture.toml"
MAX_HEADER_BYTES = MEGABYTE


def _supported(pixel_format: Any) -> Any:
    if isinstance(pixel_format, str) and pixel_format in DEEP_FORMATS:
        lying, bits = DEEP_FORMATS[pixel_format]
        raise ValueError(
            f'"{pixel_format}" is a format of cameras; a capture keeps such frames as levels of 8 bits, with '
            f'pixel_format = "{lying}" and bits = {bits}: import them by `jaxscan import`'
        )
    return pixel_format


def _listed(tables: Any) -> Any:
    return [tables] if isinstance(tables, dict | LaserTable) else tables


class CameraTable(ImageSize):
    """Size and kind of the images."""

    pixel_format: Annotated[PixelFormat, pydantic.BeforeValidator(_supported)]
    """How an image is to be read."""
    response: Annotated[Response, pydantic.AfterValidator(known_response)] = "linear"
    """"linear", or "srgb" or "gamma 2.2" (decoded before the fit)."""
    up: Up = "-v"
    shutter: Literal["global", "rolling"] | None = None
    """"rolling" where rows are exposed one after another; None if unknown."""
    compression: Literal["jpeg", "video"] | None = None
    """The lossy compression of the images before they were stored; None without one."""

    bits: Literal[10, 12, 14, 16] | None = None
    """Bits of a sample as the camera gave it, where frames are kept as levels (`split_levels`); None for 8."""

    def notes(self, compression: str | None) -> list[str]:
        """Notes on such images of a compression, a sentence each."""
        notes = []
        if compression is not None:
            kind = "JPEG files" if compression == "jpeg" else "a video"
            notes.append(
                f"the images come from {kind}: errors of neighbouring pixels belong together, and colour may have half "
                "the resolution, so sigmas are estimates; PNG images would be better."
            )
        if self.shutter == "rolling":
            notes.append(
                "the shutter is rolling: this does no harm where the table stood still for every image; where it "
                "turned, every row saw another angle."
            )
        return notes


class TurntableTable(FileModel):
    """The motion between records."""

    carries: Carries = "scanner"
    """What moves: the "scanner" on a turntable, the "object" in front of a fixed camera, a "linear" stage, or
    "nothing"."""
    angle_sigma_deg: Annotated[Number, pydantic.Field(ge=0, le=45)] | None = None
    """Standard deviation of where a table stops about the angle of its record [deg]; None: learned from boards."""
    position_sigma_mm: Annotated[Number, pydantic.Field(ge=0, lt=1000)] | None = None

    @pydantic.model_validator(mode="after")
    def _of_its_kind(self) -> "TurntableTable":
        unit = MOTIONS[self.carries].unit
        for key, value, wanted in (
            ("angle_sigma_deg", self.angle_sigma_deg, "rad"),
            ("position_sigma_mm", self.position_sigma_mm, "m"),
        ):
            if value is not None and unit != wanted:
                raise ValueError(f'{key}: found {value:g} with carries = "{self.carries}", which has none')
        return self

    @property
    def stop_sigma(self) -> float | None:
        """Standard deviation of stops about the positions of their records [rad or m]; None if not given."""
        if self.position_sigma_mm is not None:
            return self.position_sigma_mm / 1000.0
        return None if self.angle_sigma_deg is None else math.radians(self.angle_sigma_deg)


class LaserTable(FileModel):
    """One laser as the camera sees it."""

    name: Annotated[str, pydantic.Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")] = "laser"
    colour: LaserColour = "red"
    """Which channel of a colour camera sees it; "auto": the channel that shows it best."""
    stripe_axis: StripeAxis = "rows"
    """One stripe centre per image row ("rows"), or per image column ("columns")."""


class PlanTable(FileModel):
    """Plan of the acquisition."""

    steps: Annotated[Integer, pydantic.Field(ge=1)] | None = None


class CaptureHeader(FileModel):
    """The contents of `capture.toml`."""

    format: Literal["jaxscan-capture/1"] = CAPTURE_FORMAT
    kind: Literal["sweep", "calibration"]
    camera: CameraTable
    turntable: TurntableTable | None = None
    laser: Annotated[tuple[LaserTable, ...], pydantic.BeforeValidator(_listed), pydantic.Field(max_length=16)] = ()
    board: BoardTable | None = None
    plan: PlanTable | None = None
    acquisition: dict[str, Any] = pydantic.Field(default_factory=dict)

    @pydantic.model_validator(mode="after")
    def _complete(self) -> "CaptureHeader":
        names = [laser.name for laser in self.laser]
        if len(set(names)) < len(names):
            raise ValueError(f"laser: found the names {', '.join(names)}, expected no name twice")
        if self.kind == "sweep" and not self.laser:
            raise ValueError("laser: missing, a sweep needs a [[laser]] table")
        if self.kind == "sweep" and self.board is not None:
            raise ValueError('board: found in a sweep, expected only where kind = "calibration"')
        if self.kind == "calibration" and self.board is None:
            raise ValueError("board: missing, a calibration capture needs a [board] table")
        return self

    @property
    def lasers(self) -> tuple[LaserLine, ...]:
        """The lasers as the stripe extraction takes them."""
        return tuple(LaserLine(one.name, one.colour, one.stripe_axis) for one in self.laser)


def frame_shape(header: CaptureHeader) -> tuple[int, ...]:
    """Shape of one image: (rows, columns), or (rows, columns, 3)."""
    return (header.camera.height, header.camera.width, 3)[: frame_rank(header.camera.pixel_format)]


def image_limit(header: CaptureHeader) -> int:
    """Largest size of an image's file [bytes]: an uncompressed 32-bit image with a megabyte of metadata fits."""
    return 4 * header.camera.width * header.camera.height + MEGABYTE


def parse_header(data: bytes, *, name: str) -> CaptureHeader:
    """A header from the bytes of its file.

    Raises:
        CaptureError: One line with the key, the value found and the values allowed.
    """
    tables = parse_toml(data, name=name, error=CaptureError)
    for key in ("format", "kind"):
        if key not in tables:
            raise CaptureError(f'{name}: {key}: missing, so this is no capture ("{CAPTURE_FORMAT}").')
    return check(CaptureHeader, tables, name=name, error=CaptureError)


def header_toml(header: CaptureHeader) -> bytes:
    """The bytes of the file of a header.

    Raises:
        CaptureError: If `acquisition` holds a value that TOML cannot hold, or is too large or nested too deeply to be
            read again.
    """
    tables = header.model_dump(exclude_none=True)
    lasers = tables.pop("laser")
    first: dict[str, Any] = {key: tables.pop(key) for key in ("format", "kind", "camera", "turntable") if key in tables}
    try:
        text = [tomli_w.dumps(first)]
        # One [[laser]] table each, as people write them.
        text += ["[[laser]]\n" + tomli_w.dumps(laser) for laser in lasers]
        text += [tomli_w.dumps({key: table}) for key, table in tables.items() if table]
    except RecursionError as problem:
        raise CaptureError(too_deep("acquisition")) from problem
    except (TypeError, ValueError) as problem:
        raise CaptureError(f"acquisition: cannot be written as TOML: {problem}.") from problem
    data = "\n".join(text).encode()
    if len(data) > MAX_HEADER_BYTES:
        raise CaptureError(f"acquisition: the header has {len(data)} bytes, expected at most {MAX_HEADER_BYTES}.")
    if is_deep(tables):
        raise CaptureError(too_deep("acquisition"))
    return data


class _WithBoard(FileModel):
    """Any file that describes a board."""

    model_config = pydantic.ConfigDict(extra="ignore")

    board: BoardTable


def load_board(path: str | Path) -> AbstractBoard:
    """The board that a file describes in its table `[board]`.

    Args:
        path: A TOML file: the header of a capture, the configuration of a rig, or the table alone; or the folder of
            a capture.

    Returns:
        The board.

    Raises:
        ConfigError: If the file cannot be read, or describes no board.
    """
    path = Path(path)
    return load_toml(path / HEADER_NAME if os.path.isdir(path) else path, _WithBoard).board.board()
