"""`jaxscan simulate`: a known rig in a known room, rendered as captures."""

from pathlib import Path
from typing import Annotated

import tyro

from jaxscan import api
from jaxscan.cli.options import OutputPath
from jaxscan.cli.output import JsonTarget, console, emit_json
from jaxscan.cli.progress import progress_bar


def simulate(
    config: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CONFIG")],
    /,
    *,
    output: OutputPath,
    every: int = 1,
    seed: int | None = None,
    json: JsonTarget = None,
) -> None:
    """Render a simulated rig: `jaxscan simulate configs/paper.toml -o captures/paper --every 10`.

    Writes the captures `boards` and `sweep`, and beside them `truth.json` and the true cloud
    `truth.npz`, which nothing but a comparison reads.

    Args:
        config: The rig, its room and its boards (see configs/).
        output: Folder to make.
        every: Render every n-th step of the sweep only.
        seed: Seed of noise and board poses, instead of the one in the configuration.
        json: Write the result as JSON too.
    """
    settings = api.load_simulation(config)
    with progress_bar("Rendering") as progress:
        made = api.simulate(settings, output, every=every, seed=seed, progress=progress)
    out = console(json)
    out.print(f"{made.board_pairs} board pairs and {made.sweep_pairs} sweep pairs in {made.seconds:.0f} s: {output}")
    emit_json(
        json,
        "simulate",
        {
            "boards": str(made.boards) if made.boards else None,
            "sweep": str(made.sweep),
            "truth": str(made.truth),
            "board_pairs": made.board_pairs,
            "sweep_pairs": made.sweep_pairs,
            "seconds_s": made.seconds,
        },
    )
