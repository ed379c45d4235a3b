"""All that goes into a recalibration: settings, stripes of sweeps, what is known of the room, observations of it."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.geometry import StripeAxis, stripe_pixel
from jaxscan.observation import Observations
from jaxscan.reconstruction import ReconstructSettings


@dataclass(frozen=True)
class RecalibrationSettings:
    """How sweeps refine a stored calibration."""

    stations: bool = False
    """Whether every sweep was taken from a place of its own."""
    stripes: ReconstructSettings = field(default_factory=ReconstructSettings)
    """How stripes are found in captures."""
    closed: bool | None = None
    """Whether the table's full turn is exactly one turn (a gear without slip); None: no assumption."""
    angle_sigma: float | None = None
    """Standard deviation of where the table stops about the angle of its record [rad]; None: learned from walls and
    features; 0: it stops at the angle."""
    features: bool | None = None
    """Whether features of the laser-off images are tracked from step to step; None: where they have texture."""
    points: int = 40_000
    """Points on surfaces that are used at most."""


class SweepStripes(NamedTuple):
    """The stripes of one captured sweep on the grid [profile, line]; they do not depend on the calibration."""

    name: str
    centre: Float[np.ndarray, "profiles lines"]
    """Across the line [px]; of its neighbours too, where rows are smoothed."""
    sigma: Float[np.ndarray, "profiles lines"]
    shared_lines: Float[np.ndarray, "profiles lines"]
    """Lines over which the noise of a centre is shared; 1 where it is independent."""
    valid: Bool[np.ndarray, "profiles lines"]
    record: Int[np.ndarray, " profiles"]
    laser: Int[np.ndarray, " profiles"]
    """The scanner's sheet of each profile."""
    angle: Float[np.ndarray, " records"]
    """The table's angle of each record as the journal has it [rad from home]."""
    stripe_axis: StripeAxis
    station: int = 0
    """The place in the room that it was taken from."""

    def pixels(self, profile: Int[np.ndarray, " n"], line: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
        """The pixels (u, v) of stripes [px]."""
        return np.asarray(stripe_pixel(self.centre[profile, line].astype(np.float64), line * 1.0, self.stripe_axis))

    def turned(self, correction: Float[np.ndarray, " records"]) -> "SweepStripes":
        """The sweep with a correction added to the angles of its records [rad]."""
        return self._replace(angle=self.angle + correction)


class Surfaces(NamedTuple):
    """Flat surfaces of the room, `normal . p = distance` [m], in the frame of the room: that of the first station.

    A surface has three unknowns: two tilts and its distance.
    """

    normal: Float[np.ndarray, "surfaces 3"]
    distance: Float[np.ndarray, " surfaces"]
    centre: Float[np.ndarray, "surfaces 3"]
    """Mean of the points [m]."""


class SurfacePoints(NamedTuple):
    """Stripe points that lie on surfaces, so far apart that their noise is independent; of all sweeps."""

    q: Float[np.ndarray, "points 2"]
    """Pixel (u, v) of the stripe [px]."""
    sigma: Float[np.ndarray, " points"]
    """Standard deviation across the line [px]: of u where `stripe_axis` is "rows", else of v."""
    sweep: Int[np.ndarray, " points"]
    record: Int[np.ndarray, " points"]
    line: Int[np.ndarray, " points"]
    laser: Int[np.ndarray, " points"]
    surface: Int[np.ndarray, " points"]

    def take(self, index: np.ndarray) -> "SurfacePoints":
        """The points at `index` (numbers or a mask)."""
        return SurfacePoints(*(field[index] for field in self))


class Tracks(NamedTuple):
    """Points of the room that are recognised in several images; each has three unknowns."""

    q: Float[np.ndarray, "sightings 2"]
    """Where the point is seen [px]."""
    sigma: Float[np.ndarray, " sightings"]
    """Standard deviation of u and of v [px]."""
    sweep: Int[np.ndarray, " sightings"]
    record: Int[np.ndarray, " sightings"]
    track: Int[np.ndarray, " sightings"]
    point: Float[np.ndarray, "tracks 3"]
    """First values, in the frame of the room [m]."""
    name: tuple[str, ...] = ()
    """A name for each point that is a target ("marker 7, corner 2"); empty for a feature that was tracked."""


Place = str | Float[np.ndarray, "3"]
"""The name of a target among the tracks, or a point on a wall, in the frame of the room as the stored calibration has
it [m]."""


class MeasuredLength(NamedTuple):
    """A length that somebody measured, by the places of its ends."""

    metres: float
    sigma_m: float
    first: Place
    second: Place
    name: str = ""


@dataclass(frozen=True)
class Given:
    """All that is known of the room beside its sweeps; everything may be absent."""

    stations: Float[np.ndarray, "stations 4 4"] | None = None
    """First poses T_room_scanner, the identity first; None: they are found from planes and targets."""
    tracks: Tracks | None = None
    lengths: tuple[MeasuredLength, ...] = ()
    boards: Observations | None = None


class KnownLength(NamedTuple):
    """A length that somebody measured: between two planes or two tracked targets."""

    metres: float
    sigma_m: float
    between: Literal["surfaces", "tracks"]
    first: int
    """Number of the surface or track. Planes: their distance along the mean normal, midway between their centres."""
    second: int


class RoomObservations(NamedTuple):
    """All that one adjustment takes in."""

    points: SurfacePoints
    surfaces: Surfaces
    angles: tuple[Float[np.ndarray, " records"], ...]
    """The table's angles of every sweep as its journal has them [rad from home]."""
    station: Int[np.ndarray, " sweeps"]
    """Station of each sweep; 0 is the frame of the room."""
    stripe_axis: StripeAxis
    tracks: Tracks | None = None
    lengths: tuple[KnownLength, ...] = ()
    boards: Observations | None = None

    def turned(self, corrections: Sequence[np.ndarray]) -> tuple[Float[np.ndarray, " records"], ...]:
        """The angles of every sweep with corrections [rad]; without any, as they are."""
        return tuple(map(np.add, self.angles, corrections)) if len(corrections) else self.angles

    def angles_of(self, points: SurfacePoints, corrections: Sequence[np.ndarray] = ()) -> Float[np.ndarray, " points"]:
        """The table's angle of each point, with the corrections of every sweep [rad]."""
        ends = np.cumsum([0, *(len(angle) for angle in self.angles)])
        return np.concatenate(self.turned(corrections))[ends[points.sweep] + points.record]

    def only(self, numbers: Sequence[int]) -> "RoomObservations":
        """The observations of some surfaces, which get new numbers; known lengths stay only if both their ends do."""
        new = np.full(len(self.surfaces.distance), -1, np.int32)
        new[list(numbers)] = np.arange(len(numbers), dtype=np.int32)
        lengths = [
            length._replace(first=int(new[length.first]), second=int(new[length.second]))
            if length.between == "surfaces"
            else length
            for length in self.lengths
        ]
        points, surfaces = self.points.take(new[self.points.surface] >= 0), self.surfaces
        return self._replace(
            points=points._replace(surface=new[points.surface]),
            surfaces=Surfaces(*(field[list(numbers)] for field in surfaces)),
            lengths=tuple(length for length in lengths if min(length.first, length.second) >= 0),
        )
