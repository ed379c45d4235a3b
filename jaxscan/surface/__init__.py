"""Organised clouds to meshes."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.surface.atlas import texture_any_mesh
    from jaxscan.surface.decimate import simplify_mesh
    from jaxscan.surface.grid_mesh import GridMesh, coloured_mesh, faces_of_cloud, mesh_grid
    from jaxscan.surface.mesh import Mesh
    from jaxscan.surface.open3d_loader import load_open3d
    from jaxscan.surface.poisson import poisson_mesh
    from jaxscan.surface.settings import DEFAULT_MESH, MeshSettings
    from jaxscan.surface.texture import Colour, texels_of_pixels, textured_mesh
else:
    load_on_use(__name__)
