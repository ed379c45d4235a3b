"""From which side each point was seen, so that a view from outside can leave out what it sees from behind."""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Float, Int8

from jaxscan.reconstruction import PointCloud, grid_normals


_STEPS = 127
"""A component of a normal in steps, as WebGL reads signed bytes."""
_AGREE = 0.9
"""If this share of the normals points to the scanner, they are taken as oriented towards it."""
_KNOWN = 0.5
"""Share of points with a normal, below which a cloud does not know its sides."""
_REMAINS = 0.1
"""Backs are hidden at first only if this share of the points stays visible from every side."""
_SOME = 100_000
_UPRIGHT, _NEAR_DEG = 0.2, 3.0
"""Sine of the slope of a wall's normal, and how far normals of walls lie from where most do."""
_LEAST_WALL, _STANDS_OUT = 100, 0.3
"""Least number of normals, and least share of them near one angle, for walls; of random directions a seventh are
there."""


def sides_of(
    seen: Callable[[slice], tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"] | None]],
    count: int,
    *,
    certain: bool,
) -> Int8[np.ndarray, "n 3"] | None:
    """Unit normals in steps, towards where each point was seen from; zero where there is none.

    Args:
        seen: Normals of some of the points, zero where there is none, and from each of these points to its scanner, of
            any length; None in its place where nobody knows.
        count: Number of points.
        certain: Whether the cloud says where its scanner stood, which is only likely otherwise.

    Returns:
        None where the cloud does not know.
    """
    normals, towards = seen(slice(None, None, max(1, count // _SOME)))
    known = np.any(normals != 0, axis=1)
    if towards is None or not known.mean() >= _KNOWN:
        return None
    # Normals that agree are not turned one by one: the camera stands beside the axis, and sees a little more than the
    # axis would.
    agree = np.mean(np.einsum("ni,ni->n", normals, towards)[known] > 0) >= _AGREE
    if not (agree or certain):
        return None
    steps = np.empty((count, 3), np.int8)
    for start in range(0, count, _SOME):
        normals, towards = seen(slice(start, start + _SOME))
        if not agree and towards is not None:
            normals = np.where(np.einsum("ni,ni->n", normals, towards)[:, None] < 0, -normals, normals)
        steps[start : start + _SOME] = np.rint(_STEPS * normals)
    return steps


def hides_well(sides: Int8[np.ndarray, "n 3"]) -> bool:
    """Whether enough is left of a cloud without its backs, from wherever one looks: not of a single wall."""
    few = sides[:: max(1, len(sides) // _SOME)].astype(np.float32)
    few = few[np.any(few != 0, axis=1)]
    ways = np.array(list(product((-1.0, 1.0), repeat=3)), np.float32)
    return bool(len(few) and (few @ ways.T > 0).mean(0).min() >= _REMAINS)


def walls_of(sides: Int8[np.ndarray, "n 3"]) -> float | None:
    """Angle about z from the axes to the walls of a room [rad], within a quarter of a turn about 0.

    The angle at which most horizontal normals lie, whichever of the four ways they point; None where none stands out.
    """
    few = sides[:: max(1, len(sides) // _SOME)].astype(np.float64)
    upright = few[np.abs(few[:, 2]) < _UPRIGHT * np.linalg.norm(few, axis=1)]
    if len(upright) < _LEAST_WALL:
        return None
    degrees = np.degrees(np.arctan2(upright[:, 1], upright[:, 0]))
    counts = np.bincount(np.rint(degrees).astype(int) % 90, minlength=90)
    near = degrees - counts.argmax()
    near = near[np.abs((near + 45) % 90 - 45) <= _NEAR_DEG]
    if len(near) < _STANDS_OUT * len(degrees):
        return None
    angle = counts.argmax() + float(np.median((near + 45) % 90 - 45))
    return float(np.radians((angle + 45) % 90 - 45))


def seen_from(sides: Int8[np.ndarray, "n 3"], xyz: Float[np.ndarray, "n 3"], eye: Float[np.ndarray, "3"]) -> np.ndarray:
    """Which points a place sees from the side from which they were seen, bool [n]; those that know no side too."""
    return np.asarray(np.einsum("ni,ni->n", sides.astype(np.float32), eye.astype(np.float32) - xyz) >= 0)


_LEAST = 3
_UNEVEN = 2.0
"""How much larger steps between neighbouring rays of a scanner may be than others: a camera's are closer together at
its edges. From a place where no scanner stood they differ far more."""
_FEWEST, _MOST_PROFILES = 100, 200
_MOST_STEP_RAD = 0.1


def gridded_normals(cloud: PointCloud, places: Float[np.ndarray, "profiles 3"]) -> np.ndarray | None:
    """Unit normals towards the scanner's place at each profile [m], float32 [profiles, lines, 3]; zero for none.

    None if the cloud, of any scanner, has no grid, or none that is even as seen from those places.
    """
    valid = np.asarray(cloud.valid)
    if min(valid.shape) < _LEAST:
        return None
    # Coordinates on a map have more digits than the single precision of normals.
    xyz = np.where(valid[:, :, None], np.asarray(cloud.xyz) - places[0], 0.0).astype(np.float32)
    centre = (places - places[0]).astype(np.float32)
    line_step, profile_step = (_step(xyz - centre[:, None], valid, axis) for axis in (1, 0))
    if line_step is None or profile_step is None:
        return None
    sigma = np.asarray(cloud.sigma_random, np.float32)
    return grid_normals(xyz, sigma, valid, centre, line_step=line_step, profile_step=profile_step)


def _step(rays: np.ndarray, valid: np.ndarray, axis: int) -> float | None:
    """The usual angle between neighbouring rays along an axis of the grid [rad]; None if they are not even."""
    few = max(1, valid.shape[1 - axis] // _MOST_PROFILES)
    part = (slice(None, None, few), slice(None)) if axis == 1 else (slice(None), slice(None, None, few))
    rays, valid = rays[part], valid[part]
    ahead, behind = (np.take(rays, np.arange(1, rays.shape[axis]) - k, axis) for k in (0, 1))
    both = np.take(valid, np.arange(1, valid.shape[axis]), axis) & np.take(
        valid, np.arange(valid.shape[axis] - 1), axis
    )
    a, b = ahead[both].astype(np.float64), behind[both].astype(np.float64)
    if len(a) < _FEWEST:
        return None
    angles = np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.einsum("ni,ni->n", a, b))
    low, usual, high = np.percentile(angles, [10, 50, 90])
    return float(usual) if 0 < usual < _MOST_STEP_RAD and high <= _UNEVEN * low else None
