"""Colours of the room's points.

The rig's camera is grey: pairs of frames in colour would take three times as long. A camera with the same pixels in
colour takes laser-off frames every few degrees. Each point takes its colour from the nearest of them: between both
records the camera moves by 1 cm at most. Colours serve pictures only.
"""

import numpy as np

import jaxscan
from experiments.paper.products.room import Room
from experiments.paper.stage import Stage
from experiments.paper.worlds import windowed, windowed_scanner
from jaxscan.simulation import expect_record, make_rig, make_scene, take_frame


STEP_DEG, QUICK_DEG = 5.0, 15.0
"""Between frames in colour."""
_STREAM = 92


def room_colours(stage: Stage, seen: Room, xyz: np.ndarray, scanner: jaxscan.Scanner) -> np.ndarray:
    """Colours of the points of a sweep; made once and kept.

    Args:
        stage: The world.
        seen: The sweep.
        xyz: Its points by `scanner` [records, rows, 3], m, scanner frame; zero where there is none.
        scanner: A calibration.

    Returns:
        uint8 [records, rows, 3]; zero where there is no point.
    """
    path = stage.product("room_colours.npy")
    if not path.exists():
        partial = path.with_suffix(".part.npy")
        np.save(partial, _look(stage, seen, xyz, scanner))
        partial.rename(path)
    return np.load(path)


def _look(stage: Stage, seen: Room, xyz: np.ndarray, scanner: jaxscan.Scanner) -> np.ndarray:
    step = np.deg2rad(QUICK_DEG if stage.quick else STEP_DEG)
    sensor = stage.config.sensor.model_copy(update={"pixel_format": "rgb8"})
    # The stripe's own columns, and those in which its points are seen until the next frame.
    wider = int(0.65 * step * stage.config.camera.fx)
    first, stop = max(seen.window[0] - wider, 0), min(seen.window[1] + wider, stage.config.camera.width)
    config = windowed(stage.config.model_copy(update={"sensor": sensor}), first, stop)
    rig, scene, part = make_rig(config), make_scene(config), windowed_scanner(scanner, first, stop)
    nearest = np.rint(seen.angles / step).astype(int)
    rgb = np.zeros(xyz.shape, np.uint8)
    for view in np.unique(nearest):
        frame = take_frame(expect_record(rig, scene, view * step).off, config, stage.generator(_STREAM, int(view)))
        mine = np.flatnonzero(nearest == view)
        points = xyz[mine]
        there = points.any(-1)
        u, v = _pixels(part, points[there], view * step).T
        rows, columns = frame.shape[:2]
        row, column = np.clip(np.rint(v), 0, rows - 1).astype(int), np.clip(np.rint(u), 0, columns - 1).astype(int)
        colours = np.zeros(points.shape, np.uint8)
        colours[there] = frame[row, column]
        rgb[mine] = colours
    return rgb


def _pixels(scanner: jaxscan.Scanner, points: np.ndarray, phi: float) -> np.ndarray:
    """Where a camera at the table's angle `phi` [rad] sees points [n, 3]; [n, 2] px."""
    return np.asarray(jaxscan.pixels(scanner.rig, points, phi))
