"""Drives the rig in the main thread, by the orders of pages: one session at a time, those of `jaxscan scan`."""

import queue
import signal
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, NamedTuple

from jaxscan.cli.console.orders import Order
from jaxscan.cli.console.slate import Slate, one_line, outlived
from jaxscan.cli.console.watching import Painter, Silence
from jaxscan.cli.running import answer_in_words
from jaxscan.cli.signals import RigInUse
from jaxscan.cli.terminal import Terminal
from jaxscan.errors import JaxscanError, OptionError


if TYPE_CHECKING:
    from scanrig.config import RigConfig
    from scanrig.session import Devices, Wish

BUSY = "the rig is busy: stop or pause it first."
_ANSWERS = {"take", "enough", "enough of all"}
_WISHES = {"jog", "light", "expose", "auto"}
_BEGINS = {"aim": "Look", "sweep": "Scan", "boards": "Capture of the board"}
_AUTO_LOOKS = 8
"""Looks in which "auto" finds the exposure."""


class Running(NamedTuple):
    """A session that runs, and what belongs to it."""

    rig: "RigConfig"
    devices: "Devices"
    order: Order
    should_stop: Callable[[], bool]
    painter: Painter


Session = Callable[[Running], str]
"""Runs a session and returns a line on how it ended."""


class Desk:
    """Takes orders from any thread, and carries them out in the main thread."""

    def __init__(self, config: Path, slate: Slate, out: Terminal, port: str | None = None) -> None:
        """Nothing is opened yet; a serial port counts more than that in the configuration."""
        self.config, self.slate, self.out, self._port = config, slate, out, port
        self.sessions: dict[str, Session] = {}
        self.after: Callable[[], None] = lambda: None
        self.answer: Callable[[str], None] | None = None
        """Passes on what the person who places the board says, while somebody is asked."""
        self._orders: queue.SimpleQueue[Order | None] = queue.SimpleQueue()
        self._stopping = Stopping()
        self._pausing = threading.Event()
        self._lock = threading.Lock()
        self._doing = ""
        self._wish: Wish | None = None
        """Settings of the live picture while somebody aims; later sessions use its exposure too."""
        self.auto = 0
        """Number of looks for which "auto" still changes the exposure."""

    # For any thread

    def ask(self, order: Order) -> None:
        """Pass an order on.

        Raises:
            OptionError: If it cannot be carried out now.
        """
        if order.do == "stop":
            self._pausing.set()
            self._stopping.stop()
        elif order.do == "pause":
            self._pausing.set()
        elif order.do in _ANSWERS:
            if self.answer is None:
                raise OptionError("nobody asked for the board.")
            self.answer(order.do)
        elif order.do in _WISHES:
            self._want(order)
        else:
            self._begin(order)

    def wish(self) -> "Wish":
        """What is to be seen next while somebody aims."""
        from scanrig.session import Wish

        return self._wish or Wish()

    def expose(self, exposure_ms: float, gain_db: float) -> None:
        """Take frames with this exposure from now on.

        Raises:
            JaxscanError: If it is outside the range of the configuration.
        """
        from scanrig.config import load_rig, with_exposure

        with_exposure(load_rig(self.config), exposure_ms, gain_db)
        self._change(exposure_ms=exposure_ms, gain_db=gain_db)

    def _want(self, order: Order) -> None:
        if order.do != "expose" and self._doing != "aim":
            raise OptionError("press Look first: table and laser are moved by hand only while somebody looks.")
        self.auto = _AUTO_LOOKS if order.do == "auto" else 0
        match order.do:
            case "expose":
                self.expose(order.exposure_ms, order.gain_db)
            case "jog":
                self._change(angle_deg=order.deg)
            case "light":
                self._change(lit=order.on)
            case "auto":
                self.show_wish()

    def _change(self, **fields: Any) -> None:
        # "Auto" exposes in the main thread while a page turns the table.
        with self._lock:
            self._wish = self.wish()._replace(**fields)
        self.show_wish()

    def show_wish(self) -> None:
        """Show on the page what is to be seen next, and whether "auto" goes on."""
        wish = self.wish()
        self.slate.write(wish=wish._asdict() | {"auto": self.auto > 0})

    def leave(self) -> None:
        """End `attend` once nothing is done any more."""
        self._pausing.set()
        self._orders.put(None)

    def _begin(self, order: Order) -> None:
        with self._lock:
            if self._doing not in ("", "aim"):
                raise OptionError(BUSY)
            if self._doing == "aim":
                # Only looked at: the next session takes the rig over.
                self._pausing.set()
            self._doing = order.do
            # A look begins at home, with the laser.
            self._wish, self.auto = self.wish()._replace(angle_deg=0.0, lit=True), 0
            self._orders.put(order)
        self.show_wish()

    # For the main thread

    def attend(self) -> None:
        """Carry out orders until `leave`, or a signal."""
        from scanrig.controllers import UNCONFIRMED
        from scanrig.errors import Fault

        with self._stopping:
            finished = 0
            while (order := self._orders.get()) is not None:
                self._pausing.clear()
                self.slate.write(doing="opening", order=order._asdict(), problem="", ended="", estop=False)
                self.slate.say(" ".join(part for part in (_BEGINS[order.do], order.name) if part) + " begins.")
                said, problem = self._carry_out(order)
                with self._lock:
                    self._doing = self._doing if not self._orders.empty() else ""
                if problem:
                    self.slate.say(problem, "problem")
                else:
                    self.slate.say(said or f"{_BEGINS[order.do]} has ended.")
                if line := said or (f"jaxscan: {problem}" if problem else ""):
                    self.out.print(line)
                with outlived(self.slate, "the list of captures"):
                    self.after()
                finished += 1
                # The emergency stop is recognised by its words in the message on a fault.
                estop = f": {Fault.EMERGENCY_STOP};" in f"{said} {problem}"
                # Match the word with or without its capital. A doubt about the laser stays until the rig is
                # open again and may let it shine.
                doubt = UNCONFIRMED[1:] in f"{said} {problem}" or self.slate.read("laser") == "unknown"
                laser = "unknown" if doubt else "off"
                self.slate.write(
                    doing="nothing", problem=problem, ended=said, estop=estop, laser=laser, finished=finished
                )

    def notify(self, sentence: str) -> None:
        """A sentence that people should read."""
        self.out.print(sentence)
        self.slate.say(sentence, "retake" if " is taken again: " in sentence else "note")

    def _carry_out(self, order: Order) -> tuple[str, str]:
        """Run a session; returns how it ended, or why it could not."""
        try:
            return self._open_and_run(order), ""
        except KeyboardInterrupt as interrupt:
            said = str(interrupt)
            if not said.startswith(STOPPED):
                raise
            # The laser's doubt, if there is one, stands behind that word.
            doubt = said.removeprefix(STOPPED).lstrip(". ")
            return ("", f"Stopped. {doubt}") if doubt else ("Stopped: the laser is off.", "")
        except JaxscanError as problem:
            return "", one_line(problem)
        except Exception as problem:
            # The devices are closed; the next order finds the console alive.
            return "", answer_in_words(problem)

    def _open_and_run(self, order: Order) -> str:
        from scanrig.cameras import open_camera
        from scanrig.config import load_rig, with_exposure
        from scanrig.controllers import open_controller
        from scanrig.session import Devices, Interrupts

        # Read anew, so that what was advised and changed is used; what was set on the page counts more.
        rig, wish = load_rig(self.config), self.wish()
        if order.do != "aim" and wish.exposure_ms is not None and wish.gain_db is not None:
            rig = with_exposure(rig, wish.exposure_ms, wish.gain_db)
        with ExitStack() as stack:
            painter = stack.enter_context(Painter(rig, self.slate))
            with ExitStack() as opened:
                in_use = opened.enter_context(RigInUse())
                self._stopping.begin()
                opened.callback(self._stopping.end)
                turn = rig.microsteps_per_turn
                controller = opened.enter_context(open_controller(rig.controller, turn, port=self._port))
                camera = opened.enter_context(open_camera(rig.camera, self.notify))
                opened.callback(in_use.closing)
                opened.callback(self._stopping.end)
                interrupts = opened.enter_context(Interrupts())
                self.slate.write(doing=order.do, laser="may shine")
                opened.enter_context(Silence(self.slate, controller))
                should_stop = lambda: interrupts() or self._pausing.is_set()
                running = Running(rig, Devices(controller, camera), order, should_stop, painter)
                said = self.sessions[order.do](running)
            if interrupts.received:
                raise KeyboardInterrupt(interrupts.received[0])
            return said


STOPPED = "Stop on the page"
_SIGNAL = getattr(signal, "SIGUSR1", None)
"""Wakes the main thread from whatever it waits for; Windows has none."""
_AGAIN_S = 0.05


class Stopping:
    """Within `with`, `stop` raises KeyboardInterrupt in the main thread between `begin` and `end`. So another thread
    can end at once what the main thread does with the rig, as a second Ctrl-C does. The handler stays for the whole
    time, so that a signal that comes late does nothing.
    """

    def __init__(self) -> None:
        self._allowed = False
        self._session = self._asked = 0
        self._main = threading.main_thread().ident
        self._before: object = None

    def __enter__(self) -> "Stopping":
        if _SIGNAL is not None:
            self._before = signal.signal(_SIGNAL, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        if _SIGNAL is not None:
            signal.signal(_SIGNAL, self._before or signal.SIG_DFL)  # type: ignore[arg-type]

    def begin(self) -> None:
        """From now on an order to stop interrupts the main thread."""
        self._session += 1
        self._allowed = True

    def end(self) -> None:
        """From now on it does nothing: the devices are being closed."""
        self._allowed = False

    def stop(self) -> None:
        """Interrupt the main thread, from another one."""
        self._asked = self._session
        threading.Thread(target=self._insist, args=(self._session,), daemon=True).start()

    def _insist(self, session: int) -> None:
        """Send the signal until it was heard: one that comes in the moment before the main thread begins to wait does
        not end that wait.
        """
        while _SIGNAL is not None and self._main is not None and self._allowed and self._session == session:
            # Also where it waits for a port or a camera, which a flag would not end.
            signal.pthread_kill(self._main, _SIGNAL)
            time.sleep(_AGAIN_S)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        if self._allowed and self._asked == self._session:
            # Once: switching the laser off is not interrupted.
            self._allowed = False
            raise KeyboardInterrupt(STOPPED)
