"""Numbers of a rig that a person wrote, in other units or of other images."""

import dataclasses

import numpy as np
import pytest

from jaxscan.geometry import (
    Fisheye,
    LaserSheet,
    Pinhole,
    Scanner,
    Turntable,
    camera_doubts,
    scanner_doubts,
    stack_lasers,
)


def camera(fx=2894.5, fy=2887.3, cx=1016.8, cy=817.3, size=(2048, 1638), kind=Pinhole, lens=5):
    return kind(*map(np.asarray, (fx, fy, cx, cy)), np.zeros(lens), *size)


def scanner(*, sheet=1.0, axis=1.0, carries="scanner", at=(-0.009786, 0.000358, -0.212275), **others):
    """The rig of the paper's tables, with lengths in other units."""
    plane = LaserSheet.from_abc(-7.606, -1.685, 1.296203 * sheet)
    table = Turntable.from_axis(np.array([-0.018237, -0.999833, -0.000846]), axis * np.array(at), carries=carries)
    return Scanner(camera(**others), stack_lasers([plane]), table)


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (scanner(axis=1000), "the axis is 212"),
        (scanner(sheet=1000), "the nearest of its light that the camera sees is"),
        (scanner(sheet=1000, axis=1000), "may be in millimetres"),
        (scanner(axis=1000, carries="object", at=(0.1, 0, 1.5)), "the axis is"),
        (scanner(axis=100, carries="object", at=(0.1, 0, 1.5)), "may be in millimetres"),
        (scanner(fx=4.6, fy=4.6), "focal lengths are pixels, not millimetres"),
    ],
)
def test_numbers_that_cannot_be(rig, words):
    (doubt,) = scanner_doubts(rig)
    assert doubt.impossible and words in doubt.said


@pytest.mark.parametrize(
    "rig",
    [
        scanner(),
        scanner(carries="object", at=(0.1, 0, 1.5)),
        scanner(axis=10),
        scanner(size=(2047, 1700)),
        dataclasses.replace(scanner(), turntable=dataclasses.replace(scanner().turntable, gain=-1.0)),
    ],
)
def test_nothing_is_said_of_rigs(rig):
    assert scanner_doubts(rig) == []


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"size": (1024, 819)}, "the principal point (1016.8, 817.3) lies far from the middle of 1024 x 819 px"),
        ({"cx": 817.3, "cy": 1016.8, "size": (1638, 1100)}, "cx and cy are exchanged"),
        ({"fx": 2894.5, "fy": 1447.3}, "pixels are square"),
    ],
)
def test_numbers_that_hardly_are(given, words):
    (doubt,) = camera_doubts(camera(**given))
    assert words in doubt.said and not doubt.impossible


def test_a_rig_in_centimetres():
    (doubt,) = scanner_doubts(scanner(sheet=100, axis=100))
    assert "passes 16.5" in doubt.said and "centimetres" in doubt.said and not doubt.impossible


def test_a_wide_lens_sees_far_to_the_sides():
    assert camera_doubts(camera(fx=300, fy=300, kind=Fisheye, lens=4)) == []


def test_a_sheet_behind_the_camera():
    plane = LaserSheet.from_plane(np.array([0.1, 0.0, -1.0]), 0.5)
    (doubt,) = scanner_doubts(dataclasses.replace(scanner(), lasers=stack_lasers([plane])))
    assert doubt.impossible and "sees none of its plane" in doubt.said
