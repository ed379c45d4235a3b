"""Colours of points from all photographs that see them sharply."""

import functools
import itertools
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, UInt8, UInt32

from jaxscan.geometry import Array, Scanner
from jaxscan.photographs.blend import Tally, conclude, tally_all
from jaxscan.photographs.blocks import Blocks
from jaxscan.photographs.occluder import STEEPEST_SEEN, Distances, Occluder, facing, hidden
from jaxscan.photographs.photograph import Photograph, Photographs
from jaxscan.photographs.view import Lens, View, packed, poses, sample, sight
from jaxscan.reconstruction.ahead import map_ahead, workers


class BlendSettings(NamedTuple):
    """How observations of a point are blended."""

    tolerance_dn: float = 20.0
    """Colours of a point that differ by more are not mixed."""
    bearing: float = np.inf
    """Standard deviation [rad] of the weight by the angle about the axis between a point and the middle of the
    photograph: few photographs for each point where their places are not known well."""
    exposure: bool = True
    """Whether exposures are equalised."""


DEFAULT_BLEND = BlendSettings()


class _Places(NamedTuple):
    """A block of points."""

    points: Float[Array, "block 3"]
    normals: Float[Array, "block 3"]


class _Shot(NamedTuple):
    """A photograph, and all that is known about it."""

    image: UInt32[Array, "rows columns"]
    view: View
    distances: Distances
    gain: Float[Array, "3"]


def colour_points(
    photographs: Photographs,
    points: Float[np.ndarray, "n 3"],
    normals: Float[np.ndarray, "n 3"],
    occluder: Occluder | None = None,
    *,
    start: UInt8[np.ndarray, "n 3"] | None = None,
    settings: BlendSettings = DEFAULT_BLEND,
) -> tuple[UInt8[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """The colour of each point, blended of all photographs that show it.

    Each photograph is held once, and all points that it may show are looked up in it. It counts for a point by how
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
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = (np.asarray(normals) / np.maximum(lengths, 1e-12)).astype(np.float32)
    # Single precision throughout, so that the result does not depend on the caller's setting.
    with jax.enable_x64(False), ThreadPoolExecutor(workers()) as pool:
        lens, blocks = Lens.of(photographs.scanner.camera), Blocks.of(points)
        places = [_Places(*both) for both in zip(blocks.gather(points), blocks.gather(unit), strict=True)]
        first = Tally.start(start, len(points))
        tallies = [Tally(*both) for both in zip(*(blocks.gather(np.asarray(part)) for part in first), strict=True)]
        seen = [jnp.zeros(blocks.size, jnp.bool_) for _ in places]
        del first
        numbers = np.array([settings.tolerance_dn, settings.bearing], np.float32)

        def prepare(photograph: Photograph) -> _Shot:
            shot = _prepared(photograph, lens, photographs.scanner, occluder)
            if occluder is None or not settings.exposure:
                return shot
            with jax.enable_x64(False):
                return shot._replace(gain=_gain(shot, *occluder.references))

        def look(block: int, shot: _Shot) -> None:
            # JAX keeps this setting per thread.
            with jax.enable_x64(False):
                tallies[block], seen[block] = _look(tallies[block], seen[block], places[block], shot, numbers)

        # While points are looked up in one photograph, the next one is prepared.
        for shot in map_ahead(prepare, photographs, 1):
            visible = blocks.seen_from(np.asarray(shot.view.T_scanner_cam), float(lens.least_cosine))
            for _ in pool.map(look, visible.tolist(), itertools.repeat(shot)):
                pass
        every = Tally(*(np.concatenate(part) for part in zip(*tallies, strict=True)))
        rgb = conclude(every, settings.tolerance_dn)
        return blocks.scatter(rgb), blocks.scatter(np.concatenate([np.asarray(part) for part in seen]))


def _prepared(photograph: Photograph, lens: Lens, scanner: Scanner, occluder: Occluder | None) -> _Shot:
    """A photograph with the surfaces in it, not yet equalised."""
    with jax.enable_x64(False):
        view = View(lens, poses(scanner, np.array([photograph.angle]))[0])
        distances = Distances.of_nothing() if occluder is None else occluder.distances(view)
        return _Shot(packed(photograph.image), view, distances, jnp.ones(3, jnp.float32))


LEAST_COMMON = 50
"""Points by which an exposure is equalised, at the least."""
LEAST_DN = 12.0
"""Darker colours say nothing about an exposure."""
MOST_GAIN = 4.0


@jax.jit
def _gain(shot: _Shot, points: Float[Array, "n 3"], rgb: Float[Array, "n 3"]) -> Float[Array, "3"]:
    """Factor for each colour that takes a photograph to the exposure of the stripes around it.

    The stripes in a photograph are from photographs on both sides of it, so that errors do not add up along a turn.
    """
    colour, weight = jax.vmap(_observe, (None, 0, 0, None))(shot, points, jnp.zeros_like(points), jnp.float32(jnp.inf))
    use = (weight > 0)[:, None] & (colour > LEAST_DN) & (rgb > LEAST_DN) & (rgb < 250.0)
    ratio = jnp.sort(jnp.where(use, rgb / jnp.maximum(colour, 1e-3), jnp.inf), 0)
    count = jnp.sum(use, 0)
    median = jnp.take_along_axis(ratio, (count // 2)[None, :], 0)[0]
    return jnp.where(count >= LEAST_COMMON, jnp.clip(median, 1 / MOST_GAIN, MOST_GAIN), 1.0)


@functools.partial(jax.jit, donate_argnums=(0, 1))
def _look(tally: Tally, seen: Array, places: _Places, shot: _Shot, numbers: Float[Array, "2"]) -> tuple[Tally, Array]:
    """One photograph for a block of points."""
    tolerance, bearing = numbers[0], numbers[1]
    colour, weight = jax.vmap(_observe, (None, 0, 0, None))(shot, places.points, places.normals, bearing)
    return tally_all(tally, colour * shot.gain[None, :], weight, tolerance), seen | (weight > 0)


FEATHER = 0.15
"""Share of the image, on each side, over which the weight rises from its border."""


def _observe(
    shot: _Shot, point: Float[Array, "3"], normal: Float[Array, "3"], bearing: Float[Array, ""]
) -> tuple[Float[Array, "3"], Float[Array, ""]]:
    """Colour of a point in a photograph [DN], and its weight: at most 1, and 0 where it shows something else."""
    view = shot.view
    seen = sight(view, point)
    colour, sound = sample(shot.image, seen.q)
    cosine = facing(point, normal, view)
    rows, columns = shot.image.shape
    edge = jnp.minimum(_rise(seen.q[0], columns), _rise(seen.q[1], rows))
    # Resolution on the surface, in both directions of the image; next to that, the distance from the middle of the rig
    # changes little.
    away = jnp.sqrt(jnp.sum(point * point)) / jnp.maximum(seen.range_m, 1e-3)
    weight = jnp.clip(cosine, 0.0, 1.0) * jnp.minimum(away, 2.0) ** 2 * edge * _ahead(point, view, bearing)
    shown = seen.inside & sound & (cosine > 1 / STEEPEST_SEEN) & ~hidden(seen, point, normal, view, shot.distances)
    return colour, jnp.where(shown, jnp.minimum(weight, 1.0), 0.0)


def _rise(place: Array, size: int) -> Array:
    """From 0 at both ends of an axis of the image to 1, smoothly."""
    t = jnp.clip(jnp.minimum(place, size - 1 - place) / (FEATHER * size), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _ahead(point: Array, view: View, bearing: Array) -> Array:
    """Weight by the angle about the axis between a point and the middle of the photograph."""
    ahead, way = view.T_scanner_cam[:2, 2], point[:2]
    cross, dot = ahead[0] * way[1] - ahead[1] * way[0], jnp.sum(ahead * way)
    return jnp.exp(-0.5 * (jnp.arctan2(cross, dot) / bearing) ** 2)
