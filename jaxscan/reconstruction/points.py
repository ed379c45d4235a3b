"""From a stripe centre to a point: triangulated, turned, with its uncertainty and its normal; one compiled function."""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.compiling import compile_wide
from jaxscan.geometry import (
    Array,
    Hand,
    Rig,
    Scanner,
    StripeAxis,
    across_and_along,
    lit_points,
    lit_slopes,
    poses,
    rays,
    root_of,
    stripe_pixel,
    transform,
)
from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.reconstruction.settings import ReconstructSettings
from jaxscan.reconstruction.sweep import place


BLOCK = 32
"""Profiles computed at a time: few enough that all cores have some to do."""
SPACING_PX = 16.0
"""Largest distance of two knots of a `RangeTable` [px]: the interpolated value is within 0.1 % of the exact one at the
test's strong lens (k1 = -0.25)."""
LINE_ANGLE = np.radians(0.35)
PROFILE_ANGLE = np.radians(0.4)
"""Half sizes of the window of a normal [rad], in lines and in profiles, before the limits below: 15 mm and 17 mm at
2.5 m, where a stripe's noise of 1 mm leaves about 0.7 degrees in the normal."""
MAX_LINES, MAX_PROFILES = 8, 4
STEEPEST = 4.0
"""Depth change per distance across the ray up to which neighbours count as one surface (76 degrees from head-on)."""
_STEP = 1e-2
"""Length of the steps of differences [sigma]: the next order is a ten-thousandth, and rounding less."""

Vector = tuple[Array, Array, Array]
"""Components apart: [..., 3] as the fastest axis would keep loops from being vectorised."""


class RangeTable(eqx.Module):
    r"""The uncertainty of the range from the calibration's covariance: std(m dd - d dm) per laser and line.

    With range $= d / m$ a small change of the calibration moves a point along its ray by

    $$\delta\,\mathrm{range} = \frac{m\,\delta d - d\,\delta m}{m^2}.$$

    The denominator spans orders of magnitude over the image; the standard deviation of the numerator is smooth. It is
    therefore evaluated once, in float64, on a coarse lattice of pixels, and interpolated.
    """

    numerator: Float[Array, "lasers lines knots"]
    """[m]"""
    spacing: Float[Array, ""]
    """Distance of two knots across the line [px]."""

    def sigma(
        self, laser: int | Array, line: int | Array, u: Float[Array, "*n"], incidence: Float[Array, "*n"]
    ) -> Float[Array, "*n"]:
        """Standard deviation of the range [m] of stripe centres; 0 where they miss the sheet."""
        knots = self.numerator.shape[2]
        position = jnp.clip(u / self.spacing, 0.0, knots - 1.0).astype(u.dtype)
        left = jnp.minimum(position.astype(jnp.int32), knots - 2)
        weight = position - left.astype(u.dtype)
        numerator = (1.0 - weight) * self.numerator[laser, line, left]
        numerator += weight * self.numerator[laser, line, left + 1]
        hits = incidence > 0
        return jnp.where(hits, numerator / jnp.where(hits, incidence * incidence, 1.0), 0.0).astype(u.dtype)


def range_table(scanner: Scanner, stripe_axis: StripeAxis = "rows") -> RangeTable:
    """Tabulate the effect of `scanner.covariance` on the range; zero where it has none."""
    across, lines = across_and_along(scanner.camera.width, scanner.camera.height, stripe_axis)
    if scanner.covariance is None:
        return RangeTable(np.zeros((len(scanner.laser_names), lines, 2)), np.asarray(float(across - 1)))
    knots, coarse = (np.linspace(0.0, n - 1.0, max(2, int(np.ceil((n - 1) / SPACING_PX)) + 1)) for n in (across, lines))
    q = np.asarray(stripe_pixel(*np.meshgrid(knots, coarse), stripe_axis))
    table = np.stack([_numerators(scanner, laser, q) for laser in range(len(scanner.laser_names))])
    # Between lattice lines: linear, once for every line, so that a look-up needs two knots only.
    position = np.arange(lines) / (coarse[1] - coarse[0])
    low = np.minimum(position.astype(int), len(coarse) - 2)
    weight = (position - low)[None, :, None]
    full = (1.0 - weight) * table[:, low] + weight * table[:, low + 1]
    return RangeTable(full, np.asarray(knots[1] - knots[0]))


def _numerators(scanner: Scanner, laser: int, q: np.ndarray) -> np.ndarray:
    """std(m dd - d dm) at pixels of one laser: the sum of its derivatives along independent directions."""
    covariance, layout = np.asarray(scanner.covariance, np.float64), scanner.layout()
    # Neither other sheets nor a motion move a point along its ray. But where the camera sits on a hand was found by
    # boards that it saw too far or too near, as it sees all else: the two make up for one another.
    own, hand = layout.lasers.start + 5 * laser, isinstance(scanner.turntable, Hand)
    matter = np.r_[layout.camera, own : own + 5, layout.turntable if hand else slice(0)]
    ray = np.asarray(rays(scanner.rig, q)) if hand else None
    rig, variance = scanner.rig, np.zeros(q.shape[:-1])
    d, m = float(rig.laser(laser).distance), lit_points(rig, q, laser)[1]
    for step in root_of(covariance[np.ix_(matter, matter)]):
        whole = np.zeros(len(covariance))
        whole[matter] = _STEP * step
        forth, back = (rig.retract(sign * whole) for sign in (1.0, -1.0))
        change_d: Any = float(forth.laser(laser).distance - back.laser(laser).distance)
        change_m = lit_points(forth, q, laser)[1] - lit_points(back, q, laser)[1]
        # The first three of a twist move the camera in its own frame.
        along = 0.0 if ray is None else ray @ (2.0 * whole[layout.turntable][:3])
        variance += ((m * (change_d + m * along) - d * change_m) / (2.0 * _STEP)) ** 2
    return np.sqrt(variance)


class Limits(NamedTuple):
    """Which points are accepted; arrays, so a change compiles nothing."""

    min_range_m: Float[Array, ""]
    max_range_m: Float[Array, ""]
    min_incidence: Float[Array, ""]


class Aim(NamedTuple):
    """Where the points of one laser go; arrays, so a change compiles nothing."""

    rig: Rig
    table: RangeTable
    laser: Int[Array, ""]
    """Number of the laser whose sheet is meant."""
    limits: Limits

    @staticmethod
    def of(scanner: Scanner, settings: ReconstructSettings, stripe_axis: StripeAxis) -> "Aim":
        """The aim of the first laser, float32."""
        limits = Limits(*map(np.asarray, (settings.min_range_m, settings.max_range_m, settings.min_incidence)))
        parts = Aim(scanner.rig, range_table(scanner, stripe_axis), np.zeros((), np.int32), limits)
        # Host arrays: the same whether or not the caller enabled 64-bit JAX.
        return jax.tree.map(lambda leaf: leaf if leaf.dtype == np.int32 else np.asarray(leaf, np.float32), parts)


class Centres(NamedTuple):
    """The fields of `Stripes` that a point is made of."""

    u: Float[Array, "profiles lines"]
    sigma: Float[Array, "profiles lines"]
    valid: Bool[Array, "profiles lines"]


class Triangulated(NamedTuple):
    """Stripe centres in space; zero, never NaN, where they are not valid."""

    p_cam: Float[Array, "*n 3"]
    """Points [m], camera frame."""
    range_m: Float[Array, "*n"]
    """Distance from the camera along the ray [m]."""
    slope: Float[Array, "*n"]
    """d range / d u [m/px]."""
    incidence: Float[Array, "*n"]
    """m of `LaserSheet.intersect` [1]."""
    valid: Bool[Array, "*n"]


class Points(NamedTuple):
    """Fields of `PointCloud` for some profiles."""

    xyz: Float[Array, "profiles lines 3"]
    sigma_random: Float[Array, "profiles lines"]
    sigma_systematic: Float[Array, "profiles lines"]
    valid: Bool[Array, "profiles lines"]


def triangulate(
    rig: Rig,
    u: Float[Array, "*n"],
    line: Float[Array, "*n"],
    laser: int | Array,
    *,
    stripe_axis: StripeAxis = "rows",
    limits: Limits,
) -> Triangulated:
    r"""Intersect the viewing rays of stripe centres with their laser sheet.

    $p = \frac{d}{m(q)}\, v(q)$, and the slope $\partial\,\mathrm{range} / \partial u$ is the exact
    derivative, through the lens model and the bow of the sheet.

    Args:
        u: Stripe centres across the line [px].
        line: Numbers of the lines: image rows, or columns for `stripe_axis` "columns" [px].

    Source: the paper, equations (1)-(4).
    """
    p_cam, incidence = lit_points(rig, stripe_pixel(u, line, stripe_axis), laser)
    range_m = jnp.sqrt(sum(p_cam[..., k] * p_cam[..., k] for k in range(3)))
    by_u = lit_slopes(rig, p_cam, incidence, laser)[..., 0 if stripe_axis == "rows" else 1]
    safe = jnp.where(range_m > 0, range_m, 1.0)
    slope = sum(p_cam[..., k] * by_u[..., k] for k in range(3)) / safe
    valid = (incidence >= limits.min_incidence) & (incidence > 0)
    valid &= (range_m >= limits.min_range_m) & (range_m <= limits.max_range_m)
    kept = lambda value, where: jnp.where(where, value, 0.0).astype(p_cam.dtype)
    return Triangulated(kept(p_cam, valid[..., None]), kept(range_m, valid), kept(slope, valid), incidence, valid)


def locate_points(
    aim: Aim, centres: Centres, phi: Float[Array, " profiles"], *, stripe_axis: StripeAxis
) -> tuple[Points, Float[Array, "profiles 3"]]:
    """Points and sigmas of some profiles, and the camera's centres [m]; pure and traceable.

    Args:
        phi: The table's angle of each profile [rad from home].
    """
    u = jnp.where(centres.valid, centres.u, 0.0).astype(centres.u.dtype)
    line = jnp.broadcast_to(jnp.arange(u.shape[1], dtype=u.dtype), u.shape)
    found = triangulate(aim.rig, u, line, aim.laser, stripe_axis=stripe_axis, limits=aim.limits)
    valid = centres.valid & found.valid
    exists = lambda value: jnp.where(valid, value, 0.0).astype(u.dtype)
    systematic = aim.table.sigma(aim.laser, line.astype(jnp.int32), u, found.incidence)
    pose = poses(aim.rig, phi)
    xyz = jnp.where(valid[..., None], transform(pose[:, None], found.p_cam), 0.0).astype(u.dtype)
    random = jnp.abs(found.slope) * centres.sigma
    return Points(xyz, exists(random), exists(systematic), valid), pose[:, :3, 3]


class Window(NamedTuple):
    """The neighbours from which a normal is taken."""

    lines: int
    profiles: int
    """On either side."""
    steps: tuple[float, float]
    """Angle between neighbouring lines, and between neighbouring profiles [rad]."""

    @staticmethod
    def of(line_step: float, profile_step: float) -> "Window":
        lines = int(np.clip(round(LINE_ANGLE / max(line_step, 1e-6)), 2, MAX_LINES))
        profiles = int(np.clip(round(PROFILE_ANGLE / max(profile_step, 1e-6)), 1, MAX_PROFILES))
        return Window(lines, profiles, (line_step, profile_step))


def empty_points(grid: tuple[int, ...]) -> dict[str, np.ndarray]:
    """The fields of `Points`, and normals, of a grid [profiles, lines], to be filled."""
    fields = {name: np.zeros((*grid, 3), np.float32) for name in ("xyz", "normals")}
    fields |= {name: np.zeros(grid, np.float32) for name in ("sigma_random", "sigma_systematic")}
    return fields | {"valid": np.zeros(grid, np.bool_)}


def fill_points(
    fields: dict[str, np.ndarray],
    rows: np.ndarray,
    aim: Aim,
    centres: Centres,
    phi: Float[np.ndarray, " profiles"],
    window: Window | None = None,
    *,
    stripe_axis: StripeAxis,
) -> None:
    """Compute the points of profiles of one laser, and their normals.

    Args:
        fields: As of `empty_points`, of the whole grid, which are filled.
        rows: The profiles in the grid; for normals in the order of their angle.
        phi: The table's angle of each profile of the grid [rad from home].
        window: The neighbours from which normals are taken; None for no normals.
    """
    steps, halves = _sizes(window)

    def fill(start: int) -> None:
        u, sigma, valid, angle = _around((*map(np.asarray, centres), phi), rows, start, window)
        found, normals = _located(aim, Centres(u, sigma, valid), angle, steps, halves, stripe_axis=stripe_axis)
        mine = rows[start : start + BLOCK]
        for name, field in found._asdict().items():
            fields[name][place(mine)] = np.asarray(field)[: len(mine)]
        if normals is not None:
            _store(fields["normals"], mine, normals)

    _in_blocks(fill, len(rows))


def grid_normals(
    xyz: Float[np.ndarray, "profiles lines 3"],
    sigma: Float[np.ndarray, "profiles lines"],
    valid: Bool[np.ndarray, "profiles lines"],
    centre: Float[np.ndarray, "profiles 3"],
    *,
    line_step: float,
    profile_step: float,
) -> Float[np.ndarray, "profiles lines 3"]:
    """Unit normals towards the camera, for the profiles of one laser in the order of their angle.

    Args:
        xyz: Points [m].
        sigma: Standard deviation along the ray [m].
        centre: Camera centre of each profile [m].
        line_step: Angle between neighbouring lines [rad].
        profile_step: Angle between neighbouring profiles [rad].

    Returns:
        Normals, float32; zero where neighbours are too few.
    """
    normals, window, rows = np.zeros(xyz.shape, np.float32), Window.of(line_step, profile_step), np.arange(len(xyz))

    def fill(start: int) -> None:
        block = _around((xyz, sigma, valid, centre), rows, start, window)
        _store(normals, rows[start : start + BLOCK], _normals_alone(*block, *_sizes(window)))

    _in_blocks(fill, len(rows))
    return normals


def _in_blocks(fill: Callable[[int], None], profiles: int) -> None:
    def single(start: int) -> None:
        # JAX keeps this setting per thread. Single precision, so that the result does not depend on the caller's.
        with jax.enable_x64(False):
            fill(start)

    for _ in map_ahead(single, range(0, profiles, BLOCK), workers()):
        pass


def _sizes(window: Window | None) -> tuple[np.ndarray, tuple[int, int] | None]:
    """What the compiled functions take of a window: its steps, and the static half sizes."""
    if window is None:
        return np.zeros(2, np.float32), None
    return np.array(window.steps, np.float32), (window.lines, window.profiles)


def _around(arrays: tuple[np.ndarray, ...], rows: np.ndarray, start: int, window: Window | None) -> list[np.ndarray]:
    """A block of rows and those around it that its windows reach; zero (so: not valid) beyond the ends."""
    half = 0 if window is None else window.profiles
    first, stop = start - half, start + BLOCK + half
    inside = place(rows[max(first, 0) : stop])
    parts, before = [], max(-first, 0)
    for array in arrays:
        part = array[inside]
        padding = [(before, stop - first - before - len(part))] + [(0, 0)] * (array.ndim - 1)
        parts.append(np.pad(part, padding) if any(padding[0]) else part)
    return parts


def _store(normals: np.ndarray, rows: np.ndarray, components: Vector) -> None:
    for axis, component in enumerate(components):
        normals[place(rows), :, axis] = np.asarray(component)[: len(rows)]


@functools.partial(compile_wide, static=("halves", "stripe_axis"))
def _located(
    aim: Aim,
    centres: Centres,
    phi: Float[Array, " padded"],
    steps: Float[Array, "2"],
    halves: tuple[int, int] | None,
    *,
    stripe_axis: StripeAxis,
) -> tuple[Points, Vector | None]:
    """Points of a block of profiles and their normals, which need the profiles around it."""
    found, centre = locate_points(aim, centres, phi, stripe_axis=stripe_axis)
    if halves is None:
        return found, None
    inner = slice(halves[1], len(phi) - halves[1])
    normals = _normals(found.xyz, found.sigma_random, found.valid, centre, steps, halves)
    return jax.tree.map(lambda field: field[inner], found), normals


def _normals(
    xyz: Float[Array, "padded lines 3"],
    sigma: Float[Array, "padded lines"],
    valid: Bool[Array, "padded lines"],
    centre: Float[Array, "padded 3"],
    steps: Float[Array, "2"],
    halves: tuple[int, int],
) -> Vector:
    """Normals of a block of profiles from the organised grid.

    Through every point goes a line of the stripe (along its profile) and, over several profiles, a line across them;
    both lie in the surface, and their cross product is its normal. Both directions are least-squares slopes over a
    window, taken over those neighbours only that are valid and on the same surface. Any combination of coplanar points
    whose weights add up to zero lies in their plane, so on a plane the result is exact whatever is missing.
    """
    half_lines, half_profiles = halves
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


_normals_alone = jax.jit(_normals, static_argnums=5)


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


def line_step(scanner: Scanner, stripe_axis: StripeAxis) -> float:
    """Angle between neighbouring lines at the middle of the image [rad]."""
    middle = np.array([scanner.camera.width, scanner.camera.height]) / 2
    first, second = rays(scanner.rig, np.stack([middle, middle + stripe_pixel(np.zeros(()), np.ones(()), stripe_axis)]))
    return float(np.linalg.norm(second - first))
