"""A mesh from the grid of a cloud."""

import dataclasses
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxscan.errors import CloudError
from jaxscan.reconstruction import PointCloud
from jaxscan.reconstruction.ahead import map_ahead, workers
from jaxscan.surface.mesh import DEFAULT_MESH, Mesh, MeshSettings


WIDEST_GAP = 2.5
"""Profiles further apart than this many usual steps are no neighbours."""
SMALLEST_GAP = 0.25
"""Profiles nearer than this many usual steps are the same one, taken twice."""
WIDEST_CLOSING = 4.0
"""The last profile joins the first where their points are at most this many times as far apart as usual."""


class Lattice(NamedTuple):
    """Columns of the grid, sheet after sheet."""

    profile: Int[np.ndarray, " columns"]
    joined: Bool[np.ndarray, " gaps"]
    """Whether each column and the next one are neighbours; one less than columns."""
    closes: Bool[np.ndarray, " columns"]
    """Whether the column repeats the first one of its sheet."""


def make_lattice(cloud: PointCloud) -> Lattice:
    """The sheets of a cloud.

    Raises:
        CloudError: If the cloud has no grid.
    """
    valid = np.asarray(cloud.valid)
    if min(valid.shape) < 2 or len(np.unique(np.asarray(cloud.angle))) < 2:
        alike = ", all at one angle" if len(valid) > 1 else ""
        raise CloudError(
            f"the cloud has no grid of profiles and lines (found {valid.shape[0]} x {valid.shape[1]}{alike}); take one "
            "that `jaxscan reconstruct` wrote of a rig that moves, or --poisson."
        )
    laser, angle = np.asarray(cloud.laser), np.asarray(cloud.angle, np.float64)
    station = np.zeros_like(laser) if cloud.stations is None else np.asarray(cloud.stations.number)
    profiles, joins, closings = [], [], []
    for place, number in np.unique(np.stack([station, laser], 1), axis=0):
        members = np.flatnonzero((station == place) & (laser == number))
        sheet, joined, closed = _sheet(members[np.argsort(angle[members], kind="stable")], angle, cloud)
        profiles.append(sheet)
        joins.append(np.append(joined, False))
        closings.append(np.append(np.zeros(len(sheet) - 1, np.bool_), closed))
    return Lattice(np.concatenate(profiles), np.concatenate(joins)[:-1], np.concatenate(closings))


def _sheet(members: np.ndarray, angle: np.ndarray, cloud: PointCloud) -> tuple[np.ndarray, np.ndarray, bool]:
    """Columns of a sheet, which of them follow each other, and whether the last one repeats the first."""
    steps = np.diff(angle[members])
    moved = steps[steps > 0]
    if not moved.size:
        return members[:1], np.zeros(0, np.bool_), False
    usual = float(np.median(moved))
    members = members[np.append(True, steps > SMALLEST_GAP * usual)]
    # If profiles cover more than one turn, the rest is left out.
    turned = angle[members] - angle[members[0]]
    once = members[turned < 2 * np.pi - SMALLEST_GAP * usual]
    rest = 2 * np.pi - turned[len(once) - 1]
    if len(once) > 2 and rest < WIDEST_GAP * usual and _meets(once, cloud):
        return np.append(once, once[0]), np.append(np.diff(angle[once]) < WIDEST_GAP * usual, True), True
    return members, np.diff(angle[members]) < WIDEST_GAP * usual, False


def _meets(members: np.ndarray, cloud: PointCloud) -> bool:
    """Whether the points of the last profile are beside those of the first; those of a stage never are."""
    some = np.unique(np.linspace(0, len(members) - 2, 64).astype(np.int64))
    usual = [gap for k in some if np.isfinite(gap := _apart(members[k : k + 2], cloud))]
    return bool(usual) and _apart(members[[-1, 0]], cloud) <= WIDEST_CLOSING * float(np.median(usual))


def _apart(pair: np.ndarray, cloud: PointCloud) -> float:
    """Median distance of the points of two profiles on the same lines [m]; infinite where they share none."""
    both = np.asarray(cloud.valid)[pair].all(0)
    if not both.any():
        return np.inf
    step = np.diff(np.asarray(cloud.xyz)[pair][:, both], axis=0)
    return float(np.median(np.linalg.norm(step, axis=-1)))


Vector = tuple[np.ndarray, ...]
"""Components x, y and z, each [columns, lines]."""


class Nodes(NamedTuple):
    """Points of some columns of the lattice, with what joins them; components apart, because that is faster."""

    xyz: Vector
    normal: Vector
    """Zero where there is none."""
    ray: Vector
    """Unit direction of sight."""
    variance: np.ndarray
    """Variance of the noise along the ray [m^2]."""
    valid: np.ndarray

    def part(self, columns: slice, lines: slice) -> "Nodes":
        """A rectangle of them."""
        cut = (columns, lines)
        xyz, normal, ray = (tuple(component[cut] for component in vector) for vector in self[:3])
        return Nodes(xyz, normal, ray, self.variance[cut], self.valid[cut])


def make_nodes(
    xyz: Float[np.ndarray, "columns lines 3"],
    normals: Float[np.ndarray, "columns lines 3"],
    sigma: Float[np.ndarray, "columns lines"],
    valid: Bool[np.ndarray, "columns lines"],
    eyes: Float[np.ndarray, "columns 3"],
) -> Nodes:
    """Nodes of points [m], their noise along the ray [m], and the place from which each column was seen [m]."""
    p = _components(xyz)
    way = tuple(component - eyes[:, k, None].astype(np.float32) for k, component in enumerate(p))
    far = np.maximum(np.sqrt(dot(way, way)), 1e-9)
    ray = tuple(component / far for component in way)
    return Nodes(p, _components(normals), ray, np.square(sigma, dtype=np.float32), valid)


def _components(vectors: np.ndarray) -> tuple[np.ndarray, ...]:
    return tuple(np.ascontiguousarray(vectors[..., k], np.float32) for k in range(3))


class Edges(NamedTuple):
    """Pairs of nodes."""

    joined: Bool[np.ndarray, "columns lines"]
    """Whether both are on one surface."""
    cost: Float[np.ndarray, "columns lines"]
    """Departure beyond the noise [m], with a trace of the length: the cheaper one of two diagonals is better."""


def join(first: Nodes, second: Nodes, settings: MeshSettings) -> Edges:
    """Pairs of nodes that are neighbours."""
    step = tuple(b - a for a, b in zip(first.xyz, second.xyz, strict=True))
    ray = tuple(0.5 * (a + b) for a, b in zip(first.ray, second.ray, strict=True))
    deep = dot(step, ray)
    length = dot(step, step)
    lateral = np.sqrt(np.maximum(length - deep * deep, 0.0))
    steepest = settings.least_cosine()
    one, cosine_one = _departure(first, step, ray, deep, steepest)
    two, cosine_two = _departure(second, step, ray, deep, steepest)
    # Both are distances along the ray, positive where the second point is farther than the plane says.
    least = np.where(one * two <= 0, 0.0, np.minimum(np.abs(one), np.abs(two)))
    noise = settings.sigmas * np.sqrt(first.variance + second.variance)
    # Across the plane, a share of the distance between the rays; along the ray that is more, as the plane is steeper.
    beyond = least - noise
    steepness = np.maximum(cosine_one, cosine_two)
    joined = first.valid & second.valid & (beyond * steepness <= settings.bend * lateral)
    return Edges(joined, np.maximum(beyond, 0.0) * steepness + 1e-3 * np.sqrt(length))


def _departure(node: Nodes, step: Vector, ray: Vector, deep: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth beyond a node's plane, along the ray, and the plane's cosine; head-on where there is no normal."""
    facing = dot(node.normal, ray)
    # A plane seen at grazing incidence predicts any depth: it would join the last point of a limb to what is behind it.
    known = facing < -least
    safe = np.where(known, facing, np.float32(-1.0))
    return np.where(known, dot(step, node.normal) / safe, deep), -safe


def dot(a: Vector, b: Vector) -> np.ndarray:
    """Scalar products of vectors by component."""
    product: np.ndarray = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


TRIANGLES = (((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1), (0, 1)), ((0, 0), (1, 0), (0, 1)), ((1, 0), (1, 1), (0, 1)))
"""Corners (columns and lines ahead) of the faces abc, acd, abd and bcd. The bits 0 to 3 of a cell's code are theirs
where they are anticlockwise as seen, and the bits 4 to 7 where they are clockwise."""


def cell_codes(
    nodes: Nodes, joined: Bool[np.ndarray, " gaps"], settings: MeshSettings
) -> UInt8[np.ndarray, "gaps cells"]:
    """The faces of the cells between the columns of some nodes, as codes: see `TRIANGLES`."""
    every, before, after = slice(None), slice(None, -1), slice(1, None)
    along = join(nodes.part(every, before), nodes.part(every, after), settings).joined
    across = join(nodes.part(before, every), nodes.part(after, every), settings).joined & joined[:, None]
    a, c = nodes.part(before, before), nodes.part(after, after)
    b, d = nodes.part(after, before), nodes.part(before, after)
    ac, bd = join(a, c, settings), join(b, d, settings)
    ab, dc, ad, bc = across[:, :-1], across[:, 1:], along[:-1], along[1:]
    seen = [
        _facing(a, b, c, settings, ab & bc & ac.joined),
        _facing(a, c, d, settings, dc & ad & ac.joined),
        _facing(a, b, d, settings, ab & ad & bd.joined),
        _facing(b, c, d, settings, bc & dc & bd.joined),
    ]
    return _chosen(seen, ac, bd)


def _facing(
    first: Nodes, second: Nodes, third: Nodes, settings: MeshSettings, joined: np.ndarray
) -> Int[np.ndarray, "gaps cells"]:
    """1 for a face that is anticlockwise as seen, -1 for a clockwise one, 0 for none."""
    u = _step(first.xyz, second.xyz)
    v = _step(first.xyz, third.xyz)
    n = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    length = np.sqrt(dot(n, n))
    cosine = -dot(n, second.ray)
    steep = np.abs(cosine) <= settings.least_cosine() * length
    return np.where(joined & ~steep, np.sign(cosine), 0).astype(np.int8)


def _step(first: Vector, second: Vector) -> Vector:
    return tuple(b - a for a, b in zip(first, second, strict=True))


def _chosen(seen: list[np.ndarray], ac: Edges, bd: Edges) -> UInt8[np.ndarray, "gaps cells"]:
    """Codes of the faces on one side and the other of the better diagonal."""
    by_ac, by_bd = (np.abs(one) + np.abs(other) for one, other in (seen[:2], seen[2:]))
    first = (by_ac > by_bd) | ((by_ac == by_bd) & (ac.cost <= bd.cost))
    code = np.zeros(first.shape, np.uint8)
    for number, side in enumerate(seen):
        mine = first if number < 2 else ~first
        code |= np.where(mine & (side > 0), np.uint8(1 << number), np.uint8(0))
        code |= np.where(mine & (side < 0), np.uint8(16 << number), np.uint8(0))
    return code


_BRIDGED = 64
_MEAN = ("xyz", "normals", "sigma_random", "sigma_systematic", "intensity", "rgb")


def bridge_cells(cloud: PointCloud, lattice: Lattice, eyes: np.ndarray, settings: MeshSettings) -> PointCloud:
    """A cloud whose single missing cells have the mean of both neighbours, of the same profile or of the same line.

    The neighbours are twice as far apart as others, and must be on one surface.
    """
    fields: dict[str, Any] = {name: np.array(getattr(cloud, name)) for name in (*_MEAN, "valid")}
    had = np.asarray(cloud.valid)
    lines, lattice_columns = np.arange(had.shape[1]), len(lattice.profile)
    for start in range(0, len(had), _BRIDGED):
        middle = np.arange(start, min(start + _BRIDGED, len(had)))
        along = _Triples((middle, middle, middle), (lines[:-2], lines[1:-1], lines[2:]))
        _fill(fields, cloud, eyes, along, settings)
    before, middle, after = (np.arange(k, lattice_columns - 2 + k) for k in range(3))
    inner = lattice.joined[:-1] & lattice.joined[1:]
    before, middle, after = before[inner], middle[inner], after[inner]
    # The first profile of a closed sheet lies between its last one and the second.
    for end in np.flatnonzero(lattice.closes):
        first = np.flatnonzero(lattice.profile == lattice.profile[end])[0]
        before, middle, after = np.append(before, end - 1), np.append(middle, first), np.append(after, first + 1)
    for start in range(0, len(middle), _BRIDGED):
        columns = (part[start : start + _BRIDGED] for part in (before, middle, after))
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


BLOCK = 32
"""Columns that are joined at a time: what is computed of them fits into the cache."""


class GridMesh(NamedTuple):
    """The faces of a cloud, still on its grid."""

    cloud: PointCloud
    """The cloud, with the cells that were bridged."""
    eyes: Float[np.ndarray, "profiles 3"]
    lattice: Lattice
    codes: UInt8[np.ndarray, "gaps cells"]
    """Faces of each cell of the lattice; see `TRIANGLES`. All faces of a sheet are of one sense."""

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
