"""Drawings on disk: DXF through ezdxf for programs of architects, SVG for people and browsers."""

import importlib.util
import xml.etree.ElementTree as xml
from typing import Any

import numpy as np

from jaxscan.drawing import Drawing, Page, border, lay_out, layer_of
from jaxscan.drawing.model import EM, GAP_MM, SMALL_MM, TICK_MM
from jaxscan.errors import DependencyError
from jaxscan.files.disk import Part


STYLE = "JAXSCAN"
HEIGHT_MM = SMALL_MM
"""Height of the letters of dimensions, which stand above the line with their standard deviations."""


def _dimension_style(paper_m: float) -> dict[str, float]:
    """Style of dimensions, by the names of DXF; lengths in metres, a millimetre of the paper is so long [m]."""
    style = {"dimtxt": HEIGHT_MM, "dimasz": TICK_MM, "dimtsz": TICK_MM, "dimexo": 3.0, "dimexe": 1.5, "dimgap": GAP_MM}
    return {name: paper_m * value for name, value in style.items()} | {"dimdec": 3, "dimtad": 1, "dimlunit": 2}


def check_dxf() -> None:
    """Check that DXF can be written.

    Raises:
        DependencyError: If ezdxf is not installed.
    """
    if importlib.util.find_spec("ezdxf") is None:
        raise DependencyError('DXF needs ezdxf: pip install "jaxscan[plan]"')


def write_dxf(drawing: Drawing, path: Part) -> None:
    """Write a drawing as DXF.

    The model space has the drawing; one unit of it is a metre. A layout has the sheet: its border in millimetres, and
    the drawing in a viewport at the scale.

    Raises:
        DependencyError: If ezdxf is not installed.
        OSError: If the file cannot be written.
    """
    check_dxf()
    import ezdxf

    page, paper = border(drawing), drawing.sheet.paper_m
    document = ezdxf.new("R2010", setup=["linetypes"])
    document.units = ezdxf.units.M
    document.header["$MEASUREMENT"] = 1
    document.header["$LUNITS"] = 2
    # Lines of dashes are defined for drawings in inches or millimetres; a dash is a few centimetres here.
    document.header["$LTSCALE"] = 0.1
    for name in dict.fromkeys([*drawing.layers, *page.layers]):
        look = layer_of(name)
        # The library counts widths in hundredths of a millimetre.
        layer = document.layers.add(name, color=look.colour, linetype="DASHED" if look.dashed else "CONTINUOUS")
        layer.dxf.lineweight = round(100 * look.width_mm)
        layer.description = look.means
    style = document.dimstyles.new(STYLE)
    for name, value in _dimension_style(paper).items():
        style.set_dxf_attrib(name, value)
    # Some programs, LibreCAD is one, draw dimensions by the header and not by their style.
    style.copy_to_header(document)
    space = document.modelspace()
    _add(space, drawing)
    for one in drawing.dimensions:
        # The library writes from the first point to the second, also upside down.
        along = np.array([np.cos(one.angle), np.sin(one.angle)])
        turned = float((one.end - one.start) @ along) < 0.0
        points = (one.end, one.start) if turned else (one.start, one.end)
        added = space.add_aligned_dim(
            p1=tuple(map(float, points[0])),
            p2=tuple(map(float, points[1])),
            distance=-one.offset_m if turned else one.offset_m,
            text=f"{one.value}\\P{one.sigma}",
            dimstyle=STYLE,
            dxfattribs={"layer": one.layer},
        )
        # Two lines of text stand on the dimension line; the library places the middle of one.
        added.shift_text(float(one.shift[0]), float(one.shift[1]) + 0.9 * HEIGHT_MM * paper)
        added.render()
    low, high = drawing.bounds()
    document.set_modelspace_vport(height=float(1.1 * (high - low).max()), center=tuple(map(float, 0.5 * (low + high))))
    # The library writes these to the header, whatever is there before.
    space.reset_extents((*map(float, low), 0.0), (*map(float, high), 0.0))
    _add_sheet(document, drawing, page)
    document.saveas(path)


def _add(space: Any, drawn: Drawing | Page) -> None:
    """Lines, areas and texts of a drawing or of a page."""
    from ezdxf.enums import TextEntityAlignment

    for area in drawn.areas:
        hatch = space.add_hatch(color=layer_of(area.layer).colour, dxfattribs={"layer": area.layer})
        hatch.paths.add_polyline_path([(float(x), float(y)) for x, y in area.points], is_closed=True)
    for line in drawn.lines:
        space.add_lwpolyline([(float(x), float(y)) for x, y in line.points], dxfattribs={"layer": line.layer})
    for text in drawn.texts:
        attributes = {"layer": text.layer, "height": text.height, "rotation": float(np.degrees(text.angle))}
        added = space.add_text(text.words, dxfattribs=attributes)
        left = text.align == "left"
        align = TextEntityAlignment.MIDDLE_LEFT if left else TextEntityAlignment.MIDDLE_CENTER
        added.set_placement(tuple(map(float, text.at)), align=align)


def _add_sheet(document: Any, drawing: Drawing, page: Page) -> None:
    """The layout of the sheet, in millimetres of paper."""
    sheet = drawing.sheet
    name = f"{sheet.size.upper()} 1-{sheet.scale}"
    document.layouts.rename("Layout1", name)
    layout = document.paperspace(name)
    layout.page_setup(size=page.size_mm, margins=(0.0, 0.0, 0.0, 0.0), units="mm")
    _add(layout, page)
    low, high = sheet.room_mm
    width, height = (float(one) for one in high - low)
    layout.add_viewport(
        center=tuple(map(float, page.middle_mm)),
        size=(width, height),
        view_center_point=tuple(map(float, page.middle_m)),
        view_height=height * sheet.paper_m,
    )


def svg_of(drawing: Drawing) -> bytes:
    """The sheet of a drawing as SVG, in millimetres of paper; its y points down."""
    page = lay_out(drawing)
    width, height = page.size_mm
    root = xml.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{width:g}mm",
            "height": f"{height:g}mm",
            "viewBox": f"0 0 {width:g} {height:g}",
        },
    )
    xml.SubElement(root, "title").text = drawing.title
    xml.SubElement(root, "rect", {"width": f"{width:g}", "height": f"{height:g}", "fill": "#ffffff"})

    def listed(points: np.ndarray) -> str:
        return " ".join(f"{x:.3f},{height - y:.3f}" for x, y in points)

    for name in page.layers:
        look = layer_of(name)
        attributes = {"id": name, "stroke": look.rgb, "fill": "none", "stroke-width": f"{look.width_mm:g}"}
        attributes |= {"stroke-linejoin": "round", "stroke-linecap": "round"}
        group = xml.SubElement(root, "g", attributes | ({"stroke-dasharray": "1.6 1"} if look.dashed else {}))
        for area in (one for one in page.areas if one.layer == name):
            xml.SubElement(group, "polygon", {"points": listed(area.points), "fill": look.rgb, "stroke": "none"})
        for line in (one for one in page.lines if one.layer == name):
            xml.SubElement(group, "polyline", {"points": listed(line.points)})
        for text in (one for one in page.texts if one.layer == name):
            x, y = text.at[0], height - text.at[1]
            placed = {"x": f"{x:.3f}", "y": f"{y:.3f}", "font-size": f"{EM * text.height:.3f}"}
            if text.angle:
                placed["transform"] = f"rotate({-np.degrees(text.angle):.3f} {x:.3f} {y:.3f})"
            shown = {"stroke": "none", "fill": look.rgb, "font-family": "DejaVu Sans, Arial, sans-serif"}
            anchor = "start" if text.align == "left" else "middle"
            shown |= {"text-anchor": anchor, "dominant-baseline": "central"}
            xml.SubElement(group, "text", placed | shown).text = text.words
    xml.indent(root)
    return xml.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
