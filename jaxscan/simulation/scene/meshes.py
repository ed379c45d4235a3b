"""Triangles of simple solids with their surfaces, and rays cast at them."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.simulation.scene.textures import Material


Place = tuple[float | int, float | int, float | int]


class Surface(NamedTuple):
    """Part of a mesh with one material; u = (p - origin) . along_u, v likewise [m]."""

    material: Material
    origin: np.ndarray
    along_u: np.ndarray
    along_v: np.ndarray


@dataclass
class Mesh:
    """Triangles being collected; coordinates in metres, z up."""

    triangles: list[np.ndarray] = field(default_factory=list)
    """Corner points, each [n, 3, 3]."""
    surfaces: list[Surface] = field(default_factory=list)
    """One per entry of `triangles`."""

    def add(self, triangles: np.ndarray, surface: Surface) -> None:
        """Triangles [n, 3, 3] of one surface."""
        self.triangles.append(np.asarray(triangles, np.float64))
        self.surfaces.append(surface)

    def quad(self, origin: np.ndarray, edge_u: np.ndarray, edge_v: np.ndarray, material: Material) -> None:
        """A parallelogram; u and v run along its edges from `origin`."""
        o, a, b = (np.asarray(value, np.float64) for value in (origin, edge_u, edge_v))
        corners = np.array([[o, o + a, o + a + b], [o, o + a + b, o + b]])
        self.add(corners, Surface(material, o, a / np.linalg.norm(a), b / np.linalg.norm(b)))

    def box(
        self, foot: Place, size: Place, material: Material, *, yaw: float = 0.0, front: Material | None = None
    ) -> None:
        """A box on its foot's middle point, `size` along its own x, y, z, turned by `yaw` [rad].

        `front` is the material of the face towards its own -y, where it differs.
        """
        c, s = np.cos(yaw), np.sin(yaw)
        x, y, z = (
            length * np.array(axis) for length, axis in zip(size, ((c, s, 0), (-s, c, 0), (0, 0, 1)), strict=True)
        )
        low = np.asarray(foot) - (x + y) / 2
        self.quad(low, x, z, material if front is None else front)
        self.quad(low + x + y, -x, z, material)
        self.quad(low + x, y, z, material)
        self.quad(low + y, -y, z, material)
        self.quad(low + z, x, y, material)
        self.quad(low + y, x, -y, material)

    def lathe(self, centre: Place, profile: np.ndarray, material: Material, *, sides: int = 40) -> None:
        """A solid of revolution: `profile` [n, 2] of radius and height above `centre`; v is the height."""
        angle = np.linspace(0, 2 * np.pi, sides + 1)
        ring = np.stack([np.cos(angle), np.sin(angle)], -1)
        profile = np.asarray(profile, np.float64)
        points = np.concatenate(
            [profile[:, None, :1] * ring[None], np.broadcast_to(profile[:, None, 1:], (len(profile), sides + 1, 1))], -1
        ) + np.asarray(centre)
        a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
        corners = np.concatenate([np.stack([a, b, c], -2).reshape(-1, 3, 3), np.stack([a, c, d], -2).reshape(-1, 3, 3)])
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=-1)
        up, side = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
        self.add(corners[area > 1e-12], Surface(material, np.asarray(centre, np.float64), side, up))

    def cylinder(self, foot: Place, radius: float, height: float, material: Material) -> None:
        """An upright cylinder with lids."""
        self.lathe(foot, np.array([[0, 0], [radius, 0], [radius, height], [0, height]]), material)

    def sphere(self, centre: Place, radius: float, material: Material) -> None:
        """A ball; v is the height above its middle."""
        angle = np.linspace(-np.pi / 2, np.pi / 2, 25)
        self.lathe(centre, radius * np.stack([np.cos(angle), np.sin(angle)], -1), material, sides=48)


class Caster:
    """Triangles in a search tree; rays may be cast from several threads, each of which works alone."""

    _scene: Any

    def __init__(self, triangles: np.ndarray):
        """A search tree of triangles [n, 3, 3], m.

        Raises:
            DependencyError: If embreex is missing.
        """
        try:
            # Imported here, so that only who casts rays needs it.
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except (ImportError, OSError) as problem:
            raise DependencyError(
                f'The simulator needs embreex, which does not load: {problem}. pip install "jaxscan[simulate]"; '
                "there is none for ARM64."
            ) from problem
        self._scene = EmbreeScene(robust=True)
        TriangleMesh(self._scene, np.ascontiguousarray(triangles, np.float32))
        # The first cast builds the tree, and only one thread may do that.
        self.nearest(np.zeros(3), np.array([[1.0, 0.0, 0.0]]))

    def nearest(self, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first hit of every ray.

        Args:
            origin: [3], m, or one for each ray.
            directions: [rays, 3], of any length.

        Returns:
            t: float32 [rays]: hit = origin + t direction; inf where nothing is hit.
            triangle: int64 [rays]; -1 where nothing is hit.
        """
        hits = self._scene.run(*_rays(origin, directions), output=1)
        triangle = hits["primID"].astype(np.int64)
        return np.where(triangle < 0, np.float32(np.inf), hits["tfar"]), triangle

    def blocked(self, origin: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """Whether something stands on ways [n, 3] from `origin`, bool [n]."""
        ends = np.ones(len(ways), np.float32)
        return np.asarray(self._scene.run(*_rays(origin, ways), ends, query="OCCLUDED")) >= 0


def _rays(origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directions = np.ascontiguousarray(directions, np.float32)
    return np.ascontiguousarray(np.broadcast_to(origin, directions.shape), np.float32), directions
