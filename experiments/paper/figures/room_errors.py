"""Picture of the errors of the room's dimensions, and of those by the turn between the views of Tr."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from experiments.paper.drawing import plt, save
from experiments.paper.figures.pair_angles import PairAngle
from experiments.paper.figures.room_clouds import Size


PAPER_ERRORS = (-2.0, -9.0)
"""Of the paper's room, width and length [mm]."""
COLOURS = ("tab:blue", "tab:orange")
SIDES = ("width, 3.82 m", "length, 6.15 m")


def draw_errors(path: Path, groups: dict[str, list[Size]], pairs: list[PairAngle], truth: Size, title: str) -> None:
    """Errors of each group as dots on the left, rms error against the angle of the pair on the right.

    Args:
        path: Of the picture.
        groups: Measured rooms by method; NaN where walls were not found.
        pairs: Rooms by the paper's method, for each turn between the views of Tr.
        truth: The room.
        title: Of the picture.
    """
    figure, (left, right) = plt.subplots(1, 2, figsize=(17, 7.5), width_ratios=(1.25, 1), constrained_layout=True)
    figure.suptitle(title, fontsize=15)
    _dots(left, groups, truth)
    _against_angle(right, pairs, truth)
    save(figure, path, 110)


def _dots(axis: Axes, groups: dict[str, list[Size]], truth: Size) -> None:
    """Errors on a scale that is linear near zero."""
    for place, sizes in enumerate(groups.values()):
        errors = np.array([size.errors(truth) for size in sizes]).reshape(-1, 2)
        for side, (colour, name) in enumerate(zip(COLOURS, SIDES, strict=True)):
            seen = errors[np.isfinite(errors[:, side]), side]
            height = -place + (0.18 if side == 0 else -0.18)
            spread = 0.09 * np.sin(2.4 * np.arange(len(seen)))
            label = name if place == 0 else None
            axis.plot(seen, height + spread, "o", color=colour, alpha=0.6, markersize=5, label=label)
            if len(seen) > 3:
                low, middle, high = np.percentile(seen, [25, 50, 75])
                axis.plot([low, high], [height, height], color=colour, lw=6, alpha=0.3)
                axis.plot([middle], [height], "|", color=colour, markersize=22, markeredgewidth=2.5)
    for error, colour in zip(PAPER_ERRORS, COLOURS, strict=True):
        axis.axvline(error, color=colour, ls="--", lw=1)
    axis.axvline(0, color="0.3", lw=0.8)
    axis.set_xscale("symlog", linthresh=1.0, linscale=0.8)
    axis.xaxis.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
    axis.set_yticks([-place for place in range(len(groups))], list(groups))
    axis.set_xlabel("measured minus true [mm] (linear between -1 and 1); dashed: the paper's errors")
    axis.set_title("Errors of the room's dimensions; bars: quartiles of the draws")
    axis.grid(axis="x", alpha=0.3)
    axis.legend(loc="lower right")


def _against_angle(axis: Axes, pairs: list[PairAngle], truth: Size) -> None:
    angle = np.array([pair.angle_deg for pair in pairs])
    rms, scatter = np.array([[pair.rms(truth), pair.scatter(truth)] for pair in pairs]).transpose(1, 0, 2)
    for side, (colour, name) in enumerate(zip(COLOURS, SIDES, strict=True)):
        axis.plot(angle, rms[:, side], "o-", color=colour, label=f"{name}: rms error")
        axis.plot(
            angle,
            scatter[:, side],
            "s:",
            color=colour,
            label=f"{name}: standard deviation by the noise of these two views",
        )
        axis.axhline(-PAPER_ERRORS[side], color=colour, ls="--", lw=1)
    axis.set_xscale("log")
    axis.set_yscale("log")
    for scale in (axis.xaxis, axis.yaxis):
        scale.set_major_formatter(mpl.ticker.FormatStrFormatter("%g"))
        scale.set_minor_formatter(mpl.ticker.NullFormatter())
    axis.set_xticks(angle, [f"{each:g}" for each in angle])
    axis.set_xlabel("turn between the two views that give Tr [°]")
    axis.set_ylabel("error of the room [mm]")
    axis.set_title("The paper's method by the turn between the views of Tr; dashed: the paper's errors")
    axis.grid(alpha=0.3, which="both")
    axis.legend()
