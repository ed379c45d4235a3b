"""The points of a cloud as a list, with noise, laser, angle and profile."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Array


SIGMA_FLOOR_M = 1e-4
"""Smallest assumed noise of a point [m]: surfaces are no smoother, and clouds without sigma can be
measured too."""


@runtime_checkable
class Cloud(Protocol):
    """The fields of `PointCloud` that measurements read."""

    @property
    def xyz(self) -> Array: ...
    @property
    def sigma_random(self) -> Array: ...
    @property
    def valid(self) -> Array: ...
    @property
    def laser(self) -> Array: ...
    @property
    def angle(self) -> Array: ...


class Samples(NamedTuple):
    """Points of a cloud as a list."""

    p: np.ndarray
    """Points [n, 3], m, scanner frame."""
    sigma: np.ndarray
    """Standard deviation along the ray [n], m; not below the floor."""
    laser: np.ndarray
    """Laser of each point [n]."""
    angle: np.ndarray
    """The table's angle [n], rad from home."""
    profile: np.ndarray
    """Profile of each point [n]."""

    def take(self, index: np.ndarray) -> "Samples":
        """The points at `index` (numbers or a mask)."""
        return Samples(*(field[index] for field in self))

    @staticmethod
    def joined(parts: "Sequence[Samples]") -> "Samples":
        """The points of several parts, one after the other."""
        return Samples(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))

    def sigma_across(self, normal: np.ndarray) -> np.ndarray:
        """Standard deviation along `normal` [n], m: the noise lies along the ray, and the camera
        is near the origin."""
        distance = np.linalg.norm(self.p, axis=1)
        cosine = np.abs(self.p @ normal) / np.where(distance > 0, distance, 1.0)
        return np.hypot(self.sigma * cosine, SIGMA_FLOOR_M)


def samples_of(cloud: Cloud) -> Samples:
    """All valid points, in the order of the grid.

    Raises:
        MeasurementError: If the cloud has no points.
    """
    valid = np.asarray(cloud.valid)
    profile = np.nonzero(valid)[0]
    if len(profile) == 0:
        raise MeasurementError("The cloud has no valid points; nothing can be measured in it.")
    return Samples(
        p=np.asarray(cloud.xyz)[valid].astype(np.float64),
        sigma=np.maximum(np.asarray(cloud.sigma_random)[valid].astype(np.float64), SIGMA_FLOOR_M),
        laser=np.asarray(cloud.laser)[profile],
        angle=np.asarray(cloud.angle, np.float64)[profile],
        profile=profile,
    )


def spread_out(count: int, wanted: int, rng: np.random.Generator) -> np.ndarray:
    """At most `wanted` of `count` indices, at random without repetition, in order."""
    if count <= wanted:
        return np.arange(count)
    return np.sort(rng.choice(count, wanted, replace=False, shuffle=False))
