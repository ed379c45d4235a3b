"""Recordings for the viewer Rerun (.rrd): clouds in metres with their colours, and where the scanner stood."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxscan.errors import CloudError, DependencyError
from jaxscan.files.disk import write_atomically
from jaxscan.reconstruction import PointCloud


FAR_M = 1000.0
"""Rerun has single precision, which holds a tenth of a millimetre at this distance from 0."""
STATION_M = 0.05
"""Radius of a station's mark."""
_SMALLEST_M, _LARGEST_M = 0.0005, 0.05
"""Limits of a point's radius."""


def load_rerun() -> Any:
    """The module of Rerun.

    Raises:
        DependencyError: If it is not installed.
    """
    try:
        import rerun
    except ImportError as problem:
        raise DependencyError('Recordings of Rerun need rerun-sdk: pip install "jaxscan[rerun]"') from problem
    return rerun


def save_rerun(clouds: Mapping[str, PointCloud], path: Path) -> np.ndarray:
    """Write clouds as a recording.

    Args:
        clouds: By their names, in metres, z up, with one valid point at least.

    Returns:
        The place that is 0 in the recording [3], m: not 0 itself where the first cloud is far from there.

    Raises:
        DependencyError: If Rerun is not installed.
        CloudError: If the file cannot be written, or Rerun is switched off.
    """
    rr = load_rerun()
    recording = rr.RecordingStream("jaxscan")
    # In memory: of a file that Rerun writes itself nobody learns that the disk was full.
    stream = recording.binary_stream()
    log = lambda place, *what: recording.log(place, *what, static=True, strict=True)
    log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    parts = {name: cloud.points() for name, cloud in clouds.items()}
    middle = np.median(next(iter(parts.values())).xyz, axis=0).astype(np.float64)
    origin = np.round(middle) if np.linalg.norm(middle) > FAR_M else np.zeros(3)
    log("/", rr.AnyValues(origin_m=origin))
    for name, points in parts.items():
        place = rr.new_entity_path([name])
        xyz = (points.xyz - origin.astype(points.xyz.dtype)).astype(np.float32)
        known = {"sigma_random_m": points.sigma_random, "sigma_systematic_m": points.sigma_systematic}
        # Columns of Rerun's that it has no name for; it shows them where a point is chosen.
        sigmas = {column: values for column, values in known.items() if values.any()}
        log(
            place,
            rr.Points3D(xyz, colors=points.rgb if points.rgb.any() else None, radii=radius_of(xyz)),
            rr.AnyValues(**sigmas),
        )
        stations = _stations(clouds[name])
        labels = [f"station {1 + k}" if len(parts) == 1 else f"{name}: station {1 + k}" for k in range(len(stations))]
        if labels:
            log(f"{place}/stations", rr.Points3D(stations - origin, labels=labels, radii=STATION_M))
    content = stream.read()
    recording.disconnect()
    if content is None:
        raise CloudError(f"{path}: Rerun records nothing; take its switch RERUN out of the environment.")
    write_atomically(path, content, error=CloudError)
    return origin


def _stations(cloud: PointCloud) -> np.ndarray:
    """Where the scanner stood [k, 3], m; none where the cloud does not say it."""
    if cloud.stations is not None:
        return np.asarray(cloud.stations.pose, np.float64)[:, :3, 3]
    return np.zeros((int(np.ptp(np.asarray(cloud.angle)) > 0), 3))


def radius_of(xyz: np.ndarray) -> float:
    """Half the usual distance of neighbours [m], of points [n, 3], m, whose surfaces are as large as the cells hit."""
    cell = max(float(np.ptp(xyz, axis=0).max()) / 100, 1e-6)
    cells = np.unique(((xyz - xyz.min(0)) / cell).astype(np.int32) @ np.array([1, 1 << 10, 1 << 20]))
    return float(np.clip(0.5 * cell * np.sqrt(len(cells) / len(xyz)), _SMALLEST_M, _LARGEST_M))
