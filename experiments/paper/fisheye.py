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

import numpy as np

import jaxscan
from experiments.paper.products import RenderedSweep, expect, our_plan, write_captures
from experiments.paper.stage import CONFIGS, Metric, Stage, smaller
from experiments.paper.table_1 import AGREE
from experiments.report import rms
from jaxscan.calibration import CalibrationSettings
from jaxscan.measurement import RoomBox
from jaxscan.simulation import SimulationConfig, make_scene


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


def run(stage: Stage) -> list[Metric]:
    """Dimensions of the room by one calibration and one turn."""
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
    return _metrics(config, box, full=not stage.quick)


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


def _metrics(config: SimulationConfig, box: RoomBox, *, full: bool) -> list[Metric]:
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
    return [*out, Metric("observed_over_predicted", ratio, "1", "less", 1.0, None, *limits, label)]
