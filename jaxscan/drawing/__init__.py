"""Drawings of rooms: plans and sections as layers of lines, texts and dimensions, and pictures of walls."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.drawing.model import LAYERS, Area, DimensionLine, Drawing, Layer, Line, Text, layer_of, strokes
    from jaxscan.drawing.orthophotos import Orthophoto, draw_orthophotos
    from jaxscan.drawing.page import Page, border, lay_out
    from jaxscan.drawing.plan import draw_plan
    from jaxscan.drawing.section import draw_section, section_before
    from jaxscan.drawing.sheet import SIZES_MM, Sheet
    from jaxscan.drawing.survey import Survey, outward, survey_room
else:
    load_on_use(__name__)
