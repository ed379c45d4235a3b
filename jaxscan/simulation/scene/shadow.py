"""Shadows of the lamp: where no edge stands between it and a small part of a plane, no shadow ends there."""

from functools import cached_property

import numpy as np

from jaxscan.simulation.scene.edges import Cone, Outline, points_on


_SIDE = 384
"""Cells along each side of the cube round the lamp."""
_RIM = 3
"""Cells at the sides of its faces are never called clear: their neighbours lie on other faces."""


class LampView:
    """The nearest edges that the lamp sees, in cells of a cube round it; found when they are first asked for."""

    def __init__(self, outline: Outline, lamp: np.ndarray) -> None:
        self._outline, self._lamp = outline, lamp

    @cached_property
    def _nearest(self) -> np.ndarray:
        """Distance of the nearest edge in each cell or beside it [m], float32 [6 side^2]; inf where there is none."""
        # In a cube's corner a cell is seen under a third of its angle in the middle of a face.
        every = Cone(np.array([0.0, 0.0, 1.0]), np.pi)
        legs = points_on(self._outline.edges, self._lamp, 0.3 * 2 / _SIDE, every) - self._lamp
        far = np.linalg.norm(legs, axis=-1).astype(np.float32)
        face, (u, v) = _on_cube([np.ascontiguousarray(part) for part in legs.T])
        cells = np.full((6, _SIDE, _SIDE), np.inf, np.float32)
        for du in (-0.5, 0.5):
            for dv in (-0.5, 0.5):
                at = (np.clip(np.floor(place + shift), 0, _SIDE - 1).astype(int) for place, shift in ((u, du), (v, dv)))
                np.minimum.at(cells, (face, *at), far)
        for axis in (1, 2):
            wide = np.pad(cells, [(int(other == axis),) * 2 for other in range(3)], constant_values=np.inf)
            parts = (wide.take(np.arange(_SIDE) + shift, axis) for shift in range(3))
            cells = np.minimum.reduce(list(parts))
        return cells.ravel()

    def clear(self, legs: list[np.ndarray]) -> np.ndarray:
        """Whether no shadow can end within flat quads, bool [n].

        Args:
            legs: Ways x, y, z from the lamp to their corners, each [n, 4], m.
        """
        face, places = _on_cube(legs)
        cells = [place.astype(np.int32) for place in places]
        far = np.sqrt(legs[0] ** 2 + legs[1] ** 2 + legs[2] ** 2)
        nearest = self._nearest[
            (face * _SIDE + np.minimum(cells[0], _SIDE - 1)) * _SIDE + np.minimum(cells[1], _SIDE - 1)
        ]
        found = (face.min(1) == face.max(1)) & (nearest.min(1) > far.max(1))
        for cell in cells:
            # Neighbours of the corners' cells cover a quad that reaches over three.
            low, high = cell.min(1), cell.max(1)
            found &= (high - low <= 2) & (low >= _RIM) & (high < _SIDE - _RIM)
        return found


def _on_cube(legs: list[np.ndarray]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Face of a cube, and place in it in cells, that directions x, y, z meet."""
    x, y, z = legs
    ax, ay, az = np.abs(x), np.abs(y), np.abs(z)
    along_z, along_y = az >= np.maximum(ax, ay), ay >= ax
    main = np.where(along_z, z, np.where(along_y, y, x))
    face = np.where(along_z, 4, np.where(along_y, 2, 0)) + (main < 0)
    scale = 0.5 * _SIDE / np.maximum(np.abs(main), 1e-9)
    first = np.where(along_z | along_y, x, y)
    second = np.where(along_z, y, z)
    return face, [place * scale + 0.5 * _SIDE for place in (first, second)]
