"""Builds firmware and runner when they are needed, one process at a time."""

import fcntl
import os
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path

from bench.errors import BenchError


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
