"""Configuration of the surroundings of a simulated rig: a room, or an object on the table, and its light."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from jaxscan.simulation.settings.numbers import Angle, Distance, Level, Place, Point, Section, Share


class MirrorSpec(Section):
    """A clean mirror on a wall: it has no light of its own, and shows the room and the stripe again."""

    wall: Literal["x0", "x1", "y0", "y1"] = "x1"
    along_m: Place = 1.0
    """Its middle along the wall, from the room's corner."""
    height_m: Place = 1.4
    """Height of its middle above the floor."""
    size_m: tuple[Distance, Distance] = (0.6, 0.8)
    """Width and height."""
    reflects: Share = 0.9


class RoomSpec(Section):
    """A box room with furniture along its walls."""

    size_m: tuple[Distance, Distance, Distance] = (4.2, 5.4, 2.5)
    rig_m: Point = (2.0, 2.6, 1.2)
    """The scanner's origin in the room: from the walls x = 0 and y = 0, and above the floor."""
    yaw_deg: Angle = 20.0
    """Direction of the scanner's x axis in the room, from the room's x towards its y."""
    furniture: bool = True
    mirror: MirrorSpec | None = None

    @model_validator(mode="after")
    def _rig_inside(self) -> "RoomSpec":
        if not all(0 < at < size for at, size in zip(self.rig_m, self.size_m, strict=True)):
            raise ValueError(f"`rig_m` {self.rig_m} must lie inside the room of {self.size_m} m")
        return self


class ObjectSpec(Section):
    """A small object on the turntable's plate, for a table that carries the object."""

    height_m: Distance = 0.12
    base_z_m: Place = -0.06
    """Height of the plate above the scanner's origin."""
    plate_radius_m: Distance = 0.11


class LightSpec(Section):
    """The room's own light."""

    white_dn: Level = 120.0
    """Level of a white surface (albedo 1) in the room's mean light, on every channel."""
    shadows: bool = True
    bounce: Annotated[float, Field(ge=0, le=10)] = 0.0
    """Strength of the laser's light that comes back from lit surfaces: 1 as in nature, 0 for none."""
    flicker: Share = 0.0
    """Standard deviation of the room's light from frame to frame, relative."""
