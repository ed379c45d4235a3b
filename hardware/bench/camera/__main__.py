"""The camera on the bench as a program of its own.

python -m bench.camera --edges RIG/edges.jsonl --control SOCKET [--world world.toml] [--address 127.0.0.1]
"""

import argparse
import ctypes
import os
import signal
import sys
from pathlib import Path

from bench.camera.network import BenchCamera
from bench.camera.rendered import ADDRESS, load_world
from bench.places import WORLD, BenchError
from bench.processes import ControlServer


PLACEMENT_REACH_DEG = 10.0
"""Placements of the board are seen over at least this angle to both sides of home."""


def main() -> int:
    parser = argparse.ArgumentParser(prog="bench.camera", description="A GigE Vision camera that sees a simulated rig.")
    parser.add_argument("--edges", type=Path, required=True, help="the rig's log, edges.jsonl")
    parser.add_argument("--control", type=Path, required=True, help="the socket to make")
    parser.add_argument("--ledger", type=Path, required=True, help="file for the true view of each frame, JSONL")
    parser.add_argument("--world", type=Path, default=WORLD, help="a simulated rig, TOML")
    parser.add_argument("--address", default=ADDRESS, help="address of a local network interface")
    parser.add_argument("--microsteps-per-turn", type=int, default=28800)
    parser.add_argument("--owner", type=int, default=os.getppid(), help="the process that started it")
    options = parser.parse_args()
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: never outlives who started it.
    if os.getppid() != options.owner:
        print("the program that started it has ended", file=sys.stderr)
        return 1
    try:
        world = load_world(options.world, reach_deg=PLACEMENT_REACH_DEG)
        # Room and rays are made once, before anybody waits for a frame.
        world.expect(0.0)
        with open(options.ledger, "a") as ledger:
            camera = BenchCamera(world, options.edges, options.microsteps_per_turn, ledger, options.address)
            server = ControlServer(options.control, camera.answer)
            signal.signal(signal.SIGTERM, lambda *_: camera.stop())
            signal.signal(signal.SIGINT, lambda *_: camera.stop())
            print("ready", flush=True)
            camera.run()
            server.close()
    except BenchError as problem:
        print(problem, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
