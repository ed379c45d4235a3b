"""Whether stripes come back where the angles come back: a turn that is declared twice, or only half.

What the laser shows from the camera depends on the table's angle alone, whoever turns. So at one angle it shows the
same in every turn, and at another one something else, unless the object is alike all around.
"""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import Scanner, Turntable, invert, poses, transform
from jaxscan.reconstruction.cloud import PointCloud


_RECORDS, _LINES = 120, 96
"""Profiles and lines that are compared, at most."""
_LEAST = 8
"""Profiles that tell something."""
_SMOOTH = 0.5
"""Difference of neighbours in that of any two profiles, up to which it tells what is near [1]."""
_AS_NEAR, _FAR = 0.6, 0.5
"""Differences below the first, in that of neighbours, are of one angle; above the second, in that of any two, of others
[1]."""
_PAIRS, _CLOSER = 4, 0.8
"""Pairs of a lag at the least, and of profiles at the ends; and how much nearer the last one is to the first [1]."""


class _Compared(NamedTuple):
    """Differences of profiles."""

    records: np.ndarray
    angles: np.ndarray
    """[deg]"""
    difference: np.ndarray
    """Mean distance of points on the same lines [m, profiles, profiles]; one that is missing counts as far."""
    pictures: np.ndarray
    """Mean difference of laser-off images [DN, profiles, profiles]."""


def turn_doubts(cloud: PointCloud, scanner: Scanner, trace: np.ndarray, numbers: np.ndarray) -> list[str]:
    """Angles that come back where the stripes do not, or the other way about; at most one sentence.

    Args:
        cloud: The cloud of a sweep.
        scanner: Its scanner.
        trace: As `Seen` has it, of each record.
        numbers: The name of each record.
    """
    if not isinstance(scanner.turntable, Turntable):
        return []
    seen = _compared(cloud, scanner, trace)
    if seen is None:
        return []
    count, name = len(seen.records), lambda k: int(numbers[seen.records[k]])
    apart = np.abs((seen.angles[:, None] - seen.angles + 180.0) % 360.0 - 180.0)
    lag = np.abs(np.arange(count)[:, None] - np.arange(count))
    step = float(np.median(apart[lag == 1]))
    usual, near = float(np.median(seen.difference[lag > 0])), float(np.median(seen.difference[lag == 1]))
    if step == 0:
        return []
    same = np.argwhere(np.triu((apart < 0.5 * step) & (lag > 1)))
    if len(same):
        differences = seen.difference[same[:, 0], same[:, 1]]
        if float(np.median(differences)) > max(_FAR * usual, 2 * near):
            one, other = same[len(same) // 2]
            return [
                f"records {name(one)} and {name(other)} are at one angle by the journal ({seen.angles[one]:g} and "
                f"{seen.angles[other]:g} deg), but the laser shows other places there, "
                f"{1e3 * np.median(differences):.3g} mm apart: the angles are wrong, perhaps by a factor, or the "
                "object was moved"
            ]
        return []
    for m in range(3, count - _PAIRS + 1):
        differences, declared = np.diagonal(seen.difference, m), float(np.median(np.diagonal(apart, m)))
        if (
            float(np.median(differences)) < _AS_NEAR * min(near, _SMOOTH * usual)
            and declared > 1.5 * step
            and _alike(seen, m)
        ):
            return [
                f"the laser shows the same after {_records(seen, m)} records, which the journal says are "
                f"{declared:.4g} deg: either the object is alike after so many degrees, or the table made a whole turn "
                f"meanwhile, and its steps are {360.0 / _records(seen, m):.4g} deg"
            ]
    # From the last record on to the first, and from the first one back to the last: each step is like those beside it.
    ends = 0.5 * (seen.difference[0, ::-1] + seen.difference[-1])[:_PAIRS]
    beside = 1.5 * max(float(seen.difference[0, 1]), float(seen.difference[-2, -1]), near)
    closed = near < _SMOOTH * usual and ends[0] < min(beside, _CLOSER * float(ends[1:].min()))
    if closed and apart[0, -1] > 3 * step and _alike(seen, count - 1):
        records = int(seen.records[-1] - seen.records[0]) + 1
        return [
            f"the first and the last record are neighbours by what the laser shows, but {apart[0, -1]:.4g} deg apart "
            f"by the journal: either the object is alike there, or the table made a whole turn, and its steps are "
            f"{360.0 / records:.4g} deg"
        ]
    return []


def _records(seen: _Compared, lag: int) -> int:
    return round(lag * float(np.median(np.diff(seen.records))))


def _alike(seen: _Compared, lag: int) -> bool:
    """Whether pictures so many profiles apart are not less alike than any two, where pictures change at all."""
    usual = float(np.median(seen.pictures[np.triu_indices(len(seen.records), 1)]))
    return usual < 0.5 or float(np.median(np.diagonal(seen.pictures, lag))) < _FAR * usual


def _compared(cloud: PointCloud, scanner: Scanner, trace: np.ndarray) -> _Compared | None:
    laser, record = np.asarray(cloud.laser), np.asarray(cloud.record)
    own = np.flatnonzero(laser == np.bincount(laser).argmax()) if len(laser) else np.zeros(0, int)
    # If a record has several candidates, the first is the brightest.
    own = own[np.unique(record[own], return_index=True)[1]]
    if len(own) < _LEAST:
        return None
    chosen = own[np.unique(np.linspace(0, len(own) - 1, min(len(own), _RECORDS)).astype(int))]
    if len(np.unique(np.diff(chosen))) > 1:
        # Evenly, so that neighbours are equally far.
        chosen = own[:: -(-len(own) // _RECORDS)]
    lines = np.unique(np.linspace(0, cloud.valid.shape[1] - 1, _LINES).astype(int))
    valid = np.asarray(cloud.valid)[np.ix_(chosen, lines)]
    lines, valid = lines[valid.any(0)], valid[:, valid.any(0)]
    if len(lines) < 4 or np.count_nonzero(valid.any(1)) < _LEAST:
        return None
    angle = np.asarray(cloud.angle, np.float64)[chosen]
    xyz = np.asarray(cloud.xyz, np.float64)[np.ix_(chosen, lines)]
    # Where the camera sees them, whatever the angle.
    p = np.asarray(transform(invert(poses(scanner.rig, angle))[:, None], xyz))
    reach = max(float(np.quantile(np.linalg.norm(p[valid] - np.median(p[valid], axis=0), axis=1), 0.8)), 1e-9)
    difference = np.zeros((len(chosen), len(chosen)))
    for k in range(len(chosen)):
        either, both = valid | valid[k], valid & valid[k]
        gaps = np.where(both, np.minimum(np.linalg.norm(p - p[k], axis=2), reach), reach * (either & ~both))
        difference[k] = gaps.sum(1) / np.maximum(either.sum(1), 1)
    flat = np.asarray(trace, np.float32)[record[chosen]].reshape(len(chosen), -1)
    pictures = np.stack([np.abs(flat - one).mean(1) for one in flat])
    return _Compared(record[chosen], np.degrees(angle), difference, pictures)
