"""Drawings as files: of rooms, and of calibration boards on paper."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxscan.drawing import Drawing, Sheet, Survey
from jaxscan.errors import OptionError, OutputError
from jaxscan.files.disk import check_writable, write_atomically, write_together
from jaxscan.files.drawings import check_dxf, svg_of, write_dxf
from jaxscan.files.ifc import check_ifc, write_ifc
from jaxscan.geometry import AbstractBoard


if TYPE_CHECKING:
    from jaxscan.report.prints import Page, Paper


DPI = 200.0
"""Dots per inch of a picture."""
FINEST_DPI = 1200.0


SUFFIXES = (".dxf", ".svg", ".pdf", ".png")


def check_drawing_path(path: str | Path) -> None:
    """Check that a drawing can be written under this name, before it is made.

    Raises:
        OutputError: If the suffix is unknown, or nothing can be written there.
        DependencyError: If the format needs a library that is not installed.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        raise OutputError(f'{path}: cannot write "{Path(path).suffix}", known are {", ".join(SUFFIXES)}.')
    check_writable(path, error=OutputError)
    if Path(path).suffix.lower() == ".dxf":
        check_dxf()


def save_drawing(drawing: Drawing, path: str | Path, *, dpi: float = DPI) -> None:
    """Write a drawing as DXF (metres, layers, dimensions, the sheet as a layout), or its sheet as SVG, PDF or PNG.

    Args:
        drawing: As `draw_plan` or `draw_section` make it.
        path: Its suffix is .dxf, .svg, .pdf or .png. An existing file is replaced when the new one is complete.
        dpi: Dots per inch of a PNG.

    Raises:
        OutputError: If the suffix is unknown or the file cannot be written. Then nothing has changed.
        DependencyError: If the format needs a library that is not installed.
        OptionError: If a picture would be too large.
    """
    check_drawing_path(path)
    if not 20.0 <= dpi <= FINEST_DPI:
        raise OptionError(f"--dpi: found {dpi:g}, expected 20 to {FINEST_DPI:g}.")
    suffix = Path(path).suffix.lower()
    if suffix == ".dxf":
        write_atomically(path, lambda part: write_dxf(drawing, part), error=OutputError)
        return
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.report import pdf_of, png_of

    content = svg_of(drawing) if suffix == ".svg" else pdf_of(drawing) if suffix == ".pdf" else png_of(drawing, dpi)
    write_atomically(path, content, error=OutputError)


def check_ifc_path(path: str | Path) -> None:
    """Check that a model can be written under this name, before it is made.

    Raises:
        OutputError: If the suffix is not .ifc, or nothing can be written there.
        DependencyError: If ifcopenshell is not installed.
    """
    if Path(path).suffix.lower() != ".ifc":
        raise OutputError(f'{path}: cannot write "{Path(path).suffix}", known is .ifc.')
    check_writable(path, error=OutputError)
    check_ifc()


def save_ifc(survey: Survey, path: str | Path, *, sheet: Sheet | None = None) -> None:
    """Write a room as IFC 4: its space, walls, doors and windows, with the sigmas of what was measured.

    Args:
        survey: The room, of `survey_room`.
        path: Ends in .ifc. An existing file is replaced when the new one is complete.
        sheet: Names, date and north, as on a drawing.

    Raises:
        OutputError: If the suffix is not .ifc or the file cannot be written. Then nothing has changed.
        DependencyError: If ifcopenshell is not installed.
        MeasurementError: If no wall was seen.
    """
    check_ifc_path(path)
    write_atomically(path, lambda part: write_ifc(survey, sheet or Sheet(), part), error=OutputError)


class BoardSheets(NamedTuple):
    """The sheets of a board, ready to be written."""

    files: dict[Path, bytes]
    """One PDF with all sheets, or an SVG for each."""
    pages: "list[Page]"
    notes: list[str]
    """What to know before they are printed."""


def save_board(board: AbstractBoard, path: str | Path, *, paper: "Paper" = "A4") -> list[Path]:
    """Draw a calibration board in true size, on as many sheets as it needs.

    Args:
        board: The board.
        path: The file: .pdf, or .svg, of which there is one for each sheet, numbered where there are several.
        paper: Size of the sheets.

    Returns:
        The files that were written.

    Raises:
        OptionError: If the suffix is another one, or the board needs more than a hundred sheets.
        OutputError: If a file cannot be written. Then there is none.
    """
    return write_sheets(draw_board(board, Path(path), paper))


def draw_board(board: AbstractBoard, path: Path, paper: "Paper") -> BoardSheets:
    """The sheets of a board, as `save_board` writes them.

    Raises:
        OptionError: If the suffix is neither .pdf nor .svg, or the board needs more than a hundred sheets.
    """
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.report.prints import board_pages, pdf_of, svg_of

    suffix = path.suffix.lower()
    if suffix not in (".pdf", ".svg"):
        raise OptionError(f"{path}: found the suffix {path.suffix!r}, expected .pdf or .svg.")
    pages, notes = board_pages(board, paper)
    title = board.describe()
    if suffix == ".pdf":
        return BoardSheets({path: pdf_of(pages, title)}, pages, notes)
    names = [path] if len(pages) == 1 else [path.with_stem(f"{path.stem}-{k + 1}") for k in range(len(pages))]
    return BoardSheets({name: svg_of(page, title) for name, page in zip(names, pages, strict=True)}, pages, notes)


def write_sheets(sheets: BoardSheets) -> list[Path]:
    """Write all sheets, or none.

    Raises:
        OutputError: If a file cannot be written.
    """
    write_together(dict(sheets.files), error=OutputError)
    return list(sheets.files)
