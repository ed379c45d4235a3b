"""The loops of the choice among candidates, as of `path.best_path` and `rules.choose`, a frame at a time.

Constants of other files come as arguments: the compiled code is kept on disk, and only a change of this file
would renew it.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np


_inlined = numba.njit(nogil=True, inline="always")
# Only `choose_lines` is cached on disk: functions that are cached one by one are not inlined into each other.
_whole = numba.njit(nogil=True, cache=True, error_model="numpy")
_f = np.float32
PATH, BRIGHTEST, NEAREST, FARTHEST, ALL = range(5)
"""Numbers of the rules."""


class PathNumbers(NamedTuple):
    """Numbers of the choice, float32: the rule's, and those of `path`."""

    rule: int
    near_side: np.float32
    min_snr: np.float32
    bonus: np.float32
    alone: np.float32
    evidence: np.float32
    certain_snr: np.float32
    jump: np.float32
    per_px: np.float32
    gap_jump: np.float32
    width_cost: np.float32
    brighter: np.float32
    never: np.float32


class PathMemory(NamedTuple):
    """Of one frame: of every line the origin of each state [lines, candidates + 1], and the chosen number [lines]."""

    origins: np.ndarray
    chosen: np.ndarray


@_inlined
@no_type_check
def _best_by_rank(measured, slots, frame, line, numbers):
    """The candidate of a line with the highest rank; -1 where none is clear enough."""
    u_of, _, amplitude_of, _, _, _, snr_of, _, _, valid_of = measured
    best, chosen = _f(0), -1
    for k in range(slots.shape[2]):
        at = slots[frame, line, k]
        if at < 0 or not valid_of[at] or snr_of[at] < numbers.min_snr:
            continue
        rank = amplitude_of[at]
        if numbers.rule == NEAREST:
            rank = numbers.near_side * u_of[at]
        elif numbers.rule == FARTHEST:
            rank = -numbers.near_side * u_of[at]
        if chosen < 0 or rank > best:
            best, chosen = rank, k
    return chosen


@_inlined
@no_type_check
def _best_path(measured, slots, frame, numbers, memory):
    """The path through one frame: forward over the lines, and back."""
    u_of, _, amplitude_of, width_of, _, _, snr_of, _, _, valid_of = measured
    origins, chosen = memory
    lines, count = slots.shape[1], slots.shape[2]
    scores, places = np.full(count + 1, numbers.never), np.zeros(count + 1, np.float32)
    next_scores, next_places = np.zeros(count + 1, np.float32), np.zeros(count + 1, np.float32)
    widths, next_widths = np.zeros(count + 1, np.float32), np.zeros(count + 1, np.float32)
    # Nothing is remembered at first: a place so far away costs the same for all.
    scores[0], places[0] = _f(0), numbers.never
    for line in range(lines):
        origin = 0
        for j in range(1, count + 1):
            if scores[j] > scores[origin]:
                origin = j
        highest = _f(0)
        for k in range(count):
            at = slots[frame, line, k]
            next_scores[k + 1] = numbers.never + numbers.never
            next_places[k + 1] = next_widths[k + 1] = _f(0)
            origins[line, k + 1] = 0
            if at < 0 or not valid_of[at]:
                continue
            u, width = u_of[at], np.log(max(width_of[at], _f(0.1)))
            full = min(snr_of[at], numbers.certain_snr)
            full *= _f(0.5) * full
            highest = max(highest, full)
            best = scores[0] - min(numbers.per_px * abs(u - places[0]), numbers.gap_jump)
            for j in range(1, count + 1):
                change = min(numbers.per_px * abs(u - places[j]), numbers.jump)
                change += numbers.width_cost * min(abs(width - widths[j]), _f(1))
                moved = scores[j] + numbers.bonus - change
                if moved > best:
                    best = moved
                    origins[line, k + 1] = j
            own = min(full, numbers.evidence) - numbers.alone + numbers.brighter * np.log(max(amplitude_of[at], _f(1)))
            next_scores[k + 1], next_places[k + 1], next_widths[k + 1] = best + own, u, width
        origins[line, 0] = origin
        next_scores[0] = scores[origin] - max(highest - numbers.evidence, _f(0))
        next_places[0] = places[origin]
        scores, next_scores = next_scores, scores
        places, next_places = next_places, places
        widths, next_widths = next_widths, widths
    taken = 0
    for j in range(1, count + 1):
        if scores[j] > scores[taken]:
            taken = j
    for back in range(lines):
        line = lines - 1 - back
        chosen[line] = taken - 1
        taken = origins[line, taken]


@_whole
@no_type_check
def choose_lines(measured, slots, numbers, memory, sites, out):
    """Choose on all lines, and write the stripes on the lines of the image.

    Args:
        measured: The candidates, `FrameStripes` of flat arrays.
        slots: Those of each line [frames, lines, candidates].
        numbers: The rule.
        memory: Of one frame.
        sites: First line of the image, step of lines, and offsets of the lines in turn [px].
        out: `FrameStripes` of zeros [frames or candidates of frames, lines of the image]; numbers of the chosen ones
            [frames, lines of the image], all -1; and whether all candidates are written.
    """
    frames, lines, count = slots.shape
    first, step, offsets = sites
    fields, number, every = out
    u_to, sigma_to, amplitude_to, width_to, chi2_to, skew_to, snr_to, grey_to, saturated_to, valid_to = fields
    u_of, sigma_of, amplitude_of, width_of, chi2_of, skew_of, snr_of, grey_of, saturated_of, valid_of = measured
    chosen = memory.chosen
    for frame in range(frames):
        if numbers.rule == PATH:
            _best_path(measured, slots, frame, numbers, memory)
        elif numbers.rule != ALL:
            for line in range(lines):
                chosen[line] = _best_by_rank(measured, slots, frame, line, numbers)
        for line in range(lines):
            to_line = first + step * line
            if numbers.rule != ALL:
                number[frame, to_line] = chosen[line]
            for k in range(count):
                at = slots[frame, line, k]
                if at < 0 or not valid_of[at] or not (every or k == chosen[line]):
                    continue
                row = frame * count + k if every else frame
                u_to[row, to_line] = u_of[at] + offsets[line % len(offsets)]
                sigma_to[row, to_line], amplitude_to[row, to_line] = sigma_of[at], amplitude_of[at]
                width_to[row, to_line], chi2_to[row, to_line] = width_of[at], chi2_of[at]
                skew_to[row, to_line], snr_to[row, to_line] = skew_of[at], snr_of[at]
                grey_to[row, to_line], saturated_to[row, to_line] = grey_of[at], saturated_of[at]
                valid_to[row, to_line] = True
