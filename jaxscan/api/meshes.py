"""Meshes of clouds, coloured by their points or textured by photographs."""

from dataclasses import dataclass

import jax
import numpy as np

from jaxscan.api.photographs import open_photographs
from jaxscan.api.stages import Stage, Stages, megapixels
from jaxscan.files.capture import Capture
from jaxscan.geometry import Scanner
from jaxscan.measurement import camera_centres
from jaxscan.photographs import colour_points, make_occluder
from jaxscan.reconstruction import PointCloud, Progress, in_scanner_frame
from jaxscan.surface import (
    DEFAULT_MESH,
    Colour,
    Mesh,
    MeshSettings,
    coloured_mesh,
    mesh_grid,
    texels_of_pixels,
    texture_any_mesh,
)
from jaxscan.surface import poisson_mesh as close_points
from jaxscan.surface import textured_mesh as draw_on_mesh


def mesh_cloud(cloud: PointCloud, *, scanner: Scanner | None = None, settings: MeshSettings = DEFAULT_MESH) -> Mesh:
    """A mesh of a cloud: neighbours of its grid are joined where they are on one surface.

    Args:
        cloud: Points on the grid [m].
        scanner: The rig that took it, which tells where the camera was. Without, it counts as at the scanner's origin.
        settings: What counts as one surface.

    Returns:
        The mesh, in the colours of the cloud.

    Raises:
        CloudError: If the cloud has no grid, or no face.
    """
    host = jax.tree.map(np.asarray, cloud)
    return coloured_mesh(mesh_grid(host, None if scanner is None else camera_centres(host, scanner), settings))


@dataclass(frozen=True)
class Texture:
    """What is drawn on a mesh."""

    capture: Capture
    """The sweep of the cloud, with laser-off images."""
    texels: int | None = None
    """Texels on each side of a cell of the grid; where not given, about one for each pixel of the camera."""
    progress: Progress = None
    """Called with (images read, images in all); large textures are drawn in parts, each from all images."""


def textured_mesh(
    cloud: PointCloud, scanner: Scanner, texture: Texture, *, settings: MeshSettings = DEFAULT_MESH
) -> Mesh:
    """A mesh as by `mesh_cloud`, with a picture drawn from the laser-off images of the sweep.

    Args:
        cloud: Points on the grid [m], of one station.
        scanner: The rig that took it.
        texture: The images.
        settings: What counts as one surface.

    Raises:
        CloudError: If the cloud has no grid or no face, or the picture is too large.
        CaptureError: If the sweep has no laser-off images, or one cannot be read.
        CalibrationError: If the calibration is for images of another size.
    """
    own, pose = in_scanner_frame(jax.tree.map(np.asarray, cloud))
    grid = mesh_grid(own, camera_centres(own, scanner), settings)
    if texture.texels is None:
        texels = texels_of_pixels(grid, _pixels_per_radian(scanner))
    else:
        texels = (texture.texels, texture.texels)
    return _placed(draw_on_mesh(grid, _colours(own, scanner, texture), texels), pose)


def draw_texture(mesh: Mesh, cloud: PointCloud, scanner: Scanner, texture: Texture) -> Mesh:
    """A picture on any mesh of a cloud, also one with fewer faces, or one through all points.

    Args:
        mesh: Made of the cloud.
        cloud: Points on the grid [m], of one station: what stands before what.
        scanner: The rig that took it.
        texture: The images; `texels` means nothing here.

    Raises:
        CloudError: If the cloud has no grid.
        CaptureError: If the sweep has no laser-off images, or one cannot be read.
        CalibrationError: If the calibration is for images of another size.
    """
    own, pose = in_scanner_frame(jax.tree.map(np.asarray, cloud))
    seen = _placed(mesh, np.linalg.inv(pose))
    return _placed(texture_any_mesh(seen, _colours(own, scanner, texture), _pixels_per_radian(scanner)), pose)


def _colours(cloud: PointCloud, scanner: Scanner, texture: Texture) -> Colour:
    images = megapixels(*texture.capture.image_size, len(texture.capture))
    # The same as for `colour_cloud`, with the mesh before the first image.
    told = Stages(texture.progress, (Stage(4.5, 0.33 * images),)).part(0)
    photographs = open_photographs(texture.capture, scanner, progress=told)
    occluder = make_occluder(cloud, scanner)
    return lambda points, normals: colour_points(photographs, points, normals, occluder=occluder)


def _placed(mesh: Mesh, pose: np.ndarray) -> Mesh:
    """A mesh after a motion [4, 4], in its own precision."""
    rotation, kinds = pose[:3, :3].T, (mesh.vertices.dtype, mesh.normals.dtype)
    vertices, normals = mesh.vertices.astype(np.float64) @ rotation + pose[:3, 3], mesh.normals @ rotation
    return mesh._replace(vertices=vertices.astype(kinds[0]), normals=normals.astype(kinds[1]))


def _pixels_per_radian(scanner: Scanner) -> float:
    return float(max(scanner.camera.fx, scanner.camera.fy))


def poisson_mesh(cloud: PointCloud) -> Mesh:
    """One surface through all points of a cloud, with or without a grid, whose holes are filled.

    Raises:
        CloudError: If it has too few points with normals.
        DependencyError: If Open3D is not installed.
    """
    return close_points(jax.tree.map(np.asarray, cloud))
