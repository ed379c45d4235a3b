"""Things that are not files, in the place of files: links, pipes, devices, folders, gigabytes of nothing."""

import os
import random
import shutil
from pathlib import Path


def replace_place(rng: random.Random, path: Path, victim: Path) -> None:
    """Put something else in the place of a file.

    Args:
        path: An existing file.
        victim: A file outside, which nothing may read into a result, and nothing may change.
    """
    keep = path.with_name(path.name + ".kept") if rng.random() < 0.3 else None
    if keep is not None and not path.is_dir():
        shutil.copy(path, keep)
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()
    match rng.randrange(10):
        case 0 | 1 | 2:
            path.symlink_to(victim)
        case 3:
            path.symlink_to(victim.with_name("missing"))
        case 4:
            path.symlink_to(path)
        case 5:
            os.mkfifo(path)
        case 6:
            path.mkdir()
        case 7:
            path.symlink_to(rng.choice(("/dev/zero", "/dev/full", "/dev/tty", "/proc/self/mem", "/dev/null")))
        case 8:
            # Ten gigabytes that take no room on the disk.
            with open(path, "wb") as file:
                file.truncate(10 << 30)
        case _:
            pass


def strange_name(rng: random.Random) -> str:
    """A name that a file system, a terminal or a parser of words does not like."""
    return rng.choice(
        (
            *(
                "a" * 256,
                "a" * 5000,
                "",
                ".",
                "..",
                "-",
                "--help",
                "-o",
                "x\x1b[31m",
                "x\x9b0m",
                "x\ny",
                "x y",
                "x\udcff",
            ),
            *("x\u202e", "missing/x", "/dev/full", "/dev/null", "/proc/self/x", "x\0y", "CON", "~", "x" + "/y" * 600),
        )
    )
