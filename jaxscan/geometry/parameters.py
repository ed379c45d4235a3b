"""Description of the parameters of a part of the rig."""

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
    """Typical error of a first value; the unit of the solver's steps."""
    unit: str = ""
    prior: str = ""
    """Name of the prior in the settings; empty where there is none."""
    sigma: float = math.inf
    """Standard deviation of each parameter before any image: weak, and reported."""
    expected: float = 0.0
    """Value of each parameter before any image."""
    optional: bool = False
    """Whether the parameters may be absent; the solver holds them at 0 unless freed."""
