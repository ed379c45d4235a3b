"""The grid of a cloud as sheets: columns of profiles that follow each other.

A sheet has the profiles of one laser at one station, in the order of their angle. After a full turn its first profile
is there a second time, as its last column.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from jaxscan.errors import CloudError
from jaxscan.reconstruction import PointCloud


WIDEST_GAP = 2.5
"""Profiles further apart than so many usual steps are no neighbours."""
SMALLEST_GAP = 0.25
"""Profiles nearer than so many usual steps are the same one, taken twice."""
WIDEST_CLOSING = 4.0
"""The last profile joins the first where their points are at most so many times as far apart as usual."""


class Lattice(NamedTuple):
    """Columns of the grid, sheet after sheet."""

    profile: Int[np.ndarray, " columns"]
    """Profile of the cloud in each column."""
    joined: Bool[np.ndarray, " gaps"]
    """Whether each column and the next one are neighbours; one less than columns."""
    closes: Bool[np.ndarray, " columns"]
    """Whether the column repeats the first one of its sheet."""


def make_lattice(cloud: PointCloud) -> Lattice:
    """The sheets of a cloud.

    Raises:
        CloudError: If the cloud has no grid.
    """
    valid = np.asarray(cloud.valid)
    if min(valid.shape) < 2 or len(np.unique(np.asarray(cloud.angle))) < 2:
        alike = ", all at one angle" if len(valid) > 1 else ""
        raise CloudError(
            f"the cloud has no grid of profiles and lines (found {valid.shape[0]} x {valid.shape[1]}{alike}); take one "
            "that `jaxscan reconstruct` wrote of a rig that moves, or --poisson."
        )
    laser, angle = np.asarray(cloud.laser), np.asarray(cloud.angle, np.float64)
    station = np.zeros_like(laser) if cloud.stations is None else np.asarray(cloud.stations.number)
    profiles, joins, closings = [], [], []
    for place, number in np.unique(np.stack([station, laser], 1), axis=0):
        members = np.flatnonzero((station == place) & (laser == number))
        sheet, joined, closed = _sheet(members[np.argsort(angle[members], kind="stable")], angle, cloud)
        profiles.append(sheet)
        joins.append(np.append(joined, False))
        closings.append(np.append(np.zeros(len(sheet) - 1, np.bool_), closed))
    return Lattice(np.concatenate(profiles), np.concatenate(joins)[:-1], np.concatenate(closings))


def _sheet(members: np.ndarray, angle: np.ndarray, cloud: PointCloud) -> tuple[np.ndarray, np.ndarray, bool]:
    """Columns of a sheet, which of them follow each other, and whether the last one repeats the first."""
    steps = np.diff(angle[members])
    moved = steps[steps > 0]
    if not moved.size:
        return members[:1], np.zeros(0, np.bool_), False
    usual = float(np.median(moved))
    members = members[np.append(True, steps > SMALLEST_GAP * usual)]
    # Of a turn and a bit more, the bit is left out.
    turned = angle[members] - angle[members[0]]
    once = members[turned < 2 * np.pi - SMALLEST_GAP * usual]
    rest = 2 * np.pi - turned[len(once) - 1]
    if len(once) > 2 and rest < WIDEST_GAP * usual and _meets(once, cloud):
        return np.append(once, once[0]), np.append(np.diff(angle[once]) < WIDEST_GAP * usual, True), True
    return members, np.diff(angle[members]) < WIDEST_GAP * usual, False


def _meets(members: np.ndarray, cloud: PointCloud) -> bool:
    """Whether the points of the last profile are beside those of the first; those of a stage never are."""
    some = np.unique(np.linspace(0, len(members) - 2, 64).astype(np.int64))
    usual = [gap for k in some if np.isfinite(gap := _apart(members[k : k + 2], cloud))]
    return bool(usual) and _apart(members[[-1, 0]], cloud) <= WIDEST_CLOSING * float(np.median(usual))


def _apart(pair: np.ndarray, cloud: PointCloud) -> float:
    """Median distance of the points of two profiles on the same lines [m]; infinite where they share none."""
    both = np.asarray(cloud.valid)[pair].all(0)
    if not both.any():
        return np.inf
    step = np.diff(np.asarray(cloud.xyz)[pair][:, both], axis=0)
    return float(np.median(np.linalg.norm(step, axis=-1)))
