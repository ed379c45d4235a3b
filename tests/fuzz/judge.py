"""The verdict on one case: what a program may not do, whatever it was given."""

import hashlib
import os
import re
import stat
import unicodedata
from pathlib import Path


MAX_SECONDS = 30.0
MAX_BYTES = 1_500_000_000
_COMMANDS = ("Cc", "Cf", "Cs", "Co", "Zl", "Zp")


def snapshot(folder: Path) -> dict[str, str]:
    """Kind and content of everything below a folder, by its name there."""
    found = {}
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = os.path.join(place, name)
            status = os.lstat(path)
            if stat.S_ISLNK(status.st_mode):
                content = f"link {os.readlink(path)}"
            elif stat.S_ISREG(status.st_mode):
                content = f"file {status.st_size} {_digest(path, status.st_size)}"
            else:
                content = f"kind {stat.S_IFMT(status.st_mode):o}"
            found[os.path.relpath(path, folder)] = content
    return found


def _digest(path: str, size: int) -> str:
    if size > 1 << 28:
        return "sparse"
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "md5").hexdigest()


def verdict(code: int | None, out: bytes, err: bytes, seconds: float, peak: int) -> list[str]:
    """The faults of a run, by kind.

    Args:
        code: Exit code; None where an exception came out of the program.
        out: Standard output.
        err: Standard error.
        seconds: Time that it took.
        peak: Largest memory that the process had in this time [bytes].
    """
    faults = []
    text = err.decode("utf-8", "surrogateescape")
    # 70: an unexpected exception, caught by the last net.
    if code is None or code not in (0, 1, 2) or "Traceback (most recent" in text:
        faults.append("traceback")
    if seconds > MAX_SECONDS:
        faults.append("hang")
    if peak > MAX_BYTES:
        faults.append("memory")
    if any(_is_command(one) for data in (out, err) for one in data.decode("utf-8", "surrogateescape")):
        faults.append("terminal")
    lines = [line for line in text.splitlines() if not _PROGRESS.fullmatch(line)]
    if code == 1 and (len(lines) != 1 or not lines[0].startswith("jaxscan: ")):
        faults.append("lines")
    if code == 0 and lines:
        faults.append("lines")
    return faults


_PROGRESS = re.compile(r"\w+: \d+ %, about .* left")
"""How far work of some seconds is, on standard error that is no terminal."""


def _is_command(character: str) -> bool:
    return character != "\n" and unicodedata.category(character) in _COMMANDS


def changes(before: dict[str, str], after: dict[str, str], allowed: set[str]) -> list[str]:
    """Names that were changed, removed or left behind, but for those that may be written."""
    names = before.keys() | after.keys()
    return sorted(
        f"{name}: {before.get(name, 'nothing')} -> {after.get(name, 'nothing')}"
        for name in names
        if before.get(name) != after.get(name) and not any(name == one or name.startswith(one + "/") for one in allowed)
    )
