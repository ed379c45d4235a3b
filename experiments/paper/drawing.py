"""Pictures of the experiments: matplotlib without a screen."""

from pathlib import Path

import matplotlib as mpl


mpl.use("Agg")
import matplotlib.pyplot as plt


def save(figure: plt.Figure, path: Path, dpi: int) -> None:
    """Write a picture and free its memory.

    Args:
        figure: The picture.
        path: Of the file; its suffix gives the format.
        dpi: Resolution [dots per inch].
    """
    figure.savefig(path, dpi=dpi)
    plt.close(figure)
