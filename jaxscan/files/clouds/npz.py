"""NPZ: the fields of a PointCloud on the full grid, without loss."""

import dataclasses
from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.ply import CLOUD_FORMAT
from jaxscan.files.disk import check_arrays, read_arrays, write_arrays
from jaxscan.reconstruction import SMOOTHED, PointCloud


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
_SMOOTHED = dict.fromkeys(SMOOTHED, _ARRAYS["intensity"])


def write_npz(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write every field that there is as it is, and the entries of the PLY header."""
    values = {field.name: getattr(cloud, field.name) for field in dataclasses.fields(cloud)}
    fields = {name: np.asarray(value) for name, value in values.items() if value is not None}
    header = {"format": CLOUD_FORMAT, "unit": "metre", "frame": "scanner", "calibration": digest}
    write_arrays(path, {**{key: np.array(text) for key, text in header.items()}, **fields})


def read_npz(path: Path) -> PointCloud:
    """A cloud as it was written.

    Raises:
        CloudError: If it is damaged, or no cloud.
    """
    arrays = read_arrays(path, error=CloudError)
    found = str(arrays.get("format", ""))
    if found != CLOUD_FORMAT:
        raise CloudError(f"{path}: found the format {found[:60]!r}, expected {CLOUD_FORMAT!r}.")
    expected = _ARRAYS | (_SMOOTHED if _SMOOTHED.keys() & arrays.keys() else {})
    check_arrays(arrays, expected, {}, name=str(path), error=CloudError)
    return PointCloud(**{name: arrays[name] for name in expected})
