"""Sweeps and a scanner to surfaces of the room and the points on them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import SurfaceKind, SurfacePoints, Surfaces, SweepStripes
from jaxscan.recalibration.segment.cells import cells_of
from jaxscan.recalibration.segment.patches import cells_bending, no_plane
from jaxscan.recalibration.segment.pieces import Piece, join, piece
from jaxscan.recalibration.segment.regions import flat_regions
from jaxscan.recalibration.segment.thin import Candidates, Placed, candidates, choose
from jaxscan.recalibration.settings import RecalibrationSettings


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
