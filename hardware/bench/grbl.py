"""A GRBL board without hardware: a program on a pseudo terminal, written from GRBL's documentation."""

import math
import os
import re
import select
import threading
import time
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


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
"""Settings of a fast board: tests are about its logic."""


_WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)")
_CODES = {"G0", "G1", "G4", "G21", "G53", "G90", "G94", "M3", "M5"}
_VALUES = set("XFSP")


@dataclass(frozen=True)
class Block:
    """A parsed line."""

    motion: str
    """G0 or G1, which stays for the lines after it."""
    feed: float
    power: float | None
    spindle: str | None
    """M3 or M5."""
    target: float | None
    """Where the axis is to go."""
    waits: bool
    """Whether it is carried out only when all motions before it are over."""


def parse(text: str, *, motion: str, feed: float) -> Block | str:
    """A line without spaces, in capitals.

    Args:
        motion: G0 or G1, as it was.

    Returns:
        The parsed line, or GRBL's answer to a line that it does not understand.
    """
    words = _WORD.findall(text)
    if "".join(letter + number for letter, number in words) != text:
        return "error:2" if text[0].isalpha() else "error:1"
    codes = [f"{letter}{float(number):g}" for letter, number in words if letter in "GM"]
    values = {letter: float(number) for letter, number in words if letter not in "GM"}
    if not set(codes) <= _CODES or not set(values) <= _VALUES:
        return "error:20"
    motion = next((code for code in codes if code in ("G0", "G1")), motion)
    feed = values.get("F", feed)
    if "X" in values and motion == "G1" and feed <= 0:
        return "error:22"
    spindle = next((code for code in codes if code in ("M3", "M5")), None)
    waits = spindle is not None or "G4" in codes
    return Block(motion, feed, values.get("S"), spindle, values.get("X"), waits)


@dataclass(frozen=True)
class Ramp:
    """A motion from rest to rest: up with an acceleration, on with a speed, down again."""

    begin: float
    end: float
    speed: float
    acceleration: float
    start_s: float

    @property
    def _peak(self) -> float:
        return min(self.speed, math.sqrt(self.acceleration * abs(self.end - self.begin)))

    @property
    def seconds(self) -> float:
        """How long it takes."""
        distance, peak = abs(self.end - self.begin), self._peak
        return 0.0 if distance == 0 else distance / peak + peak / self.acceleration

    def at(self, now: float) -> tuple[float, float]:
        """Position and speed, which has the sign of the motion, at a time."""
        t, total, peak, a = now - self.start_s, self.seconds, self._peak, self.acceleration
        sign = math.copysign(1.0, self.end - self.begin)
        if t >= total:
            return self.end, 0.0
        up = peak / a
        if t < up:
            return self.begin + sign * a * t * t / 2, sign * a * t
        if t > total - up:
            left = total - t
            return self.end - sign * a * left * left / 2, sign * a * left
        return self.begin + sign * (a * up * up / 2 + peak * (t - up)), sign * peak


class Axis:
    """An axis that carries out one motion after the other, and can be held or stopped at once."""

    def __init__(self, place: float = 0.0) -> None:
        self.held = False
        self._queue: deque[tuple[float, float, float]] = deque()
        self._ramp: Ramp | None = None
        self._place = place

    @property
    def queued(self) -> int:
        """Motions that have not begun."""
        return len(self._queue)

    @property
    def target(self) -> float:
        """Position after all motions."""
        if self._queue:
            return self._queue[-1][0]
        return self._place if self._ramp is None else self._ramp.end

    @property
    def busy(self) -> bool:
        """Whether motions are left."""
        return self._ramp is not None or bool(self._queue)

    @property
    def moving(self) -> bool:
        """Whether it turns at this moment."""
        return self._ramp is not None

    def go(self, to: float, speed: float, acceleration: float) -> None:
        """Append a motion."""
        self._queue.append((to, speed, acceleration))

    def hold(self, now: float) -> None:
        """Slow down, and stay."""
        if self.held:
            return
        self.held = True
        if self._ramp is not None:
            place, speed = self._ramp.at(now)
            way = math.copysign(speed * speed / (2 * self._ramp.acceleration), speed)
            self._queue.appendleft((self._ramp.end, self._ramp.speed, self._ramp.acceleration))
            # A ramp whose second half is this slowing down.
            begin = now - abs(speed) / self._ramp.acceleration
            self._ramp = Ramp(place - way, place + way, math.inf, self._ramp.acceleration, begin)

    def resume(self) -> None:
        """Go on after a hold."""
        self.held = False

    def halt(self, now: float) -> None:
        """Stop at once, and clear the queue."""
        self._place = self.at(now)
        self._ramp, self.held = None, False
        self._queue.clear()

    def at(self, now: float) -> float:
        """Its position."""
        return self._place if self._ramp is None else self._ramp.at(now)[0]

    def run(self, now: float) -> None:
        """End a finished motion, and begin the next."""
        if self._ramp is not None and now - self._ramp.start_s >= self._ramp.seconds:
            self._place, self._ramp = self._ramp.end, None
        if self._ramp is None and self._queue and not self.held:
            to, speed, acceleration = self._queue.popleft()
            if to != self._place:
                self._ramp = Ramp(self._place, to, speed, acceleration, now)


class Terminal:
    """Two ends: the program's, which is used here, and the one that a host opens by name."""

    def __init__(self, name: str) -> None:
        """Open it; `name` becomes a link to the host's end."""
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self._link = Path(name)
        self._link.unlink(missing_ok=True)
        self._link.symlink_to(os.ttyname(self._theirs))

    def wait(self, timeout_s: float) -> bool:
        """Whether something has come within a time; False once it is closed."""
        try:
            return bool(select.select([self._ours], [], [], timeout_s)[0])
        except (OSError, ValueError):
            return False

    def read(self) -> bytes:
        """Received bytes."""
        return os.read(self._ours, 4096)

    def write(self, data: bytes) -> None:
        """Send it."""
        os.write(self._ours, data)

    def close(self) -> None:
        """Pull the cable."""
        os.close(self._ours)
        os.close(self._theirs)
        self._ours = -1
        self._link.unlink(missing_ok=True)


GREETING = "Grbl 1.1h ['$' for help]"
RX_BUFFER = 128
PLANNER_BLOCKS = 15
_TICK_S = 0.001
_LONGEST = 80
_SETTING = re.compile(r"\$(\d+)=(-?\d+\.?\d*)")

Mangle = Callable[[bytes], bytes]


class GrblBoard:
    """A board that runs in its own thread from `start` to `close`; tests may read its fields."""

    def __init__(self, folder: Path, **settings: float) -> None:
        """Args:
        folder: where its port is, as a link of the name `grbl`.
        settings: of its own, as `s100=…`.
        """
        self.port = str(folder / "grbl")
        self.settings = SETTINGS | {int(name[1:]): value for name, value in settings.items()}
        self.ledger: list[tuple[float, str, float]] = []
        """Events: seconds, "light" or "reset", and whether there is light."""
        self.heard: list[str] = []
        """Lines that were carried out."""
        self.to_board: Mangle = lambda data: data
        """Faults of the line on bytes to the board."""
        self.to_host: Mangle = lambda data: data
        """Faults of the line on bytes to the host."""
        self.switch = True
        """Whether there is a home switch."""
        self.slipped = 0.0
        """By how much the table stands elsewhere than the axis counts, units."""
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._terminal: Terminal | None = None
        self._axis = Axis()
        self._power_on()
        self._thread = threading.Thread(target=self._live, daemon=True)

    # From outside

    def start(self) -> None:
        """Plug it in."""
        self.plug()
        self._thread.start()

    def close(self) -> None:
        """Switch it off."""
        self._ended.set()
        self._thread.join()
        self.unplug()

    @property
    def lit(self) -> bool:
        """Whether the laser shines."""
        in_motion_mode = self._motion == "G1" or not self.settings[32]
        return self._spindle == "M3" and self._power > 0 and in_motion_mode

    @property
    def position(self) -> float:
        """Where the table stands, from the home switch [units]."""
        with self._lock:
            return self._axis.at(time.monotonic()) - self._switch_at + self.slipped

    def plug(self) -> None:
        """Plug the cable in, as another terminal under the same name."""
        with self._lock:
            self._terminal = Terminal(self.port)

    def unplug(self) -> None:
        """Pull the cable: the board goes on as it was."""
        with self._lock:
            if self._terminal is not None:
                self._terminal.close()
            self._terminal = None

    def power_cycle(self) -> None:
        """Reset by power: position and everything else are gone, and the table stands where it stands."""
        with self._lock:
            now = time.monotonic()
            stood = self.position
            self._axis.halt(now)
            self._axis = Axis()
            self._switch_at, self.slipped = -stood, 0.0
            self._power_on()
            self._say(GREETING)
            if self._locked:
                self._say("[MSG:'$H'|'$X' to unlock]")

    def hit_limit(self) -> None:
        """A hard limit: stop dead, alarm, and nothing but a reset is obeyed."""
        with self._lock:
            self._axis.halt(time.monotonic())
            self._stop_spindle()
            self._locked = self._critical = True
            self._say("ALARM:1")
            self._say("[MSG:Reset to continue]")

    # Within

    def _power_on(self) -> None:
        self._locked = bool(self.settings[22])
        """The alarm state: G-code is refused."""
        self._switch_at = getattr(self, "_switch_at", -30.0)
        """Where the axis counts the home switch."""
        self._homing_ends: float | None = None
        self._forget()

    def _forget(self) -> None:
        """Clear the state that every reset clears."""
        self._rx = b""
        self._motion, self._feed, self._power = "G0", 0.0, 0.0
        self._critical = False
        self._waiting: Callable[[], None] | None = None
        self._asked = False
        self._stop_spindle()

    def _stop_spindle(self) -> None:
        before = getattr(self, "_spindle", "M5") == "M3"
        self._spindle = "M5"
        if before:
            self._note_light()

    def _note_light(self) -> None:
        self.ledger.append((time.monotonic(), "light", float(self.lit)))

    def _live(self) -> None:
        while not self._ended.is_set():
            with self._lock:
                self._step(time.monotonic())
                terminal = self._terminal
            if terminal is None:
                time.sleep(_TICK_S)
            elif terminal.wait(_TICK_S):
                with self._lock:
                    if terminal is self._terminal:
                        self._receive(self.to_board(terminal.read()))

    def _receive(self, data: bytes) -> None:
        for byte in data:
            char = bytes([byte])
            if char == b"\x18":
                self._reset(time.monotonic())
            elif char == b"?":
                self._asked = True
            elif char == b"!":
                self._axis.hold(time.monotonic())
            elif char == b"~":
                self._axis.resume()
            elif len(self._rx) < RX_BUFFER:
                self._rx += char.replace(b"\r", b"\n")

    def _step(self, now: float) -> None:
        self._axis.run(now)
        if self._homing_ends is not None:
            # Nothing is answered while home is looked for.
            if now < self._homing_ends:
                return
            self._homed()
        if self._asked:
            self._asked = False
            self._report(now)
        if self._waiting is not None and not self._axis.busy:
            done, self._waiting = self._waiting, None
            done()
        while self._waiting is None and self._homing_ends is None and b"\n" in self._rx:
            if self._critical or self._axis.queued >= PLANNER_BLOCKS:
                return
            line, _, self._rx = self._rx.partition(b"\n")
            self._take(line.decode("latin-1"), now)

    def _reset(self, now: float) -> None:
        self.ledger.append((now, "reset", 0.0))
        homing = self._homing_ends is not None
        abrupt = self._axis.moving or homing
        self._axis.halt(now)
        self._homing_ends = None
        self._forget()
        if abrupt:
            self._locked = True
            self._say("ALARM:6" if homing else "ALARM:3")
        self._say(GREETING)
        if self._locked:
            self._say("[MSG:'$H'|'$X' to unlock]")

    def _say(self, line: str) -> None:
        data = self.to_host(line.encode("latin-1") + b"\r\n")
        if self._terminal is not None:
            self._terminal.write(data)

    def _report(self, now: float) -> None:
        if self._locked:
            state = "Alarm"
        elif self._axis.held:
            state = f"Hold:{int(self._axis.moving)}"
        else:
            state = "Run" if self._axis.busy else "Idle"
        place = self._axis.at(now)
        which = "MPos" if int(self.settings[10]) & 1 else "WPos"
        self._say(f"<{state}|{which}:{place:.3f},0.000,0.000|FS:0,{self._power * (self._spindle == 'M3'):.0f}>")

    def _take(self, line: str, now: float) -> None:
        text = line.upper().replace(" ", "")
        if len(line) >= _LONGEST:
            self._say("error:11")
        elif not text:
            self._say("ok")
        elif text[0] == "$":
            self._system(text, now)
        elif self._locked:
            self._say("error:9")
        else:
            self._gcode(text)

    def _system(self, text: str, now: float) -> None:
        if text == "$$":
            for number, value in sorted(self.settings.items()):
                self._say(f"${number}={value:.3f}" if number >= 24 and number != 32 else f"${number}={value:.0f}")
        elif text == "$G":
            modes = f"{self._motion} G54 G17 G21 G90 G94 {self._spindle} M9"
            self._say(f"[GC:{modes} T0 F{self._feed:.0f} S{self._power:.0f}]")
        elif text == "$X":
            self._locked = False
            self._say("[MSG:Caution: Unlocked]")
        elif text == "$H":
            self._home(now)
            return
        elif match := _SETTING.fullmatch(text):
            self.settings[int(match[1])] = float(match[2])
        else:
            self._say("error:3")
            return
        self.heard.append(text)
        self._say("ok")

    def _home(self, now: float) -> None:
        if not self.settings[22]:
            self._say("error:5")
            return
        self.heard.append("$H")
        self._locked = False
        way = min(abs(self.position), 1.5 * self.settings[130])
        self._homing_ends = now + 60 * way / self.settings[25] + 0.05

    def _homed(self) -> None:
        found = self.switch and abs(self.position) <= 1.5 * self.settings[130]
        self._homing_ends = None
        if not found:
            self._locked = True
            self._stop_spindle()
            self._say("ALARM:9")
            return
        # Downwards the switch is at the far end of the travel, and the table stands the pull-off above it.
        place = -self.settings[130] + self.settings[27]
        self._axis = Axis(place)
        self._switch_at, self.slipped = place - self.settings[27], 0.0
        self._say("ok")

    def _gcode(self, text: str) -> None:
        block = parse(text, motion=self._motion, feed=self._feed)
        if isinstance(block, str):
            self._say(block)
            return
        self.heard.append(text)

        def carry_out() -> None:
            before = self.lit
            self._motion, self._feed = block.motion, block.feed
            self._power = self._power if block.power is None else block.power
            self._spindle = block.spindle or self._spindle
            if self.lit != before:
                self._note_light()
            if block.target is not None:
                rate = self.settings[110] if block.motion == "G0" else min(block.feed, self.settings[110])
                step = 1 / self.settings[100]
                self._axis.go(round(block.target / step) * step, rate / 60, self.settings[120])
            self._say("ok")

        if block.waits:
            self._waiting = carry_out  # Only when all motions are over.
        else:
            carry_out()
