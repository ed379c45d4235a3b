"""Meshes on disk."""

from jaxscan.files.meshes.meshes import MESH_SUFFIXES, TEXTURED_SUFFIXES, check_mesh_path, mesh_paths, save_mesh
