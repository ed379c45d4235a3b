"""Meshes on disk."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from jaxscan.files.meshes.meshes import MESH_SUFFIXES, TEXTURED_SUFFIXES, check_mesh_path, mesh_paths, save_mesh
else:
    load_on_use(__name__)
