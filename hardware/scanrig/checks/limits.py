"""The configurable limits for the proof of a pair."""

from typing import Annotated

import pydantic

from jaxscan.files.disk import FileModel, Number


Share = Annotated[Number, pydantic.Field(ge=0, le=1)]


class ProofLimits(FileModel):
    """Limits for the proof of a pair."""

    lit_lines: Share = 0.02
    """Least part of the frame's lines that must show the laser."""
    peak_dn: Annotated[Number, pydantic.Field(ge=0, le=255)] = 0.0
    """Least height of the stripe [DN]."""
    leak: Share = 0.1
    """Largest part of the stripe's light in the laser-off frames, over several places (`leaks`)."""
    unrest: Annotated[Number, pydantic.Field(gt=0)] = 4.0
    """Largest difference beside the laser, in standard deviations of the noise, at most 6."""
    saturated: Share = 1.0
    """Largest part of the lit lines that may be clipped."""
    flooded: Share = 0.25
    """Largest part of either frame that may be clipped."""
