"""An adjustment between its rounds, and at its end."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.calibration.problem import Prepared as BoardData
from jaxscan.geometry import Scanner
from jaxscan.leastsq import Arrow, Covariance, covariance_of, noise_component
from jaxscan.recalibration.adjust.boards import BoardEquations
from jaxscan.recalibration.adjust.noise import FIRST_WALL_M, Noise
from jaxscan.recalibration.adjust.prepare import Prepared
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, LOCAL_SCALE, STATION_SCALE, Room, Unknowns
from jaxscan.recalibration.adjust.solver import Linearised
from jaxscan.recalibration.adjust.wall_shape import STOPS, Wall, find_walls, with_shape
from jaxscan.recalibration.observed import RoomObservations, Surfaces
from jaxscan.recalibration.result import Adjusted


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
    board_data: BoardData | None = None
    sighting_noise: float = 1.0
    """Over the given sigmas [1]."""
    heights: Float[np.ndarray, " sizes"] = field(default_factory=lambda: np.zeros(STOPS + 1))
    """Standard deviation of the heights of patches of each size [m], and of the table's stops [rad]."""
    patched: Sequence[Wall] = ()
    """Walls whose patches are kept; without any, patches follow the places of the points."""
    stated_wall_m: float = FIRST_WALL_M
    """Roughness of walls before any was learned [m]."""
    boards: BoardEquations | None = None
    """The information of captured boards, at the scanner of a few steps before."""
    steps: int = 0
    converged: bool = False

    @property
    def usable(self) -> Bool[np.ndarray, " points"]:
        """Points that are finite and whose rays meet the sheet; an error of 0 of the others is no observation."""
        return self.prepared.usable & np.asarray(self.linearised.points.meets)[: len(self.kept)]

    @property
    def surface(self) -> Int[np.ndarray, " points"]:
        """Surface of every point."""
        return np.asarray(self.observations.points.surface)

    @property
    def error_px(self) -> Float[np.ndarray, " points"]:
        """Seen minus predicted centres [px]."""
        return np.asarray(self.linearised.points.rows.value)[: len(self.kept)]

    @property
    def reach(self) -> Float[np.ndarray, " points"]:
        """Size of the change of the distance from the surface by one pixel [m / px]."""
        return np.maximum(np.abs(np.asarray(self.linearised.points.reach)[: len(self.kept)]), 1e-7)

    @property
    def error(self) -> Float[np.ndarray, " points"]:
        """Distances from the surfaces [m]."""
        return self.error_px * np.asarray(self.linearised.points.reach)[: len(self.kept)]

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
        return np.where(self.usable, self.error_px / self.sigma_px, 0.0)

    def sighting_error(self) -> Float[np.ndarray, "sightings 2"]:
        """Projected minus seen [px]."""
        return np.asarray(self.linearised.sightings.value).reshape(-1, 2)[: len(self.sighting_kept)]

    def sighting_sigma(self) -> Float[np.ndarray, " sightings"]:
        """Given sigmas [px]; 1 where there is none."""
        tracks = self.observations.tracks
        given = np.zeros(0) if tracks is None else np.asarray(tracks.sigma)
        return np.where(self.prepared.seen, given, 1.0)

    def sighting_whitened(self) -> Float[np.ndarray, "sightings 2"]:
        """Errors of sightings over the given sigmas; 0 where there is none."""
        return np.where(self.prepared.seen[:, None], self.sighting_error() / self.sighting_sigma()[:, None], 0.0)

    @cached_property
    def walls(self) -> list[Wall]:
        """All walls and their patches."""
        points = self.observations.points
        stop = self.prepared.angles.first[points.sweep] + points.record
        return find_walls(self.prepared.room, self.linearised, self.kept, stop, self.patched)

    @cached_property
    def shaped(self) -> tuple[Arrow, float]:
        """Normal equations in which walls have a shape, and how much less their sum of squares is."""
        arrow = self.linearised.arrow
        return with_shape(arrow, self.walls, self.heights) if self.heights.any() else (arrow, 0.0)

    @cached_property
    def covariance(self) -> Covariance:
        """Of the unknowns, if this is the minimum."""
        return covariance_of(self.shaped[0])

    @property
    def cost(self) -> float:
        """Sum of squared whitened residuals with those of the prior, less the part that the shape of walls explains."""
        return float(self.linearised.cost) - self.shaped[1]

    @property
    def misfit(self) -> float:
        """Mean square of the errors of kept points over their stated variance: no noise is learned here [1]."""
        if not self.kept.any():
            return 0.0
        square = (self.error_px / Noise(1.0, self.stated_wall_m).sigma(self.given_px, self.reach)) ** 2
        return float(np.sum(square[self.kept]) / np.sum(self.redundancy()[self.kept]))

    @cached_property
    def plain_covariance(self) -> Covariance:
        """The same if all errors of points were independent."""
        return covariance_of(self.linearised.arrow)

    @property
    def inflation(self) -> float:
        """Mean factor of the variance of the scanner's numbers and the stations by errors that points share [1]."""
        count = len(self.y.scanner) + len(self.y.stations)
        plain = np.linalg.inv(self.plain_covariance.shared[:count, :count])
        return float(np.trace(plain @ self.covariance.shared[:count, :count])) / count

    @cached_property
    def _free(self) -> float:
        """Dense unknowns that the data determine rather than the priors."""
        count, others = len(self.y.scanner), len(self.y.stations)
        variance = np.diag(self.covariance.shared)
        free = float(np.sum(1.0 - np.clip(variance[:count], 0.0, 1.0))) + others
        if len(self.y.angles):
            room, rows = self.prepared.room, self.linearised.points.rows
            square = (np.asarray(rows.angle) * np.asarray(room.point_weight)) ** 2
            known = np.bincount(np.asarray(room.points.angle), square, len(self.y.angles))
            own = variance[count + others : count + others + len(known)]
            free += float(np.sum(np.minimum(own * known, 1.0)))
        return free

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

    def weighted(self, points: np.ndarray | float, sightings: np.ndarray | float) -> Room:
        """The problem with weights by the present noise, damped by factors of points and sightings."""
        room = self.prepared.room
        point = np.zeros(len(room.point_weight))
        point[: len(self.kept)] = self.kept * points / self.sigma_px
        sighting = np.zeros(len(room.sighting_weight))
        sighting[: len(self.sighting_kept)] = (
            self.sighting_kept * sightings / (self.sighting_sigma() * self.sighting_noise)
        )
        return eqx.tree_at(lambda room: (room.point_weight, room.sighting_weight), room, (point, sighting))


def conclude(state: State, prior: Scanner, observations: RoomObservations) -> Adjusted:
    """The result of an adjustment; call in 64 bit."""
    room, y = state.prepared.room, state.y
    scanner, stations, angles = room.counts
    covariance = state.covariance.shared
    departure = np.asarray(room.root @ y.scanner)
    own = room.root @ covariance[:scanner, :scanner] @ room.root.T
    moved = prior.with_rig(state.linearised.rig)
    every = range(scanner, scanner + stations, 6)
    poses = [np.zeros((6, 6))] + [covariance[k : k + 6, k : k + 6] * STATION_SCALE**2 for k in every]
    begin = scanner + stations
    spread = np.sqrt(np.diag(covariance))[begin : begin + angles] * ANGLE_SCALE
    corrections, sigmas = _corrections(state, spread)
    rows = int(state.kept.sum()) + 2 * int(state.sighting_kept.sum()) + len(observations.lengths)
    tracks = observations.tracks
    used = len(np.unique(tracks.track[state.sighting_kept])) if tracks is not None else 0
    places = len(np.unique(state.surface[state.kept])) + used
    return Adjusted(
        scanner=eqx.tree_at(lambda s: s.covariance, moved, (own + own.T) / 2, is_leaf=lambda leaf: leaf is None),
        prior=prior,
        departure=departure,
        stations=np.asarray(state.linearised.stations),
        station_covariance=np.stack(poses),
        surfaces=moved_surfaces(state, observations.surfaces),
        corrections=corrections,
        correction_sigma=sigmas,
        point_error=state.error,
        point_sigma=state.sigma_px * state.reach,
        point_kept=state.kept,
        track_error=state.sighting_error(),
        track_kept=state.sighting_kept,
        wall_m=state.noise.wall_m,
        inflation=state.inflation,
        observations=observations,
        cost=state.cost,
        freedom=rows - 3 * places - stations,
        converged=state.converged,
        steps=state.steps,
        uneven_m=float(np.sqrt(np.sum(state.heights[:STOPS] ** 2))),
        stop_sigma=float(state.heights[STOPS]),
        misfit=state.misfit,
    )


def moved_surfaces(state: State, surfaces: Surfaces) -> Surfaces:
    """The surfaces where the adjustment has them."""
    places, count = state.prepared.room.places, len(surfaces.kind)
    step = LOCAL_SCALE * state.y.locals[:count]
    sphere = np.asarray(places.sphere)[:count]
    normal = places.normal[:count] + np.einsum("sk,skc->sc", step[:, :2], places.basis[:count])
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    centre = np.asarray(places.centre[:count])
    away = places.offset[:count] + step[:, 2]
    return Surfaces(
        kind=surfaces.kind,
        normal=np.where(sphere[:, None], 0.0, normal),
        distance=np.where(sphere, places.offset[:count], (normal * centre).sum(1) + away),
        centre=np.where(sphere[:, None], centre + step, centre + away[:, None] * normal),
    )


def _corrections(
    state: State, spread: Float[np.ndarray, " knots"]
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    angles = state.prepared.angles
    ends = np.append(angles.first, len(angles.phi))
    found, sigma = [], []
    for begin, end, known in zip(ends[:-1], ends[1:], angles.known, strict=True):
        knot = angles.knot[begin:end]
        some = len(spread) > 0
        found.append(known + (ANGLE_SCALE * state.y.angles[knot] if some else 0.0))
        sigma.append(spread[knot] if some else np.zeros(end - begin))
    return tuple(found), tuple(sigma)
