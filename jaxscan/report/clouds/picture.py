"""Pictures of clouds, and of rooms with their dimensions."""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxscan.measurement import Dimension, RoomBox
from jaxscan.measurement.samples import Cloud, places_of
from jaxscan.reconstruction import PointCloud
from jaxscan.report.drawing import BLUE, INK, RED, ROUND


FOV_DEG = 26.0
TALL = 0.85
"""Greatest height of a canvas that fits a room, over its width."""


@dataclass(frozen=True)
class Viewpoint:
    """A perspective camera of the picture; places in metres, the field of view across its width."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    """Point in the middle of the picture [m]."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov_deg: float = FOV_DEG
    cut_away: bool = True
    """Leave out surfaces that are seen from behind, and the ceiling and near walls, which hide the room."""


def room_view(xyz: np.ndarray, size: tuple[int, int] = (1600, 900)) -> Viewpoint:
    """The view into a room [n, 3], m, z up, from above one of its corners; the picture has this size [px]."""
    axes, low, high = room_box(xyz)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), -1).reshape(-1, 3) @ axes
    extent = np.maximum(high - low, 0.1)
    # From a corner, looking more along the longer side, so that both far walls are seen.
    sideways = np.array([-0.62, -0.78]) if extent[0] < extent[1] else np.array([-0.78, -0.62])
    away = np.array([*sideways, 0.62]) @ axes
    away = away / np.linalg.norm(away)
    right = np.cross(-away, (0.0, 0.0, 1.0))
    right = right / np.linalg.norm(right)
    down = np.cross(-away, right)
    reach = np.tan(0.5 * np.radians(FOV_DEG)) * 0.96
    shape = np.array([1.0, size[1] / size[0]])
    # The corner nearest the eye is cut away with the ceiling and the near walls.
    corners = np.delete(corners, np.argmax(corners @ away), axis=0)
    target, distance = corners.mean(0), float(np.linalg.norm(extent))
    for _ in range(20):
        # Put the middle of the projected box into the middle of the picture, and fill it.
        local = (corners - target - distance * away) @ np.stack([right, down, -away], 1)
        seen = local[:, :2] / local[:, 2:] / shape
        middle = 0.5 * (seen.min(0) + seen.max(0)) * shape * distance
        target = target + middle[0] * right + middle[1] * down
        distance *= 1.0 + 0.7 * (0.5 * np.ptp(seen, axis=0).max() / reach - 1.0)
        distance = float(np.clip(distance, 0.6 * np.linalg.norm(extent), 6.0 * np.linalg.norm(extent)))
    return Viewpoint(_triple(target + distance * away), _triple(target))


class Canvas(NamedTuple):
    """A view on a canvas; lengths in pixels."""

    view: Viewpoint
    focal: float
    middle: tuple[float, float]
    """Column and row of the point that the view looks at [px]."""
    size: tuple[int, int]

    def local(self, points: np.ndarray) -> np.ndarray:
        """Points [n, 3], m, in the frame of the camera: right, down, ahead [n, 3], m."""
        forward = np.array(self.view.target) - np.array(self.view.eye)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, self.view.up)
        right = right / np.linalg.norm(right)
        axes = np.stack([right, np.cross(forward, right), forward])
        return (points - np.array(self.view.eye, points.dtype)) @ axes.T.astype(points.dtype)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Columns and rows [n, 2], px, of points [n, 3], m, that are ahead of the camera."""
        local = self.local(points)
        return self.focal * local[:, :2] / local[:, 2:] + np.array(self.middle, points.dtype)


def frame_of(view: Viewpoint, size: tuple[int, int]) -> Canvas:
    """A view in the middle of a canvas of this width and height [px]."""
    width, height = size
    return Canvas(view, 0.5 * width / np.tan(0.5 * np.radians(view.fov_deg)), (0.5 * width, 0.5 * height), size)


def fitted_frame(view: Viewpoint, points: np.ndarray, width: int, margin: int) -> Canvas:
    """A view on a canvas that the points [n, 3], m, ahead of the eye, just fill, except for a margin [px] at each edge.

    The height follows from the points, `TALL` times the width [px] at most.
    """
    unit = Canvas(view, 1.0, (0.0, 0.0), (1, 1))
    seen = unit.pixels(points)
    low, high = seen.min(0), seen.max(0)
    # A single point would be infinitely large.
    across, down = np.maximum(high - low, 0.02)
    inner = width - 2 * margin
    focal = inner / max(across, down / TALL)
    height = round(focal * down) + 2 * margin
    middle = np.array([0.5 * width, 0.5 * height]) - focal * 0.5 * (low + high)
    return Canvas(view, float(focal), (float(middle[0]), float(middle[1])), (width, height))


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def room_box(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The upright box of the smallest area around a cloud: its axes [3, 3], and its ends along them [3].

    Half a per cent of the points may lie outside on every side.
    """
    some = xyz[:: max(1, len(xyz) // 30_000)].astype(np.float64)

    def box(yaw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        c, s = np.cos(yaw), np.sin(yaw)
        axes = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        low, high = np.percentile(some @ axes.T, [0.5, 99.5], axis=0)
        return axes, low, high

    boxes = [box(yaw) for yaw in np.radians(np.arange(0.0, 90.0, 2.0))]
    return min(boxes, key=lambda one: float(np.prod((one[2] - one[1])[:2])))


ON_THE_FLOOR_M = 0.06
SMALLEST_HOLE_M = 0.15
MOST_STATIONS = 8


class Axis(NamedTuple):
    """A direction of a room."""

    direction: np.ndarray
    low: float
    """Position of the nearer wall along the direction [m]."""
    high: float
    dimension: Dimension | None
    """From wall to wall; None where one of the two was not found, and the ends are those of the points."""


@dataclass(frozen=True)
class DrawnRoom:
    """A room as its picture shows it."""

    axes: tuple[Axis, Axis, Axis]
    """The two horizontal ones, and that which points up."""
    stations: np.ndarray
    """Where the scanner stood, and its x axis [stations, 2, 3]; none for a cloud that was not turned."""
    hole_m: float | None
    """Radius of the floor under the first station that has no points [m]; None where there is none."""

    def at(self, shares: np.ndarray) -> np.ndarray:
        """Places [n, 3], m, by their shares of the way through the room along its axes [n, 3]."""
        along = np.array([axis.low + shares[:, i] * (axis.high - axis.low) for i, axis in enumerate(self.axes)])
        return np.linalg.solve(np.array([axis.direction for axis in self.axes]), along).T

    @property
    def extent(self) -> float:
        """Length of the longest side [m]."""
        return max(axis.high - axis.low for axis in self.axes)

    def foot(self, place: np.ndarray) -> np.ndarray:
        """The point of the floor [3], m, below a place [3], m."""
        up = self.axes[2]
        return place + (up.low - up.direction @ place) * up.direction


def room_of(cloud: Cloud, box: RoomBox | None) -> DrawnRoom:
    """Collect the dimensions, the outline and the station of a cloud's room: one valid point at least, z up."""
    xyz = np.asarray(cloud.xyz, np.float64)[np.asarray(cloud.valid)]
    axes, pose = _axes(xyz, box), places_of(cloud).pose[:MOST_STATIONS]
    if not is_turned(cloud):
        return DrawnRoom(axes, np.zeros((0, 2, 3)), None)
    room = DrawnRoom(axes, np.stack([pose[:, :3, 3], pose[:, :3, 0]], 1), None)
    return dataclasses.replace(room, hole_m=_hole(xyz, room.foot(room.stations[0, 0]), axes[2]))


def is_turned(cloud: Cloud) -> bool:
    """Whether the profiles of a cloud point where a table of their angles would have turned them."""
    valid, angle = np.asarray(cloud.valid), np.asarray(cloud.angle, np.float64)
    if np.ptp(angle) == 0:
        return False
    places = places_of(cloud)
    xyz = np.asarray(cloud.xyz, np.float64) - places.pose[places.number][:, None, :3, 3]
    ahead = np.where(valid[..., None], xyz, 0.0).sum(1)
    local = np.einsum("pji,pj->pi", places.pose[places.number][:, :3, :3], ahead)
    azimuth = np.arctan2(local[:, 1], local[:, 0])[valid.any(1)]
    turned = angle[valid.any(1)]
    apart = np.abs([np.mean(np.exp(1j * (azimuth - sense * turned))) for sense in (1.0, -1.0)])
    return bool(apart.max() > 0.8)


def _axes(xyz: np.ndarray, box: RoomBox | None) -> tuple[Axis, Axis, Axis]:
    found = [] if box is None else list(box.sides.values())
    level = [side for side in found if side is not (box and box.height)]
    directions = room_box(xyz)[0] if not level else _upright(level[0].direction)
    axes = []
    for direction in directions:
        side = max(found, key=lambda each: abs(each.direction @ direction), default=None)
        if side is None or box is None or abs(side.direction @ direction) < 0.8:
            low, high = np.percentile(xyz @ direction, [0.5, 99.5])
            axes.append(Axis(direction, float(low), float(high), None))
            continue
        exact = side.direction * np.sign(side.direction @ direction)
        middle = float(exact @ box.centre_m)
        axes.append(Axis(exact, middle - 0.5 * side.value_m, middle + 0.5 * side.value_m, side))
    return axes[0], axes[1], axes[2]


def _upright(along: np.ndarray) -> np.ndarray:
    """Two horizontal directions, the first near `along`, and the vertical [3, 3]."""
    level = np.array([along[0], along[1], 0.0]) / np.linalg.norm(along[:2])
    return np.array([level, [-level[1], level[0], 0.0], [0.0, 0.0, 1.0]])


def _hole(xyz: np.ndarray, foot: np.ndarray, up: Axis) -> float | None:
    floor = xyz[np.abs(xyz @ up.direction - up.low) < ON_THE_FLOOR_M]
    if len(floor) < 100:
        return None
    apart = floor - foot
    radius = float(np.percentile(np.linalg.norm(apart - np.outer(apart @ up.direction, up.direction), axis=1), 0.5))
    return radius if radius > SMALLEST_HOLE_M else None


def dimension_text(side: Dimension) -> str:
    """A dimension with the digits of `jaxscan measure room`: its value, and one standard deviation."""
    return f"{side.value_m:.4f} m ± {1e3 * side.sigma_m:.2f} mm"


# Pictures of coloured clouds, drawn in software: no display, no OpenGL.
#
# Points are added between neighbouring profiles of one surface. All points are projected into a depth buffer and drawn
# as large as their spacing. Eye-dome lighting (Boucheny 2009) darkens points behind their surroundings, which shows
# shapes without shadows. Dark clouds are brightened.

BACKGROUND = np.array([244.0, 245.0, 247.0], np.float32)
SPLAT_M = 0.011
"""Size of a point [m]: about the spacing of a scan in steps of 0.1 degrees at 5 m."""
MAX_SPLAT_PX = 4
SHADING = 9.0
JOINED = 4.0
"""Neighbouring profiles are joined up to this many times their usual distance."""
MAX_GAIN = 3.0
MARGIN = 0.02
"""Left free at each edge of a canvas that a room fills, over its width."""
MAX_BETWEEN, MAX_POINTS = 16, 4_000_000


def draw_cloud(
    xyz: np.ndarray,
    rgb: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    size: tuple[int, int] = (1600, 900),
    view: Viewpoint | None = None,
) -> np.ndarray:
    """Draw a coloured cloud; returns uint8 [height, width, 3], RGB.

    Args:
        xyz: Points [..., 3], m; rows that are zero are taken as missing. On the grid [profile, line, 3]
            neighbouring profiles of one surface are joined.
        rgb: Colours [..., 3], uint8.
        normals: Normals towards the scanner [..., 3], zero where unknown; they tell which surfaces are seen from
            behind.
        size: Width and height of the picture [px].
        view: The camera of the picture; by default `room_view`.
    """
    points, colours, towards = _between_profiles(xyz, rgb, normals)
    width, height = size
    if len(points) == 0:
        return np.broadcast_to(BACKGROUND.astype(np.uint8), (height, width, 3)).copy()
    view = room_view(points, size) if view is None else view
    if view.cut_away:
        kept = _in_sight(points, towards, np.array(view.eye, np.float32))
        points, colours = points[kept], colours[kept]
    return _drawn(points, _brightened(colours), frame_of(view, size))


def draw_room(
    xyz: np.ndarray,
    rgb: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    beside: np.ndarray | None = None,
    width: int = 1600,
) -> tuple[np.ndarray, Canvas]:
    """Draw a room, cut open, on a canvas of a width [px] that it fills together with further places `beside` [n, 3], m.
    Other arguments are those of `draw_cloud`; there must be a point. Returns the picture, uint8 RGB, and its frame.
    """
    points, colours, towards = _between_profiles(xyz, rgb, normals)
    view = room_view(points)
    kept = _in_sight(points, towards, np.array(view.eye, np.float32))
    # A cloud of a few points is not cut open.
    kept = kept if kept.any() else ~kept
    points, colours = points[kept], colours[kept]
    shown = points[:: max(1, len(points) // 100_000)].astype(np.float64)
    shown = shown if beside is None else np.concatenate([shown, beside])
    frame = fitted_frame(view, shown, width, round(MARGIN * width))
    return _drawn(points, _brightened(colours), frame), frame


def _drawn(points: np.ndarray, colours: np.ndarray, frame: Canvas) -> np.ndarray:
    depth, picture = _splat(points, colours, frame)
    depth, picture = _close_holes(depth, picture, frame.focal)
    return _shade(depth, picture)


def _between_profiles(
    xyz: np.ndarray, rgb: np.ndarray, normals: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The valid points as a list. On a grid, points are added between neighbouring profiles of one surface, so that a
    coarse sweep shows surfaces and not stripes."""
    fields = [np.asarray(xyz, np.float32), np.asarray(rgb).astype(np.float32)]
    fields += [] if normals is None else [np.asarray(normals, np.float32)]
    exists = np.asarray(fields[0].any(axis=-1))
    parts = [[field[exists] for field in fields]]
    if exists.ndim == 2 and len(exists) > 2 and exists.any():
        following = [np.roll(field, -1, axis=0) for field in fields]
        far = np.linalg.norm(fields[0], axis=-1)
        gap = np.linalg.norm(following[0] - fields[0], axis=-1)
        both = exists & np.roll(exists, -1, axis=0)
        usual = float(np.median(gap[both] / far[both])) if both.any() else 0.0
        both &= gap < JOINED * usual * np.minimum(far, np.roll(far, -1, axis=0))
        added = int(np.clip(np.ceil(usual * float(np.median(far[exists])) / SPLAT_M) - 1, 0, MAX_BETWEEN))
        added = min(added, MAX_POINTS // max(int(exists.sum()), 1))
        for weight in np.arange(1, added + 1, dtype=np.float32) / (added + 1):
            parts.append([(1 - weight) * a[both] + weight * b[both] for a, b in zip(fields, following, strict=True)])
    points, colours, *towards = (np.concatenate(field) for field in zip(*parts, strict=True))
    return points, colours.astype(np.uint8), towards[0] if towards else None


def _brightened(colours: np.ndarray) -> np.ndarray:
    """The colours, brightened if even the brightest are dark."""
    brightest = float(np.percentile(colours[:: max(1, len(colours) // 200_000)].max(axis=1), 98))
    gain = np.clip(235.0 / max(brightest, 1.0), 1.0, MAX_GAIN)
    return np.clip(colours.astype(np.float32) * gain, 0, 255).astype(np.uint8)


def _in_sight(points: np.ndarray, normals: np.ndarray | None, eye: np.ndarray) -> np.ndarray:
    """Which points to draw in a view into a room from outside [n]."""
    axes, low, high = room_box(points)
    axes = axes.astype(np.float32)
    margin = 0.02 * float(np.linalg.norm(high - low))
    local, seen_from = points @ axes.T, axes @ eye
    kept = np.ones(len(points), bool)
    for axis in range(3):
        # Leave out the ceiling and the walls between the eye and the room.
        if seen_from[axis] < low[axis]:
            kept &= local[:, axis] > low[axis] + margin
        if seen_from[axis] > high[axis]:
            kept &= local[:, axis] < high[axis] - margin
    if normals is not None:
        known = normals.any(axis=1)
        kept &= (np.einsum("ij,ij->i", normals, eye - points) > 0) | ~known
    return kept


def _splat(points: np.ndarray, colours: np.ndarray, frame: Canvas) -> tuple[np.ndarray, np.ndarray]:
    """Depth and colour of the nearest point in each pixel; the depth is infinite where there is none."""
    width, height = frame.size
    local = frame.local(points)
    ahead = local[:, 2] > 0.05
    local, colours = local[ahead], colours[ahead]
    u, v = (np.round(frame.focal * local[:, i] / local[:, 2] + frame.middle[i]).astype(np.int32) for i in range(2))
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    pixel = (v[inside] * width + u[inside]).astype(np.int64)
    # One integer per point: depth in the upper half, so that it sorts by depth, and the point's number below.
    key = (local[inside, 2].view(np.int32).astype(np.int64) << 32) | np.flatnonzero(inside)
    nearest = np.full(width * height, np.iinfo(np.int64).max)
    np.minimum.at(nearest, pixel, key)
    hit = nearest < np.iinfo(np.int64).max
    index = nearest[hit] & 0xFFFFFFFF
    depth = np.full(width * height, np.inf, np.float32)
    picture = np.zeros((width * height, 3), np.float32)
    depth[hit], picture[hit] = local[index, 2], colours[index]
    return depth.reshape(height, width), picture.reshape(height, width, 3)


def _close_holes(depth: np.ndarray, picture: np.ndarray, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """Enlarge every point to its size in the picture; near points cover far ones."""
    reach = np.clip(0.5 * focal * SPLAT_M / depth, 0.0, MAX_SPLAT_PX)
    reach[~np.isfinite(depth)] = 0.0
    best, source = depth.copy(), np.arange(depth.size).reshape(depth.shape)
    r = MAX_SPLAT_PX
    rows, columns = depth.shape
    for dv in range(-r, r + 1):
        for du in range(-r, r + 1):
            apart = np.hypot(du, dv)
            if apart == 0 or apart > r + 0.3:
                continue
            to = (slice(max(dv, 0), rows + min(dv, 0)), slice(max(du, 0), columns + min(du, 0)))
            of = (slice(max(-dv, 0), rows + min(-dv, 0)), slice(max(-du, 0), columns + min(-du, 0)))
            # A point keeps its own pixel unless a clearly nearer one covers it.
            candidate = depth[of] * np.float32(1.0 + 0.004 * apart)
            take = (reach[of] + 0.5 >= apart) & (candidate < best[to])
            np.copyto(best[to], candidate, where=take)
            np.copyto(source[to], np.arange(depth.size).reshape(depth.shape)[of], where=take)
    return best, picture.reshape(-1, 3)[source.ravel()].reshape(picture.shape)


def _shade(depth: np.ndarray, picture: np.ndarray) -> np.ndarray:
    """Darken pixels that lie behind their surroundings, and add the background."""
    seen = np.isfinite(depth)
    log = np.log2(np.where(seen, depth, 1.0)).astype(np.float32)
    shadow = np.zeros_like(log)
    for distance in (2, 5):
        for dv, du in ((0, 1), (1, 0), (0, -1), (-1, 0)):
            moved = np.roll(log, (dv * distance, du * distance), (0, 1))
            both = seen & np.roll(seen, (dv * distance, du * distance), (0, 1))
            shadow += np.where(both, np.clip(log - moved, 0.0, 0.08), 0.0)
    light = np.exp(-SHADING * shadow / 8.0)[:, :, None]
    shaded = np.where(seen[:, :, None], picture * light, BACKGROUND)
    return np.clip(np.round(shaded), 0, 255).astype(np.uint8)


WIDTH = 1600
FAR_M = 1000.0
"""Single precision still holds a tenth of a millimetre at this distance from 0."""
LETTER_PX = 25
"""Height of letters: readable where a page shows the picture half as wide."""
_ROW_PX = 44
_DPI = 100
_PAPER = "#{:02x}{:02x}{:02x}".format(*BACKGROUND.astype(int))
_BESIDE = 0.03
"""Dimension lines stand off the room by this share of its extent."""


class DimensionMark(NamedTuple):
    """A dimension in the picture."""

    ends: np.ndarray
    """[2, 3], m."""
    text: str
    outwards: np.ndarray


class _Item(NamedTuple):
    """One entry of the legend."""

    draw: Callable[[Any, float, float, float], None] | None
    """Called with axes, left end, height and width of the mark [px]; None for words alone."""
    wide: float
    words: str


class Label(NamedTuple):
    """Words in the picture, with their places."""

    words: str
    box: tuple[float, float, float, float]
    """Left, top, right, bottom [px]."""


class RoomPicture(NamedTuple):
    """A marked picture."""

    rgb: np.ndarray
    labels: tuple[Label, ...]


def room_picture(cloud: PointCloud, box: RoomBox | None = None, *, width: int = WIDTH) -> RoomPicture:
    """A room, cut open, z up, with what a person wants to know beside it; its dimensions, where some were found.

    Letters and lines are equally large in every picture. A cloud without points gives an empty picture.
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


def dimension_lines(room: DrawnRoom, eye: np.ndarray) -> list[DimensionMark]:
    """The dimensions of a room seen from an eye [3], m, drawn along edges where they do not hide the room."""
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
        lines.append(
            DimensionMark(room.at(ends) + _BESIDE * room.extent * outwards, dimension_text(axis.dimension), outwards)
        )
    return lines


def _marked(picture: np.ndarray, frame: Canvas, room: DrawnRoom, lines: list[DimensionMark]) -> RoomPicture:
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
        if item.draw is not None:
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


def _draw_dimension(axes: Any, frame: Canvas, line: DimensionMark) -> Any:
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


def _draw_station(axes: Any, frame: Canvas, room: DrawnRoom) -> list[Any]:
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
        texts.append(axes.text(*at, "0°", color=RED, ha="center", va="center", path_effects=_halo(), **_font()))
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


def _legend(room: DrawnRoom, frame: Canvas) -> list["_Item"]:
    metres, wide = _scale(room, frame)
    where = "at the scanner" if len(room.stations) else "in the middle"
    items = [_Item(_draw_bar, wide, f"{metres:g} m on the floor, {where}")]
    if len(room.stations):
        scanners = "scanners and angles" if len(room.stations) > 1 else "scanner and angle"
        items.append(_Item(_draw_zero, 70.0, f"{scanners} 0 of the table"))
    if any(axis.dimension is not None for axis in room.axes):
        items.append(_Item(None, 0.0, "± one standard deviation"))
    if room.hole_m is not None:
        items.append(_Item(_draw_ring, 70.0, "hole in the floor, out of the camera's sight"))
    return [*items, _Item(None, 0.0, "ceiling and near walls are left out")]


def _scale(room: DrawnRoom, frame: Canvas) -> tuple[float, float]:
    """A round length [m], and its length in the picture [px], across the view on the floor where the scanner stands."""
    place = room.stations[0, 0] if len(room.stations) else room.at(np.full((1, 3), 0.5))[0]
    far = float(frame.local(room.foot(place)[None])[0, 2])
    per_metre = frame.focal / far
    length = max((one for one in ROUND if one * per_metre < 0.2 * frame.size[0]), default=ROUND[0])
    return length, length * per_metre
