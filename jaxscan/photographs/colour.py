"""Colours of points from the laser-off images of a sweep: a streaming blend, one image after another.

Colours of a point that agree are added up. There is room for a few that disagree: a pixel at an edge may show the
surface on the other side, and its colour is then kept apart. The colour with the most weight is that of the point. So
memory does not grow with the number of photographs, and errors of a few of them do not bleed into the colour.
"""

import functools
import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int32, Real, UInt8

from jaxscan.compiling import compile_wide
from jaxscan.geometry import Array
from jaxscan.memory import kept
from jaxscan.photographs.occluder import AT_ONCE, Blocks, Distances, Occluder
from jaxscan.photographs.photograph import (
    Lens,
    Photograph,
    Photographs,
    PhotographView,
    dot,
    packed,
    pose_finder,
    read_image,
    sight,
)
from jaxscan.reconstruction.ahead import map_ahead, workers


ROOM = 3


class Tally(NamedTuple):
    """Colours of points so far. The points are the last axis, so that they lie side by side for the compiler."""

    total: Float[Array, "..."]
    """Sum of the weighted observations of each colour [DN]."""
    weight: Float[Array, "..."]

    @staticmethod
    def start(rgb: UInt8[np.ndarray, "blocks 3 n"]) -> "Tally":
        """A tally that already holds one colour of each point; zero for none."""
        blocks, _, count = rgb.shape
        total, weight = np.zeros((blocks, ROOM, 3, count), np.float32), np.zeros((blocks, ROOM, count), np.float32)
        weight[:, 0], total[:, 0] = np.any(rgb != 0, 1), rgb
        return Tally(total, weight)


def add(
    tally: Tally, colour: Float[Array, "3"], weight: Float[Array, ""], tolerance: float | Float[Array, ""]
) -> Tally:
    """The tally of one point after one more observation of it [DN], which has weight 0 if there is none. Colours that
    differ by no more than the tolerance [DN] count as the same.
    """
    # Slot by slot: XLA would turn an index and a reduction over three slots into a loop for each of many points.
    total, known = jnp.asarray(tally.total), jnp.asarray(tally.weight)
    apart = []
    for slot in range(ROOM):
        mean = total[slot] * (1 / jnp.where(known[slot] > 0, known[slot], 1.0))
        apart.append(jnp.where(known[slot] > 0, _largest(jnp.abs(mean - colour)), jnp.inf))
    nearest, lightest = functools.reduce(jnp.minimum, apart), functools.reduce(jnp.minimum, known)
    alike = nearest <= tolerance
    # If all slots are taken, the colour with the least weight gives way to a heavier one.
    counts = (weight > 0) & (alike | (weight > lightest))
    totals, weights = [], []
    for slot in range(ROOM):
        here = counts & jnp.where(alike, apart[slot] == nearest, known[slot] == lightest)
        counts &= ~here
        kept, more = jnp.where(here & ~alike, 0.0, 1.0), jnp.where(here, weight, 0.0)
        totals.append(kept * total[slot] + more * colour)
        weights.append(kept * known[slot] + more)
    return Tally(jnp.stack(totals), jnp.stack(weights))


def _largest(three: Float[Array, "3"]) -> Float[Array, ""]:
    return jnp.maximum(jnp.maximum(three[0], three[1]), three[2])


def conclude(tally: Tally, tolerance: float) -> UInt8[np.ndarray, "3 n"]:
    """The colour with most weight of every point; black where there is none.

    Others that differ from it by no more than twice the tolerance are mixed with it: fine print looks a little
    different in each photograph, depending on where its pixels fall.
    """
    total, weight = (np.asarray(field) for field in tally)
    mean = total / np.maximum(weight, 1e-9)[:, None]
    best = np.take_along_axis(mean, np.argmax(weight, 0)[None, None], 0)
    like = np.abs(mean - best).max(1) <= 2 * tolerance
    weight = np.where(like, weight, 0)
    rgb = np.rint(np.sum(weight[:, None] * mean, 0) / np.maximum(weight.sum(0), 1e-9))
    return np.clip(rgb, 0, 255).astype(np.uint8)


def fill_holes(
    picture: Real[np.ndarray, "height width channels"], known: Bool[np.ndarray, "height width"]
) -> Real[np.ndarray, "height width channels"]:
    """Fill unknown pixels smoothly with the mean of the smallest surrounding square that has known ones. Zero where no
    pixel is known; the type stays.
    """
    if known.all() or not known.any():
        return np.where(known[..., None], picture, 0).astype(picture.dtype)
    weight = known.astype(np.float32)[..., None]
    levels: list[tuple[np.ndarray, np.ndarray]] = [(picture.astype(np.float32) * weight, weight)]
    while max(levels[-1][1].shape[:2]) > 1 and not np.all(levels[-1][1] > 0):
        levels.append((_halved(levels[-1][0]), _halved(levels[-1][1])))
    total, weight = levels[-1]
    coarse = total / np.maximum(weight, 1e-12)
    for total, weight in levels[-2::-1]:
        larger = _doubled(coarse, total.shape[:2])
        coarse = np.where(weight > 0, total / np.maximum(weight, 1e-12), larger)
    if np.issubdtype(picture.dtype, np.integer):
        coarse = np.rint(coarse)
    return np.where(known[..., None], picture, coarse.astype(picture.dtype))


def _halved(part: np.ndarray) -> np.ndarray:
    """Sums of squares of 2 x 2 pixels."""
    rows, columns = part.shape[:2]
    even = np.pad(part, ((0, rows % 2), (0, columns % 2), (0, 0)))
    return even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]


def _doubled(part: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Each pixel as four, smoothed by the pixels beside it."""
    for axis, size in enumerate(shape):
        place = np.clip((np.arange(size) - 0.5) / 2, 0, part.shape[axis] - 1)
        first = np.floor(place).astype(int)
        second = np.minimum(first + 1, part.shape[axis] - 1)
        share = (place - first).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(3)])
        part = (1 - share) * np.take(part, first, axis) + share * np.take(part, second, axis)
    return part


STEEPEST_SEEN = 6.0
"""Largest ratio of depth along a surface to the distance across, as the camera sees it, at which colours are taken."""
UNKNOWN_FACING = 0.5
"""Cosine to the line of sight that a surface without normal is taken to have."""
SKIN = 0.012
"""Depth, relative to the distance, by which a point may lie behind the surface without being hidden."""
FEATHER = 0.15
"""Share of the image, on each side, over which the weight rises from its border."""
SATURATED = 254
"""Pixels of this code or more are saturated."""


class BlendSettings(NamedTuple):
    """How observations of a point are blended."""

    tolerance_dn: float = 20.0
    """Colours of a point that differ by more are not mixed."""
    bearing: float = np.inf
    """Standard deviation [rad] of the weight over the angle about the axis between a point and the middle of the
    photograph. A small one leaves few photographs for each point, if their places are not known well."""
    exposure: bool = True

    @property
    def weighting(self) -> float | None:
        """`bearing`, or None where it is infinite and changes no weight."""
        return None if self.bearing == np.inf else self.bearing


DEFAULT_BLEND = BlendSettings()


class _Places(NamedTuple):
    """Points, and their unit normals; zero where there is none."""

    points: Float[Array, "..."]
    normals: Float[Array, "..."]


class _Shot(NamedTuple):
    """A photograph, and all that is known about it."""

    angle: float
    image: Int32[Array, "rows columns"]
    """`packed`."""
    view: PhotographView
    distances: Distances
    gain: Float[Array, "3"]


def colour_points(
    photographs: Photographs,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    *,
    occluder: Occluder | None = None,
    start: UInt8[np.ndarray, "n 3"] | None = None,
    settings: BlendSettings = DEFAULT_BLEND,
) -> tuple[UInt8[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The colour of each point, blended of all photographs that show it.

    Each photograph that may show a point is held once, and all points are looked up in it. Its weight for a point
    depends on how steeply and from how near it shows the surface, and how far the point is from the image's border. The
    weight is zero where something stands before the point or beside it, where the surface is seen from behind or along
    itself, and where a pixel is saturated. Colours that disagree are not mixed. Memory: about 100 bytes for each point.

    Args:
        photographs: Laser-off images of a calibrated rig.
        points: Places in the scanner frame [m].
        normals: Normals of their surfaces, of any length, in the sense that is seen; zero where unknown.
        occluder: The surfaces that may stand before points; exposures are equalised by their colours. Without it,
            everything in the image counts as seen.
        start: Colours of the points that are known already, from one photograph each; zero for none.
        settings: How observations are blended.

    Returns:
        rgb: Colours, in the camera's own response; `start` where no photograph shows a point, or black.
        seen: Whether a photograph shows it.

    Raises:
        ValueError: If a photograph is not of the camera's size.
    """
    if not len(points):
        return np.zeros((0, 3), np.uint8), np.zeros(0, np.bool_)
    points = np.asarray(points, np.float32)
    # Single precision throughout, so that the result does not depend on the caller's setting.
    with jax.enable_x64(False), ThreadPoolExecutor(workers()) as pool:
        lens, blocks = Lens.of(photographs.scanner.camera), Blocks.of(points)
        pose_at = pose_finder(photographs.scanner)
        facing = blocks.gather(np.asarray(normals, np.float32))
        # In place: there may be many.
        facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-12)
        places = _Places(blocks.gather(points), facing)
        tally = Tally.start(blocks.gather(np.zeros((len(points), 3), np.uint8) if start is None else start))
        seen = np.zeros((len(tally.weight), 1, blocks.size), np.bool_)

        def prepare(photograph: Photograph) -> _Shot:
            shot = _prepared(photograph, lens, pose_at(photograph.angle), occluder)
            if occluder is None or not settings.exposure:
                return shot
            return shot._replace(gain=_gain(shot, occluder, blocks.size, settings.tolerance_dn))

        def look(few: np.ndarray, shot: _Shot) -> None:
            """Add to the tally of some blocks what the photograph shows of them."""
            before = (_Places(*(field[few] for field in places)), Tally(*(field[few] for field in tally)))
            # JAX keeps this setting per thread.
            with jax.enable_x64(False):
                after, _, weight = _looked_up(shot, settings.weighting, *before, settings.tolerance_dn)
            for field, part in zip(tally, after, strict=True):
                field[few] = np.asarray(part)
            seen[few, 0] |= np.asarray(weight) > 0

        def visible(angle: float) -> list[np.ndarray]:
            return blocks.seen_from(pose_at(angle), np.asarray(lens.bounds))

        # While points are looked up in one photograph, the next one is prepared.
        shots = photographs.where(lambda angle: len(visible(angle)) > 0)
        for shot in map_ahead(prepare, shots, 1):
            for _ in pool.map(look, visible(shot.angle), itertools.repeat(shot)):
                pass
        rgb = pool.map(lambda *block: conclude(Tally(*block), settings.tolerance_dn), *tally)
        return blocks.scatter(np.stack(list(rgb))), blocks.scatter(seen)[:, 0]


def _prepared(photograph: Photograph, lens: Lens, pose: np.ndarray, occluder: Occluder | None) -> _Shot:
    """A photograph with the surfaces in it, not yet equalised."""
    # JAX keeps this setting per thread.
    with jax.enable_x64(False):
        # On the device: it is handed to many calls.
        view = jax.device_put(PhotographView(lens, pose))
        distances = Distances.of_nothing() if occluder is None else occluder.distances(view)
        image, distances = _packed(np.ascontiguousarray(photograph.image)), jax.device_put(distances)
    return _Shot(photograph.angle, image, view, distances, np.ones(3, np.float32))


_packed = jax.jit(packed)


LEAST_COMMON = 50
"""Least number of points for equalising an exposure."""
LEAST_DN = 12.0
"""Darker colours are not used for equalising exposures."""
MOST_GAIN = 4.0


def _gain(shot: _Shot, occluder: Occluder, size: int, tolerance: float) -> Float[np.ndarray, "3"]:
    """Factor for each colour that takes a photograph to the exposure of the stripes around it.

    The stripes in a photograph are from photographs on both sides of it, so that errors do not add up along a turn.
    They are looked up in blocks of the same size as those of the points, so that the compiled program that looks up
    the points serves for both.
    """
    (points, rgb), room = occluder.references, AT_ONCE * size
    nothing, observed = Tally.start(np.zeros((AT_ONCE, 3, size), np.uint8)), []
    for start in range(0, len(points), room):
        # The last blocks are filled up by repetition.
        some = np.moveaxis(np.resize(points[start : start + room], (room, 3)).reshape(AT_ONCE, size, 3), 1, 2)
        places = _Places(np.ascontiguousarray(some), np.zeros(some.shape, np.float32))
        with jax.enable_x64(False):
            colour, weight = map(np.asarray, _looked_up(shot, None, places, nothing, tolerance)[1:])
        observed.append(np.concatenate([np.moveaxis(colour, 1, 2).reshape(-1, 3), weight.reshape(-1, 1)], 1))
    known = np.concatenate([np.zeros((0, 4), np.float32), *observed])[: len(points)]
    colour, weight = known[:, :3], known[:, 3:]
    use = (weight > 0) & (colour > LEAST_DN) & (rgb > LEAST_DN) & (rgb < 250.0)
    gain = np.ones(3, np.float32)
    for k in range(3):
        ratio = rgb[use[:, k], k] / colour[use[:, k], k]
        if len(ratio) >= LEAST_COMMON:
            middle = len(ratio) // 2
            gain[k] = np.clip(np.partition(ratio, middle)[middle], 1 / MOST_GAIN, MOST_GAIN)
    return gain


def _weigh(
    view: PhotographView, distances: Distances, bearing: float | Float[Array, ""] | None, place: _Places
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Pixel of a point in a photograph, and its weight: at most 1, and 0 where it shows something else."""
    point, normal = place
    pose, camera, cell = view.T_scanner_cam, view.lens.camera, distances.cell
    (u, v), range_m, inside = seen = sight(view, point)
    cosine = jnp.where(dot(normal, normal) > 0, dot(normal, pose[:3, 3] - point) / range_m, UNKNOWN_FACING)
    # Whether something stands before the point, or so near its line of sight that their light could mix. A slanted
    # surface comes nearer beside the point, and so much nearer within two cells is allowed.
    facing = jnp.clip(cosine, 1 / STEEPEST_SEEN, 1.0)
    slope = jnp.sqrt(1 - facing * facing) / facing
    row, column = (jnp.floor((at + 0.5) / cell).astype(jnp.int32) + 1 for at in (v, u))
    # Places outside the image are looked up at its border, and do not count.
    before = jnp.asarray(distances.nearest).at[row, column].get(mode="clip")
    hidden = range_m * (1 - SKIN - 2 * cell * view.lens.per_pixel * slope) > before
    # Resolution on the surface, in both directions of the image; compared with that, the distance from the middle of
    # the rig changes little.
    away = jnp.minimum(jnp.sqrt(dot(point, point)) / jnp.maximum(range_m, 1e-3), 2.0)
    weight = jnp.minimum(cosine, 1.0) * away * away * jnp.minimum(_rise(u, camera.width), _rise(v, camera.height))
    if bearing is not None:
        off = jnp.arctan2(pose[0, 2] * point[1] - pose[1, 2] * point[0], pose[0, 2] * point[0] + pose[1, 2] * point[1])
        weight = weight * jnp.exp(-0.5 * (off / bearing) ** 2)
    shown = inside & (cosine > 1 / STEEPEST_SEEN) & ~hidden
    return seen.q, jnp.where(shown, jnp.minimum(weight, 1.0), 0.0)


def _rise(place: Float[Array, ""], size: int) -> Float[Array, ""]:
    """A weight that rises smoothly from 0 at both ends of an axis of the image to 1."""
    t = jnp.clip(jnp.minimum(place, size - 1 - place) / (FEATHER * size), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _observe(
    shot: _Shot, bearing: float | Float[Array, ""] | None, places: _Places
) -> tuple[Float[Array, "few 3 size"], Float[Array, "few size"]]:
    """Colours of points in a photograph as it shows them [DN], and their weights."""
    weigh = functools.partial(_weigh, shot.view, shot.distances, bearing)
    # Each step is computed once and kept: XLA would weigh a point again for each of its pixels, and read the pixels
    # again for each result.
    some = shot.view.lens.per_pixel > 0
    q, weight = kept(some, _each(weigh), places)
    colour, brightest = kept(some, _each(functools.partial(read_image, shot.image)), q)
    weight = jnp.where(brightest < SATURATED, weight, 0.0)
    # The pixel of a point that is not seen may be NaN.
    return _each(lambda colour, weight: jnp.where(weight > 0, colour, 0.0))(colour, weight), weight


def _each(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one point for arrays [few, ..., size]; points are the last axis, to read components in rows."""
    return jax.vmap(jax.vmap(function, -1, -1))


@functools.partial(compile_wide, sooner=True)
def _looked_up(
    shot: _Shot,
    bearing: float | Float[Array, ""] | None,
    places: _Places,
    tally: Tally,
    tolerance: float | Float[Array, ""],
) -> tuple[Tally, Float[Array, "few 3 size"], Float[Array, "few size"]]:
    """The tally of points after a photograph, and their colours and weights in that photograph alone."""
    colour, weight = _observe(shot, bearing, places)

    def one(tally: Tally, colour: Float[Array, "3"], weight: Float[Array, ""]) -> Tally:
        return add(tally, colour * shot.gain, weight, tolerance)

    return _each(one)(tally, colour, weight), colour, weight
