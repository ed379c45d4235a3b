"""Walls are not flat, and light comes back from their neighbours: errors that the points of a patch share.

Independent noise averages out over ten thousands of points; a bow of a wall does not. So the shape of every wall is a
random field: sums of patches of a few sizes, each as high or low as its size's standard deviation says, which is
learned from the residuals. With it the least squares is a generalised one, and its covariance is honest.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.leastsq import Arrow, Covariance
from jaxscan.recalibration.adjust.room import Room
from jaxscan.recalibration.adjust.solver import Linearised


# Sizes of the patches [m]: a corner's light reaches some 0.3 m, a wall bows over metres.
_SIZES = np.array([0.25, 0.5, 1.0, 2.0])
# Patches of one wall at most; in larger halls all patches are larger.
_MOST = 500
# Patches by which the height of a size can be learned at least, less those that the fit takes up.
_FEWEST = 5
# Variances of the heights of all sizes by two kinds of shape. One is of the smallest size, as plaster and light that
# comes back in corners are. The other is a smooth bow, whose patches differ in proportion to their size: it is learned
# from small patches, since a bow over a whole wall looks like an error of the scanner and is hardly left in residuals.
_KINDS = np.column_stack([_SIZES == _SIZES[0], (_SIZES / _SIZES[-1]) ** 2])
# A kind of shape is believed from this many of its standard deviations.
_BELIEVED = 1.5


class Patches(NamedTuple):
    """The kept points of one surface and the patches that they lie on; leads with the points or the patches."""

    surface: int
    member: Int[np.ndarray, " points"]
    patch: Int[np.ndarray, "sizes points"]
    """The patch of each size that a point lies on."""
    by_height: Float[np.ndarray, " points"]
    """Whitened residual by the height of any of them [1 / m]."""
    size: Int[np.ndarray, " patches"]
    """Number of its size."""


class Wall(NamedTuple):
    """Sums over the patches of one surface at a step."""

    on: Patches
    dense: Float[np.ndarray, "patches dense"]
    """Inner products with the derivatives by the dense unknowns."""
    local: Float[np.ndarray, "patches 3"]
    gram: Float[np.ndarray, "patches patches"]
    residual: Float[np.ndarray, " patches"]
    """Inner products with the residuals."""


def find_walls(
    room: Room, at: Linearised, kept: Bool[np.ndarray, " points"], before: Sequence[Wall] = ()
) -> list[Wall]:
    """The walls of all planes; with the patches of walls before, if there are any, wherever their points are now."""
    return [_wall(room, at, on) for on in [wall.on for wall in before] or _find_patches(room, at, kept)]


def _find_patches(room: Room, at: Linearised, kept: Bool[np.ndarray, " points"]) -> list[Patches]:
    surface, place = np.asarray(room.points.local), np.asarray(at.points.place)
    planes = [s for s in np.unique(surface[: len(kept)][kept]) if not room.places.sphere[s]]
    members = [np.flatnonzero(kept & (surface[: len(kept)] == s)) for s in planes]
    extent = [np.prod(np.ptp(place[index], axis=0) + _SIZES[0]) for index in members]
    grown = max(1.0, float(np.sqrt(max(extent, default=0.0) / (_MOST * _SIZES[0] ** 2))))
    by_height = np.asarray(room.point_weight) / _some(np.asarray(at.points.reach))
    found = []
    for s, index in zip(planes, members, strict=True):
        patch, size = _patches(place[index], grown)
        found.append(Patches(int(s), index, patch, by_height[index], size))
    return found


def _wall(room: Room, at: Linearised, on: Patches) -> Wall:
    index, by_height, patches = on.member, on.by_height, on.patch
    weight, rows, count = np.asarray(room.point_weight)[index], at.points.rows, len(on.size)

    def sums(values: np.ndarray) -> np.ndarray:
        """Sums of numbers of points over every patch; a point lies on one patch of each size."""
        return sum((np.bincount(patch, values, count) for patch in patches), np.zeros(count))

    scanner, stations, angles = room.counts
    begin = scanner + stations
    # Ends of known lengths have dense unknowns of their own, which no patch reaches: see `form_blocks`.
    dense = np.zeros((count, begin + angles + 6 * len(room.lengths.metres)))
    weighted = by_height * weight
    columns_of = lambda values: np.stack([sums(column) for column in values.T], axis=1)
    dense[:, :scanner] = columns_of(weighted[:, None] * rows.scanner[index])
    station = np.asarray(room.points.station)[index]
    for number in range(1, len(room.stations)):
        columns = slice(scanner + 6 * (number - 1), scanner + 6 * number)
        dense[:, columns] = columns_of((weighted * (station == number))[:, None] * rows.station[index])
    if angles:
        dense[:, begin : begin + angles] = _by_both(
            patches, np.asarray(room.points.angle)[None, index], weighted * rows.angle[index], (count, angles)
        )
    local = columns_of(weighted[:, None] * rows.local[index])
    ends = np.flatnonzero(np.asarray(room.lengths.ends).ravel() == on.surface)
    if len(ends):
        first = begin + angles + 3 * ends[0]
        dense[:, first : first + 3], local = local, np.zeros_like(local)
    residual = sums(weighted * rows.value[index])
    gram = _by_both(patches, patches, by_height**2, (count, count))
    return Wall(on, dense, local, gram, residual)


def _patches(
    place: Float[np.ndarray, "points 2"], grown: float
) -> tuple[Int[np.ndarray, "sizes points"], Int[np.ndarray, " patches"]]:
    """The patch of every point, for each size, numbered through; and the number of the size of every patch."""
    patches, sizes = [], np.zeros(0, int)
    for number, size in enumerate(_SIZES * grown):
        cell = np.floor((place - place.min(0)) / size).astype(np.int64)
        names, patch = np.unique(cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1], return_inverse=True)
        patches.append(patch.ravel() + len(sizes))
        sizes = np.append(sizes, np.full(len(names), number))
    return np.stack(patches), sizes


def _by_both(
    first: np.ndarray, second: np.ndarray, values: Float[np.ndarray, " points"], shape: tuple[int, int]
) -> Float[np.ndarray, "first second"]:
    """Sums of numbers of points by two numberings of the points."""
    total = np.zeros(shape[0] * shape[1])
    for one in first:
        for other in second:
            total += np.bincount(one.astype(np.int64) * shape[1] + other, values, len(total))
    return total.reshape(shape)


def learn_heights(walls: list[Wall], covariance: Covariance) -> Float[np.ndarray, " sizes"]:
    """Standard deviation of the heights of the patches of each size [m], by the residuals of a plain least squares.

    The mean squares of the patches' sums are compared with those that independent noise gives, and that one unit of
    each size would add; of both only the part counts that the fit cannot take up.
    """
    count = len(_SIZES)
    found, noise, spread = np.zeros(count), np.zeros(count), np.zeros(count)
    added = np.zeros((count, count))
    for wall in walls:
        away = wall.dense - wall.local @ covariance.coupling[wall.on.surface]
        left = wall.gram - away @ covariance.shared @ away.T
        left = left - wall.local @ covariance.alone[wall.on.surface] @ wall.local.T
        size = np.diag(wall.gram)
        for number in range(count):
            mine = wall.on.size == number
            found[number] += np.sum(wall.residual[mine] ** 2 / size[mine])
            noise[number] += np.sum(np.diag(left)[mine] / size[mine])
            block = left[np.ix_(mine, mine)]
            spread[number] += 2.0 * np.sum(block**2 / np.outer(size[mine], size[mine]))
            for other in range(count):
                block = left[np.ix_(mine, wall.on.size == other)]
                added[number, other] += np.sum(block**2 / size[mine, None])
    # Where the fit takes up nearly all that a size adds, its sums say nothing.
    weight = np.where(spread >= 2.0 * _FEWEST, 1.0 / np.sqrt(np.maximum(spread, 1.0)), 0.0)
    kinds = _believed(added @ _KINDS * weight[:, None], (found - noise) * weight)
    return np.sqrt(_KINDS @ kinds)


def _believed(
    matrix: Float[np.ndarray, "sizes kinds"], rhs: Float[np.ndarray, " sizes"]
) -> Float[np.ndarray, " kinds"]:
    """The best sum of kinds of which each is larger than chance makes it, by trying all sets."""
    kinds = matrix.shape[1]
    best, lowest = np.zeros(kinds), float(rhs @ rhs)
    for count in range(1, kinds + 1):
        for some in combinations(range(kinds), count):
            own = matrix[:, list(some)]
            if np.linalg.matrix_rank(own) < count:
                continue
            spread = np.linalg.inv(own.T @ own)
            value = spread @ (own.T @ rhs)
            left = rhs - own @ value
            # Another kind must explain more than chance does.
            if np.all(value > _BELIEVED * np.sqrt(np.diag(spread))) and left @ left < lowest - 1.0:
                best, lowest = np.zeros(kinds), float(left @ left)
                best[list(some)] = value
    return best


def with_shape(arrow: Arrow, walls: list[Wall], height: Float[np.ndarray, " sizes"]) -> tuple[Arrow, float]:
    """The normal equations of the generalised least squares, in which patches have heights of their own.

    Returns:
        arrow: J' S^-1 J and J' S^-1 r, with S the covariance of the whitened residuals.
        less: How much less r' S^-1 r is than the sum of squared residuals.
    """
    dense, cross, local, gradient, by_local = map(np.array, arrow)
    less = 0.0
    for wall in walls:
        free = height[wall.on.size] > 0
        if not free.any():
            continue
        size = height[wall.on.size[free]]
        gram = wall.gram[np.ix_(free, free)] * np.outer(size, size) + np.eye(len(size))
        half = np.linalg.solve(np.linalg.cholesky(gram), np.diag(size))
        few, own, residual = half @ wall.dense[free], half @ wall.local[free], half @ wall.residual[free]
        dense -= few.T @ few
        gradient -= few.T @ residual
        cross[wall.on.surface] -= few.T @ own
        local[wall.on.surface] -= own.T @ own
        by_local[wall.on.surface] -= own.T @ residual
        less += float(residual @ residual)
    return Arrow(dense, cross, local, gradient, by_local), less


def beside_shape(
    whitened: Float[np.ndarray, " points"], walls: list[Wall], height: Float[np.ndarray, " sizes"]
) -> Float[np.ndarray, " points"]:
    """Whitened errors less the likeliest shapes of the walls."""
    left = whitened.copy()
    for wall in walls:
        size = height[wall.on.size]
        gram = wall.gram * np.outer(size, size) + np.eye(len(size))
        likeliest = size * np.linalg.solve(gram, size * wall.residual)
        left[wall.on.member] -= wall.on.by_height * likeliest[wall.on.patch].sum(0)
    return left


def _some(reach: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
    return np.where(np.abs(reach) < 1e-7, 1e-7, reach)
