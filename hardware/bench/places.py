"""Where the bench's files are."""

import os
import tempfile
from pathlib import Path


HERE = Path(__file__).resolve().parent
WORLD = HERE / "world.toml"
"""What there is to see."""


def runtime() -> Path:
    """The folder of the one running `make bench`: fixed, so that a configuration can name the port in it."""
    return Path(os.environ.get("JAXSCAN_BENCH") or Path(tempfile.gettempdir()) / "jaxscan-bench")
