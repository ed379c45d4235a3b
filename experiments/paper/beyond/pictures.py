"""The picture of the acceptance tests."""

from typing import TYPE_CHECKING

import matplotlib


matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from experiments.paper.beyond.spheres import band95
from experiments.paper.beyond.targets import HALL, Hall
from experiments.paper.stage import Stage


if TYPE_CHECKING:
    from experiments.paper.beyond.acceptance import Tested


_LARGEST_MM = 1.0
_COLOURS = plt.get_cmap("coolwarm")


def draw_hall(stage: Stage, hall: Hall, tests: "list[Tested]") -> None:
    """The hall from above, lengths coloured by their errors; errors of lengths with sigmas; form against distance.

    The first and the last panel are of the first calibration.
    """
    figure, axes = plt.subplot_mosaic(
        [["top", "errors"], ["top", "form"]], figsize=(16, 9.5), width_ratios=(1.2, 1), layout="constrained"
    )
    _top(axes["top"], hall, tests[0])
    _errors(axes["errors"], hall, tests)
    _form(axes["form"], hall, tests[0])
    scale = ScalarMappable(Normalize(-_LARGEST_MM, _LARGEST_MM), _COLOURS)
    figure.colorbar(
        scale, ax=axes["top"], orientation="horizontal", shrink=0.7, pad=0.06, label="error of a length [mm]"
    )
    figure.suptitle(f"Acceptance tests in a hall of {HALL.size_m[0]:g} x {HALL.size_m[1]:g} m, {stage.world} world")
    figure.savefig(stage.picture("acceptance"), dpi=110)
    plt.close(figure)


def _top(axes: Axes, hall: Hall, test: "Tested") -> None:
    for length, error in zip(hall.lengths, 1e3 * test.error, strict=True):
        ends = np.array([hall.balls[name].centre for name in (length.first, length.second)])
        colour = _COLOURS(0.5 + 0.5 * error / _LARGEST_MM) if np.isfinite(error) else "0.6"
        axes.plot(*ends[:, :2].T, color=colour, lw=3 if length.test == "bar" else 1.5, zorder=2)
        if length.test == "bar":
            x, y = ends[:, :2].mean(0) * 1.17
            axes.text(x, y, f"{error:+.2f}", ha="center", va="center", fontsize=9)
    for plate in hall.plates:
        corners = plate.centre + np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]) @ plate.edges
        axes.fill(*corners[:, :2].T, facecolor="0.8", edgecolor="0.3", lw=2, zorder=1)
        x, y = plate.centre[:2] * 1.13
        axes.text(
            x, y, f"plate\n{1e3 * test.flatness[plate.name]:.1f}", ha="center", va="center", fontsize=8, color="0.3"
        )
    for ball in hall.balls.values():
        axes.add_patch(plt.Circle(ball.centre[:2], ball.diameter / 2, facecolor="white", edgecolor="k", zorder=3))
    axes.plot(0, 0, "k^", ms=10)
    axes.text(0.0, -0.28, "scanner", ha="center")
    x, y = HALL.size_m[0] / 2, HALL.size_m[1] / 2
    axes.plot([-x, x, x, -x, -x], [-y, -y, y, y, -y], color="0.4", lw=1)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal", title="From above; dumb-bells [mm], plates: D95 [mm]")


def _errors(axes: Axes, hall: Hall, tests: "list[Tested]") -> None:
    order = np.argsort([("bar", "front", "across").index(one.test) for one in hall.lengths], kind="stable")
    for number, test in enumerate(tests):
        place = np.arange(len(order)) + 0.22 * (number - (len(tests) - 1) / 2)
        axes.errorbar(
            place,
            1e3 * test.error[order],
            1e3 * test.sigma[order],
            fmt="o",
            ms=3,
            lw=1,
            label=f"calibration {number + 1}",
        )
    axes.axhline(0, color="k", lw=0.6)
    names = [hall.lengths[index].name for index in order]
    axes.set_xticks(range(len(order)), names, rotation=90, fontsize=7)
    axes.set(ylabel="error [mm]", title="Errors of lengths, with one predicted standard deviation")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8)


def _form(axes: Axes, hall: Hall, test: "Tested") -> None:
    balls = [hall.balls[name] for name in test.free]
    away = [np.linalg.norm(ball.centre) for ball in balls]
    axes.plot(away, [1e3 * band95(test.free[ball.name].residual) for ball in balls], "o", label="P_Form.Sph.D95")
    size = [abs(2e3 * test.free[ball.name].radius - 1e3 * ball.diameter) for ball in balls]
    axes.plot(away, size, "s", mfc="none", label="|P_Size.Sph|")
    plates = [(np.linalg.norm(plate.centre), 1e3 * test.flatness[plate.name]) for plate in hall.plates]
    axes.plot(*np.array(plates).T, "D", color="C3", label="plates, E_Form.Pla.D95")
    axes.plot([0.9, 2.55], [4.5, 4.5], "k--", lw=1, label="limit of both forms to 2.5 m")
    axes.set(xlabel="distance from the axis [m]", ylabel="[mm]", title="Form and size against distance")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
