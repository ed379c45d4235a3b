"""What is calculated and made of captures: other verbs in processes of their own, one after another, so that what they
say is what a terminal would show; and changes in the folder of captures."""

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from jaxscan import api
from jaxscan.cli.console.captures import Captures, captures_of, verdict_of
from jaxscan.cli.console.orders import Order
from jaxscan.cli.console.slate import Slate, outlived
from jaxscan.errors import JaxscanError, OptionError, OutputError
from jaxscan.files.calibration import calibration_digest
from jaxscan.files.disk import read_bounded


ORDERS = {"calibrate", "recalibrate", "reconstruct", "plan", "mesh", "report", "compare", "use", "delete", "rename"}
_POLITE = 10
"""Niceness of the processes: the scan comes first."""
_LINES = 40
_MOST_SHOWN, _MOST_BYTES = 20, 64 << 20
_FOUND = ("verdict", "lengths", "advice", "warnings", "missing", "points", "seconds_s", "notes", "errors")
Then = Callable[[bool, dict[str, Any]], None]
"""Called after a verb with its success and its result."""


class Work(NamedTuple):
    """A verb to call."""

    what: str
    words: Sequence[str]
    then: Then = lambda well, result: None
    so_far: bool = False
    """Whether the work belongs to a capture that is still growing; it gives way to the next such work."""


class Works:
    """Carries works out in a thread, and shows them on the slate; within `with`."""

    def __init__(self, slate: Slate, captures: Captures, calibration: Path | None = None) -> None:
        """Nothing is carried out yet.

        Args:
            slate: Where people see it.
            captures: Of which all is made.
            calibration: The calibration with which clouds are made, until there is a better one.
        """
        self._slate, self._captures, self.calibration = slate, captures, calibration
        self._waiting: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._shown: list[dict[str, Any]] = []
        self._process: subprocess.Popen[str] | None = None
        self._carried: Work | None = None
        self._ended, self._busy, self._given_way = False, 0, False
        self._thread = threading.Thread(target=self._attend, name="jaxscan-works", daemon=True)

    def __enter__(self) -> "Works":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended = True
        self._waiting.put(None)
        if self._process is not None:
            self._process.kill()
        self._thread.join()

    @property
    def busy(self) -> bool:
        """Whether a work is carried out or waits."""
        return self._busy > 0

    def carry_out(self, order: Order, of: str = "") -> None:
        """Begin a verb, or change the folder.

        Args:
            order: One of `ORDERS`.
            of: Of which part of a capture, as pages name it.

        Raises:
            JaxscanError: If that cannot be done now.
        """
        captures, name = self._captures, order.name
        path, cloud = str(captures.path(name)), str(captures.cloud(name))
        known = [] if self.calibration is None else ["-c", str(self.calibration)]
        match order.do:
            case "calibrate":
                file = captures.calibration(name)
                judged = self._judged(name, file, so_far=bool(of))
                self._call_verb("calibrate", name, [path, "-o", str(file)], judged, of=of)
            case "recalibrate":
                file = captures.path(f"{name}.recalibrated.json")
                words = [path, "-c", str(self._before(name)), "-o", str(file)]
                self._call_verb("recalibrate", name, words, self._judged(name, file))
            case "reconstruct":
                self._call_verb("reconstruct", name, [path, "-c", str(self._needed()), "-o", cloud])
            case "plan":
                self._call_verb("plan", name, [cloud, *known, "--name", name, "-o", str(captures.made(name, "plan"))])
            case "mesh":
                texture = ["--texture", path, "-c", str(self._needed())]
                self._call_verb("mesh", name, [cloud, *texture, "-o", str(captures.made(name, "mesh"))])
            case "report":
                self._call_verb("report", name, [cloud, "-o", str(captures.made(name, "report"))])
            case "compare":
                words = ["measure", "compare", cloud, str(captures.cloud(order.other))]
                self.begin(Work(f"compare {name} with {order.other}", words))
            case "use":
                self._use(name)
            case "delete" | "rename":
                self._change(order)

    def _call_verb(self, verb: str, name: str, words: list[str], then: Then | None = None, *, of: str = "") -> None:
        what = f"{verb} {name}" + (f", {of}" if of else "")
        self.begin(Work(what, [verb, *words], then or (lambda well, result: self.refresh()), so_far=bool(of)))

    def _needed(self) -> Path:
        if self.calibration is None:
            raise OptionError("there is no calibration yet: capture the board first, or begin with --calibration.")
        return self.calibration

    def _before(self, name: str) -> Path:
        """The calibration in use. If this sweep has refined it already, the one before that."""
        file = self._needed()
        while name in captures_of((found := api.load_calibration(file)).provenance):
            origin = found.provenance.get("calibration")
            digest = origin.get("digest") if isinstance(origin, dict) else None
            before = self._captures.calibration_of(digest) if isinstance(digest, str) else None
            if before is None:
                raise OptionError(
                    f"{file.name}: is made of {name} already, and the calibration before it is not in the folder; "
                    "choose another one under Calibration."
                )
            file = before
        return file

    def _judged(self, name: str, file: Path, *, so_far: bool = False) -> Then:
        """What follows a calibration: its verdict is shown, and a good one is used; one of the poses so far takes no
        other one's place."""

        def then(well: bool, result: dict[str, Any]) -> None:
            if well and so_far and self.calibration not in (None, file):
                self._slate.write(verdict={"well": True, "so_far": name} | verdict_of(api.load_calibration(file)))
            elif well:
                self.take(file)
            elif result:
                told = {key: result.get(key) for key in ("verdict", "advice", "warnings")}
                # The JSON of a recalibration that gained nothing has another form.
                told["lengths"] = [one for one in result.get("lengths") or [] if "what" in one]
                self._slate.write(verdict={"capture": name, "well": False} | told)
            self.refresh()

        return then

    def _use(self, file: str) -> None:
        found = next((one for one in self._captures.calibrations() if one["file"] == file), None)
        if found is None or not found["good"]:
            raise OptionError(f"{file}: is no calibration of this rig that may be used.")
        self.take(self._captures.folder_of(found) / file)
        self.refresh()

    def take(self, file: Path) -> None:
        """Make clouds with a calibration from now on, and show its verdict."""
        self.calibration = file
        self._slate.write(calibration=str(file), verdict={"well": True} | verdict_of(api.load_calibration(file)))

    def _change(self, order: Order) -> None:
        """Delete or rename a capture with what was made of it."""
        # Not while somebody looks either: large folders take a while, and Stop would wait.
        if self._slate.read("doing") != "nothing" or self.busy:
            raise OptionError("something is captured or calculated: wait until it is done.")
        if order.do == "delete":
            self._captures.delete(order.name)
            self._slate.say(f"{order.name} was deleted.")
        else:
            self._captures.rename(order.name, order.other)
            self._slate.say(f"{order.name} is called {order.other} now.")
        self.refresh()

    def refresh(self) -> None:
        """Show the captures in the folder, and the space that is left."""
        from scanrig.recording import free_bytes

        folder = self._captures.folder.absolute()
        digest = ""
        # A file that is gone makes no cloud old.
        if self.calibration is not None:
            with suppress(JaxscanError):
                digest = calibration_digest(self.calibration)
        self._slate.write(
            captures=self._captures.listed(),
            calibrations=self._captures.calibrations(),
            calibration_digest=digest,
            free_bytes=free_bytes(next(path for path in (folder, *folder.parents) if path.exists())),
        )

    def begin(self, work: Work) -> None:
        """Carry a work out as soon as those before it are done."""
        self._busy += 1
        # Results of works that ended before are dropped.
        self._slate.write(ended="", problem="")
        self._waiting.put(work)
        if self._carried is not None and self._carried.so_far and self._process is not None:
            self._given_way = True
            self._process.terminate()

    def _attend(self) -> None:
        while (work := self._waiting.get()) is not None and not self._ended:
            shown: dict[str, Any] = {"what": work.what, "running": True, "well": None, "lines": [], "result": {}}
            self._shown = [shown, *self._shown][:_MOST_SHOWN]
            self._show()
            self._slate.say(f"{work.what} begins.")
            # An error in one work must not stop those after it.
            with outlived(self._slate, work.what):
                self._carried, self._given_way = work, False
                self._carry_out(work, shown)
            self._carried = None
            if self._given_way:
                self._shown.remove(shown)
            if shown["running"]:
                shown |= {"running": False, "well": False}
            self._busy -= 1
            self._show()

    def _carry_out(self, work: Work, shown: dict[str, Any]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            answer = Path(folder) / "answer.json"
            code = self._call([*work.words, "--json", str(answer)], shown["lines"])
            result = json.loads(read_bounded(answer, _MOST_BYTES, error=OutputError)) if answer.exists() else {}
        if self._given_way:
            self._slate.say(f"{work.what}: gave way to the next one.")
            return
        shown |= {"running": False, "well": code == 0}
        if code == 0:
            self._slate.say(f"{work.what}: done.")
        else:
            self._slate.say(f"{work.what}: did not succeed; its last lines are under Calculations.", "problem")
        shown["result"] = {name: result[name] for name in _FOUND if name in result}
        if not self._ended:
            work.then(code == 0, result)

    def _call(self, words: Sequence[str], lines: list[str]) -> int:
        command = [sys.executable, "-P", "-m", "jaxscan.cli.main", *words]
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        ) as process:
            self._process = process
            if hasattr(os, "setpriority"):
                os.setpriority(os.PRIO_PROCESS, process.pid, _POLITE)
            for line in process.stdout or ():
                keep(lines, line.rstrip())
                self._show()
        return process.returncode

    def _show(self) -> None:
        self._slate.write(works=[dict(one, lines=list(one["lines"])) for one in self._shown])


def keep(lines: list[str], line: str) -> None:
    """Take what a verb says into the lines that pages show.

    Hints on what to type next are dropped, as a page has buttons; of remaining times only the newest is kept.
    """
    if line.startswith("next: "):
        return
    if lines and lines[-1].endswith(" left") and line.endswith(" left"):
        lines.pop()
    lines.append(line)
    del lines[:-_LINES]
