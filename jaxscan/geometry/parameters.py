"""How a part of the rig describes its parameters."""

import math
from typing import NamedTuple


class ParameterBlock(NamedTuple):
    """Parameters of one scale, one unit and one prior.

    Blocks of one name are freed and held together.
    """

    name: str
    parameters: tuple[str, ...]
    """Names of the minimal coordinates."""
    scale: float
    """About as far as a first value is off; the unit of the solver's steps."""
    unit: str = ""
    prior: str = ""
    """Name by which settings change or switch off the prior; empty where there is none."""
    sigma: float = math.inf
    """Standard deviation of each parameter before any image: weak, and reported."""
    expected: float = 0.0
    """Value of each parameter before any image."""
    optional: bool = False
    """Whether the parameters may be absent; the solver knows them and holds them at 0 unless freed."""
