"""Pictures of coloured clouds, drawn in software: no display, no OpenGL.

Points are added between neighbouring profiles of one surface. All points are projected into a depth buffer and drawn
as large as their spacing. Eye-dome lighting (Boucheny 2009) darkens points behind their surroundings, which shows
shapes without shadows. Dark clouds are brightened.
"""

import numpy as np

from jaxscan.report.clouds.view import Frame, View, fitted_frame, frame_of, room_box, room_view


BACKGROUND = np.array([244.0, 245.0, 247.0], np.float32)
SPLAT_M = 0.011
"""Size of a point [m]: about the spacing of a scan in steps of 0.1 degrees at 5 m."""
MAX_SPLAT_PX = 4
SHADING = 9.0
"""Strength of the shading by depth."""
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
) -> tuple[np.ndarray, Frame]:
    """Draw a room, cut open, on a canvas that it fills.

    Args:
        xyz: As of `draw_cloud`, with one point at least.
        rgb: As of `draw_cloud`.
        normals: As of `draw_cloud`.
        beside: Other places that must be on the canvas [n, 3], m.
        width: Of the picture [px]; its height is that of the room in it.

    Returns:
        Picture, uint8 [height, width, 3], RGB, and its frame.
    """
    points, colours, towards = _between_profiles(xyz, rgb, normals)
    view = room_view(points)
    kept = _in_sight(points, towards, np.array(view.eye, np.float32))
    # A few points are no room that could be cut open.
    kept = kept if kept.any() else ~kept
    points, colours = points[kept], colours[kept]
    shown = points[:: max(1, len(points) // 100_000)].astype(np.float64)
    shown = shown if beside is None else np.concatenate([shown, beside])
    frame = fitted_frame(view, shown, width, round(MARGIN * width))
    return _drawn(points, _brightened(colours), frame), frame


def _drawn(points: np.ndarray, colours: np.ndarray, frame: Frame) -> np.ndarray:
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


def _splat(points: np.ndarray, colours: np.ndarray, frame: Frame) -> tuple[np.ndarray, np.ndarray]:
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
