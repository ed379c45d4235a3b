"""Time of a step while scanning, on the bench's clock: the real firmware in a simulated processor, full-size frames.

    python -m experiments.scan_steps [--steps 120] [--settle-ms 20] [--json FILE]

The simulated rig runs as fast as the clock, so the host's work costs what it costs. A camera of 60 frames a second
delivers each frame 1/60 s after its trigger. The time between the laser-on exposures of two steps is read from the log
of the firmware's pins, and compared with the time that motion, laser and camera need: what is left is the host.

Needs `make bench-deps`.
"""

import json
import resource
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from bench import CLOCK_HZ, RigOptions, SimulatedRig
from scanrig.cameras.simulated import FrameShape, SimulatedCamera, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers.jxs import connect
from scanrig.session import Devices, Hooks, run_sweep
from scanrig.session.plan import move_s, shot_s

from experiments.report import command_line, write_json


WIDTH, HEIGHT, FRAME_S = 1280, 1024, 1.0 / 60.0
_DRAWN = 8
"""Positions that are drawn, over and over again."""


def rig_config(steps: int, settle_ms: int) -> RigConfig:
    """A rig as in configs/scan.toml, with steps of 0.1 deg."""
    return RigConfig.model_validate(
        {
            "controller": {"watchdog_ms": 5000},
            "turntable": {"gear": [9, 1], "settle_ms": settle_ms},
            "camera": {"kind": "simulated", "width": WIDTH, "height": HEIGHT},
            "sweep": {"steps": steps, "turn_deg": steps / 10},
            # The frames come from the same processor.
            "checks": {"late_s": 5.0},
        }
    )


class Wire:
    """The camera on the trigger's pin: exposes at each edge in the rig's log, and delivers 1/60 s later."""

    def __init__(self, path: Path, camera: SimulatedCamera, pictures: list[tuple[np.ndarray, np.ndarray]]) -> None:
        self._file, self._camera, self._pictures = open(path), camera, pictures
        self._file.read()
        self._ended, self._lit, self._number = threading.Event(), 0, 0
        self._due: list[tuple[float, int, int]] = []
        threading.Thread(target=self._follow, daemon=True).start()

    def picture(self, position: float, lit: int) -> np.ndarray:
        """The picture at a position [microsteps]."""
        return self._pictures[int(position) // 8 % _DRAWN][0 if lit else 1].copy()

    def close(self) -> None:
        """Stop following the log."""
        self._ended.set()

    def _follow(self) -> None:
        rest = ""
        while not self._ended.wait(0.001):
            *lines, rest = (rest + self._file.read()).split("\n")
            for edge in map(json.loads, lines):
                if edge.get("pin") == "light":
                    self._lit = int(edge["v"])
                elif edge.get("pin") == "trig" and edge["v"]:
                    self._due.append((time.monotonic() + FRAME_S, edge["pos"], self._lit))
            while self._due and time.monotonic() >= self._due[0][0]:
                _, position, lit = self._due.pop(0)
                self._camera.expose(position, lit)


def measure(steps: int, settle_ms: int) -> dict[str, float]:
    """Scan so many steps; see the module."""
    config = rig_config(steps, settle_ms)
    shape, generator = FrameShape(WIDTH, HEIGHT), np.random.default_rng(0)
    pictures = [
        tuple(draw(SyntheticScene(turn_px=12000.0), 8.0 * k, lit, shape, generator) for lit in (1, 0))
        for k in range(_DRAWN)
    ]
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with SimulatedRig(folder / "rig", RigOptions(speed=0)) as simulated:
            camera = SimulatedCamera(config.camera, lambda position, lit: wire.picture(position, lit))
            wire = Wire(simulated.edges_path, camera, pictures)
            marks: list[float] = []
            with connect(simulated.port) as controller:
                home = controller.home

                def homed(*arguments: int) -> int | None:
                    simulated.control("speed 0")
                    was = home(*arguments)
                    simulated.control("speed 1")
                    return was

                controller.home = homed
                start = time.process_time(), resource.getrusage(resource.RUSAGE_SELF)
                hooks = Hooks(on_pair=lambda *_: marks.append(time.process_time()))
                result = run_sweep(config, folder / "room", Devices(controller, camera), hooks)
            wire.close()
            edges = simulated.edges()
        assert result.status == "complete", result.message
        lit, exposed = 0, []
        for edge in edges:
            if edge.get("pin") == "light":
                lit = edge["v"]
            elif edge.get("pin") == "trig" and edge["v"] and lit:
                exposed.append(edge["cycle"] / CLOCK_HZ)
    # Without the first step, which waits for the camera, and the closing one.
    each = np.diff(exposed[:steps])[2:]
    needed = move_s(config, 8) + shot_s(config) - 2 * config.trigger.ready_ms / 1000
    return {
        "steps": steps,
        "retakes": result.retakes,
        "needed_ms": 1e3 * needed,
        "step_ms": 1e3 * float(np.median(each)),
        "step_mean_ms": 1e3 * float(each.mean()),
        "step_90_ms": 1e3 * float(np.quantile(each, 0.9)),
        "host_ms": 1e3 * (float(np.median(each)) - needed),
        "cpu_ms_a_step": 1e3 * (marks[-1] - marks[2]) / (len(marks) - 3),
        "cpu_ms_all": 1e3 * (time.process_time() - start[0]) / steps,
    }


def main() -> int:
    parser = command_line(__doc__, json=True)
    parser.add_argument("--steps", type=int, default=120)
    parser.add_argument("--settle-ms", type=int, default=20)
    arguments = parser.parse_args()
    figures = measure(arguments.steps, arguments.settle_ms)
    for name, value in figures.items():
        print(f"{name:>16} {value:8.2f}")
    write_json(arguments.json, figures)
    return 0


if __name__ == "__main__":
    sys.exit(main())
