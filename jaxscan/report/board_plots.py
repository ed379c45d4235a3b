"""The map of a calibration board: heights of its corners, and how far they are out of place."""

from typing import TYPE_CHECKING

import numpy as np

from jaxscan.calibration import BoardMap
from jaxscan.report.drawing import INK, SOFT, arrows, new_axes, new_figure


if TYPE_CHECKING:
    from matplotlib.figure import Figure


# The longest arrow, in squares.
_LONGEST = 0.9
# A colour is full at so many standard deviations or more, so that noise is pale.
_SIGMAS = 3.0
# Up to this height numbers are in micrometres [mm].
_SMALL_MM = 0.02


def board_map(found: BoardMap, corners: np.ndarray, square_m: float) -> "Figure":
    """Heights over the best plane in colour and in numbers, and shifts in the plane as arrows.

    Args:
        found: The map.
        corners: Corners of the flat board [corners, 3], m.
        square_m: Side of a square [m].
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import PathPatch

    x, y = 1e3 * corners[:, 0], 1e3 * corners[:, 1]
    shift = 1e3 * np.array(found.shift_m)
    noise = np.sqrt(np.mean(np.square(found.height_sigma_m))) if found.height_sigma_m else 0.0
    limit_mm = 1e3 * max(float(np.abs(found.height_m).max()), _SIGMAS * float(noise), 1e-6)
    unit, per_m = ("µm", 1e6) if limit_mm < _SMALL_MM else ("mm", 1e3)
    height, limit = per_m * np.array(found.height_m), 1e-3 * per_m * limit_mm
    decimals = 2 if limit < 1 else 1 if limit < 100 else 0
    wide, high = np.ptp(x), np.ptp(y)
    figure = new_figure(6.4, float(np.clip(6.0 * high / max(wide, 1e-9), 2.2, 7.5)) + 0.6)
    axes = new_axes(figure, grid=False, xlabel="x on the board, mm", ylabel="y, mm", aspect="equal")
    size = 0.44 * 1e3 * square_m
    half = 0.5e3 * square_m
    # Squares round the corners: those of some boards stand on no plain grid.
    squares = np.stack([x, y], 1)[:, None] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    drawn = PolyCollection(list(squares), array=height, cmap="RdBu_r", clim=(-limit, limit), alpha=0.75, linewidths=0)
    axes.add_collection(drawn)
    axes.set(xlim=(x.min() - half, x.max() + half), ylim=(y.max() + half, y.min() - half))
    if len(height) <= 150:
        for px, py, value in zip(x, y, height, strict=True):
            # 0 has no sign.
            text = f"{value:+.{decimals}f}" if round(value, decimals) else f"{0:.{decimals}f}"
            axes.text(px, py + size, text, ha="center", va="bottom", fontsize=6, color=INK)
    longest = float(np.linalg.norm(shift, axis=1).max()) if len(shift) else 0.0
    if longest > 0:
        scale = _LONGEST * 1e3 * square_m / longest
        path = arrows(np.column_stack([x, y]), scale * shift)
        axes.add_patch(PathPatch(path, fill=False, edgecolor=INK, linewidth=0.8, clip_on=False))
        axes.set_title(f"arrows: place in the plane, the longest {longest:.3f} mm", color=SOFT, loc="left")
    bar = figure.colorbar(drawn, ax=axes, shrink=0.8, aspect=24, pad=0.02)
    bar.set_label(f"height into the board, {unit}")
    bar.outline.set_visible(False)
    bar.ax.tick_params(length=0, labelsize=8)
    return figure
