"""NPZ: the fields of a PointCloud on the full grid, without loss."""

import dataclasses
from typing import BinaryIO

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.columns import Reading
from jaxscan.files.clouds.header import (
    CLOUD_FORMAT,
    JOINED_FORMAT,
    About,
    StoredCloud,
    about_of,
    format_of,
    frame_of,
    lacking,
)
from jaxscan.files.disk import Part, check_arrays, read_arrays, write_arrays
from jaxscan.reconstruction import SMOOTHED, PointCloud, Stations


_ARRAYS: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "valid": (np.bool_, ("profiles", "lines")),
    "xyz": (np.floating, ("profiles", "lines", 3)),
    "rgb": (np.uint8, ("profiles", "lines", 3)),
    "intensity": (np.floating, ("profiles", "lines")),
    "normals": (np.floating, ("profiles", "lines", 3)),
    "sigma_random": (np.floating, ("profiles", "lines")),
    "sigma_systematic": (np.floating, ("profiles", "lines")),
    "record": (np.integer, ("profiles",)),
    "laser": (np.integer, ("profiles",)),
    "angle": (np.floating, ("profiles",)),
}
_STATIONS: dict[str, tuple[type[np.generic], tuple[str | int, ...]]] = {
    "station": (np.integer, ("profiles",)),
    "station_pose": (np.floating, ("stations", 4, 4)),
    "station_covariance": (np.floating, ("stations", 6, 6)),
}
_KINDS = {"rgb": np.uint8} | dict.fromkeys(("intensity", "normals", "sigma_random", "sigma_systematic"), np.float32)
_SMOOTHED = dict.fromkeys(SMOOTHED, _ARRAYS["intensity"])


def write_npz(cloud: PointCloud, path: Part, about: About) -> None:
    """Write every field that there is as it is, and the entries of the PLY header."""
    left = {"stations", "absent", *cloud.lacks}
    names = [field.name for field in dataclasses.fields(cloud) if field.name not in left]
    values = {name: getattr(cloud, name) for name in names} | dict(zip(_STATIONS, cloud.stations or (), strict=False))
    fields = {name: np.asarray(value) for name, value in values.items() if value is not None}
    header = {
        "format": format_of(cloud.stations),
        "unit": "metre",
        "frame": frame_of(cloud.stations),
        "calibration": about.calibration,
    }
    header |= {} if about.epsg is None else {"crs": f"EPSG:{about.epsg}"}
    header |= {"lacks": " ".join(cloud.lacks)} if cloud.lacks else {}
    write_arrays(path, {**{key: np.array(text) for key, text in header.items()}, **fields})


def read_npz(file: BinaryIO, reading: Reading) -> StoredCloud:
    """A cloud as it was written; no other program writes one."""
    arrays = read_arrays(file.name, error=CloudError)
    found = str(arrays.get("format", ""))
    if found not in (CLOUD_FORMAT, JOINED_FORMAT):
        raise CloudError(f"found the format {found[:60]!r}, expected {CLOUD_FORMAT!r} or {JOINED_FORMAT!r}.")
    lacks = lacking([f"lacks {str(arrays['lacks'])[:200]}"] if "lacks" in arrays else [])
    written = {name: kind for name, kind in _ARRAYS.items() if name not in lacks}
    expected = written | (_SMOOTHED if _SMOOTHED.keys() & arrays.keys() else {})
    joined = _STATIONS if found == JOINED_FORMAT else {}
    check_arrays(arrays, expected | joined, {}, name=file.name, error=CloudError)
    stations = Stations(*(arrays[name] for name in joined)) if joined else None
    lines = [found, *(f"{key} {str(arrays[key])[:100]}" for key in ("unit", "calibration", "crs") if key in arrays)]
    shape = arrays["valid"].shape
    zeros = {
        name: np.zeros((*shape, 3) if name in ("rgb", "normals") else shape, _KINDS[name])
        for name in lacks
        if name in _KINDS
    }
    cloud = PointCloud(**{name: arrays[name] for name in expected}, **zeros, stations=stations, absent=lacks or None)
    return StoredCloud(cloud, about_of(lines))
