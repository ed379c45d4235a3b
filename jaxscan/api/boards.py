"""Calibration boards on paper."""

import functools
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxscan.errors import OptionError, OutputError
from jaxscan.files.disk import Part, write_together
from jaxscan.geometry import AbstractBoard


if TYPE_CHECKING:
    from jaxscan.report.prints import Page, Paper


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
        OutputError: If a file cannot be written.
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
    write_together(
        {path: functools.partial(_write, content=content) for path, content in sheets.files.items()}, error=OutputError
    )
    return list(sheets.files)


def _write(part: Part, *, content: bytes) -> None:
    part.write_bytes(content)
