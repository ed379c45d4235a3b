"""Colours of points from all photographs that see them sharply."""

import functools
import itertools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int32, UInt8

from jaxscan.compiling import compile_wide
from jaxscan.geometry import Array
from jaxscan.memory import kept
from jaxscan.photographs.blend import Tally, add, conclude
from jaxscan.photographs.blocks import Blocks
from jaxscan.photographs.occluder import Distances, Occluder
from jaxscan.photographs.photograph import Photograph, Photographs, packed, read_image
from jaxscan.photographs.view import Lens, View, dot, pose_finder, sight
from jaxscan.reconstruction.ahead import map_ahead, workers


STEEPEST_SEEN = 6.0
"""Ways along a surface for one across it, seen from the camera: beyond, no colour is taken."""
UNKNOWN_FACING = 0.5
"""Cosine to the line of sight that a surface without normal is taken to have."""
SKIN = 0.012
"""Depth, relative to the distance, by which a point may lie behind the surface without being hidden."""
FEATHER = 0.15
"""Share of the image, on each side, over which the weight rises from its border."""
SATURATED = 254
"""From this code on a pixel says nothing about the colour."""


class BlendSettings(NamedTuple):
    """How observations of a point are blended."""

    tolerance_dn: float = 20.0
    """Colours of a point that differ by more are not mixed."""
    bearing: float = np.inf
    """Standard deviation [rad] of the weight by the angle about the axis between a point and the middle of the
    photograph: few photographs for each point where their places are not known well."""
    exposure: bool = True
    """Whether exposures are equalised."""

    @property
    def weighting(self) -> float | None:
        """The bearing, or None where it does not count."""
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
    view: View
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

    Each photograph that may show a point is held once, and all points are looked up in it. It counts for a point by how
    steeply, how near and how far from its border it shows it; not at all where something stands before the point or
    beside it, where the surface is seen from behind or along itself, and where a pixel is saturated. Colours that
    disagree are not mixed. Memory: about 100 bytes for each point.

    Args:
        photographs: Laser-off images of a calibrated rig.
        points: Places in the scanner frame [m].
        normals: Normals of their surfaces, of any length, in the sense that is seen; zero where unknown.
        occluder: The surfaces that may stand before points, and by whose colours exposures are equalised. Without,
            everything in the image is seen.
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
            return shot if occluder is None or not settings.exposure else shot._replace(gain=_gain(shot, occluder))

        def look(few: np.ndarray, shot: _Shot) -> None:
            """Add to the tally of some blocks what the photograph shows of them."""
            before = (_Places(*(field[few] for field in places)), Tally(*(field[few] for field in tally)))
            # JAX keeps this setting per thread.
            with jax.enable_x64(False):
                after, shown = _looked_up(shot, settings.weighting, *before, settings.tolerance_dn)
            for field, part in zip(tally, after, strict=True):
                field[few] = np.asarray(part)
            seen[few, 0] |= np.asarray(shown)

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
        view = jax.device_put(View(lens, pose))
        distances = Distances.of_nothing() if occluder is None else occluder.distances(view)
        image, distances = _packed(np.ascontiguousarray(photograph.image)), jax.device_put(distances)
    return _Shot(photograph.angle, image, view, distances, np.ones(3, np.float32))


_packed = jax.jit(packed)


LEAST_COMMON = 50
"""Points by which an exposure is equalised, at the least."""
LEAST_DN = 12.0
"""Darker colours say nothing about an exposure."""
MOST_GAIN = 4.0


def _gain(shot: _Shot, occluder: Occluder) -> Float[np.ndarray, "3"]:
    """Factor for each colour that takes a photograph to the exposure of the stripes around it.

    The stripes in a photograph are from photographs on both sides of it, so that errors do not add up along a turn.
    """
    points, rgb = (np.ascontiguousarray(field.T)[None] for field in occluder.references)
    with jax.enable_x64(False):
        colour, weight = (np.asarray(part)[0] for part in _observed(shot, None, _Places(points, np.zeros_like(points))))
    use = (weight > 0) & (colour > LEAST_DN) & (rgb[0] > LEAST_DN) & (rgb[0] < 250.0)
    gain = np.ones(3, np.float32)
    for k in range(3):
        ratio = rgb[0, k, use[k]] / colour[k, use[k]]
        if len(ratio) >= LEAST_COMMON:
            middle = len(ratio) // 2
            gain[k] = np.clip(np.partition(ratio, middle)[middle], 1 / MOST_GAIN, MOST_GAIN)
    return gain


def _weigh(
    view: View, distances: Distances, bearing: float | Float[Array, ""] | None, place: _Places
) -> tuple[Float[Array, "2"], Float[Array, ""]]:
    """Pixel of a point in a photograph, and its weight: at most 1, and 0 where it shows something else."""
    point, normal = place
    pose, camera, cell = view.T_scanner_cam, view.lens.camera, distances.cell
    (u, v), range_m, inside = seen = sight(view, point)
    cosine = jnp.where(dot(normal, normal) > 0, dot(normal, pose[:3, 3] - point) / range_m, UNKNOWN_FACING)
    # Whether something stands before the point, or so near its line of sight that their light could mix. A slanted
    # surface is nearer beside the point: within two cells by so much.
    facing = jnp.clip(cosine, 1 / STEEPEST_SEEN, 1.0)
    slope = jnp.sqrt(1 - facing * facing) / facing
    row, column = (jnp.floor((at + 0.5) / cell).astype(jnp.int32) + 1 for at in (v, u))
    # Places outside the image are looked up at its border, and do not count.
    before = jnp.asarray(distances.nearest).at[row, column].get(mode="clip")
    hidden = range_m * (1 - SKIN - 2 * cell * view.lens.per_pixel * slope) > before
    # Resolution on the surface, in both directions of the image; next to that, the distance from the middle of the
    # rig changes little.
    away = jnp.minimum(jnp.sqrt(dot(point, point)) / jnp.maximum(range_m, 1e-3), 2.0)
    weight = jnp.minimum(cosine, 1.0) * away * away * jnp.minimum(_rise(u, camera.width), _rise(v, camera.height))
    if bearing is not None:
        off = jnp.arctan2(pose[0, 2] * point[1] - pose[1, 2] * point[0], pose[0, 2] * point[0] + pose[1, 2] * point[1])
        weight = weight * jnp.exp(-0.5 * (off / bearing) ** 2)
    shown = inside & (cosine > 1 / STEEPEST_SEEN) & ~hidden
    return seen.q, jnp.where(shown, jnp.minimum(weight, 1.0), 0.0)


def _rise(place: Float[Array, ""], size: int) -> Float[Array, ""]:
    """From 0 at both ends of an axis of the image to 1, smoothly."""
    t = jnp.clip(jnp.minimum(place, size - 1 - place) / (FEATHER * size), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _observe(
    shot: _Shot, bearing: float | Float[Array, ""] | None, places: _Places
) -> tuple[Float[Array, "few 3 size"], Float[Array, "few size"]]:
    """Colours of points in a photograph as it shows them [DN], and their weights."""
    weigh = functools.partial(_weigh, shot.view, shot.distances, bearing)
    # Kept between the steps: XLA would weigh a point again for each of its pixels, and read those for each result.
    some = shot.view.lens.per_pixel > 0
    q, weight = kept(some, _each(weigh), places)
    colour, brightest = kept(some, _each(functools.partial(read_image, shot.image)), q)
    weight = jnp.where(brightest < SATURATED, weight, 0.0)
    # The place of a point that is not seen need not be a number.
    return _each(lambda colour, weight: jnp.where(weight > 0, colour, 0.0))(colour, weight), weight


def _each(function: Callable[..., Any]) -> Callable[..., Any]:
    """For points that come last, as components that lie side by side are read together: [few, ..., size]."""
    return jax.vmap(jax.vmap(function, -1, -1))


_observed = compile_wide(_observe, sooner=True)


@functools.partial(compile_wide, sooner=True)
def _looked_up(
    shot: _Shot,
    bearing: float | Float[Array, ""] | None,
    places: _Places,
    tally: Tally,
    tolerance: float | Float[Array, ""],
) -> tuple[Tally, Bool[Array, "few size"]]:
    """The tally of points after a photograph, and which of them it shows."""
    colour, weight = _observe(shot, bearing, places)

    def one(tally: Tally, colour: Float[Array, "3"], weight: Float[Array, ""]) -> Tally:
        return add(tally, colour * shot.gain, weight, tolerance)

    return _each(one)(tally, colour, weight), weight > 0
