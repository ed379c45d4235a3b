"""Doubts about a sweep, a sentence each: contradictions within it, found by statistics of the sweep itself.

They concern its journal (numbers, angles), its frames (`Seen`: one comes twice, on and off are exchanged, one does not
continue its neighbours), their motion, its points, its header, and its pairs (laser light in the laser-off image,
motion between both).
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Array, Scanner, Turntable
from jaxscan.reconstruction.cloud import PointCloud
from jaxscan.reconstruction.extraction import learned_lasers
from jaxscan.reconstruction.seen import TRACE_BINS, Seen
from jaxscan.reconstruction.sweep import SweepSource
from jaxscan.reconstruction.whole_turns import turn_doubts
from jaxscan.stripes import FrameFormat, Stripes, judge_pairs


_LISTED = 5
_FEW_STEPS = 6
"""Records of one laser from which a regularity is asked for."""
_STEPS_AROUND = 3
"""Steps on either side that say how large a step is."""
_STEP = 0.01
"""Part of a step by which angles may be off [1]; tables that count microsteps round."""
_ROUND_DEG = 0.05
"""Angle that microsteps may be off [deg]."""
_TURN_IN_RADIANS = 24
"""Records from which steps that divide 2 pi are taken for radians; of fewer, only a whole turn."""
_WHOLE_TURN = 0.002
"""Part by which a whole turn may differ from 2 pi [1]."""
_FEW_FRAMES = 8
"""Records of one laser from which neighbours are compared."""
_ALIKE = 0.6
"""Part of the records whose motion must be steady, so that the picture tells anything [1]."""
_OVERLAP = 0.4
"""Part of the frame that both must show [1]."""
_BINS, _NEARER = 3.0, 0.15
"""Motion that is never doubted [bins of a trace], and the part of it that near things add [1]."""
_ELSEWHERE = 0.4
"""Correlation of another place, in that of most neighbours [1]."""
_CONTINUED = 0.6
"""Correlation around records that are elsewhere, in that of most neighbours [1]."""
_STILL = 1e-6
"""Motion of the picture from step to step that is none [bins]."""
_AT_ONCE = 256
_FEW_PROFILES = 12
_COMMON = 0.1
"""Part of the lines that three neighbouring records must share [1]."""
_GREEN = {"bayer_rggb8": (1, 2), "bayer_bggr8": (1, 2), "bayer_grbg8": (0, 3), "bayer_gbrg8": (0, 3)}
_PHASES = {
    "bayer_rggb8": ("red", "green", "green", "blue"),
    "bayer_bggr8": ("blue", "green", "green", "red"),
    "bayer_grbg8": ("green", "red", "blue", "green"),
    "bayer_gbrg8": ("green", "blue", "red", "green"),
    "rgb8": ("red", "green", "blue"),
}
_LEAST_DN = 2.0
"""Level of a frame from which its mosaic can be seen [DN]."""
_JUDGED_PAIRS = 8
"""Pairs of a sweep that are looked at."""
_LEAK = 0.05
"""Part of the stripe in the laser-off image from which a user should know [1]."""
_UNREST = 2.0
"""Difference beside the laser from which a user should know, in the noise [1]."""


def sweep_doubts(
    sweep: SweepSource,
    scanner: Scanner,
    cloud: PointCloud,
    seen: Seen,
    numbers: Sequence[int],
    off_images: np.ndarray | None = None,
) -> tuple[str, ...]:
    """Contradictions between a part of a sweep and the rest of it, a sentence each; none for a healthy one.

    Args:
        numbers: The name of each record.
        off_images: As of `repeated_frames`.
    """
    number = np.asarray(numbers)
    doubts = repeated_frames(seen, number, off_images) + exchanged_frames(seen, number)
    doubts += blank_frames(seen, number)
    lit: list[tuple[int, ...]] = [()] * len(sweep)
    for record, laser in zip(sweep.record.tolist(), sweep.laser.tolist(), strict=True):
        lit[record] = (*lit[record], laser)
    for own in groups_of(lit):
        doubts += strange_frames(seen, number, own)
        doubts += turning_doubts(seen, number, sweep.angles, own, scanner)
    doubts += turn_doubts(cloud, scanner, seen.trace, number)
    return tuple(doubts + profile_doubts(cloud, number) + header_doubts(sweep, seen, scanner))


def named(numbers: Sequence[int] | np.ndarray) -> str:
    """ "record 3", or "records 3, 4 and 7"; long lists are cut."""
    texts = [str(int(number)) for number in numbers]
    if len(texts) > _LISTED:
        texts = [*texts[:_LISTED], f"{len(texts) - _LISTED} more"]
    listed = texts[0] if len(texts) == 1 else ", ".join(texts[:-1]) + " and " + texts[-1]
    return f"{'record' if len(texts) == 1 else 'records'} {listed}"


def said(numbers: Sequence[int] | np.ndarray, of_one: str, of_many: str) -> str:
    """Records with their verb: "record 3 shows", or "records 3, 4 and 7 show"."""
    return f"{named(numbers)} {of_one if len(numbers) == 1 else of_many}"


def scatter(residuals: np.ndarray) -> float:
    """Size that four of five residuals keep, so that a few that are wrong do not matter."""
    return float(np.quantile(np.abs(residuals), 0.8)) if len(residuals) else 0.0


def bend(values: np.ndarray) -> np.ndarray:
    """Each value minus the mean of its two neighbours; at the ends minus the one neighbour."""
    if len(values) < 2:
        return np.zeros(len(values))
    padded = np.concatenate([values[1:2], values, values[-2:-1]])
    return values - (padded[:-2] + padded[2:]) / 2


def peaks(sizes: np.ndarray, limit: float) -> np.ndarray:
    """Where a size is over the limit and larger than those of its neighbours, to which a wrong value spreads."""
    padded = np.concatenate([[0.0], sizes, [0.0]])
    return np.flatnonzero((sizes > limit) & (sizes >= 1.2 * padded[:-2]) & (sizes >= 1.2 * padded[2:]))


def groups_of(lit: Sequence[tuple[int, ...]]) -> Iterable[np.ndarray]:
    """Positions of the records with the same lasers lit, ascending."""
    for lasers in sorted(set(lit)):
        yield np.array([k for k, one in enumerate(lit) if one == lasers])


def journal_doubts(
    numbers: Sequence[int], degrees: np.ndarray | None, lit: Sequence[tuple[int, ...]], planned: int | None
) -> list[str]:
    """Contradictions in the journal of a sweep.

    Args:
        numbers: Of the records, ascending.
        degrees: The table's angles, float64 [records], deg; None without a table.
        lit: The lasers that are lit in each record.
        planned: Records that the header plans, if it does.
    """
    number = np.asarray(numbers, np.int64)
    doubts = _missing(number, planned)
    for own in groups_of(lit):
        if degrees is not None and len(own) >= _FEW_STEPS:
            doubts += _angles(number[own], degrees[own])
    return doubts


def _missing(number: np.ndarray, planned: int | None) -> list[str]:
    doubts = []
    if planned is not None and len(number) < planned:
        doubts.append(f"{len(number)} of the {planned} planned records are there")
    gaps = np.diff(number)
    # Every tenth record of another capture is a regular choice.
    if len(gaps) and gaps.max() > gaps.min():
        at = np.flatnonzero(gaps > gaps.min())
        before, after = number[at[0]], number[at[0] + 1]
        more = f", and {len(at) - 1} more gaps" if len(at) > 1 else ""
        doubts.append(f"records are missing: {before + gaps.min()} to {after - gaps.min()}{more}")
    return doubts


def _angles(number: np.ndarray, degrees: np.ndarray) -> list[str]:
    if np.ptp(degrees) < 1e-9:
        return [f"all {len(degrees)} records have the same angle, {degrees[0]:g} deg: the table did not turn"]
    stride = np.median(np.diff(number))
    # Whole turns make no difference.
    steps = (np.diff(degrees) + 180.0) % 360.0 - 180.0
    steps = steps / np.maximum(np.diff(number) / stride, 1.0)
    sizes = np.abs(steps)
    around = np.stack(
        [np.roll(np.pad(sizes, _STEPS_AROUND, mode="reflect"), k) for k in range(-_STEPS_AROUND, _STEPS_AROUND + 1)]
    )
    usual = np.median(around, 0)[_STEPS_AROUND:-_STEPS_AROUND]
    residuals = sizes - usual
    limit = np.maximum(4.0 * scatter(residuals), np.maximum(_STEP * usual, np.minimum(_ROUND_DEG, 0.3 * usual)))
    turned = np.sign(steps[1:]) * np.sign(steps[:-1]) < 0
    doubts = _radians(degrees, float(np.median(sizes)))
    if turned.mean() > 0.25:
        return [*doubts, "the angle goes back and forth from record to record: the records may have been exchanged"]
    # A table that goes to and fro turns round once, not twice in a row.
    back = np.concatenate([[False], turned[:-1] & turned[1:], [False]])
    wrong = np.flatnonzero((np.abs(residuals) > limit) | back)
    if 0 < len(wrong) <= max(2, 0.4 * len(steps)):
        both = np.intersect1d(wrong, wrong + 1)
        records = number[both] if len(both) else number[wrong + 1]
        expected = float(np.median(usual))
        doubts.append(
            f"the angle of {named(records)} does not continue that of the records around: "
            + _unlike(float(np.diff(degrees)[wrong[0]]), float(steps[wrong[0]]), expected)
        )
    return doubts


def _unlike(written: float, step: float, expected: float) -> str:
    """A step as it stands in the journal beside the usual one, with as many digits as tell them apart."""
    shown = written if abs(written) > 360.0 else step
    digits = next((n for n in range(4, 16) if f"{shown:.{n}g}" != f"{expected:.{n}g}"), 16)
    return f"a step of {shown:.{digits}g} deg, where {expected:.{digits}g} deg are usual"


def _radians(degrees: np.ndarray, step: float) -> list[str]:
    """A turn that fits into 2 pi, in steps that divide it evenly."""
    whole = abs(np.ptp(degrees) + step - 2 * np.pi) < _WHOLE_TURN * 2 * np.pi
    if step <= 0 or np.ptp(degrees) > 2 * np.pi * 1.01 or not (whole or len(degrees) >= _TURN_IN_RADIANS):
        return []
    parts = 2 * np.pi / step
    if abs(parts - round(parts)) > 0.02 or (parts > 2000 and abs(np.ptp(degrees) + step - 2 * np.pi) > 0.01):
        return []
    return [
        f"all angles lie within {np.ptp(degrees):.4g} deg, and {round(parts)} steps make 2 pi: they may be in radians; "
        "angle_deg needs degrees"
    ]


def repeated_frames(seen: Seen, numbers: np.ndarray, off_images: np.ndarray | None = None) -> list[str]:
    """Frames that are the same to the last bit, which noise never makes.

    Args:
        off_images: A number for each record's laser-off image, int [records]; records that name the same image, as two
            lasers at one angle may, have the same. None if each record has its own.
    """
    doubts = []
    on, off = seen.prints[:, 0], seen.prints[:, 1]
    alike = np.flatnonzero((on == off) & (on != 0))
    if len(alike):
        doubts.append(f"the laser-on and the laser-off frame of {named(numbers[alike])} are the same")
    own = np.arange(len(off))
    firsts = own if off_images is None else np.unique(off_images, return_index=True)[1]
    for side, prints, counted in (("on", on, own), ("off", off, firsts)):
        known = counted[prints[counted] != 0]
        values, counts = np.unique(prints[known], return_counts=True)
        # One laser-off frame for the whole sweep is somebody's intention.
        if len(known) and counts.max() > 1 and (side == "on" or len(values) > 1):
            again = np.flatnonzero(np.isin(prints, values[counts > 1]))
            doubts.append(f"the laser-{side} frames of {named(numbers[again])} are the same frame again")
    mixed = np.flatnonzero(np.isin(on, off[off != 0]) & (on != off) & (on != 0))
    if len(mixed):
        doubts.append(f"the laser-on frame of {named(numbers[mixed])} is the laser-off frame of another record")
    return doubts


def blank_frames(seen: Seen, numbers: np.ndarray) -> list[str]:
    """Records of which one frame is without anything where the other has light, as where a file has lost a block."""
    blank = np.flatnonzero(seen.blank.any(1))
    if not len(blank):
        return []
    rows = int(seen.blank[blank].max())
    return [
        f"{said(numbers[blank], 'has', 'have')} up to {rows} rows of zeros in one frame and light there in the other"
    ]


def exchanged_frames(seen: Seen, numbers: np.ndarray) -> list[str]:
    """Records whose laser-off frame has the stripe."""
    brighter, darker = seen.change.T
    if np.median(brighter) <= np.median(darker):
        everywhere = len(numbers) >= _FEW_FRAMES and np.median(darker) > max(4 * np.median(brighter), 5e-4)
        sentence = "the laser is in the laser-off frames and not in the laser-on frames: on and off are exchanged"
        return [sentence] if everywhere else []
    wrong = np.flatnonzero((darker > 4 * brighter) & (darker > 0.2 * np.median(brighter)))
    return [f"laser on and laser off are exchanged in {named(numbers[wrong])}"] if len(wrong) else []


def strange_frames(seen: Seen, numbers: np.ndarray, own: np.ndarray) -> list[str]:
    """Records whose frames are not like those before and after: brighter, rougher, or of two different places.

    `own` are the records of one laser.
    """
    if len(own) < _FEW_FRAMES:
        return []
    doubts = []
    for name, values, floor in (
        ("brightness", np.log(seen.level[own] + 1.0), 0.12),
        ("noise", np.log(seen.grain[own] + 0.5), 0.25),
    ):
        wrong: set[int] = set()
        for side in values.T:
            residuals = bend(side)
            wrong |= set(peaks(np.abs(residuals), max(5.0 * scatter(residuals), floor)).tolist())
        if wrong:
            doubts.append(f"the {name} of {named(numbers[own[sorted(wrong)]])} is not that of the records around")
    usual = np.median(seen.unrest[own])
    unlike = own[seen.unrest[own] > max(3.0 * usual, usual + 3.0, 4.0 * scatter(seen.unrest[own]))]
    if len(unlike):
        doubts.append(f"the laser-on and the laser-off frame of {named(numbers[unlike])} do not show the same")
    broken = own[_far_off(seen.lost[own])]
    broken = broken[~np.isin(broken, unlike)]
    if len(broken):
        doubts.append(
            f"the laser-on frame of {said(numbers[broken], 'lacks', 'lack')} light that its laser-off frame has: one "
            "of the two is damaged or of something else in part"
        )
    light = seen.change[own, 0]
    least = np.minimum(np.concatenate([light[1:2], light[:-1]]), np.concatenate([light[1:], light[-2:-1]]))
    gone = own[(light < 0.1 * least) & (least > 0.4 * np.median(light)) & (least > 2e-3)]
    if len(gone):
        doubts.append(f"{said(numbers[gone], 'shows', 'show')} no laser, and the records around do")
    return doubts


def _far_off(lost: np.ndarray) -> np.ndarray:
    """Records at one of whose places something is far above the same of the sweep and of the records around.

    `lost` is as in `Seen`, of one laser.
    """
    wrong: set[int] = set()
    for place in lost.T:
        residuals = bend(place)
        # Ten standard deviations, of which 4 of 5 residuals keep 1.28 at most; levels are whole numbers.
        usual = float(np.median(place))
        limit = max(8.0 * scatter(residuals), 4.0, usual)
        # The neighbours of a record that is far too low are no higher than usual themselves.
        high = np.where(place - usual > limit, np.maximum(residuals, 0.0), 0.0)
        wrong |= set(peaks(high, limit).tolist())
    return np.array(sorted(wrong), int)


class Motion(NamedTuple):
    """Motion of the picture from each record to the next."""

    lags: np.ndarray
    """Motions that were tried [bins]."""
    alike: np.ndarray
    """Correlation of two records after each motion [records - 1, lags]."""


def turning_doubts(seen: Seen, numbers: np.ndarray, angles: np.ndarray, own: np.ndarray, scanner: Scanner) -> list[str]:
    """Records of one laser that show another place than their angle says, and an axis that lies in the image.

    `own` are the records of one laser; angles [rad].
    """
    if len(own) < _FEW_FRAMES or not seen.trace[own].any() or not isinstance(scanner.turntable, Turntable):
        return []
    found = motion(seen.trace[own])
    shift = found.lags[np.argmax(found.alike, axis=1)]
    turned = (np.diff(angles[own]) + np.pi) % (2 * np.pi) - np.pi
    moving = np.abs(turned) > 1e-6
    if not moving.any():
        return []
    rate = float(np.median(shift[moving] / turned[moving]))
    expected = rate * turned
    reach = _BINS + _NEARER * np.abs(expected)
    steady = np.abs(shift - expected) <= reach
    # Bare walls, wide steps or a dark room tell nothing.
    if np.count_nonzero(steady) < _ALIKE * len(steady):
        return []
    near = np.abs(found.lags - expected[:, None]) <= reach[:, None]
    there = np.where(near, found.alike, -1.0).max(1)
    # A record that is elsewhere fits neither the one before nor the one after.
    fits = np.concatenate([[-1.0], there]), np.concatenate([there, [-1.0]])
    misses = np.concatenate([~steady[:1], ~steady]) & np.concatenate([~steady, ~steady[-1:]])
    usual = float(np.median(there))
    wrong = np.flatnonzero(misses & (np.maximum(*fits) < _ELSEWHERE * usual))
    wrong = np.array([k for run in _runs(wrong) if _continues(seen.trace[own], run, expected, usual) for k in run], int)
    doubts = [said(numbers[own[wrong]], "shows", "show") + " another place than the angle says"] if len(wrong) else []
    return doubts + _lying_axis(rate, float(np.median(np.abs(turned))), scanner)


def _runs(wrong: np.ndarray) -> list[np.ndarray]:
    """Records in a row, apart from others."""
    return [run for run in np.split(wrong, np.flatnonzero(np.diff(wrong) > 1) + 1) if len(run)]


def _continues(trace: np.ndarray, run: np.ndarray, expected: np.ndarray, usual: float) -> bool:
    """Whether the picture goes on as expected around a run of records; if not, it tells nothing there (a bare wall).

    Args:
        trace: [records, places, bins]
        run: Records in a row.
        expected: Motion from each record to the next [bins].
        usual: Correlation of most neighbours [1].
    """
    before, after = int(run[0]) - 1, int(run[-1]) + 1
    if before < 0 or after >= len(trace):
        return True
    found = motion(trace[[before, after]])
    there = float(expected[before:after].sum())
    near = np.abs(found.lags - there) <= _BINS + _NEARER * abs(there)
    return bool(near.any() and found.alike[0, near].max() > _CONTINUED * usual)


def motion(trace: np.ndarray) -> Motion:
    """Correlation of the slopes of each record and the next, where both show the same, for every motion.

    Args:
        trace: [records, places, bins]
    """
    slopes = np.diff(np.asarray(trace, np.float32), axis=-1)
    # An edge of a window is not worth more than many of a texture.
    most = float(np.quantile(np.abs(slopes), 0.98)) or 1.0
    slopes = np.clip(slopes, -most, most)
    count = slopes.shape[-1]
    far = int((1 - _OVERLAP) * count)
    lags = np.arange(-far, far + 1)
    starts = range(0, len(slopes) - 1, _AT_ONCE)
    return Motion(lags, np.concatenate([_correlated(slopes[k : k + _AT_ONCE + 1], lags) for k in starts]))


def _correlated(slopes: np.ndarray, lags: np.ndarray) -> np.ndarray:
    count = slopes.shape[-1]
    spectrum = np.fft.rfft(slopes, 2 * count)
    product = np.fft.irfft((np.conj(spectrum[:-1]) * spectrum[1:]).sum(1), 2 * count)[:, lags]
    # The energy of both where they overlap: of the first from max(0, -lag), of the other from max(0, lag).
    energy = np.pad(np.cumsum((slopes**2).sum(1), axis=1), ((0, 0), (1, 0)))
    parts = []
    for own, sign in ((energy[:-1], -1), (energy[1:], 1)):
        start, stop = np.maximum(0, sign * lags), count + np.minimum(0, sign * lags)
        parts.append(np.maximum(own[:, stop] - own[:, start], 1e-9))
    return product / np.sqrt(parts[0] * parts[1])


def _lying_axis(rate: float, turned: float, scanner: Scanner) -> list[str]:
    """Whether the picture moves along an axis by which it cannot; `refuse_other_motion` looks for the other faults.

    Args:
        rate: Motion of the picture [bins/rad].
        turned: Usual step [rad].
        scanner: The calibrated rig.
    """
    camera, table = scanner.camera, scanner.turntable
    if not isinstance(table, Turntable) or table.carries != "scanner":
        return []
    upright = scanner.up in ("-v", "+v")
    x, y, _ = np.asarray(table.direction, np.float64)
    bins = TRACE_BINS / (camera.width if upright else camera.height)
    focal = -np.asarray(camera.fx) * y if upright else np.asarray(camera.fy) * x
    expected = float(np.asarray(table.gain)) * bins * float(focal)
    if turned * abs(rate) < _BINS or turned * abs(expected) >= _STILL:
        return []
    return ["the calibrated axis does not stand upright in the image: the axis, or `up`, may be wrong"]


def profile_doubts(cloud: PointCloud, numbers: np.ndarray) -> list[str]:
    """Records whose points lie far from those around, or are missing; distances do not depend on the angle."""
    far: list[int] = []
    few: list[int] = []
    record, laser = np.asarray(cloud.record), np.asarray(cloud.laser)
    for one in np.unique(laser):
        own = np.flatnonzero(laser == one)
        # If a record has several candidates, the first is taken.
        own = own[np.unique(record[own], return_index=True)[1]]
        if len(own) < _FEW_PROFILES:
            continue
        valid = np.asarray(cloud.valid)[own]
        distance = np.hypot(*(np.asarray(cloud.xyz)[own, :, axis] for axis in (0, 1)))
        far += record[own[_far(distance, valid)]].tolist()
        few += record[own[_far_fewer(valid.mean(1))]].tolist()
    doubts = []
    if far:
        doubts.append(f"the points of {named(numbers[sorted(far)])} are not where those of the records around are")
    if few:
        doubts.append(f"{said(numbers[sorted(few)], 'has', 'have')} far fewer points than the records around")
    return doubts


def _far(distance: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Profiles that do not lie between those before and after, in logarithms of the distance from the axis."""
    log = np.log(np.maximum(distance, 1e-3))
    bends = np.zeros(len(log))
    for k in range(1, len(log) - 1):
        common = valid[k - 1] & valid[k] & valid[k + 1]
        if np.count_nonzero(common) >= max(8, _COMMON * valid.shape[1]):
            before, here, after = log[k - 1 : k + 2, common]
            # Beyond both neighbours: at the edge of a thing a profile is like one of them.
            outside = np.maximum(here - np.maximum(before, after), np.minimum(before, after) - here)
            bends[k] = abs(np.median(np.where(outside > 0, np.sign(here - before) * outside, 0.0)))
    return peaks(bends, max(6.0 * scatter(bends), 0.1))


def _far_fewer(share: np.ndarray) -> np.ndarray:
    least = np.minimum(share[:-2], share[2:])
    return 1 + np.flatnonzero((share[1:-1] < 0.25 * least) & (least > max(0.5 * np.median(share), 0.1)))


def header_doubts(sweep: SweepSource, seen: Seen, scanner: Scanner) -> list[str]:
    """Entries of the header that contradict the frames, or the calibrated rig."""
    doubts = _mosaic(sweep.pixel_format, np.median(seen.colours, 0)) if len(seen.colours) else []
    lit = np.bincount(sweep.record, minlength=len(sweep))
    for laser in np.unique(sweep.laser):
        line = sweep.lasers[laser]
        own = np.unique(sweep.record[sweep.laser == laser])
        own = own[lit[own] == 1]
        if len(own) and line.colour != "auto":
            doubts += _colour(sweep.pixel_format, line.colour, line.name, seen.light[own].sum(0))
    return doubts + _lying_sheet(sweep, scanner)


def _mosaic(pixel_format: str, colours: np.ndarray) -> list[str]:
    if pixel_format == "rgb8" or colours.mean() < _LEAST_DN:
        return []
    spread = np.ptp(colours) / colours.mean()
    if pixel_format == "mono8":
        if spread > 0.05:
            return ['the frames show a mosaic of colours, and pixel_format is "mono8"']
        return []
    if spread < 0.01:
        return [f'the frames show no mosaic of colours, and pixel_format is "{pixel_format}"']
    green = list(_GREEN[pixel_format])
    others = [k for k in range(4) if k not in green]
    unlike, alike = np.ptp(colours[green]), np.ptp(colours[others])
    if unlike > 4 * alike + 0.02 * colours.mean():
        return [f'the frames show another order of colours than the pixel_format "{pixel_format}"']
    return []


def _colour(pixel_format: str, colour: str, name: str, light: np.ndarray) -> list[str]:
    phases = _PHASES.get(pixel_format)
    if phases is None:
        return []
    shown = {one: float(np.mean([light[k] for k, two in enumerate(phases) if two == one])) for one in set(phases)}
    best = max(shown, key=lambda one: shown[one])
    if shown[best] > 2.5 * shown.get(colour, np.inf) and shown[best] > 0:
        return [f'the laser "{name}" is {best} in the frames, and {colour} or another order of colours in the header']
    return []


def _lying_sheet(sweep: SweepSource, scanner: Scanner) -> list[str]:
    """A sheet that is seen along the rows, with one centre asked for on each of them."""
    doubts = []
    normals = np.atleast_2d(np.asarray(scanner.lasers.normal, np.float64))
    upright = np.abs(normals[:, 0]) > 2 * np.abs(normals[:, 1])
    lying = np.abs(normals[:, 1]) > 2 * np.abs(normals[:, 0])
    axis = sweep.lasers[0].stripe_axis
    if (axis == "columns" and upright.all()) or (axis == "rows" and lying.all()):
        better = "rows" if axis == "columns" else "columns"
        doubts.append(f'stripe_axis is "{axis}", and the calibrated laser is seen across the {better}')
    return doubts


def pair_notes(
    sweep: SweepSource,
    stripes: Stripes,
    frames: Callable[[int], tuple[Array | None, Array | None]],
    numbers: Sequence[int],
) -> tuple[str, ...]:
    """The faults of a sweep's pairs, from some of them all over it: laser light in the laser-off image, motion.

    Args:
        stripes: Its stripes; of several of a line the brightest counts.
        frames: Laser-on and laser-off frame of a record.
        numbers: The name of each record.
    """
    alone = np.flatnonzero(np.bincount(sweep.record, minlength=len(sweep)) == 1)
    if len(alone) == 0 or len(sweep.exposures) > 1:
        return ()
    chosen = alone[np.unique(np.linspace(0, len(alone) - 1, _JUDGED_PAIRS).astype(int))]
    pairs = [frames(int(record)) for record in chosen]
    if any(off is None for _, off in pairs):
        return ()
    notes, lasers = [], learned_lasers(sweep)
    laser = sweep.laser[np.searchsorted(sweep.record, chosen)]
    for index in np.unique(laser):
        own = np.flatnonzero(laser == index)
        on, off = (np.stack(images) for images in zip(*(pairs[i] for i in own), strict=True))
        line, seen = lasers[index], _brightest(stripes, chosen[own])
        found = judge_pairs(on, off, seen, frames=FrameFormat(sweep.pixel_format, sweep.response), line=line)
        leaking = float(np.median(found.leak))
        if leaking > _LEAK and leaking > 4.0 * float(np.median(found.leak_sigma)):
            notes.append(
                f'the laser "{line.name}" is in the laser-off images too ({100 * leaking:.0f} % of the stripe): wait '
                f"longer after switching it off"
            )
        moving = [str(numbers[i]) for i in chosen[own][found.unrest > _UNREST]]
        if moving:
            notes.append(
                f"something moved, or a lamp changed, between the two images of record "
                f"{', '.join(moving)} ({len(own)} were looked at)"
            )
    return tuple(notes)


def _brightest(stripes: Stripes, records: np.ndarray) -> Stripes:
    """One profile of each of some records, of every line the brightest stripe."""
    mine = np.stack([np.flatnonzero(np.asarray(stripes.record) == record) for record in records])
    best = np.argmax(np.where(np.asarray(stripes.valid)[mine], np.asarray(stripes.amplitude)[mine], 0), axis=1)
    rows = np.take_along_axis(mine, best, 1)
    lines = np.arange(rows.shape[1])[None, :]
    fields = {name: np.asarray(field)[rows, lines] for name, field in vars(stripes).items() if np.ndim(field) == 2}
    return Stripes(**fields, record=records, laser=np.zeros(len(records), np.int32))
