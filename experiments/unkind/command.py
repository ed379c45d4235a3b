"""The command line of both kinds of worlds: SEED FOLDER."""

import argparse
import time
from collections.abc import Callable
from pathlib import Path


def render_seed(render: Callable[[int, Path], None], description: str | None) -> None:
    """Write the world of a seed, and say how long it took."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("seed", type=int)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    start = time.perf_counter()
    render(options.seed, options.folder)
    print(f"seed {options.seed}: {time.perf_counter() - start:.0f} s")
