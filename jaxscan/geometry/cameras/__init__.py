"""Camera models, one file each, and their registry."""

from jaxscan.facades import TYPE_CHECKING, load_on_use


if TYPE_CHECKING:
    from typing import TYPE_CHECKING, Literal

    from jaxscan.geometry.cameras.camera import CENTRE, FOCAL, AbstractCamera
    from jaxscan.geometry.cameras.double_sphere import DoubleSphere
    from jaxscan.geometry.cameras.fisheye import Fisheye
    from jaxscan.geometry.cameras.pinhole import Pinhole
    from jaxscan.geometry.cameras.registry import CAMERAS, CameraModel
else:
    load_on_use(__name__)
