"""What stands before what: the surface drawn into an image as distances, and points in compact blocks."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, UInt8, UInt32

from jaxscan.geometry import Array, Scanner
from jaxscan.photographs.photograph import Lens, PhotographView, sight
from jaxscan.photographs.surface import surface_samples
from jaxscan.reconstruction import PointCloud


LARGEST_BLOCK = 1 << 11
AT_ONCE = 16


@dataclass(frozen=True)
class Blocks:
    """An order of points, cut into blocks whose points lie close together."""

    order: Int[np.ndarray, " padded"]
    """Number of the point at each place of the order; the last one is repeated until the last block is full."""
    size: int
    count: int
    """Number of points, without repetitions."""
    centre: Float[np.ndarray, "blocks 3"]
    """Middle of each block [m]."""
    radius: Float[np.ndarray, " blocks"]
    """Distance of the block's farthest point from its middle [m]."""

    @staticmethod
    def of(points: Float[np.ndarray, "n 3"], largest: int = LARGEST_BLOCK) -> "Blocks":
        """Points [m] along a curve that fills space, cut into runs."""
        size, count = min(largest, 1 << max(len(points) - 1, 1).bit_length()), len(points)
        order = np.argsort(_along_curve(points), kind="stable")
        order = np.concatenate([order, np.repeat(order[-1:], -count % size)])
        grouped = points[order].reshape(-1, size, 3)
        centre = (grouped.min(1) + grouped.max(1)) / 2
        radius = np.linalg.norm(grouped - centre[:, None], axis=-1).max(1)
        return Blocks(order, size, count, centre, radius)

    def gather(self, field: np.ndarray) -> np.ndarray:
        """A field [n, components] of the points, block by block: [blocks, components, size]."""
        return np.ascontiguousarray(np.moveaxis(field[self.order].reshape(-1, self.size, field.shape[1]), 1, 2))

    def scatter(self, field: np.ndarray) -> np.ndarray:
        """The inverse of `gather`: a field in the order of the points."""
        flat = np.moveaxis(field, 1, 2).reshape(-1, field.shape[1])[: self.count]
        back = np.empty_like(flat)
        back[self.order[: self.count]] = flat
        return back

    def seen_from(self, pose: Float[np.ndarray, "4 4"], bounds: Float[np.ndarray, "2 3"]) -> list[np.ndarray]:
        """Numbers of blocks that may reach into a view, `AT_ONCE` at a time; bounds are those of `Lens`. The last group
        is padded by repetition, since any other size would have to be compiled.
        """
        way = self.centre - pose[:3, 3]
        distance = np.maximum(np.linalg.norm(way, axis=-1), 1e-9)
        reach = np.arcsin(np.clip(self.radius / distance, 0, 1))[:, None]
        away = np.arccos(np.clip(way @ pose[:3, :3] / distance[:, None], -1, 1))
        nearest, farthest = np.arccos(np.clip(bounds[::-1], -1, 1))
        beside = np.all((away + reach >= nearest) & (away - reach <= farthest), 1)
        seen = np.flatnonzero((distance <= self.radius) | beside)
        cuts = (seen[start : start + AT_ONCE] for start in range(0, len(seen), AT_ONCE))
        return [np.concatenate([few, np.repeat(few[-1:], AT_ONCE - len(few))]) for few in cuts]


def _along_curve(points: Float[np.ndarray, "n 3"]) -> UInt32[np.ndarray, " n"]:
    """Numbers of the cells in which points lie, along Morton's curve: the bits of the three coordinates take turns."""
    extent = max(float(np.ptp(points, axis=0).max()), 1e-9)
    cells = ((points - points.min(0)) * np.float32(1023 / extent)).astype(np.uint32)
    for shift, mask in ((16, 0xFF0000FF), (8, 0x0F00F00F), (4, 0xC30C30C3), (2, 0x49249249)):
        cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)
    return cells[:, 0] | (cells[:, 1] << np.uint32(1)) | (cells[:, 2] << np.uint32(2))


CELLS = 256
"""Cells of distance along the shorter side of an image."""
REFERENCES = 1 << 13


class Distances(NamedTuple):
    """Distances of the nearest surface in one view, in square cells of `cell` pixels."""

    nearest: Float[np.ndarray, "rows columns"]
    """Distance in each cell [m], inf where there is no surface; a border of one cell is around all."""
    cell: int

    @staticmethod
    def of_nothing() -> "Distances":
        """No surface anywhere."""
        return Distances(np.full((3, 3), np.inf, np.float32), 1 << 16)


@dataclass(frozen=True)
class Occluder:
    """The surface of a room, ready to be looked up in photographs; made once for a cloud by `make_occluder`."""

    surface: tuple[Blocks, Float[np.ndarray, "blocks 3 size"]] | None
    """Samples of the surface, block by block [m]; None where no surface is known."""
    references: tuple[Float[np.ndarray, "references 3"], Float[np.ndarray, "references 3"]]
    """Points all over the room, and their usual colours, from which exposures are equalised."""
    cell: int
    shape: tuple[int, int]
    """Rows and columns of cells, with a border of one."""

    @staticmethod
    def of_nothing(points: Float[np.ndarray, "references 3"], rgb: UInt8[np.ndarray, "references 3"]) -> "Occluder":
        """No surface, only places whose usual colours are known."""
        return Occluder(None, (points.astype(np.float32), rgb.astype(np.float32)), 1 << 16, (3, 3))

    def distances(self, view: PhotographView) -> Distances:
        """The surface in one view."""
        nearest = np.full(self.shape, np.inf, np.float32)
        if self.surface is not None:
            blocks, points = self.surface
            for few in blocks.seen_from(np.asarray(view.T_scanner_cam), np.asarray(view.lens.bounds)):
                cell, range_m = (np.asarray(part) for part in _first_cells(view, points[few], self.cell, self.shape[1]))
                np.minimum.at(nearest.reshape(-1), cell, range_m)
        return Distances(_spread(nearest), self.cell)


def make_occluder(cloud: PointCloud, scanner: Scanner) -> Occluder:
    """The surface of an organised cloud.

    Args:
        cloud: Points on the grid [profile, line], scanner frame, with the colours of their stripes.
        scanner: The rig that took it.

    Returns:
        What may stand before points.

    Raises:
        CloudError: If the cloud has no grid.
    """
    camera = scanner.camera
    cell = max(2, round(min(camera.width, camera.height) / CELLS))
    spacing = cell * float(Lens.of(camera).per_pixel)
    # Nothing behind a surface's largest possible extent counts as seen, so that foreground does not bleed into walls.
    found = [(samples.xyz, samples.rgb) for samples in surface_samples(cloud, scanner, spacing, reach=1.0)]
    xyz, rgb = (np.concatenate(parts) for parts in zip(*found, strict=True))
    if not len(xyz):
        # No two points make a face, so each stands alone.
        there = np.asarray(cloud.valid)
        xyz, rgb = np.asarray(cloud.xyz)[there], np.asarray(cloud.rgb)[there]
    blocks = Blocks.of(xyz)
    chosen = np.linspace(0, len(xyz) - 1, REFERENCES).astype(int)
    shape = -(-camera.height // cell) + 2, -(-camera.width // cell) + 2
    return Occluder((blocks, blocks.gather(xyz)), (xyz[chosen], rgb[chosen]), cell, shape)


@jax.jit
def _first_cells(
    view: PhotographView, points: Float[Array, "few 3 size"], cell: int | Int[Array, ""], columns: int | Int[Array, ""]
) -> tuple[Int[Array, "few size"], Float[Array, "few size"]]:
    """Number of the first of the four cells that each sample covers, two on each axis, and its distance [m].

    Samples outside the image are infinitely far behind the corner of the border.
    """
    q, range_m, inside = jax.vmap(jax.vmap(sight, (None, 1)), (None, 0))(view, points)
    column, row = (jnp.floor((q[..., k] + 0.5) / cell - 0.5).astype(jnp.int32) + 1 for k in range(2))
    return jnp.where(inside, row * columns + column, 0), jnp.where(inside, range_m, jnp.inf)


def _spread(nearest: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Enter every sample in its own cell and in the next ones to the right and below."""
    for target, source in ((nearest[1:], nearest[:-1]), (nearest[:, 1:], nearest[:, :-1])):
        np.minimum(target, source.copy(), out=target)
    return nearest
