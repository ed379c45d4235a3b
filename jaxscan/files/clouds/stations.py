"""Poses of stations as numbers in headers and descriptions."""

from collections.abc import Iterable

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.points import MAX_STATIONS
from jaxscan.geometry import Array
from jaxscan.reconstruction import Stations


_TRIANGLE = np.triu_indices(6)
_ENTRIES = 12 + len(_TRIANGLE[0])


def station_lines(stations: Stations) -> list[str]:
    """A line for each station: "station", its number, T_room_scanner by rows without the last, its covariance."""
    return [
        f"station {number} {' '.join(f'{value:.17g}' for value in np.asarray(pose, np.float64)[:3].ravel())} "
        f"{covariance_text(covariance)}"
        for number, (pose, covariance) in enumerate(zip(stations.pose, stations.covariance, strict=True))
    ]


def read_stations(lines: Iterable[str], number: np.ndarray, name: str) -> Stations:
    """The stations of `station_lines`, in their order, with that of each profile.

    Raises:
        CloudError: If a line is wrong or missing.
    """
    poses: list[np.ndarray] = []
    covariances: list[np.ndarray] = []
    for line in lines:
        words = line.split()
        if not words or words[0] != "station":
            continue
        try:
            values = [float(word) for word in words[2:]]
        except ValueError:
            values = []
        if len(poses) == MAX_STATIONS or words[1:2] != [str(len(poses))] or len(values) != _ENTRIES:
            raise CloudError(f'{name}: the comment "station {len(poses)}" is missing or wrong: found "{line[:60]}".')
        if not np.isfinite(values).all():
            raise CloudError(f'{name}: the comment "station {len(poses)}" holds a number that is not finite.')
        pose, covariance = np.eye(4), np.zeros((6, 6))
        pose[:3] = np.reshape(values[:12], (3, 4))
        covariance[_TRIANGLE] = values[12:]
        covariance.T[_TRIANGLE] = values[12:]
        poses.append(pose)
        covariances.append(covariance)
    if not poses:
        raise CloudError(f'{name}: the comments "station" are missing, with the poses of a joined cloud.')
    return Stations(number, np.array(poses), np.array(covariances))


def covariance_text(covariance: Array) -> str:
    """The upper triangle of a covariance [6, 6], by rows."""
    return " ".join(f"{value:.9g}" for value in np.asarray(covariance, np.float64)[_TRIANGLE])


def quaternion(rotation: np.ndarray) -> tuple[float, float, float, float]:
    """Unit quaternion (w, x, y, z) of a rotation [3, 3], w not negative.

    Source: Bar-Itzhack, J. Guidance 23 (2000) 1085: the eigenvector of the largest eigenvalue.
    """
    r = np.asarray(rotation, np.float64)
    k = np.zeros((4, 4))
    k[0, 0] = np.trace(r)
    k[0, 1:] = k[1:, 0] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    k[1:, 1:] = r + r.T - np.trace(r) * np.eye(3)
    w, x, y, z = np.linalg.eigh(k)[1][:, -1]
    sign = -1.0 if w < 0 else 1.0
    return float(sign * w), float(sign * x), float(sign * y), float(sign * z)
