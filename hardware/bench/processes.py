"""The bench's programs: built, started until they are ready, commanded over sockets, ended for certain."""

import contextlib
import fcntl
import os
import selectors
import shutil
import socket
import socketserver
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Self

from bench.places import BenchError


def launch(
    command: Sequence[str], *, folder: Path, errors: Path, within_s: float, apart: bool = False
) -> "subprocess.Popen[str]":
    """Start a program and wait until it prints a line that begins with "ready"; its stderr is appended to a file.

    Args:
        apart: Whether Ctrl-C at the terminal is kept from it, because its starter ends it in order.

    Raises:
        BenchError: With its last words, if it ends, says something else or takes longer; it is ended then.
    """
    with open(errors, "a") as stderr:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            start_new_session=apart,
        )
    try:
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            came = selector.select(within_s)
        line = process.stdout.readline() if came else ""
    except BaseException:
        # Ctrl-C, which may be kept from the program.
        end(process, kill=True)
        raise
    if line.startswith("ready"):
        return process
    end(process, kill=True)
    words = errors.read_text(errors="replace").strip().splitlines()
    name = Path(command[0]).name if len(command) < 3 or command[1] != "-m" else command[2]
    raise BenchError(f"{name} did not start: {words[-1] if words else 'it said nothing'}")


def end(process: "subprocess.Popen[str]", *, kill: bool = False) -> None:
    (process.kill if kill else process.terminate)()
    try:
        process.wait(15)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(5)
    process.stdout.close()


@contextmanager
def _short(path: Path) -> Iterator[str]:
    """A name of the socket that fits the 108 bytes of its address, however deep the folder is."""
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


class ControlClient:
    """A conversation with a control socket. Raises BenchError where nobody listens or answers."""

    def __init__(self, path: Path, *, timeout_s: float = 20.0) -> None:
        self._path, self._socket = path, socket.socket(socket.AF_UNIX)
        self._socket.settimeout(timeout_s)
        try:
            with _short(path) as name:
                self._socket.connect(name)
        except OSError as problem:
            self._socket.close()
            raise BenchError(f"{path}: nobody answers there: {problem.strerror}. Is the bench running?") from problem
        self._answers = self._socket.makefile()

    def ask(self, text: str) -> str:
        """Send one line, return the answer."""
        try:
            self._socket.sendall(text.encode() + b"\n")
            answer = self._answers.readline()
        except OSError as problem:
            raise BenchError(f"{self._path}: no answer to {text!r}: {problem}.") from problem
        if not answer.endswith("\n"):
            raise BenchError(f"{self._path}: hung up after {text!r}.")
        return answer.rstrip("\n")

    def close(self) -> None:
        self._answers.close()
        self._socket.close()


class Part:
    """A program of the bench in a folder of its own, switched on by `start` or `with`."""

    name: str
    socket: str

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        self.control_path = self.folder / self.socket
        self._errors = self.folder / f"{self.socket}.err"
        self._process: subprocess.Popen[str] | None = None
        self._control: ControlClient | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        raise NotImplementedError

    def ask(self, text: str) -> str:
        """Its answer to one command, see README.md. Raises BenchError if it is off, or does not answer."""
        if self._control is None:
            raise BenchError(f"{self.folder}: {self.name} is off.")
        return self._control.ask(text)

    def died(self) -> str:
        """How it ended by itself, as a sentence with its last words; "" if it runs or was switched off."""
        status = None if self._process is None else self._process.poll()
        if status is None:
            return ""
        words = self._errors.read_text(errors="replace").strip().splitlines() if self._errors.exists() else []
        how = f"killed by signal {-status}" if status < 0 else f"exit code {status}"
        return f"{self.name} has ended ({how})" + (f": {words[-1]}" if words and status > 0 else "")

    def close(self, *, kill: bool = False) -> None:
        """Switch off, or take the power away in the middle of any action. Doing so twice is doing it once."""
        process, self._process = self._process, None
        control, self._control = self._control, None
        if control is not None:
            control.close()
        if process is not None:
            end(process, kill=kill)
            # One that was killed left its socket.
            self.control_path.unlink(missing_ok=True)

    def _launch(self, command: Sequence[str], *, within_s: float, apart: bool) -> None:
        self._process = launch(command, folder=self.folder, errors=self._errors, within_s=within_s, apart=apart)
        self._control = ControlClient(self.control_path)

    def _require_off(self) -> None:
        if self._process is not None:
            raise BenchError(f"{self.folder}: {self.name} is on already.")


class ControlServer:
    """Answers at a socket, in threads of its own, until it is closed."""

    def __init__(self, path: Path, answer: Callable[[str], str]) -> None:
        """Listen at `path`, replacing an old socket; `answer` is called with each line, from several threads."""

        class Conversation(socketserver.StreamRequestHandler):
            def handle(self) -> None:
                # A client may hang up at any moment.
                with contextlib.suppress(OSError):
                    for line in self.rfile:
                        try:
                            said = answer(line.decode().strip())
                        except BenchError as problem:
                            said = f"error: {problem}"
                        self.wfile.write(said.encode() + b"\n")

        self._path = path
        path.unlink(missing_ok=True)
        with _short(path) as name:
            self._server = socketserver.ThreadingUnixStreamServer(name, Conversation)
        self._server.daemon_threads = True
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        self._path.unlink(missing_ok=True)
        self._server.shutdown()
        self._server.server_close()


HERE = Path(__file__).resolve().parent
FIRMWARE = HERE.parent / "firmware"
SIMRUN = HERE / "build" / "simrun"
IMAGES = {
    "scan": FIRMWARE / "build" / "scan.elf",
    "scan_hang": FIRMWARE / "build" / "scan_hang.elf",
    "echo": HERE / "build" / "echo.elf",
}
"""Firmware by name: the scanner's, the same with a command that hangs, and some other device."""


def missing_tools() -> list[str]:
    """Debian packages that are missing for building the rig."""
    needed = {
        "gcc-avr": shutil.which("avr-gcc"),
        "avr-libc": os.path.exists("/usr/lib/avr/include/avr/io.h"),
        "libsimavr-dev": os.path.exists("/usr/include/simavr/sim_avr.h"),
        "gcc": shutil.which("cc"),
        "make": shutil.which("make"),
    }
    return [package for package, there in needed.items() if not there]


@lru_cache
def build(firmware: str) -> Path:
    """Build the runner and one firmware, if they are older than their sources.

    Args:
        firmware: "scan", "scan_hang" or "echo".

    Returns:
        The firmware's image.

    Raises:
        BenchError: If a tool is missing or the build fails.
    """
    if firmware not in IMAGES:
        raise BenchError(f"There is no firmware {firmware!r}: choose one of {', '.join(IMAGES)}.")
    if missing := missing_tools():
        raise BenchError(f"The simulated rig needs {', '.join(missing)}: type `make bench-deps`.")
    (HERE / "build").mkdir(exist_ok=True)
    with open(HERE / "build" / ".lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        _make(HERE, "all")
        if firmware != "echo":
            _make(FIRMWARE, str(IMAGES[firmware].relative_to(FIRMWARE)))
    return IMAGES[firmware]


def _make(folder: Path, target: str) -> None:
    # A make that started these tests hands its own flags down; they are not for this one.
    clean = {name: value for name, value in os.environ.items() if name not in ("MAKEFLAGS", "MFLAGS", "MAKELEVEL")}
    command = ["make", "-s", "-C", str(folder), target]
    done = subprocess.run(command, capture_output=True, text=True, env=clean, timeout=300)
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-6:]
        raise BenchError(f"`make -C {folder} {target}` failed: {' | '.join(last)}")
