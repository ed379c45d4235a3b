"""Which controller, and what it is told: the `[controller]` table of a rig's configuration."""

from typing import Annotated, Literal

import pydantic

from jaxscan.files.disk import FileModel, Integer, Number


_Command = Annotated[str, pydantic.Field(max_length=70, pattern=r"^[\x20-\x7e]*$")]
_REALTIME = set("?!~")
"""Characters that GRBL takes out of a line and obeys at once."""


class GrblTable(FileModel):
    """What a board is told that speaks GRBL's G-code or a dialect of it."""

    greeting: Annotated[str, pydantic.Field(min_length=1, max_length=40)] = "Grbl"
    """How the line begins that it says after a reset."""
    axis: Literal["X", "Y", "Z", "A", "B", "C"] = "X"
    """The axis that turns the table."""
    units_per_turn: Annotated[Number, pydantic.Field(gt=0, le=1e6)] = 360.0
    """What the axis counts in a turn of the table, in what the board calls millimetres: 360 for degrees."""
    laser_on: Annotated[tuple[_Command, ...], pydantic.Field(min_length=1, max_length=8)] = ("M3 S1000",)
    """Switches a laser on, a command for each laser."""
    laser_off: Annotated[_Command, pydantic.Field(min_length=1)] = "M5"
    """Switches all lasers off."""
    home: _Command = "$H"
    """Looks for the home switch; "" where there is none: home is where the table stands when a scan begins."""
    enable: _Command = ""
    """Switches the motor on; "" where it always is."""
    disable: _Command = ""
    """Switches the motor off."""
    check_settings: bool = True
    """Whether the board's own settings ($$) are read and compared with the configuration."""

    @pydantic.field_validator("laser_on", mode="before")
    @classmethod
    def _listed(cls, commands: object) -> object:
        return (commands,) if isinstance(commands, str) else tuple(commands) if isinstance(commands, list) else commands

    @pydantic.model_validator(mode="after")
    def _lines(self) -> "GrblTable":
        for command in (*self.laser_on, self.laser_off, self.home, self.enable, self.disable):
            if _REALTIME & set(command):
                raise ValueError(
                    f'found the command "{command}", expected none of ? ! ~ in it: GRBL obeys them at once'
                )
        if not all(command.strip() for command in self.laser_on):
            raise ValueError('laser_on: found an empty command, expected one that switches a laser on, as "M3 S1000"')
        return self


class ControllerTable(FileModel):
    """The controller and the wire to it."""

    type: Literal["jaxscan", "grbl"] = "jaxscan"
    """"jaxscan": the firmware of hardware/firmware. "grbl": a board that speaks GRBL's G-code."""
    port: Annotated[str, pydantic.Field(min_length=1, max_length=1024)] = "auto"
    """Serial port; "auto": the only one that looks like a controller."""
    baud: Annotated[Integer, pydantic.Field(ge=1200, le=4_000_000)] | None = None
    """Bits per second; by default what its type is built with: 250000, for GRBL 115200."""
    watchdog_ms: Annotated[Integer, pydantic.Field(ge=100, le=60_000)] = 500
    """Time without a good line from the host after which laser and motor are switched off; GRBL has nothing of the
    kind."""
    reconnects: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 10
    """Times that a lost controller is looked for, with growing pauses, before the scan ends."""
    allow_laser_without_watchdog: bool = False
    """Scan with a controller that leaves the laser on when the host dies or the cable is pulled."""
    grbl: GrblTable = GrblTable()
    """For `type = "grbl"`."""
