"""The controllers that there are, held to the contract of all: the real firmware on the bench, GRBL simulated."""

import contextlib

import pytest
from scanrig.controllers.jxs import connect
from scanrig.errors import Fault, RigError

from .controller_contract import ControllerContract
from .grbl_rig import GrblBoard, open_board, rig_config


class GrblPlant:
    def __init__(self):
        self.board = GrblBoard()
        self.controller = open_board(self.board, rig_config())
        self.reset, self.unplug, self.plug = self.board.power_cycle, self.board.unplug, self.board.plug
        self.wait = self.board.clock.sleep

    def position(self):
        return 80 * self.board.position

    def lit(self):
        return self.board.lit

    def fault(self):
        self.board.hit_limit()
        return Fault.LIMIT

    def release(self):
        pass


class TestGrbl(ControllerContract):
    @pytest.fixture
    def plant(self):
        return GrblPlant()


class FirmwarePlant:
    def __init__(self, rig):
        self.rig = rig(speed=1.0)
        self.controller = connect(self.rig.port)
        self.unplug, self.plug = self.rig.unplug, self.rig.plug

    def position(self):
        return self.rig.plant()["pos"]

    def lit(self):
        return bool(self.rig.plant()["light"])

    def reset(self):
        self.rig.control("reset")

    def fault(self):
        self.rig.control("estop 1")
        self.rig.run_for(0.1)
        return Fault.EMERGENCY_STOP

    def release(self):
        self.rig.control("estop 0")
        self.rig.run_for(0.1)

    def wait(self, seconds):
        self.rig.run_for(seconds)


class TestFirmware(ControllerContract):
    @pytest.fixture
    def plant(self, rig):
        plant = FirmwarePlant(rig)
        yield plant
        with contextlib.suppress(RigError):
            plant.controller.close()
