"""The map of a surface's deviations from its plane, with their sigmas beside it."""

import io

import numpy as np

from jaxscan.measurement import DeviationMap
from jaxscan.report.drawing import new_axes, new_figure


def deviation_picture(found: DeviationMap) -> bytes:
    """A PNG of two maps in millimetres: deviations, towards the scanner positive, and one standard deviation."""
    figure = new_figure(9.6, 4.4)
    half = 0.5 * found.cell_m * np.array(found.seen.shape)
    reach = max(float(np.percentile(np.abs(found.deviation_m[found.seen]), 99)), 1e-5)
    largest = max(float(np.percentile(found.sigma_m[found.seen], 99)), 1e-5)
    panels = (
        ("deviation from the plane, mm", found.deviation_m, "RdBu_r", (-1e3 * reach, 1e3 * reach)),
        ("one standard deviation, mm", found.sigma_m, "viridis", (0.0, 1e3 * largest)),
    )
    for place, (title, values, colours, (low, high)) in enumerate(panels):
        axes = new_axes(figure, 121 + place, grid=False)
        shown = np.ma.masked_where(~found.seen, 1e3 * values)
        extent = (-half[1], half[1], -half[0], half[0])
        image = axes.imshow(shown, origin="lower", extent=extent, cmap=colours, vmin=low, vmax=high)
        axes.set_facecolor("#dfe3e8")
        axes.set_title(title)
        axes.set_xlabel("to the right, m")
        if place == 0:
            axes.set_ylabel("up, m")
        figure.colorbar(image, ax=axes, shrink=0.85)
    written = io.BytesIO()
    figure.savefig(written, format="png", dpi=120)
    return written.getvalue()
