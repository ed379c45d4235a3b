"""Where the stripe of a given depth lies in the image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner


# Half the opening over which a stripe is looked for: 72 degrees to either side of the optical axis.
_WIDEST_TANGENT = 3.0
_SAMPLES = 512
_NEARBY = 1.001


class Lit(NamedTuple):
    """The stripe on a plane z = `depth`, once for each line of the image that it crosses.

    Lines are rows of the image, or its columns if the stripe spans more of them than of rows.
    """

    depth: float
    """z in the camera frame [m]."""
    q: Float[np.ndarray, "lines 2"]
    """(u, v) [px] by ascending line; empty where that depth is nowhere in the image."""
    along: Float[np.ndarray, " lines"]
    """Where each lies along the stripe, counted from beside the optical axis [m]."""
    per_pixel: float
    """Change of the depth over one pixel [m / px]."""

    def middle(self) -> Float[np.ndarray, "2"]:
        """Pixel of the point nearest the optical axis."""
        return self.q[np.argmin(np.abs(self.along))]


def lit_lines(scanner: Scanner, laser: int, depths: Sequence[float]) -> list[Lit]:
    """The stripe of one sheet on planes at several depths [m]; no depths, no stripes."""
    if not len(depths):
        return []
    size = np.array([scanner.camera.width, scanner.camera.height])
    tangents = np.linspace(-_WIDEST_TANGENT, _WIDEST_TANGENT, _SAMPLES)
    every = np.array([near * depth for depth in depths for near in (1.0, _NEARBY)])
    along = np.repeat(depths, 2)[:, None] * tangents
    q, seen = _stripe(scanner, laser, np.repeat(every, _SAMPLES), along.ravel())
    q, seen = q.reshape(len(depths), 2, _SAMPLES, 2), np.all(seen.reshape(len(depths), 2, _SAMPLES), axis=1)
    found = []
    for number, depth in enumerate(depths):
        at, shift = _at_lines(q[number, 0], seen[number], along[2 * number], q[number, 1], size)
        found.append((depth, at, (_NEARBY - 1.0) * depth / shift))
    # Interpolated to a tenth of a line; the pixels there are computed exactly.
    count = [len(at) for _, at, _ in found]
    q, seen = _stripe(scanner, laser, np.repeat(depths, count), np.concatenate([at for _, at, _ in found]))
    kept = seen & ((q >= -0.5) & (q <= size - 0.5)).all(-1)
    ends = np.cumsum(count)
    parts = [slice(end - size, end) for end, size in zip(ends, count, strict=True)]
    return [
        Lit(depth, q[part][kept[part]], at[kept[part]], float(worth))
        for (depth, at, worth), part in zip(found, parts, strict=True)
    ]


def _at_lines(
    q: np.ndarray, seen: np.ndarray, along: np.ndarray, q_nearby: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, float]:
    """Where along a sampled stripe the lines of the image are, and how far it shifts to the depth nearby [px]."""
    inside = seen & ((q >= 0) & (q <= size - 1)).all(-1)
    if inside.sum() < 2:
        return np.zeros(0), 1.0
    axis = int(np.ptp(q[inside, 1]) >= np.ptp(q[inside, 0]))
    middle = np.flatnonzero(inside)[inside.sum() // 2 + np.array([-1, 0])]
    tangent = q[middle[1]] - q[middle[0]]
    # A motion along the stripe is not seen.
    shift = np.abs(np.linalg.det([tangent, q_nearby[middle[0]] - q[middle[0]]])) / np.linalg.norm(tangent)
    order = np.argsort(q[seen, axis])
    across, along = q[seen, axis][order], along[seen][order]
    lines = np.arange(size[axis])
    lines = lines[(lines >= across[0]) & (lines <= across[-1])]
    return np.interp(lines, across, along), float(shift)


def _stripe(scanner: Scanner, laser: int, depth: np.ndarray, along: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of the points of a sheet at depths, and whether the camera sees them there."""
    sheet, camera = scanner.laser(laser), scanner.camera
    # In the plane z = depth the sheet is a line at a distance from the optical axis, but for its bow.
    steepness = float(np.hypot(sheet.normal[0], sheet.normal[1]))
    if steepness <= 1e-6:
        return np.zeros((len(depth), 2)), np.zeros(len(depth), bool)
    beside = np.asarray(sheet.normal[:2]) / steepness
    points = lambda at: np.column_stack([np.outer(at, beside) + np.outer(along, [-beside[1], beside[0]]), depth])
    at = (sheet.distance - sheet.normal[2] * depth) / steepness
    # Each round leaves the slope of the bow, less than a hundredth, of the error before.
    for _ in range(4):
        at = at - sheet.offset(points(at)) / steepness
    p = points(at)
    q = np.asarray(camera.project(p))
    # Far outside its field of view a lens model may fold back into the image.
    same = np.linalg.norm(camera.unproject(q) - p / np.linalg.norm(p, axis=1, keepdims=True), axis=1) < 1e-6
    return q, np.asarray(same & (np.abs(sheet.offset(p)) < 1e-6 * depth))
