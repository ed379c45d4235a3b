"""Shadows of the lamp: where no edge stands between it and a small part of a plane, no shadow ends there."""

from functools import cached_property

import numpy as np

from jaxscan.simulation.scene.edges import Cone, Outline, points_on


_SIDES = 384, 192, 96
"""Cells along each side of the cube round the lamp: large parts are looked up in large cells."""
_RIM = 3
"""Cells at the sides of its faces are never called clear: their neighbours lie on other faces."""


class LampView:
    """The nearest edges that the lamp sees, in cells of a cube round it; found when they are first asked for."""

    def __init__(self, outline: Outline, lamp: np.ndarray) -> None:
        self._outline, self._lamp = outline, lamp

    @cached_property
    def _nearest(self) -> list[np.ndarray]:
        """Distance of the nearest edge in each cell or beside it [m], float32 [6 side^2]; inf where there is none."""
        # In a cube's corner a cell is seen under a third of its angle in the middle of a face.
        every, side = Cone(np.array([0.0, 0.0, 1.0]), np.pi), _SIDES[0]
        legs = points_on(self._outline.edges, self._lamp, 0.3 * 2 / side, every) - self._lamp
        far = np.linalg.norm(legs, axis=-1).astype(np.float32)
        face, places = _on_cube([np.ascontiguousarray(part) for part in legs.T])
        u, v = (0.5 * side * (place + 1) for place in places)
        cells = np.full((6, side, side), np.inf, np.float32)
        for du in (-0.5, 0.5):
            for dv in (-0.5, 0.5):
                at = (np.clip(np.floor(place + shift), 0, side - 1).astype(int) for place, shift in ((u, du), (v, dv)))
                np.minimum.at(cells, (face, *at), far)
        by_side = (cells.reshape(6, n, side // n, n, side // n).min((2, 4)) for n in _SIDES)
        return [_widened(part).ravel() for part in by_side]

    def clear(self, legs: list[np.ndarray]) -> np.ndarray:
        """Whether no shadow can end within flat quads, bool [n].

        Args:
            legs: Ways x, y, z from the lamp to their corners, each [n, 4], m.
        """
        face, places = _on_cube(legs)
        far = np.sqrt(legs[0] ** 2 + legs[1] ** 2 + legs[2] ** 2).max(1)
        alike, found = face.min(1) == face.max(1), np.zeros(len(far), bool)
        for side, nearest in zip(_SIDES, self._nearest, strict=True):
            cells = [np.minimum((0.5 * side * (place + 1)).astype(np.int32), side - 1) for place in places]
            here = alike & (nearest[(face * side + cells[0]) * side + cells[1]].min(1) > far)
            for cell in cells:
                # Neighbours of the corners' cells cover a quad that reaches over three.
                low, high = cell.min(1), cell.max(1)
                here &= (high - low <= 2) & (low >= _RIM) & (high < side - _RIM)
            found |= here
        return found


def _widened(cells: np.ndarray) -> np.ndarray:
    """The least of each cell and those beside it, [6, side, side]."""
    for axis in (1, 2):
        wide = np.pad(cells, [(int(other == axis),) * 2 for other in range(3)], constant_values=np.inf)
        cells = np.minimum.reduce([wide.take(np.arange(cells.shape[axis]) + shift, axis) for shift in range(3)])
    return cells


def _on_cube(legs: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Face of a cube, and place in it (-1 ... 1), that directions x, y, z meet."""
    x, y, z = legs
    ax, ay, az = np.abs(x), np.abs(y), np.abs(z)
    along_z, along_y = az >= np.maximum(ax, ay), ay >= ax
    main = np.where(along_z, z, np.where(along_y, y, x))
    face = np.where(along_z, 4, np.where(along_y, 2, 0)) + (main < 0)
    scale = 1 / np.maximum(np.abs(main), 1e-9)
    first = np.where(along_z | along_y, x, y)
    second = np.where(along_z, y, z)
    return face, [place * scale for place in (first, second)]
