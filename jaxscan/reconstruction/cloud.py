"""The organised point cloud."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.geometry import Array


SMOOTHED = ("sigma_row", "shift_px", "shared_lines")
"""Fields that a cloud has where its points use their neighbours, and not otherwise."""


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
    """Of a step (translation [m], rotation [rad]) in the station's own frame; zero for the station that is the room."""


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


_AT_ONCE = 1 << 20


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
