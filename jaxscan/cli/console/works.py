"""Calls other verbs in processes of their own, one after another: what they say is what a terminal would show."""

import os
import queue
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxscan.cli.console.captures import result_of
from jaxscan.cli.console.outliving import outlived
from jaxscan.cli.console.slate import Slate


_POLITE = 10
"""Niceness of the processes: the scan comes first."""
_LINES = 40
"""Last lines of a process that are kept."""
_FOUND = ("verdict", "lengths", "advice", "warnings", "missing", "points", "seconds_s", "notes", "errors")
"""What pages show of a result."""


class Work(NamedTuple):
    """A verb to call."""

    what: str
    """As pages name it."""
    words: Sequence[str]
    then: Callable[[bool, dict[str, Any]], None] = lambda well, result: None
    """Called with whether it went well, and its result."""


def keep(lines: list[str], line: str) -> None:
    """Take what a verb says into the lines that pages show.

    What to type next is no news on a page with buttons, and of the times that are left the newest counts.
    """
    if line.startswith("next: "):
        return
    if lines and lines[-1].endswith(" left") and line.endswith(" left"):
        lines.pop()
    lines.append(line)
    del lines[:-_LINES]


class Works:
    """Carries works out in a thread, and shows them on the slate; within `with`."""

    def __init__(self, slate: Slate) -> None:
        """Nothing is carried out yet."""
        self._slate = slate
        self._waiting: queue.SimpleQueue[Work | None] = queue.SimpleQueue()
        self._shown: list[dict[str, Any]] = []
        self._process: subprocess.Popen[str] | None = None
        self._ended = False
        self._busy = 0
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

    def begin(self, work: Work) -> None:
        """Carry a work out as soon as those before it are done."""
        self._busy += 1
        # What ended before is no news any more.
        self._slate.write(ended="", problem="")
        self._waiting.put(work)

    def _attend(self) -> None:
        while (work := self._waiting.get()) is not None and not self._ended:
            shown: dict[str, Any] = {"what": work.what, "running": True, "well": None, "lines": [], "result": {}}
            self._shown = [shown, *self._shown][:20]
            self._tell()
            self._slate.say(f"{work.what} begins.")
            # The works after it do not suffer from what happens to one.
            with outlived(self._slate, work.what):
                self._carry_out(work, shown)
            if shown["running"]:
                shown |= {"running": False, "well": False}
            self._busy -= 1
            self._tell()

    def _carry_out(self, work: Work, shown: dict[str, Any]) -> None:
        with tempfile.TemporaryDirectory() as folder:
            answer = Path(folder) / "answer.json"
            code = self._call([*work.words, "--json", str(answer)], shown["lines"])
            result = result_of(answer) if answer.exists() else {}
        shown |= {"running": False, "well": code == 0}
        if code == 0:
            self._slate.say(f"{work.what}: done.")
        else:
            self._slate.say(f"{work.what}: did not succeed; its last lines are under Calculations.", "problem")
        shown["result"] = {name: result[name] for name in _FOUND if name in result}
        if not self._ended:
            work.then(code == 0, result)

    def _call(self, words: Sequence[str], lines: list[str]) -> int:
        nowhere, pipe = subprocess.DEVNULL, subprocess.PIPE
        command = [sys.executable, "-P", "-m", "jaxscan.cli.main", *words]
        with subprocess.Popen(command, stdin=nowhere, stdout=pipe, stderr=subprocess.STDOUT, text=True) as process:
            self._process = process
            if hasattr(os, "setpriority"):
                os.setpriority(os.PRIO_PROCESS, process.pid, _POLITE)
            for line in process.stdout or ():
                keep(lines, line.rstrip())
                self._tell()
        return process.returncode

    def _tell(self) -> None:
        self._slate.write(works=[dict(one, lines=list(one["lines"])) for one in self._shown])
