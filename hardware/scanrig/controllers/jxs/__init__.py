"""The scanner's own firmware: JXS/1, as PROTOCOL.md defines it."""

from scanrig.controllers.jxs.controller import JxsController, connect
