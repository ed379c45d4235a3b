"""The `[controller]` table of a rig's configuration: which controller, and its commands."""

from typing import Annotated, Literal

import pydantic

from jaxscan.files.disk import FileModel, Integer, Number


_Command = Annotated[str, pydantic.Field(max_length=70, pattern=r"^[\x20-\x7e]*$")]
_REALTIME = set("?!~")
"""Characters that GRBL removes from a line and obeys at once."""


class GrblTable(FileModel):
    """Commands and units of a board that speaks GRBL's G-code or a dialect of it."""

    greeting: Annotated[str, pydantic.Field(min_length=1, max_length=40)] = "Grbl"
    """Beginning of the line that the board sends after a reset."""
    axis: Literal["X", "Y", "Z", "A", "B", "C"] = "X"
    """The axis that turns the table."""
    units_per_turn: Annotated[Number, pydantic.Field(gt=0, le=1e6)] = 360.0
    """Length of one turn of the table in the board's "millimetres": 360 for degrees."""
    laser_on: Annotated[tuple[_Command, ...], pydantic.Field(min_length=1, max_length=8)] = ("M3 S1000",)
    """Commands that switch a laser on, one for each laser."""
    laser_off: Annotated[_Command, pydantic.Field(min_length=1)] = "M5"
    """Command that switches all lasers off."""
    home: _Command = "$H"
    """Command for homing; "" without a home switch: home is then the table's position when a scan begins."""
    enable: _Command = ""
    """Command that switches the motor on; "" if it is always on."""
    disable: _Command = ""
    """Command that switches the motor off."""
    check_settings: bool = True
    """Whether to read the board's own settings ($$) and compare them with the configuration."""

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
    """The controller and its port."""

    type: Literal["jaxscan", "grbl"] = "jaxscan"
    """"jaxscan": the firmware of hardware/firmware. "grbl": a board that speaks GRBL's G-code."""
    port: Annotated[str, pydantic.Field(min_length=1, max_length=1024)] = "auto"
    """Serial port; "auto": the only port that looks like a controller."""
    baud: Annotated[Integer, pydantic.Field(ge=1200, le=4_000_000)] | None = None
    """Bits per second; by default that of its type: 250000, for GRBL 115200."""
    watchdog_ms: Annotated[Integer, pydantic.Field(ge=100, le=60_000)] = 500
    """Time without a valid line from the host after which laser and motor are switched off; GRBL has no watchdog."""
    reconnects: Annotated[Integer, pydantic.Field(ge=0, le=1000)] = 10
    """Attempts to find a lost controller again, with growing pauses, before the scan ends."""
    allow_laser_without_watchdog: bool = False
    """Scan with a controller that leaves the laser on when the host dies or the cable is pulled."""
    grbl: GrblTable = GrblTable()
    """For `type = "grbl"`."""
