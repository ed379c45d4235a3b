"""A finished adjustment in the terms of its caller: scanner, stations, surfaces, residuals, covariances."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from jaxscan.geometry import Scanner
from jaxscan.recalibration.adjust.room import ANGLE_SCALE, LOCAL_SCALE, STATION_SCALE
from jaxscan.recalibration.adjust.state import State
from jaxscan.recalibration.adjust.wall_shape import STOPS
from jaxscan.recalibration.adjusted import Adjusted
from jaxscan.recalibration.observed import RoomObservations, Surfaces


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
