"""What a pair of frames has to keep to, as a configuration says it."""

from typing import Annotated

import pydantic

from jaxscan.files.disk import FileModel, Number


Share = Annotated[Number, pydantic.Field(ge=0, le=1)]


class ProofLimits(FileModel):
    """What a pair has to keep to."""

    lit_lines: Share = 0.02
    """Part of the image's lines that must show the laser at least."""
    peak_dn: Annotated[Number, pydantic.Field(ge=0, le=255)] = 0.0
    """Height that the line must have at least [DN]."""
    leak: Share = 0.1
    """Part of the line's light that the laser-off frames may have, over several places (`leaks`)."""
    unrest: Annotated[Number, pydantic.Field(gt=0)] = 4.0
    """What may differ beside the laser, in standard deviations of the noise; 6 is the most there is."""
    saturated: Share = 1.0
    """Part of the lit lines that may be clipped."""
    flooded: Share = 0.25
    """Part of either frame that may be clipped."""
