"""A calibration from boards and a room measured with it, by equations alone: no image is rendered.

Pixels of corners and stripes come from `experiments.worlds.ideal_rig` and `experiments.recalibration.crossings`, which
share no code with the estimator. So one source of error can act alone, and a draw takes two seconds.
"""

from dataclasses import dataclass, replace

import numpy as np

import jaxscan
from experiments.recalibration.world import Noise, Sweeping, true_sweep
from experiments.worlds.calibration_trials import observations
from experiments.worlds.ideal_boards import BoardPoses, add_noise, ideal_boards
from jaxscan.calibration.parameters import USUALLY_FREE
from jaxscan.recalibration import SweepStripes
from jaxscan.simulation import SimulationConfig, make_rig
from jaxscan.simulation.sweep import Placement


@dataclass(frozen=True)
class Faults:
    """Sources of error; by default there are none."""

    corner_px: float = 0.0
    """Noise of each coordinate of a corner, a standard deviation [px]."""
    stripe_px: float = 0.0
    """Noise of a row's centre from the sensor [px]."""
    speckle_px: float = 0.0
    """Noise of a row's centre from speckle [px]."""
    pitch: float = 0.0
    """Relative error of the size of the board's squares, a standard deviation [1]."""
    gain: float = 0.0
    """Relative error of the table's angles; its sign is drawn [1]."""
    harmonics: tuple[float, float] = (0.0, 0.0)
    """Amplitudes of the table's errors once and twice per turn; their phases are drawn [rad]."""
    jitter_rad: float = 0.0
    """Independent errors of the table's stops, evenly spread over this width [rad]."""
    bow: tuple[float, float] = (0.0, 0.0)
    """Of the laser's sheet, as `LaserSpec.bow`; its sign is drawn."""


@dataclass(frozen=True)
class Study:
    """The setting that all draws share."""

    config: SimulationConfig
    """A rig without faults in an empty room."""
    poses: BoardPoses
    stated: Faults
    """By which the calibration weighs corners and stripes."""
    points: int
    """Of the stripe on a board, at most."""
    steps: int
    stride: int
    """Only every n-th row of the sweep has a point."""


def plain_rig(config: SimulationConfig) -> SimulationConfig:
    """The rig of a configuration without its faults, in its room without furniture and mirror."""
    assert config.room is not None
    table = config.turntable.model_copy(update={"gain": 1.0, "harmonics": (0.0, 0.0, 0.0, 0.0)})
    laser = config.laser[0].model_copy(update={"bow": (0.0, 0.0)})
    boards = config.boards.model_copy(update={"warp_mm": (0.0, 0.0)})
    room = config.room.model_copy(update={"furniture": False, "mirror": None})
    return config.model_copy(update={"turntable": table, "laser": (laser,), "boards": boards, "room": room})


def poses_of(config: SimulationConfig, placements: list[Placement]) -> BoardPoses:
    """The poses of a plan of boards; all are lit."""
    home = make_rig(config).pose(0.0).inverse()
    views = [(number, phi) for number, one in enumerate(placements) for phi in one.angles]
    number, angle = (np.array(column) for column in zip(*views, strict=True))
    return BoardPoses([home @ one.scanner_from_board for one in placements], number, angle, np.ones(len(views), bool))


def measured_room(
    study: Study, faults: Faults, random: np.random.Generator, *, as_user: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Width and length of the room by one calibration and one sweep, with their predicted standard deviations [2] [m].

    Args:
        study: The rig, its protocol and its sweep.
        faults: The sources of error.
        random: Source of all draws.
        as_user: Noise is estimated from residuals, as a user's calibration does it. Otherwise corners and stripes have
            the weights of `study.stated` even where they are exact, so that a source alone has the same effect as
            among all sources.

    Raises:
        MeasurementError: If the cloud has no walls that can be measured.
    """
    config = study.config
    boards = config.boards.model_copy(
        update={"square_mm": config.boards.square_mm * (1 + faults.pitch * random.standard_normal())}
    )
    config = _faulty(config, faults, random).model_copy(update={"boards": boards})
    scanner = _calibrated(study, config, faults, random, as_user)
    noise = float(np.hypot(faults.stripe_px, faults.speckle_px))
    how = Sweeping(
        steps=study.steps,
        line_stride=study.stride,
        # The standard deviation of an even spread over that width.
        wander_deg=float(np.rad2deg(faults.jitter_rad)) / np.sqrt(12),
        noise=Noise(px=noise, shared_lines=1),
    )
    stripes, _ = true_sweep(config, int(random.integers(2**31)), how)
    stated = float(np.hypot(study.stated.stripe_px, study.stated.speckle_px))
    room = jaxscan.measure_room(cloud_of(stripes, scanner, study.stride, stated), scanner=scanner)
    assert room.length is not None and room.width is not None
    sides = (room.width, room.length)
    value, sigma = (np.array([getattr(side, name) for side in sides]) for name in ("value_m", "sigma_m"))
    # No image shows the size of the squares: every length has their relative uncertainty too.
    return value, np.hypot(sigma, study.stated.pitch * value)


def cloud_of(stripes: SweepStripes, scanner: jaxscan.Scanner, stride: int, sigma_px: float) -> jaxscan.PointCloud:
    """Points of every n-th row of known stripes.

    Args:
        stripes: The stripes of a sweep by one laser.
        scanner: The calibration.
        stride: n.
        sigma_px: Standard deviation of all centres [px].

    Returns:
        The cloud [profiles, rows], without colour and normals.
    """
    rows = np.arange(0, stripes.valid.shape[1], stride)
    valid, u = stripes.valid[:, rows], stripes.centre[:, rows]
    q = np.stack([u, np.broadcast_to(rows, u.shape)], -1).reshape(-1, 2).astype(float)
    phi = np.repeat(stripes.angle[stripes.record], len(rows))
    at, beside = (jaxscan.points(scanner.rig, q + step, 0, phi) for step in ([0.0, 0.0], [1.0, 0.0]))
    shape = valid.shape
    sigma = sigma_px * np.linalg.norm(beside - at, axis=-1).reshape(shape)
    return jaxscan.PointCloud(
        xyz=np.where(valid[..., None], at.reshape(*shape, 3), 0.0),
        rgb=np.zeros((*shape, 3), np.uint8),
        intensity=np.zeros(shape, np.float32),
        normals=np.zeros((*shape, 3), np.float32),
        sigma_random=np.where(valid, sigma, 0.0),
        sigma_systematic=np.zeros(shape),
        valid=valid,
        record=stripes.record,
        laser=stripes.laser,
        angle=stripes.angle[stripes.record],
    )


def _faulty(config: SimulationConfig, faults: Faults, random: np.random.Generator) -> SimulationConfig:
    """The rig as it truly is in one draw."""
    sign, phases = np.sign(random.standard_normal(2)), random.uniform(0, 2 * np.pi, 2)
    harmonics = [size * wave(phase) for size, phase in zip(faults.harmonics, phases, strict=True) for wave in _WAVES]
    table = config.turntable.model_copy(
        update={"gain": 1 + sign[0] * faults.gain, "harmonics": tuple(map(float, harmonics))}
    )
    laser = config.laser[0].model_copy(update={"bow": tuple(float(sign[1] * part) for part in faults.bow)})
    return config.model_copy(update={"turntable": table, "laser": (laser,)})


_WAVES = (np.cos, np.sin)


def _calibrated(
    study: Study, truth: SimulationConfig, faults: Faults, random: np.random.Generator, as_user: bool
) -> jaxscan.Scanner:
    """A calibration of the rig as it truly is, by someone who knows the nominal one."""
    # Free views are all taken at home: nothing turns between them.
    turning = np.bincount(study.poses.placement)[study.poses.placement] > 1
    stops = study.poses.angle + faults.jitter_rad * turning * random.uniform(-0.5, 0.5, len(turning))
    ideal = ideal_boards(truth, study.poses._replace(angle=stops), points=study.points)
    noise = float(np.hypot(faults.stripe_px, faults.speckle_px))
    seen = add_noise(ideal, random, corner_px=faults.corner_px, stripe_px=noise)
    found = observations(seen._replace(angle=study.poses.angle), study.config)
    corner, stripe = study.stated.corner_px, float(np.hypot(study.stated.stripe_px, study.stated.speckle_px))
    found = replace(
        found,
        corners=replace(found.corners, sigma=np.full(found.corners.valid.shape, corner)),
        stripes=replace(found.stripes, sigma=np.full(found.stripes.valid.shape, stripe)),
    )
    free = tuple(block for block in USUALLY_FREE if block != "bow" or any(study.stated.bow))
    settings = jaxscan.CalibrationSettings(judge=False, free=free)
    if not as_user:
        settings = replace(settings, estimate_noise=False, stripe_correlation=1.0)
    scanner = jaxscan.calibrate_observations(found, settings=settings).scanner
    assert scanner is not None
    return scanner
