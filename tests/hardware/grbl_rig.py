"""A simulated GRBL board with a table, and a camera that sees its laser, for tests of sessions."""

import os

import numpy as np
from bench.grbl import GrblBoard
from scanrig.cameras.simulated import FrameShape, SimulatedCamera, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers import open_controller


WIDTH, HEIGHT = 128, 96
STEPS_PER_TURN = 28800
SCENE = SyntheticScene(turn_px=12000.0)


def rig_config(*, steps=10, grbl=None, **controller):
    """A table of 80 microsteps a degree, and a free-running camera."""
    return RigConfig.model_validate(
        {
            "controller": {
                "type": "grbl",
                "allow_laser_without_watchdog": True,
                "reconnects": 2,
                "grbl": grbl or {},
                **controller,
            },
            "turntable": {"gear": [9, 1], "settle_ms": 5, "speed_deg_s": 100.0},
            "laser": {"on_ms": 5, "off_ms": 5},
            "camera": {"kind": "simulated", "width": WIDTH, "height": HEIGHT, "trigger": "free", "exposure_ms": 1.0},
            "sweep": {"steps": steps, "turn_deg": float(steps)},
        }
    )


def camera_of(board: GrblBoard, config: RigConfig) -> SimulatedCamera:
    """A camera that sees where the table of a board truly stands, and whether its laser truly shines."""
    generator = np.random.default_rng(os.getpid())

    def see(position, lit):
        return draw(SCENE, position, lit, FrameShape(WIDTH, HEIGHT), generator)

    # From the place where the table stands after homing, the pull-off above the switch.
    def world():
        return STEPS_PER_TURN / 360 * (board.position - board.settings[27]), board.lit

    return SimulatedCamera(config.camera, see, world=world)


def open_board(board: GrblBoard, config: RigConfig):
    return open_controller(config.controller, config.microsteps_per_turn, port=board.port)
