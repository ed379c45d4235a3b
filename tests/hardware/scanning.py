"""Sessions in processes of their own, which can be killed: modules are loaded once, then a child is forked for each."""

import json
import multiprocessing
import os
import sys
import threading

import numpy as np
from scanrig.cameras import open_camera
from scanrig.cameras.simulated import FrameShape, SimulatedCamera, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers.jxs.controller import connect
from scanrig.session import Devices, Hooks, Interrupts, run_sweep


_SERVER = multiprocessing.get_context("forkserver")
# Its threads are JAX's, which are idle: nothing uses them.
_SERVER.set_forkserver_preload([__name__, "tests.hardware.desk"])


def forked(function, *arguments):
    """A process that calls a function of a module and exits with its result, or -n if signal n kills it."""
    process = _SERVER.Process(target=_exit_with, args=(function, *arguments))
    process.start()
    return process


def _exit_with(function, *arguments):
    sys.exit(function(*arguments))


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


def session(*, folder, port, edges, steps, said, gige=False):
    """One session, from the port to the exit status: 0 complete, 130 interrupted, 1 another end.

    It writes to the file `said`: the number of each pair when it is on the disk, and the end. With `gige` it is by the
    network camera of the bench.
    """
    rig = config(steps, **(GIGE if gige else {}))
    generator = np.random.default_rng(os.getpid())
    with open(said, "a", buffering=1) as said, Interrupts() as interrupts:
        controller = connect(port)
        if gige:
            camera, wire = open_camera(rig.camera, lambda sentence: print("#", sentence, file=said)), None
        else:
            camera = SimulatedCamera(rig.camera, lambda position, lit: see(position, lit, generator))
            wire = Wire(edges, camera)
        try:
            result = run_sweep(
                rig,
                folder,
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
