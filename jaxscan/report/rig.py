"""The drawing of a rig: camera, sheets and axis in one scale."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxscan.geometry import LinearStage, Scanner, Turntable
from jaxscan.report.drawing import BLUE, INK, ROUND, SERIES, SOFT, new_figure, plain


if TYPE_CHECKING:
    from matplotlib.figure import Figure


_UP = {"-v": (0.0, -1.0, 0.0), "+v": (0.0, 1.0, 0.0), "+u": (1.0, 0.0, 0.0), "-u": (-1.0, 0.0, 0.0)}
_ASIDE, _ABOVE = np.radians(np.arange(-80.0, 81.0, 10.0)), np.radians(24.0)
"""Views from which the rig may be drawn: how far round from behind, and how far up."""


def sheet_slopes_deg(scanner: Scanner) -> list[tuple[str, float]]:
    """The angles of the sheets to the camera's line of sight, with their names."""
    ahead = np.array([0.0, 0.0, 1.0])
    slopes = (min(abs(float(_normal(scanner, k) @ ahead)), 1.0) for k in range(len(scanner.laser_names)))
    return list(zip(scanner.laser_names, np.degrees(np.arcsin(list(slopes))).tolist(), strict=True))


def rig_lengths(scanner: Scanner) -> list[tuple[str, float]]:
    """The distances of the camera's centre from the axis and from the sheets, with their names [m]."""
    table = scanner.turntable
    found = []
    if isinstance(table, Turntable):
        found.append(("camera to axis", float(np.linalg.norm(_axis_foot(table)))))
    return found + [
        (f"camera to sheet {name}", abs(float(scanner.laser(k).distance))) for k, name in enumerate(scanner.laser_names)
    ]


def rig_figure(scanner: Scanner) -> "Figure":
    """Camera, sheets and axis in one scale, seen from aside, behind and above."""
    up, ahead, right = _directions(scanner)
    size = max([value for _, value in rig_lengths(scanner)] + [0.02])
    feet = [_sheet_foot(scanner, k) for k in range(len(scanner.laser_names))]
    feet += [_axis_foot(scanner.turntable)] if isinstance(scanner.turntable, Turntable) else []
    canvas = _Canvas(up, ahead, right, np.array(feet))
    for number in range(len(scanner.laser_names)):
        _draw_sheet(canvas, scanner, number, size)
    if isinstance(scanner.turntable, Turntable):
        _draw_axis(canvas, scanner.turntable, size)
    elif isinstance(scanner.turntable, LinearStage):
        way = np.asarray(scanner.turntable.direction, np.float64)
        canvas.arrow(np.zeros(3), 0.9 * size * way, INK)
        canvas.words(1.0 * size * way, "travel", INK)
    _draw_camera(canvas, scanner, size)
    away = feet[0] / max(float(np.linalg.norm(feet[0])), 1e-9)
    canvas.words(-0.2 * size * away - 0.12 * size * up, "camera", INK)
    return canvas.finished(size)


def _normal(scanner: Scanner, number: int) -> np.ndarray:
    return np.asarray(scanner.laser(number).normal, np.float64)


def _sheet_foot(scanner: Scanner, number: int) -> np.ndarray:
    """The point of a sheet nearest the camera's centre [3], m."""
    return float(scanner.laser(number).distance) * _normal(scanner, number)


def _axis_foot(table: Turntable) -> np.ndarray:
    """The point of the axis nearest the camera's centre [3], m."""
    direction, point = (np.asarray(part, np.float64) for part in (table.direction, table.point))
    direction = direction / np.linalg.norm(direction)
    return point - (point @ direction) * direction


def _directions(scanner: Scanner) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    up = np.array(_UP[scanner.up])
    if isinstance(scanner.turntable, Turntable):
        up = np.asarray(scanner.turntable.direction, np.float64)
    up = up / np.linalg.norm(up)
    ahead = np.array([0.0, 0.0, 1.0])
    # A camera that looks along the axis has no horizontal direction ahead.
    ahead = np.array([1.0, 0.0, 0.0]) if abs(ahead @ up) > 0.99 else ahead
    ahead = ahead - (ahead @ up) * up
    ahead = ahead / np.linalg.norm(ahead)
    return up, ahead, np.cross(ahead, up)


class _Canvas:
    """Draws places of the camera frame [m] as millimetres of a picture."""

    def __init__(self, up: np.ndarray, ahead: np.ndarray, right: np.ndarray, lengths: np.ndarray) -> None:
        """Up, horizontally ahead and across are unit vectors; none of the lengths [n, 3] is seen from its end."""

        def onto(aside: float) -> np.ndarray:
            level = np.cos(aside) * right + np.sin(aside) * ahead
            away = -np.sin(aside) * right + np.cos(aside) * ahead
            return np.stack([level, np.cos(_ABOVE) * up + np.sin(_ABOVE) * away])

        def seen(aside: float) -> float:
            shares = np.linalg.norm(lengths @ onto(aside).T, axis=1) / np.maximum(np.linalg.norm(lengths, axis=1), 1e-9)
            # Ahead should not point at the eye either.
            return float(min([*shares, 1.3 * abs(onto(aside)[0] @ ahead)]))

        self.to_picture = 1e3 * onto(max(_ASIDE.tolist(), key=seen))
        self.up, self.ahead = up, ahead
        self.figure = new_figure(5.4, 3.9, fitted=False)
        self.axes: Any = self.figure.add_axes((0.02, 0.02, 0.96, 0.96))
        self.axes.set_axis_off()
        self.axes.set_aspect("equal", adjustable="datalim")

    def at(self, places: np.ndarray) -> np.ndarray:
        return np.asarray(places, np.float64) @ self.to_picture.T

    def line(self, places: np.ndarray, colour: str, *, width: float = 1.4, style: str = "-") -> None:
        self.axes.plot(*self.at(places).T, style, color=colour, linewidth=width)

    def area(self, places: np.ndarray, colour: str, alpha: float) -> None:
        self.axes.fill(*self.at(places).T, facecolor=colour, alpha=alpha, edgecolor=colour, linewidth=1.0)

    def arrow(self, start: np.ndarray, end: np.ndarray, colour: str) -> None:
        look = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4}
        self.axes.annotate("", tuple(self.at(end)), tuple(self.at(start)), arrowprops=look)

    def words(self, place: np.ndarray, text: str, colour: str, **how: Any) -> None:
        halo = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
        style = {"ha": "center", "va": "center", "fontsize": 9, "bbox": halo} | how
        self.axes.text(*self.at(place), text, color=colour, parse_math=False, **style)

    def finished(self, size: float) -> "Figure":
        """The finished figure, with a scale."""
        length = max(step for step in ROUND if step <= 0.5 * size)
        low, high = np.array(self.axes.get_xlim()), np.array(self.axes.get_ylim())
        y, x = high[0] - 0.04 * np.ptp(high), low[0]
        for part in range(2):
            ends = x + 1e3 * length * 0.5 * np.array([part, part + 1])
            filled = INK if part == 0 else "white"
            self.axes.fill_between(ends, y, y + 0.02 * np.ptp(high), facecolor=filled, edgecolor=INK, linewidth=0.8)
        self.axes.text(x + 1.06e3 * length, y + 0.01 * np.ptp(high), f"{1e3 * length:g} mm", va="center", color=INK)
        return self.figure


def _draw_sheet(canvas: _Canvas, scanner: Scanner, number: int, size: float) -> None:
    normal, foot = _normal(scanner, number), _sheet_foot(scanner, number)
    colour = SERIES[(1 + number) % len(SERIES)]
    along = canvas.ahead - (canvas.ahead @ normal) * normal
    along = canvas.up if np.linalg.norm(along) < 1e-6 else along / np.linalg.norm(along)
    across = np.cross(normal, along)
    # A fan that widens ahead, as from a line laser near the foot.
    fan = [foot - 0.12 * size * across, foot + 0.12 * size * across]
    fan += [foot + 1.7 * size * along + side * 0.6 * size * across for side in (1.0, -1.0)]
    canvas.area(np.array(fan), colour, 0.22)
    name = plain(scanner.laser_names[number], 18)
    canvas.line(np.array([np.zeros(3), foot]), colour, style="--")
    canvas.words(0.55 * foot, f"{1e3 * np.linalg.norm(foot):.1f} mm", colour)
    canvas.words(foot + 1.25 * size * along, f"sheet {name}", colour)


def _draw_axis(canvas: _Canvas, table: Turntable, size: float) -> None:
    foot = _axis_foot(table)
    direction = np.asarray(table.direction, np.float64)
    turns = np.linspace(0.3, 2.0 * np.pi - 0.3, 60)
    side = np.cross(direction, canvas.ahead)
    ahead = np.cross(side, direction)
    ring = (
        foot - 0.75 * size * direction + 0.22 * size * (np.outer(np.cos(turns), side) + np.outer(np.sin(turns), ahead))
    )
    canvas.line(np.array([foot - 0.9 * size * direction, foot + 0.75 * size * direction]), BLUE, style="-.", width=1.6)
    canvas.line(ring, BLUE)
    canvas.arrow(ring[-2], ring[-1], BLUE)
    canvas.words(foot + 0.85 * size * direction, "axis", BLUE)
    canvas.line(np.array([np.zeros(3), foot]), SOFT, style="--")
    canvas.words(0.5 * foot - 0.08 * size * canvas.up, f"{1e3 * np.linalg.norm(foot):.1f} mm", SOFT)


def _draw_camera(canvas: _Canvas, scanner: Scanner, size: float) -> None:
    camera = scanner.camera
    corners = np.array([[0, 0], [camera.width - 1, 0], [camera.width - 1, camera.height - 1], [0, camera.height - 1]])
    rays = np.asarray(camera.unproject(corners.astype(np.float64)))
    ends = 0.55 * size * rays
    if np.isfinite(ends).all():
        for end in ends:
            canvas.line(np.array([np.zeros(3), end]), INK, width=1.0)
        canvas.area(ends, INK, 0.06)
    canvas.axes.plot(*canvas.at(np.zeros(3)), "o", color=INK, markersize=6)
