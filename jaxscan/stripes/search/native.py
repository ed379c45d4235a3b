"""`locate` for a CPU, where XLA's code for it is many times slower: the same integers, natively.

One pass over the frames, line by line in the first-level cache: the difference on the lattice,
two matched filters, the highest maxima, and the samples around them. It computes what
`locate.locate` computes, number by number; a test holds the two equal.

The loops are written for the vectoriser: every integer is cast back to 16 bits, or it would be
widened to 64; indices are unsigned, or each would be tested for being negative; and no loop
makes slices, which cost as much as 64 additions. What other files define comes as an argument:
the compiled code is kept on disk, and only a change of this file would renew it.
"""

import threading
from typing import no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int, Int16, UInt8

from jaxscan.stripes.search.candidates import (
    BIN_EXTENT_PX,
    BLOCK,
    CANDIDATES,
    FINE_SHIFT,
    HALF_SPAN,
    NARROW,
    WIDE,
    ZONE_SPAN,
    Candidates,
    Located,
)


_GROUP = np.uint64(64)
"""Lattice points whose maximum is kept."""
_ALIGNMENT = 64
"""Address of an array that JAX takes on a CPU without a copy [bytes]."""
_EDGE = np.uint64(4)
"""Zeros around a line of the lattice."""
_LAYOUT = (CANDIDATES, HALF_SPAN, ZONE_SPAN, FINE_SHIFT, NARROW, WIDE, BLOCK)
_i16, _u64 = np.int16, np.uint64
_part = numba.njit(nogil=True)
# Only the whole is kept on disk: what comes from there one by one is not put together again.
_whole = numba.njit(nogil=True, cache=True)


class NativeLocator(threading.local):
    """Finds candidates; keeps its memory, since the pages of new memory cost more than the search.

    Every thread has its own. What is returned is good until the next call.
    """

    def __init__(self) -> None:
        self._kept: dict[tuple, np.ndarray] = {}

    def locate(
        self,
        on: UInt8[np.ndarray, "frames lines samples"],
        off: UInt8[np.ndarray, "frames lines samples"],
        *,
        pitch: int,
        low: Int[np.ndarray, " lines"],
        high: Int[np.ndarray, " lines"],
        gain: Int[np.ndarray, " frames"],
        thresholds: Int16[np.ndarray, "256"],
        levels: Float[np.ndarray, "256"],
        saturation: int,
    ) -> Located:
        """Candidates of all frames: a list of those with narrow windows, one of those with wide ones.

        Args and meaning: see `jaxscan.stripes.search.locate.locate`.
        """
        frames, lines, _ = on.shape
        room = frames * lines * CANDIDATES
        narrow, wide = self._lists("narrow", room, NARROW), self._lists("wide", room, WIDE)
        slots = self._memory(("slots",), (frames, lines, CANDIDATES), np.int32)
        counts = np.zeros(2, np.int64)
        _locate(
            on, off, pitch, low.astype(np.int64), high.astype(np.int64), gain.astype(np.int64), thresholds,
            levels.astype(np.float32), saturation, _LAYOUT, np.float32(BIN_EXTENT_PX), counts, slots, narrow, wide,
            self._scratch(on.shape[2]),
        )  # fmt: skip
        return Located((_packed(counts[0], narrow), _packed(counts[1], wide)), slots)

    def _lists(self, name: str, room: int, samples: int) -> tuple[np.ndarray, ...]:
        blocks = -(-room // BLOCK)
        numbers = (self._memory((name, field), (blocks, BLOCK), np.int32) for field in ("frame", "bins", "saturated"))
        values = (self._memory((name, field), (blocks, BLOCK), np.float32) for field in ("start", "extent", "middle"))
        windows = (self._memory((name, field), (blocks, samples, BLOCK), np.float32) for field in ("on", "off"))
        return *numbers, *values, *windows

    def _scratch(self, samples: int) -> tuple[np.ndarray, ...]:
        """Of a line: the lattice, the fine filter, the response, and the highest response of each group."""
        groups = samples // int(_GROUP) + 1
        padded = samples + 2 * int(_EDGE)
        sizes = {"lattice": padded, "fine": padded, "response": groups * int(_GROUP), "highest": groups}
        return tuple(self._memory((name,), (size,), np.int16) for name, size in sizes.items())

    def _memory(self, key: tuple, shape: tuple[int, ...], dtype: type) -> np.ndarray:
        kept = self._kept.get(key)
        if kept is None or kept.shape != shape:
            size = int(np.prod(shape)) * np.dtype(dtype).itemsize
            memory = np.zeros(size + _ALIGNMENT, np.uint8)
            first = -memory.ctypes.data % _ALIGNMENT
            kept = self._kept[key] = memory[first : first + size].view(dtype).reshape(shape)
        return kept


def _packed(count: np.integer, lists: tuple[np.ndarray, ...]) -> Candidates:
    frame, bins, saturated, start, extent, middle, on, off = lists
    return Candidates(np.asarray(count, np.int32), frame, start, extent, middle, bins, saturated, on, off)


@_part
@no_type_check
def _lattice(on, off, gain, first, lattice, count):
    """Difference of two frames' line, two neighbouring samples added up."""
    if gain == 128:
        for i in range(count):
            x = first + _u64(2) * i
            lattice[i + _EDGE] = _i16(on[x]) + _i16(on[x + _u64(1)]) - _i16(off[x]) - _i16(off[x + _u64(1)])
    else:
        for i in range(count):
            x = first + _u64(2) * i
            second = _i16((np.int32(off[x + _u64(1)]) * gain + 64) >> 7)
            lattice[i + _EDGE] = (
                _i16(on[x]) + _i16(on[x + _u64(1)]) - _i16((np.int32(off[x]) * gain + 64) >> 7) - second
            )


@_part
@no_type_check
def _sparse_lattice(on, off, gain, first, lattice, count):
    """As `_lattice`, where every sample is a point."""
    for i in range(count):
        lattice[i + _EDGE] = _i16(on[first + i]) - _i16((np.int32(off[first + i]) * gain + 64) >> 7)


@_part
@no_type_check
def _mean(values, first, count):
    total = np.uint32(0)
    for i in range(count):
        total += np.uint32(values[first + i])
    return np.int64(total) // np.int64(count)


@_part
@no_type_check
def _fine(lattice, fine, count):
    for i in range(count):
        fine[i + _u64(1)] = lattice[i] + 2 * lattice[i + _u64(1)] + lattice[i + _u64(2)]


@_part
@no_type_check
def _response(fine, response, count, shift):
    for i in range(count):
        middle = fine[i + _EDGE]
        coarse = _i16(fine[i + _EDGE - _u64(2)] + middle + fine[i + _EDGE + _u64(2)])
        scaled = _i16(2 * middle - (middle >> shift))
        response[i] = scaled if scaled > coarse else coarse


@_part
@no_type_check
def _highest(values, first, count):
    # The length is an argument: of a constant the compiler would unroll the loop, not vectorise it.
    highest = values[first]
    for i in range(count):
        value = values[first + i]
        highest = value if value > highest else highest
    return highest


@_part
@no_type_check
def _zone_end(response, count, best, side, threshold, span):
    """The first point on one side that does not belong to the maximum any more."""
    peak = np.int64(response[best])
    floor = threshold // 2
    rise = max(floor, peak // 4)
    lowest = peak
    for step in range(1, span + 1):
        point = best + side * step
        if point < 0 or point >= count:
            return point
        value = np.int64(response[point])
        if value < floor or value >= lowest + rise:
            return point
        lowest = min(lowest, value)
    return best + side * (span + 1)


@_part
@no_type_check
def _half_distance(fine, count, best, side, span):
    """Distance to half of the maximum of the fine filter [lattice points]."""
    edge = np.int64(_EDGE)
    peak = np.int64(fine[best])
    inner = peak
    for step in range(1, span + 1):
        point = best + side * step
        # The filter reaches one point beyond the lattice.
        value = np.int64(fine[point]) if edge - 1 <= point <= count + edge else 0
        if 2 * value < peak or step == span:
            fraction = np.float32(2 * inner - peak) / np.float32(2 * max(inner - value, 1))
            return np.float32(step - 1) + min(max(fraction, np.float32(0)), np.float32(1))
        inner = value
    return np.float32(0)


@_part
@no_type_check
def _keep(on, off, at, extent, bins, pitch, levels, saturation, samples, frame, count, size, lists):
    """Add a candidate to a list, with the samples around it."""
    frames, binning, saturated, starts, extents, middles, on_window, off_window = lists
    block, slot = count // size, count % size
    first = np.int64(np.floor(at / np.float32(pitch) + np.float32(0.5))) - bins * (samples // 2)
    middle = np.float32(pitch) * (np.float32(first) + np.float32(0.5) * np.float32(samples * bins - 1))
    frames[block, slot] = frame
    binning[block, slot] = bins
    starts[block, slot] = at - middle
    extents[block, slot] = extent
    middles[block, slot] = middle
    step, reach = np.float32(pitch * bins), extent + np.float32(1)
    x = np.float32(-0.5) * np.float32(samples - 1) * step - (at - middle)
    clipped = 0
    for sample in range(samples):
        index = first + bins * sample
        level_on, level_off = np.float32(-1), np.float32(0)
        if 0 <= index and index + bins <= on.size:
            a, b = on[index], off[index]
            whole = a < saturation and b < saturation
            above = 1 if a >= saturation else 0
            total, level_off = levels[a], levels[b]
            if bins == 2:
                a, b = on[index + 1], off[index + 1]
                whole &= a < saturation and b < saturation
                above += 1 if a >= saturation else 0
                total = np.float32(0.5) * (total + levels[a])
                level_off = np.float32(0.5) * (level_off + levels[b])
            if abs(x + sample * step) <= reach:
                clipped += above
                if whole:
                    level_on = total
        on_window[block, sample, slot] = level_on
        off_window[block, sample, slot] = level_off
    saturated[block, slot] = clipped


@_whole
@no_type_check
def _locate(
    on, off, pitch, low, high, gain, thresholds, levels, saturation, layout, bin_extent, counts, slots, narrow, wide,
    scratch,
):  # fmt: skip
    candidates, half_span, zone_span, fine_shift, few, many, size = layout
    frames, lines, samples = on.shape
    per_point = 2 // pitch
    points = samples // per_point
    group_size = np.int64(_GROUP)
    edge = np.int64(_EDGE)
    lattice, fine, response, highest = scratch
    behind = narrow[0].size
    for frame in range(frames):
        for line in range(lines):
            for rank in range(candidates):
                slots[frame, line, rank] = -1
            begin, end = low[line] // per_point, min(-(-high[line] // per_point), points)
            if end <= begin:
                continue
            on_line, off_line = on[frame, line], off[frame, line]
            count, first = end - begin, _u64(per_point * begin)
            if pitch == 1:
                _lattice(on_line, off_line, gain[frame], first, lattice, _u64(count))
            else:
                _sparse_lattice(on_line, off_line, gain[frame], first, lattice, _u64(count))
            # What an earlier, longer line left.
            for i in range(count + edge, count + 2 * edge):
                lattice[i] = 0
            threshold = np.int64(thresholds[_mean(off_line, first, _u64(per_point * count))])
            _fine(lattice, fine, _u64(count + 2 * edge - 2))
            _response(fine, response, _u64(count), fine_shift)
            groups = -(-count // group_size)
            for i in range(count, groups * group_size):
                response[i] = -32768
            for group in range(_u64(groups)):
                highest[group] = _highest(response, group * _GROUP, _GROUP)
            for rank in range(candidates):
                group = 0
                for other in range(1, groups):
                    if highest[other] > highest[group]:
                        group = other
                peak = highest[group]
                if peak < threshold:
                    break
                best = group * group_size
                while response[best] != peak:
                    best += 1
                left = max(_zone_end(response, count, best, -1, threshold, zone_span) + 1, 0)
                right = min(_zone_end(response, count, best, 1, threshold, zone_span), count)
                before = _half_distance(fine, count, best + edge, -1, half_span)
                after = _half_distance(fine, count, best + edge, 1, half_span)
                extent = np.float32(2) * (before + after)
                at = np.float32(2) * (np.float32(best + begin) + np.float32(0.5) * (after - before))
                at += np.float32(0.5) if pitch == 1 else np.float32(0)
                slim = extent + np.float32(1) <= np.float32(0.5) * np.float32(pitch * (few - 1))
                # Clipped ones take more steps of the fit: they go with the others that are rare.
                slim &= on_line[per_point * (best + begin)] < saturation
                bins = 2 if pitch == 1 and extent > bin_extent else 1
                if slim:
                    _keep(
                        on_line,
                        off_line,
                        at,
                        extent,
                        bins,
                        pitch,
                        levels,
                        saturation,
                        few,
                        frame,
                        counts[0],
                        size,
                        narrow,
                    )
                    slots[frame, line, rank] = counts[0]
                    counts[0] += 1
                else:
                    _keep(
                        on_line,
                        off_line,
                        at,
                        extent,
                        bins,
                        pitch,
                        levels,
                        saturation,
                        many,
                        frame,
                        counts[1],
                        size,
                        wide,
                    )
                    slots[frame, line, rank] = behind + counts[1]
                    counts[1] += 1
                if rank + 1 < candidates:
                    for i in range(left, right):
                        response[i] = -32768
                    for other in range(left // group_size, (right - 1) // group_size + 1):
                        highest[other] = _highest(response, _u64(other) * _GROUP, _GROUP)
