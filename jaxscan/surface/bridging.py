"""Single missing cells, filled where the points on both sides are on one surface."""

import dataclasses

import numpy as np

from jaxscan.reconstruction import PointCloud
from jaxscan.surface.joints import join, make_nodes
from jaxscan.surface.lattice import Lattice
from jaxscan.surface.settings import MeshSettings


BLOCK = 64
_MEAN = ("xyz", "normals", "sigma_random", "sigma_systematic", "intensity", "rgb")


def bridge_cells(cloud: PointCloud, lattice: Lattice, eyes: np.ndarray, settings: MeshSettings) -> PointCloud:
    """A cloud whose single missing cells have the mean of both neighbours, of the same profile or of the same line.

    Args:
        cloud: Points on the grid [m].
        lattice: Its sheets.
        eyes: Where the camera was at each profile [profiles, 3], m.
        settings: What counts as one surface; the neighbours are twice as far apart as others.

    Returns:
        The cloud with more points; those that it had are as they were.
    """
    fields = {name: np.array(getattr(cloud, name)) for name in (*_MEAN, "valid")}
    had = np.asarray(cloud.valid)
    columns = np.arange(1, len(lattice.profile) - 1)
    between = columns[lattice.joined[:-1] & lattice.joined[1:]]
    for start in range(0, len(had), BLOCK):
        middle = np.arange(start, min(start + BLOCK, len(had)))
        lines = np.arange(had.shape[1])
        _fill(fields, cloud, eyes, (middle, middle, middle), (lines[:-2], lines[1:-1], lines[2:]), settings)
    for start in range(0, len(between), BLOCK):
        at = between[start : start + BLOCK]
        lines = np.arange(had.shape[1])
        rows = (lattice.profile[at - 1], lattice.profile[at], lattice.profile[at + 1])
        _fill(fields, cloud, eyes, rows, (lines, lines, lines), settings)
    # The first profile of a closed sheet lies between its last one and the second.
    for end in np.flatnonzero(lattice.closes):
        first = int(np.flatnonzero(lattice.profile[:end] == lattice.profile[end])[0])
        rows = tuple(lattice.profile[[k]] for k in (end - 1, first, first + 1))
        _fill(fields, cloud, eyes, rows, (lines, lines, lines), settings)
    return dataclasses.replace(cloud, **fields)


def _fill(fields, cloud, eyes, rows, lines, settings) -> None:
    """Fill cells from those before and after them, of which profiles `rows` and `lines` are (before, cell, after)."""
    grids = [np.ix_(profile, line) for profile, line in zip(rows, lines, strict=True)]
    missing = ~fields["valid"][grids[1]]
    nodes = [
        make_nodes(
            np.asarray(cloud.xyz)[grid] - eyes[rows[1]][:, None],
            np.asarray(cloud.normals)[grid],
            np.asarray(cloud.sigma_random)[grid],
            np.asarray(cloud.valid)[grid],
            eyes[profile] - eyes[rows[1]],
        )
        for grid, profile in ((grids[0], rows[0]), (grids[2], rows[2]))
    ]
    column, line = np.nonzero(missing & join(*nodes, settings).joined)
    before, cell, after = ((profile[column], at[line]) for profile, at in zip(rows, lines, strict=True))
    for name in _MEAN:
        values = np.asarray(getattr(cloud, name))
        fields[name][cell] = (0.5 * (values[before].astype(np.float64) + values[after])).astype(values.dtype)
    fields["valid"][cell] = True
