"""Angles of a sweep against the motion of its laser-off images."""

import dataclasses
import re
import shutil

import numpy as np
import pytest

import jaxscan
from jaxscan.api import reconstruct_capture
from jaxscan.errors import CaptureError
from jaxscan.geometry import LaserSheet, LinearStage, Pinhole, Scanner, Turntable, stack_lasers
from jaxscan.reconstruction import Sweep, refuse_other_motion


WIDTH, HEIGHT, COUNT = 320, 96, 24
TURN = np.radians(9.0) * np.arange(COUNT)
FOCAL, OFFSET, ROOM, ROUND = 200.0, 0.12, 2.0, 0.3
CAMERA = Pinhole(
    fx=np.float64(FOCAL), fy=np.float64(FOCAL), cx=np.float64(159.5), cy=np.float64(47.5),
    distortion=np.zeros(5), width=WIDTH, height=HEIGHT,
)  # fmt: skip
SHEET = stack_lasers([LaserSheet.from_plane(np.array([-1.0, -0.03, 0.30]), 0.2)])
ROOM_SCANNER = Scanner(CAMERA, SHEET, Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -OFFSET]))
TABLE_SCANNER = Scanner(CAMERA, SHEET, Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, 1.0], carries="object"))
RAYS = np.stack(np.meshgrid((np.arange(WIDTH) - 159.5) / FOCAL, (np.arange(HEIGHT) - 47.5) / FOCAL), -1)


def surface(scanner):
    """Where rays meet the round wall of a room, or a round thing on a table: the azimuth about the axis and the height.

    Azimuths are those of the sheet's frame, so that a camera or a thing that turns adds its angle.
    """
    x, y = RAYS[..., 0], RAYS[..., 1]
    foot = np.asarray(scanner.turntable.point)[2]
    radius, sign = (ROOM, 1) if foot < 0 else (ROUND, -1)
    # |t (x, 1) - (0, foot)| = radius
    a, b, c = x**2 + 1, foot, foot**2 - radius**2
    root = b**2 - a * c
    t = (b + sign * np.sqrt(np.maximum(root, 0))) / a
    return np.arctan2(-t * x, t - foot), -t * y, root > 0


def frames(scanner, texture, turn=TURN, seed=1):
    """Laser-off frames of the texture [azimuth, height] -> DN, with noise."""
    azimuth, height, met = surface(scanner)
    background = 40 + 30 * np.sin(RAYS[..., 0] * 40) * np.cos(RAYS[..., 1] * 31)
    noise = np.random.default_rng(seed)
    seen = [np.where(met, texture((azimuth + theta) % (2 * np.pi), height), background) for theta in turn]
    return np.clip(np.rint(seen + noise.normal(0, 1.2, (len(turn), HEIGHT, WIDTH))), 0, 255).astype(np.uint8)


def blobs(azimuth, height, seed=5, cells=240):
    """A texture that repeats nowhere, in cells of equal sides."""
    values = np.random.default_rng(seed).uniform(30, 180, (cells, 80))
    i = np.mod(azimuth * cells / (2 * np.pi), cells)
    j = np.clip(height * cells / (2 * np.pi) / (ROOM if cells > 100 else ROUND) + 40, 0, 78)
    (m, n), (a, b) = (part.astype(int) for part in (i, j)), (i % 1, j % 1)
    near, far = (values[k % cells, n] * (1 - b) + values[k % cells, n + 1] * b for k in (m, m + 1))
    return near * (1 - a) + far * a


def points_of(scanner):
    """The stripe in the middle column, as the sheet has it at angle 0."""
    azimuth, height, _ = surface(scanner)
    radius = ROOM if np.asarray(scanner.turntable.point)[2] < 0 else ROUND
    a, z = azimuth[:, 160], height[:, 160]
    stripe = np.stack([radius * np.cos(a), radius * np.sin(a), z], -1)
    return lambda record: stripe


def refuse(scanner, off, angles, points=None):
    sweep = Sweep(off, off, np.asarray(angles))
    refuse_other_motion(sweep, scanner, points or points_of(scanner), lambda record: off[record], "sweep")


CASES = {
    "in a room": (ROOM_SCANNER, blobs, 1),
    # A thing whose front comes towards the camera's left turns against the azimuths that are seen.
    "on a table": (TABLE_SCANNER, lambda azimuth, height: blobs(azimuth, height, cells=60), -1),
}


@pytest.fixture(scope="module", params=CASES)
def healthy(request):
    scanner, texture, sense = CASES[request.param]
    return scanner, frames(scanner, texture, sense * TURN)


def test_the_right_angles(healthy):
    scanner, off = healthy
    refuse(scanner, off, TURN)
    refuse(scanner, off, TURN + 2 * np.pi)
    refuse(scanner, off, TURN % (2 * np.pi) - np.pi)
    refuse(scanner, off[::-1], TURN[::-1])


@pytest.mark.parametrize(
    "factor, words",
    [
        (np.pi / 180, "angle_deg is in radians"),
        (-1, "wrong sign"),
        (2, r"multiply angle_deg by (0.5|0.50\d|0.49\d),"),
        (0.9, r"multiply angle_deg by 1.1[012]?,"),
        (1.1, r"multiply angle_deg by 0.9[01]\d?,"),
    ],
)
def test_wrong_angles_are_refused(healthy, factor, words):
    scanner, off = healthy
    with pytest.raises(CaptureError, match=words):
        refuse(scanner, off, factor * TURN)


def test_a_table_that_stands_still():
    off = frames(ROOM_SCANNER, blobs, 0 * TURN)
    with pytest.raises(CaptureError, match="did not turn"):
        refuse(ROOM_SCANNER, off, TURN)
    # Where the laser shows that it did turn, the picture is dirt on the lens before bare walls.
    stripe = points_of(ROOM_SCANNER)(0)
    refuse(ROOM_SCANNER, off, TURN, lambda record: stripe * (1 + 0.01 * record))
    refuse(TABLE_SCANNER, frames(TABLE_SCANNER, blobs, 0 * TURN), TURN)


@pytest.mark.parametrize("angles", [TURN, -TURN, TURN * np.pi / 180], ids=["right", "sign", "radians"])
def test_a_picture_that_tells_nothing_is_quiet(angles):
    """A bare wall, a dark room, a sweep of two records."""
    bare = lambda azimuth, height: 90 + 0 * height
    refuse(ROOM_SCANNER, frames(ROOM_SCANNER, bare), angles)
    refuse(ROOM_SCANNER, np.zeros((COUNT, HEIGHT, WIDTH), np.uint8), angles)
    refuse(ROOM_SCANNER, frames(ROOM_SCANNER, blobs, TURN[:2]), angles[:2])
    refuse(ROOM_SCANNER, frames(ROOM_SCANNER, blobs), angles, lambda record: None)


@pytest.mark.parametrize("period", [4.5, 18.0])
def test_a_texture_that_repeats_is_no_contradiction(period):
    stripes = lambda azimuth, height: 90 + 60 * np.sin(azimuth * 360 / period)
    refuse(ROOM_SCANNER, frames(ROOM_SCANNER, stripes), TURN)


def test_a_linear_stage_is_not_asked():
    off = frames(ROOM_SCANNER, blobs)
    stage = Scanner(CAMERA, SHEET, LinearStage.from_direction([1.0, 0.0, 0.0]))
    sweep = Sweep(off, off, 0.1 * TURN, carries="linear")
    refuse_other_motion(sweep, stage, points_of(ROOM_SCANNER), lambda record: off[record], "sweep")


@pytest.mark.more
@pytest.mark.parametrize(
    "factor, words", [(1.0, ""), (np.pi / 180, "radians"), (-1.0, "wrong sign"), (0.9, "multiply")]
)
def test_a_whole_reconstruction(tiny, tmp_path, factor, words):
    shutil.copytree(tiny.sweep, tmp_path / "sweep")
    capture = jaxscan.open_capture(tmp_path / "sweep")
    records = tuple(dataclasses.replace(record, angle=factor * record.angle) for record in capture.records)
    scanner = jaxscan.load_scanner(tiny.calibration)
    reconstructed = lambda: reconstruct_capture(dataclasses.replace(capture, records=records), scanner)
    if not words:
        assert np.asarray(reconstructed().cloud.valid).any()
        return
    with pytest.raises(CaptureError, match=re.escape(str(capture.path)) + ".*" + words):
        reconstructed()
