"""Drawings on disk: DXF for programs of architects, SVG for people and browsers."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.drawings.dxf import check_dxf, write_dxf
    from jaxscan.files.drawings.svg import svg_of
else:
    load_on_use(__name__)
