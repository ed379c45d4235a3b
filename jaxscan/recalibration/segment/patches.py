"""The planes of one sweep."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.errors import CalibrationError
from jaxscan.geometry import Scanner
from jaxscan.recalibration.observed import SweepStripes
from jaxscan.recalibration.segment.bending import bending
from jaxscan.recalibration.segment.cells import Cells, cells_of
from jaxscan.recalibration.segment.regions import Region, flat_regions


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
