"""The table of contents: every experiment and its module, and the files of its figures."""

from pathlib import Path


EXPERIMENTS = {
    "table_1": "tables.table_1",
    "table_2": "tables.table_2",
    "figure_5": "figures.figure_5",
    "figure_6": "figures.figure_6",
    "figure_7": "figures.figure_7",
    "figure_8": "figures.figure_8",
    "figure_9": "figures.figure_9",
    "fisheye": "beyond.fisheye",
    "sensitivity": "beyond.sensitivity",
    "acceptance": "beyond.acceptance",
    "peers": "beyond.peers",
}
"""Each is a module with `run(stage) -> list[Metric]`."""


def part_of(world: str, quick: bool) -> str:
    """Name of a world's part of the baseline."""
    return f"quick {world}" if quick else world


def results_path(out: Path, world: str, quick: bool) -> Path:
    """File of the figures of a world."""
    return out / f"{part_of(world, quick).replace(' ', '_')}.json"
