"""Observations of a room made ready for the solver: checked, and padded to few different sizes."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, Turntable, square_root
from jaxscan.geometry.rigid import tangent_basis
from jaxscan.recalibration.adjust.room import Lengths, Places, Room, Sight, Unknowns
from jaxscan.recalibration.observed import RecalibrationSettings, RoomObservations, SurfacePoints, Tracks
from jaxscan.recalibration.result import Start


# Standard deviation of where the table stops, before it is learned: that of 1,600 microsteps a turn, or of a finer
# table with backlash [rad]; and one that is small enough to hold the angles as they are.
FIRST_STOP, HELD_STOP = 5e-4, 1e-7
# Numbers are rounded up to these, so that rooms of about the same size share a compilation.
_IMAGES = (0, 128, 256, 512, 1_024)
_POINTS = (1_000, 5_000, 10_000, 20_000, 40_000, 80_000, 160_000)
_SURFACES = (8, 32, 128, 512)
_SIGHTINGS = (0, 1_000, 5_000, 20_000, 80_000)
_TRACKS = (0, 256, 1_024, 4_096)
# Relative sigma of the gain of a table whose gear has no slip [1].
_CLOSED = 5e-6
# A held gain that is farther from 1 than this many of them contradicts it.
_CONTRADICTS = 5.0


class Angles(NamedTuple):
    """The angles of all records of all sweeps, one after another.

    Each image in which features are seen has an unknown correction: how far beside its angle the table stopped. All
    sightings in the image share it. In other records this is an error that the points of a wall share, see `errors`.
    """

    first: Int[np.ndarray, " sweeps"]
    phi: Float[np.ndarray, " records"]
    """Angles of the records, known faults corrected [rad from home]."""
    known: tuple[Float[np.ndarray, " records"], ...]
    """The known faults of every sweep [rad]."""
    knot: Int[np.ndarray, " records"]
    """Number of the unknown correction of each record; a record without one has the count of all corrections."""
    unknown: int
    """Unknown corrections, padding included."""


class Prepared(NamedTuple):
    """The problem without weights, and how it belongs to the observations; all on the host."""

    room: Room
    y: Unknowns
    """The step from the stored scanner to the start."""
    angles: Angles
    usable: Bool[np.ndarray, " points"]
    """Points that are finite; the others have weight 0."""
    seen: Bool[np.ndarray, " sightings"]
    """Sightings that are finite; the others have weight 0."""


def prepare(prior: Scanner, start: Start, observations: RoomObservations, settings: RecalibrationSettings) -> Prepared:
    """The joint problem seen from the stored scanner.

    Raises:
        CalibrationError: If the stored calibration has no covariance, or parts do not fit each other.
    """
    root, inverse = _prior_root(prior)
    angles = _make_angles(observations, start, prior, settings)
    rows, values = _closed(prior, root, settings)
    if observations.boards is not None:
        rows = np.concatenate([rows, np.zeros_like(root)])
        values = np.append(values, np.zeros(len(root)))
    points, usable = _sight_points(observations, angles)
    sightings, seen, first = _sight_tracks(observations, angles)
    places = _places(observations, first)
    room = Room(
        rig=prior.rig,
        root=root,
        linear_rows=rows,
        linear_values=values,
        stations=np.asarray(start.stations, np.float64),
        stop=np.full(angles.unknown, 1.0 / (settings.angle_sigma or FIRST_STOP)),
        places=places,
        points=points,
        point_weight=np.zeros(len(points.phi)),
        across=np.array([1.0, 0.0] if observations.stripe_axis == "rows" else [0.0, 1.0]),
        sightings=sightings,
        sighting_weight=np.zeros(len(sightings.phi)),
        lengths=_lengths(observations, len(places.offset)),
    )
    y = Unknowns(
        inverse @ prior.departure(start.scanner),
        np.zeros(6 * (len(room.stations) - 1)),
        np.zeros(angles.unknown),
        np.zeros((len(places.offset) + len(first), 3)),
    )
    return Prepared(room, y, angles, usable, seen)


def _make_angles(
    observations: RoomObservations, start: Start, scanner: Scanner, settings: RecalibrationSettings
) -> Angles:
    journal = [np.asarray(angle, np.float64) for angle in observations.angles]
    known = start.corrections or tuple(np.zeros(len(angle)) for angle in journal)
    if [len(angle) for angle in journal] != [len(extra) for extra in known]:
        raise CalibrationError("The start's corrections of angles are not of these sweeps: expected one per record.")
    first = np.concatenate([[0], np.cumsum([len(angle) for angle in journal])])[:-1].astype(np.int32)
    phi = np.concatenate([angle + extra for angle, extra in zip(journal, known, strict=True)])
    tracks, seen = observations.tracks, np.zeros(0, int)
    if (
        tracks is not None
        and len(tracks.q)
        and settings.angle_sigma != 0.0
        and isinstance(scanner.turntable, Turntable)
    ):
        seen = np.unique(first[tracks.sweep] + tracks.record)
    count = _bucket(len(seen), _IMAGES)
    knot = np.full(len(phi), count, np.int32)
    knot[seen] = np.arange(len(seen))
    return Angles(first, phi, known, knot, count)


def _closed(
    prior: Scanner, root: np.ndarray, settings: RecalibrationSettings
) -> tuple[Float[np.ndarray, "rows params"], Float[np.ndarray, " rows"]]:
    """A full turn of a closed gear is one turn exactly."""
    if not settings.closed or not isinstance(prior.turntable, Turntable):
        return np.zeros((0, len(root))), np.zeros(0)
    row = prior.parameter_names().index("gain")
    gain = float(prior.turntable.gain)
    if not root[row].any():
        # A row that no unknown meets would only add to the residuals.
        if abs(1.0 - abs(gain)) > _CONTRADICTS * _CLOSED:
            raise CalibrationError(
                f"The stored calibration holds the table's gain at {gain:.6f}, but a closed gear has 1 (--closed): "
                "leave out --closed, or calibrate with a gain that is not held."
            )
        return np.zeros((0, len(root))), np.zeros(0)
    return np.sign(gain) * root[row : row + 1] / _CLOSED, np.array([(1.0 - abs(gain)) / _CLOSED])


def _sight_points(observations: RoomObservations, angles: Angles) -> tuple[Sight, Bool[np.ndarray, " points"]]:
    points = observations.points
    if not len(points.q):
        if observations.tracks is None and observations.boards is None:
            raise CalibrationError("No stripe point lies on a surface of the room, so nothing can be adjusted.")
        zero = np.zeros(1, np.int32)
        return Sight(np.zeros((1, 2)), np.zeros(1), zero, zero, zero, zero), np.zeros(0, bool)
    return _sight(points, points.surface, points.laser, observations, angles, _POINTS)


def _sight_tracks(
    observations: RoomObservations, angles: Angles
) -> tuple[Sight, Bool[np.ndarray, " sightings"], Float[np.ndarray, "tracks 3"]]:
    tracks = observations.tracks
    if tracks is None or not len(tracks.q):
        none = np.zeros(0, np.int32)
        return Sight(np.zeros((0, 2)), np.zeros(0), none, none, none, none), np.zeros(0, bool), np.zeros((0, 3))
    sight, seen = _sight(tracks, tracks.track, np.zeros(len(tracks.q)), observations, angles, _SIGHTINGS)
    return sight, seen, _pad(np.asarray(tracks.point, np.float64), _bucket(len(tracks.point), _TRACKS))


def _sight(
    seen: SurfacePoints | Tracks,
    local: np.ndarray,
    laser: np.ndarray,
    observations: RoomObservations,
    angles: Angles,
    sizes: tuple[int, ...],
) -> tuple[Sight, Bool[np.ndarray, " seen"]]:
    """Points or sightings with their places, padded; and which of them are finite."""
    usable = np.isfinite(seen.q).all(1) & np.isfinite(seen.sigma) & (seen.sigma > 0)
    record = angles.first[seen.sweep] + seen.record
    whole = (observations.station[seen.sweep], angles.knot[record], local, laser)
    numbers = (np.asarray(field, np.int32) for field in whole)
    # The padding, and entries that are not finite, are copies of the first entry that can be computed.
    good = np.where(usable, np.arange(len(usable)), np.argmax(usable))
    fields = np.asarray(seen.q, np.float64), angles.phi[record], *numbers
    return Sight(*(_pad(field[good], _bucket(len(usable), sizes)) for field in fields)), usable


def _places(observations: RoomObservations, points: Float[np.ndarray, "tracks 3"]) -> Places:
    surfaces, upright = observations.surfaces, np.array([1.0, 0.0, 0.0])
    normal = np.asarray(surfaces.normal, np.float64).reshape(-1, 3)
    centre = np.asarray(surfaces.centre, np.float64).reshape(-1, 3)
    offset = np.asarray(surfaces.distance, np.float64) - (normal * centre).sum(1)
    basis = np.array([tangent_basis(n) for n in normal]).reshape(-1, 2, 3)
    more = _bucket(len(normal), _SURFACES) - len(normal)
    full = lambda array, fill: np.concatenate([array, np.broadcast_to(fill, (more, *fill.shape))])
    return Places(
        full(normal, upright),
        full(basis, tangent_basis(upright)),
        full(centre, np.zeros(3)),
        full(offset, np.array(0.0)),
        points,
    )


def _lengths(observations: RoomObservations, surfaces: int) -> Lengths:
    """Known lengths; tracked points are numbered after the surfaces, padding included."""
    begin = {"surfaces": 0, "tracks": surfaces}
    tracks = 0 if observations.tracks is None else len(observations.tracks.point)
    count = {"surfaces": len(observations.surfaces.distance), "tracks": tracks}
    for known in observations.lengths:
        ends = {known.first, known.second}
        if len(ends) < 2 or not ends <= set(range(count[known.between])):
            raise CalibrationError(
                f"A known length lies between {known.between} {known.first} and {known.second}, expected two different "
                f"ones of {count[known.between]}."
            )
    pairs = [[begin[known.between] + end for end in (known.first, known.second)] for known in observations.lengths]
    return Lengths(
        np.array(pairs, np.int32).reshape(-1, 2),
        np.array([known.metres for known in observations.lengths], np.float64),
        np.array([1.0 / known.sigma_m for known in observations.lengths], np.float64),
    )


def _bucket(count: int, sizes: tuple[int, ...]) -> int:
    """The first of the sizes that is large enough for the count; the count itself if none is."""
    return next((size for size in sizes if size >= count), count)


def _pad(array: np.ndarray, size: int) -> np.ndarray:
    """The array, padded to a size by copies of its first entry."""
    return np.concatenate([array, np.broadcast_to(array[:1], (size - len(array), *array.shape[1:]))])


def _prior_root(scanner: Scanner) -> tuple[Float[np.ndarray, "params params"], Float[np.ndarray, "params params"]]:
    r"""A square root A of the covariance, $C = A A^T$, by the eigenvectors of the correlations; and its pseudo-inverse.

    A step of the scanner is $A z$ with $z$ normal: every unknown has size 1 however badly the covariance is
    scaled, and directions without variance are held, since their columns are zero.
    """
    names = scanner.parameter_names()
    if scanner.covariance is None:
        raise CalibrationError(
            "The stored calibration has no covariance, so nothing says how far it may be off: calibrate from boards "
            "again, and recalibrate from that file."
        )
    covariance = np.asarray(scanner.covariance, np.float64)
    if covariance.shape != (len(names), len(names)) or not np.isfinite(covariance).all():
        raise CalibrationError(
            f"The stored calibration's covariance has shape {covariance.shape} or is not finite, expected "
            f"{len(names)} x {len(names)} numbers: calibrate from boards again."
        )
    root = square_root((covariance + covariance.T) / 2)
    return root.steps.T, root.inverse.T
