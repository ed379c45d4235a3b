"""Points that two stations know by name: corners of boards and markers, middles of known spheres."""

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from jaxscan.geometry import Array, Scanner
from jaxscan.recalibration.observed import SweepStripes, Tracks
from jaxscan.recalibration.stations.view import View


Landmarks = Mapping[str, np.ndarray]
"""Points [3] by name, m, in the scanner frame of one station."""

BESIDE_RAD = np.radians(6.0)
"""Farthest patch on whose plane a target is taken to be."""
AGREE_M = 0.1
"""A landmark that is this far off was moved, or is another of the same name [m]."""
SPREAD_M = 0.05
"""Least width of landmarks across their longest direction, so that they hold a pose [m]."""


def find_landmarks(
    tracks: Tracks, sweeps: Mapping[int, SweepStripes], scanner: Scanner, view: View
) -> dict[str, np.ndarray]:
    """Where the named targets are that the sweeps of one station see.

    A target is where the rays to it meet the flat patch that is nearest to them.

    Args:
        tracks: Of all sweeps.
        sweeps: Those of the station, by their numbers in `tracks`.
        scanner: The scanner.
        view: The view of the station.

    Returns:
        Points [3] by name, m, scanner frame of the station.
    """
    found: dict[str, np.ndarray] = {}
    mine = np.isin(tracks.sweep, list(sweeps))
    for number in np.unique(tracks.track[mine]):
        if number >= len(tracks.name) or not tracks.name[number]:
            continue
        sightings = np.flatnonzero(mine & (tracks.track == number))
        phi = np.array([sweeps[tracks.sweep[k]].angle[tracks.record[k]] for k in sightings], np.float64)
        with jax.enable_x64(True):
            exact = scanner.without_covariance().as_dtype(jnp.float64)
            eyes, rays = (np.asarray(each) for each in _rays(exact, tracks.q[sightings].astype(np.float64), phi))
        points = [p for eye, ray in zip(eyes, rays, strict=True) if (p := _on_patch(view, eye, ray)) is not None]
        if points:
            found[tracks.name[number]] = np.median(points, 0)
    return found


@jax.jit
def _rays(scanner: Scanner, q: Array, phi: Array) -> tuple[Array, Array]:
    def one(q: Array, phi: Array) -> tuple[Array, Array]:
        T = scanner.pose(phi)
        return T[:3, 3], T[:3, :3] @ scanner.camera.unproject(q)

    return jax.vmap(one)(q, phi)


def _on_patch(view: View, eye: np.ndarray, ray: np.ndarray) -> np.ndarray | None:
    """Where a ray meets the plane of the patch nearest to it; None where no patch is near."""
    ways = view.patches - eye
    cosine = ways @ ray / np.linalg.norm(ways, axis=1)
    near = int(cosine.argmax())
    slope = float(view.normals[near] @ ray)
    if cosine[near] < np.cos(BESIDE_RAD) or abs(slope) < 0.05:
        return None
    point: np.ndarray = eye + float(view.normals[near] @ ways[near]) / slope * ray
    return point


def pose_of(at: np.ndarray, of: np.ndarray) -> np.ndarray | None:
    """T_one_other [4, 4] that brings landmarks `of` [n, 3] of the other onto `at` [n, 3]; None where they hold none.

    Landmarks that were moved are left out, as long as three agree. Source: Kabsch, Acta Cryst. A32 (1976) 922.
    """
    while len(at) >= 3:
        middle_at, middle_of = at.mean(0), of.mean(0)
        u, width, vt = np.linalg.svd((of - middle_of).T @ (at - middle_at) / len(at))
        if np.sqrt(width[1]) < SPREAD_M:
            return None
        rotation = vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, middle_at - rotation @ middle_of
        apart = np.linalg.norm(of @ rotation.T + pose[:3, 3] - at, axis=1)
        if apart.max() < AGREE_M:
            return pose
        keep = np.arange(len(at)) != apart.argmax()
        at, of = at[keep], of[keep]
    return None
