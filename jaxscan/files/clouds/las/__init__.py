"""LAS 1.4 and LAZ, the formats of surveying."""

from jaxscan.files.clouds.las.reader import read_las
from jaxscan.files.clouds.las.writer import write_las
