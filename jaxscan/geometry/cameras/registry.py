"""The camera models, by name."""

from typing import TYPE_CHECKING, Literal

from jaxscan.geometry.cameras.camera import AbstractCamera
from jaxscan.geometry.cameras.double_sphere import DoubleSphere
from jaxscan.geometry.cameras.fisheye import Fisheye
from jaxscan.geometry.cameras.pinhole import Pinhole


CAMERAS: dict[str, type[AbstractCamera]] = {camera.model: camera for camera in (Pinhole, Fisheye, DoubleSphere)}
"""All camera models by name."""

if TYPE_CHECKING:
    CameraModel = str
else:
    CameraModel = Literal[tuple(CAMERAS)]
