"""Where the bench's files are."""

import os
from pathlib import Path


HERE = Path(__file__).resolve().parent
WORLD = HERE / "world.toml"
"""What there is to see."""


def runtime() -> Path:
    """The folder of the one running `make bench`; fixed, because configs/bench.toml names the port in it."""
    return Path(os.environ.get("JAXSCAN_BENCH") or HERE / "build" / "desk")
