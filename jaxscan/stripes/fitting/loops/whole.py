"""The fit of all candidates, block by block: the one function that is kept on disk."""

from typing import no_type_check

from jaxscan.stripes.fitting.loops import judge, prepare, rows, steps
from jaxscan.stripes.fitting.loops.judge import accept, add_dark, judge_edges, prepare_edges
from jaxscan.stripes.fitting.loops.prepare import begin, grow, levels
from jaxscan.stripes.fitting.loops.rows import (
    BINS,
    CLIPPED,
    EXTENT,
    HALF,
    LANES,
    MOVING,
    ONE,
    RATIO,
    SAMPLES,
    START,
    STEP,
    TOP,
    ZERO,
    f32,
    inlined,
    u64,
    whole,
)
from jaxscan.stripes.fitting.loops.steps import add_sample, moving, prepare_sums, step
from jaxscan.stripes.sources import fingerprint


@inlined
@no_type_check
def _fit_list(candidates, ratio, numbers, table, memory, into):
    """Fit and judge all candidates of a list, into `found` from `behind` on."""
    found, behind = into
    total, frame, start, extent, middle, bins, saturated, on, off = candidates
    w, y, variance = memory
    count, samples = int(total[()]), on.shape[1]
    n = u64(frame.shape[1])
    read = numbers.read_variance + f32(1 / 12)
    noise = (read, numbers.per_dn, numbers.black)
    starts = (
        numbers.pitch,
        numbers.filter_variance,
        numbers.max_width,
        numbers.speckle,
        numbers.per_dn,
        numbers.smallest,
    )
    prior = (numbers.log_width, numbers.width_information)
    rules = (numbers.least_snr, numbers.rest, numbers.small_step, numbers.smallest)
    middle_sample = HALF * f32(samples - 1)
    dark = (read, numbers.per_dn, numbers.black, numbers.floor)
    for block in range(-(-count // LANES)):
        u_block = u64(block)
        real = min(LANES, count - block * LANES)
        for lane in range(LANES):
            i = u64(lane)
            # Lanes beyond the last candidate repeat it.
            k = min(lane, real - 1)
            w[RATIO + i], w[BINS + i] = ratio[frame[block, k]], f32(bins[block, lane] if lane < real else 1)
            w[START + i], w[EXTENT + i] = start[block, lane], extent[block, lane]
            w[CLIPPED + i] = f32(saturated[block, lane])
            w[STEP + i] = numbers.pitch * w[BINS + i]
            w[TOP + i], w[SAMPLES + i] = f32(-1e3), ZERO
            w[MOVING + i] = ONE if lane < real else ZERO
        for s in range(u64(samples)):
            place, window = f32(s) - middle_sample, (on, off, u_block, s)
            levels(w, window, (y, variance), place, noise, n)
            if not numbers.linear:
                grow(w, window, variance, table, f32(1 / 12))
        begin(w, starts, (f32(numbers.iterations), f32(numbers.clipped_iterations)), n)
        number = ZERO
        while moving(w, n):
            prepare_sums(w, n)
            for s in range(u64(samples)):
                add_sample(w, y, variance, s, f32(s) - middle_sample, n)
            step(w, number, prior, rules, n)
            number += ONE
        prepare_edges(w, numbers.min_width_told, n)
        for s in range(u64(samples)):
            add_dark(w, (on, off, u_block, s), f32(s) - middle_sample, dark, n)
        if numbers.guard_edges:
            judge_edges(w, numbers.certain, n)
        accept(w, found, middle[block], (behind + block * LANES, real), numbers, HALF * f32(samples))


def _made(sources):
    """`fit_lists`, compiled anew where any function of this folder changes: numba looks at this file alone."""

    @whole
    @no_type_check
    def fit_lists(lists, ratio, numbers, table, memory, found):
        """Fit and judge the candidates of all lists of a `Located` in blocks of `LANES`, into flat `FrameStripes`."""
        # Of the closure, and so of the key under which the compiled code is kept.
        _ = sources
        behind = 0
        for number in range(len(lists)):
            _fit_list(lists[number], ratio, numbers, table, memory, (found, behind))
            behind += lists[number].start.size

    return fit_lists


fit_lists = _made(fingerprint(rows, prepare, steps, judge))
