"""Why a calibration is not updated: one sentence each, with the finding, the expectation and the remedy."""

from collections.abc import Sequence

import numpy as np

from jaxscan.recalibration.judge.drift import TABLE_PART, Compared, scale_slopes
from jaxscan.recalibration.observed import Surfaces
from jaxscan.recalibration.result import Adjusted, Drift, HoldOut, LengthGain


# Residuals this much larger than they are known to be, in variance, are of something that is not in the model: than
# was learned from them, and than was stated before (walls may be rougher, and stripes noisier, than anybody stated).
_BELIEVABLE, _MISFIT = 3.0, 25.0
# Largest roughness and unevenness of a flat wall [m].
_ROUGHEST_M = 5e-3
# Planes whose normals are nearer than this have one direction.
_SAME_DIRECTION = np.cos(np.radians(15.0))
_LEAST_DIRECTIONS = 2
# Tracked points, and turn over which they are seen [rad], that stand for walls in other directions.
_LEAST_TRACKS, _LEAST_TURN = 20, np.radians(90.0)
# Least gain of a direction, and of a length, for which a calibration is updated: old over new standard deviation [1].
_LEAST_GAIN = 1.05
# No length may be known worse than before by more than rounding and first order make of it [1].
_WORSE = 1.02
# Largest relative sigma of a room's scale [1].
_LEAST_SCALE = 0.01


def refuse_result(
    adjusted: Adjusted, compared: Compared, drift: Drift, held_out: HoldOut | None, lengths: Sequence[LengthGain]
) -> str:
    """The first reason not to update; empty where there is none."""
    best = float(np.max(compared.factor, initial=1.0))
    directions = count_directions(adjusted.surfaces)
    if not adjusted.converged:
        return (
            f"the adjustment did not settle in {adjusted.steps} steps; check that the sweeps are of this rig and of "
            "one room that stood still"
        )
    if directions < _LEAST_DIRECTIONS and not (_many_tracks(adjusted) or _lit_boards(adjusted)):
        return (
            f"the planes found face {directions} direction{'s' if directions != 1 else ''}, expected at least "
            f"{_LEAST_DIRECTIONS}, better 3 (two walls and the floor): sweep more of the room"
        )
    learned, uneven = adjusted.cost / max(adjusted.freedom, 1), float(np.hypot(adjusted.wall_m, adjusted.uneven_m))
    if learned > _BELIEVABLE or adjusted.misfit > _MISFIT or uneven > _ROUGHEST_M:
        return (
            f"the walls do not fit: residuals are {np.sqrt(max(learned, adjusted.misfit)):.1f} times as large as "
            f"stated and the walls are uneven by {1e3 * uneven:.1f} mm (expected at most {np.sqrt(_MISFIT):.0f} times "
            f"and {1e3 * _ROUGHEST_M:.0f} mm), worst {_worst_surfaces(adjusted)}; check that nothing moved during the "
            "sweep and that the calibration is of this rig"
        )
    if held_out is not None and not held_out.better:
        before, after = np.mean(held_out.before_mm), np.mean(held_out.after_mm)
        return (
            f"planes that were not used became less flat ({before:.2f} mm before, {after:.2f} mm after), expected "
            "flatter ones: the walls are not flat enough, or something moved; sweep another room"
        )
    parts, size = drift.moves[0] if drift.moves else ((), "")
    if drift.drifted and TABLE_PART in parts:
        # Steps that were lost or miscounted were found before; gears keep their errors, whatever hits the rig.
        return (
            f"the walls fit only if the {' and '.join(parts)} changed ({size}; p = {drift.p:.1g}), and no knock "
            "changes the angles of a table, while a wall that is curved or has a step looks the same; sweep a room "
            "with flat walls, or calibrate with boards if the table or its gear was changed"
        )
    if drift.drifted and adjusted_scale(adjusted) > _LEAST_SCALE:
        return (
            f"the rig has drifted (p = {drift.p:.1g}; {drift.part}), and these sweeps alone would know the scale of "
            f"the room to {100 * adjusted_scale(adjusted):.1f} % only, expected {100 * _LEAST_SCALE:g} %: give a known "
            "length or a capture of a board, or calibrate again"
        )
    return "" if drift.drifted else _nothing_gained(best, lengths)


def _nothing_gained(best: float, lengths: Sequence[LengthGain]) -> str:
    if best < _LEAST_GAIN:
        return (
            f"nothing was gained: the best direction is known {best:.2f} times as well as before, expected at least "
            f"{_LEAST_GAIN:g} times; the stored calibration is as good as these sweeps"
        )
    # A length that the stored calibration makes without any error can neither gain nor lose.
    shares = [each.after_mm / each.before_mm for each in lengths if each.before_mm > 0]
    if shares and min(shares) > 1.0 / _LEAST_GAIN:
        return (
            f"nothing was gained: the best of the typical lengths is known {1.0 / min(shares):.2f} times as well as "
            f"before, expected at least {_LEAST_GAIN:g} times; the stored calibration is as good as these sweeps"
        )
    if shares and max(shares) > _WORSE:
        worst = max((each for each in lengths if each.before_mm > 0), key=lambda each: each.after_mm / each.before_mm)
        return (
            f"a length of {worst.length_m:.1f} m {worst.name} would be known worse (± {worst.after_mm:.2f} mm, before "
            f"± {worst.before_mm:.2f} mm), though nothing has drifted; the stored calibration is better there"
        )
    return ""


def _many_tracks(adjusted: Adjusted) -> bool:
    """Whether tracked points say as much of the table as walls in two directions do."""
    tracks = adjusted.observations.tracks
    if tracks is None or not adjusted.track_kept.any():
        return False
    sweep, record = tracks.sweep[adjusted.track_kept], tracks.record[adjusted.track_kept]
    turned = [
        float(np.ptp(angle[record[sweep == number]]))
        for number, angle in enumerate(adjusted.observations.angles)
        if np.any(sweep == number)
    ]
    seen = len(np.unique(tracks.track[adjusted.track_kept]))
    return seen >= _LEAST_TRACKS and bool(max(turned) >= _LEAST_TURN)


def _lit_boards(adjusted: Adjusted) -> bool:
    """Whether boards were captured with the stripe on them."""
    boards = adjusted.observations.boards
    return boards is not None and len(boards.stripes.q) > 0


def adjusted_scale(adjusted: Adjusted) -> float:
    """Standard deviation of the radial scale [1]."""
    slope = scale_slopes(adjusted.scanner, adjusted.observations, adjusted.corrections)[0]
    return float(np.sqrt(slope @ np.asarray(adjusted.scanner.covariance) @ slope))


def count_directions(surfaces: Surfaces) -> int:
    """Number of directions in which planes face; opposite walls count once."""
    found: list[np.ndarray] = []
    for normal in surfaces.normal:
        if all(abs(normal @ other) < _SAME_DIRECTION for other in found):
            found.append(normal)
    return len(found)


def _worst_surfaces(adjusted: Adjusted) -> str:
    """The surfaces whose points are farthest off, by their directions and distances."""
    points, kept = adjusted.observations.points, adjusted.point_kept
    own = points.surface[kept]
    square = np.bincount(own, adjusted.point_error[kept] ** 2, minlength=len(adjusted.surfaces.distance))
    rms = np.sqrt(square / np.maximum(np.bincount(own, minlength=len(square)), 1))
    order = np.argsort(-rms)[:2]
    return " and ".join(f"{describe_surface(adjusted.surfaces, int(k))} ({1e3 * rms[k]:.1f} mm)" for k in order)


def none_is_flat(adjusted: Adjusted) -> str:
    """One line for a room of which no surface can be used."""
    count = len(adjusted.surfaces.distance)
    return (
        f"none of the {count} surfaces found is flat, worst {_worst_surfaces(adjusted)}; expected flat walls: sweep a "
        "room that has some, and check that nothing moved during the sweep and that the calibration is of this rig."
    )


def describe_surface(surfaces: Surfaces, number: int) -> str:
    """A surface in words: "the floor", "a wall at 2.1 m towards 35 degrees"."""
    normal, distance = surfaces.normal[number], float(surfaces.distance[number])
    away = normal * np.sign(distance) if distance else normal
    if abs(away[2]) > _SAME_DIRECTION:
        return f"the {'ceiling' if away[2] > 0 else 'floor'} at {abs(distance):.2f} m"
    if abs(away[2]) > np.sin(np.radians(15.0)):
        return f"an inclined plane at {abs(distance):.2f} m"
    return f"the wall at {abs(distance):.2f} m towards {np.degrees(np.arctan2(away[1], away[0])):.0f} degrees"
