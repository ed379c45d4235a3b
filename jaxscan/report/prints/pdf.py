"""Sheets as PDF: filled rectangles and circles, and Helvetica, which every reader has.

Written out here: a plotting library would embed fonts, and cannot ask the reader to print without scaling.
"""

from collections.abc import Sequence

import numpy as np

from jaxscan.report.prints.numbers import decimal
from jaxscan.report.prints.pages import Page


_POINTS_PER_MM = 72 / 25.4
_ROUND = 4 / 3 * (np.sqrt(2) - 1)
"""Distance of the control points of a quarter of a circle, in radii; it is off by 0.03 % of a radius at most."""


def pdf_of(pages: Sequence[Page], title: str) -> bytes:
    """The file of some sheets, each a page in true size."""
    kids = " ".join(f"{4 + 2 * k} 0 R" for k in range(len(pages)))
    objects = [
        # Readers that heed it print in true size.
        "<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        f"<< /Type /Pages /Kids [{kids}] /Count {len(pages)} >>",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
    ]
    for k, page in enumerate(pages):
        size = f"{decimal(page.width * _POINTS_PER_MM)} {decimal(page.height * _POINTS_PER_MM)}"
        objects.append(
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size}] /Contents {5 + 2 * k} 0 R "
            "/Resources << /Font << /F1 3 0 R >> >> >>"
        )
        content = _content(page)
        objects.append(f"<< /Length {len(content.encode('cp1252'))} >>\nstream\n{content}\nendstream")
    objects.append(f"<< /Title ({_escaped(title)}) /Producer (jaxscan) >>")
    data, places = b"%PDF-1.6\n", []
    for number, body in enumerate(objects, 1):
        places.append(len(data))
        data += f"{number} 0 obj\n{body}\nendobj\n".encode("cp1252")
    table = "".join(f"{place:010d} 00000 n \n" for place in places)
    end = (
        f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R /Info {len(objects)} 0 R >>\nstartxref\n{len(data)}\n%%EOF\n"
    )
    return data + f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n{table}{end}".encode("cp1252")


def _content(page: Page) -> str:
    """The operators that draw a sheet, in millimetres with y down."""
    scale = f"{_POINTS_PER_MM:.10f}"
    lines = [f"{scale} 0 0 -{scale} 0 {decimal(page.height * _POINTS_PER_MM)} cm"]
    x0, y0, x1, y1 = page.window
    lines += ["q", f"{_rectangle(x0, y0, x1, y1)} W n"]
    # All in one path: where rectangles touch, no reader leaves a white hair between them.
    lines += [_rectangle(*box) for box in page.ink.rectangles]
    lines += [_circle(*circle) for circle in page.ink.circles]
    lines += ["f", "Q", *(_rectangle(*box) for box in page.rectangles), "f", "BT"]
    for text in page.texts:
        size = decimal(text.size)
        lines.append(f"/F1 1 Tf {size} 0 0 -{size} {decimal(text.x)} {decimal(text.y)} Tm ({_escaped(text.text)}) Tj")
    return "\n".join([*lines, "ET"])


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> str:
    return f"{decimal(x0)} {decimal(y0)} {decimal(x1 - x0)} {decimal(y1 - y0)} re"


def _circle(x: float, y: float, radius: float) -> str:
    reach = _ROUND * radius
    cos, sin = (1, 0, -1, 0, 1), (0, 1, 0, -1, 0)
    words = [f"{decimal(x + radius)} {decimal(y)} m"]
    for k in range(4):
        points = [
            (radius * cos[k] - reach * sin[k], radius * sin[k] + reach * cos[k]),
            (radius * cos[k + 1] + reach * sin[k + 1], radius * sin[k + 1] - reach * cos[k + 1]),
            (radius * cos[k + 1], radius * sin[k + 1]),
        ]
        words.append(" ".join(f"{decimal(x + a)} {decimal(y + b)}" for a, b in points) + " c")
    return " ".join(words)


def _escaped(text: str) -> str:
    for sign in "\\()":
        text = text.replace(sign, f"\\{sign}")
    return text.encode("cp1252", "replace").decode("cp1252")
