"""The whole bench: rig and camera, and the commands of a person at the terminal."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.camera import RenderedCamera, loopback
from bench.places import BenchError, held, own_folder
from bench.rig import RigOptions, SimulatedRig


MICROSTEPS_PER_TURN = 28800

HELP = """\
Enter          show the next pose of the board; after the last one, take it away
place N|none   show pose N, or no board
e, r           press the e-stop, release it
noise on|off   a bad cable: damaged and lost bytes, both ways
unplug, plug   pull the cable, plug it in again
drop N         let the motor lose N steps
laser good|welded|dead, and laser_2 the same
lose N         let the camera lose its next N frames
rig …          any other command of simrun, camera … of the camera; see hardware/bench/README.md
quit           or Ctrl-C"""

NOISE = {"corrupt": 0.002, "drop": 0.001, "duplicate": 0.001}


@dataclass
class Desk:
    """A rig with its camera, and the board under manual control."""

    rig: SimulatedRig
    camera: RenderedCamera

    def command(self, text: str) -> str:
        """Carry out one line, and return its answer. Raises BenchError if it is not understood."""
        verb, _, rest = text.strip().partition(" ")
        simple: dict[str, Callable[[], str]] = {
            "": lambda: self.place("next"),
            "place": lambda: self.place(rest),
            "e": lambda: self.rig.control("estop 1"),
            "r": lambda: self.rig.control("estop 0"),
            "noise": lambda: self.noise(rest),
            "lose": lambda: str(self.camera.control(f"lose {rest}")),
            "rig": lambda: self.rig.control(rest),
            "camera": lambda: str(self.camera.control(rest)),
            "help": lambda: HELP,
        }
        if verb in simple:
            return simple[verb]()
        return self.rig.control(text.strip())

    def place(self, which: str) -> str:
        """Show the board in a pose: "next", "none", or its number."""
        described = self.camera.control(f"board {which}")
        if described["board"] is None:
            return "no board"
        kind = "free view" if described["kind"] == "free" else f"placement {described['placement'] + 1}"
        return f"board in pose {described['board']}: {kind}"

    def noise(self, switch: str) -> str:
        """Make the cable bad, or good again: "on" or "off"."""
        if switch not in ("on", "off"):
            raise BenchError(f"noise: found {switch!r}, expected on or off.")
        for fault, share in NOISE.items():
            for way in ("rx", "tx"):
                self.rig.control(f"{fault}_{way} {share if switch == 'on' else 0}")
        return f"noise {switch}"

    def require_alive(self) -> None:
        """Raise BenchError with the part that has ended by itself."""
        if died := self.rig.died() or self.camera.died():
            raise BenchError(f"{died}; the bench is shut down.")

    def status(self) -> str:
        """One line: where everything stands."""
        plant, camera = self.rig.plant(), self.camera.control("state")
        words = [
            f"{360 * plant['pos'] / MICROSTEPS_PER_TURN:8.2f}°",
            " ".join(name for name, light in (("LASER", "light"), ("LASER 2", "light_2")) if plant[light])
            or "laser off",
            "armed" if plant["contactor"] else "disarmed",
            *(["E-STOP"] if plant["estop"] else []),
            ("host" if plant["host"] else "no host") if plant["plugged"] else "UNPLUGGED",
            f"{camera['sent']} frames" + (f", {camera['waiting']} waiting" if camera["waiting"] else ""),
            "no board" if camera["board"] is None else f"board {camera['board']}",
        ]
        return " · ".join(words)


@contextmanager
def claimed(folder: Path) -> Iterator[None]:
    """Keeps a runtime folder to one bench; raises BenchError if one runs in it already."""
    busy = f"A bench runs already, in {folder}: end that one first."
    with held(own_folder(folder) / "lock", timeout_s=0.0, busy=busy):
        yield


@contextmanager
def set_up(folder: Path, *, world: Path, speed: float = 1.0, wait_s: float = 1.0) -> Iterator[Desk]:
    """Rig and camera in a folder, fresh, switched off at the end; `wait_s` is for another camera to end."""
    with ExitStack() as stack:
        stack.enter_context(claimed(folder))
        stack.enter_context(loopback(timeout_s=wait_s))
        for old in ("edges.jsonl", "frames.jsonl", "eeprom.bin"):
            (folder / old).unlink(missing_ok=True)
        rig = SimulatedRig(folder, RigOptions(speed=speed, microsteps_per_turn=MICROSTEPS_PER_TURN, apart=True))
        stack.enter_context(rig)
        camera = RenderedCamera(folder, edges=rig.edges_path, world=world, apart=True)
        yield Desk(rig, stack.enter_context(camera))
