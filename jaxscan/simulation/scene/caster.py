"""Rays against triangles, by Embree."""

from typing import Any

import numpy as np

from jaxscan.errors import DependencyError


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
        # The first cast builds the tree, which only one thread may do.
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
