"""Single stripes of flat regions: away from their borders, and so far apart that their noise is independent."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import Scanner, stripe_pixel
from jaxscan.recalibration.adjust import triangulate_points
from jaxscan.recalibration.observed import SurfacePoints, SweepStripes
from jaxscan.recalibration.segment.pieces import Piece


_CORNER_M, _CORNER = 0.2, 0.1
"""Distance from another wall within which points are left out, because light comes back from it and smoothing rounds
[m]; but no more than this share of their own wall's width."""
_NEAR_M = 0.3
"""How far another wall may end from a corner that it makes [m]."""
_CROSSING = 0.94
"""Cosine of the angle below which two planes make a corner."""
_TRIES = 6
_ALL = 16
"""Stripes of a cell up to which all of them may be used, and not one alone."""
_DENSE = 200
"""Profiles of a sweep from which they are dense."""
_RIM, _RIM_SIGMAS, _RIM_M = 4, 3.0, 1e-3
"""Cells beside a region that may belong to it, and their distance from its plane: in standard deviations, and [m]."""
_OUTLIER, _OUTLIER_M = 4.0, 2e-3
"""Standard deviations, and distance beside them [m], from which a stripe does not belong to its wall."""
_LEAST = 30
"""Points of a surface at least."""
_BIN_M = 0.1
"""Size of the squares over which points are spread evenly, at least [m]."""


class Candidates(NamedTuple):
    """Stripes that may be used."""

    points: SurfacePoints
    p: Float[np.ndarray, "points 3"]
    """In the frame of the room [m]."""
    shared: Float[np.ndarray, " points"]
    """Lines over which the noise is shared."""
    profile: Int[np.ndarray, " points"]


class Placed(NamedTuple):
    """A sweep with all that places its points."""

    sweep: SweepStripes
    angle: Float[np.ndarray, " records"]
    """With the corrections [rad]."""
    pose: Float[np.ndarray, "4 4"]
    """T_room_scanner."""


def candidates(
    piece: Piece,
    others: Sequence[Piece],
    bend: tuple[Float[np.ndarray, "cells 3 directions"], Int[np.ndarray, " grid"]],
    placed: Placed,
    scanner: Scanner,
) -> Candidates:
    """Stripes of a piece and its rim.

    Args:
        piece: The flat region.
        others: All pieces of its sweep; corners with them are left out.
        bend: Shifts of valid cells by the likely steps [m], and the number of each cell of the grid among them.
        placed: Its sweep.
        scanner: The calibrated rig.
    """
    sweep = placed.sweep
    cells = piece.cells
    members, shifts = _claimed(piece, others, *bend)
    i, j = np.unravel_index(members, cells.valid.shape)
    i, j = i[:, None] * cells.block[0], j[:, None] * cells.block[1]
    if cells.block[0] * cells.block[1] <= _ALL:
        row, line = (part.ravel() for part in np.mgrid[: cells.block[0], : cells.block[1]])
        row, line = i + row, j + line
    else:
        # The same for the same input.
        rng = np.random.default_rng(0)
        row = i + rng.integers(0, cells.block[0], (len(i), _TRIES))
        line = j + rng.integers(0, cells.block[1], (len(i), _TRIES))
    inside = (row < len(cells.profiles)) & (line < len(cells.lines))
    profile = cells.profiles[np.minimum(row, len(cells.profiles) - 1)]
    line = cells.lines[np.minimum(line, len(cells.lines) - 1)]
    good = inside & sweep.valid[profile, line] & (sweep.sigma[profile, line] > 0)
    if cells.block[0] * cells.block[1] > _ALL:
        good &= np.arange(_TRIES) == good.argmax(1)[:, None]
    kept, _ = np.nonzero(good)
    profile, line, shifts = profile[good], line[good], shifts[kept]
    record = sweep.record[profile]
    q = np.asarray(
        stripe_pixel(sweep.centre[profile, line].astype(np.float64), line.astype(np.float64), sweep.stripe_axis)
    )
    laser = sweep.laser[profile]
    p, exists = triangulate_points(scanner, q, laser, placed.angle[record])
    sigma = sweep.sigma[profile, line].astype(np.float64)
    noise = np.abs(cells.slope.reshape(-1, 3)[members[kept]] @ piece.plane.normal) * sigma
    error = piece.plane.error(p, shifts)
    good = exists & (np.abs(error) < _OUTLIER * np.maximum(noise, 1.5 * np.median(noise)) + _OUTLIER_M)
    good &= ~_at_corners(piece, others, p)
    points = SurfacePoints(q, sigma, np.full(len(q), piece.sweep), record, line, laser, np.zeros(len(q), int))
    at = p @ placed.pose[:3, :3].T + placed.pose[:3, 3]
    shared = np.maximum(sweep.shared_lines[profile, line].astype(np.float64), 1.0)
    return Candidates(points.take(good), at[good], shared[good], profile[good])


def choose(found: Candidates, most: int) -> Int[np.ndarray, " chosen"]:
    """At most so many of the candidates: balanced over surfaces, even over their area, independent in their noise.

    Args:
        found: Candidates of all surfaces, numbered by `found.points.surface`.
        most: Number of points at most.
    """
    surface = found.points.surface
    independent = np.flatnonzero(far_apart(found.points.sweep, found.profile, found.points.line, found.shared))
    independent = np.random.default_rng(1).permutation(independent)
    rank = _rank(found.p[independent], surface[independent])
    names, counts = np.unique(surface[independent], return_counts=True)
    areas = np.array([len(np.unique(_squares(found.p[independent][surface[independent] == k]))) for k in names])
    share = _shares(np.sqrt(areas.astype(float)), counts, most)
    chosen = []
    for name, number in zip(names, share, strict=True):
        own = independent[surface[independent] == name]
        own = own[np.argsort(rank[surface[independent] == name], kind="stable")]
        if len(own) >= _LEAST:
            chosen.append(own[:number])
    return np.sort(np.concatenate(chosen)) if chosen else np.zeros(0, int)


def _claimed(
    piece: Piece,
    others: Sequence[Piece],
    bend: Float[np.ndarray, "cells 3 directions"],
    place: Int[np.ndarray, " grid"],
) -> tuple[Int[np.ndarray, " members"], Float[np.ndarray, "members 3 directions"]]:
    """Cells of a region that are surely its own, and their shifts by the likely steps.

    Where profiles are dense, these are the inner ones: a curved wall may begin at the border. Where they are few,
    neighbourhoods are full only well inside a wall, so cells beside the region that lie on its plane count too.
    """
    mask = np.zeros(piece.cells.valid.shape, bool)
    mask.ravel()[piece.region.cells] = True
    mask = _inner(mask) if len(mask) >= _DENSE else _with_rim(mask, piece, others, (bend, place))
    members = np.flatnonzero(mask.ravel())
    return members, bend[place[members]]


def _inner(mask: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Cells whose eight neighbours belong to the region too; the grid's own ends are no borders."""
    wide = np.pad(mask, 1, mode="edge")
    rows, columns = mask.shape
    return np.logical_and.reduce([wide[i : i + rows, j : j + columns] for i in range(3) for j in range(3)])


def _with_rim(
    mask: Bool[np.ndarray, "rows columns"],
    piece: Piece,
    others: Sequence[Piece],
    shifts: tuple[Float[np.ndarray, "cells 3 directions"], Int[np.ndarray, " grid"]],
) -> Bool[np.ndarray, "rows columns"]:
    """A region and the cells beside it that lie on its plane and belong to no other."""
    cells, (bend, place) = piece.cells, shifts
    mask, taken = mask.copy(), np.zeros_like(mask)
    for other in others:
        if other.cells is cells and other is not piece:
            taken.ravel()[other.region.cells] = True
    noise = cells.across(piece.plane.normal).ravel()
    typical = float(np.median(noise[piece.region.cells]))
    for _ in range(_RIM):
        wide = np.pad(mask, 1)
        beside = wide[2:, 1:-1] | wide[:-2, 1:-1] | wide[1:-1, 2:] | wide[1:-1, :-2]
        new = np.flatnonzero((beside & ~mask & cells.valid & ~taken).ravel())
        error = np.abs(piece.plane.error(cells.p.reshape(-1, 3)[new], bend[place[new]]))
        mask.ravel()[new[error < _RIM_SIGMAS * np.maximum(noise[new], typical) + _RIM_M]] = True
    return mask


def _at_corners(piece: Piece, others: Sequence[Piece], p: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, " points"]:
    near = np.zeros(len(p), bool)
    width = np.ptp((piece.points - piece.centre) @ piece.axes.T, axis=0).max()
    margin = min(_CORNER_M, _CORNER * float(width))
    for other in others:
        plane = other.plane
        if abs(plane.normal @ piece.plane.normal) > _CROSSING:
            continue
        along = (p - plane.centre) @ plane.axes.T
        reach = (other.points - other.centre) @ other.axes.T
        beside = (along > reach.min(0) - _NEAR_M) & (along < reach.max(0) + _NEAR_M)
        near |= (np.abs(p @ plane.normal - plane.distance) < margin) & beside.all(1)
    return near


def _squares(p: np.ndarray) -> Int[np.ndarray, " points"]:
    """Number of the cube that each point lies in; on a plane they are about squares."""
    at = np.floor(p / _BIN_M).astype(np.int64)
    at -= at.min(0)
    size = at.max(0) + 1
    return (at[:, 0] * size[1] + at[:, 1]) * size[2] + at[:, 2]


def _rank(p: np.ndarray, surface: np.ndarray) -> Int[np.ndarray, " points"]:
    """How many points of the same square of the same surface come before each."""
    square = _squares(p)
    key = surface.astype(np.int64) * (square.max(initial=0) + 1) + square
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    starts = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1])) if len(key) else np.zeros(0, int)
    lengths = np.diff(np.append(starts, len(key)))
    rank = np.empty(len(key), int)
    rank[order] = np.arange(len(key)) - np.repeat(starts, lengths)
    return rank


def _shares(wish: np.ndarray, most: np.ndarray, total: int) -> Int[np.ndarray, " surfaces"]:
    """Numbers in the proportion of a wish, none above its own most, at most `total` together."""
    share = np.zeros(len(wish))
    open_ = np.ones(len(wish), bool)
    while open_.any():
        left = total - share[~open_].sum()
        share[open_] = left * wish[open_] / wish[open_].sum()
        over = open_ & (share >= most)
        if not over.any():
            break
        share[over] = most[over]
        open_ &= ~over
    return np.floor(share + 1e-9).astype(int)


def far_apart(
    sweep: Int[np.ndarray, " points"],
    profile: Int[np.ndarray, " points"],
    line: Int[np.ndarray, " points"],
    shared: Float[np.ndarray, " points"],
) -> Bool[np.ndarray, " points"]:
    """Points of which no two of one profile are nearer than the lines over which their noise is shared."""
    # Every line in turn, all profiles at once.
    _, own = np.unique(np.stack([sweep, profile]), axis=1, return_inverse=True)
    own = own.reshape(-1)
    last, reach = np.full(own.max(initial=-1) + 1, -np.inf), np.zeros(own.max(initial=-1) + 1)
    kept = np.zeros(len(line), bool)
    order = np.argsort(line, kind="stable")
    for here in np.split(order, np.flatnonzero(np.diff(line[order])) + 1):
        free = line[here] - last[own[here]] >= np.maximum(shared[here], reach[own[here]])
        here = here[free]
        kept[here], last[own[here]], reach[own[here]] = True, line[here], shared[here]
    return kept
