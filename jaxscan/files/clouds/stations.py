"""Poses of stations as numbers in headers and descriptions."""

from collections.abc import Iterable

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.points import MAX_STATIONS
from jaxscan.geometry import Array
from jaxscan.reconstruction import Stations


_TRIANGLE = np.triu_indices(6)
_POSE, _COVARIANCE = 12, len(_TRIANGLE[0])


def station_lines(stations: Stations) -> list[str]:
    """Two lines for each station: its number and T_room_scanner by rows without the last; its covariance.

    MeshLab opens no file with a longer line than 509 bytes.
    """
    lines = []
    for number, (pose, covariance) in enumerate(zip(stations.pose, stations.covariance, strict=True)):
        lines.append(f"station {number} {' '.join(f'{x:.17g}' for x in np.asarray(pose, np.float64)[:3].ravel())}")
        lines.append(f"station-covariance {number} {covariance_text(covariance)}")
    return lines


def read_stations(lines: Iterable[str], number: np.ndarray, name: str) -> Stations:
    """The stations of `station_lines`, in their order, with that of each profile.

    Raises:
        CloudError: If a line is wrong or missing.
    """
    poses: list[np.ndarray] = []
    covariances: list[np.ndarray] = []
    for line in lines:
        words = line.split()
        # Of an earlier version the line of a station holds its covariance too.
        if words[:1] == ["station-covariance"] and words[1:2] == [str(len(poses) - 1)]:
            covariances[-1] = _covariance(words[2:], f'{name}: the comment "station-covariance {len(poses) - 1}"')
        if not words or words[0] != "station":
            continue
        try:
            values = [float(word) for word in words[2:]]
        except ValueError:
            values = []
        if (
            len(poses) == MAX_STATIONS
            or words[1:2] != [str(len(poses))]
            or len(values) not in (_POSE, _POSE + _COVARIANCE)
        ):
            raise CloudError(f'{name}: the comment "station {len(poses)}" is missing or wrong: found "{line[:60]}".')
        if not np.isfinite(values).all():
            raise CloudError(f'{name}: the comment "station {len(poses)}" holds a number that is not finite.')
        pose = np.eye(4)
        pose[:3] = np.reshape(values[:_POSE], (3, 4))
        poses.append(pose)
        covariances.append(_symmetric(values[_POSE:] or [0.0] * _COVARIANCE))
    if not poses:
        raise CloudError(f'{name}: the comments "station" are missing, with the poses of a joined cloud.')
    return Stations(number, np.array(poses), np.array(covariances))


def _covariance(words: list[str], name: str) -> np.ndarray:
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != _COVARIANCE or not np.isfinite(values).all():
        raise CloudError(f"{name} is wrong: expected {_COVARIANCE} finite numbers.")
    return _symmetric(values)


def _symmetric(triangle: list[float]) -> np.ndarray:
    covariance = np.zeros((6, 6))
    covariance[_TRIANGLE] = triangle
    covariance.T[_TRIANGLE] = triangle
    return covariance


def covariance_text(covariance: Array) -> str:
    """The upper triangle of a covariance [6, 6], by rows."""
    return " ".join(f"{value:.9g}" for value in np.asarray(covariance, np.float64)[_TRIANGLE])
