"""What handing out a batch costs: captures without work, from 10 to 10,000, on two workers of this machine.

Each number of captures is one batch in a process of its own: captures that are folders with a header and a journal
are found, their digests taken and compared with an empty catalogue, each is handed to a worker that does nothing, and
its row is written. Limits, stated before: 10,000 captures in 60 s and 1 GB, and time that grows linearly: from 1,000
to 10,000 not more than tenfold with a tenth to spare.

    python experiments/fleet/scheduling.py [--quick] [--plot FILE]
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import matplotlib


matplotlib.use("agg")

from matplotlib import pyplot as plt

from jaxscan.fleet.batch import run_batch
from jaxscan.fleet.cluster import open_cluster
from jaxscan.project import (
    Order,
    Row,
    digests_of,
    load_project,
    open_catalogue,
    order_of,
    row_to_json,
    states_of,
    steps_of,
)


COUNTS = 10, 100, 1000, 10_000
LIMIT_S, LIMIT_BYTES, LINEAR = 60.0, 1e9, 11.0
HEADER = """format = "jaxscan-capture/1"
kind = "sweep"
"""
PROJECT = """[project]
name = "empty"
products = ["cloud"]
[[rig]]
name = "one"
calibration = "calibration.json"
[[captures]]
pattern = "captures/*"
rig = "one"
"""


def do_nothing(text: str) -> str:
    """The row of a step whose work is empty; what a worker does."""
    order = Order.from_json(text)
    return row_to_json(Row(order.step.key, order.digest, "done", "", order.parts, (), time.time(), 0.0, "", ""))


class Silent:
    """Shows nothing."""

    def working(self, key: str, done: int, total: int) -> None:
        pass

    def finished(self, row: Row) -> None:
        pass


def measure(count: int) -> dict[str, float]:
    """Seconds of planning and of handing out so many captures, and the peak of this process [bytes]."""
    with tempfile.TemporaryDirectory() as name:
        home = Path(name)
        for number in range(count):
            folder = home / "captures" / f"room-{number:05}"
            folder.mkdir(parents=True)
            (folder / "capture.toml").write_text(HEADER)
            (folder / "frames.jsonl").write_text(f'{{"i": {number}}}\n')
        (home / "calibration.json").write_text("{}")
        (home / "project.toml").write_text(PROJECT)
        (home / "products").mkdir()
        start = time.perf_counter()
        project = load_project(home / "project.toml")
        catalogue = open_catalogue(project)
        steps = steps_of(project)
        states = states_of(steps, *digests_of(steps), catalogue.rows(), project.output)
        todo = [order_of(status, project.output) for status in states]
        planned = time.perf_counter() - start
        with open_cluster(workers=2) as client:
            start = time.perf_counter()
            run_batch(todo, catalogue, client, Silent(), work=do_nothing)
            handed_out = time.perf_counter() - start
        assert len(catalogue.rows()) == count
    peak = 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"captures": count, "planned_s": planned, "handed_out_s": handed_out, "peak_bytes": peak}


def main() -> int:
    """Measure, print, draw, and say whether the limits are kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="only up to 1,000 captures")
    parser.add_argument("--plot", type=Path, help="picture to write")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(given.one)))
        return 0
    found = []
    for count in COUNTS[:-1] if given.quick else COUNTS:
        words = [sys.executable, __file__, "--one", str(count)]
        ran = subprocess.run(words, capture_output=True, text=True, check=True)
        found.append(json.loads(ran.stdout.splitlines()[-1]))
        each = 1e3 * (found[-1]["planned_s"] + found[-1]["handed_out_s"]) / count
        print(
            f"{count:6} captures: planned in {found[-1]['planned_s']:.2f} s, handed out in "
            f"{found[-1]['handed_out_s']:.2f} s ({each:.2f} ms each), peak {found[-1]['peak_bytes'] / 1e6:.0f} MB"
        )
    if given.plot:
        draw(found, given.plot)
    *_, before, last = found
    seconds = [one["planned_s"] + one["handed_out_s"] for one in (before, last)]
    kept = seconds[1] <= LIMIT_S and last["peak_bytes"] <= LIMIT_BYTES and seconds[1] / seconds[0] <= LINEAR
    print(f"tenfold captures, {seconds[1] / seconds[0]:.1f}-fold time; limits {'kept' if kept else 'MISSED'}")
    return 0 if kept else 1


def draw(found: list[dict[str, float]], path: Path) -> None:
    """Time and memory against the number of captures."""
    captures = [one["captures"] for one in found]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    left.loglog(captures, [one["planned_s"] for one in found], "o-", label="planned")
    left.loglog(captures, [one["handed_out_s"] for one in found], "s-", label="handed out and written down")
    left.axhline(LIMIT_S, color="0.6", linestyle=":", label="limit")
    left.set(xlabel="captures", ylabel="s")
    left.legend()
    right.semilogx(captures, [one["peak_bytes"] / 1e6 for one in found], "o-")
    right.set(xlabel="captures", ylabel="peak memory of the batch's process, MB", ylim=(0, None))
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
