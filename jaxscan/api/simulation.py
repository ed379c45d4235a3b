"""Simulated captures, written to disk with their true values."""

from pathlib import Path

from jaxscan.files import load_toml
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
