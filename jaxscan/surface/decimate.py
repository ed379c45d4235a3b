"""Fewer faces, where the surface is flat: edges collapse in the order of their quadric error."""

import numpy as np

from jaxscan.errors import DependencyError
from jaxscan.surface.mesh import Mesh


def simplify_mesh(mesh: Mesh, faces: int) -> Mesh:
    """A mesh with so many faces at the most.

    Each vertex has the mean colour and normal of those that collapsed into it. Borders move little, so a mesh with many
    of them may keep more faces.

    Args:
        mesh: Without a texture.
        faces: Wanted number.

    Returns:
        The mesh with fewer faces, or itself where it has no more.

    Raises:
        DependencyError: If fast-simplification is not installed.
    """
    try:
        import fast_simplification
    except ImportError as problem:
        raise DependencyError('fewer faces need fast-simplification: pip install "jaxscan[mesh]"') from problem
    if len(mesh.faces) <= faces:
        return mesh
    # Singles far from the origin are coarse.
    origin = mesh.vertices.mean(0, dtype=np.float64)
    near = (mesh.vertices - origin).astype(np.float32)
    vertices, triangles, collapses = fast_simplification.simplify(
        near, mesh.faces, target_count=faces, return_collapses=True
    )
    _, _, home = fast_simplification.replay_simplification(near, mesh.faces, collapses)
    count = np.maximum(np.bincount(home, minlength=len(vertices)), 1)

    def mean(values: np.ndarray) -> np.ndarray:
        sums = [np.bincount(home, values[:, k], minlength=len(vertices)) for k in range(3)]
        return np.stack(sums, 1) / count[:, None]

    normals = mean(mesh.normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(
        (vertices + origin).astype(mesh.vertices.dtype),
        (normals / np.maximum(length, 1e-12)).astype(np.float32),
        np.round(mean(mesh.rgb)).astype(np.uint8),
        triangles.astype(np.int32),
    )
