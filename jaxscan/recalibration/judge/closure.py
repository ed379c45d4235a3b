"""The gap after a full turn: planes that a sweep sees twice, or the gain of the table's angle."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner, Turntable
from jaxscan.measurement.planes import weighted_plane
from jaxscan.recalibration.result import Adjusted, Closure
from jaxscan.recalibration.triangulate import place_points


RADIUS_M = 2.5
"""Distance from the axis at which the gap is told [m]."""
_TURN = 2.0 * np.pi
# Fewer points of a plane say nothing of its direction.
_LEAST_PASS = 30
# A point of the room that is seen again after this turn closes it [rad].
_NEARLY = np.radians(350.0)


def closure_of(adjusted: Adjusted, stored: Scanner) -> Closure | None:
    """The gap after a full turn, with the stored and with the new scanner; None without a full turn.

    Where a sweep overlaps itself the gap is measured: planes that the first pass saw against points of the second.
    A table's gain need not be 1, so without an overlap the gap is that of the stored gain against the new one where
    features close the turn, and nobody knows it where nothing does: then only its standard deviation is told.
    """
    if not isinstance(stored.turntable, Turntable) or not isinstance(adjusted.scanner.turntable, Turntable):
        return None
    if not any(np.ptp(angle) > _NEARLY for angle in adjusted.observations.angles if len(angle)):
        return None
    before = _overlap_gap(stored, adjusted, ())
    after = _overlap_gap(adjusted.scanner, adjusted, adjusted.corrections)
    if before is not None and after is not None:
        return Closure(_mm(before[0]), _mm(after[0]), _mm(after[1]), "overlap")
    position = stored.parameter_names().index("gain")
    sigma = float(np.sqrt(max(np.asarray(adjusted.scanner.covariance)[position, position], 0.0)))
    if not _seen_again(adjusted):
        return Closure(None, None, _mm(_TURN * sigma), "model")
    change = float(adjusted.scanner.turntable.gain) - float(stored.turntable.gain)
    return Closure(_mm(_TURN * change), None, _mm(_TURN * sigma), "features")


def _mm(angle: float) -> float:
    return 1e3 * RADIUS_M * abs(angle)


def _seen_again(adjusted: Adjusted) -> bool:
    """Whether a tracked point is seen at the beginning and at the end of a turn."""
    tracks = adjusted.observations.tracks
    if tracks is None:
        return False
    kept = np.flatnonzero(adjusted.track_kept)
    for sweep, angle in enumerate(adjusted.observations.angles):
        own = kept[tracks.sweep[kept] == sweep]
        phi = angle[tracks.record[own]]
        _, point = np.unique(tracks.track[own], return_inverse=True)
        low, high = np.full(len(own), np.inf), np.full(len(own), -np.inf)
        np.minimum.at(low, point, phi)
        np.maximum.at(high, point, phi)
        if len(own) and np.any(high - low > _NEARLY):
            return True
    return False


def _overlap_gap(scanner: Scanner, adjusted: Adjusted, corrections: Sequence[np.ndarray]) -> tuple[float, float] | None:
    """The angle by which the second pass is turned against the first, a weighted mean over planes and sweeps, and its
    sigma [rad]."""
    observations = adjusted.observations
    kept = np.flatnonzero(adjusted.point_kept)
    points = observations.points.take(kept)
    journal = observations.angles_of(points)
    place, valid = place_points(scanner, observations, corrections, points=points)
    sigma = adjusted.point_sigma[kept]
    weight = total = 0.0
    for sweep, angle in enumerate(observations.angles):
        way = 1.0 if angle[-1] >= angle[0] else -1.0
        turned = way * (journal - angle[0])
        end = float(np.max(way * (angle - angle[0])))
        for surface in np.unique(points.surface[points.sweep == sweep]):
            own = valid & (points.sweep == sweep) & (points.surface == surface)
            first, second = own & (turned <= end - _TURN), own & (turned >= _TURN)
            if min(first.sum(), second.sum()) >= _LEAST_PASS:
                information, score = _turn_of_plane(place, sigma, first, second)
                weight, total = weight + information, total + score
    if weight <= 0.0:
        return None
    return total / weight, float(np.sqrt(adjusted.inflation / weight))


def _turn_of_plane(
    place: Float[np.ndarray, "n 3"], sigma: Float[np.ndarray, " n"], first: np.ndarray, second: np.ndarray
) -> tuple[float, float]:
    """Information on the turn between two passes over one plane, whose three unknowns are eliminated, and its score."""
    both = np.concatenate([place[first], place[second]])
    late = np.repeat([0.0, 1.0], [first.sum(), second.sum()])
    own = np.concatenate([sigma[first], sigma[second]])
    flat = weighted_plane(both, np.ones(len(both)))
    arm, normal = both - flat.centre, flat.normal
    # A turn about the scanner's z axis moves a point by z x p.
    moved = late * (normal[1] * both[:, 0] - normal[0] * both[:, 1]) / own
    plane = np.column_stack([arm @ flat.axes.T, np.ones(len(arm))]) / own[:, None]
    basis, _ = np.linalg.qr(plane)
    free = moved - basis @ (basis.T @ moved)
    return float(free @ free), float(free @ (arm @ normal / own))
