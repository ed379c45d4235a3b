"""Boards on paper: sheets in true size, as PDF and SVG."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.report.prints.pages import Page, board_pages
    from jaxscan.report.prints.papers import PAPERS, Paper
    from jaxscan.report.prints.pdf import pdf_of
    from jaxscan.report.prints.svg import svg_of
else:
    load_on_use(__name__)
