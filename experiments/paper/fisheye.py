"""The paper's future work: the same room by a fisheye camera in one turn, floor and ceiling included.

The rig is that of configs/fisheye.toml, with a lens that sees 195 degrees and a laser whose fan has 175, in the room of
Figure 9. In the unkind world it has that world's sensor, light, table and print of the board, and its laser has that
world's speckle, bow, lobes and uneven light; a lens so short has next to no defocus. Images are smaller than the
configuration's 1600 x 1600, with pixels as much larger, and the turn has fewer steps than its 1800, so that an
experiment takes minutes: more of both would make points closer and their noise smaller, not the room larger.

The calibration is the rig's own, from boards; nothing of it is taken from the truth. The turn is seen in colour.
"""

import shutil
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

import jaxscan
from experiments.paper.products import RenderedSweep, expect, our_plan, write_captures
from experiments.paper.stage import CONFIGS, Metric, Stage, smaller
from experiments.paper.table_1 import AGREE
from experiments.report import rms
from jaxscan.calibration import CalibrationSettings
from jaxscan.simulation import SimulationConfig, make_scene
from jaxscan.simulation.scene import Scene


_SCALE, _RECORDS = 0.5, {"kind": 360, "unkind": 240}
_QUICK_SCALE, _QUICK_RECORDS = 0.25, 120
_BOARDS = {"type": "chessboard", "columns": 7, "rows": 5, "free_views": 24, "placements": 4, "angles": 6}
"""Markers would be too small in such images."""
_LASER = (
    "bow",
    "side_lobes",
    "lobes_at",
    "uneven_slow",
    "uneven_fine",
    "fine_deg",
    "widening",
    "wavelength_nm",
    "speckle_contrast",
)
"""Fields of a laser that its world sets; the rig sets the others."""
_PRINT = ("warp_mm", "ink", "paper", "uneven", "print_blur_mm", "gloss", "gloss_deg")
"""Fields of a board that its world sets."""
_NEAR_M = 0.05
"""A place is seen if a point of the cloud is nearer than this [m]; profiles are 4 cm apart at 2.5 m in the
kind world, and 7 cm in the unkind one."""
_PLACES = 20_000


class Shares(NamedTuple):
    """Shares of the surroundings that are seen [1]."""

    sphere: float
    """Of the directions."""
    surface: float
    """Of the surfaces that can be seen from the scanner's origin, by area."""


def run(stage: Stage) -> list[Metric]:
    """Dimensions of the room by one calibration and one turn, and the share of the room that is seen."""
    config = fisheye_config(stage)
    scanner = _calibration(stage, config)
    scene = make_scene(config)
    records = _QUICK_RECORDS if stage.quick else _RECORDS[stage.world]
    colour = config.model_copy(update={"sensor": config.sensor.model_copy(update={"pixel_format": "rgb8"})})
    sweep = RenderedSweep(colour, np.arange(records) * 2 * np.pi / records, seed=config.seed + 50, scene=scene)
    settings = jaxscan.ReconstructSettings(min_range_m=0.3, max_range_m=6.0)
    cloud = jaxscan.reconstruct(sweep, scanner, settings=settings)
    stage.say(f"fisheye: {records} records")
    box = jaxscan.measure_room(cloud, scanner=scanner)
    fisheye, pinhole = seen_by_fisheye(scene, cloud), seen_by_pinhole(scene, stage.config)
    return _metrics(config, box, fisheye, pinhole, full=not stage.quick)


def fisheye_config(stage: Stage) -> SimulationConfig:
    """The fisheye rig in the room of a world, with that world's faults of camera, laser, table and boards."""
    rig, world = jaxscan.load_simulation(CONFIGS / "fisheye.toml"), stage.config
    shorter = rig.camera.fx / world.camera.fx
    sensor = {"defocus_px_m": world.sensor.defocus_px_m * shorter**2}
    laser = {name: getattr(world.laser[0], name) for name in _LASER}
    boards = {name: getattr(world.boards, name) for name in _PRINT} | _BOARDS
    table = {name: getattr(world.turntable, name) for name in ("gain", "harmonics")}
    config = rig.model_copy(
        update={
            "sensor": world.sensor.model_copy(update=sensor),
            "laser": (rig.laser[0].model_copy(update=laser),),
            "turntable": rig.turntable.model_copy(update=table),
            "boards": rig.boards.model_copy(update=boards),
            "room": world.room,
            "light": world.light,
            "seed": world.seed,
        }
    )
    return smaller(config, _QUICK_SCALE if stage.quick else _SCALE)


def _calibration(stage: Stage, config: SimulationConfig) -> jaxscan.Scanner:
    """The calibration by boards of its own; made once, then loaded."""
    path = stage.product("fisheye/calibration.json")
    if not path.exists():
        own = replace(stage, config=config)
        plan = our_plan(own)
        folder = stage.emptied("fisheye/boards")
        (capture,) = write_captures(own, expect(own, plan), plan, {60: folder})
        stage.say(f"fisheye: rendered {len(plan.lit)} views of the board")
        settings = CalibrationSettings(camera="fisheye", judge=False)
        found = jaxscan.calibrate(capture, settings=settings, redetect=not stage.quick)
        jaxscan.save_calibration(found, path)
        shutil.rmtree(folder)
    return jaxscan.load_scanner(path)


def seen_by_fisheye(scene: Scene, cloud: jaxscan.PointCloud) -> Shares:
    """Shares of places all around that lie next to a point of the cloud."""
    tree = cKDTree(np.asarray(cloud.xyz)[np.asarray(cloud.valid)])
    return Shares(*(float(np.mean(tree.query(places)[0] < _NEAR_M)) for places in _places(scene)))


def seen_by_pinhole(scene: Scene, config: SimulationConfig) -> Shares:
    """Upper bounds: places within the vertical field of the paper's camera, whether the laser reaches them or not."""
    _, cy = config.camera.centre()
    low, high = -(config.camera.height - 1 - cy) / config.camera.fy, cy / config.camera.fy
    slopes = [places[:, 2] / np.linalg.norm(places[:, :2], axis=1) for places in _places(scene)]
    return Shares(*(float(np.mean((low < slope) & (slope < high))) for slope in slopes))


def _places(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Places that can be seen from the scanner's origin [n, 3], m: evenly over directions, and evenly over surfaces."""
    number = np.arange(_PLACES)
    height, turn = 1 - (2 * number + 1) / _PLACES, np.pi * (1 + np.sqrt(5)) * number
    ring = np.sqrt(1 - height**2)
    ways = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], -1)
    far, _ = scene.cast(np.zeros(3), ways)
    random = np.random.default_rng(0)
    triangles = np.concatenate(scene.mesh.triangles)
    a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    area = np.linalg.norm(np.cross(ab, ac), axis=1)
    chosen = random.choice(len(area), 3 * _PLACES, p=area / area.sum())
    s, t = random.uniform(size=(2, len(chosen), 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    over = a[chosen] + s * ab[chosen] + t * ac[chosen]
    hidden = scene.blocked(np.zeros(3), over.astype(np.float32), skin=2e-3)
    return (ways * far[:, None])[np.isfinite(far)], over[~hidden]


def _metrics(
    config: SimulationConfig, box: jaxscan.measurement.RoomBox, fisheye: Shares, pinhole: Shares, *, full: bool
) -> list[Metric]:
    assert config.room is not None
    width, length, height = config.room.size_m
    out, ratios = [], []
    for name, true in (("length", length), ("width", width), ("height", height)):
        side = getattr(box, name)
        error = np.nan if side is None else 1e3 * (side.value_m - true)
        sigma = np.nan if side is None else 1e3 * side.sigma_m
        ratios.append(error / sigma)
        label = f"fisheye, one turn: room's {name} ({1e3 * true:.0f} mm)"
        out.append(Metric(f"{name}_error", abs(error), "mm", "less", 2.0, label=f"{label}, absolute error"))
        out.append(Metric(f"{name}_sigma", sigma, "mm", "less", 0.3, label=f"{label}, predicted standard deviation"))
    ratio = rms(ratios)
    label = "fisheye, one turn: rms of error over predicted standard deviation, three dimensions"
    limits = AGREE if full else (None, None)
    out.append(Metric("observed_over_predicted", ratio, "1", "less", 1.0, None, *limits, label))
    for name, whole in (("sphere", "of all directions"), ("surface", "of all visible surfaces")):
        ours, theirs = 100 * getattr(fisheye, name), 100 * getattr(pinhole, name)
        out.append(
            Metric(
                f"seen_{name}", ours, "%", "more", 2.0, label=f"fisheye, one turn: share {whole} that the cloud covers"
            )
        )
        label = f"the paper's camera, one turn: share {whole} in its field of view, upper bound"
        out.append(Metric(f"pinhole_{name}", theirs, "%", label=label))
    return out
