"""An adjustment between its rounds, and at its end."""

from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.solve import noise_component
from jaxscan.recalibration.adjust.noise import Noise
from jaxscan.recalibration.adjust.prepare import Prepared
from jaxscan.recalibration.adjust.room import Room, Unknowns
from jaxscan.recalibration.adjust.solver import Covariance, Linearised, covariance_of
from jaxscan.recalibration.observed import RoomObservations


@dataclass(frozen=True)
class State:
    """An adjustment between its rounds; arrays as long as the observations, without padding."""

    prepared: Prepared
    observations: RoomObservations
    y: Unknowns
    linearised: Linearised
    kept: Bool[np.ndarray, " points"]
    sighting_kept: Bool[np.ndarray, " sightings"]
    noise: Noise
    sighting_noise: float = 1.0
    """Over the given sigmas [1]."""
    inflation: float = 1.0
    """Of the variance of points, because neighbours share errors [1]."""
    steps: int = 0
    converged: bool = False

    @property
    def surface(self) -> Int[np.ndarray, " points"]:
        """Surface of every point."""
        return np.asarray(self.observations.points.surface)

    @property
    def error_px(self) -> Float[np.ndarray, " points"]:
        """Seen minus predicted centres [px]."""
        return self.linearised.points.rows.value[: len(self.kept)]

    @property
    def reach(self) -> Float[np.ndarray, " points"]:
        """Size of the change of the distance from the surface by one pixel [m / px]."""
        return np.maximum(np.abs(self.linearised.points.reach[: len(self.kept)]), 1e-7)

    @property
    def error(self) -> Float[np.ndarray, " points"]:
        """Distances from the surfaces [m]."""
        return self.error_px * self.linearised.points.reach[: len(self.kept)]

    @property
    def given_px(self) -> Float[np.ndarray, " points"]:
        """Given standard deviations of the centres [px]; 1 where there is none."""
        return np.where(self.prepared.usable, self.observations.points.sigma, 1.0)

    @property
    def sigma_px(self) -> Float[np.ndarray, " points"]:
        """Standard deviation of the centres by noise and roughness [px]."""
        return self.noise.sigma(self.given_px, self.reach)

    def whitened(self) -> Float[np.ndarray, " points"]:
        """Errors over their standard deviations; 0 where there is none."""
        return np.where(self.prepared.usable, self.error_px / self.sigma_px, 0.0)

    def sighting_error(self) -> Float[np.ndarray, "sightings 2"]:
        """Projected minus seen [px]."""
        return self.linearised.sightings.value.reshape(-1, 2)[: len(self.sighting_kept)]

    def sighting_sigma(self) -> Float[np.ndarray, " sightings"]:
        """Given sigmas [px]; 1 where there is none."""
        tracks = self.observations.tracks
        given = np.zeros(0) if tracks is None else tracks.sigma
        return np.where(self.prepared.seen, given, 1.0)

    def sighting_whitened(self) -> Float[np.ndarray, "sightings 2"]:
        """Errors of sightings over the given sigmas; 0 where there is none."""
        return np.where(self.prepared.seen[:, None], self.sighting_error() / self.sighting_sigma()[:, None], 0.0)

    @cached_property
    def covariance(self) -> Covariance:
        """Of the unknowns, if this is the minimum."""
        return covariance_of(self.linearised.blocks)

    @cached_property
    def _free(self) -> float:
        """Dense unknowns that the data determine rather than the prior."""
        count = len(self.y.scanner)
        scanner = self.covariance.dense[:count, :count]
        return float(np.sum(1.0 - np.clip(np.diag(scanner), 0.0, 1.0))) + len(self.y.stations)

    def redundancy(self) -> Float[np.ndarray, " points"]:
        """Share of each error that the fit leaves [1]; the same for all points of a surface."""
        count = np.bincount(self.surface[self.kept], minlength=len(self.observations.surfaces.kind))
        every = max(int(self.kept.sum()), 1)
        return np.clip(1.0 - 3.0 / np.maximum(count, 1)[self.surface] - self._free / every, 0.05, 1.0)

    def learned_sighting_noise(self) -> float:
        """Noise of the kept sightings over the given sigmas [1]."""
        kept = self.sighting_kept
        if not kept.any():
            return 1.0
        tracks = self.observations.tracks
        points = len(np.unique(tracks.track[kept])) if tracks is not None else 0
        values = self.sighting_whitened()[kept].ravel()
        return noise_component(values, np.full(len(values), min(3.0 * points / len(values), 0.9)))

    def in_surface(self) -> Float[np.ndarray, "points 2"]:
        """Coordinates of every point in its plane [m]."""
        return self.linearised.points.place[: len(self.kept)]

    def weighted(self, points: np.ndarray | float, sightings: np.ndarray | float) -> Room:
        """The problem with weights by the present noise, damped by factors of points and sightings."""
        room = self.prepared.room
        point = np.zeros(len(room.point_weight))
        point[: len(self.kept)] = self.kept * points / (self.sigma_px * np.sqrt(self.inflation))
        sighting = np.zeros(len(room.sighting_weight))
        sighting[: len(self.sighting_kept)] = (
            self.sighting_kept * sightings / (self.sighting_sigma() * self.sighting_noise)
        )
        return eqx.tree_at(lambda room: (room.point_weight, room.sighting_weight), room, (point, sighting))
