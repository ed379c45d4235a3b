"""Text formats: XYZ, which every program reads, and PTX, which keeps the grid."""

from jaxscan.files.clouds.ptx import read_ptx, write_ptx
from jaxscan.files.clouds.xyz import read_xyz, write_xyz
