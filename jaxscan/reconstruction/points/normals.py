"""Normals from the organised grid.

Through every point goes a line of the stripe (along its profile) and, over several profiles, a
line across them; both lie in the surface, and their cross product is its normal. Both directions
are least-squares slopes over a window, taken over those neighbours only that are valid and on
the same surface. Any combination of coplanar points whose weights add up to zero lies in their
plane, so on a plane the result is exact whatever is missing.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from jaxscan.geometry import Array
from jaxscan.reconstruction.ahead import map_ahead, workers


BLOCK = 32
"""Profiles computed at a time: few enough that all cores have some to do."""
LINE_ANGLE = np.radians(0.35)
PROFILE_ANGLE = np.radians(0.4)
"""Half sizes of the window [rad], in lines and in profiles, before the limits below: 15 mm and
17 mm at 2.5 m, where a stripe's noise of 1 mm leaves about 0.7 degrees in the normal."""
MAX_LINES, MAX_PROFILES = 8, 4
STEEPEST = 4.0
"""Depth change per distance across the ray up to which neighbours count as one surface (76
degrees from head-on)."""


def grid_normals(
    xyz: np.ndarray,
    sigma: np.ndarray,
    valid: np.ndarray,
    centre: np.ndarray,
    *,
    line_step: float,
    profile_step: float,
) -> np.ndarray:
    """Unit normals towards the camera, for the profiles of one laser in the order of their angle.

    Args:
        xyz: Points [profiles, lines, 3], m.
        sigma: Standard deviation along the ray [profiles, lines], m.
        valid: Which of them exist [profiles, lines].
        centre: Camera centre of each profile [profiles, 3], m.
        line_step: Angle between neighbouring lines [rad].
        profile_step: Angle between neighbouring profiles [rad].

    Returns:
        Normals, float32 [profiles, lines, 3]; zero where neighbours are too few.
    """
    profiles = len(xyz)
    half_lines = int(np.clip(round(LINE_ANGLE / max(line_step, 1e-6)), 2, MAX_LINES))
    half = int(np.clip(round(PROFILE_ANGLE / max(profile_step, 1e-6)), 1, MAX_PROFILES))
    steps = np.array([line_step, profile_step], np.float32)
    normals = np.zeros(xyz.shape, np.float32)

    def fill(start: int) -> None:
        window = (start - half, start + BLOCK + half)
        block = (_part(array, window) for array in (xyz, sigma, valid, centre))
        # JAX keeps this setting per thread.
        with jax.enable_x64(False):
            found = _block_normals(*block, steps, (half_lines, half))
            for axis in range(3):
                part = normals[start : start + BLOCK, :, axis]
                part[:] = np.asarray(found[axis])[: len(part)]

    for _ in map_ahead(fill, range(0, profiles, BLOCK), workers()):
        pass
    return normals


def _part(array: np.ndarray, window: tuple[int, int]) -> np.ndarray:
    """Profiles start ... stop of the array, zero (so: not valid) beyond its ends."""
    start, stop = window
    inside = array[max(start, 0) : min(stop, len(array))]
    before = max(-start, 0)
    padding = [(before, stop - start - before - len(inside))] + [(0, 0)] * (array.ndim - 1)
    return np.pad(inside, padding) if any(padding[0]) else inside


@functools.partial(jax.jit, static_argnums=5)
def _block_normals(
    xyz: Float[Array, "padded lines 3"],
    sigma: Float[Array, "padded lines"],
    valid: Bool[Array, "padded lines"],
    centre: Float[Array, "padded 3"],
    steps: Float[Array, "2"],
    halves: tuple[int, int],
) -> tuple[Array, Array, Array]:
    """Normals of a block of profiles by component; the block holds those around it that its windows reach."""
    half_lines, half_profiles = halves
    # Components apart: [..., 3] as the fastest axis would keep the loops from being vectorised.
    p = tuple(xyz[:, :, axis] for axis in range(3))
    c = tuple(centre[:, None, axis] for axis in range(3))
    along, mean, found = _slopes((p, sigma, valid, c), (1, half_lines, 3), steps[0])
    across, average, enough = _slopes((mean, sigma, found, c), (0, half_profiles, 2), steps[1], along)
    inner = slice(half_profiles, p[0].shape[0] - half_profiles)
    a, b, at, eye = (tuple(x[inner] for x in vector) for vector in (average, across, p, c))
    n = (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    towards = sum(n[i] * (eye[i] - at[i]) for i in range(3))
    length = jnp.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    exists = enough[inner] & valid[inner] & (length > 1e-12)
    scale = jnp.where(exists, jnp.sign(towards) / jnp.where(exists, length, 1.0), 0.0)
    return n[0] * scale, n[1] * scale, n[2] * scale


def _slopes(points, window, step, carried=None):
    """Slope and mean of the points over a window along one axis of the grid.

    Args:
        points: Positions by component, sigmas, which are valid, and camera centres by component.
        window: The axis, the neighbours on either side, and how many are needed.
        step: Angle between neighbours along the axis [rad].
        carried: Vectors whose mean is wanted instead of that of the positions.

    Returns:
        The slope per grid step, the mean, and where enough neighbours were found.
    """
    (p, sigma, valid, centre), (axis, half, least) = points, window
    d = tuple(p[i] - centre[i] for i in range(3))
    far = jnp.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    variance = sigma * sigma
    columns = (*p, far, variance, *(carried or ()))
    padding = [(half, half) if i == axis else (0, 0) for i in range(2)]
    padded = [jnp.pad(column, padding) for column in columns]
    padded_valid = jnp.pad(valid, padding)
    size = valid.shape[axis]

    def on_side(number):
        """Weight, offset and difference of the neighbours `number - half` steps away."""
        x, y, z, range_k, variance_k, *more = (
            jax.lax.dynamic_slice_in_dim(column, number, size, axis) for column in padded
        )
        there = jax.lax.dynamic_slice_in_dim(padded_valid, number, size, axis)
        k = (number - half).astype(far.dtype)
        gap = STEEPEST * jnp.abs(k) * step * far + 4.0 * jnp.sqrt(variance + variance_k)
        w = (valid & there & (jnp.abs(range_k - far) <= gap)).astype(far.dtype)
        return k, w, tuple(w * (component - p[i]) for i, component in enumerate((x, y, z))), tuple(w * m for m in more)

    def add(distance, total):
        # Both sides in one pass: the sums are read and written half as often.
        count, first, second, sums, moments, others = total
        k, w_after, after, more_after = on_side(half + distance)
        _, w_before, before, more_before = on_side(half - distance)
        both = w_after + w_before
        return (
            count + both,
            first + k * (w_after - w_before),
            second + (k * k) * both,
            tuple(s + (a + b) for s, a, b in zip(sums, after, before, strict=True)),
            tuple(s + k * (a - b) for s, a, b in zip(moments, after, before, strict=True)),
            tuple(s + (a + b) for s, a, b in zip(others, more_after, more_before, strict=True)),
        )

    zero = jnp.zeros_like(far)
    itself = valid.astype(far.dtype)
    own = tuple(itself * component for component in carried or ())
    start = (itself, zero, zero, (zero,) * 3, (zero,) * 3, own)
    count, first, second, sums, moments, others = jax.lax.fori_loop(1, half + 1, add, start)
    spread = count * second - first * first
    enough = (count >= least) & (spread > 0)
    safe = jnp.where(enough, spread, 1.0)
    many = jnp.maximum(count, 1.0)
    slope = tuple((count * moments[i] - first * sums[i]) / safe for i in range(3))
    if carried is not None:
        return slope, tuple(other / many for other in others), enough
    return slope, tuple(p[i] + sums[i] / many for i in range(3)), enough
