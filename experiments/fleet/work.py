"""What a batch makes of two cores: copies of the demo's sweep, cloud and measures of each.

Each batch is the command `jaxscan batch`, after one that has compiled all code. Limit, stated before: two
workers do at least 1.7 times the work of one on one core.

    jaxscan demo -o demo
    python experiments/fleet/work.py demo [--copies 24]
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from jaxscan.project import Catalogue


LIMIT = 1.7
PROJECT = """[project]
name = "copies"
output = "{output}"
products = ["cloud", "measures"]
[[rig]]
name = "demo"
calibration = "calibration.json"
[[captures]]
pattern = "captures/*"
rig = "demo"
"""


def batch(home: Path, *, workers: int, cores: set[int]) -> tuple[float, float]:
    """Seconds of one batch from nothing, and of those the seconds that its steps were at work."""
    output = tempfile.mkdtemp(prefix="products-", dir=home)
    file = home / "project.toml"
    file.write_text(PROJECT.format(output=Path(output).name))
    words = [sys.executable, "-m", "jaxscan", "batch", str(file), "--workers", str(workers)]
    start = time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, preexec_fn=lambda: os.sched_setaffinity(0, cores))
    seconds = time.perf_counter() - start
    catalogue = Catalogue(Path(output, "catalogue.sqlite"), "copies")
    at_work = sum(row.seconds for row in catalogue.rows())
    catalogue.close()
    shutil.rmtree(output)
    return seconds, at_work


def measure_workers(home: Path, copies: int, cores: list[int]) -> dict[str, float]:
    """Seconds of all copies by one worker on one core, by one on two, and by two.

    Beside a capture's own work is a worker's time that no step has, the start of the batch among it.
    """
    found = {}
    for name, workers, own in (("one_one", 1, cores[:1]), ("one_two", 1, cores), ("two_two", 2, cores)):
        seconds, at_work = batch(home, workers=workers, cores=set(own))
        found[f"{name}_s"] = seconds
        beside = found[f"{name}_beside_s"] = (seconds * workers - at_work) / copies
        print(f"{workers} on {len(own)} cores: {seconds:.1f} s; for each capture {beside:.2f} s beside its own work")
    return found


def copies_of(demo: Path, home: Path, count: int) -> None:
    """Captures that share the bytes of the demo's sweep."""
    for path in demo.glob("calibration.*"):
        shutil.copy(path, home / path.name)
    for number in range(count):
        shutil.copytree(
            demo / "captures" / "sweep",
            home / "captures" / f"room-{number:02}",
            ignore=shutil.ignore_patterns("stripes.npz"),
            copy_function=os.link,
        )


def main() -> int:
    """Measure, print, and say whether the limit is kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("demo", type=Path, help="folder that `jaxscan demo` wrote")
    parser.add_argument("--copies", type=int, default=24)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))[:2]
    with tempfile.TemporaryDirectory(dir=given.demo) as name:
        home = Path(name)
        copies_of(given.demo, home, 1)
        batch(home, workers=1, cores=set(cores))
        shutil.rmtree(home / "captures")
        copies_of(given.demo, home, given.copies)
        times = measure_workers(home, given.copies, cores)
    gain = times["one_one_s"] / times["two_two_s"]
    print(f"two workers do {gain:.2f} times the work of one on one core, asked {LIMIT}")
    if given.json:
        given.json.write_text(json.dumps({"workers": times | {"gain": gain}}, indent=2) + "\n")
    return 0 if gain >= LIMIT else 1


if __name__ == "__main__":
    sys.exit(main())
