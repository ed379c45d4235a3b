"""A mesh from the grid of a cloud."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.errors import CloudError
from jaxscan.reconstruction import PointCloud
from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.surface.bridging import bridge_cells
from jaxscan.surface.cells import TRIANGLES, cell_codes
from jaxscan.surface.joints import make_nodes
from jaxscan.surface.lattice import Lattice, make_lattice
from jaxscan.surface.mesh import Mesh
from jaxscan.surface.settings import DEFAULT_MESH, MeshSettings


BLOCK = 32
"""Columns that are joined at a time: what is computed of them fits into the cache."""


class GridMesh(NamedTuple):
    """The faces of a cloud, still on its grid."""

    cloud: PointCloud
    """The cloud, with the cells that were bridged."""
    eyes: Float[np.ndarray, "profiles 3"]
    lattice: Lattice
    codes: UInt8[np.ndarray, "gaps cells"]
    """Faces of each cell of the lattice; see `cells.TRIANGLES`. All faces of a sheet are of one sense."""

    def faces(self) -> Int[np.ndarray, "m 3"]:
        """Corners of the faces, as numbers of places on the lattice (columns x lines), anticlockwise as seen."""
        lines = self.cloud.valid.shape[1]
        blocks = range(0, len(self.codes), 8 * BLOCK)
        found = [_corners(self.codes[start : start + 8 * BLOCK], start, lines) for start in blocks]
        return np.concatenate(found) if found else np.zeros((0, 3), np.int32)


def mesh_grid(
    cloud: PointCloud, eyes: Float[np.ndarray, "profiles 3"] | None = None, settings: MeshSettings = DEFAULT_MESH
) -> GridMesh:
    """Join the neighbours of a grid that are on one surface.

    Args:
        cloud: Points on the grid [m], NumPy arrays.
        eyes: Where the camera was at each profile [m], in the frame of the cloud. Without, the origin of the scanner:
            the camera is some decimetres from it.
        settings: What counts as one surface.

    Returns:
        The faces on the grid.

    Raises:
        CloudError: If the cloud has no grid, or no face.
    """
    lattice = make_lattice(cloud)
    eyes = np.asarray(_origins(cloud) if eyes is None else eyes, np.float64)
    if settings.bridge:
        cloud = bridge_cells(cloud, lattice, eyes, settings)

    def codes(start: int) -> np.ndarray:
        rows = lattice.profile[start : start + BLOCK + 1]
        fields = (cloud.xyz, cloud.normals, cloud.sigma_random, cloud.valid)
        xyz, normals, sigma, valid = (np.asarray(field)[rows] for field in fields)
        # Far from the origin, as in a national grid, singles are too coarse; near their eyes they are not.
        centre = eyes[rows[0]]
        near = (xyz - centre).astype(np.float32)
        nodes = make_nodes(near, normals, sigma, valid, eyes[rows] - centre)
        return cell_codes(nodes, lattice.joined[start : start + BLOCK], settings)

    starts = range(0, len(lattice.joined), BLOCK)
    found = np.concatenate(list(map_ahead(codes, starts, workers(), compiled=True)))
    mesh = GridMesh(cloud, eyes, lattice, _of_one_sense(found, lattice.joined))
    if not mesh.codes.any():
        raise CloudError("no neighbours of the cloud are on one surface, so there is no face; see --sigmas and --bend.")
    return mesh


def coloured_mesh(grid: GridMesh) -> Mesh:
    """The mesh of all faces, with a vertex for each point that has one, in the colour of the cloud."""
    places, faces = faces_of_cloud(grid)
    lines = grid.cloud.valid.shape[1]
    return Mesh(*vertex_fields(grid, places // lines, places % lines), faces)


def faces_of_cloud(grid: GridMesh) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, "m 3"]]:
    """Places of the cloud's own grid that are corners of faces, in order, and the faces with corners among these."""
    faces = grid.faces()
    lines = grid.cloud.valid.shape[1]
    # On the cloud's own grid the first profile of a closed sheet is there once.
    faces = (grid.lattice.profile[faces // lines] * lines + faces % lines).astype(np.int32)
    return used_places(faces, grid.cloud.valid.size)


def used_places(faces: Int[np.ndarray, "m 3"], size: int) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, "m 3"]]:
    """Places that are corners of faces, of `size` places, and the faces with corners counted among these."""
    used = np.zeros(size, np.bool_)
    used[faces.ravel()] = True
    places = np.flatnonzero(used)
    number = np.zeros(size, np.int32)
    number[places] = np.arange(len(places), dtype=np.int32)
    return places, number[faces]


def vertex_fields(grid: GridMesh, profiles: np.ndarray, lines: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, unit normals and colours of points of the grid; towards the scanner where there is no normal."""
    cloud = grid.cloud
    xyz = np.asarray(cloud.xyz)[profiles, lines]
    normals = np.asarray(cloud.normals)[profiles, lines].astype(np.float32)
    length = np.linalg.norm(normals, axis=1)
    none = length < 0.5
    normals[~none] /= length[~none, None]
    way = (grid.eyes[profiles[none]] - xyz[none]).astype(np.float32)
    normals[none] = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-12)
    return xyz, normals, np.asarray(cloud.rgb)[profiles, lines]


def _origins(cloud: PointCloud) -> Float[np.ndarray, "profiles 3"]:
    if cloud.stations is None:
        return np.zeros((len(cloud.valid), 3))
    return np.asarray(cloud.stations.pose)[np.asarray(cloud.stations.number), :3, 3]


def _of_one_sense(codes: np.ndarray, joined: Bool[np.ndarray, " gaps"]) -> np.ndarray:
    """Codes without the faces that are turned over: noise that is larger than the grid folds the surface."""
    kept = codes.copy()
    for part in np.split(np.arange(len(codes)), np.flatnonzero(~joined)):
        one, other = (codes[part] & np.uint8(bits) for bits in (0x0F, 0xF0))
        kept[part] = one if np.count_nonzero(one) >= np.count_nonzero(other) else other
    return kept


def _corners(codes: np.ndarray, start: int, lines: int) -> Int[np.ndarray, "m 3"]:
    """Faces of some columns, as places on the lattice."""
    found = []
    for bit, triangle in enumerate(TRIANGLES):
        for turned in (False, True):
            column, line = np.nonzero(codes & np.uint8((16 if turned else 1) << bit))
            corner = [(column + start + ahead) * lines + line + below for ahead, below in triangle]
            found.append(np.stack(corner[::-1] if turned else corner, 1).astype(np.int32))
    return np.concatenate(found)
