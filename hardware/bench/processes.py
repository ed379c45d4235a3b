"""Programs of the bench: started until they say that they are ready, and ended for certain."""

import selectors
import subprocess
from collections.abc import Sequence
from pathlib import Path

from bench.errors import BenchError


def launch(
    command: Sequence[str], *, folder: Path, errors: Path, within_s: float, apart: bool = False
) -> "subprocess.Popen[str]":
    """Start a program and wait until it prints a line that begins with "ready".

    Args:
        command: The program with its arguments.
        errors: File to which its stderr is appended.
        within_s: How long that may take.
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
    if process.stdout is None:
        raise BenchError("A program without an output cannot say that it is ready.")
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


def epitaph(name: str, process: "subprocess.Popen[str] | None", errors: Path) -> str:
    """How a program ended by itself, as a sentence with its last words; "" if it runs, or there is none."""
    status = None if process is None else process.poll()
    if status is None:
        return ""
    words = errors.read_text(errors="replace").strip().splitlines() if errors.exists() else []
    how = f"killed by signal {-status}" if status < 0 else f"exit code {status}"
    return f"{name} has ended ({how})" + (f": {words[-1]}" if words and status > 0 else "")


def end(process: "subprocess.Popen[str]", *, kill: bool = False) -> None:
    """End a program: asked first, unless `kill`, and by force where that does not help."""
    if kill:
        process.kill()
    else:
        process.terminate()
    try:
        process.wait(15)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(5)
    if process.stdout is not None:
        process.stdout.close()
