"""One surface through all points, also those of several stations: Poisson's, by Open3D."""

import ctypes
import glob
import os
from functools import cache
from types import ModuleType

import numpy as np
from jaxtyping import Float

from jaxscan.errors import CloudError, DependencyError
from jaxscan.reconstruction import PointCloud
from jaxscan.surface.mesh import Mesh


FEWEST = 100
"""Least number of points with a normal."""
FINEST, COARSEST = 12, 6
EMPTIEST = 0.01
"""Share of the vertices, those with the fewest points around them, that are left out: the surface is closed even
where nothing was seen, like a balloon."""
BLOCK = 1 << 16


def poisson_mesh(cloud: PointCloud) -> Mesh:
    """A smooth surface through all points [m] that have a normal towards the camera; holes are filled.

    Cells of the octree are about as large as the points are apart. Vertices have the colour of the nearest point.

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


_PACKAGES = "libusb-1.0-0 libegl1 libgl1 libx11-6 libgomp1 libudev1 libidn2-0"


@cache
def load_open3d() -> ModuleType:
    """The module open3d.

    Raises:
        DependencyError: If it or a system library it needs is missing.
    """
    try:
        import libusb_package

        # Open3D 0.20 is linked against libusb, which few systems have; the package brings one,
        # and it must be loaded first.
        for library in sorted(glob.glob(os.path.join(os.path.dirname(libusb_package.__file__), "libusb-1.0*"))):
            ctypes.CDLL(library, mode=ctypes.RTLD_GLOBAL)
    except (ImportError, OSError):
        pass  # The system may have libusb; if not, the next import says so.
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise DependencyError(
            f'Open3D does not load: {error}. Type pip install "jaxscan[poisson]" and, on Debian or Ubuntu, apt-get '
            f"install {_PACKAGES}"
        ) from error
    return open3d


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
