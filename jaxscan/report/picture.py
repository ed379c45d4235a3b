"""Pictures of coloured clouds, drawn in software: no display, no OpenGL.

Points are added between neighbouring profiles of one surface. All points are projected into a depth buffer and drawn
as large as their spacing. Eye-dome lighting (Boucheny 2009) darkens points behind their surroundings, which shows
shapes without shadows. Dark clouds are brightened.
"""

from dataclasses import dataclass

import numpy as np


BACKGROUND = np.array([244.0, 245.0, 247.0], np.float32)
SPLAT_M = 0.011
"""Size of a point [m]: about the spacing of a scan in steps of 0.1 degrees at 5 m."""
MAX_SPLAT_PX = 3
SHADING = 9.0
"""Strength of the shading by depth."""
FOV_DEG = 40.0
JOINED = 4.0
"""Neighbouring profiles are joined up to this many times their usual distance."""
MAX_GAIN = 3.0
MAX_BETWEEN, MAX_POINTS = 16, 4_000_000


@dataclass(frozen=True)
class View:
    """A perspective camera of the picture."""

    eye: tuple[float, float, float]
    """Position of the camera [m]."""
    target: tuple[float, float, float]
    """Point in the middle of the picture [m]."""
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fov_deg: float = FOV_DEG
    """Field of view across the picture's width."""
    cut_away: bool = True
    """Leave out surfaces that are seen from behind, and the ceiling and near walls, which hide the room."""


def room_view(xyz: np.ndarray, size: tuple[int, int] = (1600, 900)) -> View:
    """The view into a room from above one of its corners.

    Args:
        xyz: Points [n, 3], m, z up.
        size: Width and height of the picture [px].
    """
    axes, low, high = _room_box(xyz)
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), -1).reshape(-1, 3) @ axes
    extent = np.maximum(high - low, 0.1)
    # From a corner, looking more along the longer side, so that both far walls are seen.
    sideways = np.array([-0.62, -0.78]) if extent[0] < extent[1] else np.array([-0.78, -0.62])
    away = np.array([*sideways, 0.9]) @ axes
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
    return View(_triple(target + distance * away), _triple(target))


def _triple(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def draw_cloud(
    xyz: np.ndarray,
    rgb: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    size: tuple[int, int] = (1600, 900),
    view: View | None = None,
) -> np.ndarray:
    """Draw a coloured cloud.

    Args:
        xyz: Points [..., 3], m; rows that are zero are taken as missing. On the grid [profile, line, 3]
            neighbouring profiles of one surface are joined.
        rgb: Colours [..., 3], uint8.
        normals: Normals towards the scanner [..., 3], zero where unknown; they tell which surfaces are seen from
            behind.
        size: Width and height of the picture [px].
        view: The camera of the picture; by default `room_view`.

    Returns:
        Picture, uint8 [height, width, 3], RGB.
    """
    points, colours, towards = _between_profiles(xyz, rgb, normals)
    width, height = size
    if len(points) == 0:
        return np.broadcast_to(BACKGROUND.astype(np.uint8), (height, width, 3)).copy()
    colours = _brightened(colours)
    view = room_view(points, size) if view is None else view
    if view.cut_away:
        kept = _in_sight(points, towards, np.array(view.eye, np.float32))
        points, colours = points[kept], colours[kept]
    focal = 0.5 * width / np.tan(0.5 * np.radians(view.fov_deg))
    depth, picture = _splat(points, colours, view, focal, size)
    depth, picture = _close_holes(depth, picture, focal)
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


def _room_box(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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


def _in_sight(points: np.ndarray, normals: np.ndarray | None, eye: np.ndarray) -> np.ndarray:
    """Which points to draw in a view into a room from outside [n]."""
    axes, low, high = _room_box(points)
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


def _splat(
    points: np.ndarray, colours: np.ndarray, view: View, focal: float, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Depth and colour of the nearest point in each pixel; the depth is infinite where there is none."""
    width, height = size
    forward = np.array(view.target) - np.array(view.eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, view.up)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward]).astype(np.float32)
    local = (points - np.array(view.eye, np.float32)) @ axes.T
    ahead = local[:, 2] > 0.05
    local, colours = local[ahead], colours[ahead]
    u = np.round(focal * local[:, 0] / local[:, 2] + 0.5 * width).astype(np.int32)
    v = np.round(focal * local[:, 1] / local[:, 2] + 0.5 * height).astype(np.int32)
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
