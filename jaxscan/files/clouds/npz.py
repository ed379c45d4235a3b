"""NPZ: the fields of a PointCloud on the full grid, without loss."""

import dataclasses
from pathlib import Path

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.ply import CLOUD_FORMAT
from jaxscan.files.disk import read_arrays, write_arrays
from jaxscan.reconstruction import PointCloud


_SHAPES = {
    "xyz": (None, None, 3),
    "rgb": (None, None, 3),
    "intensity": (None, None),
    "normals": (None, None, 3),
    "sigma_random": (None, None),
    "sigma_systematic": (None, None),
    "valid": (None, None),
    "record": (None,),
    "laser": (None,),
    "angle": (None,),
}
_KINDS = {"rgb": "uint8", "valid": "bool", "record": "integer", "laser": "integer"}


def write_npz(cloud: PointCloud, path: Path, digest: str) -> None:
    """Write every field as it is, with what the PLY header says beside."""
    fields = {field.name: np.asarray(getattr(cloud, field.name)) for field in dataclasses.fields(cloud)}
    said = {"format": CLOUD_FORMAT, "unit": "metre", "frame": "scanner", "calibration": digest}
    write_arrays(path, {**{key: np.array(text) for key, text in said.items()}, **fields})


def read_npz(path: Path) -> PointCloud:
    """A cloud as it was written.

    Raises:
        CloudError: If it is damaged, or no cloud.
    """
    arrays = read_arrays(path, error=CloudError)
    found = str(arrays.get("format", ""))
    if found != CLOUD_FORMAT:
        raise CloudError(f"{path}: found the format {found[:60]!r}, expected {CLOUD_FORMAT!r}.")
    grid = arrays["valid"].shape if "valid" in arrays else ()
    for name, template in _SHAPES.items():
        array = arrays.get(name)
        if array is None:
            raise CloudError(f"{path}: {name} is missing.")
        shape = tuple(grid[k] if extent is None and k < len(grid) else extent for k, extent in enumerate(template))
        if array.shape != shape or not _is_kind(array.dtype, _KINDS.get(name, "floating")):
            raise CloudError(
                f"{path}: {name}: found {array.dtype} with shape {array.shape}, "
                f"expected {_KINDS.get(name, 'floating')} with shape {shape}."
            )
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise CloudError(f"{path}: {name} is not finite everywhere.")
    return PointCloud(**{name: arrays[name] for name in _SHAPES})


def _is_kind(dtype: np.dtype, kind: str) -> bool:
    if kind == "floating":
        return dtype in (np.dtype(np.float32), np.dtype(np.float64))
    return np.issubdtype(dtype, np.integer) if kind == "integer" else dtype == np.dtype(kind)
