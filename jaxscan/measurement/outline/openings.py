"""What is in the walls: openings that rays go through or that send nothing back, and panels that stand out.

Every ray meets the wall's plane somewhere. Drawn there, the cloud's grid shows what the ray found at each place of the
wall: the wall, something behind it, something just before it, or nothing. Furniture hides what is behind it.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from jaxscan.geometry import Scanner
from jaxscan.measurement.grid import Quads, quads_of, rasterise
from jaxscan.measurement.outline.corners import Estimate, Surface
from jaxscan.measurement.outline.outline import RoomOutline, Side
from jaxscan.measurement.samples import Cloud, camera_centres


PIXEL_M = 0.02
OFF_M = 0.02
"""Things this far off a wall, beside 4 sigma, are not the wall [m]: skirtings and frames are nearer."""
PANEL_M = 0.1
"""Things before a wall by more than this are furniture [m]."""
SMALLEST_M = 0.4
"""Smallest width and height of an opening [m]."""
FILLED = 0.7
"""Share of its rectangle that an opening fills."""
ON_FLOOR_M = 0.15
"""An opening that begins lower than this begins on the floor [m]."""
DOOR_M = (1.8, 0.55, 1.6)
"""Smallest height, and smallest and largest width, of a door [m]."""
WIDEST = 0.9
"""Share of a wall above which nothing is an opening in it."""

WIDEST_GAP_M = 0.5
"""Neighbouring rays farther apart than this on a wall leave a gap [m]."""
WALL, BEYOND, PANEL, SHADOW, EMPTY, UNSEEN = range(6)
"""What a ray found at a place of a wall: the wall, something behind, just before, or far before it; nothing between
others; or no ray was there."""

Kind = Literal["door", "window", "opening", "panel"]


@dataclass(frozen=True)
class Opening:
    """A rectangle in a wall, in the frame of the plan."""

    side: str
    kind: Kind
    """"door": on the floor and as high as one; "window": through the wall, or without any return, above the floor;
    "opening": on the floor, and no door; "panel": flat before the wall: a window, a picture or a board."""
    depth_m: float | None
    """How far behind the wall, or before it where negative, rays ended (median); None where none came back."""
    left: Estimate
    """Place from the wall's first corner on, as the outline goes [m]."""
    right: Estimate
    bottom: Estimate
    """Above the floor [m]."""
    top: Estimate

    @property
    def width(self) -> Estimate:
        """[m]"""
        return difference(self.right, self.left)

    @property
    def height(self) -> Estimate:
        """[m]"""
        return difference(self.top, self.bottom)


def find_openings(cloud: Cloud, room: RoomOutline, *, scanner: Scanner | None = None) -> list[list[list[Opening]]]:
    """What is in each wall of an outline: openings of each side of each loop, from its first corner on.

    Ends lie between the last ray that found the wall and the first that did not; the random part of their sigma is that
    of an even distribution there. The systematic part is that of the wall's length, in proportion: a wall that is found
    too long is too long everywhere. The scanner says where the camera was; without it at the origin of its station.

    Raises:
        MeasurementError: If the cloud has no grid.
    """
    rays = _rays(cloud, room, scanner)
    corners, top = room.corners(), _top(room)
    found = [
        [
            _in_wall(rays, side, at[i].at, at[(i + 1) % len(at)].at, top.value) if side.seen else []
            for i, side in enumerate(loop)
        ]
        for loop, at in zip(room.loops, corners, strict=True)
    ]
    return [
        [[_with_errors_of(one, length, top) for one in side] for side, length in zip(loop, lengths, strict=True)]
        for loop, lengths in zip(found, room.lengths(), strict=True)
    ]


def _with_errors_of(opening: Opening, length: Estimate | None, top: Estimate) -> Opening:
    """The opening with the systematic part of the wall's length and height, in proportion."""
    left, right = (_scaled(end, length) for end in (opening.left, opening.right))
    bottom, upper = (_scaled(end, top) for end in (opening.bottom, opening.top))
    return replace(opening, left=left, right=right, bottom=bottom, top=upper)


def _scaled(end: Estimate, of: Estimate | None) -> Estimate:
    if of is None:
        return end
    systematic = abs(end.value / of.value) * of.sigma_systematic
    return Estimate(end.value, float(np.hypot(end.sigma_random, systematic)), end.sigma_random, systematic)


class _Rays(NamedTuple):
    """Rays of the cells, flat [cells, …], in the plan."""

    quads: Quads
    p: np.ndarray
    eye: np.ndarray
    sigma: np.ndarray


def _rays(cloud: Cloud, room: RoomOutline, scanner: Scanner | None) -> _Rays:
    eye = room.frame.of(camera_centres(cloud, scanner))
    xyz, sigma = np.asarray(cloud.xyz, np.float64), np.asarray(cloud.sigma_random, np.float64)
    cells = xyz.reshape(-1, 3)
    return _Rays(quads_of(cloud), room.frame.of(cells), np.repeat(eye, xyz.shape[1], 0), sigma.ravel())


def _top(room: RoomOutline) -> Estimate:
    """The height of the walls, or of the highest point where there is no ceiling [m]."""
    return room.height() or Estimate(float(room.samples.p[:, 2].max()), 0.0, 0.0, 0.0)


class _Face(NamedTuple):
    """What rays found at each place of a wall [rows from the floor up, columns], and where they met its plane."""

    state: np.ndarray
    cell: np.ndarray
    place: np.ndarray
    """Place of each cell along the wall and above the floor [cells, 2], m."""
    depth: np.ndarray
    spacing: np.ndarray
    """Distance of neighbouring rays along both [2], m."""

    def span(self, axis: int) -> float:
        """Length or height of the wall [m]."""
        return self.state.shape[1 - axis] * PIXEL_M


def _in_wall(rays: _Rays, side: Side, start: np.ndarray, end: np.ndarray, top: float) -> list[Opening]:
    face = _face(rays, side.surface, start, end, top)
    if face is None:
        return []
    through = (face.state == BEYOND) | (face.state == EMPTY)
    found = [*_boxes(through, face, False), *_boxes(face.state == PANEL, face, True)]
    made = [_opening(side.name, face, mask, box, is_panel) for mask, box, is_panel in found]
    return sorted(made, key=lambda each: each.left.value)


def _face(rays: _Rays, surface: Surface, start: np.ndarray, end: np.ndarray, top: float) -> _Face | None:
    plane = surface.plane
    length = float(np.linalg.norm((end - start)[:2]))
    along = (end - start) / np.linalg.norm(end - start)
    way = rays.p - rays.eye
    slope = way @ plane.normal
    towards = slope > 0.05 * np.linalg.norm(way, axis=1)
    reach = (plane.distance - rays.eye @ plane.normal) / np.where(towards, slope, 1.0)
    met = rays.eye + reach[:, None] * way
    place = np.stack([(met - start) @ along, met[:, 2]], 1)
    corners = place[rays.quads.corners]
    size = np.ptp(corners, axis=1)
    whole = towards[rays.quads.corners].all(1) & (size < WIDEST_GAP_M).all(1)
    on = whole & ((corners > 0).all(1) & (corners < [length, top]).all(1)).all(1)
    if not on.any():
        return None
    quads = Quads(rays.quads.corners[whole])
    # A metre more above and below: if rays meet the plane there too, gaps between were within the field of view.
    beyond = round(1.0 / PIXEL_M)
    shape = (max(1, round(top / PIXEL_M)) + 2 * beyond, max(1, round(length / PIXEL_M)))
    raster = rasterise(quads, place / PIXEL_M - 0.5 + [0, beyond], shape)
    cell = raster.nearest(quads)
    depth = rays.p @ plane.normal - plane.distance
    off = np.maximum(OFF_M, 4.0 * rays.sigma)
    states = np.select([depth >= off, depth > -off, depth > -PANEL_M], [BEYOND, WALL, PANEL], SHADOW)
    state = np.where(cell >= 0, states[np.maximum(cell, 0)], UNSEEN)
    above = np.maximum.accumulate((cell >= 0)[::-1], 0)[::-1]
    below = np.maximum.accumulate(cell >= 0, 0)
    # Between rays that are too far apart there may be anything, though both came back.
    wide = Quads(rays.quads.corners[towards[rays.quads.corners].all(1) & ~whole])
    between = rasterise(wide, place / PIXEL_M - 0.5 + [0, beyond], shape).nearest(wide) >= 0
    state = np.where((cell < 0) & ~between & above & below, EMPTY, state)
    inner = slice(beyond, shape[0] - beyond)
    # Things that stand out are placed at their points, not where their rays would have met the wall.
    foot = np.stack([(rays.p - start) @ along, rays.p[:, 2]], 1)
    place = np.where((states == PANEL)[:, None], foot, place)
    return _Face(state[inner], cell[inner], place, depth, np.median(size[on], axis=0))


def _boxes(mask: np.ndarray, face: _Face, is_panel: bool) -> list[tuple[np.ndarray, tuple[slice, slice], bool]]:
    """Rectangles of a mask, with its pixels that belong to them."""
    # Imported here, so that `import jaxscan` does not load SciPy.
    from scipy import ndimage  # type: ignore[import-untyped]

    whole = ndimage.binary_opening(ndimage.binary_closing(np.pad(mask, 3), iterations=3)[3:-3, 3:-3], np.ones((5, 5)))
    labels, _ = ndimage.label(whole)
    found = []
    for number, box in enumerate(ndimage.find_objects(labels), 1):
        mine = labels == number
        size = np.array([box[1].stop - box[1].start, box[0].stop - box[0].start]) * PIXEL_M
        filled = mine[box].mean()
        if (size >= SMALLEST_M).all() and filled >= FILLED and size[0] < WIDEST * face.span(0):
            found.append((mine & mask, box, is_panel))
    return found


def _opening(side: str, face: _Face, mask: np.ndarray, box: tuple[slice, slice], is_panel: bool) -> Opening:
    left, right = (_end(face, mask, box, 0, sign) for sign in (-1, 1))
    bottom, top = (_end(face, mask, box, 1, sign) for sign in (-1, 1))
    cells = face.cell[mask & (face.cell >= 0)]
    # Where no wall was seen below, an opening begins on the floor: the root mean square of its interval about 0.
    if bottom.value - np.sqrt(3.0) * bottom.sigma < PIXEL_M and bottom.value < ON_FLOOR_M:
        sigma = float(np.hypot(bottom.value, bottom.sigma))
        bottom = Estimate(0.0, sigma, sigma, 0.0)
    depth = float(np.median(face.depth[cells])) if len(cells) > 0.5 * mask.sum() else None
    width, height = right.value - left.value, top.value - bottom.value
    on_floor = bottom.value < ON_FLOOR_M
    kind: Kind = "panel" if is_panel else "opening" if on_floor else "window"
    if on_floor and height >= DOOR_M[0] and DOOR_M[1] <= width <= DOOR_M[2]:
        kind = "door"
    return Opening(side, kind, depth, left, right, bottom, top)


def _end(face: _Face, mask: np.ndarray, box: tuple[slice, slice], axis: int, sign: int) -> Estimate:
    """One end of a rectangle, along the wall (axis 0) or upwards (1)."""
    # Rows of these arrays are lines of pixels across the end, which is to the right.
    state, cell, inside = ((each if axis == 0 else each.T)[:, ::sign] for each in (face.state, face.cell, mask))
    across = box[axis]
    inset = (across.stop - across.start) // 8
    limit = face.span(axis) if sign > 0 else 0.0
    ends = []
    for row in range(across.start + inset, across.stop - inset):
        last = np.flatnonzero(inside[row])
        if not len(last):
            continue
        wall = np.flatnonzero(state[row, last[-1] + 1 :] == WALL)
        places = face.place[cell[row, last[-1] + 1 + wall], axis]
        outer = places[0] if len(wall) else limit
        within = cell[row, last[-1]]
        # Where nothing came back, the next ray was as far from the last one as that from the one before.
        spaces = np.abs(places - outer)
        spaces = spaces[spaces > 0.3 * face.spacing[axis]]
        space = spaces[0] if len(spaces) else face.spacing[axis]
        inner = face.place[within, axis] if within >= 0 else outer - sign * space
        ends.append((inner, outer))
    inner, outer = np.median(np.array(ends), axis=0)
    sigma = float(abs(outer - inner) / np.sqrt(12.0))
    return Estimate(float(0.5 * (inner + outer)), sigma, sigma, 0.0)


def difference(second: Estimate, first: Estimate) -> Estimate:
    """Distance between two places along a wall: systematic parts have one cause and add up, random parts are
    independent."""
    random = float(np.hypot(first.sigma_random, second.sigma_random))
    systematic = abs(second.sigma_systematic - first.sigma_systematic)
    return Estimate(second.value - first.value, float(np.hypot(random, systematic)), random, systematic)
