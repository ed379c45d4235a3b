"""Points in blocks of one size, each as compact as can be, so that a view looks at few that it does not see."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt32


LARGEST_BLOCK = 1 << 11
AT_ONCE = 16
"""Blocks that are projected by one call."""


@dataclass(frozen=True)
class Blocks:
    """An order of points, by which consecutive runs lie close together."""

    order: Int[np.ndarray, " padded"]
    """Which point; the last one is repeated until the last block is full."""
    size: int
    count: int
    """Points, without repetitions."""
    centre: Float[np.ndarray, "blocks 3"]
    """Middle of each block [m]."""
    radius: Float[np.ndarray, " blocks"]
    """Distance of its farthest point from there [m]."""

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
        """The way back of `gather`, in the order of the points."""
        flat = np.moveaxis(field, 1, 2).reshape(-1, field.shape[1])[: self.count]
        back = np.empty_like(flat)
        back[self.order[: self.count]] = flat
        return back

    def seen_from(self, pose: Float[np.ndarray, "4 4"], bounds: Float[np.ndarray, "2 3"]) -> list[np.ndarray]:
        """Numbers of blocks that may reach into a view, `AT_ONCE` at a time.

        The last of them are given again and again until there are as many, or each number of them would be compiled.

        Args:
            pose: Of the camera.
            bounds: Least and largest component of its rays on each of its axes.
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
    """Numbers of the cells in which points lie, by the curve of Morton: the bits of the three places take turns."""
    extent = max(float(np.ptp(points, axis=0).max()), 1e-9)
    cells = ((points - points.min(0)) * np.float32(1023 / extent)).astype(np.uint32)
    for shift, mask in ((16, 0xFF0000FF), (8, 0x0F00F00F), (4, 0xC30C30C3), (2, 0x49249249)):
        cells = (cells | (cells << np.uint32(shift))) & np.uint32(mask)
    return cells[:, 0] | (cells[:, 1] << np.uint32(1)) | (cells[:, 2] << np.uint32(2))
