"""Whether laser-off images move from record to record as calibration and angles say."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.geometry import AbstractCamera, Array, Scanner, Turntable
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.plan import Plan


_SIZE_PX = 320
"""Larger side of a reduced image, at most [px]."""
_FLAT_PX = 7
"""Half of the square whose mean is taken away: vignetting and lamps move with the camera [px]."""
_POINTS, _LINES, _HALF = 24, 4, 12
"""Points of a record, and half a window around each, across and along its way [px]."""
_RECORDS = 6
"""Records from which pairs are taken."""
_CLEAR = 0.6
"""Correlation from which a pair tells how far it turned [1]."""
_LOST = 0.6
"""Correlation where the angle says, in that of the best place, below which a pair contradicts it [1]."""
_FEW, _MOST = 4, 0.8
"""Pairs that must tell, and the part of them that must contradict [1]."""
_NEAR_PX, _NEAR = 3.0, 0.1
"""Motion that is never doubted: pixels, and a part of it [1]."""
_SIGMAS, _FLOOR = 10.0, 0.003
"""How sure a contradiction must be, and the least sigma of a ratio: distances and pixels are only so good [1]."""
_FAR_PX = 20.0
"""Motion of the wider pairs by the journal [px]."""


class _Ways(NamedTuple):
    """Where points of one record would be seen from other angles."""

    turns: np.ndarray
    """Turns of the table [rad]; 0 in the middle."""
    pixels: np.ndarray
    """Places in the reduced image, NaN behind the camera [points, lines, turns, 2]."""


class _Turn(NamedTuple):
    """What a pair of records shows, where it tells anything."""

    ratio: float
    """Turn that is seen, in that of the journal [1]."""
    seen: float
    said: float
    contradicts: bool


def refuse_other_motion(plan: Plan, cloud: PointCloud, off_frame: Callable[[int], Array | None], name: str) -> None:
    """Refuse a sweep whose images move otherwise than its angles say.

    The laser gives the distance of points in a record, so calibration and angle say where each must be seen in the
    laser-off image of another record. It is looked for at all other turns too. Images that show nothing, or several
    places alike, tell nothing.

    Args:
        plan: The sweep and its scanner.
        cloud: Its cloud.
        off_frame: The laser-off image of a record.
        name: Of the capture, for the message.

    Raises:
        CaptureError: If nearly all pairs of records that tell anything agree on another turn, by more than ten sigmas.
    """
    table = plan.scanner.turntable
    if not isinstance(table, Turntable) or plan.predicts or len(plan.sweep) < 2:
        return
    found = _turns(plan, cloud, table, off_frame)
    if len(found) < _FEW:
        return
    against = [turn for turn in found if turn.contradicts]
    if len(against) < max(_FEW, _MOST * len(found)):
        return
    ratios = np.array([turn.ratio for turn in against])
    ratio = float(np.median(ratios))
    spread = float(np.median(np.abs(ratios - ratio)))
    sigma = max(1.4826 * spread / np.sqrt(len(ratios)), _FLOOR)
    # Behind an object that turns, the background stands still by right.
    still = table.carries == "object" and abs(ratio) < _NEAR
    if still or spread > _NEAR * max(abs(ratio), 0.1) or abs(ratio - 1.0) < _SIGMAS * sigma:
        return
    first = against[0]
    raise CaptureError(
        f"{name}: the pictures turn by {np.degrees(first.seen):.3g} deg where the journal says "
        f"{np.degrees(first.said):.3g} deg, in {len(against)} of {len(found)} pairs of records: {_cause(ratio)}."
    )


def _cause(ratio: float) -> str:
    if abs(ratio * np.pi / 180 - 1) < 0.15:
        return "angle_deg is in radians; write degrees"
    if abs(ratio + 1) < 0.15:
        return "angle_deg has the wrong sign, or images are in another order; turn the sign, or name the right images"
    if abs(ratio) < _NEAR:
        return "the table did not turn, or all records name images of one place; name the right images"
    return f"multiply angle_deg by {ratio:.3g}, or use the calibration of this table"


def _turns(plan: Plan, cloud: PointCloud, table: Turntable, off_frame: Callable[[int], Array | None]) -> list[_Turn]:
    sweep, count = plan.sweep, len(plan.sweep)
    camera = plan.scanner.as_dtype(np.float32).camera
    factor = max(2, -(-max(camera.width, camera.height) // _SIZE_PX))
    images: dict[int, np.ndarray | None] = {}

    def image(record: int) -> np.ndarray | None:
        if record not in images:
            frame = off_frame(record)
            images[record] = None if frame is None else _reduced(frame, factor, len(sweep.exposures) > 1)
        return images[record]

    record = np.asarray(cloud.record)
    found = []
    for one in np.unique(np.linspace(0, count - 1, min(count, _RECORDS)).astype(int)).tolist():
        seen, profiles = image(one), np.flatnonzero(record == one)
        points = _points(cloud, profiles, plan.scanner, float(sweep.angles[one])) if len(profiles) else None
        if seen is None or points is None:
            continue
        ways = _ways(camera, table, points, factor)
        for other in _partners(sweep.angles, one, ways.turns):
            turned = image(other)
            said = (sweep.angles[other] - sweep.angles[one] + np.pi) % (2 * np.pi) - np.pi
            if turned is not None:
                turn = _judged(_correlation(seen, turned, ways.pixels), ways.turns, float(said))
                found += [] if turn is None else [turn]
    return found


def _partners(angles: np.ndarray, one: int, turns: np.ndarray) -> list[int]:
    """The next records with another angle on both sides, and those that are farther by the journal."""
    said = np.abs((angles - angles[one] + np.pi) % (2 * np.pi) - np.pi)
    chosen = set()
    for least in (1e-6, _FAR_PX * float(turns[1] - turns[0])):
        moved = np.flatnonzero(said > least)
        chosen |= {int(side[k]) for side, k in ((moved[moved < one], -1), (moved[moved > one], 0)) if len(side)}
    return sorted(chosen)


def _reduced(frame: Array, factor: int, bracket: bool) -> np.ndarray:
    """A smaller image without its slow changes, float32 [rows, columns]; a mosaic loses its colours."""
    frame = np.asarray(frame)
    frame = frame[len(frame) // 2] if bracket else frame
    frame = frame[..., 1] if frame.ndim == 3 else frame
    rows, columns = (size // factor for size in frame.shape)
    blocks = frame[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    small = blocks.mean((1, 3), dtype=np.float32)
    small = small - _box(_box(small).T).T
    # One bright edge is not worth more than many of a texture.
    most = float(np.quantile(np.abs(small), 0.98))
    return np.clip(small, -most, most)


def _box(image: np.ndarray) -> np.ndarray:
    """Means along the columns of a row."""
    at = np.arange(image.shape[1])
    first, stop = np.maximum(at - _FLAT_PX, 0), np.minimum(at + _FLAT_PX + 1, image.shape[1])
    sums = np.pad(np.cumsum(image, 1, dtype=np.float64), ((0, 0), (1, 0)))
    return ((sums[:, stop] - sums[:, first]) / (stop - first)).astype(np.float32)


def _points(cloud: PointCloud, profiles: np.ndarray, scanner: Scanner, angle: float) -> np.ndarray | None:
    """Points of a record, evenly along its stripe, in the camera frame at its angle [points, 3]."""
    profile = profiles[0]
    valid = np.flatnonzero(np.asarray(cloud.valid)[profile])
    if len(valid) < _POINTS:
        return None
    chosen = valid[np.linspace(0, len(valid) - 1, _POINTS).astype(int)]
    pose = np.asarray(scanner.pose(np.float64(angle)), np.float64)
    return (np.asarray(cloud.xyz, np.float64)[profile, chosen] - pose[:3, 3]) @ pose[:3, :3]


def _ways(camera: AbstractCamera, table: Turntable, points: np.ndarray, factor: int) -> _Ways:
    axis, foot = (np.asarray(part, np.float64) for part in (table.direction, table.point))
    gain = float(np.asarray(table.gain)) * (1 if table.carries == "scanner" else -1)

    def turned(turns: np.ndarray) -> np.ndarray:
        """The points as the camera sees them after each turn [points, turns, 3]."""
        theta = -gain * turns[:, None]
        apart = points - foot
        along = (apart @ axis)[:, None, None] * axis
        across, side = apart[:, None] - along, np.cross(axis, apart)[:, None]
        return foot + along + np.cos(theta) * across + np.sin(theta) * side

    def pixels(places: np.ndarray) -> np.ndarray:
        with jax.enable_x64(False):
            flat = np.asarray(_project(camera, places.reshape(-1, 3).astype(np.float32)), np.float64)
        return ((flat + 0.5) / factor - 0.5).reshape(*places.shape[:-1], 2)

    little = 1e-3
    before, after = np.moveaxis(pixels(turned(np.array([-little, little]))), 1, 0)
    step = 2 * little / max(float(np.median(np.linalg.norm(after - before, axis=-1))), 1e-9)
    reach = max(camera.width, camera.height) // factor
    turns = step * np.arange(-reach, reach + 1)
    height = little * np.linalg.norm(points, axis=1, keepdims=True) * axis
    px = np.linalg.norm(pixels(points + height) - pixels(points - height), axis=-1)
    lines = np.arange(-_LINES, _LINES + 1)[:, None, None]
    across = 2 * height / np.maximum(px, 1e-9)[:, None]
    places = turned(turns)[:, None] + lines * across[:, None, None]
    found = pixels(places)
    return _Ways(turns, np.where(places[..., 2:] > 0.01, found, np.nan))


@jax.jit
def _project(camera: AbstractCamera, places: Array) -> Array:
    return jax.vmap(camera.project)(places)


def _strips(image: np.ndarray, pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image along the ways, and where they are within it."""
    x, y = np.nan_to_num(pixels[..., 0], nan=-1.0), np.nan_to_num(pixels[..., 1], nan=-1.0)
    rows, columns = image.shape
    inside = (x >= 0) & (x <= columns - 1.001) & (y >= 0) & (y <= rows - 1.001)
    x, y = np.clip(x, 0, columns - 1.001), np.clip(y, 0, rows - 1.001)
    i, j = y.astype(int), x.astype(int)
    a, b = y - i, x - j
    above = image[i, j] * (1 - b) + image[i, j + 1] * b
    below = image[i + 1, j] * (1 - b) + image[i + 1, j + 1] * b
    return np.where(inside, above * (1 - a) + below * a, 0.0), inside


def _correlation(one: np.ndarray, other: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Correlation of all windows of one image with the other after each turn; NaN where too few are seen."""
    (first, near), (second, there) = _strips(one, pixels), _strips(other, pixels)
    count, middle, wide = pixels.shape[2], pixels.shape[2] // 2, 2 * _HALF + 1
    edge = ((0, 0), (0, 0), (_HALF, _HALF))
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(second, edge), wide, -1)
    inside = np.lib.stride_tricks.sliding_window_view(np.pad(there.all(1), edge[1:]), wide, -1).all(-1)
    energy = np.einsum("pzjw,pzjw->pj", windows, windows)
    sums = np.zeros((4, count))
    # Beside the stripe distances are much the same, and more of the image is compared.
    for centre in (0, -5 * _HALF, 5 * _HALF):
        if not wide <= middle + centre < count - wide:
            continue
        part = np.s_[middle + centre - _HALF : middle + centre + _HALF + 1]
        known = near[..., part].all((1, 2))
        own = first[..., part] * known[:, None, None]
        usable = inside & known[:, None]
        alike = np.einsum("pzw,pzjw->pj", own, windows)
        values = (alike, np.broadcast_to((own**2).sum((1, 2))[:, None], alike.shape), energy, np.ones_like(alike))
        for k, value in enumerate(values):
            total = np.where(usable, value, 0.0).sum(0)
            start, stop = max(centre, 0), count + min(centre, 0)
            sums[k, start - centre : stop - centre] += total[start:stop]
    enough = sums[3] >= max(0.3 * float(sums[3].max()), 8.0)
    return np.where(enough, sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-9)), np.nan)


def _judged(alike: np.ndarray, turns: np.ndarray, said: float) -> _Turn | None:
    step = float(turns[1] - turns[0])
    near = np.abs(turns - said) <= _NEAR_PX * step + _NEAR * abs(said)
    # A turn that cannot be seen is not contradicted by things that look alike.
    if not near.any() or np.isnan(alike[near]).all():
        return None
    best = int(np.nanargmax(alike))
    if alike[best] < _CLEAR:
        return None
    seen = float(turns[best])
    return _Turn(seen / said, seen, said, bool(np.nanmax(alike[near]) < _LOST * alike[best]))
