"""Clouds of other programs in metres with z up, and clouds moved into a map's coordinates."""

import dataclasses
from typing import Any, Literal

import numpy as np

from jaxscan.files.clouds.about import StoredCloud
from jaxscan.reconstruction import PointCloud, Stations, some_points


Unit = Literal["m", "cm", "mm", "inch", "foot"]
Up = Literal["x", "-x", "y", "-y", "z", "-z"]
_METRES: dict[Unit, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}
_WORDS = {"m": "metres", "cm": "centimetres", "mm": "millimetres"}
_TURNS: dict[Up, list[list[int]]] = {
    "z": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "-z": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
    "y": [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
    "-y": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
    "x": [[0, 0, -1], [0, 1, 0], [1, 0, 0]],
    "-x": [[0, 0, 1], [0, 1, 0], [-1, 0, 0]],
}
"""Turns that carry each direction to z."""

MILLIMETRES_FROM, CENTIMETRES_FROM = 1500.0, 200.0
"""Extents from which a cloud is taken for one in a smaller unit: no room is 200 m large, and few are 15 m."""
FAR_AWAY = 10.0
"""A cloud so many times its extent from the origin is one of a map, which is in metres."""
LOW = 0.75
"""Rooms are lower than wide: an extent of less than this share of z's is taken for the height."""


def in_metres(stored: StoredCloud, unit: Unit | None = None) -> tuple[PointCloud, list[str]]:
    """The cloud in metres, and a note where its file does not say its unit and none is given."""
    cloud, notes = stored.cloud, []
    if unit is None and not stored.about.in_metres:
        extent, away = float(np.linalg.norm(_extents(cloud))), float(np.linalg.norm(_middle(cloud)))
        unit = "m"
        if away < FAR_AWAY * extent and extent >= CENTIMETRES_FROM:
            unit = "mm" if extent >= MILLIMETRES_FROM else "cm"
        notes = [f"the file does not say its unit; an extent of {extent:.4g} is taken as {_WORDS[unit]} (--unit)."]
    return (cloud if unit in (None, "m") else _scaled(cloud, _METRES[unit or "m"])), notes


def with_z_up(stored: StoredCloud, cloud: PointCloud, up: Up | None = None) -> tuple[PointCloud, list[str]]:
    """The cloud with z up, and a note where its file does not say what is up and nothing is given.

    Args:
        stored: The cloud as it was read.
        cloud: The same in metres.
        up: The direction of the cloud that is up.
    """
    notes = []
    if up is None and not stored.about.upright:
        extents = _extents(cloud)
        lowest = int(np.argmin(extents))
        up = ("x", "y", "z")[lowest] if extents[lowest] < LOW * extents[2] else "z"
        notes = [f"the file does not say what is up; {up} is taken for it (--up)."]
    return (cloud if up in (None, "z") else _turned(cloud, np.array(_TURNS[up or "z"], float))), notes


def shifted(cloud: PointCloud, offset: tuple[float, float, float]) -> PointCloud:
    """The cloud moved by an offset [m], in double precision; its places of the scanner are moved with it."""
    step = np.eye(4)
    step[:3, 3] = offset
    if cloud.stations is None:
        stations = Stations(np.zeros(len(cloud.valid), np.int32), step[None], np.zeros((1, 6, 6)))
    else:
        stations = cloud.stations._replace(pose=step @ np.asarray(cloud.stations.pose, np.float64))
    xyz = np.asarray(cloud.xyz).astype(np.float64)
    xyz += step[:3, 3]
    xyz[~np.asarray(cloud.valid)] = 0
    return dataclasses.replace(cloud, xyz=xyz, stations=stations)


def _extents(cloud: PointCloud) -> np.ndarray:
    """Extents [3] of the cloud without its outermost hundredth on every side."""
    low, high = np.percentile(some_points(cloud, 100_000), [1, 99], axis=0)
    return np.asarray(high - low)


def _middle(cloud: PointCloud) -> np.ndarray:
    return np.asarray(np.median(some_points(cloud, 100_000), axis=0))


def _scaled(cloud: PointCloud, factor: float) -> PointCloud:
    def times(field: np.ndarray | None) -> np.ndarray | None:
        return None if field is None else np.asarray(field) * np.asarray(factor, np.asarray(field).dtype)

    stations = cloud.stations
    if stations is not None:
        pose = np.array(stations.pose, np.float64)
        pose[:, :3, 3] *= factor
        stations = stations._replace(pose=pose)
    lengths = ("xyz", "sigma_random", "sigma_systematic", "sigma_row")
    fields: dict[str, Any] = {name: times(getattr(cloud, name)) for name in lengths}
    return dataclasses.replace(cloud, **fields, stations=stations)


def _turned(cloud: PointCloud, rotation: np.ndarray) -> PointCloud:
    stations = cloud.stations
    if stations is not None:
        turn = np.eye(4)
        turn[:3, :3] = rotation
        stations = stations._replace(pose=turn @ np.asarray(stations.pose, np.float64))
    vectors = {name: np.asarray(getattr(cloud, name)) for name in ("xyz", "normals")}
    turned = {name: field @ rotation.T.astype(field.dtype) for name, field in vectors.items()}
    return dataclasses.replace(cloud, **turned, stations=stations)
