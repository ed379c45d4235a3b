"""Surfaces of a simulated room in its own frame: the box, and facets of furniture and of walls that are not flat."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from jaxscan.simulation import RoomSpec
from jaxscan.simulation.scene.meshes import Mesh
from jaxscan.simulation.scene.scene import Scene, build_scene, furnish
from jaxscan.simulation.scene.textures import Material


BOX = ("wall x0", "wall x1", "wall y0", "wall y1", "floor", "ceiling")
"""Surfaces 0 to 5."""
_WAVES = 48
_PLASTER = Material(((0.7, 0.7, 0.7),))


@dataclass(frozen=True)
class Box:
    """Six planes `normal . p = distance`; normals look into the room."""

    normal: np.ndarray
    distance: np.ndarray

    def corner(self, point: np.ndarray, metres: float = 0.15) -> np.ndarray:
        """Nearness of points [n, 3] to a second wall: 1 in the corner; its sign says on which of both they are."""
        gap = np.abs(point @ self.normal.T - self.distance)
        order = np.argsort(gap, axis=1)
        second = np.take_along_axis(gap, order[:, 1:2], 1)[:, 0]
        return np.where(order[:, 0] < order[:, 1], 1.0, -1.0) * np.exp(-second / metres)


@dataclass(frozen=True, eq=False)
class Facets:
    """Triangles; the last entry of each array is for rays that hit nothing."""

    scene: Scene
    normal: np.ndarray
    distance: np.ndarray
    surface: np.ndarray

    def cast(self, eye: np.ndarray, ray: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nearest hits of rays [n, 3]: lengths of the ray, and facets."""
        return self.scene.cast(eye, ray)

    def blocked(self, source: np.ndarray, point: np.ndarray) -> np.ndarray:
        """Whether something stands between both, each [n, 3]."""
        far, _ = self.scene.cast(source, point - source)
        return far < 1 - 2e-3


@dataclass(frozen=True)
class RoomSurfaces:
    """All that a stripe can lie on."""

    box: Box
    facets: Facets | None
    """None: the empty box."""
    rough_m: float
    rough_length_m: float

    def rough(self, point: np.ndarray, surface: np.ndarray) -> np.ndarray:
        """Height of the surface over its plane at points [n, 3]: a sum of waves, so that no grid shows [m]."""
        height = np.zeros(len(point))
        for number in np.unique(surface[surface >= 0]):
            mine = surface == number
            random = np.random.default_rng([int(number), 86])
            wave = random.standard_normal((3, _WAVES)) / self.rough_length_m
            phase = random.uniform(0, 2 * np.pi, _WAVES)
            height[mine] = np.cos(point[mine] @ wave + phase).sum(1) * np.sqrt(2 / _WAVES)
        return self.rough_m * height


def box_of(room: RoomSpec) -> Box:
    """The walls, floor and ceiling of a room."""
    normal, distance = np.zeros((6, 3)), np.zeros(6)
    for axis, size in enumerate(room.size_m):
        normal[2 * axis, axis], normal[2 * axis + 1, axis] = 1.0, -1.0
        distance[2 * axis + 1] = -size
    return Box(normal, distance)


@lru_cache(maxsize=4)
def facets_of(room: RoomSpec, extras: Callable[[Mesh], None] | None) -> Facets:
    """The facets of a furnished room; the last few are kept."""
    mesh = furnish(room)
    if extras is not None:
        extras(mesh)
    corners = np.concatenate(mesh.triangles)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance = np.einsum("ij,ij->i", normal, corners[:, 0])
    surface = len(BOX) + np.repeat(np.arange(len(mesh.triangles)), [len(part) for part in mesh.triangles])
    for number, (own, at) in enumerate(zip(*vars(box_of(room)).values(), strict=True)):
        sense = normal @ own
        surface[(np.abs(sense) > 1 - 1e-9) & (np.abs(distance * sense - at) < 1e-9)] = number
    mirror = np.array([part.material.mirror > 0 for part in mesh.surfaces])
    surface[np.repeat(mirror, [len(part) for part in mesh.triangles])] = -1
    scene = build_scene(mesh, np.array(room.size_m) / 2, 1.0, shadows=False)
    last = np.array([[0.0, 0.0, 1.0]])
    return Facets(scene, np.concatenate([normal, last]), np.append(distance, 0.0), np.append(surface, -1))


def stepped(room: RoomSpec, depth_m: float) -> Callable[[Mesh], None]:
    """Half of the wall x0 stands out by a step: two planes that a coarse tolerance takes for one."""
    _, y, z = room.size_m

    def add(mesh: Mesh) -> None:
        mesh.box((depth_m / 2, 0.75 * y, 0), (depth_m, 0.5 * y, z), _PLASTER)

    return add


def curved(room: RoomSpec, sagitta_m: float) -> Callable[[Mesh], None]:
    """The wall y1 bulges into the room as a part of a cylinder, in facets of a two hundredth of its length."""
    x, y, z = room.size_m

    def add(mesh: Mesh) -> None:
        along = np.linspace(0, x, 201)
        out = y - 1e-4 - sagitta_m * (1 - (2 * along / x - 1) ** 2)
        for a, b, low, high in zip(along[:-1], along[1:], out[:-1], out[1:], strict=True):
            mesh.quad(np.array([a, low, 0]), np.array([b - a, high - low, 0]), np.array([0, 0, z]), _PLASTER)

    return add
