"""Colours of points from all photographs that see them sharply."""

import itertools
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxscan.photographs.blend import Tally, conclude
from jaxscan.photographs.blocks import Blocks
from jaxscan.photographs.occluder import Distances, Occluder
from jaxscan.photographs.photograph import Photograph, Photographs
from jaxscan.photographs.view import Lens, View, pose_finder, sights
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
    """Points, and their unit normals; zero where there is none."""

    points: Float[np.ndarray, "*n 3"]
    normals: Float[np.ndarray, "*n 3"]


class _Shot(NamedTuple):
    """A photograph, and all that is known about it."""

    angle: float
    image: UInt8[np.ndarray, "rows columns 3"]
    view: View
    distances: Distances
    gain: Float[np.ndarray, "3"]


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
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    unit = (np.asarray(normals) / np.maximum(lengths, 1e-12)).astype(np.float32)
    # Single precision throughout, so that the result does not depend on the caller's setting.
    with jax.enable_x64(False), ThreadPoolExecutor(workers()) as pool:
        lens, blocks = Lens.of(photographs.scanner.camera), Blocks.of(points)
        pose_at = pose_finder(photographs.scanner)
        places = _Places(blocks.gather(points), blocks.gather(unit))
        tally = Tally.start(blocks.gather(np.zeros((len(points), 3), np.uint8) if start is None else start))
        seen = np.zeros(tally.weight.shape[:2], np.bool_)

        def prepare(photograph: Photograph) -> _Shot:
            shot = _prepared(photograph, lens, pose_at(photograph.angle), occluder)
            return shot if occluder is None or not settings.exposure else shot._replace(gain=_gain(shot, occluder))

        def look(few: np.ndarray, shot: _Shot) -> None:
            padded = _Places(*(blocks.taken(field, few) for field in places))
            colours, weights = _observed(shot, padded, settings.bearing)
            for number, block in enumerate(few):
                mine = slice(number * blocks.size, (number + 1) * blocks.size)
                found = colours[mine], weights[mine]
                _add(found, shot.gain, settings.tolerance_dn, (tally.total[block], tally.weight[block]))
                seen[block] |= weights[mine] > 0

        def visible(angle: float) -> list[np.ndarray]:
            return blocks.seen_from(pose_at(angle), float(lens.least_cosine))

        # While points are looked up in one photograph, the next one is prepared.
        shots = photographs.where(lambda angle: len(visible(angle)) > 0)
        for shot in map_ahead(prepare, shots, 1):
            for _ in pool.map(look, visible(shot.angle), itertools.repeat(shot)):
                pass
        each = pool.map(lambda part: conclude(Tally(*part), settings.tolerance_dn), zip(*tally, strict=True))
        return blocks.scatter(np.stack(list(each))), blocks.scatter(seen)


def _prepared(photograph: Photograph, lens: Lens, pose: np.ndarray, occluder: Occluder | None) -> _Shot:
    """A photograph with the surfaces in it, not yet equalised."""
    # JAX keeps this setting per thread.
    with jax.enable_x64(False):
        # On the device: it is handed to many calls.
        view = jax.device_put(View(lens, pose))
        distances = Distances.of_nothing() if occluder is None else occluder.distances(view)
    return _Shot(photograph.angle, np.ascontiguousarray(photograph.image), view, distances, np.ones(3, np.float32))


LEAST_COMMON = 50
"""Points by which an exposure is equalised, at the least."""
LEAST_DN = 12.0
"""Darker colours say nothing about an exposure."""
MOST_GAIN = 4.0


def _gain(shot: _Shot, occluder: Occluder) -> Float[np.ndarray, "3"]:
    """Factor for each colour that takes a photograph to the exposure of the stripes around it.

    The stripes in a photograph are from photographs on both sides of it, so that errors do not add up along a turn.
    """
    points, rgb = occluder.references
    colour, weight = _observed(shot, _Places(points, np.zeros_like(points)), np.inf)
    use = (weight > 0)[:, None] & (colour > LEAST_DN) & (rgb > LEAST_DN) & (rgb < 250.0)
    gain = np.ones(3, np.float32)
    for k in range(3):
        ratio = rgb[use[:, k], k] / colour[use[:, k], k]
        if len(ratio) >= LEAST_COMMON:
            middle = len(ratio) // 2
            gain[k] = np.clip(np.partition(ratio, middle)[middle], 1 / MOST_GAIN, MOST_GAIN)
    return gain


def _observed(shot: _Shot, places: _Places, bearing: float) -> tuple[np.ndarray, np.ndarray]:
    """Colours of points in a photograph [DN], and their weights: 0 where it shows something else."""
    # Here, because it loads numba: whoever reads no colours does not wait for that.
    from jaxscan.photographs.native_loops import observe

    with jax.enable_x64(False):
        seen = tuple(np.asarray(part) for part in sights(shot.view, places.points))
    found = np.empty(places.points.shape, np.float32), np.empty(len(places.points), np.float32)
    rules = shot.distances.nearest, shot.distances.cell, float(shot.view.lens.per_pixel), float(bearing)
    observe(shot.image, tuple(places), seen, np.asarray(shot.view.T_scanner_cam), rules, found)
    return found


def _add(found: tuple[np.ndarray, np.ndarray], gain: np.ndarray, tolerance: float, tally: tuple) -> None:
    from jaxscan.photographs.native_loops import add

    add(found, gain, float(tolerance), tally)
