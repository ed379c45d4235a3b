"""Errors of many calibrations as a picture."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from experiments.paper.drawing import plt, save


class Series(NamedTuple):
    """Errors by one method."""

    name: str
    errors: np.ndarray
    """[draws, panels]."""
    colour: str


def strips(series: list[Series], titles: list[str], headline: str, path: Path, *, columns: int = 4) -> None:
    """Draw a panel for each number: a point for each draw, a line for the mean, a box for its standard deviation.

    Args:
        series: One for each method; all have the same panels.
        titles: Of the panels, with units.
        headline: Of the picture.
        path: Where it is written.
        columns: Panels side by side.
    """
    rows = -(-len(titles) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(3.7 * columns, 2.9 * rows), squeeze=False)
    random = np.random.default_rng(0)
    for axis in axes.ravel()[len(titles) :]:
        axis.set_visible(False)
    for panel, title in enumerate(titles):
        axis = axes.ravel()[panel]
        axis.axhline(0, color="0.6", linewidth=0.8)
        for at, one in enumerate(series):
            values = one.errors[:, panel]
            mean, spread = values.mean(), values.std(ddof=1) if len(values) > 1 else 0.0
            axis.bar(at, 2 * spread, 0.6, mean - spread, color=one.colour, alpha=0.2)
            axis.plot([at - 0.3, at + 0.3], [mean, mean], color=one.colour, linewidth=2)
            aside = random.uniform(-0.2, 0.2, len(values))
            axis.plot(at + aside, values, ".", color=one.colour, markersize=5, label=one.name)
            said = f"{mean:+.2g}\n± {spread:.2g}" if len(values) > 1 else f"{mean:+.2g}"
            axis.text(at, -0.02, said, color=one.colour, ha="center", va="top", fontsize=8,
                      transform=axis.get_xaxis_transform())  # fmt: skip
        # Bars would otherwise end at the frame.
        axis.use_sticky_edges = False
        axis.margins(y=0.08)
        axis.set_xticks([])
        axis.set_xlim(-0.6, len(series) - 0.4)
        axis.set_title(title, fontsize=10)
    handles, names = axes.ravel()[0].get_legend_handles_labels()
    figure.suptitle(headline, fontsize=12)
    figure.legend(handles, names, loc="lower center", ncols=len(series), fontsize=10, markerscale=2)
    figure.tight_layout(rect=(0, 0.05, 1, 0.98), h_pad=2.0)
    save(figure, path, 110)
