"""What a batch of many captures costs.

    python -m experiments.fleet scheduling [--quick] [--plot FILE]
    jaxscan demo -o demo
    python -m experiments.fleet work demo [--copies 24] [--json FILE]

scheduling: captures without work, from 10 to 10,000, on two workers of this machine, each number of them in a process
of its own. Captures that are folders with a header and a journal are found, their digests taken and compared with an
empty catalogue, each is handed to a worker that does nothing, and its row is written. Limits, stated before: 10,000
captures in 60 s and 1 GB, and time that grows linearly: from 1,000 to 10,000 not more than tenfold with a tenth to
spare.

work: what a batch makes of two cores: copies of the demo's sweep, cloud and measures of each. Every batch is the
command `jaxscan batch`, after one that has compiled all code. Limit, stated before: two workers do at least 1.7 times
the work of one on one core.
"""

import argparse
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from matplotlib.figure import Figure

from experiments.report import command_line, verb, write_json
from jaxscan.project import (
    Catalogue,
    Row,
    Status,
    begun_row,
    digests_of,
    load_project,
    open_catalogue,
    run_batch,
    states_of,
    steps_of,
)


COUNTS = 10, 100, 1000, 10_000
LIMIT_S, LIMIT_BYTES, LINEAR = 60.0, 1e9, 11.0
HEADER = """format = "jaxscan-capture/1"
kind = "sweep"
"""
PROJECT = """[project]
name = "{name}"
output = "{output}"
products = {products}
[[rig]]
name = "one"
calibration = "calibration.json"
[[captures]]
pattern = "{pattern}"
rig = "one"
"""


def do_nothing(status: Status, output: Path, progress: object) -> Row:
    """The row of a step whose work is empty; what a process does."""
    return begun_row(status)._replace(state="done")


class Silent:
    """Shows nothing."""

    def working(self, key: str, done: int, total: int) -> None:
        pass

    def finished(self, row: Row) -> None:
        pass


def hand_out(count: int) -> dict[str, float]:
    """Seconds of planning and of handing out so many captures, and the peak of this process [bytes]."""
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        for number in range(count):
            folder = home / "captures" / f"room-{number:05}"
            folder.mkdir(parents=True)
            (folder / "capture.toml").write_text(HEADER)
            (folder / "frames.jsonl").write_text(f'{{"i": {number}}}\n')
        (home / "calibration.json").write_text("{}")
        text = PROJECT.format(name="empty", output="products", products='["cloud"]', pattern="captures/*")
        (home / "project.toml").write_text(text)
        (home / "products").mkdir()
        start = time.perf_counter()
        project = load_project(home / "project.toml")
        catalogue = open_catalogue(project)
        steps = steps_of(project)
        states = states_of(steps, *digests_of(steps), catalogue.rows(), project.output)
        planned = time.perf_counter() - start
        start = time.perf_counter()
        run_batch(states, project.output, catalogue, Silent(), workers=2, work=do_nothing)
        handed_out = time.perf_counter() - start
        assert len(catalogue.rows()) == count
    peak = 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"captures": count, "planned_s": planned, "handed_out_s": handed_out, "peak_bytes": peak}


def scheduling(options: argparse.Namespace) -> bool:
    """Measure, print, draw, and say whether the limits are kept."""
    found = []
    for count in COUNTS[:-1] if options.quick else COUNTS:
        words = [sys.executable, "-m", "experiments.fleet", "scheduling", "--one", str(count)]
        ran = subprocess.run(words, capture_output=True, text=True, check=True)
        found.append(json.loads(ran.stdout.splitlines()[-1]))
        each = 1e3 * (found[-1]["planned_s"] + found[-1]["handed_out_s"]) / count
        print(
            f"{count:6} captures: planned in {found[-1]['planned_s']:.2f} s, handed out in "
            f"{found[-1]['handed_out_s']:.2f} s ({each:.2f} ms each), peak {found[-1]['peak_bytes'] / 1e6:.0f} MB"
        )
    if options.plot:
        draw(found, options.plot)
    *_, before, last = found
    seconds = [one["planned_s"] + one["handed_out_s"] for one in (before, last)]
    print(f"tenfold captures, {seconds[1] / seconds[0]:.1f}-fold time")
    return seconds[1] <= LIMIT_S and last["peak_bytes"] <= LIMIT_BYTES and seconds[1] / seconds[0] <= LINEAR


def draw(found: list[dict[str, float]], path: Path) -> None:
    """Time and memory against the number of captures."""
    captures = [one["captures"] for one in found]
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    left.loglog(captures, [one["planned_s"] for one in found], "o-", label="planned")
    left.loglog(captures, [one["handed_out_s"] for one in found], "s-", label="handed out and written down")
    left.axhline(LIMIT_S, color="0.6", linestyle=":", label="limit")
    left.set(xlabel="captures", ylabel="s")
    left.legend()
    right.semilogx(captures, [one["peak_bytes"] / 1e6 for one in found], "o-")
    right.set(xlabel="captures", ylabel="peak memory of the batch's process, MB", ylim=(0, None))
    figure.savefig(path, dpi=110)


WORKERS_LIMIT = 1.7


def batch(home: Path, pattern: str, *, workers: int, cores: set[int]) -> tuple[float, float]:
    """Seconds of one batch from nothing, and of those the seconds that its steps were at work."""
    output = Path(tempfile.mkdtemp(prefix="products-", dir=home))
    file = home / "project.toml"
    products = '["cloud", "measures"]'
    file.write_text(PROJECT.format(name="copies", output=output.name, products=products, pattern=pattern))
    ran = verb("batch", file, "--workers", str(workers), cores=cores)
    if ran.code:
        raise SystemExit(f"jaxscan batch: exit code {ran.code}: {ran.problem[-2000:]}")
    catalogue = Catalogue(output / "catalogue.sqlite", "copies")
    at_work = sum(row.seconds for row in catalogue.rows())
    catalogue.close()
    shutil.rmtree(output)
    return ran.wall_s, at_work


def measure_workers(home: Path, copies: int, cores: list[int]) -> dict[str, float]:
    """Seconds of all copies by one worker on one core, by one on two, and by two.

    Beside a capture's own work is a worker's time that no step has, the start of the batch among it.
    """
    found = {}
    for name, workers, own in (("one_one", 1, cores[:1]), ("one_two", 1, cores), ("two_two", 2, cores)):
        seconds, at_work = batch(home, "captures/*", workers=workers, cores=set(own))
        found[f"{name}_s"] = seconds
        beside = found[f"{name}_beside_s"] = (seconds * workers - at_work) / copies
        print(f"{workers} on {len(own)} cores: {seconds:.1f} s; for each capture {beside:.2f} s beside its own work")
    found["gain"] = found["one_one_s"] / found["two_two_s"]
    print(f"two workers do {found['gain']:.2f} times the work of one on one core, limit {WORKERS_LIMIT}")
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


def work(options: argparse.Namespace) -> bool:
    """Measure, print, and say whether the limit is kept."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    with tempfile.TemporaryDirectory(dir=options.demo) as folder:
        home = Path(folder).resolve()
        copies_of(options.demo, home, options.copies)
        batch(home, "captures/room-00", workers=1, cores=set(cores))
        found = measure_workers(home, options.copies, cores)
    write_json(options.json, {"workers": found})
    return found["gain"] >= WORKERS_LIMIT


def main() -> int:
    """The command."""
    parser = command_line(__doc__)
    parts = parser.add_subparsers(dest="part", required=True)
    first = parts.add_parser("scheduling")
    first.add_argument("--quick", action="store_true", help="only up to 1,000 captures")
    first.add_argument("--plot", type=Path, help="picture to write")
    first.add_argument("--one", type=int, help=argparse.SUPPRESS)
    second = parts.add_parser("work")
    second.add_argument("demo", type=Path, help="folder that `jaxscan demo` wrote")
    second.add_argument("--copies", type=int, default=24)
    second.add_argument("--json", type=Path)
    options = parser.parse_args()
    if getattr(options, "one", None):
        print(json.dumps(hand_out(options.one)))
        return 0
    kept = scheduling(options) if options.part == "scheduling" else work(options)
    print(f"limits {'kept' if kept else 'MISSED'}")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
