"""Straight lines among all candidates of a stripe on a board: the stripe itself, and lines that look like it."""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry import StripeAxis, stripe_pixel
from jaxscan.observation.board_map import BoardMap
from jaxscan.observation.stripes_on_board import FoundStripe
from jaxscan.stripes import ChunkStripes


# Distance across the image's lines [px] within which a candidate votes for a line; the error of the map from pixels
# to the board adds to it.
_TOLERANCE_PX = 3.0
_MAP_ERRORS = 3.0
# Lines through two candidates that are tried, and candidates that vote.
_TRIALS = 200
_VOTERS = 400
# Lines that are kept of those that are looked for: the print makes some, too.
_MAX_LINES = 3
_MAX_FOUND = 20
# A line has this many points at least, this share of those of the longest one, and more than scattered candidates
# give by so many standard deviations.
_MIN_POINTS = 8
_MIN_SHARE = 0.2
_BY_CHANCE = 8.0
# Share of the image's lines between its ends on which it has a point.
_MIN_DENSITY = 0.25
# A line that keeps so close to one edge or middle of squares [px] with this share of its points is print.
_EDGE_PX = 1.5
_EDGE_SHARE = 0.9
# From so many points on a line may bend: boards and sheets are not quite flat.
_BENDING_POINTS = 30
_ROUNDS = 4


class Candidates(NamedTuple):
    """All places in one image where the stripe of one laser may be, k on every line."""

    u: np.ndarray
    """Centre across the line [k, lines], px."""
    sigma: np.ndarray
    """Standard deviation of `u` [k, lines], px."""
    width: np.ndarray
    """Standard deviation of the profile [k, lines], px."""
    valid: np.ndarray
    """bool [k, lines]."""
    chosen: np.ndarray
    """Number of the candidate on the best path over the lines [lines]; -1 for none."""
    stripe_axis: StripeAxis = "rows"
    """Whether a line is an image row or an image column."""

    @staticmethod
    def of(found: ChunkStripes, record: int, stripe_axis: StripeAxis) -> "Candidates":
        """The candidates of one record, from a chunk that was extracted with all candidates."""
        chosen = np.asarray(found.chosen)
        stripes = found.stripes
        fields = [np.asarray(field) for field in (stripes.u, stripes.sigma, stripes.width, stripes.valid)]
        u, sigma, width, valid = (field.reshape(len(chosen), -1, chosen.shape[1])[record] for field in fields)
        return Candidates(u, sigma, width, valid, chosen[record], stripe_axis)

    def pixels(self) -> np.ndarray:
        """float64 [k, lines, 2]: (u, v) [px]; at 0 of its line where not valid."""
        lines = np.broadcast_to(np.arange(self.u.shape[1], dtype=np.float64), self.u.shape)
        centre = np.where(self.valid, self.u, 0.0).astype(np.float64)
        return np.asarray(stripe_pixel(centre, lines, self.stripe_axis))

    def taken(self, number: np.ndarray) -> FoundStripe:
        """One candidate of every line, by its number [lines]; none where that is -1."""
        at = np.maximum(number, 0).astype(np.intp), np.arange(len(number))
        fields = (self.u, self.sigma, self.width, self.valid)
        u, sigma, width, valid = (np.where(number >= 0, field[at], field.dtype.type(0)) for field in fields)
        return FoundStripe(u, sigma, width, valid, self.stripe_axis)


def find_lines(
    found: Candidates, xy: np.ndarray, usable: np.ndarray, view: BoardMap, *, print_shows: bool
) -> list[np.ndarray]:
    """Straight lines on the board among the candidates, that of the best path first.

    On a flat board the stripe of a flat sheet is straight, and the map from pixels to the board, fitted to
    its corners, takes out the lens. Reflections, other lamps and the board's edge give lines too, and no
    single view tells which one is the laser's.

    Args:
        found: All candidates of one image.
        xy: Their board coordinates [k, lines, 2], m.
        usable: Those that count [k, lines].
        view: The map from this image to the board.
        print_shows: The print was not taken off by a laser-off image, so lines along it are dropped.

    Returns:
        Up to three lines, each as the number of its candidate on every line of the image [lines], -1 for
        none.

    Source: M. A. Fischler, R. C. Bolles, Random sample consensus, Communications of the ACM 24, 1981.
    """
    number, line = np.nonzero(usable)
    across = 0 if found.stripe_axis == "rows" else 1
    xy, slope = xy[number, line], view.by_pixel(found.pixels()[number, line])[:, across]
    error = view.error_px()
    tolerance = _TOLERANCE_PX + _MAP_ERRORS * error
    chance = 2.0 * tolerance / max(float(np.ptp(view.seen[:, across])), 1.0)
    random, free = np.random.default_rng(0), np.ones(len(xy), bool)
    lines: list[np.ndarray] = []
    for _ in range(_MAX_FOUND):
        distance = _best_line(xy[free], slope[free], tolerance, random)
        if distance is None or len(lines) == _MAX_LINES:
            break
        expected = chance * free.sum()
        near = np.full(len(xy), np.inf)
        near[free] = np.abs(distance)
        least = max(_MIN_SHARE * max(map(_count, lines), default=0), expected + _BY_CHANCE * np.sqrt(expected))
        own = near <= tolerance
        if own.sum() < max(_MIN_POINTS, least):
            break
        dense = len(np.unique(line[own])) > _MIN_DENSITY * np.ptp(line[own])
        if dense and not (print_shows and _is_printed(xy[own], slope[own], view, _EDGE_PX + _MAP_ERRORS * error)):
            lines.append(_nearest(near, number, line, tolerance, found.u.shape[1]))
        free &= near > 2.0 * tolerance
    on_path = lambda taken: int(((taken >= 0) & (taken == found.chosen)).sum())
    return sorted(lines, key=on_path, reverse=True)


def _is_printed(xy: np.ndarray, slope: np.ndarray, view: BoardMap, reach: float) -> bool:
    """Whether points [n, 2] follow one edge or middle of the printed squares; a laser's line crosses them aslant."""
    half, start = 0.5 * view.board.square, view.board.corners()[0, :2]
    nearest = start + half * np.round((np.median(xy, axis=0) - start) / half)
    return bool((np.abs(xy - nearest) <= reach * np.abs(slope)).mean(0).max() >= _EDGE_SHARE)


def _count(taken: np.ndarray) -> int:
    return int((taken >= 0).sum())


def _nearest(distance: np.ndarray, number: np.ndarray, line: np.ndarray, tolerance: float, lines: int) -> np.ndarray:
    """The nearest of the candidates within the tolerance, on every line of the image."""
    taken = np.full(lines, -1, np.int8)
    # The nearest is written last.
    order = np.argsort(-distance, kind="stable")
    order = order[distance[order] <= tolerance]
    taken[line[order]] = number[order]
    return taken


def _best_line(xy: np.ndarray, slope: np.ndarray, tolerance: float, random: np.random.Generator) -> np.ndarray | None:
    """Distances across [n], px, from the line that most points [n, 2] vote for; None where there are too few.

    Args:
        xy: Points on the board [n, 2], m.
        slope: Their derivatives by the pixel across the image's lines [n, 2], m per px.
        tolerance: Distance within which a point votes [px].
        random: Draws the lines that are tried.
    """
    if len(xy) < _MIN_POINTS:
        return None
    first, second = random.integers(0, len(xy), (2, _TRIALS))
    along = xy[second] - xy[first]
    first, along = first[np.any(along != 0, axis=1)], along[np.any(along != 0, axis=1)]
    if len(along) == 0:
        return None
    normal = along[:, ::-1] * np.array([1.0, -1.0]) / np.linalg.norm(along, axis=1)[:, None]
    voters = np.unique(np.linspace(0, len(xy) - 1, _VOTERS).astype(np.intp))
    offset = xy[voters] @ normal.T - np.sum(xy[first] * normal, axis=1)
    share = np.square(offset / _along(slope[voters], normal.T) / tolerance)
    best = int(np.argmax(np.maximum(1.0 - share, 0.0).sum(0)))
    middle, normal = xy[first[best]], normal[best]
    distance = (xy - middle) @ normal / _along(slope, normal)
    for _ in range(_ROUNDS):
        near = np.abs(distance) <= tolerance
        if near.sum() < 3:
            break
        place = (xy - middle) @ np.array([-normal[1], normal[0]])
        reach = max(float(np.abs(place[near]).max()), 1e-12)
        place = place / reach
        terms = np.column_stack([np.ones_like(place), place, np.minimum(place**2, 1.0)])
        # A bend is known where the points are; beyond them the line goes on straight.
        terms = terms[:, : 3 if near.sum() >= _BENDING_POINTS else 2]
        curve = terms @ np.linalg.lstsq(terms[near], ((xy - middle) @ normal)[near], rcond=None)[0]
        distance = ((xy - middle) @ normal - curve) / _along(slope, normal)
    return distance


def _along(slope: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """How far a point moves along `normal` for one pixel across [..., m per px]; never 0."""
    moved = slope @ normal
    return np.where(np.abs(moved) < 1e-12, 1e-12, moved)
