"""One surface through all points, also those of several stations: Poisson's, by Open3D."""

import numpy as np
from jaxtyping import Float

from jaxscan.errors import CloudError
from jaxscan.reconstruction import PointCloud
from jaxscan.surface.mesh import Mesh
from jaxscan.surface.open3d_loader import load_open3d


FEWEST = 100
"""Points with a normal, below which there is no surface to speak of."""
FINEST, COARSEST = 12, 6
"""Depths of the octree."""
EMPTIEST = 0.01
"""Share of the vertices, those with the fewest points around them, that are left out: the surface is closed even
where nothing was seen, like a balloon."""
BLOCK = 1 << 16


def poisson_mesh(cloud: PointCloud) -> Mesh:
    """A smooth surface through all points that have a normal; holes are filled.

    Cells of the octree are about as large as the points are apart. Vertices have the colour of the nearest point.

    Args:
        cloud: Points [m] with normals towards the camera, on a grid or not, NumPy arrays.

    Raises:
        CloudError: If it has too few points with normals.
        DependencyError: If Open3D is not installed.
    """
    points = cloud.points()
    known = np.linalg.norm(points.normals, axis=1) > 0.5
    xyz, normals, rgb = points.xyz[known].astype(np.float64), points.normals[known], points.rgb[known]
    if len(xyz) < FEWEST:
        raise CloudError(f"found {len(xyz)} points with a normal, expected at least {FEWEST} for a surface.")
    open3d = load_open3d()
    origin = xyz.mean(0)
    seen = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz - origin))
    seen.normals = open3d.utility.Vector3dVector(normals.astype(np.float64))
    size = float((xyz.max(0) - xyz.min(0)).max())
    some = np.linspace(0, len(xyz) - 1, min(len(xyz), 2000)).astype(np.int64)
    tree = open3d.geometry.KDTreeFlann(seen)
    gaps = [np.sqrt(tree.search_knn_vector_3d(seen.points[k], 2)[2][1]) for k in some]
    apart = max(float(np.median(gaps)), 1e-6 * size)
    depth = int(np.clip(np.ceil(np.log2(size / apart)), COARSEST, FINEST))
    made, density = open3d.geometry.TriangleMesh.create_from_point_cloud_poisson(seen, depth=depth)
    density = np.asarray(density)
    made.remove_vertices_by_mask(density < np.quantile(density, EMPTIEST))
    made.compute_vertex_normals()
    vertices = np.asarray(made.vertices)
    return Mesh(
        (vertices + origin).astype(cloud.xyz.dtype),
        np.asarray(made.vertex_normals).astype(np.float32),
        rgb[_nearest(open3d, xyz - origin, vertices)],
        np.asarray(made.triangles).astype(np.int32),
    )


def _nearest(open3d, points: Float[np.ndarray, "n 3"], places: Float[np.ndarray, "m 3"]) -> np.ndarray:
    """Number of the nearest point of each place."""
    search = open3d.core.nns.NearestNeighborSearch(open3d.core.Tensor(points))
    search.knn_index()
    found = [
        search.knn_search(open3d.core.Tensor(np.ascontiguousarray(places[start : start + BLOCK])), 1)[0].numpy()
        for start in range(0, len(places), BLOCK)
    ]
    return np.concatenate(found)[:, 0]
