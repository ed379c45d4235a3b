"""Controllers: what turns the table, switches the laser and may trigger the camera, behind one interface.

`jxs/` is the scanner's own firmware (PROTOCOL.md), `grbl/` any board that speaks GRBL's G-code.
"""

from scanrig.controllers.controller import UNCONFIRMED, Controller, Guarantees
from scanrig.controllers.opening import open_controller, require_allowed, shortcomings
from scanrig.controllers.settings import Settings
from scanrig.controllers.status import Counters, Firmware, LinkCounts, Reconnection, ShotDone, Status
from scanrig.controllers.table import ControllerTable, GrblTable
