"""Whether laser-off images move from record to record as calibration and angles say."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CaptureError
from jaxscan.geometry import Array, Rig, Scanner, Turntable, invert, median_sigma, poses, transform
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.sweep import SweepSource
from jaxscan.stripes import box_mean


_SIZE_PX = 320
"""Larger side of a reduced image, at most [px]."""
_FLAT_PX = 7
"""Half of the square whose mean is taken away: vignetting and lamps move with the camera [px]."""
_POINTS, _LINES, _HALF = 16, 3, 12
"""Points of a record, and half a window around each, across and along its way [px]."""
_RECORDS = 6
"""Records from which pairs are taken."""
_CLEAR = 0.7
"""Correlation from which a pair tells how far it turned [1]."""
_ALIKE = 0.9
"""Correlation where the angle says, in that of the best place, from which a pair agrees: a texture may repeat [1]."""
_FEW, _MOST = 4, 0.7
"""Pairs that must tell, and the part of them that must agree on another turn [1]."""
_NEAR_PX, _NEAR = 3.0, 0.1
"""Motion at which a place is that of the angle: pixels, and a part of it [1]."""
_LEAST_PX = 5.0
"""Motion from which a pair tells a ratio, seen or by the journal [px]."""
_SIGMAS, _FLOOR, _SCALE = 10.0, 0.003, 0.03
"""How sure a contradiction must be, the least sigma of a ratio (distances and pixels are only so good), and the least
error of a scale [1]."""
_STILL_M = 0.002
"""Differences of stripes by which the table did turn [m]."""
_FAR_PX = 20.0
"""Motion of the wider pairs by the journal [px]."""

Points = Callable[[int], np.ndarray | None]
"""Points of the stripe of a record [points, 3], in the scanner frame, as the laser has them at angle 0 [m]."""


class _Ways(NamedTuple):
    """Where points of one record would be seen from other angles."""

    turns: np.ndarray
    """Turns of the table [rad]; 0 in the middle."""
    pixels: np.ndarray
    """Places in the reduced image, far outside for those behind the camera [2, points, lines, turns]."""


class _Turn(NamedTuple):
    """What a pair of records shows, where it tells anything."""

    seen: float
    said: float
    px: float
    """The larger of both in the reduced image [px]."""

    @property
    def ratio(self) -> float:
        """The turn that is seen, in that of the journal [1]."""
        return self.seen / self.said


def cloud_points(cloud: PointCloud, scanner: Scanner) -> Points:
    """The points of each record of a cloud, turned back to angle 0."""
    record, rig = np.asarray(cloud.record), scanner.rig

    def points(one: int) -> np.ndarray | None:
        profiles = np.flatnonzero(record == one)
        if not len(profiles) or not isinstance(scanner.turntable, Turntable):
            return None
        first = int(profiles[0])
        found = np.asarray(cloud.xyz[first], np.float64)[np.asarray(cloud.valid[first])]
        turned = poses(rig, float(cloud.angle[first]))
        return np.asarray(transform(poses(rig, 0.0), transform(invert(turned), found)))

    return points


def refuse_other_motion(
    sweep: SweepSource, scanner: Scanner, points: Points, off_frame: Callable[[int], Array | None], name: str
) -> None:
    """Refuse a sweep whose images move otherwise than its angles say.

    The laser gives the distance of points in a record, so calibration and angle say where each must be seen in the
    laser-off image of another record. It is looked for at all other turns too. Images that show nothing, or several
    places alike, tell nothing. Only NumPy computes, on a few reduced images.

    Args:
        points: Of its records, in the order along the stripe.
        off_frame: The laser-off image of a record.
        name: Of the capture, for the message.

    Raises:
        CaptureError: If nearly all pairs of records that tell anything agree on another turn, by more than ten sigmas.
    """
    table = scanner.turntable
    if not isinstance(table, Turntable):
        return
    found = [turn for turn in _turns(sweep, scanner, points, off_frame) if turn.px >= _LEAST_PX]
    if len(found) < _FEW:
        return
    ratio = float(np.median([turn.ratio for turn in found]))
    agreed = [turn for turn in found if abs(turn.ratio - ratio) <= _NEAR * max(abs(ratio), _NEAR)]
    if len(agreed) < max(_FEW, _MOST * len(found)):
        return
    ratios = np.array([turn.ratio for turn in agreed])
    sigma = max(median_sigma(ratios - ratio) / np.sqrt(len(ratios)), _FLOOR)
    if abs(ratio - 1.0) <= max(_SIGMAS * sigma, _SCALE * max(1.0, abs(ratio))):
        return
    # Dirt on the lens stands still, and so does what is behind an object that turns.
    if abs(ratio) < _NEAR and (table.carries == "object" or not _same_stripes(points, len(sweep))):
        return
    first = agreed[0]
    raise CaptureError(
        f"{name}: the pictures turn by {np.degrees(first.seen):.3g} deg where the journal says "
        f"{np.degrees(first.said):.3g} deg, in {len(agreed)} of {len(found)} pairs of records: {_cause(ratio)}."
    )


def _cause(ratio: float) -> str:
    if abs(ratio * np.pi / 180 - 1) < 0.15:
        return "angle_deg is in radians; write degrees"
    if abs(ratio + 1) < 0.15:
        return "angle_deg has the wrong sign, or images are in another order; turn the sign, or name the right images"
    if abs(ratio) < _NEAR:
        return "the table did not turn, or all records name images of one place; name the right images"
    return f"multiply angle_deg by {ratio:.3g}, or use the calibration of this table"


def _records(count: int) -> list[int]:
    return np.unique(np.linspace(0, count - 1, min(count, _RECORDS)).astype(int)).tolist()


def _some(stripe: np.ndarray) -> np.ndarray:
    """Points of a stripe, evenly along it."""
    return stripe[np.linspace(0, len(stripe) - 1, _POINTS).astype(int)]


def _same_stripes(points: Points, count: int) -> bool:
    """Whether the laser shows the same in all records, as it does where nothing turns."""
    found = [points(one) for one in _records(count)]
    whole = [_some(stripe) for stripe in found if stripe is not None and len(stripe) >= _POINTS]
    return len(whole) > 1 and float(np.median(np.linalg.norm(np.ptp(whole, 0), axis=-1))) < _STILL_M


def _turns(
    sweep: SweepSource, scanner: Scanner, points: Points, off_frame: Callable[[int], Array | None]
) -> list[_Turn]:
    camera, count = scanner.camera, len(sweep)
    factor = max(2, -(-max(camera.width, camera.height) // _SIZE_PX))
    images: dict[int, np.ndarray | None] = {}

    def image(record: int) -> np.ndarray | None:
        if record not in images:
            frame = off_frame(record)
            images[record] = None if frame is None else _reduced(frame, factor, len(sweep.exposures) > 1)
        return images[record]

    found = []
    for one in _records(count):
        stripe = points(one)
        if stripe is None or len(stripe) < _POINTS:
            continue
        ways = _ways(scanner.rig, _some(stripe), factor, max(camera.width, camera.height) // factor)
        seen = image(one)
        if seen is None:
            continue
        strips = _strips(seen, ways.pixels)
        for other in _partners(sweep.angles, one, ways.turns):
            turned = image(other)
            said = (sweep.angles[other] - sweep.angles[one] + np.pi) % (2 * np.pi) - np.pi
            if turned is not None:
                alike, at_stripe = _correlation(strips, _strips(turned, ways.pixels))
                # Beside the stripe on a thing that turns may be what does not.
                alike = alike if scanner.turntable.carries == "scanner" else at_stripe
                turn = _judged(alike, at_stripe, ways.turns, float(said))
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
    lines = frame[: rows * factor, : columns * factor].reshape(rows, factor, -1).sum(1, dtype=np.uint32)
    small = lines.reshape(rows, columns, factor).sum(2).astype(np.float32) / factor**2
    small = small - box_mean(small[None], _FLAT_PX, _FLAT_PX)[0]
    # One bright edge is not worth more than many of a texture.
    most = float(np.quantile(np.abs(small), 0.98))
    return np.clip(small, -most, most)


def _ways(rig: Rig, points: np.ndarray, factor: int, reach: int) -> _Ways:
    """Where points [points, 3] of a record at angle 0 are seen from other angles, up to `reach` pixels away."""

    def seen(places: np.ndarray, phi: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
        p = np.asarray(transform(invert(poses(rig, phi)), places))
        return p, (np.asarray(rig.camera.project(p)) + 0.5) / factor - 0.5

    little, up = 1e-3, np.array([0.0, 0.0, 1.0])
    (before, after), away = (seen(points, turn)[1] for turn in (-little, little)), seen(points, 0.0)[0]
    step = 2 * little / max(float(np.median(np.linalg.norm(after - before, axis=-1))), 1e-9)
    turns = step * np.arange(-reach, reach + 1)
    height = little * np.linalg.norm(away, axis=1, keepdims=True) * up
    px = np.linalg.norm(seen(points + height, 0.0)[1] - seen(points - height, 0.0)[1], axis=-1)
    across = 2 * height / np.maximum(px, 1e-9)[:, None]
    lines = points[:, None] + np.arange(-_LINES, _LINES + 1)[:, None] * across[:, None]
    p, pixels = seen(lines[:, :, None], turns)
    return _Ways(turns, np.moveaxis(np.where(p[..., 2:] > 0.01, pixels, -9.0), -1, 0))


class _Strips(NamedTuple):
    """An image along the ways."""

    values: np.ndarray
    """[points, lines, turns]; 0 outside of the image."""
    inside: np.ndarray
    """[points, turns]"""


def _strips(image: np.ndarray, pixels: np.ndarray) -> _Strips:
    rows, columns = image.shape
    x, y = pixels.astype(np.float32)
    inside = (x >= 0) & (x <= columns - 1.001) & (y >= 0) & (y <= rows - 1.001)
    x, y = np.clip(x, 0, columns - 1.001), np.clip(y, 0, rows - 1.001)
    i, j = y.astype(np.int32), x.astype(np.int32)
    a, b = y - i, x - j
    flat, at = image.ravel(), i * columns + j
    above = flat[at] * (1 - b) + flat[at + 1] * b
    below = flat[at + columns] * (1 - b) + flat[at + columns + 1] * b
    return _Strips(np.where(inside, above * (1 - a) + below * a, 0.0), np.all(inside, axis=1))


def _correlation(one: _Strips, other: _Strips) -> tuple[np.ndarray, np.ndarray]:
    """Correlation of all windows of one image with the other after each turn, and of those at the stripe alone.

    NaN where too few are seen.
    """
    count = one.values.shape[2]
    middle, wide, size = count // 2, 2 * _HALF + 1, count + 2 * _HALF
    spectrum = np.fft.rfft(other.values, size)
    energy, inside = (
        np.apply_along_axis(np.convolve, 1, part, np.ones(wide), "same")
        for part in ((other.values**2).sum(1), other.inside.astype(np.float64))
    )
    inside = inside > wide - 0.5
    sums = np.zeros((4, count))
    at_stripe = None
    # Beside the stripe distances are much the same, and more of the image is compared.
    for centre in (0, -5 * _HALF, 5 * _HALF):
        if not wide <= middle + centre < count - wide:
            continue
        part = np.s_[middle + centre - _HALF : middle + centre + _HALF + 1]
        usable = inside & np.all(one.inside[:, part], axis=1)[:, None]
        own = one.values[..., part]
        product = np.fft.irfft((spectrum * np.conj(np.fft.rfft(own, size))).sum(1), size)
        alike = np.roll(product, _HALF, 1)[:, :count]
        values = (alike, np.broadcast_to((own**2).sum((1, 2))[:, None], alike.shape), energy, np.ones_like(alike))
        total = np.stack([np.where(usable, value, 0.0).sum(0) for value in values])
        start, stop = max(centre, 0), count + min(centre, 0)
        sums[:, start - centre : stop - centre] += total[:, start:stop]
        at_stripe = total if centre == 0 else at_stripe
    at_stripe = sums if at_stripe is None else at_stripe
    return _normalised(sums), _normalised(at_stripe)


def _normalised(sums: np.ndarray) -> np.ndarray:
    enough = sums[3] >= max(0.3 * float(sums[3].max()), 8.0)
    return np.where(enough, sums[0] / np.sqrt(np.maximum(sums[1] * sums[2], 1e-9)), np.nan)


def _judged(alike: np.ndarray, at_stripe: np.ndarray, turns: np.ndarray, said: float) -> _Turn | None:
    step = float(turns[1] - turns[0])
    near = np.abs(turns - said) <= _NEAR_PX * step + _NEAR * abs(said)
    # A turn that cannot be seen is not contradicted by things that look alike.
    if not near.any() or np.isnan(alike[near]).all():
        return None
    best = int(np.nanargmax(alike))
    if alike[best] < _CLEAR:
        return None
    if np.nanmax(alike[near]) >= _ALIKE * alike[best]:
        best = int(np.nanargmax(np.where(near, alike, np.nan)))
    # Only at the stripe is the distance known, which a small difference takes.
    around = slice(max(best - 2, 0), best + 3)
    if np.isfinite(at_stripe[around]).all():
        alike, best = at_stripe, around.start + int(np.argmax(at_stripe[around]))
    seen = float(turns[best]) + step * _peak(alike, best)
    return _Turn(seen, said, max(abs(seen), abs(said)) / step)


def _peak(values: np.ndarray, best: int) -> float:
    """Where between its neighbours a largest value lies [steps], by a parabola."""
    around = values[max(best - 1, 0) : best + 2]
    if len(around) < 3 or not np.isfinite(around).all():
        return 0.0
    bend = 2 * around[1] - around[0] - around[2]
    return float(np.clip(0.5 * (around[2] - around[0]) / bend, -0.5, 0.5)) if bend > 0 else 0.0
