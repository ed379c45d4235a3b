"""Organised clouds to meshes."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.surface.atlas import texture_any_mesh
    from jaxscan.surface.grid_mesh import GridMesh, coloured_mesh, faces_of_cloud, mesh_grid
    from jaxscan.surface.mesh import DEFAULT_MESH, Mesh, MeshSettings
    from jaxscan.surface.poisson import load_open3d, poisson_mesh, simplify_mesh
    from jaxscan.surface.texture import Colour, texels_of_pixels, textured_mesh
else:
    load_on_use(__name__)
