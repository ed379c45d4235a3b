"""A scale below a picture whose pixels have a size."""

import numpy as np

from jaxscan.report.drawing import INK


def with_scale(rgb: np.ndarray, pixel_m: float, words: str) -> np.ndarray:
    """A picture with a strip below it: a scale in metres and words.

    Args:
        rgb: [rows, columns, 3], uint8.
        pixel_m: Size of a pixel [m].
        words: What is said beside the scale.

    Returns:
        [rows + strip, columns, 3], uint8; the picture itself is not changed.
    """
    # Imported here, so that only drawing loads matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = rgb.shape[1]
    high = max(40, columns // 14)
    dpi = 100
    figure = Figure(figsize=(columns / dpi, high / dpi), dpi=dpi)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0.0, columns)
    axes.set_ylim(0.0, high)
    # Half of the width at most, in a round number of parts.
    part = max(size for size in (0.001, 0.01, 0.1, 0.5, 1.0) if 4 * size < 0.5 * columns * pixel_m or size == 0.001)
    left = 0.02 * columns
    for number in range(4):
        start = left + number * part / pixel_m
        filled = INK if number % 2 == 0 else "white"
        axes.fill_between([start, start + part / pixel_m], 0.55 * high, 0.75 * high, facecolor=filled, edgecolor=INK)
    size = 0.24 * high * 72 / dpi
    for number in (0, 2, 4):
        axes.text(left + number * part / pixel_m, 0.2 * high, f"{number * part:g}", fontsize=size, ha="center")
    axes.text(left + 4.35 * part / pixel_m, 0.5 * high, f"m.  {words}", fontsize=size, va="center", parse_math=False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    strip = np.asarray(canvas.buffer_rgba())[:, :columns, :3]
    strip = np.pad(strip, ((0, 0), (0, columns - strip.shape[1]), (0, 0)), constant_values=255)
    return np.concatenate([rgb, strip])
