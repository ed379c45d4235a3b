"""Pictures of the comparison: errors as bars, clouds from above."""

import textwrap
from pathlib import Path

import matplotlib as mpl


mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from jaxscan.simulation import RoomSpec


COLOURS = {"ours": "tab:blue", "horus": "tab:red", "tuned": "tab:orange", "whole": "tab:olive"}


def draw_bars(
    path: Path,
    figures: dict[str, dict[str, float]],
    ways: dict[str, str],
    units: dict[str, tuple[str, str]],
    world: str,
) -> None:
    """One panel for each figure, one bar for each method.

    Args:
        path: Of the picture.
        figures: By method, then by figure.
        ways: Names of the methods.
        units: Unit and name of each figure.
        world: The world's name.
    """
    figure, axes = plt.subplots(2, 5, figsize=(16, 7.4), constrained_layout=True)
    # A room that cannot be measured shows in the panels of its dimensions.
    panels = {what: text for what, text in units.items() if what != "measured"}
    for axis, (what, (unit, label)) in zip(axes.flat, panels.items(), strict=True):
        shown = [name for name in ways if what in figures[name]]
        values = np.array([figures[name][what] for name in shown])
        bars = axis.bar(range(len(shown)), np.nan_to_num(values), color=[COLOURS[name] for name in shown])
        axis.bar_label(bars, [f"{value:.3g}" if np.isfinite(value) else "failed" for value in values], fontsize=10)
        axis.set(title=textwrap.fill(f"{label} [{unit}]", 32), xticks=[])
        axis.margins(y=0.15)
    handles = [mpl.patches.Patch(color=COLOURS[name], label=label) for name, label in ways.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(ways), fontsize=11)
    figure.suptitle(f"The same images by jaxscan and by Horus' method, {world} world", fontsize=14)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def draw_plans(path: Path, clouds: dict[str, np.ndarray], room: RoomSpec, world: str) -> None:
    """Clouds from above over the true walls, with the room's own axes.

    Args:
        path: Of the picture.
        clouds: By the name of the method [records, rows, 3], m.
        room: The true room.
        world: The world's name.
    """
    figure, axes = plt.subplots(1, len(clouds), figsize=(5.2 * len(clouds), 8.2), constrained_layout=True, sharey=True)
    yaw = np.deg2rad(room.yaw_deg)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    left, near = -np.array(room.rig_m[:2])
    for axis, (label, xyz) in zip(axes, clouds.items(), strict=True):
        points = xyz[np.isfinite(xyz).all(-1)]
        flat = points[:, :2] @ turn.T
        axis.add_patch(plt.Rectangle((left, near), *room.size_m[:2], fill=False, ec="tab:red", lw=0.8, ls="--"))
        axis.plot(*flat.T, ",", color="k", alpha=0.5)
        axis.plot(0, 0, "+", color="tab:blue", ms=12)
        axis.set(title=f"{label}\n{len(points)} points", xlabel="m", aspect="equal")
        axis.set_xlim(left - 0.6, left + room.size_m[0] + 0.6)
        axis.set_ylim(near - 0.6, near + room.size_m[1] + 0.6)
    axes[0].set_ylabel("m")
    figure.suptitle(f"The room from above; dashed: true walls, cross: the axis ({world} world)", fontsize=13)
    figure.savefig(path, dpi=90)
    plt.close(figure)
