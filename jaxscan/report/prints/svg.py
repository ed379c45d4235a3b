"""A sheet as SVG."""

from collections.abc import Iterable
from xml.sax.saxutils import escape

from jaxscan.report.prints.numbers import decimal
from jaxscan.report.prints.pages import Page


def svg_of(page: Page, title: str) -> bytes:
    """The file of one sheet in true size."""
    width, height = decimal(page.width), decimal(page.height)
    ink = [*map(_rectangle, page.ink.rectangles), *map(_circle, page.ink.circles)]
    size = f'width="{width}mm" height="{height}mm" viewBox="0 0 {width} {height}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" {size}>',
        f"<title>{escape(title)}</title>",
        f'<clipPath id="window"><path d="{_rectangle(page.window)}"/></clipPath>',
        f'<path d="M0 0H{width}V{height}H0Z" fill="white"/>',
        # All in one path: where rectangles touch, no viewer leaves a white hair between them.
        f'<path clip-path="url(#window)" d="{" ".join(ink)}"/>',
        f'<path d="{" ".join(map(_rectangle, page.rectangles))}"/>',
    ]
    for text in page.texts:
        place = f'x="{decimal(text.x)}" y="{decimal(text.y)}" font-size="{decimal(text.size)}"'
        lines.append(f'<text {place} font-family="Helvetica, Arial, sans-serif">{escape(text.text)}</text>')
    return ("\n".join([*lines, "</svg>"]) + "\n").encode()


def _rectangle(box: Iterable[float]) -> str:
    x0, y0, x1, y1 = map(decimal, box)
    return f"M{x0} {y0}H{x1}V{y1}H{x0}Z"


def _circle(circle: Iterable[float]) -> str:
    x, y, radius = circle
    r, across = decimal(radius), decimal(2 * radius)
    return f"M{decimal(x)} {decimal(y - radius)}a{r} {r} 0 0 1 0 {across}a{r} {r} 0 0 1 0 -{across}Z"
