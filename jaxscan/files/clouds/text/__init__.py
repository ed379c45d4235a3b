"""Text formats: XYZ, which every program reads, and PTX, which keeps the grid."""

from jaxscan.files.clouds.text.ptx import write_ptx
from jaxscan.files.clouds.text.ptx_reader import read_ptx
from jaxscan.files.clouds.text.xyz import read_xyz, write_xyz
