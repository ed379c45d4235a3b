"""Single missing cells, filled where the points on both sides are on one surface."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from jaxscan.reconstruction import PointCloud
from jaxscan.surface.joints import Nodes, join, make_nodes
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
    fields: dict[str, Any] = {name: np.array(getattr(cloud, name)) for name in (*_MEAN, "valid")}
    had = np.asarray(cloud.valid)
    lines, lattice_columns = np.arange(had.shape[1]), len(lattice.profile)
    for start in range(0, len(had), BLOCK):
        middle = np.arange(start, min(start + BLOCK, len(had)))
        along = _Triples((middle, middle, middle), (lines[:-2], lines[1:-1], lines[2:]))
        _fill(fields, cloud, eyes, along, settings)
    before, middle, after = (np.arange(k, lattice_columns - 2 + k) for k in range(3))
    inner = lattice.joined[:-1] & lattice.joined[1:]
    before, middle, after = before[inner], middle[inner], after[inner]
    # The first profile of a closed sheet lies between its last one and the second.
    for end in np.flatnonzero(lattice.closes):
        first = np.flatnonzero(lattice.profile == lattice.profile[end])[0]
        before, middle, after = np.append(before, end - 1), np.append(middle, first), np.append(after, first + 1)
    for start in range(0, len(middle), BLOCK):
        columns = (part[start : start + BLOCK] for part in (before, middle, after))
        one, two, three = (lattice.profile[part] for part in columns)
        _fill(fields, cloud, eyes, _Triples((one, two, three), (lines, lines, lines)), settings)
    return dataclasses.replace(cloud, **fields)


class _Triples(NamedTuple):
    """Cells of the grid with those before and after them."""

    profiles: tuple[np.ndarray, np.ndarray, np.ndarray]
    lines: tuple[np.ndarray, np.ndarray, np.ndarray]


def _fill(
    fields: dict[str, Any], cloud: PointCloud, eyes: np.ndarray, triples: _Triples, settings: MeshSettings
) -> None:
    """Fill those missing cells whose neighbours are on one surface."""
    before, cell, after = (np.ix_(*places) for places in zip(*triples, strict=True))
    missing = ~fields["valid"][cell]
    centre = eyes[triples.profiles[1]]

    def nodes(grid: tuple[np.ndarray, ...], profiles: np.ndarray) -> Nodes:
        near = (np.asarray(cloud.xyz)[grid] - centre[:, None]).astype(np.float32)
        normals, sigma, valid = (np.asarray(field)[grid] for field in (cloud.normals, cloud.sigma_random, cloud.valid))
        return make_nodes(near, normals, sigma, valid, eyes[profiles] - centre)

    sides = nodes(before, triples.profiles[0]), nodes(after, triples.profiles[2])
    column, line = np.nonzero(missing & join(*sides, settings).joined)
    places = [(profile[column], at[line]) for profile, at in zip(*triples, strict=True)]
    for name in _MEAN:
        values = np.asarray(getattr(cloud, name))
        mean = 0.5 * (values[places[0]].astype(np.float64) + values[places[2]])
        fields[name][places[1]] = mean.astype(values.dtype)
    fields["valid"][places[1]] = True
