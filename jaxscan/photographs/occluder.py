"""Hidden places: the surface of a cloud, drawn as distances into each photograph."""

import functools
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, UInt8

from jaxscan.geometry import Array, Scanner
from jaxscan.photographs.blocks import Blocks
from jaxscan.photographs.surface import surface_samples
from jaxscan.photographs.view import Lens, View, sight
from jaxscan.reconstruction import PointCloud


CELLS = 256
"""Cells of distance along the shorter side of an image."""
REFERENCES = 1 << 13


class Distances(NamedTuple):
    """Distances of the nearest surface in one view, cell by cell."""

    nearest: Float[np.ndarray, "rows columns"]
    """[m]; inf where there is none. With a border of one cell."""
    cell: int
    """Side of a cell [px]."""

    @staticmethod
    def of_nothing() -> "Distances":
        """No surface anywhere."""
        return Distances(np.full((3, 3), np.inf, np.float32), 1 << 16)


@dataclass(frozen=True)
class Occluder:
    """The surface of a room as photographs of it need it; made once for a cloud by `make_occluder`."""

    surface: tuple[Blocks, list[Array]] | None
    """Samples of the surface, block by block [m]; None where nothing is known to stand anywhere."""
    references: tuple[Float[np.ndarray, "references 3"], Float[np.ndarray, "references 3"]]
    """Points all over the room, and their usual colours: by these, exposures are equalised."""
    cell: int
    shape: tuple[int, int]
    """Rows and columns of cells, with a border of one."""

    @staticmethod
    def of_nothing(points: Float[np.ndarray, "references 3"], rgb: UInt8[np.ndarray, "references 3"]) -> "Occluder":
        """No surface, only places whose usual colours are known."""
        return Occluder(None, (points.astype(np.float32), rgb.astype(np.float32)), 1 << 16, (3, 3))

    def distances(self, view: View) -> Distances:
        """The surface in one view."""
        nearest, cell = jnp.full(self.shape, jnp.inf, jnp.float32), np.asarray(self.cell, np.float32)
        if self.surface is not None:
            blocks, parts = self.surface
            for block in blocks.seen_from(np.asarray(view.T_scanner_cam), float(view.lens.least_cosine)):
                nearest = _draw(nearest, view, parts[block], cell)
        return Distances(np.asarray(_spread(nearest)), self.cell)


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
    # Wherever a surface may reach, nothing behind it counts as seen: what stands before a wall does not bleed into it.
    found = [(samples.xyz, samples.rgb) for samples in surface_samples(cloud, scanner, spacing, reach=1.0)]
    xyz, rgb = (np.concatenate(parts) for parts in zip(*found, strict=True))
    blocks = Blocks.of(xyz)
    chosen = np.linspace(0, len(xyz) - 1, REFERENCES).astype(int)
    shape = -(-camera.height // cell) + 2, -(-camera.width // cell) + 2
    parts: list[Array] = [jnp.asarray(part) for part in blocks.gather(xyz)]
    return Occluder((blocks, parts), (xyz[chosen], rgb[chosen]), cell, shape)


@functools.partial(jax.jit, donate_argnums=0)
def _draw(nearest: Array, view: View, points: Float[Array, "block 3"], cell: Array) -> Array:
    seen = jax.vmap(sight, (None, 0))(view, points)
    # Each sample covers the two cells beside it on each axis: see `_spread`.
    column, row = jnp.floor((seen.q + 0.5) / cell - 0.5).astype(jnp.int32).T + 1
    outside = jnp.asarray(nearest.shape[0], jnp.int32)
    return jnp.asarray(nearest).at[jnp.where(seen.inside, row, outside), column].min(seen.range_m, mode="drop")


@jax.jit
def _spread(nearest: Array) -> Array:
    """Every sample in its own cell and in the next ones to the right and below."""
    down = jnp.minimum(nearest, jnp.pad(nearest[:-1], ((1, 0), (0, 0)), constant_values=jnp.inf))
    return jnp.minimum(down, jnp.pad(down[:, :-1], ((0, 0), (1, 0)), constant_values=jnp.inf))
