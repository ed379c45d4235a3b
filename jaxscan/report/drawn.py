"""Drawings of rooms as PDF."""

import io

from jaxscan.drawing import Drawing, layer_of, strokes


INCH_PER_M = 20.0 / 25.4
"""1 : 50."""
MARGIN_M = 0.25


def pdf_of(drawing: Drawing) -> bytes:
    """A drawing as one page of PDF, 1 : 50."""
    # Imported here, so that only drawing loads matplotlib.
    import matplotlib
    from matplotlib.figure import Figure

    low, high = drawing.bounds()
    low, high = low - MARGIN_M, high + MARGIN_M
    figure = Figure(figsize=tuple(INCH_PER_M * (high - low)))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    lines, texts = strokes(drawing)
    for line in lines:
        look = layer_of(line.layer)
        style = (0, (8, 5)) if look.dashed else "-"
        axes.plot(*line.points.T, color=look.rgb, linewidth=look.width_mm * 72 / 25.4, linestyle=style)
    for text in texts:
        axes.text(
            float(text.at[0]),
            float(text.at[1]),
            text.words,
            color=layer_of(text.layer).rgb,
            fontsize=1.2 * text.height_m * INCH_PER_M * 72,
            rotation=float(text.angle * 180 / 3.141592653589793),
            rotation_mode="anchor",
            horizontalalignment="center",
            verticalalignment="center",
            parse_math=False,
        )
    written = io.BytesIO()
    with matplotlib.rc_context({"pdf.fonttype": 42}):
        figure.savefig(written, format="pdf", metadata={"Title": drawing.title, "CreationDate": None})
    return written.getvalue()
