"""The picture of a room, with its dimensions, a scale, the table's angle 0 and a legend."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxscan.measurement import RoomBox
from jaxscan.reconstruction import PointCloud
from jaxscan.report.clouds.picture import BACKGROUND, draw_cloud, draw_room
from jaxscan.report.clouds.room import Room, dimension_text, room_of
from jaxscan.report.clouds.view import Frame, room_view
from jaxscan.report.drawing import BLUE, INK, RED


WIDTH = 1600
FAR_M = 1000.0
"""Single precision still holds a tenth of a millimetre at this distance from 0."""
LETTER_PX = 25
"""Height of letters: readable where a page shows the picture half as wide."""
_ROW_PX = 44
_DPI = 100
_LENGTHS_M = tuple(step * 10.0**power for power in range(-6, 7) for step in (1, 2, 5))
_PAPER = "#{:02x}{:02x}{:02x}".format(*BACKGROUND.astype(int))
_BESIDE = 0.03
"""Dimension lines stand off the room by this share of its extent."""


class Line(NamedTuple):
    """A dimension in the picture."""

    ends: np.ndarray
    """[2, 3], m."""
    text: str
    outwards: np.ndarray
    """Unit vector away from the room [3]."""


class _Item(NamedTuple):
    """One entry of the legend."""

    draw: Callable[[Any, float, float, float], None]
    """Called with axes, left end, height and width of the mark [px]."""
    wide: float
    words: str


class Label(NamedTuple):
    """Words in the picture, for those who ask where they are."""

    words: str
    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""


class RoomPicture(NamedTuple):
    """A marked picture."""

    rgb: np.ndarray
    """uint8 [height, width, 3]."""
    labels: tuple[Label, ...]


def room_picture(cloud: PointCloud, box: RoomBox | None = None, *, width: int = WIDTH) -> RoomPicture:
    """A room, cut open, with what a person wants to know beside it.

    Args:
        cloud: The room, z up. A cloud without points gives an empty picture.
        box: Its dimensions, as `measure_room` finds them, where it does.
        width: Of the picture [px]; letters and lines are equally large in every picture.
    """
    cloud, box = _near_zero(cloud, box)
    xyz, rgb, normals = (np.asarray(field) for field in (cloud.xyz, cloud.rgb, cloud.normals))
    if not np.asarray(cloud.valid).any():
        return RoomPicture(draw_cloud(xyz, rgb, size=(width, width // 2)), ())
    room = room_of(cloud, box)
    lines = dimension_lines(room, np.array(room_view(xyz[np.asarray(cloud.valid)]).eye))
    outer = [line.ends + 2.0 * _BESIDE * room.extent * line.outwards for line in lines]
    picture, frame = draw_room(xyz, rgb, normals=normals, beside=np.concatenate(outer) if outer else None, width=width)
    return _marked(picture, frame, room, lines)


def _near_zero(cloud: PointCloud, box: RoomBox | None) -> tuple[PointCloud, RoomBox | None]:
    """The same room about 0 if it is far from there: pictures are drawn in single precision."""
    valid, xyz = np.asarray(cloud.valid), np.asarray(cloud.xyz, np.float64)
    place = np.round(np.median(xyz[valid], axis=0)) if valid.any() else np.zeros(3)
    if np.linalg.norm(place) < FAR_M:
        return cloud, box
    stations = cloud.stations
    if stations is not None:
        pose = np.array(stations.pose, np.float64)
        pose[:, :3, 3] -= place
        stations = stations._replace(pose=pose)
    near = np.where(valid[..., None], xyz - place, 0.0).astype(np.float32)
    moved = dataclasses.replace(cloud, xyz=near, stations=stations)
    return moved, None if box is None else dataclasses.replace(box, centre_m=box.centre_m - place)


def dimension_lines(room: Room, eye: np.ndarray) -> list[Line]:
    """The dimensions of a room, along those of its edges where they hide nothing of it.

    Args:
        room: The room.
        eye: From where it is seen [3], m.
    """
    near = [float(eye @ axis.direction > 0.5 * (axis.low + axis.high)) for axis in room.axes]
    lines = []
    for number, axis in enumerate(room.axes):
        if axis.dimension is None:
            continue
        # Along the floor at the foot of the near wall that was cut away; up, where a far wall ends.
        aside = 1 - number if number < 2 else 0
        shares = np.array([near[0], near[1], 0.0]) if number < 2 else np.array([near[0], 1.0 - near[1], 0.0])
        ends = np.stack([shares, shares])
        ends[:, number] = 0.0, 1.0
        outwards = room.axes[aside].direction * (1.0 if near[aside] else -1.0)
        lines.append(Line(room.at(ends) + _BESIDE * room.extent * outwards, dimension_text(axis.dimension), outwards))
    return lines


def _marked(picture: np.ndarray, frame: Frame, room: Room, lines: list[Line]) -> RoomPicture:
    # Imported here, so that only drawing loads matplotlib.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = picture.shape[:2]
    items = _legend(room, frame)
    # Rows of the legend are known when its words are measured; no more rows than items.
    whole = height + _ROW_PX * (len(items) + 1)
    figure = Figure(figsize=(width / _DPI, whole / _DPI), dpi=_DPI, facecolor=_PAPER)
    canvas = FigureCanvasAgg(figure)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_axis_off()
    axes.set_xlim(0, width)
    axes.set_ylim(whole, 0)
    figure.figimage(picture, 0, whole - height, origin="upper", zorder=-1)
    axes.patch.set_visible(False)
    texts = [_draw_dimension(axes, frame, line) for line in lines]
    texts += _draw_station(axes, frame, room)
    edge = 0.02 * width
    left, bottom = float(width), height
    for item in items:
        text = axes.text(0, 0, item.words, color=INK, va="center", **_font())
        mark = item.wide + 0.5 * LETTER_PX * (item.wide > 0)
        wide = mark + text.get_window_extent(canvas.get_renderer()).width
        if left + wide > width - edge:
            left, bottom = edge, bottom + _ROW_PX
        item.draw(axes, left, bottom - 0.5 * _ROW_PX, item.wide)
        text.set_position((left + mark, bottom - 0.5 * _ROW_PX))
        texts.append(text)
        left += wide + 1.4 * LETTER_PX
    canvas.draw()
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in texts]
    labels = [
        Label(text.get_text(), (box.x0, whole - box.y1, box.x1, whole - box.y0))
        for text, box in zip(texts, boxes, strict=True)
    ]
    rgb = np.asarray(canvas.buffer_rgba())[: bottom + round(0.3 * _ROW_PX), :width, :3].copy()
    return RoomPicture(rgb, tuple(labels))


def _font() -> dict[str, Any]:
    return {"fontsize": LETTER_PX * 72 / _DPI, "fontfamily": "DejaVu Sans", "parse_math": False}


def _halo() -> list[Any]:
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=5, foreground=_PAPER)]


def _draw_dimension(axes: Any, frame: Frame, line: Line) -> Any:
    start, end = frame.pixels(line.ends)
    along = (end - start) / np.linalg.norm(end - start)
    tip = frame.pixels(line.ends + 0.1 * line.outwards) - frame.pixels(line.ends)
    out = np.array([along[1], -along[0]])
    out *= np.sign(out @ tip.mean(0)) or 1.0
    axes.plot(*np.stack([start, end]).T, color=INK, linewidth=2.2, solid_capstyle="butt")
    for place in (start, end):
        axes.plot(*np.stack([place - 11 * out, place + 11 * out]).T, color=INK, linewidth=2.2)
    turn = float(np.degrees(np.arctan2(-along[1], along[0])))
    turn = turn - 180.0 * np.round(turn / 180.0)
    at = 0.5 * (start + end) + 1.05 * LETTER_PX * out
    return axes.text(
        *at, line.text, color=INK, rotation=turn, rotation_mode="anchor", ha="center", va="center", **_font()
    )


def _draw_station(axes: Any, frame: Frame, room: Room) -> list[Any]:
    """The floor under the scanner that it does not see, where it stood, and its angle 0."""
    texts = []
    for number, (place, x) in enumerate(room.stations):
        foot = room.foot(place)
        reach = max(0.62 * (room.hole_m or 0.0), 0.11 * room.extent)
        if number == 0 and room.hole_m is not None:
            turns = np.linspace(0.0, 2.0 * np.pi, 181)
            side = np.cross(room.axes[2].direction, x)
            ring = foot + room.hole_m * (np.outer(np.cos(turns), x) + np.outer(np.sin(turns), side))
            axes.plot(*frame.pixels(ring).T, color=BLUE, linewidth=2.2, dashes=(5, 4), path_effects=_halo())
        start, end = frame.pixels(np.stack([foot, foot + reach * x]))
        _draw_arrow(axes, start, end)
        axes.plot(*start, "o", color=RED, markersize=11, markeredgecolor="white")
        ahead = (end - start) / max(float(np.linalg.norm(end - start)), 1e-6)
        at = end + 1.1 * LETTER_PX * ahead
        text = axes.text(*at, "0°", color=RED, ha="center", va="center", path_effects=_halo(), **_font())
        texts.append(text)
    return texts


def _draw_arrow(axes: Any, start: Sequence[float] | np.ndarray, end: Sequence[float] | np.ndarray) -> None:
    look = {"arrowstyle": "-|>", "color": RED, "linewidth": 3, "mutation_scale": 26}
    axes.annotate("", tuple(end), tuple(start), arrowprops=look)


def _draw_bar(axes: Any, left: float, y: float, wide: float) -> None:
    part = 0.25 * wide
    for number in range(4):
        ends = [left + number * part, left + (number + 1) * part]
        filled = INK if number % 2 == 0 else "white"
        axes.fill_between(ends, y - 7, y + 7, facecolor=filled, edgecolor=INK, linewidth=1.5)


def _draw_ring(axes: Any, left: float, y: float, wide: float) -> None:
    axes.plot([left, left + wide], [y, y], color=BLUE, linewidth=2.2, dashes=(5, 4))


def _draw_zero(axes: Any, left: float, y: float, wide: float) -> None:
    _draw_arrow(axes, (left, y), (left + wide, y))
    axes.plot(left + 5, y, "o", color=RED, markersize=11, markeredgecolor="white")


def _draw_nothing(axes: Any, left: float, y: float, wide: float) -> None:
    del axes, left, y, wide


def _legend(room: Room, frame: Frame) -> list["_Item"]:
    metres, wide = _scale(room, frame)
    where = "at the scanner" if len(room.stations) else "in the middle"
    items = [_Item(_draw_bar, wide, f"{metres:g} m on the floor, {where}")]
    if len(room.stations):
        scanners = "scanners and angles" if len(room.stations) > 1 else "scanner and angle"
        items.append(_Item(_draw_zero, 70.0, f"{scanners} 0 of the table"))
    if any(axis.dimension is not None for axis in room.axes):
        items.append(_Item(_draw_nothing, 0.0, "± one standard deviation"))
    if room.hole_m is not None:
        words = "hole in the floor, out of the camera's sight"
        items.append(_Item(_draw_ring, 70.0, words))
    return [*items, _Item(_draw_nothing, 0.0, "ceiling and near walls are left out")]


def _scale(room: Room, frame: Frame) -> tuple[float, float]:
    """A round length [m], and its length in the picture [px], across the view on the floor where the scanner stands."""
    place = room.stations[0, 0] if len(room.stations) else room.at(np.full((1, 3), 0.5))[0]
    far = float(frame.local(room.foot(place)[None])[0, 2])
    per_metre = frame.focal / far
    fitting = [length for length in _LENGTHS_M if length * per_metre < 0.2 * frame.size[0]]
    return fitting[-1], fitting[-1] * per_metre
