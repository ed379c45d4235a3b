"""Sessions as processes that can be killed: loads everything once, then forks a child for each.

Reads one JSON object a line: {"folder", "port", "edges", "steps", "said"}, and "gige" for the bench's network camera;
answers with the child's number, and with "<number> <status>" when it has ended: 0 complete, 130 interrupted, 1 another
end, -n killed by signal n. A child writes to `said`: the number of each pair when it is on the disk, and the end.
"""

import json
import os
import sys
import threading
import time
import warnings
from pathlib import Path

import numpy as np
from scanrig.cameras import open_camera
from scanrig.cameras.simulated import FrameShape, SimulatedCamera, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers.jxs.controller import connect
from scanrig.session import Devices, Hooks, Interrupts, run_sweep

from jaxscan.vision import images


WIDTH, HEIGHT = 128, 96
GIGE = {
    "camera": {"kind": "aravis", "id": "127.0.0.1", "width": WIDTH, "height": HEIGHT, "trigger_source": "Software"},
    "checks": {"late_s": 10.0},
}
"""With the bench's camera, which draws its pictures on the same processor."""
SCENE = SyntheticScene(turn_px=12000.0)


def config(steps, **tables):
    """A step of 8 microsteps and a patient controller: the rig's clock runs faster than the host's."""
    return RigConfig.model_validate(
        {
            "controller": {"watchdog_ms": 60_000},
            "turntable": {"gear": [9, 1], "settle_ms": 20},
            "camera": {"kind": "simulated", "width": WIDTH, "height": HEIGHT},
            "sweep": {"steps": steps, "turn_deg": steps / 10},
            **tables,
        }
    )


def see(position, lit, generator):
    return draw(SCENE, position, lit, FrameShape(WIDTH, HEIGHT), generator)


class Wire:
    """Every edge of the trigger's pin in the rig's log exposes the camera, at the table's true position."""

    def __init__(self, path, camera):
        self._file = open(path)
        self._camera = camera
        self._lit = {"light": False, "light_2": False}
        self._rest = ""
        self._read(expose=False)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def close(self):
        self._ended.set()
        self._thread.join()
        self._file.close()

    def _follow(self):
        while not self._ended.wait(0.001):
            self._read(expose=True)

    def _read(self, expose):
        *lines, self._rest = (self._rest + self._file.read()).split("\n")
        for line in lines:
            edge = json.loads(line)
            if edge.get("pin") in self._lit:
                self._lit[edge["pin"]] = bool(edge["v"])
            elif edge.get("pin") == "trig" and edge["v"] and expose:
                self._camera.expose(edge["pos"], self._lit["light"] + 2 * self._lit["light_2"])


def session(order):
    """One session, from the port to the exit status; with "gige" by the network camera of the bench."""
    gige = bool(order.get("gige"))
    rig = config(order["steps"], **(GIGE if gige else {}))
    generator = np.random.default_rng(os.getpid())
    with open(order["said"], "a", buffering=1) as said, Interrupts() as interrupts:
        controller = connect(order["port"])
        if gige:
            camera, wire = open_camera(rig.camera, lambda sentence: print("#", sentence, file=said)), None
        else:
            camera = SimulatedCamera(rig.camera, lambda position, lit: see(position, lit, generator))
            wire = Wire(order["edges"], camera)
        try:
            result = run_sweep(
                rig,
                order["folder"],
                Devices(controller, camera),
                Hooks(
                    on_pair=lambda number, *_: print(number, file=said),
                    notify=lambda sentence: print("#", sentence, file=said),
                    should_stop=interrupts,
                ),
                resume=True,
            )
            print(result.status, file=said)
            return {"complete": 0, "interrupted": 130}.get(result.status, 1)
        except KeyboardInterrupt:
            print("aborted", file=said)
            return 130
        except Exception as problem:
            print("error", type(problem).__name__, problem, file=said)
            return 1
        finally:
            controller.close()
            camera.close()
            if wire is not None:
                wire.close()


def main():
    # Forking a process that has threads is dangerous in general; JAX's are idle here, and nothing uses them.
    warnings.simplefilter("ignore")
    images.encode_png(np.zeros((64, 64), np.uint8))
    print("ready", flush=True)
    for line in sys.stdin:
        order = json.loads(line)
        child = os.fork()
        if child == 0:
            os._exit(session(order))
        print(child, flush=True)
        _, status = os.waitpid(child, 0)
        print(child, os.waitstatus_to_exitcode(status), flush=True)
        time.sleep(0)


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "hardware"))
    main()
