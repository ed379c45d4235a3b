"""The scans of an E57 file as one cloud."""

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import numpy as np

from jaxscan.errors import CloudError
from jaxscan.files.clouds.grid import Records, cloud_of
from jaxscan.reconstruction import PointCloud


_SINGLE_M = 128.0
"""Coordinates up to which a single is good to 8 um."""
_AXES, _NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
_SPHERICAL = ("range", "azimuth", "elevation")

Block = dict[str, np.ndarray]
"""Columns of some points."""


class Scan(NamedTuple):
    """A scan as it is stored, in its own frame."""

    points: int
    """Number of points."""
    types: dict[str, str]
    """Type of each column."""
    blocks: Callable[[Iterable[str]], Iterator[Block]]
    """Reads some columns of all points, a block at a time."""
    pose: np.ndarray
    """T_file_scan [4, 4]."""
    lines: list[str]
    """The lines of our header; none where another program wrote it."""
    unused: tuple[str, ...] = ()
    """Columns that a cloud has no place for."""
    colours: str = ""
    """What was decided about the range of its colours."""


def joined(scans: list[Scan], name: str) -> PointCloud:
    """The cloud of all scans, in the frame of the file.

    Of ours, on the grid with its stations; of others, the points as a single profile. Beside the cloud only a block of
    points is in memory at a time.

    Raises:
        CloudError: If there is no point, or grid or stations cannot be.
        ValueError: If the file is damaged.
    """
    lines = scans[0].lines
    parts = [part for scan in scans if scan.points and (part := _in_file_frame(scan, name)).points]
    if not parts:
        raise CloudError(f"{name}: holds no valid point.")
    together = sorted({field for part in parts for field in part.types})
    types = {field: np.result_type(*(part.types[field] for part in parts if field in part.types)) for field in together}
    # Of ours, profiles are counted through all stations, and steps in each.
    profiles = bool(lines) and "profile" in types

    def read() -> Iterator[np.ndarray]:
        for part in parts:
            for block in part.blocks(part.types):
                points = np.zeros(len(block["x"]), list(types.items()))
                for field, values in block.items():
                    points[field] = values
                if profiles:
                    points["step"] = points["profile"]
                yield points

    return cloud_of(Records(np.dtype(list(types.items())), sum(part.points for part in parts), read), lines, name)


def _in_file_frame(scan: Scan, name: str) -> Scan:
    """The points that the scan calls valid with x, y and z, carried along by the pose, like their normals."""
    cartesian = set(_AXES) <= set(scan.types)
    if not (cartesian or set(_SPHERICAL) <= set(scan.types)):
        raise CloudError(f"{name}: the points have no x, y and z.")
    stored = [field for field in scan.types if cartesian is False or field not in _SPHERICAL]
    kept = [field for field in stored if field not in (*_AXES, *_SPHERICAL, "invalid")]
    turns = not np.array_equal(scan.pose, np.eye(4))

    def blocks(columns: Iterable[str]) -> Iterator[Block]:
        wanted = set(columns)
        needed = [field for field in stored if field in wanted | {*_AXES, *_SPHERICAL, "invalid"}]
        for block in scan.blocks(needed):
            if "invalid" in block:
                valid = block.pop("invalid") == 0
                block = {field: values[valid] for field, values in block.items()}
            block = block if cartesian else _cartesian(block)
            if turns:
                block |= _turned(block, _AXES, scan.pose[:3, :3], scan.pose[:3, 3])
                if set(_NORMAL) <= set(block):
                    block |= _turned(block, _NORMAL, scan.pose[:3, :3], np.zeros(3))
            yield block

    single = cartesian and all(np.dtype(scan.types[axis]).itemsize <= 4 for axis in _AXES)
    count = scan.points
    if "invalid" in scan.types or (turns and single):
        # Singles suffice where nothing is lost by them; what is not finite is dropped later.
        count, reach = 0, 0.0
        for block in blocks(()):
            count += len(block["x"])
            places = np.abs([block[axis] for axis in _AXES])
            reach = max(reach, float(np.max(places, where=np.isfinite(places), initial=0.0)))
        single = single and (not turns or reach <= _SINGLE_M)
    types = dict.fromkeys(_AXES, "f4" if single else "f8") | {field: scan.types[field] for field in kept}
    return scan._replace(points=count, types=types, blocks=blocks, pose=np.eye(4))


def _turned(block: Block, names: tuple[str, ...], turn: np.ndarray, shift: np.ndarray) -> Block:
    moved = np.stack([block[name].astype(np.float64) for name in names], -1) @ turn.T + shift
    return dict(zip(names, moved.T, strict=True))


def _cartesian(block: Block) -> Block:
    distance, azimuth, elevation = (block.pop(field).astype(np.float64) for field in _SPHERICAL)
    flat = distance * np.cos(elevation)
    return block | {"x": flat * np.cos(azimuth), "y": flat * np.sin(azimuth), "z": distance * np.sin(elevation)}
