"""Controllers: what turns the table, switches the laser and may trigger the camera, behind one interface.

`jxs/` is the scanner's own firmware (PROTOCOL.md), `grbl/` any board that speaks GRBL's G-code.
"""

from scanrig.controllers.controller import UNCONFIRMED as UNCONFIRMED
from scanrig.controllers.controller import Controller as Controller
from scanrig.controllers.controller import Guarantees as Guarantees
from scanrig.controllers.opening import open_controller as open_controller
from scanrig.controllers.opening import require_allowed as require_allowed
from scanrig.controllers.opening import shortcomings as shortcomings
from scanrig.controllers.settings import Settings as Settings
from scanrig.controllers.status import Counters as Counters
from scanrig.controllers.status import Firmware as Firmware
from scanrig.controllers.status import LinkCounts as LinkCounts
from scanrig.controllers.status import Reconnection as Reconnection
from scanrig.controllers.status import ShotDone as ShotDone
from scanrig.controllers.status import Status as Status
from scanrig.controllers.table import ControllerTable as ControllerTable
from scanrig.controllers.table import GrblTable as GrblTable
