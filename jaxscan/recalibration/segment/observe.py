"""Sweeps and a scanner to surfaces of the room and the points on them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner, root_of
from jaxscan.recalibration.adjust import point_gradient
from jaxscan.recalibration.given import RecalibrationSettings
from jaxscan.recalibration.observed import SurfaceKind, SurfacePoints, Surfaces, SweepStripes
from jaxscan.recalibration.segment.cells import Cells, cells_of
from jaxscan.recalibration.segment.pieces import Piece, join, piece
from jaxscan.recalibration.segment.regions import Region, flat_regions
from jaxscan.recalibration.segment.thin import Candidates, Placed, candidates, choose


class Patches(NamedTuple):
    """Planes of one sweep, in the frame of its scanner; the largest first."""

    labels: Int[np.ndarray, "profiles lines"]
    """Number of the plane that each point of the grid lies on; -1 where on none."""
    normal: Float[np.ndarray, "patches 3"]
    """Unit normals, towards the scanner."""
    distance: Float[np.ndarray, " patches"]
    """`normal . p = distance` [m]."""
    centre: Float[np.ndarray, "patches 3"]
    """Mean of the points [m]."""
    axes: Float[np.ndarray, "patches 2 3"]
    """Two unit vectors in each plane."""
    extent: Float[np.ndarray, "patches 2 2"]
    """Where the points lie along the axes, from the centre: least and largest [m]."""


def find_patches(
    sweep: SweepStripes, scanner: Scanner, correction: Float[np.ndarray, " records"] | None = None
) -> Patches:
    """Planes of one sweep, with the scanner as it is.

    Args:
        sweep: The stripes.
        scanner: The calibrated rig; its covariance says how far it may bend a wall.
        correction: Added to the angle of every record [rad].

    Raises:
        CalibrationError: If no plane is found.
    """
    angles = np.zeros(len(sweep.angle)) if correction is None else correction
    labels = np.full(sweep.centre.shape, -1, np.int32)
    found: list[tuple[Cells, Region]] = []
    for cells in cells_of(sweep, scanner, angles):
        regions = flat_regions(cells, cells_bending(scanner, cells))
        grid = np.full(cells.valid.size, -1, np.int32)
        for region in regions:
            grid[region.cells] = len(found)
            found.append((cells, region))
        labels[np.ix_(cells.profiles, cells.lines)] = cells.spread(grid.reshape(cells.valid.shape))
    if not found:
        raise CalibrationError(no_plane(sweep.name))
    planes = [region.plane for _, region in found]
    normal = np.stack([plane.normal for plane in planes])
    centre = np.stack([plane.centre for plane in planes])
    axes = np.stack([plane.axes for plane in planes])
    extent = np.stack([_extent(cells, region) for cells, region in found])
    labels = np.where(sweep.valid, labels, -1).astype(np.int32)
    return Patches(labels, normal, np.array([plane.distance for plane in planes]), centre, axes, extent)


def cells_bending(scanner: Scanner, cells: Cells) -> Float[np.ndarray, "points 3 directions"]:
    """Shifts of the valid cells by the likely steps of the calibration [m]."""
    laser = np.full(int(cells.valid.sum()), cells.laser, np.int32)
    return bending(scanner, cells.q[cells.valid], laser, cells.phi[cells.valid])


def _extent(cells: Cells, region: Region) -> np.ndarray:
    along = (cells.p.reshape(-1, 3)[region.cells] - region.plane.centre) @ region.plane.axes.T
    return np.stack([along.min(0), along.max(0)], -1)


def no_plane(names: str) -> str:
    """The message where no plane is found in sweeps of these names."""
    return (
        f"{names}: found no plane, expected flat walls of 0.2 m or more: sweep a room with free walls, "
        "or calibrate with boards"
    )


_LOOSE = {
    "n1": 1e-3,
    "n2": 1e-3,
    "d": 3e-4,
    "axis.d1": 1e-3,
    "axis.d2": 1e-3,
    "axis.p1": 3e-4,
    "axis.p2": 3e-4,
    "gain": 2e-4,
    "c1": 3e-4,
    "s1": 3e-4,
    "c2": 3e-4,
    "s2": 3e-4,
}
"""Standard deviations of a drift that no covariance states, by which walls may be bent as well [rad, m]."""
_DIRECTIONS = 24
"""Directions of the covariance that are used at most."""


def likely_steps(scanner: Scanner) -> Float[np.ndarray, "directions params"]:
    """Steps of the scanner by one standard deviation, independent of one another: its covariance, and a drift.

    The largest first.
    """
    names = scanner.parameter_names()
    loose = np.array([_LOOSE.get(name, _LOOSE.get(name.rsplit(".", 1)[-1], 0.0)) for name in names])
    covariance = np.diag(loose**2)
    if scanner.covariance is not None:
        covariance = covariance + np.asarray(scanner.covariance, np.float64)
    steps = root_of(covariance)[::-1][:_DIRECTIONS]
    return steps[steps.any(1)]


def bending(
    scanner: Scanner,
    q: Float[np.ndarray, "points 2"],
    laser: Int[np.ndarray, " points"],
    phi: Float[np.ndarray, " points"],
) -> Float[np.ndarray, "points 3 directions"]:
    """Shifts of points [m] by each of the `likely_steps`.

    Args:
        scanner: The calibrated rig.
        q: Pixels of the stripes (u, v) [px].
        laser: The sheet of each.
        phi: The table's angle of each [rad], or the position of a stage [m].
    """
    by_scanner = point_gradient(scanner, q, laser, phi)
    return (by_scanner @ likely_steps(scanner).T).astype(np.float32)


def observe_surfaces(
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    stations: Float[np.ndarray, "stations 4 4"],
    corrections: Sequence[Float[np.ndarray, " records"]] = (),
    settings: RecalibrationSettings | None = None,
) -> tuple[SurfacePoints, Surfaces]:
    """Planes of the room, and points on them that are spread evenly and whose noise is independent.

    Args:
        sweeps: Stripes of each sweep.
        scanner: The calibrated rig; its covariance says how far it may bend a wall that is flat.
        stations: T_room_scanner of every station.
        corrections: Added to the angles of each sweep [rad]; nothing without them.
        settings: Its `points` is the largest number of points.

    Returns:
        The points, in the order of the sweeps, and the planes with most points first.

    Raises:
        CalibrationError: If no plane is found.
    """
    settings = settings or RecalibrationSettings()
    pieces: list[Piece] = []
    found: list[Candidates] = []
    for number, sweep in enumerate(sweeps):
        correction = corrections[number] if len(corrections) else np.zeros(len(sweep.angle))
        placed = Placed(sweep, sweep.angle + correction, np.asarray(stations[sweep.station], np.float64))
        of_sweep: list[tuple[Piece, tuple[np.ndarray, np.ndarray]]] = []
        for cells in cells_of(sweep, scanner, correction):
            bend = cells_bending(scanner, cells)
            place = np.cumsum(cells.valid.ravel()) - 1
            for region in flat_regions(cells, bend):
                one = piece(number, sweep.station, cells, region, placed.pose)
                of_sweep.append((one, (bend, place)))
        others = [one for one, _ in of_sweep]
        for one, shifts in of_sweep:
            pieces.append(one)
            found.append(candidates(one, others, shifts, placed, scanner))
    if not pieces:
        names = ", ".join(sweep.name for sweep in sweeps)
        raise CalibrationError(no_plane(names))
    surface = join(pieces)
    every = _joined(found, surface)
    chosen = choose(every, settings.points)
    if len(chosen) == 0:
        names = ", ".join(sweep.name for sweep in sweeps)
        raise CalibrationError(no_plane(names))
    return _numbered(every.points.take(chosen), every.p[chosen], pieces, surface)


def _joined(found: Sequence[Candidates], surface: np.ndarray) -> Candidates:
    points = [
        one.points._replace(surface=np.full(len(one.p), number)) for one, number in zip(found, surface, strict=True)
    ]
    return Candidates(
        SurfacePoints(*(np.concatenate(field) for field in zip(*points, strict=True))),
        *(np.concatenate(field) for field in zip(*(one[1:] for one in found), strict=True)),
    )


def _numbered(
    points: SurfacePoints, p: np.ndarray, pieces: Sequence[Piece], surface: np.ndarray
) -> tuple[SurfacePoints, Surfaces]:
    """Surfaces with their points, the largest first, and planes through the points."""
    names, counts = np.unique(points.surface, return_counts=True)
    names = names[np.argsort(-counts, kind="stable")]
    number = np.full(surface.max() + 1, -1)
    number[names] = np.arange(len(names))
    normals, centres = np.zeros((len(names), 3)), np.zeros((len(names), 3))
    for k, name in enumerate(names):
        own = p[points.surface == name]
        centres[k] = own.mean(0)
        normal = np.linalg.eigh((own - centres[k]).T @ (own - centres[k]))[1][:, 0]
        towards = pieces[int(np.flatnonzero(surface == name)[0])].normal
        normals[k] = normal if normal @ towards > 0 else -normal
    kind: tuple[SurfaceKind, ...] = tuple("plane" for _ in names)
    surfaces = Surfaces(kind, normals, (normals * centres).sum(1), centres)
    return points._replace(surface=number[points.surface]), surfaces
