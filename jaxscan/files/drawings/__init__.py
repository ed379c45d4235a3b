"""Drawings on disk: DXF for programs of architects, SVG for people and browsers."""

from jaxscan.files.drawings.dxf import check_dxf, write_dxf
from jaxscan.files.drawings.svg import svg_of
