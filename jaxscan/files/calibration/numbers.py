"""Numbers, vectors and frames of a calibration file, and their limits."""

from typing import Annotated, Any

import numpy as np
import pydantic

from jaxscan.files.disk import Number


UNIT_TOLERANCE = 1e-6
"""Accepted departure of a vector from unit length and from perpendicular: digits are lost when written by hand."""

# Beyond these limits squares and quotients are not finite, in single precision at the latest.
Limited = Annotated[Number, pydantic.Field(ge=-1e6, le=1e6)]
"""Pixels, metres, coefficients, and components of vectors."""
Focal = Annotated[Number, pydantic.Field(ge=0.1, le=1e6)]
"""Focal length, px."""
Bend = Annotated[Number, pydantic.Field(ge=-10, le=10)]
"""Bows and harmonics, rad."""
Covariance = Annotated[Number, pydantic.Field(ge=-1e12, le=1e12)]
Pair = tuple[Bend, Bend]
Triple = tuple[Limited, Limited, Limited]
Basis = tuple[Triple, Triple]


def arrays(*values: Any) -> tuple[np.ndarray, ...]:
    """Numbers as float64 arrays."""
    return tuple(np.array(value, np.float64) for value in values)


def check_frame(name: str, direction: Triple, basis: Basis) -> None:
    """Refuse a unit vector and a basis that are none.

    Raises:
        ValueError: With the value found.
    """
    length = float(np.linalg.norm(direction))
    if abs(length - 1) > UNIT_TOLERANCE:
        raise ValueError(f"{name}: found a vector of length {length:.9g}, expected 1")
    frame = np.array([direction, *basis], np.float64)
    if np.abs(frame @ frame.T - np.eye(3)).max() > UNIT_TOLERANCE:
        raise ValueError(f"basis: expected two unit vectors, perpendicular to each other and to {name}")
