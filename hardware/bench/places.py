"""Paths of the bench's files."""

import os
from pathlib import Path


HERE = Path(__file__).resolve().parent
WORLD = HERE / "camera" / "world.toml"
"""The world in front of the camera."""
TWO_LASERS = HERE / "camera" / "world_two_lasers.toml"
"""The same with a second laser."""


def runtime() -> Path:
    """The folder of the one running `make bench`; fixed, because configs/bench.toml names the port in it."""
    return Path(os.environ.get("JAXSCAN_BENCH") or HERE / "build" / "desk")
