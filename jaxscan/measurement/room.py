"""The dimensions of a room, from wall to wall."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from jaxscan.errors import MeasurementError
from jaxscan.geometry import Scanner
from jaxscan.measurement.planes import Plane, feet_on
from jaxscan.measurement.samples import Cloud, CloudSamples, Samples, about_the_scanner, is_known, places_of
from jaxscan.measurement.systematic import systematic_sigma
from jaxscan.measurement.walls import BEYOND, Wall, find_planes, outermost, refine_wall, wall_weights


LEVEL = np.cos(np.radians(15.0))
"""|z| of a normal above which a plane is floor or ceiling."""
UPRIGHT = np.sin(np.radians(15.0))
"""|z| of a normal below which a plane is a wall."""
ALONG = np.radians(20.0)
"""Largest angle of a wall to the room's own direction."""
PARALLEL = np.cos(np.radians(5.0))
"""Least cosine between two walls that are opposite each other."""


@dataclass(frozen=True)
class Dimension:
    """Distance of two opposite walls along their mean normal; sigmas are predicted, RMS is of their points."""

    value_m: float
    """Distance along the pair's mean normal through the room's centre [m]."""
    sigma_m: float
    sigma_random_m: float
    sigma_systematic_m: float
    """The part from the covariance of the calibration [m]; 0 where it is not known."""
    rms_m: float
    points: int
    angle_deg: float
    direction: np.ndarray


@dataclass(frozen=True)
class RoomBox:
    """A room's dimensions, the longer horizontal one first; None if one of the two walls was not seen."""

    length: Dimension | None
    width: Dimension | None
    height: Dimension | None
    centre_m: np.ndarray
    """Middle between the walls [3], m, scanner frame; distances are taken there."""
    walls: tuple[Wall, ...] = field(repr=False)
    """Every bounding plane that was found, with its points, normals pointing out of the room."""
    remarks: tuple[str, ...] = ()
    """Why dimensions are left out, where planes were found for them: parts of a sentence."""

    @property
    def sides(self) -> dict[str, Dimension]:
        """The dimensions that were found, by name."""
        named = {"length": self.length, "width": self.width, "height": self.height}
        return {name: side for name, side in named.items() if side is not None}


def measure_room(cloud: Cloud, *, scanner: Scanner | None = None, seed: int = 0) -> RoomBox:
    """Measure a room from wall to wall.

    The walls are the outermost large planes in each direction, not those with the most points,
    fitted by weighted least squares. Opposite walls are parallel to 5 degrees, at most a fifth of the
    points is behind a wall, and a dimension is known to a fifth of itself. As opposite walls are
    never quite parallel, a dimension is the distance between them along their mean normal through the
    room's centre: the point midway between the walls of every pair, and nearest the origin where a pair
    is missing.

    Args:
        cloud: The room, scanned from within; z of the scanner frame is vertical within 10 degrees.
        scanner: The scanner it was made with; its covariance gives the systematic part of sigma.
        seed: Seed of the random hypotheses; the result is deterministic.

    Returns:
        Length, width and height [m] as far as they were seen, each with its standard deviation.

    Raises:
        MeasurementError: If no two opposite walls are found between which the points are.
    """
    samples, place = about_the_scanner(CloudSamples(cloud))
    rng = np.random.default_rng(seed)
    pairs, planes, remarks = bounding_walls(samples, rng, seed=seed)
    opposite = [(pair, float(-pair[0].plane.normal @ pair[1].plane.normal)) for pair in pairs if len(pair) == 2]
    found = [pair for pair, cosine in opposite if cosine > PARALLEL]
    for _, cosine in opposite:
        if cosine <= PARALLEL:
            remarks.append(f"opposite walls are {np.degrees(np.arccos(cosine)):.0f} degrees from parallel")
    centre = _centre(found) if found else np.zeros(3)
    systematic = partial(systematic_sigma, scanner, places_of(cloud))
    measured = [_dimension(pair, centre, systematic, rng) for pair in found]
    dimensions = sorted((one for one in measured if is_known(one.value_m, one.sigma_m)), key=lambda each: -each.value_m)
    for one in measured:
        if not is_known(one.value_m, one.sigma_m):
            remarks.append(
                f"a distance of {one.value_m:.3g} m between walls has a standard deviation of {one.sigma_m:.2g} m"
            )
    if not dimensions:
        raise MeasurementError(
            f"No two opposite walls among {planes} planes in {len(samples)} points{because(remarks)}; "
            "a room must be scanned from within, all around, in steps of a few degrees."
        )
    height = next((each for each in dimensions if abs(each.direction[2]) > 0.5), None)
    horizontal = [each for each in dimensions if each is not height]
    return RoomBox(
        length=horizontal[0] if horizontal else None,
        width=horizontal[1] if len(horizontal) > 1 else None,
        height=height,
        centre_m=centre + place,
        walls=tuple(wall.moved(place) for pair in pairs for wall in pair),
        remarks=tuple(remarks),
    )


def because(remarks: Sequence[str]) -> str:
    """Remarks as the end of a sentence; empty without any."""
    return f" ({'; '.join(remarks)})" if remarks else ""


def bounding_walls(
    samples: CloudSamples, rng: np.random.Generator, *, seed: int
) -> tuple[list[list[Wall]], int, list[str]]:
    """The walls across each direction, the vertical last; among how many planes; and why planes are no walls."""
    inside = _place_inside(samples)
    seen = samples.moved(-inside)
    planes = find_planes(seen, seed=seed)
    pairs, remarks = [], []
    for direction in _directions(planes):
        found = [(wall, wall.behind(seen)) for wall in _pair(seen, planes, direction, rng)]
        pairs.append([wall.moved(inside) for wall, behind in found if behind <= BEYOND])
        remarks += [
            f"{100 * behind:.0f} % of the points lie behind a plane at {wall.plane.distance:.2f} m"
            for wall, behind in found
            if behind > BEYOND
        ]
    return pairs, len(planes), remarks


_NEAR_THE_RIM = 0.05
"""Share of its extent at either end of a cloud where nobody stands to scan it."""


def _place_inside(samples: CloudSamples) -> np.ndarray:
    """A place in the room from which its walls are seen: the scanner's, or the middle where that cannot be it.

    A cloud of another program has no angles and does not say where its scanner stood: its origin may be in a corner
    of the room, or on a map.
    """
    place = samples.first_origin()
    if samples.turns():
        return place
    low, high = np.array([np.percentile(axis, [1.0, 99.0]) for axis in samples.some_places().T]).T
    rim = _NEAR_THE_RIM * (high - low)
    within = (low + rim < place) & (place < high - rim)
    return place if within.all() else (low + high) / 2


def _directions(planes: list[tuple[Plane, np.ndarray]]) -> list[np.ndarray]:
    """Horizontal unit vectors across the walls, and the vertical."""
    vertical = np.array([0.0, 0.0, 1.0])
    if not any(is_upright(plane) for plane, _ in planes):
        return [vertical]
    along = main_direction(planes)
    return [along, np.cross(vertical, along), vertical]


def is_upright(plane: Plane) -> bool:
    """Whether a plane stands as a wall does."""
    return bool(abs(plane.normal[2]) < UPRIGHT)


def main_direction(planes: list[tuple[Plane, np.ndarray]]) -> np.ndarray:
    """The horizontal unit vector [3] across the walls that most points agree with, up to right angles; x without."""
    upright = [(plane, len(p)) for plane, p in planes if is_upright(plane)]
    if not upright:
        return np.array([1.0, 0.0, 0.0])
    azimuth = np.array([np.arctan2(plane.normal[1], plane.normal[0]) for plane, _ in upright])
    support = np.array([count for _, count in upright], float)
    # Walls are roughly at right angles: the direction modulo 90 degrees that most points agree with.
    gap = np.abs(_modulo_right_angle(azimuth[:, None] - azimuth[None, :]))
    best = int(np.argmax((support[None, :] * (gap < np.radians(10.0))).sum(1)))
    close = gap[best] < np.radians(10.0)
    turn = azimuth[best] + support[close] @ _modulo_right_angle(azimuth[close] - azimuth[best]) / support[close].sum()
    return np.array([np.cos(turn), np.sin(turn), 0.0])


def _modulo_right_angle(angle: np.ndarray) -> np.ndarray:
    return (angle + np.pi / 4) % (np.pi / 2) - np.pi / 4


def _pair(
    samples: CloudSamples, planes: list[tuple[Plane, np.ndarray]], direction: np.ndarray, rng: np.random.Generator
) -> list[Wall]:
    """The walls on both sides of the room across `direction`."""
    limit = LEVEL if direction[2] == 1.0 else np.cos(ALONG)
    mine = [(plane, p) for plane, p in planes if abs(plane.normal @ direction) > limit]
    walls = (outermost(mine, side) for side in (direction, -direction))
    return [refine_wall(samples, wall, rng=rng) for wall in walls if wall is not None]


def _centre(pairs: list[list[Wall]]) -> np.ndarray:
    """The point midway between the walls of every pair, nearest the origin."""
    centre = np.zeros(3)
    for _ in range(5):
        # The middle of one pair depends a little on the position along its walls.
        feet = [_feet(pair, centre) for pair in pairs]
        middles = [normal @ centre + np.mean(along) for normal, along in feet]
        centre = np.linalg.lstsq(np.array([normal for normal, _ in feet]), np.array(middles), rcond=None)[0]
    return centre


def _feet(pair: list[Wall], at: np.ndarray) -> tuple[np.ndarray, list[float]]:
    return feet_on([wall.plane for wall in pair], at)


def _dimension(
    pair: list[Wall],
    centre: np.ndarray,
    systematic_of: Callable[[Samples, np.ndarray], float],
    rng: np.random.Generator,
) -> Dimension:
    normal, (ahead, behind) = _feet(pair, centre)
    random = np.hypot(pair[0].plane.sigma_at(centre), pair[1].plane.sigma_at(centre))
    parts = [wall_weights(wall, wall.plane.height_weights(centre), rng) for wall in pair]
    weights = np.concatenate([weight for _, weight in parts])
    systematic = systematic_of(Samples.joined([part for part, _ in parts]), weights)
    counts = [len(wall.samples.p) for wall in pair]
    cosine = -pair[0].plane.normal @ pair[1].plane.normal
    return Dimension(
        value_m=ahead - behind,
        sigma_m=float(np.hypot(random, systematic)),
        sigma_random_m=float(random),
        sigma_systematic_m=systematic,
        rms_m=float(np.sqrt(np.average([wall.rms_m**2 for wall in pair], weights=counts))),
        points=sum(counts),
        angle_deg=float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))),
        direction=normal,
    )
