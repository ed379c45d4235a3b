"""The organised point cloud; clouds of several stations as one in the frame of the room, and one of them again."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.errors import CloudError
from jaxscan.geometry import Array


SMOOTHED = ("sigma_row", "shift_px", "shared_lines")
"""Fields that a cloud has where its points use their neighbours, and not otherwise."""
MAY_LACK = ("rgb", "intensity", "normals", "sigma_random", "sigma_systematic", "grid")
"""What the cloud of another program may not have; "grid" is its profiles and lines, with lasers, angles and records."""
_AT_ONCE, _POINTS_AT_ONCE = 1 << 20, 1 << 17
"""Cells that are looked at, and points that are turned, at a time."""


class CloudPoints(NamedTuple):
    """The valid points of a cloud, in the order of the grid."""

    xyz: np.ndarray
    """Position [m], [n, 3], scanner frame; float32, or float64 where the cloud holds it: a national grid needs it."""
    normals: np.ndarray
    """float32 [n, 3]; zero where there is none."""
    rgb: np.ndarray
    """uint8 [n, 3]."""
    intensity: np.ndarray
    """Amplitude [DN], float32 [n]."""
    sigma: np.ndarray
    """Both uncertainties together [m], float32 [n]."""
    sigma_random: np.ndarray
    sigma_systematic: np.ndarray
    step: np.ndarray
    """Profile, int32 [n]."""
    row: np.ndarray
    """Line, int32 [n]."""
    laser: np.ndarray
    """uint8 [n]."""
    sigma_row: np.ndarray | None = None
    """float32 [n], as are the following two; None where rows were not smoothed."""
    shift_px: np.ndarray | None = None
    shared_lines: np.ndarray | None = None
    station: np.ndarray | None = None
    """uint8 [n]; None where the cloud has one station."""


class Stations(NamedTuple):
    """The places from which the profiles of a joined cloud were taken."""

    number: Int[Array, " profiles"]
    """Station of each profile."""
    pose: Float[Array, "stations 4 4"]
    """T_room_scanner of each station [m]."""
    covariance: Float[Array, "stations 6 6"]
    """Covariance of a step (translation [m], rotation [rad]) in the station's own frame; zero for the station that is
    the room."""


class PointCloud(eqx.Module):
    """Points on the grid [profile, line]: neighbours in the scan stay neighbours.

    Scanner frame, metres; the frame of the room where clouds of several stations were joined. Entries that are not
    `valid` are zero, never NaN.
    """

    xyz: Float[Array, "profiles lines 3"]
    rgb: UInt8[Array, "profiles lines 3"]
    """Colour, from the laser-off image; grey for a mono camera; predicted where there is none."""
    intensity: Float[Array, "profiles lines"]
    """Fitted amplitude of the stripe [DN]."""
    normals: Float[Array, "profiles lines 3"]
    """Unit normals towards the camera; zero where there is none."""
    sigma_random: Float[Array, "profiles lines"]
    """Standard deviation along the ray from the stripe's noise [m]; independent per point without `shared_lines`."""
    sigma_systematic: Float[Array, "profiles lines"]
    """Standard deviation along the ray from the calibration, shared by all points [m]; zero
    where the scanner has no covariance."""
    valid: Bool[Array, "profiles lines"]
    record: Int[Array, " profiles"]
    laser: Int[Array, " profiles"]
    angle: Float[Array, " profiles"]
    """The table's angle phi of the profile [rad from home], or the stage's position [m]."""
    sigma_row: Float[Array, "profiles lines"] | None = None
    """`sigma_random` that the point would have from its own row alone [m]; None where rows were not smoothed."""
    shift_px: Float[Array, "profiles lines"] | None = None
    """Centre of the row's own fit minus that of the point [px], across the line."""
    shared_lines: Float[Array, "profiles lines"] | None = None
    """Lines over which the noise of a point is shared: its correlation with the k-th next line of its profile is about
    1 - k / shared_lines. Points share noise with no other profile."""
    stations: Stations | None = None
    """Where each profile was taken from; None for the cloud of one station, which is in its scanner frame."""
    absent: tuple[str, ...] | None = eqx.field(static=True, default=None)
    """Fields of `MAY_LACK` that the cloud's file did not have. They are zero here, not known, and not written. None
    where all are there, as in every cloud of `reconstruct`."""

    @property
    def lacks(self) -> tuple[str, ...]:
        """What is absent; nothing where all is there."""
        return self.absent or ()

    def points(self, start: int = 0, stop: int | None = None) -> CloudPoints:
        """The valid points as a flat list, of all profiles or of those from `start` to before `stop`."""
        profiles, lines = self.valid.shape
        start, stop, _ = slice(start, stop).indices(profiles)
        return self.points_of_cells(start * lines, stop * lines)

    def points_of_cells(self, start: int, stop: int) -> CloudPoints:
        """The valid points as a flat list, of the cells from `start` to before `stop`, counted line after line."""
        lines = self.valid.shape[1]
        cells = start + np.flatnonzero(_flat(self.valid)[start:stop])
        step, row = np.divmod(cells, lines)

        def take(field, dtype):
            return _flat(field)[cells].astype(dtype, copy=False)

        random, systematic = take(self.sigma_random, np.float32), take(self.sigma_systematic, np.float32)
        return CloudPoints(
            xyz=take(self.xyz, np.float64 if self.xyz.dtype == np.float64 else np.float32),
            normals=take(self.normals, np.float32),
            rgb=take(self.rgb, np.uint8),
            intensity=take(self.intensity, np.float32),
            sigma=np.hypot(random, systematic),
            sigma_random=random,
            sigma_systematic=systematic,
            step=step.astype(np.int32),
            row=row.astype(np.int32),
            laser=np.asarray(self.laser)[step].astype(np.uint8),
            **{name: take(getattr(self, name), np.float32) for name in SMOOTHED if getattr(self, name) is not None},
            station=None if self.stations is None else np.asarray(self.stations.number)[step].astype(np.uint8),
        )


def some_points(cloud: PointCloud, wanted: int) -> np.ndarray:
    """Every k-th valid point, float64 [n, 3], so that it is `wanted` to twice as many of a cloud with more."""
    xyz, valid = _flat(cloud.xyz), _flat(cloud.valid)
    every = max(1, int(np.count_nonzero(valid)) // wanted)
    found, seen = [], 0
    for start in range(0, len(valid), _AT_ONCE):
        cells = start + np.flatnonzero(valid[start : start + _AT_ONCE])
        found.append(xyz[cells[-seen % every :: every]].astype(np.float64))
        seen += len(cells)
    return np.concatenate(found)


def _flat(field: Array) -> np.ndarray:
    """A field of cells in a row."""
    values = np.asarray(field)
    return values.reshape(-1, *values.shape[2:])


def join_clouds(
    clouds: Sequence[PointCloud], poses: Sequence[np.ndarray], covariances: Sequence[np.ndarray]
) -> PointCloud:
    r"""One cloud in the frame of the room; its profiles are those of all stations, one after the other.

    The systematic variance of a point p grows by that of its station's pose, in the direction in which that is
    largest: a turn moves points across their rays. It is the largest eigenvalue of $J C J^T$ with
    $J = (I,\; -[p]_\times)$, p in the scanner frame of the station.

    Args:
        clouds: Of each station, in its own scanner frame; all of one camera.
        poses: T_room_scanner of each [4, 4].
        covariances: Of a step (translation [m], rotation [rad]) in each station's own frame [6, 6]; the part that
            a pose shares with the calibration is not counted.

    Returns:
        The joined cloud, NumPy arrays.

    Raises:
        CloudError: If there is none, a cloud is a joined one already, or the clouds differ in the number of lines.
    """
    if any(cloud.stations is not None for cloud in clouds):
        raise CloudError("join: found a cloud that is joined already; join the clouds of its stations.")
    smoothed = any(cloud.sigma_row is not None for cloud in clouds)
    moved = []
    for cloud, *place in zip(clouds, poses, covariances, strict=True):
        pose, covariance = (np.asarray(one, np.float64) for one in place)
        fields, station = _moved(cloud, pose, covariance, smoothed=smoothed), np.zeros(len(cloud.valid), np.int32)
        moved.append(
            PointCloud(**fields, stations=Stations(station, pose[None], covariance[None]), absent=cloud.absent)
        )
    return stack_placed(moved)


def _together_lack(clouds: Sequence[PointCloud]) -> tuple[str, ...] | None:
    """What clouds lack together: what none has, and sigmas that one of them lacks, whose points would seem perfect."""
    every, some = (how(*(set(cloud.lacks) for cloud in clouds)) for how in (set.intersection, set.union))
    return tuple(name for name in MAY_LACK if name in every or (name in some and name.startswith("sigma"))) or None


def stack_placed(clouds: Sequence[PointCloud], *, every: int = 1) -> PointCloud:
    """One cloud of clouds that are in the frame of the room already, as `join_clouds` placed each.

    Args:
        clouds: Each with its stations; all of one camera.
        every: Only every n-th profile of each.

    Raises:
        CloudError: If there is none, one was not placed, or the clouds differ in the number of lines.
    """
    if not clouds or len({len(cloud.valid[0]) for cloud in clouds}) > 1:
        raise CloudError("join: expected clouds of one camera, with the same number of lines.")
    placed = [cloud.stations for cloud in clouds if cloud.stations is not None]
    if len(placed) < len(clouds):
        raise CloudError("join: found a cloud without the place of its station, expected clouds of one frame.")
    thinned = [{name: None if value is None else value[::every] for name, value in _fields(c).items()} for c in clouds]
    names = [name for name in thinned[0] if all(fields[name] is not None for fields in thinned)]
    before = np.cumsum([0, *(len(stations.pose) for stations in placed)])
    numbers = [np.asarray(one.number)[::every] + first for one, first in zip(placed, before, strict=False)]
    return PointCloud(
        **{name: np.concatenate([fields[name] for fields in thinned]) for name in names},
        stations=Stations(
            np.concatenate(numbers).astype(np.int32),
            np.concatenate([np.asarray(one.pose, np.float64) for one in placed]),
            np.concatenate([np.asarray(one.covariance, np.float64) for one in placed]),
        ),
        absent=_together_lack(clouds),
    )


def of_station(cloud: PointCloud, number: int) -> PointCloud:
    """The cloud of one station of a joined cloud, in its own scanner frame; its sigmas keep the part of the pose."""
    if cloud.stations is None:
        return cloud
    mine = np.asarray(cloud.stations.number) == number
    pose = np.linalg.inv(np.asarray(cloud.stations.pose[number], np.float64))
    fields = {name: value[mine] for name, value in _fields(cloud).items() if value is not None}
    placed = _turned(fields["xyz"], fields["normals"], fields["valid"], pose)
    return PointCloud(**(fields | placed), absent=cloud.absent)


def in_scanner_frame(cloud: PointCloud) -> tuple[PointCloud, np.ndarray]:
    """The cloud of one station in its scanner frame, and T_room_scanner [4, 4]; of a cloud that was not moved, itself.

    Raises:
        CloudError: If it is joined of several stations.
    """
    if cloud.stations is None:
        return cloud, np.eye(4)
    if len(cloud.stations.pose) > 1:
        raise CloudError("the cloud is joined of several stations; take the cloud of one.")
    return of_station(cloud, 0), np.asarray(cloud.stations.pose, np.float64)[0]


def _fields(cloud: PointCloud) -> dict[str, Any]:
    """All but the stations, on the host."""
    names = ("xyz", "rgb", "intensity", "normals", "sigma_random", "sigma_systematic", "valid", "record", "laser")
    values = {name: getattr(cloud, name) for name in (*names, "angle", *SMOOTHED)}
    return {name: None if value is None else np.asarray(value) for name, value in values.items()}


def _turned(xyz: np.ndarray, normals: np.ndarray, valid: np.ndarray, pose: np.ndarray) -> dict[str, np.ndarray]:
    """Points and normals carried along, in their own precision; zero where they are not valid."""
    found = {"xyz": np.zeros_like(xyz), "normals": np.zeros_like(normals)}
    shift = {"xyz": pose[:3, 3], "normals": np.zeros(3)}
    for name, field in (("xyz", xyz), ("normals", normals)):
        flat, target = field.reshape(-1, 3), found[name].reshape(-1, 3)
        for start in range(0, len(flat), _POINTS_AT_ONCE):
            part = slice(start, start + _POINTS_AT_ONCE)
            moved = flat[part].astype(np.float64) @ pose[:3, :3].T + shift[name]
            target[part] = np.where(valid.reshape(-1)[part, None], moved, 0)
    return found


def _moved(cloud: PointCloud, pose: np.ndarray, covariance: np.ndarray, *, smoothed: bool) -> dict[str, Any]:
    """The fields of a cloud in the frame of the room, with the sigma of the pose."""
    fields = _fields(cloud)
    if smoothed and fields["sigma_row"] is None:
        # Rows by themselves, in the words of smoothed ones.
        zero = np.zeros_like(fields["sigma_random"])
        fields |= {"sigma_row": fields["sigma_random"], "shift_px": zero, "shared_lines": zero + zero.dtype.type(1)}
    own = fields["sigma_systematic"]
    # Profile by profile: matrices of all points at once would take ten times the memory of the cloud.
    variance = np.array([largest_variance(profile, covariance) for profile in fields["xyz"].astype(np.float64)])
    total = np.sqrt(own.astype(np.float64) ** 2 + variance)
    fields["sigma_systematic"] = np.where(fields["valid"], total, 0).astype(own.dtype)
    return fields | _turned(fields["xyz"], fields["normals"], fields["valid"], pose)


def largest_variance(p: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variance [n], m^2, of points [n, 3] by a step (translation, rotation) of their frame, along its largest axis."""
    if not covariance.any():
        return np.zeros(len(p))
    by_turn = np.zeros((len(p), 3, 3))
    by_turn[:, [2, 0, 1], [1, 2, 0]] = -p
    by_turn[:, [1, 2, 0], [2, 0, 1]] = p
    J = np.concatenate([np.broadcast_to(np.eye(3), by_turn.shape), by_turn], -1)
    return np.maximum(np.linalg.eigvalsh(J @ covariance @ J.swapaxes(1, 2))[:, -1], 0)
