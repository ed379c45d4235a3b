"""Where the laser-off frames of a sweep come from: they are given, one picture is given for all, or they are predicted.

A frame is predicted from itself, and, where the camera turns with the table, from what neighbouring steps show. A point
of the room at one of a few distances is seen at known places of two other steps, whose stripes are elsewhere. Each
place takes the distance at which both agree with each other and with the frame; that is a plane sweep
(R. T. Collins, A space-sweep approach to true multi-image matching, CVPR 1996).

Where there is a choice, the first frames decide which of these ways makes lines straightest.
"""

import dataclasses
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, Scanner, StripeAxis, pixels, poses, rays, stripe_pixel, transform
from jaxscan.reconstruction.ahead import workers
from jaxscan.reconstruction.plan import Plan
from jaxscan.reconstruction.sweep import FrameChunk, SweepSource
from jaxscan.stripes import Channels, Sites, box_mean, laser_sites, predict_off, read_channels, warped


_APART_PX = 24.0
"""Motion of the room from one step to another from which its stripe is out of the way [px]."""
_SEEN = 0.35
"""Part of the image by which the room may move, so that most of it is seen twice [1]."""
_FARTHEST = 16
"""Records on either side that are kept."""
_RANGES = 7
_NEAREST_M, _FARTHEST_M = 0.3, 10.0
"""Distances between which the room is taken to be where the range limits are wider [m]."""
_NODES_PX = 16
"""Distance between the pixels of which the place in another step is computed [px]."""
_AGREE_DN = 8.0
"""Difference of two steps up to which their mean is taken, and beyond it the median of both and the frame itself: one
may have a stripe there, or an edge is not quite where it should be [DN]."""
_MOST_DN = 20.0
"""Residual from which more is not worse [DN]."""
_AROUND = (8, 4)
"""Samples and lines on either side whose residuals choose the distance."""
_DARK_SHARE, _DARK_DN = 0.9, 16.0
"""Part of the pixels of a dark room that are hardly brighter than its median, and by how much they are [DN]."""


class Dark(NamedTuple):
    """Laser-off frames of one source."""

    source: Literal["given", "predicted", "alone", "even"]
    """Given by the sweep; predicted by all channels; each channel predicted by itself; or one colour everywhere."""
    room: UInt8[np.ndarray, "..."] | None = None
    """The frame, where it is of one colour."""


GIVEN = Dark("given")


def predicts(sweep: SweepSource) -> bool:
    """Whether laser-off frames may be predicted, as the first records say: none is given, or one picture for all."""
    return _can_predict(sweep) and _is_one(next(sweep.chunks(2)).off)


def _is_one(off: Array | None) -> bool:
    return off is None or (len(off) > 1 and bool(np.array_equal(off[0], off[1])))


def darks(sweep: SweepSource, first: FrameChunk) -> list[Dark]:
    """The laser-off frames that a sweep may have, the usual first.

    Args:
        first: Its first frames, as `with_off` gives them.
    """
    if not predicts(sweep):
        return [GIVEN]
    given = next(sweep.chunks(1)).off is not None
    found = [GIVEN if given else Dark("predicted")]
    if len(sweep.exposures) > 1:
        return found
    found += [Dark("predicted")] if given else []
    found += [Dark("alone")] if sweep.pixel_format != "mono8" else []
    room = dark_room(sweep, first.on)
    return found if room is None else [*found, Dark("even", room)]


def _can_predict(sweep: SweepSource) -> bool:
    """A laser whose colour is to be learned needs true laser-off frames."""
    return sweep.pixel_format == "mono8" or all(line.colour != "auto" for line in sweep.lasers)


def dark_room(sweep: SweepSource, on: Array) -> UInt8[np.ndarray, "..."] | None:
    """A laser-off frame of one colour, where next to nothing but the laser is seen; else None.

    Args:
        sweep: A sweep of one exposure.
        on: Its first laser-on frames, uint8 [frames, rows, columns] (rgb8: and 3).
    """
    on = np.asarray(on)
    room = np.empty(on.shape[1:], np.uint8)
    # Pixels of one colour: a mosaic repeats itself every two of them.
    tile = 2 if sweep.pixel_format.startswith("bayer") else 1
    for place in np.ndindex((tile, tile)):
        these = np.s_[:, place[0] :: tile, place[1] :: tile]
        level = on[these].reshape(-1, *on.shape[3:])
        middle, bright = np.quantile(level, [0.5, _DARK_SHARE], axis=0)
        if np.any(bright > middle + _DARK_DN):
            return None
        room[these[1:]] = middle.astype(np.uint8)
    return room


def with_off(plan: Plan, dark: Dark | None = None, *, first: int | None = None) -> Iterator[FrameChunk]:
    """The chunks of a sweep with laser-off frames.

    Args:
        dark: Which; those that are given, and predicted ones where none are, where not said.
        first: Records of the first chunk of predicted ones; as of the others where not given.
    """
    sweep, size = plan.sweep, plan.size
    if not _can_predict(sweep):
        yield from sweep.chunks(size)
        return
    alone = dark is not None and dark.source == "alone"
    frames: dict[int, np.ndarray] = {}
    read, done, count = 0, 0, size if first is None else min(first, size)
    with ThreadPoolExecutor(workers()) as pool:
        for chunk in sweep.chunks(size):
            if chunk.off is not None and (dark is None or dark.source == "given"):
                yield chunk
                continue
            if dark is not None and dark.room is not None:
                yield FrameChunk(chunk.on, np.broadcast_to(dark.room, chunk.on.shape))
                continue
            frames |= dict(enumerate(np.asarray(chunk.on), read))
            read += len(chunk.on)
            while done < read and (read == len(sweep) or done + count + _FARTHEST <= read):
                records = range(done, min(done + count, len(sweep)))
                off = pool.map(lambda k, known=frames: _off(plan, k, known, alone), records)
                yield FrameChunk(np.stack([frames[k] for k in records]), np.stack(list(off)))
                done, count = records.stop, size
                frames = {k: frame for k, frame in frames.items() if k >= done - _FARTHEST}


def _off(plan: Plan, record: int, frames: dict[int, np.ndarray], alone: bool) -> np.ndarray:
    """The laser-off frames of a record, of all its exposures."""
    bracket = len(plan.sweep.exposures) > 1
    stacks = {k: frame if bracket else frame[None] for k, frame in frames.items()}
    parts = [
        _predicted(plan, record, {k: stack[e : e + 1] for k, stack in stacks.items()}, alone)
        for e in range(len(stacks[record]))
    ]
    return np.concatenate(parts) if bracket else parts[0][0]


def _predicted(plan: Plan, record: int, frames: dict[int, np.ndarray], alone: bool) -> np.ndarray:
    sweep, own = plan.sweep, frames[record]
    (laser, *_) = sweep.laser[sweep.record == record].tolist() or [0]
    line = dataclasses.replace(sweep.lasers[laser], name="laser")
    neighbours, sites = _neighbours(plan, record, frames), laser_sites(sweep.pixel_format, line)
    if not neighbours or len(sites.offsets) > 1:
        return predict_off(own, sweep.pixel_format, line, alone=alone)
    seen, *others = (read_channels(frames[k], sweep.pixel_format, line) for k in (record, *neighbours))
    near, far = max(plan.settings.min_range_m, _NEAREST_M), min(plan.settings.max_range_m, _FARTHEST_M)
    ranges = 1.0 / np.linspace(1.0 / min(near, far), 1.0 / max(near, far), _RANGES)
    lattice = Lattice.of(seen.laser.shape[1:], sites)
    where = [
        places(plan.scanner, (sweep.angles[record], sweep.angles[k]), ranges, lattice, line.stripe_axis)
        for k in neighbours
    ]
    elsewhere = moved(seen, (others[0], others[1]), (where[0], where[1]))
    return predict_off(own, sweep.pixel_format, line, elsewhere=elsewhere, alone=alone)


def _neighbours(plan: Plan, record: int, frames: dict[int, np.ndarray]) -> list[int]:
    """Two steps in which the camera has turned far enough and not too far, if possible before and after."""
    sweep, scanner = plan.sweep, plan.scanner
    if scanner.turntable.carries != "scanner":
        return []
    focal = float(max(np.asarray(scanner.camera.fx), np.asarray(scanner.camera.fy)))
    turn = (sweep.angles - sweep.angles[record] + np.pi) % (2 * np.pi) - np.pi
    motion = focal * np.abs(turn)
    fits = (motion >= _APART_PX) & (motion <= _SEEN * min(sweep.image_size))
    near = [k for k in frames if fits[k] and abs(k - record) <= _FARTHEST]
    before, after = [k for k in near if k < record][::-1], [k for k in near if k > record]
    if before and after:
        return [before[0], after[0]]
    # At an end of the sweep, take two on one side, such that again only one has a stripe at any place.
    one = before or after
    return next(([one[0], k] for k in one[1:] if abs(motion[k] - motion[one[0]]) >= _APART_PX), [])


class Lattice(NamedTuple):
    """Pixels of a plane whose places in another step are computed; the others lie between them."""

    line: Float[np.ndarray, " lines"]
    """Lines of the image [px]."""
    u: Float[np.ndarray, " samples"]
    """Coordinates across [px]."""
    sites: Sites

    @staticmethod
    def of(shape: tuple[int, int], sites: Sites) -> "Lattice":
        """The lattice of a plane [lines, samples]."""
        line, sample = (_NODES_PX * np.arange(-(-size // _NODES_PX) + 1.0) for size in shape)
        return Lattice(sites.first_line + sites.line_step * line, sites.offsets[0] + sites.pitch * sample, sites)


def places(
    scanner: Scanner, phi: tuple[float, float], ranges: Float[np.ndarray, " ranges"], lattice: Lattice, axis: StripeAxis
) -> Float[np.ndarray, "ranges lines samples 2"]:
    """Where the second of two steps sees what the first sees at the lattice's pixels, as (line, sample) of the plane.

    Args:
        phi: The table's angles of both steps [rad].
        ranges: Distances of the points from the camera [m].
        lattice: Pixels of the first step.
    """
    rig = scanner.rig
    u, line = np.meshgrid(lattice.u, lattice.line)
    ray = rays(rig, stripe_pixel(u, line, axis))
    at = transform(poses(rig, phi[0]), ranges[:, None, None, None] * ray)
    q = pixels(rig, at, phi[1])
    sites, (u, line) = lattice.sites, (q[..., 0], q[..., 1]) if axis == "rows" else (q[..., 1], q[..., 0])
    found = np.stack([(line - sites.first_line) / sites.line_step, (u - sites.offsets[0]) / sites.pitch], -1)
    # A pixel that is nowhere in the other step.
    return np.nan_to_num(found, nan=-1.0, posinf=1e6, neginf=-1e6).astype(np.float32)


def moved(seen: Channels, neighbours: tuple[Channels, Channels], where: tuple[np.ndarray, np.ndarray]) -> Channels:
    """The frame as two other steps predict it.

    Args:
        seen: The frame, one.
        neighbours: Frames of two other steps; may be the same.
        where: Of `places`, for each of them.
    """
    level = seen.laser[0].astype(np.float32)
    stacks = [np.stack([one.laser[0], *(other[0] for other in one.others)]).astype(np.float32) for one in neighbours]
    own = np.stack([level, *(other[0] for other in seen.others)])
    best, least = own, np.full_like(level, np.inf)
    for number in range(len(where[0])):
        first, second = (warped(stack, place[number], _NODES_PX) for stack, place in zip(stacks, where, strict=True))
        # What only one of the steps sees is taken from that one; what none sees is no prediction.
        first, second = (np.where(np.isnan(one), other, one) for one, other in ((first, second), (second, first)))
        first, second = np.nan_to_num(first), np.nan_to_num(second)
        apart, darker = np.abs(first - second), np.minimum(first, second)
        # Not the darker of both: at every edge it would leave a bright line.
        between = np.clip(own, darker, np.maximum(first, second))
        found = np.where(apart < np.float32(_AGREE_DN), 0.5 * (first + second), between)
        size = np.minimum(apart, np.float32(_MOST_DN)) + np.minimum(np.abs(own - darker), np.float32(_MOST_DN))
        size = box_mean(size.mean(0, keepdims=True), *_AROUND)[0]
        better = size < least
        best, least = np.where(better, found, best), np.minimum(size, least)
    return Channels(best[:1], tuple(plane[None] for plane in best[1:]))
