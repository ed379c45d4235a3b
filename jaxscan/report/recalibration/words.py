"""A recalibration in sentences: drift, gain, motions of the parts, walls, closure, faults of the table."""

import math

import numpy as np

from jaxscan.recalibration import Drift, Gain, Moved, PanoramaOfWalls, Recalibration
from jaxscan.report.words import Headline, length_words, millimetres, sentence


SMALLEST_P = 1e-6
"""Smaller p-values are shown as "less than" this one."""
LARGEST_FACTOR = 1000.0
"""Larger gains are shown as "more than" this one."""
_NAMES = {"camera": "camera", "axis": "axis of the table"}


def drift_words(drift: Drift) -> str:
    """Whether the rig is as it was calibrated."""
    p = _chance(drift.p)
    if not drift.drifted:
        return f"The rig is as it was calibrated ({p})"
    if not drift.part:
        return f"The rig has drifted, and no single part explains it ({p})"
    moves = [_move(parts, size) for parts, size in drift.moves]
    unsure = "; these sweeps cannot tell which" if len(moves) > 1 else ""
    return f"The rig has drifted: {', or '.join(moves)}{unsure} ({p})"


def _move(names: tuple[str, ...], size: str) -> str:
    """How parts moved together."""
    parts = [_part(name) for name in names]
    if len(parts) == 1:
        return f"the {parts[0]} moved{f' by {size}' if size else ''}"
    return f"the {', the '.join(parts[:-1])} and the {parts[-1]} moved{f' ({size})' if size else ''}"


def headline(result: Recalibration) -> Headline:
    """The verdict on drift, and whether the calibration was updated."""
    said = drift_words(result.drift)
    if not result.updated:
        return Headline("open", said, f"The calibration was not updated: {sentence(result.refused)}")
    wall, points = 1e3 * result.adjusted.wall_m, int(np.count_nonzero(result.adjusted.point_kept))
    walls = len(result.adjusted.surfaces.distance)
    rough = f"rough by {millimetres(wall)}" if wall > 0 else "whose roughness is lost in the noise"
    explanation = (
        f"The calibration was updated from {points:,} points on {walls} flat {'surface' if walls == 1 else 'surfaces'}"
        f", {rough}."
    )
    return Headline("bad" if result.drift.drifted else "good", said, explanation)


def length_lines(result: Recalibration) -> list[str]:
    """The uncertainty of typical lengths before and after, one line each."""
    lasers = {one.laser for one in result.lengths}
    lines = []
    for one in result.lengths:
        words = length_words(one.name, one.length_m, one.depth_m)
        beside = f", laser {one.laser}" if len(lasers) > 1 else ""
        change = f"{millimetres(one.before_mm)} before, {millimetres(one.after_mm)} now"
        lines.append(f"{words}{beside}: {change}{_times(one.before_mm, one.after_mm)}")
    return lines


def gain_lines(gains: tuple[Gain, ...], most: int = 6) -> list[str]:
    """How much better each direction is known: the two scales, then those that gained most."""
    scales = [gain for gain in gains if gain.name.endswith("scale")]
    others = sorted((gain for gain in gains if gain not in scales), key=lambda gain: -gain.factor)
    return [
        *(f"{gain.name}: {_gain(gain)}" for gain in scales),
        *(f"{gain.name}: {_gain(gain)}" for gain in others[:most] if gain.factor > 1.005),
    ]


def known_lines(result: Recalibration) -> list[str]:
    """Lengths that were given beside those that the new scanner finds."""
    return [
        f"known length {one.metres:.4f} m: found {one.found_m:.4f} m, {1e3 * (one.found_m - one.metres):+.2f} mm "
        f"(given to {millimetres(1e3 * one.sigma_m)})"
        for one in result.known
    ]


def wall_lines(result: Recalibration) -> list[str]:
    """Flatness of the walls before and after, a line for each sweep."""
    lines = []
    for panorama in result.panoramas:
        before, after = flatness_mm(panorama)
        if math.isfinite(before):
            lines.append(f"walls of {panorama.sweep}: {millimetres(before)} off flat before, {millimetres(after)} now")
    return lines


def flatness_mm(panorama: PanoramaOfWalls) -> tuple[float, float]:
    """Root mean square distance of the points from their planes, before and after [mm]; NaN without points."""
    seen = np.asarray(panorama.seen)
    if not seen.any():
        return math.nan, math.nan
    before, after = (
        float(np.sqrt(np.mean(np.square(field[seen], dtype=np.float64)))) for field in (panorama.before, panorama.after)
    )
    return 1e3 * before, 1e3 * after


def hold_out_lines(result: Recalibration) -> list[str]:
    """Flatness of walls that had no part in the solve."""
    found = result.hold_out
    if found is None:
        return []
    halves = [
        f"{millimetres(before)} before, {millimetres(after)} now"
        for before, after in zip(found.before_mm, found.after_mm, strict=True)
    ]
    ending = "" if found.better else "; the new calibration explains them no better"
    return [f"walls that had no part in the solve are off flat by {'; and '.join(halves)}{ending}"]


def closure_lines(result: Recalibration) -> list[str]:
    """The gap that is left after a full turn."""
    closure = result.closure
    if closure is None:
        return []
    name, sigma = "closure after a full turn, at 2.5 m", millimetres(closure.sigma_mm)
    if closure.before_mm is None:
        return [f"{name}: no overlap and no feature shows it; it is known to {sigma} by the table's model (one sigma)"]
    if closure.after_mm is None:
        return [f"{name}, by features: {millimetres(closure.before_mm)} before; it is known to {sigma} now (one sigma)"]
    return [
        f"{name}, by the overlap: {millimetres(closure.before_mm)} before, "
        f"{millimetres(closure.after_mm)} now (sigma {sigma})"
    ]


def table_lines(result: Recalibration) -> list[str]:
    """Faults of the table's angles."""
    return [sentence(fault) for fault in result.table.sentences]


def moved_rows(moved: tuple[Moved, ...]) -> list[tuple[str, ...]]:
    """Parameters that moved, the most by its sigmas first: name, before, after, sigmas before and after, sigmas."""
    return [
        (
            f"{one.name}, {one.unit}" if one.unit else one.name,
            *(_number(one.scale * value) for value in (one.before, one.after)),
            *(_number(one.scale * sigma, 2) for sigma in (one.sigma_before, one.sigma_after)),
        )
        + (f"{one.sigmas:+.1f}",)
        for one in by_sigmas(moved)
    ]


def station_rows(result: Recalibration) -> list[tuple[str, ...]]:
    """Places of the stations in the frame of the first, with their sigmas; none where there is one station."""
    poses, covariance = result.adjusted.stations, result.adjusted.station_covariance
    if len(poses) < 2:
        return []
    rows = []
    for number, (pose, own) in enumerate(zip(poses, covariance, strict=True)):
        place, turn = (float(np.sqrt(max(np.trace(part), 0.0))) for part in (own[:3, :3], own[3:, 3:]))
        azimuth = math.degrees(math.atan2(pose[1, 0], pose[0, 0]))
        sigmas = (f"{1e3 * place:.2f}", f"{1e3 * turn:.2f}") if number else ("–", "–")
        rows.append((str(number + 1), *(f"{value:.4f}" for value in pose[:3, 3]), f"{azimuth:.2f}", *sigmas))
    return rows


def by_sigmas(moved: tuple[Moved, ...]) -> list[Moved]:
    """The parameters that could move, the most by its sigmas first."""
    return sorted((one for one in moved if one.sigma_before > 0), key=lambda one: -abs(one.sigmas))


def _part(part: str) -> str:
    return f"plane of {part}" if part.startswith("laser ") else _NAMES.get(part, part)


def _chance(p: float) -> str:
    return f"p < {SMALLEST_P:.0e}".replace("e-0", "e-") if p < SMALLEST_P else f"p = {p:.2g}"


def _gain(gain: Gain) -> str:
    if gain.factor < 1.05:
        return "as well known as before" + (f", {_short(gain.after)} {gain.unit}" if gain.unit else "")
    sizes = f", {_short(gain.before)} before and {_short(gain.after)} {gain.unit} now" if gain.unit else ""
    return f"{factor(gain.factor)} better known{sizes}"


def _times(before: float, after: float) -> str:
    if not 0 < after < before / 1.05:
        return ""
    return f", {factor(before / after)} better"


def factor(times: float) -> str:
    """A factor of gain in words."""
    if times > LARGEST_FACTOR:
        return f"more than {LARGEST_FACTOR:.0f} times"
    return f"{times:.0f} times" if times >= 9.95 else f"{times:.1f} times"


def _short(value: float) -> str:
    """Two significant digits, without an exponent where that is short."""
    return f"{value:.0f}" if 9.95 <= abs(value) < 1e6 else f"{value:.2g}"


def _number(value: float, digits: int = 7) -> str:
    return f"{value:.{digits}g}"
