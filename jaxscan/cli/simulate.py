"""`jaxscan simulate`: renders captures of a known rig in a known room."""

import time

# Loads a name when it is first used, so that `--help` does not load JAX.
import jaxscan
from jaxscan.cli.options import ConfigPath, OutputPath, at_least
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.cli.paths import check_paths, file_at
from jaxscan.cli.progress import progress_bar


def simulate(
    config: ConfigPath,
    /,
    *,
    output: OutputPath,
    every: int = 1,
    seed: int | None = None,
    json: JsonTarget = None,
) -> None:
    """Render a simulated rig: `jaxscan simulate paper.toml -o captures/paper --every 10`.

    Writes the captures `boards` and `sweep`, the true values `truth.json` and the true cloud `truth.npz`. Only
    comparisons read the truth.

    Args:
        config: Configuration of the rig, its room and its boards (`jaxscan init paper.toml` writes one).
        output: Folder to create.
        every: Render every n-th step of the sweep only.
        seed: Seed of the noise and of the board poses, instead of the seed in the configuration.
        json: Write the result as JSON too.
    """
    at_least(1, "--every", every)
    at_least(0, "--seed", seed)
    check_paths(file_at("CONFIG", config), [*file_at("--output", output), *file_at("--json", json)])
    check_json(json)
    settings = jaxscan.load_simulation(config)
    start = time.perf_counter()
    with progress_bar("Rendering") as progress:
        made = jaxscan.simulate(settings, output, every=every, seed=seed, progress=progress)
    seconds = time.perf_counter() - start
    console(json).print(
        f"{made.board_pairs} board pairs and {made.sweep_pairs} sweep pairs in {seconds:.0f} s: {output}"
    )
    emit_json(
        json,
        "simulate",
        {
            "boards": str(made.boards) if made.board_pairs else None,
            "sweep": str(made.sweep),
            "truth": str(made.truth),
            "true_cloud": str(made.true_cloud),
            "board_pairs": made.board_pairs,
            "sweep_pairs": made.sweep_pairs,
            "seconds_s": seconds,
        },
    )
