"""The loops of the native search: one pass over the frames, line by line in the first-level cache.

They take the difference on the lattice, two matched filters, the highest maxima, and the samples around
them. They are written for the vectoriser: every integer is cast back to 16 bits, or it would be widened to 64; indices
are unsigned, or each would be tested for being negative; and no loop makes slices, which cost as much as 64 additions.
Constants of other files come as arguments: the compiled code is kept on disk, and only a change of this file renews it.
"""

from typing import no_type_check

import numba
import numpy as np


GROUP = np.uint64(64)
"""Lattice points whose maximum is kept."""
EDGE = np.uint64(4)
"""Zeros around a line of the lattice."""
_i16, _u64 = np.int16, np.uint64
_STRIP = 64
"""Lines that are searched before the samples of their candidates are copied: they are still near."""
_part = numba.njit(nogil=True)
_inlined = numba.njit(nogil=True, inline="always")
# Only `locate_lines` is cached on disk: functions that are cached one by one are not inlined into each other.
_whole = numba.njit(nogil=True, cache=True)


@_part
@no_type_check
def _lattice(on, off, ratio, first, lattice, count):
    """Difference of two frames' line, two neighbouring samples added up; and the sum of all with the laser off."""
    total = np.uint32(0)
    if ratio == 128:
        for i in range(count):
            x = first + _u64(2) * i
            dark = _i16(_i16(off[x]) + _i16(off[x + _u64(1)]))
            lattice[i + EDGE] = _i16(on[x]) + _i16(on[x + _u64(1)]) - dark
            total += np.uint32(dark)
    else:
        for i in range(count):
            x = first + _u64(2) * i
            second = _i16((np.int32(off[x + _u64(1)]) * ratio + 64) >> 7)
            lattice[i + EDGE] = (
                _i16(on[x]) + _i16(on[x + _u64(1)]) - _i16((np.int32(off[x]) * ratio + 64) >> 7) - second
            )
            total += np.uint32(off[x]) + np.uint32(off[x + _u64(1)])
    return np.int64(total)


@_part
@no_type_check
def _sparse_lattice(on, off, ratio, first, lattice, count):
    """As `_lattice`, where every sample is a point."""
    total = np.uint32(0)
    for i in range(count):
        lattice[i + EDGE] = _i16(on[first + i]) - _i16((np.int32(off[first + i]) * ratio + 64) >> 7)
        total += np.uint32(off[first + i])
    return np.int64(total)


@_part
@no_type_check
def _fine(lattice, fine, count):
    for i in range(count):
        fine[i + _u64(1)] = lattice[i] + 2 * lattice[i + _u64(1)] + lattice[i + _u64(2)]


@_part
@no_type_check
def _response(fine, response, count, shift):
    for i in range(count):
        middle = fine[i + EDGE]
        coarse = _i16(fine[i + EDGE - _u64(2)] + middle + fine[i + EDGE + _u64(2)])
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
    peak = np.int64(response[_u64(best)])
    # Both are positive.
    floor = threshold >> 1
    rise = max(floor, peak >> 2)
    lowest = peak
    for step in range(1, span + 1):
        point = best + side * step
        if point < 0 or point >= count:
            return point
        value = np.int64(response[_u64(point)])
        if value < floor or value >= lowest + rise:
            return point
        lowest = min(lowest, value)
    return best + side * (span + 1)


@_part
@no_type_check
def _half_distance(fine, count, best, side, span):
    """Distance to half of the maximum of the fine filter [lattice points]."""
    edge = np.int64(EDGE)
    peak = np.int64(fine[_u64(best)])
    inner = peak
    for step in range(1, span + 1):
        point = best + side * step
        # The filter reaches one point beyond the lattice.
        value = np.int64(fine[_u64(point)]) if edge - 1 <= point <= count + edge else 0
        if 2 * value < peak or step == span:
            fraction = np.float32(2 * inner - peak) / np.float32(2 * max(inner - value, 1))
            return np.float32(step - 1) + min(max(fraction, np.float32(0)), np.float32(1))
        inner = value
    return np.float32(0)


@_part
@no_type_check
def _cut_windows(frames_of, rules, spots, span, found):
    """Write candidates to a list, with the samples around them: many at once, as each array costs some time."""
    (on, off, frame), (pitch, levels, saturation), (begin, end) = frames_of, rules, span
    _, frames, starts, extents, middles, binning, saturated, on_window, off_window = found
    lines, places, reaches, binned = spots
    samples, size = on_window.shape[1], on_window.shape[2]
    half = np.float32(-0.5) * np.float32(samples - 1)
    for number in range(begin, end):
        k = _u64(number)
        block, slot = k // _u64(size), k % _u64(size)
        at, extent, bins, line = places[k], reaches[k], np.int64(binned[k]), _u64(lines[k])
        first = np.int64(np.floor(at / np.float32(pitch) + np.float32(0.5))) - bins * (samples // 2)
        middle = np.float32(pitch) * (np.float32(first) + np.float32(0.5) * np.float32(samples * bins - 1))
        frames[block, slot] = frame
        binning[block, slot] = bins
        starts[block, slot] = at - middle
        extents[block, slot] = extent
        middles[block, slot] = middle
        step, reach = np.float32(pitch * bins), extent + np.float32(1)
        x = half * step - (at - middle)
        clipped = 0
        if bins == 1 and first >= 0 and first + samples <= on.shape[2]:
            for sample in range(_u64(samples)):
                a, b = on[_u64(frame), line, _u64(first) + sample], off[_u64(frame), line, _u64(first) + sample]
                place = x + np.float32(np.int32(sample)) * step
                near = (place <= reach) & (place >= -reach)
                clipped += 1 if near & (a >= saturation) else 0
                whole = near & (a < saturation) & (b < saturation)
                on_window[block, sample, slot] = levels[a] if whole else np.float32(-1)
                off_window[block, sample, slot] = levels[b]
        else:
            for sample in range(samples):
                index = first + bins * sample
                level_on, level_off = np.float32(-1), np.float32(0)
                if 0 <= index and index + bins <= on.shape[2]:
                    a, b = on[frame, line, index], off[frame, line, index]
                    whole = a < saturation and b < saturation
                    above = 1 if a >= saturation else 0
                    total, level_off = levels[a], levels[b]
                    if bins == 2:
                        a, b = on[frame, line, index + 1], off[frame, line, index + 1]
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


@_inlined
@no_type_check
def _filter_line(pair, ratio, rules, scratch, span):
    """Response of both filters over a line, highest of each group; gives the number of groups and the mean level."""
    (on_line, off_line), (pitch, fine_shift), (begin, end) = pair, rules, span
    lattice, fine, response, highest = scratch
    per_point = 2 // pitch
    count, first = end - begin, _u64(per_point * begin)
    if pitch == 1:
        total = _lattice(on_line, off_line, ratio, first, lattice, _u64(count))
    else:
        total = _sparse_lattice(on_line, off_line, ratio, first, lattice, _u64(count))
    edge = np.int64(EDGE)
    # An earlier, longer line may have left something here.
    for i in range(count + edge, count + 2 * edge):
        lattice[i] = 0
    _fine(lattice, fine, _u64(count + 2 * edge - 2))
    _response(fine, response, _u64(count), fine_shift)
    groups = -(-count // np.int64(GROUP))
    for i in range(count, groups * np.int64(GROUP)):
        response[i] = -32768
    for group in range(_u64(groups)):
        highest[group] = _highest(response, group * GROUP, GROUP)
    return groups, total // (per_point * count)


@_part
@no_type_check
def _first_of(values, first, count, wanted):
    place = _i16(count)
    for i in range(count):
        here = _i16(i) if values[first + i] == wanted else _i16(count)
        place = here if here < place else place
    return np.int64(place)


@_part
@no_type_check
def _highest_point(response, highest, groups, threshold):
    """The first of the highest points of a line; -1 where it is below the threshold."""
    best = np.int64(-1) << 40
    for group in range(_u64(groups)):
        # The first of equal ones wins.
        key = (np.int64(highest[group]) << 24) - np.int64(group)
        best = key if key > best else best
    peak = (best + 0xFFFFFF) >> 24
    if peak < threshold:
        return np.int64(-1)
    group = (peak << 24) - best
    return group * np.int64(GROUP) + _first_of(response, _u64(group) * GROUP, GROUP, _i16(peak))


@_whole
@no_type_check
def locate_lines(on, off, ratio, rules, found, scratch):
    """Fill `found`, a `Located` of two lists, with the candidates of all frames."""
    frames, lines, samples = on.shape
    group_size = np.int64(GROUP)
    edge = np.int64(EDGE)
    # Fields are taken out of their tuples once: each access would count the references to all of their arrays.
    lattice, fine, response, highest, line_of, place_of, reach_of, bins_of = scratch
    low, high, thresholds, levels, pitch, saturation, candidates, half_span, zone_span, fine_shift, bin_extent = rules
    slots = found.slots
    narrow, wide = found.lists
    per_point = 2 // pitch
    behind, few = narrow.frame.size, narrow.on.shape[1]
    spots = (
        (line_of[0], place_of[0], reach_of[0], bins_of[0]),
        (line_of[1], place_of[1], reach_of[1], bins_of[1]),
    )
    counts, before_strip = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for frame in range(frames):
        for strip in range(0, lines, _STRIP):
            before_strip[0], before_strip[1] = counts[0], counts[1]
            for line in range(strip, min(strip + _STRIP, lines)):
                for rank in range(candidates):
                    slots[frame, line, rank] = -1
                begin, end = low[line] // per_point, min(-(-high[line] // per_point), samples // per_point)
                if end <= begin:
                    continue
                on_line, off_line = on[frame, line], off[frame, line]
                count = end - begin
                memory = (lattice, fine, response, highest)
                groups, mean = _filter_line(
                    (on_line, off_line), ratio[frame], (pitch, fine_shift), memory, (begin, end)
                )
                threshold = np.int64(thresholds[mean])
                for rank in range(candidates):
                    best = _highest_point(response, highest, groups, threshold)
                    if best < 0:
                        break
                    before = _half_distance(fine, count, best + edge, -1, half_span)
                    after = _half_distance(fine, count, best + edge, 1, half_span)
                    extent = np.float32(2) * (before + after)
                    at = np.float32(2) * (np.float32(best + begin) + np.float32(0.5) * (after - before))
                    at += np.float32(0.5) if pitch == 1 else np.float32(0)
                    slim = extent + np.float32(1) <= np.float32(0.5) * np.float32(pitch * (few - 1))
                    # Clipped ones take more steps of the fit: they go with the others that are rare.
                    slim &= on_line[per_point * (best + begin)] < saturation
                    which = _u64(0) if slim else _u64(1)
                    number = counts[which]
                    line_of[which, number], place_of[which, number] = line, at
                    reach_of[which, number] = extent
                    bins_of[which, number] = 2 if pitch == 1 and extent > bin_extent else 1
                    slots[frame, line, rank] = number if slim else behind + number
                    counts[which] = number + 1
                    if rank + 1 < candidates:
                        left = max(_zone_end(response, count, best, -1, threshold, zone_span) + 1, 0)
                        right = min(_zone_end(response, count, best, 1, threshold, zone_span), count)
                        for i in range(left, right):
                            response[_u64(i)] = -32768
                        for other in range(left // group_size, (right - 1) // group_size + 1):
                            highest[_u64(other)] = _highest(response, _u64(other) * GROUP, GROUP)
            how, here = (pitch, levels, saturation), (on, off, frame)
            _cut_windows(here, how, spots[0], (before_strip[0], counts[0]), narrow)
            _cut_windows(here, how, spots[1], (before_strip[1], counts[1]), wide)
    narrow.total[()] = counts[0]
    wide.total[()] = counts[1]
