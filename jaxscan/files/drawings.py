"""Drawings on disk: DXF through ezdxf for programs of architects, SVG for people and browsers."""

import importlib.util
import xml.etree.ElementTree as xml

import numpy as np

from jaxscan.drawing import Drawing, layer_of, strokes
from jaxscan.drawing.model import TEXT_M
from jaxscan.errors import DependencyError
from jaxscan.files.disk import Part


STYLE = "JAXSCAN"
DIMENSIONS = {
    "dimtxt": TEXT_M,
    "dimasz": 0.05,
    "dimtsz": 0.05,
    "dimexo": 0.05,
    "dimexe": 0.05,
    "dimgap": 0.03,
    "dimdec": 3,
    "dimtad": 1,
    "dimlunit": 2,
}
"""Style of dimensions, by the names of DXF; lengths in metres."""


def check_dxf() -> None:
    """Check that DXF can be written.

    Raises:
        DependencyError: If ezdxf is not installed.
    """
    if importlib.util.find_spec("ezdxf") is None:
        raise DependencyError('DXF needs ezdxf: pip install "jaxscan[plan]"')


def write_dxf(drawing: Drawing, path: Part) -> None:
    """Write a drawing as DXF; one unit of it is a metre.

    Raises:
        DependencyError: If ezdxf is not installed.
        OSError: If the file cannot be written.
    """
    check_dxf()
    import ezdxf

    document = ezdxf.new("R2010", setup=["linetypes"])
    document.units = ezdxf.units.M
    document.header["$MEASUREMENT"] = 1
    document.header["$LUNITS"] = 2
    # Lines of dashes are defined for drawings in inches or millimetres; a dash is a few centimetres here.
    document.header["$LTSCALE"] = 0.1
    for name in drawing.layers:
        look = layer_of(name)
        # The library counts widths in hundredths of a millimetre.
        layer = document.layers.add(name, color=look.colour, linetype="DASHED" if look.dashed else "CONTINUOUS")
        layer.dxf.lineweight = round(100 * look.width_mm)
        layer.description = look.means
    style = document.dimstyles.new(STYLE)
    for name, value in DIMENSIONS.items():
        style.set_dxf_attrib(name, value)
    # Some programs, LibreCAD is one, draw dimensions by the header and not by their style.
    style.copy_to_header(document)
    space = document.modelspace()
    for line in drawing.lines:
        space.add_lwpolyline([(float(x), float(y)) for x, y in line.points], dxfattribs={"layer": line.layer})
    for text in drawing.texts:
        attributes = {"layer": text.layer, "height": text.height_m, "rotation": float(np.degrees(text.angle))}
        added = space.add_text(text.words, dxfattribs=attributes)
        added.set_placement(tuple(map(float, text.at)), align=ezdxf.enums.TextEntityAlignment.MIDDLE_CENTER)
    for one in drawing.dimensions:
        space.add_aligned_dim(
            p1=tuple(map(float, one.start)),
            p2=tuple(map(float, one.end)),
            distance=one.offset_m,
            text=one.words,
            dimstyle=STYLE,
            dxfattribs={"layer": one.layer},
        ).render()
    low, high = drawing.bounds()
    document.set_modelspace_vport(height=float(1.1 * (high - low).max()), center=tuple(map(float, 0.5 * (low + high))))
    # The library writes these to the header, whatever is there before.
    space.reset_extents((*map(float, low), 0.0), (*map(float, high), 0.0))
    document.saveas(path)


SCALE = 20.0
"""Millimetres of paper per metre: 1 : 50."""
MARGIN_M = 0.25


def svg_of(drawing: Drawing) -> bytes:
    """A drawing as SVG, 1 : 50; units of the drawing are metres, and their y points down."""
    low, high = drawing.bounds()
    low, high = low - MARGIN_M, high + MARGIN_M
    width, height = high - low
    root = xml.Element(
        "svg",
        {
            "xmlns": "http://www.w3.org/2000/svg",
            "width": f"{SCALE * width:.1f}mm",
            "height": f"{SCALE * height:.1f}mm",
            "viewBox": f"{low[0]:.4f} {-high[1]:.4f} {width:.4f} {height:.4f}",
        },
    )
    xml.SubElement(root, "title").text = drawing.title
    paper = {"x": f"{low[0]:.4f}", "y": f"{-high[1]:.4f}", "width": f"{width:.4f}", "height": f"{height:.4f}"}
    xml.SubElement(root, "rect", paper | {"fill": "#ffffff"})
    lines, texts = strokes(drawing)
    for name in drawing.layers:
        look = layer_of(name)
        attributes = {"id": name, "stroke": look.rgb, "fill": "none", "stroke-width": f"{look.width_mm / SCALE:.4f}"}
        attributes |= {"stroke-linejoin": "round", "stroke-linecap": "round"}
        group = xml.SubElement(root, "g", attributes | ({"stroke-dasharray": "0.08 0.05"} if look.dashed else {}))
        for line in lines:
            if line.layer == name:
                xml.SubElement(group, "polyline", {"points": " ".join(f"{x:.4f},{-y:.4f}" for x, y in line.points)})
        for text in texts:
            if text.layer == name:
                x, y = text.at
                placed = {"x": f"{x:.4f}", "y": f"{-y:.4f}", "font-size": f"{1.3 * text.height_m:.4f}"}
                if text.angle:
                    placed["transform"] = f"rotate({-np.degrees(text.angle):.3f} {x:.4f} {-y:.4f})"
                shown = {"stroke": "none", "fill": look.rgb, "font-family": "sans-serif"}
                shown |= {"text-anchor": "middle", "dominant-baseline": "central"}
                xml.SubElement(group, "text", placed | shown).text = text.words
    xml.indent(root)
    return xml.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
