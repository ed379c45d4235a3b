"""The project of two sweeps, and the command line."""

from tests.cli.conftest import run  # noqa: F401
from tests.museum import museum  # noqa: F401
