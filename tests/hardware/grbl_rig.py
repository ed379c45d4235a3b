"""A board that speaks GRBL, written from GRBL's documentation, on a clock that tests move; a table and a camera."""

import os
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scanrig.cameras.simulated import FrameShape, SyntheticScene, draw
from scanrig.config import RigConfig
from scanrig.controllers.grbl import GrblController
from scanrig.controllers.grbl.lines import GrblLines, TableUnits
from scanrig.errors import LinkLost, PortError

from .fake import ANSWER_S, Mangle, ManualClock
from .faulty_camera import FaultyCamera


WIDTH, HEIGHT = 128, 96
STEPS_PER_TURN = 28800
SCENE = SyntheticScene(turn_px=12000.0)

GREETING = "Grbl 1.1h ['$' for help]"
SETTINGS = {
    1: 255.0,  # step idle delay: 255 keeps the motor on
    10: 1.0,  # reports have MPos
    13: 0.0,  # reports in millimetres
    21: 0.0,  # hard limits
    22: 1.0,  # homing
    23: 1.0,  # homing downwards
    25: 60000.0,  # homing seek, units/min
    27: 1.0,  # pull-off
    30: 1000.0,  # largest S
    32: 0.0,  # laser mode
    100: 80.0,  # steps per unit
    110: 60000.0,  # largest rate, units/min
    120: 20000.0,  # acceleration, units/s²
    130: 400.0,  # travel
}
_WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)")


@dataclass(frozen=True)
class Motion:
    """From one place to another at a constant speed [units, units/s]."""

    begin: float
    end: float
    speed: float
    start_s: float

    @property
    def end_s(self) -> float:
        return self.start_s + abs(self.end - self.begin) / self.speed

    def at(self, now: float) -> float:
        share = 1.0 if self.end == self.begin else (now - self.start_s) * self.speed / abs(self.end - self.begin)
        return self.begin + min(share, 1.0) * (self.end - self.begin)


class GrblBoard:
    """A `Link` with a board at its end. Its planner has no ramps; it has one axis."""

    name = "grbl"

    def __init__(self, greeting: str = GREETING, report: str | None = None, **settings: float) -> None:
        """`settings`: its own, as `s100=…`; `report`: said instead of the true one."""
        self.greeting, self.report = greeting, report
        self.clock = ManualClock()
        self.settings = SETTINGS | {int(name[1:]): value for name, value in settings.items()}
        self.ledger: list[tuple[float, str, bool]] = []
        """Events: seconds, "light" or "reset", and whether there is light."""
        self.heard: list[str] = []
        """Lines that were carried out."""
        self.to_host: Mangle = lambda data: data
        """Changes a line on its way to the host."""
        self.plugged = True
        self.slipped = 0.0
        """By how much the table stands elsewhere than the axis counts, units."""
        self._due: list[tuple[float, Callable[[], None]]] = []
        self._place, self._motion, self._queue = 0.0, None, deque()
        self._switch_at = -30.0
        self._spindle = "M5"
        self._power_on()
        self._out = b""

    # Link

    def write(self, data: bytes) -> None:
        self._require_cable()
        for byte in data:
            self._run()
            match bytes([byte]):
                case b"\x18":
                    self._reset()
                case b"?":
                    self._asked = True
                case b"!":
                    self._hold()
                case char:
                    self._rx += char
        self._run()

    def read(self, timeout_s: float) -> bytes:
        """Bytes to the host; the clock moves on until there are any."""
        end = self.clock.now() + timeout_s
        while True:
            self._require_cable()
            self._run()
            if self._out:
                self.clock.sleep(ANSWER_S)
                out, self._out = self._out, b""
                return out
            if self.clock.now() >= end:
                return b""
            self.clock.time_s = min([end, *(at for at in self._moments() if at > self.clock.now())])

    def close(self) -> None:
        pass

    # From outside

    def later(self, seconds: float, action: Callable[[], None]) -> None:
        """Run an action after so many seconds."""
        self._due.append((self.clock.now() + seconds, action))

    def unplug(self) -> None:
        """Pull the cable: the board goes on as it was."""
        self.plugged, self._out = False, b""

    def plug(self) -> None:
        self.plugged = True

    @property
    def lit(self) -> bool:
        """Whether the laser shines."""
        self._run()
        return self._shines()

    @property
    def position(self) -> float:
        """Where the table stands, from the home switch [units]."""
        self._run()
        return self._at() - self._switch_at + self.slipped

    def power_cycle(self) -> None:
        """Reset by power: position and everything else are gone, and the table stands where it stands."""
        stood = self._at() - self._switch_at + self.slipped
        self._halt()
        self._place, self._switch_at, self.slipped = 0.0, -stood, 0.0
        self._power_on()
        self._greet()

    def hit_limit(self) -> None:
        """A hard limit: stop dead, alarm, and nothing but a reset is obeyed."""
        self._halt()
        self._set_spindle("M5")
        self._locked = self._critical = True
        self._say("ALARM:1", "[MSG:Reset to continue]")

    # Within

    def _require_cable(self) -> None:
        self.run_due()
        if not self.plugged:
            raise LinkLost("grbl went away (unplugged)") from OSError(5, "unplugged")

    def _moments(self) -> list[float]:
        """When something happens by itself."""
        own = [self._motion.end_s] if self._motion else []
        return [*own, *([] if self._homing_ends is None else [self._homing_ends]), *(at for at, _ in self._due)]

    def run_due(self) -> None:
        """Run the actions whose time has come."""
        due = [entry for entry in self._due if entry[0] <= self.clock.now()]
        self._due = [entry for entry in self._due if entry not in due]
        for _, action in due:
            action()

    def _power_on(self) -> None:
        self._locked = bool(self.settings[22])
        """The alarm state: G-code is refused."""
        self._homing_ends: float | None = None
        self._forget()

    def _forget(self) -> None:
        """Clear the state that every reset clears."""
        self._rx = b""
        self._mode, self._feed, self._power = "G0", 0.0, 0.0
        self._critical = self._asked = self._held = False
        self._set_spindle("M5")

    def _set_spindle(self, spindle: str, power: float | None = None) -> None:
        before = self._shines()
        self._spindle = spindle
        self._power = self._power if power is None else power
        if self._shines() != before:
            self.ledger.append((self.clock.now(), "light", self._shines()))

    def _shines(self) -> bool:
        return self._spindle == "M3" and self._power > 0 and (self._mode == "G1" or not self.settings[32])

    def _at(self) -> float:
        return self._place if self._motion is None else self._motion.at(self.clock.now())

    def _halt(self) -> None:
        self._place, self._motion = self._at(), None
        self._queue.clear()

    def _hold(self) -> None:
        if self._motion is not None:
            self._queue.appendleft((self._motion.end, self._motion.speed))
            self._place, self._motion = self._at(), None
            self._held = True

    def _run(self) -> None:
        self.run_due()
        now = self.clock.now()
        while self._motion is not None and now >= self._motion.end_s:
            ended, self._place, self._motion = self._motion.end_s, self._motion.end, None
            self._next(ended)
        # Nothing is answered while home is looked for.
        if self._homing_ends is not None:
            if now < self._homing_ends:
                return
            self._homed()
        if self._asked:
            self._asked = False
            self._report()
        while b"\n" in self._rx and self._homing_ends is None and not self._critical:
            line, _, rest = self._rx.partition(b"\n")
            text = line.decode("latin-1").upper().replace(" ", "")
            # The spindle is switched only when all motions are over.
            if re.search("M[35]", text) and (self._motion or self._queue):
                return
            self._rx = rest
            self._take(text)

    def _next(self, now: float) -> None:
        if self._motion is None and self._queue and not self._held:
            to, speed = self._queue.popleft()
            self._motion = Motion(self._place, to, speed, now)

    def _reset(self) -> None:
        homing = self._homing_ends is not None
        abrupt = self._motion is not None or homing
        self.ledger.append((self.clock.now(), "reset", False))
        self._halt()
        self._homing_ends = None
        self._forget()
        if abrupt:
            self._locked = True
            self._say("ALARM:6" if homing else "ALARM:3")
        self._greet()

    def _greet(self) -> None:
        self._say(*([self.greeting] if self.greeting else []), *(["[MSG:'$H'|'$X' to unlock]"] if self._locked else []))

    def _say(self, *lines: str) -> None:
        for line in lines:
            self._out += self.to_host(line.encode("latin-1") + b"\r\n") if self.plugged else b""

    def _report(self) -> None:
        if self.report is not None:
            self._say(self.report)
            return
        state = "Alarm" if self._locked else "Hold:0" if self._held else "Run" if self._motion else "Idle"
        which = "MPos" if int(self.settings[10]) & 1 else "WPos"
        self._say(f"<{state}|{which}:{self._at():.3f},0.000,0.000|FS:0,{self._power * (self._spindle == 'M3'):.0f}>")

    def _take(self, text: str) -> None:
        if not text:
            self._say("ok")
        elif text == "$H":
            self._home()
        elif text[0] == "$":
            self._system(text)
        elif self._locked:
            self._say("error:9")
        else:
            self._gcode(text)

    def _system(self, text: str) -> None:
        if text == "$$":
            self._say(*(f"${number}={value:.3f}" for number, value in sorted(self.settings.items())))
        elif text == "$G":
            modes = f"{self._mode} G54 G17 G21 G90 G94 {self._spindle} M9"
            self._say(f"[GC:{modes} T0 F{self._feed:.0f} S{self._power:.0f}]")
        elif text == "$X":
            self._locked = False
            self._say("[MSG:Caution: Unlocked]")
        else:
            self._say("error:3")
            return
        self.heard.append(text)
        self._say("ok")

    def _home(self) -> None:
        if not self.settings[22]:
            self._say("error:5")
            return
        self.heard.append("$H")
        self._locked = False
        way = min(abs(self._at() - self._switch_at + self.slipped), 1.5 * self.settings[130])
        self._homing_ends = self.clock.now() + 60 * way / self.settings[25] + 0.05

    def _homed(self) -> None:
        # Downwards the switch is at the far end of the travel, and the table stands the pull-off above it.
        self._place = -self.settings[130] + self.settings[27]
        self._switch_at, self.slipped = self._place - self.settings[27], 0.0
        self._homing_ends = None
        self._say("ok")

    def _gcode(self, text: str) -> None:
        words = _WORD.findall(text)
        if "".join(letter + number for letter, number in words) != text:
            self._say("error:2")
            return
        codes = [f"{letter}{float(number):g}" for letter, number in words if letter in "GM"]
        values = {letter: float(number) for letter, number in words if letter not in "GM"}
        self.heard.append(text)
        self._mode = next((code for code in codes if code in ("G0", "G1")), self._mode)
        self._feed = values.get("F", self._feed)
        spindle = next((code for code in codes if code in ("M3", "M5")), self._spindle)
        self._set_spindle(spindle, values.get("S"))
        if "X" in values:
            step = 1 / self.settings[100]
            self._queue.append((round(values["X"] / step) * step, min(self._feed, self.settings[110]) / 60))
            self._next(self.clock.now())
        self._say("ok")


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


def camera_of(board: GrblBoard, config: RigConfig) -> FaultyCamera:
    """A camera that sees where the table of a board truly stands, and whether its laser truly shines."""
    generator = np.random.default_rng(os.getpid())

    def see(position, lit):
        return draw(SCENE, position, lit, FrameShape(WIDTH, HEIGHT), generator)

    # From the place where the table stands after homing, the pull-off above the switch.
    def world():
        return STEPS_PER_TURN / 360 * (board.position - board.settings[27]), board.lit

    return FaultyCamera(config.camera, see, world=world)


def open_board(board: GrblBoard, config: RigConfig) -> GrblController:
    """A controller at a board; its port is there while the cable is plugged in."""

    def reopen() -> GrblBoard:
        board.clock.sleep(ANSWER_S)
        board.run_due()
        if not board.plugged:
            raise PortError("there is no port grbl")
        return board

    table = config.controller.grbl
    lines = GrblLines(board, board.clock, greeting=table.greeting, reopen=reopen)
    return GrblController(lines, table, TableUnits(config.microsteps_per_turn, table.units_per_turn))
