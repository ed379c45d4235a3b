"""Drawings of rooms from clouds, and their files."""

from collections.abc import Callable
from pathlib import Path

from jaxscan.drawing import Drawing
from jaxscan.errors import OutputError
from jaxscan.files.disk import Part, check_writable, write_atomically
from jaxscan.files.drawings import check_dxf, svg_of, write_dxf


def _write_svg(drawing: Drawing, path: Part) -> None:
    path.write_bytes(svg_of(drawing))


def _write_pdf(drawing: Drawing, path: Part) -> None:
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.report import pdf_of

    path.write_bytes(pdf_of(drawing))


WRITERS: dict[str, Callable[[Drawing, Part], None]] = {".dxf": write_dxf, ".svg": _write_svg, ".pdf": _write_pdf}


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
    write_atomically(path, lambda part: writer(drawing, part), error=OutputError)
