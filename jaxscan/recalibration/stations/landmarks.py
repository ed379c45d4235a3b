"""Points that two stations know by name: corners of boards and markers, middles of known spheres."""

from collections.abc import Mapping

import numpy as np

from jaxscan.geometry import Scanner, nearest_rotation, poses, rays, turn
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
        pose = np.asarray(poses(scanner.rig, phi))
        ways = np.asarray(turn(pose[:, :3, :3], rays(scanner.rig, tracks.q[sightings])))
        points = [
            p for eye, ray in zip(pose[:, :3, 3], ways, strict=True) if (p := _on_patch(view, eye, ray)) is not None
        ]
        if points:
            found[tracks.name[number]] = np.median(points, 0)
    return found


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
        both = (at - middle_at).T @ (of - middle_of) / len(at)
        if np.sqrt(np.linalg.svd(both, compute_uv=False)[1]) < SPREAD_M:
            return None
        rotation = nearest_rotation(both)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, middle_at - rotation @ middle_of
        apart = np.linalg.norm(of @ rotation.T + pose[:3, 3] - at, axis=1)
        if apart.max() < AGREE_M:
            return pose
        keep = np.arange(len(at)) != apart.argmax()
        at, of = at[keep], of[keep]
    return None
