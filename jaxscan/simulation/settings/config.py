"""Configuration of a simulated rig, as frozen models that refuse unknown keys.

Metres, radians and pixels unless the key says otherwise.
"""

from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from jaxscan.simulation.settings.boards import BoardsSpec
from jaxscan.simulation.settings.camera import CameraSpec, SensorSpec
from jaxscan.simulation.settings.laser import LaserSpec
from jaxscan.simulation.settings.numbers import Section
from jaxscan.simulation.settings.surroundings import LightSpec, ObjectSpec, RoomSpec
from jaxscan.simulation.settings.table import PlanSpec, TurntableSpec


_LARGEST_GRAIN_PX = 16
"""The memory of drawing grows with the square of the grain."""


class SimulationConfig(Section):
    """A rig, its surroundings and its plan; everything is drawn from `seed`."""

    camera: CameraSpec = CameraSpec()
    sensor: SensorSpec = SensorSpec()
    laser: tuple[LaserSpec, ...] = (LaserSpec(baseline_m=0.4, crossing_m=3.0),)
    turntable: TurntableSpec = TurntableSpec(direction=(0.0, -1.0, 0.0), point_m=(0.1, 0.0, -0.1))
    room: RoomSpec | None = None
    object: ObjectSpec | None = None
    light: LightSpec = LightSpec()
    boards: BoardsSpec = BoardsSpec()
    plan: PlanSpec = PlanSpec()
    seed: Annotated[int, Field(ge=0, lt=1 << 63)] = 0

    @field_validator("laser", mode="before")
    @classmethod
    def _single_laser(cls, value: Any) -> Any:
        return value if isinstance(value, list | tuple) else [value]

    @model_validator(mode="after")
    def _consistent(self) -> "SimulationConfig":
        if (self.room is None) == (self.object is None):
            raise ValueError("a simulation needs either [room] or [object]")
        if not self.laser:
            raise ValueError("a simulation needs at least one [[laser]]")
        if len({laser.name for laser in self.laser}) != len(self.laser):
            raise ValueError("the lasers' names must differ")
        for laser in self.laser:
            if laser.speckle_contrast > 0 and (grain := laser.grain_px(self.sensor)) > _LARGEST_GRAIN_PX:
                raise ValueError(
                    f"speckle of laser {laser.name!r} has grains of {grain:.0f} px, at most {_LARGEST_GRAIN_PX} can be "
                    "drawn: lower f_number or wavelength_nm, or raise pixel_um"
                )
        return self
