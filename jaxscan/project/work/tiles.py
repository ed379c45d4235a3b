"""The points of many stations in square tiles, in bounded memory: spooled to files, then read tile by tile."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from jaxscan.files.disk import append_whole, make_folder, open_to_append
from jaxscan.reconstruction import PointCloud


MOST_POINTS = 10_000_000
"""Points that are in memory at a time, and in one file."""
_ROW = np.dtype(
    [
        ("xyz", np.float64, 3),
        ("normals", np.float32, 3),
        ("rgb", np.uint8, 3),
        ("intensity", np.float32),
        ("sigma_random", np.float32),
        ("sigma_systematic", np.float32),
    ]
)


class Tiles:
    """Points by the square of the plan that they lie in."""

    def __init__(self, folder: Path, side_m: float) -> None:
        """Spool into a folder, which is made now and removed at the end of `with`."""
        self._folder, self._side_m = folder, side_m
        self._files: dict[tuple[int, int], Path] = {}

    def __enter__(self) -> "Tiles":
        make_folder(self._folder, new=True)
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def add(self, cloud: PointCloud) -> None:
        """Add the points of a cloud in the frame of the room [m]."""
        points = cloud.points()
        rows = np.empty(len(points.xyz), _ROW)
        for name in _ROW.fields or ():
            rows[name] = getattr(points, name)
        squares = np.floor(rows["xyz"][:, :2] / self._side_m).astype(int)
        places, of_place = np.unique(squares, axis=0, return_inverse=True)
        order = np.argsort(of_place.ravel(), kind="stable")
        ends = np.cumsum(np.bincount(of_place.ravel(), minlength=len(places)))
        for place, some in zip(places.tolist(), np.split(rows[order], ends[:-1]), strict=True):
            path = self._files.setdefault((place[0], place[1]), self._folder / f"{place[0]}_{place[1]}")
            with open_to_append(path) as file:
                append_whole(file, some.tobytes(), durable=False)

    def clouds(self) -> Iterator[tuple[tuple[int, int], PointCloud]]:
        """Each tile, by its place in steps of its side, as a cloud without a grid: one profile of all its points.

        One of more than `MOST_POINTS` comes in several clouds.
        """
        for place, path in sorted(self._files.items()):
            read = 0
            while len(rows := np.fromfile(path, _ROW, MOST_POINTS, offset=read)):
                read += rows.nbytes
                yield place, _cloud(rows)
            path.unlink()


def _cloud(rows: Shaped[np.ndarray, " n"]) -> PointCloud:
    zero = np.zeros(1, np.int32)
    fields = {name: np.ascontiguousarray(rows[name])[None] for name in _ROW.fields or () if name != "xyz"}
    xyz = rows["xyz"].astype(np.float32)[None]
    valid = np.ones((1, len(rows)), np.bool_)
    angle = np.zeros(1)
    return PointCloud(xyz=xyz, valid=valid, **fields, record=zero, laser=zero, angle=angle, stations=None, absent=None)
