"""Rehearses a reconstruction on a made-up sweep of the shapes that a capture will have, so that its code is compiled.

The code depends on the size and format of images, the laser and the motion, and on the number of records in a chunk.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from jaxscan.geometry import LaserSheet, Pinhole, Scanner, Turntable
from jaxscan.measurement import compare_clouds, measure_distance
from jaxscan.photographs import Photograph, Photographs, as_rgb, colour_points, make_occluder
from jaxscan.reconstruction import DEFAULTS, Sweep, make_plan, reconstruct
from jaxscan.stripes import LaserLine, PixelFormat, frame_rank


RECORDS = 64
"""Enough for chunks of the size that longer sweeps have, and for two of them."""
_DIFFERENT = 4
"""Frames with noise of their own; they repeat."""
_FOCAL, _BASELINE, _CROSSING_M, WALL_M = 0.65, 0.4, 3.2, 2.0
"""Focal length in widths of the image; a sheet that starts beside the camera and crosses the axis; a wall before it."""
_DARK_DN, _STRIPE_DN, _NOISE_DN, _WIDTH_PX = 60.0, 90.0, 1.5, 1.5
_PATCH_M = 0.2


class ExpectedSweep(NamedTuple):
    """A sweep that is yet to be recorded: by a turning rig with one laser."""

    image_size: tuple[int, int]
    """Width and height [px]."""
    pixel_format: PixelFormat
    line: LaserLine
    records: int


def rehearse_reconstruction(expected: ExpectedSweep) -> None:
    """Reconstruct and measure a wall, made up in the shapes of a sweep; nothing of it is kept but the compiled code.

    Raises:
        JaxscanError: If the made-up sweep is refused.
    """
    sweep, scanner = made_up_sweep(expected)
    settings = replace(DEFAULTS, chunk_records=_chunk(sweep, scanner, expected.records))
    cloud = reconstruct(sweep, scanner, settings=settings)
    points = np.asarray(cloud.xyz)[np.asarray(cloud.valid)]
    ends = points[points[:, 2].argmin()], points[points[:, 2].argmax()]
    measure_distance(cloud, *ends, radius_m=_PATCH_M, scanner=scanner)
    frames = sweep.on if sweep.off is None else sweep.off
    few = zip(sweep.angles[:_DIFFERENT].tolist(), frames, strict=False)
    shots = [Photograph(angle, as_rgb(frame, sweep.pixel_format)) for angle, frame in few]
    colour_points(Photographs(scanner, shots), points, np.zeros_like(points), occluder=make_occluder(cloud, scanner))
    compare_clouds(cloud, cloud, scanner=scanner)


def made_up_sweep(expected: ExpectedSweep) -> tuple[Sweep, Scanner]:
    """A sweep of a wall of a few records, and the rig that took it."""
    order = np.arange(min(RECORDS, expected.records)) % _DIFFERENT
    on, off = (part[order] for part in _frames(expected))
    angles = np.deg2rad(np.arange(len(order)))
    sweep = Sweep(on, off, angles, expected.pixel_format, lasers=(expected.line,), carries="scanner")
    return sweep, _scanner(expected)


def _chunk(sweep: Sweep, scanner: Scanner, records: int) -> int:
    """Records of a chunk of the whole sweep, which depend on the cores."""
    frames = np.broadcast_to(sweep.on[:1], (records, *sweep.on.shape[1:]))
    number = np.arange(records)
    whole = replace(sweep, on=frames, off=frames, angles=number, laser=0 * number, record=number)
    return make_plan(whole, scanner, DEFAULTS).size


def _scanner(expected: ExpectedSweep) -> Scanner:
    """A made-up rig."""
    width, height = expected.image_size
    focal, zero = np.asarray(_FOCAL * width), np.asarray(0.0)
    camera = Pinhole(
        focal, focal, np.asarray((width - 1) / 2), np.asarray((height - 1) / 2), np.zeros(5), width, height, zero
    )
    across = np.array([1.0, 0.0, 0.0] if expected.line.stripe_axis == "rows" else [0.0, 1.0, 0.0])
    sheet = LaserSheet.from_plane(across / _BASELINE + np.array([0.0, 0.0, 1 / _CROSSING_M]), 1.0)
    table = Turntable.from_axis([0.0, -1.0, 0.0], [0.0, 0.0, -0.05])
    rig = Scanner.from_parts(camera, sheet, table, laser_names=(expected.line.name,))
    covariance = 1e-12 * np.eye(len(rig.parameter_names()))
    return Scanner(rig.camera, rig.lasers, rig.turntable, covariance, rig.laser_names, rig.up)


def _frames(expected: ExpectedSweep) -> tuple[np.ndarray, np.ndarray]:
    """A few frames of a wall with the laser on, and with it off, uint8."""
    width, height = expected.image_size
    rows = expected.line.stripe_axis == "rows"
    middle = ((width if rows else height) - 1) / 2
    # Where the sheet meets the wall.
    at = middle + _FOCAL * width * _BASELINE * (1 - WALL_M / _CROSSING_M) / WALL_M
    pixel = np.arange(width if rows else height)
    stripe = _STRIPE_DN * np.exp(-0.5 * ((pixel - at) / _WIDTH_PX) ** 2)
    light = np.broadcast_to(stripe if rows else stripe[:, None], (height, width))
    if frame_rank(expected.pixel_format) == 3:
        light = light[..., None] * (np.arange(3) == ("red", "green", "blue").index(expected.line.colour))
    random = np.random.default_rng(0)
    noise = _NOISE_DN * random.standard_normal((2, _DIFFERENT, *light.shape), np.float32)
    on, off = (np.rint(_DARK_DN + part + extra).astype(np.uint8) for part, extra in zip(noise, (light, 0), strict=True))
    return on, off
