"""`python -m bench`: the bench at the places that configs/bench.toml names, with commands from the terminal.

`python -m bench place N` shows the camera of a running bench the board in pose N, `place next` in the next one, and
`place none` takes it away, as a person with a board would. `python -m bench rig …` and `camera …` pass a command on.
`python -m bench two-lasers` sets up a rig with a second laser.
"""

import os
import select
import signal
import sys
import time
from pathlib import Path

from bench.desk import HELP, Desk, set_up
from bench.places import TWO_LASERS, WORLD, BenchError, runtime
from bench.processes import ControlClient
from jaxscan.errors import JaxscanError


STATUS_S = 0.5
PLACE = ".venv/bin/python -m bench place"
"""Shows the camera of a running bench the board in a pose, as docs/console.md has it."""
SOCKETS = {"place": "camera", "camera": "camera", "rig": "control"}


def ask(words: list[str]) -> int:
    client = ControlClient(runtime() / SOCKETS[words[0]])
    text = " ".join(["board", *words[1:]] if words[0] == "place" else words[1:])
    answer = client.ask(text)
    client.close()
    if answer.startswith(("error: ", "unknown")):
        raise BenchError(answer.removeprefix("error: "))
    print(answer)
    return 0


def attend(desk: Desk) -> None:
    """Take commands from the terminal and show where everything stands, until `quit`, a signal, or a part's death."""
    shows, typed, listening = sys.stdout.isatty(), b"", True
    while True:
        desk.require_alive()
        if shows:
            print(f"\r\x1b[K{desk.status()}  > ", end="", flush=True)
        if not listening:
            time.sleep(STATUS_S)
        elif select.select([sys.stdin], [], [], STATUS_S)[0]:
            more = os.read(sys.stdin.fileno(), 4096)
            listening = bool(more)  # Nobody at the terminal: a signal ends this.
            *lines, typed = (typed + more).split(b"\n")
            for line in lines:
                text = line.decode(errors="replace").strip()
                if text == "quit":
                    return
                print(("\r\x1b[K" if shows else "") + _carried_out(desk, text), flush=True)


def _carried_out(desk: Desk, text: str) -> str:
    try:
        return desk.command(text)
    except BenchError as problem:
        return str(problem)


def run(world: Path, config: str) -> int:
    """Set the bench up, print how to scan with it, and serve the terminal."""
    folder = runtime()
    print("Building, and making a room …", flush=True)
    with set_up(folder, world=world) as desk:
        poses = desk.camera.control("poses")
        free = sum(pose["kind"] == "free" for pose in poses)
        print(f"The bench is set up. Port: {desk.rig.port}   camera: {desk.camera.address}")
        print(f"In another terminal, type:\n\n    jaxscan doctor --config configs/{config}\n")
        print(f'or, to scan from a web page,\n\n    jaxscan console configs/{config} --place-command "{PLACE}"\n')
        print(f"The board has {len(poses)} poses: {free} free views, then {len(poses) - free} placements.\n{HELP}\n")
        attend(desk)
    return 0


def main(words: list[str]) -> int:
    try:
        if words and words[0] in SOCKETS:
            return ask(words)
        if words and words != ["two-lasers"]:
            raise BenchError(f"{words[0]}: found no such word, expected place, camera, rig, two-lasers, or nothing.")
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        signal.signal(signal.SIGHUP, signal.default_int_handler)
        return run(TWO_LASERS, "bench_two_lasers.toml") if words else run(WORLD, "bench.toml")
    except JaxscanError as problem:
        print(f"bench: {problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nThe bench is shut down.")
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
