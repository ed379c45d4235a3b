"""Errors of the dimensions of the room by each source of error alone, and by all together.

Not from rendered images. Pixels come from the independent equations of
`experiments.recalibration.world`: boards in poses of our own
protocol, a joint calibration, a sweep of the empty room, and the distances of its walls. Each source acts alone, all
others are zero. "All together" has them all. The predicted standard deviation is compared with the errors of all but
two: jitter, whose size a calibration learns from its boards (`quality.angle_sigma`) but which moves the room by the
sweep's own stops too, and the pitch, whose share is its size times the length. The same sizes hold in both worlds,
whose rigs differ by their lens alone; poses and draws differ.

Sizes: corners 0.1 px and stripe centres 0.05 px, white; speckle as measured, from rendered rows of the unkind world
with and without it; board pitch 0.1 mm over 300 mm, a standard deviation; angle: gain and harmonics of the unkind
table, their signs and phases drawn, and a jitter evenly spread over one microstep of 28 800 a turn, as positions are
rounded; sheet bow as in the unkind world, its sign drawn. Gain, harmonics and the size of the jitter are estimated.
The bow is free; "bow not modelled" shows the price of a flat sheet. The rendered rows of the world at hand
check the 0.05 px.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

import jaxscan
from experiments.exact_rig import BoardPoses, add_noise, ideal_boards, observations
from experiments.paper.stage import Metric, Stage, windowed, world
from experiments.recalibration.world import Noise, Sweeping, true_sweep
from experiments.report import rms
from jaxscan.calibration import USUALLY_FREE
from jaxscan.recalibration import SweepStripes
from jaxscan.simulation import SimulationConfig, make_rig, render_sweep
from jaxscan.simulation.scene import make_scene
from jaxscan.simulation.sweep import Placement, plan_boards


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
    """Width and length of the room by one calibration and one sweep, and their predicted standard deviations [2], m.

    `as_user`: noise is estimated from residuals. Otherwise corners and stripes have the weights of `study.stated` even
    where they are exact, so that a source alone has the same effect as among all sources.
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


CORNER_PX, STRIPE_PX = 0.1, 0.05
PITCH = 0.1 / 300
MICROSTEP_RAD = 2 * np.pi / 28800
"""A stepper of 200 x 16 microsteps behind a gear of 9 : 1."""
SIDES = ("width", "length")
_TOGETHER = {"all": "all sources", "modelled": "all sources but jitter and pitch"}


class Source(NamedTuple):
    """A source of error by itself."""

    name: str
    label: str
    faults: Faults


def run(stage: Stage) -> list[Metric]:
    """Errors of the room's width and length by each source [mm]."""
    stage.say("sensitivity: rows of rendered stripes")
    unkind = world("unkind", quick=stage.quick)
    with_speckle, without = row_error(stage, unkind), row_error(stage, _without_speckle(unkind))
    own = row_error(stage, _without_speckle(stage.config))
    every = Faults(
        corner_px=CORNER_PX,
        stripe_px=STRIPE_PX,
        speckle_px=float(np.sqrt(max(with_speckle**2 - without**2, 0.0))),
        pitch=PITCH,
        gain=abs(unkind.turntable.gain - 1),
        harmonics=(float(np.hypot(*unkind.turntable.harmonics[:2])), float(np.hypot(*unkind.turntable.harmonics[2:]))),
        jitter_rad=MICROSTEP_RAD,
        bow=unkind.laser[0].bow,
    )
    study = _study(stage, every)
    truth = np.array(sorted(study.config.room.size_m[:2]))
    draws = 2 if stage.quick else 8
    errors = {}
    for number, source in enumerate(sources(every)):
        stage.say(f"sensitivity: {source.label}")
        how = study if source.name != "bow_not_modelled" else replace(study, stated=replace(every, bow=(0.0, 0.0)))
        runs = [measured_room(how, source.faults, _random(stage, number, draw))[0] for draw in range(draws)]
        errors[source.name] = 1e3 * (np.array(runs) - truth)
    stage.say("sensitivity: all together")
    count, modelled = (2, 2) if stage.quick else (8, 16)
    runs = [measured_room(study, every, _random(stage, 98, draw), as_user=True)[0] for draw in range(count)]
    errors["all"] = 1e3 * (np.array(runs) - truth)
    # Jitter moves the sweep's stops too; the share of the pitch is known without an experiment: pitch times length.
    still = replace(every, jitter_rad=0.0, pitch=0.0)
    exact = replace(study, stated=replace(every, pitch=0.0))
    pairs = [measured_room(exact, still, _random(stage, 99, draw), as_user=True) for draw in range(modelled)]
    values, sigma = (1e3 * np.array(part) for part in zip(*pairs, strict=True))
    errors["modelled"] = values - 1e3 * truth
    labels = {source.name: source.label for source in sources(every)} | _TOGETHER
    return [*_metrics(errors, sigma, labels), *_row_metrics(every.speckle_px, own)]


def sources(every: Faults) -> list[Source]:
    """Each source alone."""
    bow = Faults(bow=every.bow)
    return [
        Source("corner", f"corner noise, {every.corner_px:g} px", Faults(corner_px=every.corner_px)),
        Source("stripe", f"stripe noise, {every.stripe_px:g} px", Faults(stripe_px=every.stripe_px)),
        Source("speckle", f"speckle, {every.speckle_px:.2f} px", Faults(speckle_px=every.speckle_px)),
        Source("pitch", "board pitch, 0.1 mm in 300 mm", Faults(pitch=every.pitch)),
        Source("angle", "table angle: gain, harmonics", Faults(gain=every.gain, harmonics=every.harmonics)),
        Source("jitter", "table angle: jitter of a microstep", Faults(jitter_rad=every.jitter_rad)),
        Source("bow", "sheet bow, estimated", bow),
        Source("bow_not_modelled", "sheet bow, not modelled", bow),
    ]


def row_error(stage: Stage, config: SimulationConfig) -> float:
    """Root mean square error of a row's centre, without smoothing, in rendered frames of the room [px].

    Rows that err by a pixel are no noise (edges, mirrors) and are left out: about 1 in 1000.
    """
    camera = config.camera
    part = windowed(config, round(0.44 * camera.width), round(0.70 * camera.width))
    angles = np.linspace(0.3, 6.5, 4 if stage.quick else 8)
    records = list(render_sweep(part, angles=angles, seed=config.seed))
    found = jaxscan.extract_stripes(*(np.stack([getattr(one, side) for one in records]) for side in ("on", "off")))
    error = np.asarray(found.u) - np.stack([one.truth.u for one in records])
    there = np.asarray(found.valid) & np.stack([one.truth.valid for one in records]) & (np.abs(error) < 1)
    return rms(error[there])


def _study(stage: Stage, stated: Faults) -> Study:
    config = plain_rig(stage.config)
    random = np.random.Generator(np.random.SFC64([config.seed, 7]))
    placements = plan_boards(make_rig(config), make_scene(config, boards=False), random)
    poses = poses_of(config, placements)
    if stage.quick:
        return Study(config, poses, stated, points=60, steps=240, stride=16)
    return Study(config, poses, stated, points=200, steps=360, stride=16)


def _random(stage: Stage, source: int, draw: int) -> np.random.Generator:
    return stage.generator(61, len(stage.world), source, draw)


def _without_speckle(config: SimulationConfig) -> SimulationConfig:
    laser = config.laser[0].model_copy(update={"speckle_contrast": 0.0})
    return config.model_copy(update={"laser": (laser, *config.laser[1:])})


def _metrics(errors: dict[str, np.ndarray], sigma: np.ndarray, labels: dict[str, str]) -> list[Metric]:
    out = []
    for name, found in errors.items():
        for side, title in enumerate(SIDES):
            size = rms(found[:, side])
            # Another set of draws has another root mean square: three standard errors of it.
            tolerance = 3 * size / np.sqrt(2 * len(found))
            alone = "" if name in _TOGETHER else " alone"
            label = f"room's {title}, {labels[name]}{alone}: rms error"
            out.append(Metric(f"{name}_{title}", size, "mm", "less", tolerance, label=label))
    for side, title in enumerate(SIDES):
        predicted, ratio = rms(sigma[:, side]), rms(errors["modelled"][:, side] / sigma[:, side])
        label = f"room's {title}, {_TOGETHER['modelled']}: predicted standard deviation"
        out.append(Metric(f"predicted_{title}", predicted, "mm", "near", 0.1 * predicted, label=label))
        tolerance = 3 * ratio / np.sqrt(2 * len(sigma))
        label = f"room's {title}, {_TOGETHER['modelled']}: rms of error over predicted standard deviation"
        out.append(Metric(f"ratio_{title}", ratio, "1", "near", tolerance, label=label))
    return out


def _row_metrics(speckle: float, own: float) -> list[Metric]:
    words = "rms error of a row's stripe centre"
    with_speckle = f"{words} by speckle alone, rendered, rig of the unkind world"
    return [
        Metric("speckle_row", speckle, "px", "none", label=with_speckle),
        Metric("rendered_row", own, "px", "near", 0.01, label=f"{words} without speckle, rendered"),
    ]
