"""A simulated GRBL 1.1 board on a pseudo terminal, with one axis, a laser as its spindle, and faults on demand.

Source: "Grbl v1.1 Interface", "Grbl v1.1 Commands", "Grbl v1.1 Configuration", "Grbl v1.1 Laser Mode" of
github.com/gnea/grbl.
"""

import os
import re
import select
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

from bench.grbl.motion import Axis


GREETING = "Grbl 1.1h ['$' for help]"
RX_BUFFER = 128
PLANNER_BLOCKS = 15
_TICK_S = 0.001
_LONGEST = 80
_WORD = re.compile(r"([A-Z])(-?\d*\.?\d+)")
_SETTING = re.compile(r"\$(\d+)=(-?\d+\.?\d*)")

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
"""A fast board: what is tested is its logic."""

Mangle = Callable[[bytes], bytes]


class GrblBoard:
    """A board that is switched on from `start` to `close`, in a thread of its own. It may be looked into."""

    def __init__(self, folder: Path, **settings: float) -> None:
        """Args:
        folder: where its port is, as a link of the name `grbl`.
        settings: of its own, as `s100=…`.
        """
        self.port = str(folder / "grbl")
        self.settings = SETTINGS | {int(name[1:]): value for name, value in settings.items()}
        self.ledger: list[tuple[float, str, float]] = []
        """What happened: seconds, "light" or "reset" or "moved", and the value."""
        self.heard: list[str] = []
        """Lines that were carried out."""
        self.to_board: Mangle = lambda data: data
        """What the line does to bytes on their way in."""
        self.to_host: Mangle = lambda data: data
        """What the line does to a line on its way out."""
        self.switch = True
        """Whether there is a home switch."""
        self.slipped = 0.0
        """By how much the table stands elsewhere than the axis counts, units."""
        self._lock = threading.RLock()
        self._ended = threading.Event()
        self._master = self._slave = -1
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
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            link = Path(self.port)
            link.unlink(missing_ok=True)
            link.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Pull the cable: the board goes on as it was."""
        with self._lock:
            for end in (self._master, self._slave):
                if end >= 0:
                    os.close(end)
            self._master = self._slave = -1
            Path(self.port).unlink(missing_ok=True)

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
        """What any reset forgets."""
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
                master = self._master
            if master < 0:
                time.sleep(_TICK_S)
            elif select.select([master], [], [], _TICK_S)[0]:
                with self._lock:
                    self._receive()

    def _receive(self) -> None:
        if self._master < 0:
            return
        try:
            data = self.to_board(os.read(self._master, 4096))
        except OSError:
            return
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
        if self._master >= 0 and data:
            os.write(self._master, data)

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
        words = _WORD.findall(text)
        if "".join(letter + number for letter, number in words) != text:
            self._say("error:2" if re.fullmatch(r"[A-Z][^A-Z]*", text) or text[0].isalpha() else "error:1")
            return
        codes = [f"{letter}{float(number):g}" for letter, number in words if letter in "GM"]
        values = {letter: float(number) for letter, number in words if letter not in "GM"}
        known = {"G0", "G1", "G4", "G21", "G53", "G90", "G94", "M3", "M5"}
        if not set(codes) <= known or not set(values) <= set("XFSP"):
            self._say("error:20")
            return
        motion = next((code for code in codes if code in ("G0", "G1")), self._motion)
        feed = values.get("F", self._feed)
        if "X" in values and motion == "G1" and feed <= 0:
            self._say("error:22")
            return
        self.heard.append(text)

        def carry_out() -> None:
            self._motion, self._feed, self._power = motion, feed, values.get("S", self._power)
            before = self.lit
            self._spindle = next((code for code in codes if code in ("M3", "M5")), self._spindle)
            if self.lit != before:
                self._note_light()
            if "X" in values:
                rate = self.settings[110] if motion == "G0" else min(feed, self.settings[110])
                step = 1 / self.settings[100]
                self._axis.go(round(values["X"] / step) * step, rate / 60, self.settings[120])
                self.ledger.append((time.monotonic(), "moved", values["X"]))
            self._say("ok")

        if {"G4", "M3", "M5"} & set(codes):
            self._waiting = carry_out  # Only when all motions are over.
        else:
            carry_out()
