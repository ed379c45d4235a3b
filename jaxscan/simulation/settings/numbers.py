"""Ranges of the numbers in the configuration of a simulated rig: all finite, and all within the limits of rendering."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field


class Section(BaseModel):
    """A table of the configuration."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


Number = Annotated[float, Field(ge=-1e6, le=1e6)]
"""Components of vectors, pixels, coefficients of a lens."""
Place = Annotated[float, Field(ge=-1e3, le=1e3)]
"""A coordinate, m."""
Distance = Annotated[float, Field(ge=1e-3, le=1e4)]
"""Of something in front of the camera, m."""
Millimetres = Annotated[float, Field(ge=1e-3, le=1e4)]
WIDEST_BLUR_PX = 50.0
Pixels = Annotated[float, Field(ge=0.01, le=WIDEST_BLUR_PX)]
"""Width of a blur, px: the time and memory of rendering grow with it."""
Focal = Annotated[float, Field(ge=1.0, le=1e6)]
Level = Annotated[float, Field(gt=1e-6, le=1e6)]
"""Of light, DN."""
Fraction = Annotated[float, Field(ge=-1, le=1)]
Gain = Annotated[float, Field(ge=-1e3, le=1e3)]
Angle = Annotated[float, Field(ge=-36_000, le=36_000)]
"""Degrees."""
Share = Annotated[float, Field(ge=0, lt=1)]
Albedo = Annotated[float, Field(gt=0, le=1)]
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]+$")]
Size = Annotated[int, Field(ge=8, le=65535)]
"""Of an image along an axis, px."""
Pair = tuple[float, float]
Triple = tuple[Number, Number, Number]
Point = tuple[Place, Place, Place]
