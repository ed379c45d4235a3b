"""The controller in a few lines of Python, on a clock that tests move: for the host's logic, not for the rig's truth.

Assertions about a rig belong on `SimulatedRig`, which runs the real firmware.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from scanrig.clock import Clock, rfc3339
from scanrig.controllers.jxs.protocol import ABORT, crc, seal
from scanrig.errors import LinkLost


ANSWER_S = 0.002
"""From question to answer."""
ARMED_IDLE_S = 10.0
"""Without a line, after which the contactor opens while nothing runs; or the watchdog's time, where that is longer."""

DEFAULTS = {
    "motion": {"wd": 500, "vmax": 4000, "vst": 400, "acc": 8000, "hv": 200, "back": 0, "dir": 0},
    "shot": {"settl": 50, "lon": 20, "loff": 20, "exp": 10, "gap": 5, "rdy": 0, "smin": -(2**31), "smax": 2**31 - 1},
}

Mangle = Callable[[bytes], bytes]


@dataclass
class ManualClock(Clock):
    """A clock that moves only when `sleep` is called or `time_s` is set."""

    time_s: float = 0.0
    start: datetime = datetime(2000, 1, 1, tzinfo=UTC)

    def now(self) -> float:
        return self.time_s

    def utc(self) -> str:
        return rfc3339(self.start + timedelta(seconds=self.time_s))

    def sleep(self, s: float) -> None:
        self.time_s += max(s, 0.0)


@dataclass
class FakeController:
    """A Link with a controller at its end. Everything in it may be looked at and changed."""

    clock: ManualClock = field(default_factory=ManualClock)
    name: str = "fake"
    boot: int = 7
    proto: int = 1
    to_controller: Mangle = lambda data: data
    """Changes bytes on their way in."""
    to_host: Mangle = lambda data: data
    """Changes a line on its way out."""
    unplugged: bool = False
    estop: bool = False
    switch: bool = True
    """Whether there is a home switch."""
    position: int = 500
    """Of the table, from the switch."""

    turn: int | None = None
    """Microsteps after which the switch comes again; None: it is nowhere else."""
    slips: int = 0
    """Microsteps that a homing stops beside the switch."""
    lasers: int = 2

    def __post_init__(self) -> None:
        self.carried_out: list[str] = []
        self.seconds_between_lines = 0.0
        self.pulses = 0
        self.exposures = 0
        self.reset(self.boot)

    def reset(self, boot: int | None = None) -> None:
        """The state after a reset; BOOT is sent."""
        self.boot = self.boot + 1 if boot is None else boot
        self.settings = {part: dict(values) for part, values in DEFAULTS.items()}
        self.counter = 0
        self.fault = 0
        self.state = "idle"
        self.homed = self.armed = self.enabled = self.laser = self.session = False
        self.was = 0
        self.pulse_ends_s = 0.0
        self.events = 0
        self.last: tuple[int, bytes] = (0, b"")
        self._line = b""
        self.out = b""
        self.due: tuple[float, Callable[[], None]] | None = None
        self._fed = self.clock.now()
        self.tell(f"BOOT why=1 boot={self.boot}")

    # Link

    def write(self, data: bytes) -> None:
        """Bytes from the host."""
        if self.unplugged:
            raise LinkLost(f"{self.name} went away (unplugged)") from OSError(5, "unplugged")
        self._run()
        for byte in self.to_controller(data):
            if byte == ABORT[0]:
                self._line = b""
                self.fail(5)
            elif byte == ord("\n"):
                line, self._line = self._line, b""
                if line:
                    self._take(line)
            else:
                self._line += bytes([byte])

    def read(self, timeout_s: float) -> bytes:
        """Bytes to the host; the clock moves on meanwhile."""
        if self.unplugged:
            raise LinkLost(f"{self.name} went away (unplugged)") from OSError(5, "unplugged")
        self._run()
        if not self.out and self.due and self.due[0] <= self.clock.now() + timeout_s:
            self.clock.sleep(self.due[0] - self.clock.now())
            self._run()
        if not self.out:
            self.clock.sleep(timeout_s)
            return b""
        self.clock.sleep(ANSWER_S)
        out, self.out = self.out, b""
        return out

    def close(self) -> None:
        """Nothing."""

    # Controller

    def tell(self, text: str) -> None:
        """An event."""
        self.events = self.events % 65535 + 1
        self.say(seal(f"!{self.events} {text}"))

    def press(self, pressed: bool) -> None:
        """The emergency stop."""
        self.estop = pressed
        if pressed:
            self.fail(1)

    def say(self, line: bytes) -> None:
        """A whole line, as the firmware puts it on the wire."""
        heard = self.to_host(line)
        self.out += heard

    def _run(self) -> None:
        now, patience = self.clock.now(), self.settings["motion"]["wd"] / 1000
        busy_until = now if self.laser or self.due is not None else min(now, self.pulse_ends_s)
        if busy_until - self._fed > patience:
            self.fail(2)
        if self.state == "idle" and now - self._fed >= max(ARMED_IDLE_S, patience):
            self.armed = False
        if self.due and self.clock.now() >= self.due[0] - 1e-9:
            _, finish = self.due
            self.due = None
            self.state = "idle"
            finish()

    def fail(self, fault: int) -> None:
        """A fault, as the firmware makes one."""
        self.due = None
        self.laser = self.armed = False
        self.fault, self.state = fault, "fault"
        if fault == 1:
            self.homed = self.enabled = False
        self.tell(f"FAULT f={fault} pos={self.counter}")

    def _take(self, line: bytes) -> None:
        body, star, digits = line.rpartition(b"*")
        if len(line) > 96 or not star or digits != b"%04X" % crc(body) or not body.startswith(b"@"):
            self.say(seal("=? err 10" if len(line) > 96 else "=? err 2"))
            return
        number, _, text = body.decode("ascii")[1:].partition(" ")
        seq = int(number)
        if self.due or self.laser:
            self.seconds_between_lines = max(self.seconds_between_lines, self.clock.now() - self._fed)
        self._fed = self.clock.now()
        verb, *words = text.split()
        if seq == self.last[0] and verb != "HELLO":
            self.say(self.last[1])
            return
        self.carried_out.append(text)
        said = self._carry_out(verb, {key: int(value) for key, value in (word.split("=") for word in words)}, seq)
        reply = seal(f"={seq} err {said}" if isinstance(said, int) else f"={seq} ok{said}")
        self.last = (seq, reply)
        self.say(reply)

    def _carry_out(self, verb: str, args: dict[str, int], seq: int) -> str | int:
        """The fields of the answer, or an error."""
        match verb:
            case "HELLO":
                self.session, self.laser, self.armed, self.events = True, False, False, 0
                return f" proto={self.proto} fw=9.9.9 boot={self.boot} lease=1000 buf=96"
            case "STAT":
                inputs = int(self.position <= 0 and self.switch) + 2 * self.estop
                return (
                    f" st={self.state} f={self.fault} pos={self.counter} hm={self.homed:d} arm={self.armed:d} "
                    f"en={self.enabled:d} las={bool(self.laser):d} le=0 trg={self.exposures % 65536} in={inputs} "
                    f"ev={self.events}"
                )
            case "CNT":
                up = int(self.clock.now() * 1000)
                return f" crc=0 over=0 dup=0 las={self.pulses} up={up} wdr=0 was={self.was}"
            case "HAS":
                return f" las={self.lasers}"
            case "CFG":
                part = self.settings["shot" if args.get("shot") else "motion"]
                return "".join(f" {key}={value}" for key, value in part.items())
            case "SET":
                for part in self.settings.values():
                    part.update({key: value for key, value in args.items() if key in part})
                return ""
            case "STOP":
                self.laser, self.due = False, None
                self.state = "idle" if self.state != "fault" else "fault"
                return ""
            case "CLEAR":
                if self.estop:
                    return 6
                self.fault, self.state = 0, "idle"
                return ""
            case "ARM" | "LASER" if not args["on"]:
                self.laser = False
                self.armed = self.armed and verb != "ARM"
                return ""
        if self.fault:
            return 6
        if verb != "EN" and not self.session:
            return 9
        if self.state != "idle":
            return 5
        return self._act(verb, args, seq)

    def _act(self, verb: str, args: dict[str, int], seq: int) -> str | int:
        match verb:
            case "EN":
                self.enabled = bool(args["on"])
                self.homed = self.homed and self.enabled
            case "ARM":
                self.armed = True
            case "LASER" if self.armed:
                self.pulses += not self.laser
                self.laser = args.get("n", 1)
            case "TRIG":
                self.pulse_ends_s = self.clock.now() + self.settings["shot"]["exp"] / 1000
                self.expose()
            case "LASER":
                return 14
            case _ if not self.enabled:
                return 11
            case "MOVE":
                self._begin("move", args["to"], lambda: self.tell(f"DONE seq={seq} pos={self.counter}"))
            case "HOME" if not self.switch or self._above_switch() > args["max"]:
                self._begin("home", self.counter - args["max"], lambda: self.fail(4))
            case "HOME":
                self._begin("home", self.counter - self._above_switch(), lambda: self._homed(seq))
            case "SHOT" if not self.homed:
                return 8
            case "SHOT" if args["m"] & 1 and not self.armed:
                return 14
            case "SHOT":
                self._begin("shot", args["to"], lambda: self._shot(**args))
            case _:
                return 3
        return ""

    def _begin(self, state: str, to: int, finish: Callable[[], None]) -> None:
        steps = to - self.counter

        def arrive() -> None:
            self.position += steps
            self.counter += steps
            finish()

        self.state = state
        self.due = (self.clock.now() + 0.1 + abs(steps) / 4000, arrive)

    def _above_switch(self) -> int:
        return self.position if self.turn is None else self.position % self.turn

    def expose(self) -> None:
        """A pulse at the camera."""
        self.exposures += 1

    def _homed(self, seq: int) -> None:
        self.position += self.slips
        self.was, self.counter, self.homed = self.counter, 0, True
        self.tell(f"HOMED seq={seq} was={self.was}")

    def _shot(self, id: int, m: int, to: int, n: int = 1) -> None:
        self.pulses += m & 1
        for lit in (n, 0)[1 - (m & 1) : 1 + (m >> 1)]:
            self.laser = lit
            self.expose()
        self.laser = False
        self.tell(f"SHOT id={id} pos={self.counter} trg={self.exposures % 65536}")
