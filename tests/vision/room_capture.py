"""Rendered images as a captured sweep, and the true scanner of their rig."""

from types import SimpleNamespace

import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.recalibration import SweepStripes


class Images:
    """A sweep whose laser-off images are in memory."""

    path, pixel_format, carries = "room", "mono8", "scanner"

    def __init__(self, images, angles):
        self.images, self.angles = images, np.asarray(angles, float)
        self.records = [SimpleNamespace(off=(k,)) for k in range(len(images))]
        self.image_size = images[0].shape[::-1]

    def image(self, reference):
        return self.images[reference]


def true_scanner(rig, gain=1.0):
    coefficients = np.array([rig.k1, 0.0, 0.0, 0.0, 0.0])
    camera = Pinhole(rig.focal, rig.focal, *rig.centre, coefficients, rig.width, rig.height)
    sheet = LaserSheet.from_plane(np.array([-0.9, -0.1, 0.4]), 1.0)
    return Scanner.from_parts(camera, sheet, Turntable.from_axis(rig.direction, rig.point, gain=gain))


def stripes_of(angles, name="room", station=0):
    """A sweep without stripes at these angles."""
    none = np.zeros((1, 1))
    number = np.zeros(1, int)
    return SweepStripes(name, none, none, none, none > 0, number, number, np.asarray(angles, float), "rows", station)
