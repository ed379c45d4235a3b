"""Centres of dark round marks in a coloured cloud of a flat wall, from the colours on the cloud's grid.

Each profile's crossings of a mark's outline are found from colour alone. The circle of least squares through these
points of the cloud, in the plane of the wall, gives the mark's centre.
"""

from typing import NamedTuple

import numpy as np
from scipy import ndimage


_DARK = 0.75
"""A point is of a mark if it is darker than this share of its surroundings."""
_MIN_PROFILES = 3
_MIN_EDGES = 6
_STRAY = 7.5
"""Edges farther from the circle than this many times the median of them do not count: five standard deviations."""
_RADIUS_SHARE = (0.6, 1.6)
"""Circles much smaller or larger than most of them are no marks."""


class Edges(NamedTuple):
    """Where profiles cross the outlines of marks."""

    mark: np.ndarray
    """Number of the mark, int [edges]."""
    profile: np.ndarray
    """int [edges]."""
    line: np.ndarray
    """Position between the lines of the profile, float [edges]."""
    gradient: np.ndarray
    """Change of grey per line [DN], positive [edges]."""


class Wall(NamedTuple):
    """The plane of the wall."""

    middle: np.ndarray
    """[3], m."""
    axes: np.ndarray
    """To the right, upwards and towards the scanner, unit rows [3, 3]."""


class Noise(NamedTuple):
    """Random noise of a coloured cloud."""

    along: np.ndarray
    """A standard deviation of each point, as a vector along its ray [profiles, lines, 3], m."""
    shared: np.ndarray
    """Lines of a profile over which it is shared [profiles, lines]."""
    aside: np.ndarray
    """A standard deviation of the place whose colour a point has, from the point: its own in each [profiles, lines, 3],
    m."""
    grey: float
    """Standard deviation of a grey value [DN]."""


class Centres(NamedTuple):
    """Marks that were found."""

    mark: np.ndarray
    """Number of each, as in `Edges` [marks]."""
    place: np.ndarray
    """To the right, upwards and out of the wall [marks, 3], m."""
    radius: np.ndarray
    """[marks], m."""
    sigma: np.ndarray
    """Predicted standard deviation to the right and upwards [marks, 2], m; zero where no noise is given."""


def find_edges(grey: np.ndarray, valid: np.ndarray) -> Edges:
    """Outlines of dark patches.

    Args:
        grey: Grey values [profiles, lines], DN.
        valid: Which points exist.
    """
    share = grey / np.maximum(_surroundings(grey, valid), 1.0)
    dark = valid & (share < _DARK)
    # A patch keeps its missing points and single bright ones.
    label, _ = ndimage.label(ndimage.binary_closing(dark, np.ones((3, 3))))
    found: list[tuple[int, int, float, float]] = []
    for mark, place in enumerate(ndimage.find_objects(label)):
        profiles, lines = place
        tall = lines.stop - lines.start
        inside = profiles.start > 0 and profiles.stop < len(grey) and lines.start > tall / 2
        if not inside or profiles.stop - profiles.start < _MIN_PROFILES or lines.stop + tall / 2 > grey.shape[1]:
            continue
        body = label[place] == mark + 1
        ink = float(np.median(share[place][body & valid[place]]))
        for profile in range(profiles.start, profiles.stop):
            own = np.flatnonzero(body[profile - profiles.start]) + lines.start
            if len(own):
                for line, gradient in _crossings(grey[profile], valid[profile], (own[0], own[-1]), ink):
                    found.append((mark, profile, line, gradient))
    table = np.array(found).reshape(-1, 4)
    return Edges(table[:, 0].astype(int), table[:, 1].astype(int), table[:, 2], table[:, 3])


def fit_wall(xyz: np.ndarray, valid: np.ndarray, up: np.ndarray) -> Wall:
    """The plane through most of a cloud.

    Args:
        xyz: [..., 3], m; the origin is on the scanner's side of the wall.
        valid: Which points exist.
        up: Roughly upwards [3].
    """
    points = xyz[valid]
    points = points[:: max(1, len(points) // 50_000)]
    kept = np.ones(len(points), bool)
    for _ in range(5):
        middle = points[kept].mean(0)
        normal = np.linalg.eigh(np.cov((points[kept] - middle).T))[1][:, 0]
        apart = (points - middle) @ normal
        kept = np.abs(apart) < 4 * 1.4826 * np.median(np.abs(apart)) + 1e-6
    normal = normal * -np.sign(normal @ middle)
    right = np.cross(up, normal)
    right /= np.linalg.norm(right)
    return Wall(middle, np.stack([right, np.cross(normal, right), normal]))


def find_centres(xyz: np.ndarray, valid: np.ndarray, edges: Edges, wall: Wall, noise: Noise | None = None) -> Centres:
    """Circles through the outlines.

    Args:
        xyz: The cloud [profiles, lines, 3], m.
        valid: Which points exist.
        edges: From `find_edges` of the same cloud.
        wall: Its plane.
        noise: For the prediction of the centres' uncertainty.
    """
    low = np.floor(edges.line).astype(int)
    rest = (edges.line - low)[:, None]

    def between(field: np.ndarray) -> np.ndarray:
        return (1 - rest) * field[edges.profile, low] + rest * field[edges.profile, low + 1]

    both = valid[edges.profile, low] & valid[edges.profile, low + 1]
    at = (between(xyz) - wall.middle) @ wall.axes.T
    step = ((xyz[edges.profile, low + 1] - xyz[edges.profile, low]) @ wall.axes.T)[:, :2]
    fits: list[tuple[int, np.ndarray, float, np.ndarray]] = []
    for mark in np.unique(edges.mark):
        own = np.flatnonzero(both & (edges.mark == mark))
        circle = fit_circle(at[own, :2])
        if circle is None:
            continue
        centre, radius, kept = circle
        own = own[kept]
        sigma = np.zeros(2)
        if noise is not None:
            shared = np.maximum(noise.shared[edges.profile[own], low[own]], 1.0)
            # A position between two lines, and the crossing between two grey values, are means of both.
            apart, slope = rest[own, 0] * (1 - rest[own, 0]), edges.gradient[own]
            along = (between(noise.along)[own] @ wall.axes.T)[:, :2] * np.sqrt(1 - 2 * apart / shared)[:, None]
            greys = step[own] * (noise.grey * np.sqrt(1 - 2 * apart) / slope)[:, None]
            aside = (between(noise.aside)[own] @ wall.axes.T)[:, :2] * np.sqrt(1 - 2 * apart)[:, None]
            sigma = _predicted(
                at[own, :2] - centre, (along, greys, aside), (edges.profile[own], edges.line[own]), shared
            )
        fits.append((int(mark), np.append(centre, np.median(at[own, 2])), radius, sigma))
    if not fits:
        return Centres(np.zeros(0, int), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 2)))
    mark, place, radius, sigma = (np.array(part) for part in zip(*fits, strict=True))
    usual = np.median(radius)
    good = (radius > _RADIUS_SHARE[0] * usual) & (radius < _RADIUS_SHARE[1] * usual)
    return Centres(mark[good], place[good], radius[good], sigma[good])


def fit_circle(points: np.ndarray) -> tuple[np.ndarray, float, np.ndarray] | None:
    """The circle with the least squared distances from points [n, 2]: centre, radius, and which points it kept.

    None where the points determine none.
    """
    kept = np.ones(len(points), bool)
    if len(points) < _MIN_EDGES:
        return None
    centre = points.mean(0)
    radius = float(np.sqrt(2) * np.sqrt(np.mean((points - centre) ** 2)))
    for _ in range(8):
        apart = points - centre
        far = np.maximum(np.linalg.norm(apart, axis=1), 1e-9)
        residual = far - radius
        kept = np.abs(residual) < max(_STRAY * float(np.median(np.abs(residual))), 3e-4)
        if kept.sum() < _MIN_EDGES:
            return None
        design = np.column_stack([apart / far[:, None], np.ones(len(points))])[kept]
        change = np.linalg.lstsq(design, residual[kept], rcond=None)[0]
        centre, radius = centre + change[:2], radius + change[2]
    return (centre, float(radius), kept) if radius > 0 else None


def picked_points(xyz: np.ndarray, valid: np.ndarray, wall: Wall, centres: Centres) -> np.ndarray:
    """The point of the cloud nearest to each centre, as by a click [marks, 3], m, axes of the wall; NaN without one."""
    at = (xyz[valid] - wall.middle) @ wall.axes.T
    at = at[np.abs(at[:, 2]) < 0.1]
    order = np.argsort(at[:, 0])
    at = at[order]
    out = np.full((len(centres.place), 3), np.nan)
    for number, place in enumerate(centres.place):
        first, stop = np.searchsorted(at[:, 0], place[0] + np.array([-0.01, 0.01]))
        near = at[first:stop]
        if len(near):
            out[number] = near[np.argmin(np.sum((near[:, :2] - place[:2]) ** 2, axis=1))]
    return out


def pairs(place: np.ndarray, length: float, room: float) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal and vertical pairs of places, about `length` apart.

    Args:
        place: [n, 3], m, axes of the wall.
        length: Nominal distance [m].
        room: Largest departure from it, along and across [m].

    Returns:
        Numbers of both [pairs, 2], and whether they are horizontal, bool [pairs].
    """
    apart = place[None, :, :2] - place[:, None, :2]
    beside = (np.abs(apart[..., 0] - length) < room) & (np.abs(apart[..., 1]) < room)
    above = (np.abs(apart[..., 1] - length) < room) & (np.abs(apart[..., 0]) < room)
    number = np.argwhere(beside | above)
    return number, beside[number[:, 0], number[:, 1]]


def _surroundings(grey: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """The wall's own grey round every point: a median over more than a mark."""
    steps = max(1, grey.shape[0] // 130), max(1, grey.shape[1] // 130)
    small = np.where(valid, grey, np.nan)[:: steps[0], :: steps[1]]
    small = np.where(np.isfinite(small), small, np.nanmedian(small))
    # A mark is a twelfth of its field of the grid: the upper half of a window round it is wall.
    wide = ndimage.percentile_filter(small, 70, size=(15, 15), mode="nearest")
    at = np.minimum(np.arange(grey.shape[0]) // steps[0], len(wide) - 1)
    line = np.minimum(np.arange(grey.shape[1]) // steps[1], wide.shape[1] - 1)
    return wide[np.ix_(at, line)]


def _crossings(grey: np.ndarray, valid: np.ndarray, ends: tuple[int, int], ink: float) -> list[tuple[float, float]]:
    """Where a profile crosses the middle between wall and ink, above and below a mark: line, and gradient."""
    first, last = ends
    reach = max(2, (last - first) // 3)
    out = []
    for start, sense in ((first, -1), (last, 1)):
        beyond = start + sense * np.arange(1 + reach // 2, 2 + 2 * reach)
        beyond = beyond[(beyond >= 0) & (beyond < len(grey))]
        if valid[beyond].sum() < 2:
            continue
        bright = float(np.median(grey[beyond[valid[beyond]]]))
        middle = 0.5 * (1 + ink) * bright
        # From inside the mark outwards, to the first point that is brighter.
        for line in range(start - sense * min(reach, 3), start + sense * (reach + 2), sense):
            after = line + sense
            if not (0 <= after < len(grey) and valid[line] and valid[after]):
                continue
            if grey[line] < middle <= grey[after]:
                share = (middle - grey[line]) / (grey[after] - grey[line])
                out.append((min(line + sense * share, len(grey) - 1.001), float(grey[after] - grey[line])))
                break
    return out


def _predicted(
    apart: np.ndarray, noise: tuple[np.ndarray, ...], grid: tuple[np.ndarray, np.ndarray], shared: np.ndarray
) -> np.ndarray:
    """Standard deviation [2] of a circle's centre from the noise of its points.

    Args:
        apart: Points from the centre [n, 2].
        noise: Displacements by one standard deviation of the points' ranges, shared along a profile, of their grey
            values, and of the places of these [n, 2].
        grid: Profile and line of each point.
        shared: Lines over which the noise of each range is shared.
    """
    normal = apart / np.linalg.norm(apart, axis=1)[:, None]
    factors = np.linalg.pinv(np.column_stack([normal, np.ones(len(normal))]))[:2]
    ranges, greys, aside = (np.sum(normal * part, 1) for part in noise)
    profile, line = grid
    alike = np.clip(1 - np.abs(line[:, None] - line) / np.minimum(shared[:, None], shared), 0, 1) * (
        profile[:, None] == profile
    )
    covariance = alike * np.outer(ranges, ranges) + np.diag(greys**2 + aside**2)
    return np.sqrt(np.diag(factors @ covariance @ factors.T))
