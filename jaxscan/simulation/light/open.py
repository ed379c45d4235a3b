"""Where the laser's fan meets edges: between their angles in it, no shadow of the laser ends on a facet."""

import math

import numpy as np

from jaxscan.simulation.light.fan import band
from jaxscan.simulation.light.lit import LitScene


_CELLS = 4096
"""Over the fan, in angle."""


class FanView:
    """The nearest edges that the laser's fan meets, in cells of angle."""

    def __init__(self, shot: LitScene) -> None:
        sheet = shot.sheet
        self._sheet, self._half = sheet, math.radians(sheet.spec.fan_deg) / 2
        edges, origin = shot.scene.outline.edges, shot.pose.apply(sheet.origin)
        normal = shot.pose.turn(sheet.normal)
        out = np.einsum("nij,j->ni", edges, normal) - normal @ origin
        # How thick the lit band can be at all, with its bow.
        far = shot.scene.outline.farthest(origin)
        thick = float(max(sheet.thickness(np.array([0.0, far])))) * band(sheet) * (1 + sheet.spec.widening)
        thick += (far + float(np.linalg.norm(sheet.origin))) * sheet.bulge
        near = (out.min(1) <= thick) & (out.max(1) >= -thick)
        legs, out = shot.pose.inverse().turn(edges[near] - origin), out[near]
        step = out[:, 1] - out[:, 0]
        step = np.where(np.abs(step) < 1e-12, 1e-12, step)
        shares = np.sort((np.array([-thick, thick]) - out[:, :1]) / step[:, None], 1).clip(0, 1)
        ends = legs[:, None, 0] + shares[..., None] * (legs[:, None, 1] - legs[:, None, 0])
        angle = sheet.angle(ends)
        low, high = np.sort(self._cell(angle), 1).T
        # A part of an edge that passes behind the laser lies outside both ends, not between them.
        behind = np.abs(angle[:, 1] - angle[:, 0]) > np.pi
        low, high = np.where(behind, 0, low), np.where(behind, _CELLS - 1, high)
        # No point of an edge is nearer than its nearer end by more than its length.
        distance = np.linalg.norm(ends, axis=-1).min(1) - np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)
        low, high = np.maximum(low - 1, 0), np.minimum(high + 1, _CELLS - 1)
        counts = np.maximum(high - low + 1, 0)
        which = np.arange(len(counts)).repeat(counts)
        cells = low[which] + np.arange(len(which)) - (np.cumsum(counts) - counts)[which]
        self._nearest = np.full(_CELLS, np.inf, np.float32)
        np.minimum.at(self._nearest, cells, distance[which].astype(np.float32))

    def clear(self, first: np.ndarray, last: np.ndarray, far: np.ndarray) -> np.ndarray:
        """Whether no shadow can end between pairs of angles in the fan [rad], up to a distance [m] of the laser."""
        low, high = self._cell(first), self._cell(last)
        inside = (low >= 0) & (high < _CELLS) & (high - low <= 2)
        low, high = (np.clip(cell, 0, _CELLS - 1) for cell in (low, high))
        return inside & (self._nearest[low] > far) & (self._nearest[high] > far)

    def _cell(self, angle: np.ndarray) -> np.ndarray:
        return np.floor((angle + self._half) * (_CELLS / (2 * self._half))).astype(np.int64)
