"""Controllers turn the table, switch the lasers and may trigger the camera. All have one interface.

`jxs/` is for the scanner's own firmware (PROTOCOL.md), `grbl/` for boards that speak GRBL's G-code.
"""

from scanrig.controllers.controller import (
    UNCONFIRMED,
    Controller,
    ControllerTable,
    Counters,
    Firmware,
    GrblTable,
    Guarantees,
    LinkCounts,
    Reconnection,
    Settings,
    ShotDone,
    Status,
)
from scanrig.controllers.opening import open_controller, require_allowed, shortcomings
