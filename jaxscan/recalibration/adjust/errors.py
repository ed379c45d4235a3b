"""Errors of points on walls, learned from their residuals: noise of stripes, roughness, and errors that points share.

Walls are not flat, light comes back from their neighbours, and tables stop beside their angles. Independent noise
averages out over tens of thousands of points; a bow of a wall does not. So the shape of every wall is a random field:
sums of patches of a few sizes, each as high or low as its size's standard deviation says, which is learned from the
residuals. The points of one record on an upright wall are a patch too, which the stop of the table turns about the
axis. With them the least squares is a generalised one, and its covariance is honest.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.leastsq import Arrow, Covariance
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, Linearised, Room


# First roughness of walls [m].
FIRST_WALL_M = 5e-4
# The noise of stripes over the given sigmas lies between these [1].
_QUIETEST, _NOISIEST = 0.3, 5.0
_ROUNDS = 20
# Neighbours that share errors are at most so many profiles and lines apart.
_NEAR_PROFILES, _NEAR_LINES = 3, 3
# A correlation counts if it is so many of its own standard deviations.
_CERTAIN = 2.5


class Noise(NamedTuple):
    """Noise of stripe centres on surfaces: variance = (stripe * given sigma)^2 + (wall / reach)^2."""

    stripe: float
    """Noise of stripes over the given sigmas [1]."""
    wall_m: float
    """Roughness [m]."""

    def sigma(
        self, given_px: Float[np.ndarray, " points"], reach: Float[np.ndarray, " points"]
    ) -> Float[np.ndarray, " points"]:
        """Standard deviations [px], from the given ones and the change of the distance by one pixel [m / px]."""
        return np.hypot(self.stripe * given_px, self.wall_m / reach)


def learn_noise(
    square: Float[np.ndarray, " points"], given_px: Float[np.ndarray, " points"], reach: Float[np.ndarray, " points"]
) -> Noise:
    """Variance components of the noise, by iterated weighted least squares of squared errors [px^2].

    Errors are over the share that the fit left, `reach` is the change of distance by a pixel [m / px].

    Source: Förstner's estimate of variance components.
    """
    shapes = given_px**2, 1.0 / reach**2
    parts = np.array([1.0, FIRST_WALL_M**2])
    low, high = np.array([_QUIETEST**2, 0.0]), np.array([_NOISIEST**2, np.inf])
    for _ in range(_ROUNDS):
        weight = 1.0 / np.maximum(shapes[0] * parts[0] + shapes[1] * parts[1], 1e-12)
        # One after the other, each within its limits: both stay variances.
        before = parts.copy()
        for index in (0, 1):
            mine, rest = shapes[index] * weight, shapes[1 - index] * parts[1 - index]
            # Not by BLAS, whose threads wait for each other longer than the sum takes.
            size = float(np.sum(mine * mine))
            wanted = float(np.sum(mine * (square - rest) * weight)) / size if size > 0 else parts[index]
            parts[index] = np.clip(wanted, low[index], high[index])
        if np.allclose(parts, before, rtol=1e-4, atol=1e-14):
            break
    return Noise(float(np.sqrt(parts[0])), float(np.sqrt(parts[1])))


def shared_by_profiles(whitened: Float[np.ndarray, " points"], grid: Int[np.ndarray, "points 4"]) -> float:
    """Factor by which the variance of a sum over neighbouring profiles exceeds that of independent errors [1]; at least
    1.

    Along the line points are so far apart that their errors are independent. From profile to profile speckle and the
    paint of a wall change little where steps are small. The factor is 1 + 2 sum of r_i r_j / sum of r_i^2 over the
    pairs of neighbours, and 1 where that sum is no more than chance makes it. `grid` is sweep, surface, record, line.
    """
    square = float(whitened @ whitened)
    if square <= 0.0:
        return 1.0
    wall = np.unique(grid[:, :2], axis=0, return_inverse=True)[1].ravel().astype(np.int64)
    place = (grid[:, 2:] - grid[:, 2:].min(0)).astype(np.int64)
    # With room between walls and profiles, so that no pair reaches over two of them.
    length, height = place.max(0) + 1 + np.array([_NEAR_PROFILES, 2 * _NEAR_LINES])
    key = (wall * length + place[:, 0]) * height + place[:, 1]
    order = np.argsort(key)
    products, pairs = 0.0, 0
    for profiles in range(1, _NEAR_PROFILES + 1):
        for lines in range(-_NEAR_LINES, _NEAR_LINES + 1):
            wanted = key + profiles * height + lines
            other = order[np.minimum(np.searchsorted(key[order], wanted), len(key) - 1)]
            there = key[other] == wanted
            products += float(whitened[there] @ whitened[other[there]])
            pairs += int(there.sum())
    chance = np.sqrt(pairs) * square / len(key)
    return 1.0 + 2.0 * products / square if products > _CERTAIN * chance else 1.0


# Sizes of the patches [m]: a corner's light reaches some 0.3 m, a wall bows over metres.
_SIZES = np.array([0.25, 0.5, 1.0, 2.0])
# Patches of one wall at most; in larger halls all patches are larger.
_MOST = 500
# Patches by which the height of a size can be learned at least, less those that the fit takes up.
_FEWEST = 5
# Variances of the heights of all sizes by three kinds of shape. One is of the smallest size, as plaster and light that
# comes back in corners are. The other is a smooth bow, whose patches differ in proportion to their size: it is learned
# from small patches, since a bow over a whole wall looks like an error of the scanner and is hardly left in residuals.
# The third is of the records, whose number follows those of the sizes.
STOPS = len(_SIZES)
_KINDS = np.zeros((STOPS + 1, 3))
_KINDS[:STOPS, 0], _KINDS[:STOPS, 1], _KINDS[STOPS, 2] = _SIZES == _SIZES[0], (_SIZES / _SIZES[-1]) ** 2, 1.0
# Walls whose normals have a larger part than this along the axis hardly see the table turn [1].
_LEVEL = 0.9
# A kind of shape is used if it is this many of its standard deviations.
_SIGNIFICANT = 1.5


class Patches(NamedTuple):
    """The kept points of one surface and the patches that they lie on; leads with the points or the patches."""

    surface: int
    member: Int[np.ndarray, " points"]
    patch: Int[np.ndarray, "sizes points"]
    """The patch of each size that a point lies on, and the one of its record."""
    by_height: Float[np.ndarray, "sizes points"]
    """Whitened residual by the height of each of them [1 / m], and by the stop [1 / rad]."""
    size: Int[np.ndarray, " patches"]


class Wall(NamedTuple):
    """Sums over the patches of one surface at a step."""

    on: Patches
    dense: Float[np.ndarray, "patches dense"]
    """Inner products with the derivatives by the dense unknowns."""
    local: Float[np.ndarray, "patches 3"]
    gram: Float[np.ndarray, "patches patches"]
    residual: Float[np.ndarray, " patches"]


def find_walls(
    room: Room,
    at: Linearised,
    kept: Bool[np.ndarray, " points"],
    stop: Int[np.ndarray, " points"],
    before: Sequence[Wall] = (),
) -> list[Wall]:
    """All walls by the kept points; with the patches of walls before, if any, wherever their points are now."""
    return [_wall(room, at, on) for on in [wall.on for wall in before] or _find_patches(room, at, kept, stop)]


def _find_patches(
    room: Room, at: Linearised, kept: Bool[np.ndarray, " points"], stop: Int[np.ndarray, " points"]
) -> list[Patches]:
    surface, place = np.asarray(room.points.local), np.asarray(at.points.place)
    planes = np.unique(surface[: len(kept)][kept])
    members = [np.flatnonzero(kept & (surface[: len(kept)] == s)) for s in planes]
    extent = [np.prod(np.ptp(place[index], axis=0) + _SIZES[0]) for index in members]
    grown = max(1.0, float(np.sqrt(max(extent, default=0.0) / (_MOST * _SIZES[0] ** 2))))
    weight, unknown = np.asarray(room.point_weight), np.asarray(room.points.angle) < room.counts[2]
    by_height = weight / _some(np.asarray(at.points.reach))
    # A correction that is an unknown is no error.
    by_stop = np.where(unknown, 0.0, weight * np.asarray(at.points.rows.angle) / ANGLE_SCALE)
    found = []
    for s, index in zip(planes, members, strict=True):
        patch, size = _patches(place[index], grown)
        by = np.broadcast_to(by_height[index], patch.shape)
        if not unknown[index].all() and abs(room.places.normal[s][2]) < _LEVEL:
            names, record = np.unique(stop[index], return_inverse=True)
            patch = np.concatenate([patch, len(size) + record.reshape(1, -1)])
            by, size = np.concatenate([by, by_stop[None, index]]), np.append(size, np.full(len(names), STOPS))
        found.append(Patches(int(s), index, patch, by, size))
    return found


def _wall(room: Room, at: Linearised, on: Patches) -> Wall:
    index, patches = on.member, on.patch
    weight, rows, count = np.asarray(room.point_weight)[index], at.points.rows, len(on.size)

    def sums(values: np.ndarray) -> np.ndarray:
        """Inner products with numbers of points for every patch; a point lies on one patch of each size."""
        each = zip(patches, on.by_height, strict=True)
        return sum((np.bincount(patch, by * values, count) for patch, by in each), np.zeros(count))

    scanner, stations, angles = room.counts
    begin = scanner + stations
    # Ends of known lengths have dense unknowns of their own, which no patch reaches: see `form_blocks`.
    dense = np.zeros((count, begin + angles + 6 * len(room.lengths.metres)))
    columns_of = lambda values: np.stack([sums(column) for column in values.T], axis=1)
    dense[:, :scanner] = columns_of(weight[:, None] * rows.scanner[index])
    station = np.asarray(room.points.station)[index]
    for number in range(1, len(room.stations)):
        columns = slice(scanner + 6 * (number - 1), scanner + 6 * number)
        dense[:, columns] = columns_of((weight * (station == number))[:, None] * rows.station[index])
    if angles:
        stops = np.asarray(room.points.angle)[None, index]
        turned = np.where(stops < angles, weight * rows.angle[index], 0.0)
        stops = np.minimum(stops, angles - 1)
        dense[:, begin : begin + angles] = _by_both(patches, on.by_height, stops, turned, (count, angles))
    local = columns_of(weight[:, None] * rows.local[index])
    ends = np.flatnonzero(np.asarray(room.lengths.ends).ravel() == on.surface)
    if len(ends):
        first = begin + angles + 3 * ends[0]
        dense[:, first : first + 3], local = local, np.zeros_like(local)
    residual = sums(weight * rows.value[index])
    gram = _by_both(patches, on.by_height, patches, on.by_height, (count, count))
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
    first: np.ndarray,
    ahead: Float[np.ndarray, "_ points"],
    second: np.ndarray,
    behind: Float[np.ndarray, "_ points"],
    shape: tuple[int, int],
) -> Float[np.ndarray, "first second"]:
    """Sums of products of numbers of points by several numberings of the points each."""
    total = np.zeros(shape[0] * shape[1])
    for one, value in zip(first, ahead, strict=True):
        for other, factor in zip(second, behind, strict=True):
            total += np.bincount(one.astype(np.int64) * shape[1] + other, value * factor, len(total))
    return total.reshape(shape)


def learn_heights(
    walls: list[Wall], covariance: Covariance, stop_sigma: float | None = None
) -> Float[np.ndarray, " sizes"]:
    """Standard deviation of the heights of the patches of each size [m] and of the stops [rad].

    They are learned by the residuals of a plain least squares; that of the stops is as given, if it is.

    The mean squares of the patches' sums are compared with those that independent noise gives, and that one unit of
    each size would add; of both only the part counts that the fit cannot take up.
    """
    count = len(_KINDS)
    found, noise, spread = np.zeros(count), np.zeros(count), np.zeros(count)
    added = np.zeros((count, count))
    for wall in walls:
        away = wall.dense - wall.local @ covariance.coupling[wall.on.surface]
        left = wall.gram - away @ covariance.shared @ away.T
        left = left - wall.local @ covariance.alone[wall.on.surface] @ wall.local.T
        size = np.diag(wall.gram)
        for number in range(count):
            mine = (wall.on.size == number) & (size > 0)
            if not mine.any():
                continue
            found[number] += np.sum(wall.residual[mine] ** 2 / size[mine])
            noise[number] += np.sum(np.diag(left)[mine] / size[mine])
            block = left[np.ix_(mine, mine)]
            spread[number] += 2.0 * np.sum(block**2 / np.outer(size[mine], size[mine]))
            for other in range(count):
                block = left[np.ix_(mine, wall.on.size == other)]
                added[number, other] += np.sum(block**2 / size[mine, None])
    # Where the fit takes up nearly all that a size adds, its sums say nothing.
    weight = np.where(spread >= 2.0 * _FEWEST, 1.0 / np.sqrt(np.maximum(spread, 1.0)), 0.0)
    kinds, more = _KINDS, found - noise
    if stop_sigma is not None:
        kinds, more = kinds[:, :2], more - added[:, STOPS] * stop_sigma**2
    variance = kinds @ _significant(added @ kinds * weight[:, None], more * weight)
    if stop_sigma is not None:
        variance[STOPS] = stop_sigma**2
    return np.sqrt(variance)


def learn_stops(
    correction: Float[np.ndarray, " images"], variance: Float[np.ndarray, " images"], sigma: float
) -> float:
    """Standard deviation of the table's stops by the corrections of images of features [rad]; 0 where they show none.

    They were found with stops of `sigma`. Without that prior each has a variance of its own, beside which the
    corrections scatter by the stops.
    """
    free = 1.0 / np.maximum(1.0 / variance - sigma**-2, 1e-6 * sigma**-2)
    square = (correction * (free / sigma**2 + 1.0)) ** 2
    found, spread = sigma**2, np.inf
    for _ in range(50):
        weight = (found + free) ** -2
        wanted, spread = float(weight @ (square - free) / weight.sum()), float(np.sqrt(2.0 / weight.sum()))
        before, found = found, max(wanted, 0.0)
        if abs(found - before) <= 1e-4 * before:
            break
    return float(np.sqrt(found)) if found > _SIGNIFICANT * spread and len(free) >= _FEWEST else 0.0


def _significant(
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
            # A further kind must explain more than chance would.
            if np.all(value > _SIGNIFICANT * np.sqrt(np.diag(spread))) and left @ left < lowest - 1.0:
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
        left[wall.on.member] -= (wall.on.by_height * likeliest[wall.on.patch]).sum(0)
    return left


def _some(reach: Float[np.ndarray, " points"]) -> Float[np.ndarray, " points"]:
    return np.where(np.abs(reach) < 1e-7, 1e-7, reach)
