"""PCD, the format of the Point Cloud Library and of ROS."""

from jaxscan.files.clouds.pcd.reader import read_pcd
from jaxscan.files.clouds.pcd.writer import write_pcd
