"""PLY, the format for storage and exchange."""

from jaxscan.files.clouds.ply.reader import read_ply
from jaxscan.files.clouds.ply.writer import write_ply
