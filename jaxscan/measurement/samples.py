"""The points of a cloud as a list, with noise, laser, angle and profile; which clouds are fit for measuring."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Array, Hand, Scanner, poses, transform


SIGMA_FLOOR_M = 1e-4
"""Smallest assumed noise of a point [m]: surfaces are no smoother, and clouds without sigma can be
measured too."""


@runtime_checkable
class Cloud(Protocol):
    """The fields of `PointCloud` that measurements read.

    `sigma_row`, `shared_lines` and `stations` too, where a cloud has them.
    """

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


class Places(NamedTuple):
    """The stations T_room_scanner [stations, 4, 4] of a cloud, one at the origin where it has none, by profile."""

    number: np.ndarray
    pose: np.ndarray
    covariance: np.ndarray
    """Covariance of a step (translation [m], rotation [rad]) in the station's own frame [stations, 6, 6]."""


class Samples(NamedTuple):
    """Points [n] of a cloud as a list, with laser, profile, line, station and angle [rad from home] of each."""

    p: np.ndarray
    """Points [n, 3], m, scanner frame; the frame of the room where a cloud has several stations."""
    sigma: np.ndarray
    """Standard deviation along the ray [n], m; not below the floor."""
    laser: np.ndarray
    angle: np.ndarray
    profile: np.ndarray
    line: np.ndarray
    sigma_row: np.ndarray
    shared: np.ndarray
    """Lines over which the noise of each point is shared [n]; 1 where it is independent."""
    station: np.ndarray
    origin: np.ndarray
    """The station's origin, near which the camera was [n, 3], m."""

    def take(self, index: np.ndarray) -> "Samples":
        """The points at `index` (numbers or a mask)."""
        return Samples(*(field[index] for field in self))

    def moved(self, step: np.ndarray) -> "Samples":
        """The points, and where they were seen from, after a shift [3], m."""
        return self._replace(p=self.p + step, origin=self.origin + step)

    @staticmethod
    def joined(parts: "Sequence[Samples]") -> "Samples":
        """The points of several parts, one after the other."""
        return Samples(*(np.concatenate(fields) for fields in zip(*parts, strict=True)))

    def sigma_across(self, normal: np.ndarray) -> np.ndarray:
        """Standard deviation along `normal` [n], m: the noise lies along the ray, and the camera
        is near the origin of its station."""
        return np.hypot(self.sigma * self._cosine(normal), SIGMA_FLOOR_M)

    def weights_across(self, normal: np.ndarray) -> np.ndarray:
        """Weights [n], m^-2, with which averages along `normal` are best: those of the rows."""
        return np.hypot(self.sigma_row * self._cosine(normal), SIGMA_FLOOR_M) ** -2

    def covariance_of(self, factors: np.ndarray, normal: np.ndarray) -> np.ndarray:
        r"""Covariance [k, k] of $\sum_i f_i x_i$, f [k, n], of points displaced by their noise x along `normal`.

        Points of one profile share noise: two that are k lines apart are correlated by 1 - k / shared lines.
        """
        order = np.lexsort((self.line, self.profile))
        profile, line, shared = self.profile[order], self.line[order], self.shared[order]
        noise = factors[:, order] * (self.sigma * self._cosine(normal))[order]
        covariance = noise @ noise.T + SIGMA_FLOOR_M**2 * factors @ factors.T
        for ahead in range(1, min(int(np.ceil(shared.max())), len(order))):
            apart = (line[ahead:] - line[:-ahead]) / np.sqrt(shared[ahead:] * shared[:-ahead])
            together = np.where(profile[ahead:] == profile[:-ahead], np.maximum(1.0 - apart, 0.0), 0.0)
            if not together.any():
                break
            both = (noise[:, ahead:] * together) @ noise[:, :-ahead].T
            covariance += both + both.T
        return covariance

    def _cosine(self, normal: np.ndarray) -> np.ndarray:
        ray = self.p - self.origin
        # Five times as fast as the norm of rows, and called thousands of times for a room.
        distance = np.sqrt(np.einsum("ij,ij->i", ray, ray))
        return np.abs(ray @ normal) / np.where(distance > 0, distance, 1.0)


AT_ONCE = 1 << 17
"""Points that are looked at together."""
_SOME = 500_000


class CloudSamples:
    """All valid points of a cloud, in the order of its grid. Only some are samples at a time.

    Samples take three times the memory of a cloud's own fields.
    """

    def __init__(self, cloud: Cloud, *, origin: np.ndarray | None = None, steps: tuple[np.ndarray, ...] = ()) -> None:
        """Nothing is taken from the cloud yet.

        Args:
            cloud: The cloud.
            origin: Where all points were seen from, instead of from their stations [3], m.
            steps: By which points and origin are shifted, one after the other [3], m.

        Raises:
            MeasurementError: If the cloud has no points.
        """
        self._valid = np.asarray(cloud.valid)
        self._lines = self._valid.shape[1]
        stops = range(0, self._valid.size, AT_ONCE)
        flat = self._valid.reshape(-1)
        self._counts = np.cumsum([0, *(np.count_nonzero(flat[k : k + AT_ONCE]) for k in stops)])
        if len(self) == 0:
            raise MeasurementError("The cloud has no valid points; nothing can be measured in it.")
        self._cloud, self._places = cloud, places_of(cloud)
        self._origin, self._steps = origin, steps

    def __len__(self) -> int:
        return int(self._counts[-1])

    def moved(self, step: np.ndarray) -> "CloudSamples":
        """The points, and where they were seen from, after a shift [3], m."""
        return CloudSamples(self._cloud, origin=self._origin, steps=(*self._steps, np.asarray(step)))

    def seen_from(self, place: np.ndarray) -> "CloudSamples":
        """The points as if they were seen from a place [3], m."""
        return CloudSamples(self._cloud, origin=place, steps=self._steps)

    def blocks(self) -> Iterator[Samples]:
        """All points, some at a time."""
        for number in range(len(self._counts) - 1):
            if self._counts[number + 1] > self._counts[number]:
                yield self._of(self._cells(number))

    def take(self, index: np.ndarray) -> Samples:
        """The points at `index`, which is in order."""
        ends = np.searchsorted(index, self._counts)
        parts = [
            self._cells(number)[index[start:stop] - self._counts[number]]
            for number, (start, stop) in enumerate(itertools.pairwise(ends))
            if stop > start
        ]
        return self._of(np.concatenate(parts) if parts else np.zeros(0, np.int64))

    def all(self) -> Samples:
        """Every point."""
        return self._of(np.flatnonzero(self._valid))

    def chosen(self, choose: Callable[[Samples], np.ndarray]) -> np.ndarray:
        """Numbers of the points for which a rule is True [n], in order."""
        parts, start = [], 0
        for block in self.blocks():
            parts.append(start + np.flatnonzero(choose(block)))
            start += len(block.p)
        return np.concatenate(parts)

    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """The smallest and the largest coordinates [3], m."""
        low, high = zip(*((block.p.min(0), block.p.max(0)) for block in self.blocks()), strict=True)
        return np.min(low, axis=0), np.max(high, axis=0)

    def some_places(self) -> np.ndarray:
        """Every k-th point [n, 3], m; all of a cloud of less than a million. Enough for the quantiles of its places."""
        every = max(1, len(self) // _SOME)
        found, seen = [], 0
        for block in self.blocks():
            found.append(block.p[-seen % every :: every].copy())
            seen += len(block.p)
        return np.concatenate(found)

    def mean_origin(self) -> np.ndarray:
        """The mean place from which the points were seen [3], m."""
        per_profile = np.count_nonzero(self._valid, axis=1)
        weights = np.bincount(self._places.number, per_profile, len(self._places.pose))
        return np.asarray(weights @ self._places.pose[:, :3, 3] / len(self))

    def first_origin(self) -> np.ndarray:
        """The place from which the first point was seen [3], m."""
        return np.asarray(self.take(np.zeros(1, int)).origin[0])

    def turns(self) -> bool:
        """Whether not all points have the same angle."""
        angle = np.asarray(self._cloud.angle, np.float64)[self._valid.any(1)]
        return bool(np.ptp(angle) > 0)

    def _cells(self, number: int) -> np.ndarray:
        """Valid cells of a block, counted line after line."""
        start = number * AT_ONCE
        return start + np.flatnonzero(self._valid.reshape(-1)[start : start + AT_ONCE])

    def _of(self, cells: np.ndarray) -> Samples:
        cloud, places = self._cloud, self._places

        def take(field: Array) -> np.ndarray:
            values = np.asarray(field)
            return values.reshape(-1, *values.shape[2:])[cells].astype(np.float64)

        profile, line = np.divmod(cells, self._lines)
        # Not in the protocol: clouds whose rows were not smoothed need not have them.
        row, lines = (getattr(cloud, name, None) for name in ("sigma_row", "shared_lines"))
        sigma = np.maximum(take(cloud.sigma_random), SIGMA_FLOOR_M)
        station = places.number[profile]
        found = Samples(
            p=take(cloud.xyz),
            sigma=sigma,
            laser=np.asarray(cloud.laser)[profile],
            angle=np.asarray(cloud.angle, np.float64)[profile],
            profile=profile,
            line=line,
            sigma_row=sigma if row is None else np.maximum(take(row), SIGMA_FLOOR_M),
            shared=np.ones(len(line)) if lines is None else np.maximum(take(lines), 1.0),
            station=station,
            origin=places.pose[station, :3, 3],
        )
        if self._origin is not None:
            found = found._replace(origin=np.broadcast_to(self._origin, found.p.shape))
        for step in self._steps:
            found = found.moved(step)
        return found


def samples_of(cloud: Cloud) -> Samples:
    """All valid points, in the order of the grid; refused where there are none."""
    return CloudSamples(cloud).all()


def about_the_scanner(samples: CloudSamples) -> tuple[CloudSamples, np.ndarray]:
    """The samples about the place from which they were seen, and that place [3], m.

    The origin of a map is far from a room, and that of an aligned cloud is in a corner of it. Where the cloud does not
    say where the scanner stood, it is taken to be amid the points.
    """
    low, high = samples.ends()
    place = samples.mean_origin()
    if np.linalg.norm(np.clip(place, low, high) - place) > np.linalg.norm(high - low):
        place = np.array([np.median(axis) for axis in samples.some_places().T])
        samples = samples.seen_from(place)
    return samples.moved(-place), place


def places_of(cloud: Cloud) -> Places:
    """Poses of the stations of a cloud and their covariances."""
    stations = getattr(cloud, "stations", None)
    if stations is None:
        return Places(np.zeros(len(cloud.valid), int), np.eye(4)[None], np.zeros((1, 6, 6)))
    pose, covariance = (np.asarray(field, np.float64) for field in (stations.pose, stations.covariance))
    return Places(np.asarray(stations.number), pose, covariance)


def camera_centres(cloud: Cloud, scanner: Scanner | None) -> np.ndarray:
    """Where the camera was at each profile [profiles, 3], m; without a scanner in the origin of its station.

    Raises:
        MeasurementError: If the scanner rides on a hand whose poses are not there.
    """
    places, angle = places_of(cloud), np.asarray(cloud.angle, np.float64)
    check_path(scanner, angle)
    centre = np.zeros((len(angle), 3)) if scanner is None else poses(scanner.rig, angle)[:, :3, 3]
    return np.asarray(transform(places.pose[places.number], centre))


def check_path(scanner: Scanner | None, angle: np.ndarray) -> None:
    """Refuse a scanner on a hand without the poses of these profiles."""
    motion = None if scanner is None else scanner.turntable
    if isinstance(motion, Hand) and len(angle) and angle.max() >= len(motion.path):
        raise MeasurementError(
            "The calibration is that of a camera on a hand, and a cloud does not hold the hand's poses: measure "
            "without the calibration, or in Python give scanner.along(capture.poses)."
        )


def spread_out(count: int, wanted: int, rng: np.random.Generator) -> np.ndarray:
    """At most `wanted` of `count` indices, at random without repetition, in order."""
    if count <= wanted:
        return np.arange(count)
    return np.sort(rng.choice(count, wanted, replace=False, shuffle=False))


FARTHEST_M = 1e8
"""Largest coordinate of a point [m]: more than twice around the Earth."""


LEAST_KNOWN = 0.2
"""Largest relative standard deviation of a dimension [1]; above it the dimension counts as not measured."""


def is_known(value: float, sigma: float) -> bool:
    """Whether a length, an area or a volume is known well enough to be stated."""
    # NaN fails too.
    return sigma <= LEAST_KNOWN * value


def require_known(what: str, value_m: float, sigma_m: float) -> None:
    """Refuse to state a length that is not known.

    Raises:
        MeasurementError: If its standard deviation is too large a share of it.
    """
    if not is_known(value_m, sigma_m):
        raise MeasurementError(
            f"The {what} is not known: {1e3 * value_m:.3g} mm with a standard deviation of {1e3 * sigma_m:.3g} mm, "
            f"expected at most {100 * LEAST_KNOWN:.0f} % of it; average more points, or measure something longer."
        )


def checked_samples(cloud: Cloud) -> CloudSamples:
    """All valid points.

    Raises:
        MeasurementError: If there are none, or if a coordinate or sigma is no number that a point can have.
    """
    samples = CloudSamples(cloud)
    finite, known = True, False
    valid = np.asarray(cloud.valid)
    # Profile by profile, or a part of a long one: only that is copied.
    for xyz, sigma, seen in _parts(np.asarray(cloud.xyz), np.asarray(cloud.sigma_random), valid):
        # NaN fails too.
        if not (np.abs(xyz[seen]) <= FARTHEST_M).all():
            raise MeasurementError(f"The cloud has coordinates that are not numbers within {FARTHEST_M:g} m of 0.")
        finite &= bool(np.isfinite(sigma[seen]).all())
        known |= bool((sigma[seen] > 0).any())
    if not (finite and known):
        raise MeasurementError(
            "The cloud has no sigmas, so the uncertainty of a measured number is unknown; a cloud of jaxscan "
            "reconstruct is needed, as .ply or .npz."
        )
    return samples


def _parts(*fields: np.ndarray) -> Iterator[tuple[np.ndarray, ...]]:
    flat = [field.reshape(-1, *field.shape[2:]) for field in fields]
    for start in range(0, len(flat[0]), AT_ONCE):
        yield tuple(field[start : start + AT_ONCE] for field in flat)
