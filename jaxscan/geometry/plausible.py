"""Whether the numbers of a scanner fit one another: those that a person wrote may be in other units or of other images.

Nothing here is a matter of accuracy. Lengths of a rig differ by a factor of ten or so; one in millimetres among metres,
or all of them, differ by a thousand.
"""

from typing import NamedTuple

import numpy as np

from jaxscan.geometry.cameras import AbstractCamera
from jaxscan.geometry.kinematics import lit_points
from jaxscan.geometry.motions import Turntable
from jaxscan.geometry.scanner import Scanner


_ACROSS = 33
"""Pixels across an image that are tested."""
_WIDE_DEG, _NARROW_DEG = 160.0, 0.5
"""Angles of view that a lens of the pinhole model does not have."""
_OFF_CENTRE = 0.35
"""Distance of the principal point from the middle of the image, in its sides, from which it is doubtful [1]."""
_UNEQUAL = 1.5
"""Ratio of the focal lengths along both sides, from which it is doubtful [1]."""
_FAR_M = 60.0
"""Distance of all light of a laser, which no rig of this kind has."""
_APART = (50.0, 10.0)
"""Distance of the axis from all light of a laser, divided by the distance of this light from the camera: for a table
that carries the scanner, and for one that carries the object [1]."""
_BESIDE_M = 4.0
"""Distance of a laser's plane from the camera, from which it is doubtful: that is how large a rig is."""
_OTHER_UNIT = "lengths of a calibration are metres, and these may be in centimetres"
_METRES = "lengths of a calibration are metres, and this one may be in millimetres"


class Doubt(NamedTuple):
    """Something impossible or implausible."""

    said: str
    impossible: bool
    """Whether it makes a cloud impossible."""


def camera_doubts(camera: AbstractCamera) -> list[Doubt]:
    """Numbers of a camera that do not fit its image size."""
    doubts = []
    size = np.array([camera.width, camera.height], np.float64)
    focal = np.array([camera.fx, camera.fy], np.float64)
    centre = np.array([camera.cx, camera.cy], np.float64)
    shape = f"{camera.width} x {camera.height} px"
    across, down = np.degrees(2 * np.arctan(size / 2 / focal))
    if not camera.wide and not _NARROW_DEG < max(across, down) < _WIDE_DEG:
        seen = (
            f"the camera sees {across:.4g} x {down:.4g} degrees by fx = {focal[0]:g} and fy = {focal[1]:g} in {shape}"
        )
        doubts.append(Doubt(f"{seen}: focal lengths are pixels, not millimetres", impossible=True))
    if focal.max() > _UNEQUAL * focal.min():
        doubts.append(Doubt(f"fx = {focal[0]:g} and fy = {focal[1]:g} differ, and pixels are square as a rule", False))
    if np.any(np.abs((centre - (size - 1) / 2) / size) > _OFF_CENTRE):
        where = f"the principal point ({centre[0]:g}, {centre[1]:g}) lies far from the middle of {shape}"
        doubts.append(Doubt(f"{where}: of images of another size, or cx and cy are exchanged", impossible=False))
    return doubts


def scanner_doubts(scanner: Scanner) -> list[Doubt]:
    """Numbers of a scanner that do not fit one another.

    For every laser the part of its light that the camera can see is tested: where it is, and where the axis is from
    there.
    """
    doubts = camera_doubts(scanner.camera)
    if any(doubt.impossible for doubt in doubts):
        return doubts
    camera, rig, table = scanner.camera, scanner.rig, scanner.turntable
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _ACROSS), np.linspace(0, camera.height - 1, _ACROSS))
    q = np.stack([u.ravel(), v.ravel()], -1)
    for number, name in enumerate(scanner.laser_names):
        p, incidence = (np.asarray(values) for values in lit_points(rig, q, number))
        lit = p[incidence > 0]
        if not len(lit):
            why = "the camera sees none of its plane: check the signs of normal and distance"
            doubts.append(Doubt(f'laser "{name}": {why}', impossible=True))
            continue
        # A sheet is met far away by rays that are nearly parallel to it; what is near can be scanned.
        near, usual = (float(part) for part in np.quantile(np.linalg.norm(lit, axis=-1), (0.0, 0.25)))
        if near > _FAR_M:
            why = f"the nearest of its light that the camera sees is {near:.4g} m away"
            doubts.append(Doubt(f'laser "{name}": {why}; {_METRES}', impossible=True))
            continue
        aside = float(scanner.laser(number).distance)
        if aside > _BESIDE_M:
            why = f"its plane passes {aside:.4g} m beside the camera"
            doubts.append(Doubt(f'laser "{name}": {why}; {_OTHER_UNIT}', impossible=False))
        if isinstance(table, Turntable):
            apart = np.cross(lit - np.asarray(table.point, np.float64), np.asarray(table.direction, np.float64))
            away = float(np.linalg.norm(apart, axis=-1).min())
            if away > _APART[table.carries == "object"] * usual:
                why = f"the axis is {away:.4g} m from all light of laser {name!r}, seen from {near:.3g} m on"
                doubts.append(Doubt(f"{why}; {_METRES}", impossible=True))
    return doubts
