"""Turns that are declared twice, half, or by a factor, of a table that carries the object."""

import dataclasses

import numpy as np
import pytest

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable, poses, stack_lasers, transform
from jaxscan.reconstruction import PointCloud
from jaxscan.reconstruction.whole_turns import turn_doubts


RECORDS, LINES = 36, 40
NUMBERS = np.arange(RECORDS)
FLAT = np.zeros((RECORDS, 2, 8), np.float16)


def scanner():
    camera = Pinhole(*map(np.asarray, (800.0, 800.0, 320.0, 240.0)), np.zeros(5), 640, 480)
    table = Turntable.from_axis(np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 0.4]), carries="object")
    return Scanner(camera, stack_lasers([LaserSheet.from_plane(np.array([0.9, 0.0, 0.36]), 0.144)]), table)


def box(turned):
    """Distances from the axis at which a sheet through it meets a box that stands beside the axis [m]."""
    x = np.array([np.cos(turned), np.sin(turned)])
    sides = [((1, 0), 0.06), ((-1, 0), 0.05), ((0, 1), 0.03), ((0, -1), 0.045)]
    return min(far / float(x @ side) for side, far in sides if x @ side > 1e-9)


def cloud(true_deg, declared_deg, alike=None):
    """What is seen after turns, where the journal says others."""
    rig, declared = scanner().rig, np.radians(declared_deg)
    reach = np.array([box(turned) if alike is None else alike(turned) for turned in np.radians(true_deg)])
    height = np.linspace(-0.04, 0.04, LINES)
    # In the camera: on the sheet, so far before the axis.
    along = np.array([0.37, 0.0, -0.93])
    p = np.array([0.0, 0.0, 0.4]) + reach[:, None, None] * along + height[:, None] * np.array([0.0, 1.0, 0.0])
    p = p + np.random.default_rng(0).normal(0, 2e-5, p.shape)
    xyz = np.asarray(transform(poses(rig, declared)[:, None], p)).astype(np.float32)
    grid = (RECORDS, LINES)
    full = np.ones(grid, np.float32)
    return PointCloud(
        xyz=xyz,
        normals=np.zeros((*grid, 3), np.float32),
        rgb=np.zeros((*grid, 3), np.uint8),
        intensity=full,
        sigma_random=full,
        sigma_systematic=full,
        valid=np.ones(grid, bool),
        record=np.arange(RECORDS, dtype=np.int32),
        laser=np.zeros(RECORDS, np.int32),
        angle=declared.astype(np.float32),
    )


def said(true, declared, **others):
    return turn_doubts(cloud(true * NUMBERS, declared * NUMBERS, **others), scanner(), FLAT, NUMBERS)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("true", "declared", "words"),
    [
        (10.0, 20.0, "records 9 and 27 are at one angle by the journal"),
        (10.0, 5.0, "the first and the last record are neighbours by what the laser shows, but 175 deg apart"),
        (10.0, 9.0, "its steps are 10 deg"),
        (20.0, 10.0, "the laser shows the same after 18 records, which the journal says are 180 deg"),
    ],
)
def test_turns_that_contradict_what_is_seen(true, declared, words, sign):
    (doubt,) = said(true, sign * declared)
    assert words in doubt and "\n" not in doubt


@pytest.mark.parametrize(("true", "declared"), [(10.0, 10.0), (5.0, 5.0), (20.0, 20.0), (2.0, 2.0), (10.0, -350.0)])
def test_nothing_is_said_of_turns_that_fit(true, declared):
    assert said(true, declared) == []


def test_what_is_alike_all_around_tells_nothing():
    assert said(10.0, 5.0, alike=lambda turned: 0.04) == []


def test_other_pictures_after_half_a_turn_are_another_side():
    square = {"alike": lambda turned: 0.04 / max(abs(np.cos(turned)), abs(np.sin(turned)))}
    (doubt,) = said(10.0, 10.0, **square)
    assert "either the object is alike after so many degrees" in doubt
    painted = np.random.default_rng(1).uniform(0, 90, FLAT.shape).astype(np.float16)
    assert turn_doubts(cloud(10.0 * NUMBERS, 10.0 * NUMBERS, **square), scanner(), painted, NUMBERS) == []


def test_another_motion_is_not_looked_at():
    still = dataclasses.replace(scanner(), turntable=Turntable.from_axis(np.array([0.0, -1, 0]), np.zeros(3)))
    assert turn_doubts(cloud(10.0 * NUMBERS, 10.0 * NUMBERS), still, FLAT, NUMBERS) == []
