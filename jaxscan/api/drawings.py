"""Drawings as files: of rooms, and of calibration boards on paper."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxscan.drawing import Drawing
from jaxscan.errors import OptionError, OutputError
from jaxscan.files.disk import Part, check_writable, write_atomically, write_together
from jaxscan.files.drawings import check_dxf, svg_of, write_dxf
from jaxscan.geometry import AbstractBoard


if TYPE_CHECKING:
    from jaxscan.report.prints import Page, Paper


def _write_pdf(drawing: Drawing, path: Part) -> None:
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.report import pdf_of

    path.write_bytes(pdf_of(drawing))


WRITERS: dict[str, Callable[[Drawing, Part], object]] = {
    ".dxf": write_dxf,
    ".svg": lambda drawing, path: path.write_bytes(svg_of(drawing)),
    ".pdf": _write_pdf,
}


def check_drawing_path(path: str | Path) -> None:
    """Check that a drawing can be written under this name, before it is made.

    Raises:
        OutputError: If the suffix is unknown, or nothing can be written there.
        DependencyError: If the format needs a library that is not installed.
    """
    if Path(path).suffix.lower() not in WRITERS:
        raise OutputError(f'{path}: cannot write "{Path(path).suffix}", known are {", ".join(WRITERS)}.')
    check_writable(path, error=OutputError)
    if Path(path).suffix.lower() == ".dxf":
        check_dxf()


def save_drawing(drawing: Drawing, path: str | Path) -> None:
    """Write a drawing as DXF (metres, layers, dimensions), SVG or PDF (both 1 : 50).

    Args:
        drawing: As `draw_plan` or `draw_section` make it.
        path: Its suffix is .dxf, .svg or .pdf. An existing file is replaced when the new one is complete.

    Raises:
        OutputError: If the suffix is unknown or the file cannot be written. Then nothing has changed.
        DependencyError: If the format needs a library that is not installed.
    """
    check_drawing_path(path)
    writer = WRITERS[Path(path).suffix.lower()]

    def write(part: Part) -> None:
        writer(drawing, part)

    write_atomically(path, write, error=OutputError)


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
