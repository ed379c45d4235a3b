"""Simulated captures, written to disk with their true values; and a rig on paper as a simulated rig."""

import math
from pathlib import Path
from typing import Any

import tomli_w

from jaxscan.design import BLUR_PX, RigDesign
from jaxscan.errors import OutputError
from jaxscan.files import load_toml
from jaxscan.files.disk import write_atomically
from jaxscan.files.simulated import SimulatedCaptures, new_simulation, write_boards, write_sweep
from jaxscan.observation import Progress
from jaxscan.simulation import SimulationConfig, board_pairs, render_boards, render_sweep, sweep_angles


TEXTURE_PX = 60
"""Pixels per square of the picture from which boards are rendered."""


def simulate(
    config: SimulationConfig,
    folder: str | Path,
    *,
    every: int = 1,
    seed: int | None = None,
    progress: Progress | None = None,
) -> SimulatedCaptures:
    """Render captures of a simulated rig, and write them with their true values.

    The folder appears once everything in it is complete.

    Args:
        config: The rig, its surroundings, its boards and its plan.
        folder: Must not exist, or be empty.
        every: Only every n-th step of the sweep.
        seed: Seed of noise and board poses, instead of the configuration's.
        progress: Called with (pairs done, pairs in all).

    Returns:
        The paths of everything written, and the number of pairs.

    Raises:
        CaptureError: If the folder exists and is not empty, or cannot be written.
        DependencyError: If embreex is missing.
    """
    # Imported here, so that `import jaxscan` does not load OpenCV.
    from jaxscan.vision import board_texture

    pairs = board_pairs(config) + len(sweep_angles(config, every=every)) * len(config.laser)

    def after(before: int) -> Progress | None:
        return None if progress is None else lambda done, _: progress(before + done, pairs)

    with new_simulation(Path(folder)) as part:
        texture = board_texture(config.boards.board(), TEXTURE_PX)
        boards = write_boards(config, part, render_boards(config, texture, seed=seed), after(0))
        swept = render_sweep(config, every=every, seed=seed)
        sweep = write_sweep(config, part, swept, every=every, progress=after(boards))
    return SimulatedCaptures(Path(folder), boards, sweep)


def load_simulation(path: str | Path) -> SimulationConfig:
    """A simulated rig from a TOML file.

    Args:
        path: The file.

    Returns:
        The configuration, checked.

    Raises:
        ConfigError: With the key that is unknown, missing or wrong.
    """
    return load_toml(Path(path), SimulationConfig)


_STRIPE_PX = 1.5
"""Width of the stripe at the wanted range (standard deviation), in the middle of what is found well."""
_ROOM_HEIGHT_M, _BOARD_M = 2.5, 3.0
"""Height of the room, and the range from which on the board has squares of 60 mm; less for smaller ones."""


def save_designed_rig(design: RigDesign, path: str | Path, *, step_deg: float = 0.2) -> None:
    """Write a rig on paper as a configuration for `jaxscan simulate`, in a square room with walls at its range.

    Args:
        design: The rig; its sheet crosses the optical axis at the wanted range.
        path: The TOML file to write.
        step_deg: Step of the sweep [deg].

    Raises:
        OutputError: If it cannot be written.
    """
    tables = _tables(design, step_deg)
    # It is read before it is written: what the simulator would refuse is a defect of ours.
    SimulationConfig.model_validate(tables)
    across, along = design.fields_deg
    head = (
        f"# A rig of `jaxscan design`: {design.lens_mm:g} mm lens, {across:.1f} x {along:.1f} degrees, in a square\n"
        f"# room with walls {design.crossing_m:g} m away.\n"
        "# Lengths in metres, angles in radians, pixels, unless a key says otherwise.\n"
    )
    write_atomically(Path(path), (head + tomli_w.dumps(tables)).encode(), error=OutputError)


def _tables(design: RigDesign, step_deg: float) -> dict[str, Any]:
    far, focal = design.crossing_m, design.focal_px
    height = min(_ROOM_HEIGHT_M, far)
    square = round(60.0 * min(1.0, far / _BOARD_M), 2)
    near, _ = design.view_m
    return {
        "seed": 1,
        "camera": {
            "width": design.sensor.width,
            "height": design.sensor.height,
            "fx": round(focal, 2),
            "fy": round(focal, 2),
        },
        "sensor": {"pixel_format": "mono8", "psf_px": BLUR_PX, "pixel_um": round(1e6 * design.sensor.pixel_m, 4)},
        "laser": {
            "baseline_m": design.baseline_m,
            "crossing_m": far,
            "fan_deg": design.fan_deg,
            "waist_mm": max(round(1e3 * math.sqrt(_STRIPE_PX**2 - BLUR_PX**2) * far / focal, 4), 1e-3),
            "focus_m": far,
            "range_m": far,
        },
        "turntable": {
            "carries": "scanner",
            "direction": [0.0, -1.0, 0.0],
            "point_m": [round(0.5 * design.baseline_m, 4), 0.0, -0.05],
        },
        "room": {
            "size_m": [2 * far, 2 * far, height],
            "rig_m": [far, far, 0.5 * height],
            "furniture": far >= 1.5,
        },
        "boards": {
            "type": "chessboard",
            "columns": 10,
            "rows": 7,
            "square_mm": square,
            "free_views": 30,
            "placements": 4,
            "angles": 5,
            "range_m": [round(max(0.35 * far, 1.2 * near), 3), round(max(0.75 * far, 1.5 * near), 3)],
        },
        "plan": {"steps": max(1, round(360.0 / step_deg))},
    }
