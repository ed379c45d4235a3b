"""The scene: a furnished room or an object on a plate, its edges, and the shadows of its lamp.

Room coordinates: origin in a corner on the floor, x and y along the walls, z up. Pieces stand
along the walls or in corners. Their sizes are fixed, so small rooms are fuller; of each wall more
than 40 % stays visible.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np

from jaxscan.simulation.rig import Motion, rodrigues
from jaxscan.simulation.scene import textures
from jaxscan.simulation.scene.meshes import Caster, Mesh
from jaxscan.simulation.scene.textures import Material, framed
from jaxscan.simulation.settings import MirrorSpec, ObjectSpec, RoomSpec, SimulationConfig


LAMP_HEIGHT_SHARE = 0.93
"""Height of the lamp under the ceiling, as a share of the room's."""

_OAK = Material(((0.52, 0.34, 0.18), (0.42, 0.26, 0.13)), textures.wood)
_WHITE = Material(((0.80, 0.79, 0.76),))
_DARK = Material(((0.16, 0.15, 0.15),))
_BRASS = Material(((0.66, 0.52, 0.22),))
_SOFA = Material(((0.20, 0.34, 0.56), (0.26, 0.42, 0.64)), textures.weave)
_CUSHION = Material(((0.80, 0.50, 0.16), (0.86, 0.78, 0.62)), partial(textures.stripes, period=0.08))
_LEAF = Material(((0.14, 0.40, 0.13), (0.22, 0.52, 0.18)), partial(textures.checker, size=0.05))
_POT = Material(((0.66, 0.34, 0.22),))
_BALL = Material(((0.82, 0.18, 0.14), (0.86, 0.84, 0.80)), partial(textures.stripes, period=0.12))
_BOOKS = (
    (0.14, 0.10, 0.07),
    (0.62, 0.16, 0.14),
    (0.16, 0.30, 0.52),
    (0.74, 0.62, 0.30),
    (0.20, 0.44, 0.28),
    (0.78, 0.76, 0.70),
    (0.46, 0.24, 0.46),
)


def furnish(room: RoomSpec) -> Mesh:
    """The room as triangles, room coordinates."""
    mesh = Mesh()
    _shell(mesh, room)
    if room.mirror is not None:
        _mirror(mesh, room, room.mirror)
    if room.furniture:
        _openings(mesh, room)
        _pictures(mesh, room)
        _sofa(mesh, room)
        _shelf(mesh, room)
        _table(mesh, room)
        _small_things(mesh, room)
    return mesh


def _shell(mesh: Mesh, room: RoomSpec) -> None:
    x, y, z = room.size_m
    floor = Material(((0.60, 0.42, 0.25), (0.46, 0.30, 0.17)), partial(textures.planks, width=0.14, length=1.3))
    mesh.quad(np.zeros(3), np.array([x, 0, 0]), np.array([0, y, 0]), floor)
    ceiling = Material(((0.78, 0.78, 0.76),), textures.plaster)
    mesh.quad(np.array([0, y, z]), np.array([x, 0, 0]), np.array([0, -y, 0]), ceiling)
    walls = (
        Material(((0.76, 0.70, 0.56),), textures.plaster),
        Material(((0.66, 0.74, 0.62), (0.57, 0.68, 0.56)), partial(textures.stripes, period=0.2)),
        Material(((0.62, 0.70, 0.76),), textures.plaster),
        Material(((0.78, 0.68, 0.64), (0.68, 0.48, 0.44)), partial(textures.dots, period=0.24, radius=0.035)),
    )
    corners = np.array([[0, 0, 0], [x, 0, 0], [x, y, 0], [0, y, 0]], float)
    height = np.array([0, 0, z])
    for index, wall in enumerate(walls):
        start, end = corners[index], corners[(index + 1) % 4]
        along = end - start
        mesh.quad(start, along, height, wall)
        if room.furniture:
            length = float(np.linalg.norm(along))
            inward = np.array([-along[1], along[0], 0]) / length
            foot = (start + end) / 2 + 0.0075 * inward
            mesh.box(tuple(foot), (length, 0.015, 0.08), _WHITE, yaw=float(np.arctan2(along[1], along[0])))


def _mirror(mesh: Mesh, room: RoomSpec, mirror: MirrorSpec) -> None:
    """A mirror that hangs in front of a wall by more than skirting and pictures are thick."""
    axis, far = "xy".index(mirror.wall[0]), mirror.wall[1] == "1"
    width, height = mirror.size_m
    low, along = np.zeros(3), np.zeros(3)
    low[axis] = room.size_m[axis] - 0.03 if far else 0.03
    low[1 - axis], along[1 - axis] = mirror.along_m - width / 2, width
    low[2] = mirror.height_m - height / 2
    mesh.quad(low, along, np.array([0, 0, height]), Material(((0.0, 0.0, 0.0),), mirror=mirror.reflects))


def _openings(mesh: Mesh, room: RoomSpec) -> None:
    """A door in the wall y = 0, a window in the wall x = 0."""
    x, y, _ = room.size_m
    door = framed((0.9, 2.02), ((0.50, 0.30, 0.16), (0.40, 0.23, 0.12), (0.78, 0.76, 0.72)), textures.wood, 0.05)
    at = 0.27 * x
    mesh.box((at, 0.015, 0), (0.9, 0.03, 2.02), _OAK, yaw=np.pi, front=door)
    mesh.sphere((at + 0.33, 0.07, 1.0), 0.03, _BRASS)
    width, height = 1.3, 1.1
    panes = partial(textures.panes, size=(width, height), bar=0.07)
    window = Material(((0.55, 0.72, 0.90), (0.84, 0.84, 0.82)), panes, glow=0.3)
    mesh.box((0.02, 0.62 * y, 0.95), (width, 0.04, height), _WHITE, yaw=np.pi / 2, front=window)
    mesh.box((0.08, 0.62 * y, 0.90), (width + 0.2, 0.16, 0.04), _WHITE, yaw=np.pi / 2)


def _pictures(mesh: Mesh, room: RoomSpec) -> None:
    x, y, _ = room.size_m
    gold, black = (0.70, 0.55, 0.22), (0.10, 0.10, 0.10)
    sizes = ((0.8, 0.6), (0.6, 0.6), (0.7, 0.5), (0.5, 0.7))
    inner = (
        ((0.86, 0.82, 0.70), (0.70, 0.20, 0.14), gold, partial(textures.rings, period=0.12, centre=(0.4, 0.3))),
        ((0.88, 0.88, 0.86), (0.08, 0.10, 0.14), black, partial(textures.checker, size=0.1)),
        ((0.86, 0.74, 0.22), (0.16, 0.28, 0.56), black, partial(textures.stripes, period=0.1)),
        ((0.84, 0.84, 0.80), (0.24, 0.46, 0.40), gold, partial(textures.dots, period=0.14, radius=0.05)),
    )
    places = (
        ((x - 0.012, 0.45 * y, 1.35), -np.pi / 2),
        ((0.66 * x, 0.012, 1.45), np.pi),
        ((0.30 * x, y - 0.012, 1.40), 0.0),
        ((0.012, 0.25 * y, 1.30), np.pi / 2),
    )
    for (width, height), (first, second, frame, pattern), (foot, yaw) in zip(sizes, inner, places, strict=True):
        picture = framed((width, height), (first, second, frame), pattern)
        mesh.box(foot, (width, 0.024, height), Material((frame,)), yaw=yaw, front=picture)


def _sofa(mesh: Mesh, room: RoomSpec) -> None:
    """A sofa against the wall x = X, its front towards the room."""
    x, y, _ = room.size_m
    at = 0.42 * y

    def part(across: float, along: float, z: float, size: tuple[float, float, float], material: Material) -> None:
        mesh.box((x - 0.03 - across, at + along, z), size, material, yaw=-np.pi / 2)

    part(0.42, 0.0, 0.06, (1.7, 0.80, 0.36), _SOFA)
    part(0.12, 0.0, 0.42, (1.7, 0.20, 0.42), _SOFA)
    for side in (-1, 1):
        part(0.42, side * 0.92, 0.06, (0.16, 0.80, 0.56), _SOFA)
        part(0.34, side * 0.55, 0.42, (0.42, 0.16, 0.38), _CUSHION)


def _shelf(mesh: Mesh, room: RoomSpec) -> None:
    """A shelf against the wall y = Y: boards, two sides, and books."""
    x, y, _ = room.size_m
    middle, width, depth, height = 0.70 * x, 1.1, 0.28, 1.7
    front = y - 0.03 - depth / 2
    for side in (-1, 1):
        mesh.box((middle + side * (width / 2 - 0.015), front, 0), (0.03, depth, height), _OAK)
    levels = np.linspace(0.02, height - 0.03, 5)
    for level in levels:
        mesh.box((middle, front, float(level)), (width, depth, 0.03), _OAK)
    gap = float(levels[1] - levels[0])
    for number, level in enumerate(levels[:-1]):
        spines = partial(textures.books, width=0.035 + 0.006 * number, height=gap, colours=len(_BOOKS))
        length = width - 0.07 - 0.2 * (number % 2)
        mesh.box(
            (middle - 0.1 * (number % 2), front + 0.03, float(level) + 0.03),
            (length, 0.18, 0.75 * gap),
            _DARK,
            front=Material(_BOOKS, spines),
        )


def _table(mesh: Mesh, room: RoomSpec) -> None:
    """A table in the corner x = 0, y = Y, with two chairs and a vase on it."""
    _, y, _ = room.size_m
    cx, cy, top = 0.62, y - 0.85, 0.74
    cloth = Material(((0.74, 0.70, 0.62), (0.62, 0.28, 0.24)), partial(textures.checker, size=0.09))
    mesh.box((cx, cy, top - 0.03), (0.8, 1.1, 0.03), _OAK, front=None)
    mesh.box((cx, cy, top), (0.5, 0.7, 0.004), cloth)
    for dx in (-0.35, 0.35):
        for dy in (-0.5, 0.5):
            mesh.box((cx + dx, cy + dy, 0), (0.05, 0.05, top - 0.03), _OAK)
    profile = np.array([[0, 0], [0.05, 0], [0.09, 0.08], [0.08, 0.16], [0.04, 0.22], [0.055, 0.26]])
    mesh.lathe(
        (cx, cy + 0.1, top + 0.004),
        profile,
        Material(((0.22, 0.40, 0.62), (0.84, 0.82, 0.76)), partial(textures.bands, period=0.05)),
    )
    _chair(mesh, cx + 0.62, cy - 0.15, np.pi / 2)
    _chair(mesh, cx - 0.05, cy - 0.85, 0.0)


def _chair(mesh: Mesh, x: float, y: float, yaw: float) -> None:
    """A chair whose back stands on its own -y side, turned by `yaw`."""
    c, s = np.cos(yaw), np.sin(yaw)

    def part(dx: float, dy: float, z: float, size: tuple[float, float, float]) -> None:
        mesh.box((x + c * dx - s * dy, y + s * dx + c * dy, z), size, _CHAIR, yaw=yaw)

    part(0.0, 0.0, 0.43, (0.42, 0.42, 0.035))
    for dx in (-0.18, 0.18):
        part(dx, 0.18, 0.0, (0.035, 0.035, 0.43))
        part(dx, -0.19, 0.0, (0.035, 0.035, 0.92))
    for z in (0.58, 0.72, 0.86):
        part(0.0, -0.19, z, (0.36, 0.02, 0.06))


_CHAIR = Material(((0.58, 0.22, 0.16), (0.50, 0.18, 0.13)), textures.wood)


def _small_things(mesh: Mesh, room: RoomSpec) -> None:
    """A rug, a floor lamp, a plant, a ball, and a low chest of drawers."""
    x, y, _ = room.size_m
    colours = (0.62, 0.20, 0.18), (0.76, 0.64, 0.42), (0.22, 0.24, 0.36)
    rug = framed((1.8, 1.3), colours, partial(textures.dots, period=0.26, radius=0.09), 0.1)
    mesh.quad(np.array([0.5 * x - 0.9, 0.36 * y - 0.65, 0.008]), np.array([1.8, 0, 0]), np.array([0, 1.3, 0]), rug)
    shade = Material(((0.84, 0.76, 0.56),), glow=0.25)
    mesh.cylinder((x - 0.32, y - 0.9, 0), 0.14, 0.025, _DARK)
    mesh.cylinder((x - 0.32, y - 0.9, 0.025), 0.014, 1.45, _BRASS)
    mesh.sphere((x - 0.32, y - 0.9, 1.58), 0.16, shade)
    mesh.lathe((x - 0.35, 0.38, 0), np.array([[0, 0], [0.12, 0], [0.17, 0.32], [0.15, 0.32], [0, 0.28]]), _POT)
    leaves = (0, 0, 0.62, 0.20), (-0.10, 0.08, 0.85, 0.16), (0.08, 0.02, 0.98, 0.14), (-0.02, -0.06, 1.14, 0.10)
    for dx, dy, z, radius in leaves:
        mesh.sphere((x - 0.35 + dx, 0.38 + dy, z), radius, _LEAF)
    mesh.sphere((0.55, 0.30 * y + 0.75, 0.13), 0.13, _BALL)
    colours = (0.70, 0.68, 0.62), (0.40, 0.38, 0.34), (0.56, 0.54, 0.48)
    drawers = framed((0.9, 0.7), colours, partial(textures.tiles, size=0.23), 0.03)
    mesh.box((0.25, 0.25 * y, 0), (0.9, 0.42, 0.7), Material(((0.60, 0.58, 0.52),)), yaw=np.pi / 2, front=drawers)


def set_table(spec: ObjectSpec, *, empty: bool = False) -> Mesh:
    """A vase, a block and a ball on the turntable's plate, or the plate alone; scanner coordinates."""
    mesh = Mesh()
    z, h = spec.base_z_m, spec.height_m
    plate = Material(((0.34, 0.34, 0.36), (0.46, 0.46, 0.48)), partial(textures.rings, period=0.04, centre=(0.0, 0.0)))
    r = spec.plate_radius_m
    mesh.cylinder((0, 0, z - 0.02), r, 0.02, plate)
    if empty:
        return mesh
    radius = [0, 0.20, 0.30, 0.36, 0.33, 0.20, 0.14, 0.18, 0.24, 0]
    outline = np.column_stack([radius, [0, 0, 0.12, 0.30, 0.48, 0.66, 0.80, 0.93, 1.0, 0.97]])
    vase = Material(((0.22, 0.42, 0.60), (0.80, 0.76, 0.66)), partial(textures.bands, period=0.22 * h))
    mesh.lathe((0.0, 0.0, z), h * outline, vase, sides=96)
    block = Material(((0.78, 0.58, 0.22), (0.56, 0.20, 0.16)), partial(textures.checker, size=0.1 * h))
    mesh.box((0.62 * r, 0.1 * r, z), (0.3 * h, 0.3 * h, 0.35 * h), block, yaw=0.4)
    mesh.sphere((-0.55 * r, 0.45 * r, z + 0.15 * h), 0.15 * h, Material(((0.70, 0.72, 0.66),)))
    return mesh


class Outline:
    """Facets and edges of a mesh; found when they are first used."""

    def __init__(self, mesh: Mesh, normal: np.ndarray) -> None:
        """`normal` is that of every triangle, float64 [triangles, 3]."""
        self._mesh, self.normal = mesh, normal

    @cached_property
    def corners(self) -> np.ndarray:
        """Corners of all triangles [triangles, 3, 3], m."""
        return np.concatenate(self._mesh.triangles)

    @cached_property
    def facet(self) -> np.ndarray:
        """Facet of every triangle, int64 [triangles + 1]; the last entry is for rays that hit nothing."""
        surface = np.repeat(np.arange(len(self._mesh.triangles)), [len(part) for part in self._mesh.triangles])
        offset = np.sum(self.normal * self.corners[:, 0], -1)
        keys = np.column_stack([surface, np.rint(np.column_stack([self.normal, offset]) * _SAME)])
        _, facet = np.unique(keys.astype(np.int64), axis=0, return_inverse=True)
        return np.append(facet.ravel(), -1)

    @cached_property
    def edges(self) -> np.ndarray:
        """Ends of the edges between facets, [edges, 2, 3], m."""
        ends = np.stack([self.corners, np.roll(self.corners, -1, 1)], 2).reshape(-1, 2, 3)
        places = np.rint(ends * _SAME).astype(np.int64)
        _, point = np.unique(places.reshape(-1, 3), axis=0, return_inverse=True)
        pair = np.sort(point.reshape(-1, 2), 1)
        # An edge between two triangles of one facet, such as the diagonal of a quad, does not count.
        _, first, count = np.unique(
            np.column_stack([self.facet[:-1].repeat(3), pair]), axis=0, return_index=True, return_counts=True
        )
        kept = first[count == 1]
        _, once = np.unique(pair[kept], axis=0, return_index=True)
        return ends[kept[once]]


# Edges of the scene's facets: between them a picture sees one plane.
#
# A facet is the part of a plane that has one surface. Where no edge of any facet crosses a part of a picture, all of it
# shows one facet: any other that reached into that part would cover the whole of it, in front or behind.

_SAME = 1e6
"""Planes and corners are distinguished to one part of this: a micrometre."""


class Cone(NamedTuple):
    """Directions within an angle of an axis."""

    axis: np.ndarray
    """Unit vector [3]."""
    half: float
    """The angle [rad]."""


def points_on(edges: np.ndarray, eye: np.ndarray, step: float, cone: Cone) -> np.ndarray:
    """Points of edges, no farther apart than an angle, as an eye sees them.

    Args:
        edges: Their ends [n, 2, 3], m.
        eye: Where they are seen from [3].
        step: The angle [rad].

    Returns:
        [points, 3], m.
    """
    edges = edges[_within(edges, eye, step, cone)]
    legs = edges - eye
    far = np.maximum(np.sqrt(np.einsum("nij,nij->ni", legs, legs)), 1e-9)
    ways = legs / far[..., None]
    between = np.arctan2(
        np.linalg.norm(np.cross(ways[:, 0], ways[:, 1]), axis=-1), np.einsum("ni,ni->n", ways[:, 0], ways[:, 1])
    )
    aside = np.arccos(np.clip(ways @ cone.axis, -1, 1)).min(1)
    # An edge that is seen under an angle reaches no farther into the cone than half of it from its nearer end.
    near = aside - between / 2 < cone.half + step
    far, ways, between = far[near], ways[near], between[near]
    counts = np.ceil(between / step).astype(int) + 1
    which = np.arange(len(counts)).repeat(counts)
    share = (np.arange(len(which)) - (np.cumsum(counts) - counts)[which]) / np.maximum(counts[which] - 1, 1)
    angle = between[which]
    sine = np.where(angle < 1e-6, 1.0, np.sin(angle))
    first = np.where(angle < 1e-6, 1 - share, np.sin((1 - share) * angle) / sine)
    second = np.where(angle < 1e-6, share, np.sin(share * angle) / sine)
    way = first[:, None] * ways[which, 0] + second[:, None] * ways[which, 1]
    # The line through both ends: along the direction first w0 + second w1 it lies at 1 / (first / r0 + second / r1).
    length = 1 / (first / far[which, 0] + second / far[which, 1])
    return eye + length[:, None] * way


def _within(edges: np.ndarray, eye: np.ndarray, step: float, cone: Cone) -> np.ndarray:
    """Which edges may reach into a cone that is wider by two steps: found by the spheres round them, bool [n]."""
    middle, leg = (edges[:, 0] + edges[:, 1]) / 2 - eye, edges[:, 1] - edges[:, 0]
    far = np.maximum(np.sqrt(np.einsum("ni,ni->n", middle, middle)), 1e-9)
    radius = np.sqrt(np.einsum("ni,ni->n", leg, leg)) / 2
    aside = np.arccos(np.clip(np.einsum("ni,i->n", middle, cone.axis) / far, -1, 1))
    # Seen from within its sphere, an edge may lie anywhere.
    return (aside - np.arcsin(np.minimum(radius / far, 1)) < cone.half + 2 * step) | (far <= radius)


@dataclass(frozen=True, eq=False)
class Scene:
    """Triangles in the scanner frame."""

    caster: Caster
    mesh: Mesh
    surface: np.ndarray
    """Surface of each triangle, int64 [triangles + 1]; the last entry is for rays that hit nothing."""
    normal: np.ndarray
    """Unit normal of each triangle, float32 [triangles + 1, 3]."""
    lamp: np.ndarray
    """Position of the lamp [m]."""
    reach: float
    """Distance at which the lamp's light is of mean strength [m]."""
    shadows: bool
    mirror: np.ndarray
    """Share of the light that each triangle reflects as a mirror, float32 [triangles + 1]."""
    outline: Outline
    """Facets, and the edges between them."""

    def cast(self, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest hits of rays from one point.

        Args:
            origin: [3], m, or one for each ray.
            directions: [rays, 3], of any length.

        Returns:
            t: float32 [rays]: hit = origin + t direction; inf where nothing is hit.
            triangle: int64 [rays]; the last index of `normal` where nothing is hit.
        """
        t, triangle = self.caster.nearest(origin, directions)
        return t, np.where(triangle < 0, len(self.normal) - 1, triangle)

    def facing(self, eye: np.ndarray) -> np.ndarray:
        """Unit normal of each triangle on the side of a place [3], float32 [triangles + 1, 3]."""
        behind = np.sum(self.outline.normal * (eye - self.outline.corners[:, 0]), -1) < 0
        return np.where(np.append(behind, False)[:, None], -self.normal, self.normal)

    def glass(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """A point and the unit normal of every mirror."""
        ends = np.cumsum([len(part) for part in self.mesh.triangles])
        parts = zip(self.mesh.surfaces, self.mesh.triangles, ends, strict=True)
        return [(part[0, 0], self.normal[end - 1]) for surface, part, end in parts if surface.material.mirror > 0]

    def reflect(
        self, eye: np.ndarray, points: np.ndarray, triangle: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The points seen in mirrors.

        Args:
            eye: Where the camera is [3], m.
            points: Points of mirrors [n, 3].
            triangle: Their triangles [n].

        Returns:
            Distance from the mirror in lengths of the way to it, inf where nothing is, triangle, and points [n, 3].
        """
        ways, normal = points - eye.astype(points.dtype), self.normal[triangle]
        ways = ways - 2 * np.sum(ways * normal, -1, keepdims=True) * normal
        far, behind = self.cast(points + np.float32(1e-4) * ways, ways)
        return far, behind, points + np.where(np.isfinite(far), far, 0)[:, None] * ways

    def blocked(self, origin: np.ndarray, points: np.ndarray, *, skin: float = 1e-3) -> np.ndarray:
        """Whether something stands between `origin` [3] and each of `points` [n, 3], bool [n].

        The last `skin` metres before the point are not looked at: they are its own surface.
        """
        return _occluded(self.caster, origin, points - origin.astype(points.dtype), skin)

    def lit_share(self, legs: list[np.ndarray]) -> np.ndarray:
        """Share of the lamp's light that ends of ways x, y, z from the lamp receive, float32 of their shape."""
        dark = _occluded(self.caster, self.lamp, np.stack(legs, -1).reshape(-1, 3), 5e-3).reshape(legs[0].shape)
        return np.where(dark, np.float32(0.25), np.float32(1))

    def ambient(self, triangle: np.ndarray, points: np.ndarray, view: np.ndarray, channels: np.ndarray) -> np.ndarray:
        """A picture in the room's own light, float32 [channels, rows, columns]; white in mean light is 1.

        Args:
            triangle: Hit triangles [rows, columns].
            points: Hit points float32 [rows, columns, 3].
            view: Where the camera is [3]; surfaces are seen from this side.
            channels: [3, channels], weights of R, G, B.
        """
        colour, glow = self.look(triangle.ravel(), points.reshape(-1, 3), channels)
        colour *= self.light(points, self.normal[triangle], view).ravel()
        colour += glow
        return colour.reshape(-1, *triangle.shape)

    def light(self, points: np.ndarray, normal: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Strength of the room's light at points [rows, columns, 3] with normals of either sense, float32."""
        f = np.float32
        (x, y, z), (a, b, c) = (np.moveaxis(part, -1, 0) for part in (points, normal))
        plane = a * x + b * y + c * z
        (vx, vy, vz), (lx, ly, lz) = view.astype(f), self.lamp.astype(f)
        sense = np.where(vx * a + vy * b + vz * c < plane, f(-1), f(1))
        r2 = np.square(lx - x) + np.square(ly - y) + np.square(lz - z)
        cosine = np.maximum((lx * a + ly * b + lz * c - plane) * sense, 0) / np.sqrt(r2)
        direct = cosine * f(0.95 * self.reach**2) / (r2 + f(0.6 * self.reach**2))
        if self.shadows:
            direct *= self._shadow(points, direct > 0)
        # Light from all sides: a little more from above than from below.
        return f(0.66) + f(0.05) * c * sense + direct

    def lamp_light(self, points: np.ndarray) -> np.ndarray:
        """Strength of the lamp's light on surfaces that face it, at points [rows, columns, 3]; as `light`."""
        r2 = np.sum(np.square(points - self.lamp.astype(np.float32)), -1)
        light = np.float32(0.95 * self.reach**2) / (r2 + np.float32(0.6 * self.reach**2))
        return light * self._shadow(points, np.ones(light.shape, bool)) if self.shadows else light

    def _shadow(self, points: np.ndarray, facing: np.ndarray) -> np.ndarray:
        """Share of the lamp's light at points [rows, columns, 3], looked up at every other one.

        It stays 1 where none of four points is `facing` the lamp, bool [rows, columns].
        """
        rows, columns = facing.shape
        asked = facing[::2, ::2].copy()
        asked[: rows // 2] |= facing[1::2, ::2]
        asked[:, : columns // 2] |= facing[::2, 1::2]
        asked[: rows // 2, : columns // 2] |= facing[1::2, 1::2]
        share = np.ones(asked.shape, np.float32)
        share[asked] = self.lit_share(list((points[::2, ::2][asked] - self.lamp.astype(points.dtype)).T))
        return share.repeat(2, 0).repeat(2, 1)[:rows, :columns]

    def look(self, triangle: np.ndarray, points: np.ndarray, channels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Albedo [channels, n] and glow [n], float32, at hit points [n, 3]; `channels` [3, channels] weighs R, G, B.

        Points are sorted by surface, and each surface is evaluated at once.
        """
        surface = self.surface[triangle]
        order = np.argsort(surface.astype(np.uint16), kind="stable")
        counts = np.bincount(surface, minlength=len(self.mesh.surfaces) + 1)
        ends = np.cumsum(counts)
        colour = np.zeros((channels.shape[1], len(points)), np.float32)
        glow = np.zeros(len(points), np.float32)
        for index in np.flatnonzero(counts[:-1]):
            part = order[ends[index] - counts[index] : ends[index]]
            material, origin, along_u, along_v = self.mesh.surfaces[index]
            x, y, z = points.take(part, 0).T
            u, v = (
                x * np.float32(axis[0])
                + y * np.float32(axis[1])
                + (z * np.float32(axis[2]) - np.float32(axis @ origin))
                for axis in (along_u, along_v)
            )
            colour[:, part] = material.albedo(u, v, channels)
            if material.glow:
                glow[part] = material.glow
        return colour, glow


def room_from_scanner(config: SimulationConfig) -> Motion:
    """Scanner coordinates to the room's (origin in a corner on the floor); identity without a room."""
    if config.room is None:
        return Motion(np.eye(3), np.zeros(3))
    yaw = np.deg2rad(config.room.yaw_deg)
    return Motion(rodrigues(np.array([0.0, 0.0, 1.0]), yaw), np.array(config.room.rig_m))


@lru_cache(maxsize=4)
def make_scene(
    config: SimulationConfig, *, boards: bool = False, extras: Callable[[Mesh], None] | None = None
) -> Scene:
    """The scene of a configuration; the last few are kept.

    Where the table carries an object, that is taken off to make place for `boards`. `extras` adds surfaces to a room,
    in its coordinates: origin in a corner on the floor, x and y along the walls, z up [m].
    """
    if config.room is not None:
        mesh = furnish(config.room)
        if extras is not None:
            extras(mesh)
        size = np.array(config.room.size_m)
        lamp, reach = size * (0.5, 0.5, LAMP_HEIGHT_SHARE), float(np.mean(size[:2]) / 2)
    elif config.object is not None:
        mesh = set_table(config.object, empty=boards)
        lamp, reach = np.array([-0.6, 0.8, 1.0]), 1.4
    else:
        mesh, lamp, reach = Mesh(), np.zeros(3), 1.0
    motion = room_from_scanner(config).inverse()
    return build_scene(_carry(mesh, motion), motion.apply(lamp), reach, shadows=config.light.shadows)


def build_scene(mesh: Mesh, lamp: np.ndarray, reach: float, *, shadows: bool) -> Scene:
    """A scene of a mesh in the scanner frame."""
    corners = np.concatenate(mesh.triangles)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    surface = np.repeat(np.arange(len(mesh.triangles)), [len(part) for part in mesh.triangles])
    return Scene(
        Caster(corners),
        mesh,
        np.append(surface, len(mesh.triangles)),
        np.concatenate([normal, np.zeros((1, 3))]).astype(np.float32),
        lamp,
        reach,
        shadows,
        np.append(np.array([part.material.mirror for part in mesh.surfaces], np.float32)[surface], np.float32(0)),
        Outline(mesh, normal),
    )


def _carry(mesh: Mesh, motion: Motion) -> Mesh:
    surfaces = [
        surface._replace(
            origin=motion.apply(surface.origin),
            along_u=motion.rotation @ surface.along_u,
            along_v=motion.rotation @ surface.along_v,
        )
        for surface in mesh.surfaces
    ]
    return Mesh([motion.apply(part) for part in mesh.triangles], surfaces)


def _occluded(caster: Caster, origin: np.ndarray, legs: np.ndarray, skin: float) -> np.ndarray:
    """Whether something stands on ways [n, 3] from `origin`, before their last `skin` metres, bool [n]."""
    distance = np.sqrt(np.einsum("ij,ij->i", legs, legs))
    return caster.blocked(origin, legs * np.maximum(1 - skin / np.maximum(distance, 1e-9), 0)[:, None])
