"""SVG at a scale of paper: one group for each layer, text as text."""

import xml.etree.ElementTree as xml

import numpy as np

from jaxscan.drawing import Drawing, layer_of, strokes


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
