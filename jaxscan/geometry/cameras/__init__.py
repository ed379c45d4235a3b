"""Camera models: one file each, and the registry that lists them."""

from jaxscan.geometry.cameras.camera import CENTRE as CENTRE
from jaxscan.geometry.cameras.camera import FOCAL as FOCAL
from jaxscan.geometry.cameras.camera import AbstractCamera as AbstractCamera
from jaxscan.geometry.cameras.double_sphere import DoubleSphere as DoubleSphere
from jaxscan.geometry.cameras.fisheye import Fisheye as Fisheye
from jaxscan.geometry.cameras.pinhole import Pinhole as Pinhole
from jaxscan.geometry.cameras.registry import CAMERAS as CAMERAS
from jaxscan.geometry.cameras.registry import CameraModel as CameraModel
