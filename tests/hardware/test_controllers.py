"""The controllers that there are, held to the contract of all: the real firmware on the bench, GRBL simulated."""

import contextlib
import time

import pytest
from bench.grbl import GrblBoard
from scanrig.controllers.jxs import connect
from scanrig.errors import Fault, RigError

from .controller_contract import ControllerContract
from .grbl_rig import open_board, rig_config


class GrblPlant:
    def __init__(self, folder):
        self.board = GrblBoard(folder)
        self.board.start()
        self.controller = open_board(self.board, rig_config())
        self.unplug, self.plug = self.board.unplug, self.board.plug

    def position(self):
        return 80 * self.board.position

    def lit(self):
        return self.board.lit

    def reset(self):
        self.board.power_cycle()
        time.sleep(0.05)

    def fault(self):
        self.board.hit_limit()
        return Fault.LIMIT

    def release(self):
        pass

    def wait(self, seconds):
        time.sleep(seconds)

    def close(self):
        with contextlib.suppress(RigError):
            self.controller.close()
        self.board.close()


class TestGrbl(ControllerContract):
    @pytest.fixture
    def plant(self, tmp_path):
        plant = GrblPlant(tmp_path)
        yield plant
        plant.close()


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
