"""What a batch makes of two cores, and of object storage: copies of the demo's sweep, cloud and measures of each.

Each batch is the command `jaxscan batch`, once per line, after one that has compiled all code. With `--storage` copies
lie on a server of S3 (moto) that has a core of its own, and one worker has the other; batches from disk and from
storage take turns. Limits, stated before: two workers do at least 1.7 times the work of one on one core; from storage
at least 70 % of the speed from disk, by the median of the pairs.

    jaxscan demo -o demo
    python experiments/fleet/work.py demo [--copies 24] [--storage 6] [--rounds 3]
"""

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxscan.project import Catalogue


WORKERS_LIMIT, STORAGE_LIMIT = 1.7, 0.70
PROJECT = """[project]
name = "copies"
output = "{output}"
products = ["cloud", "measures"]
[[rig]]
name = "demo"
calibration = "calibration.json"
[[captures]]
pattern = "{pattern}"
rig = "demo"
"""
KEYS = {"AWS_ACCESS_KEY_ID": "made", "AWS_SECRET_ACCESS_KEY": "up", "AWS_DEFAULT_REGION": "us-east-1"}
BUCKET = "rooms"


def batch(home: Path, pattern: str, *, workers: int, cores: set[int]) -> tuple[float, float]:
    """Seconds of one batch from nothing, and of those the seconds that its steps were at work."""
    output = tempfile.mkdtemp(prefix="products-", dir=home)
    file = home / "project.toml"
    file.write_text(PROJECT.format(output=Path(output).name, pattern=pattern))
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
        seconds, at_work = batch(home, "captures/*", workers=workers, cores=set(own))
        found[f"{name}_s"] = seconds
        beside = found[f"{name}_beside_s"] = (seconds * workers - at_work) / copies
        print(f"{workers} on {len(own)} cores: {seconds:.1f} s; for each capture {beside:.2f} s beside its own work")
    return found


def measure_storage(home: Path, rounds: int, cores: list[int]) -> list[tuple[float, float]]:
    """Seconds from disk and from storage, in turn; one worker has a core, the server the other."""
    pairs = []
    with server(cores[1]) as address:
        os.environ.update(KEYS | {"AWS_ENDPOINT_URL": address})
        upload(home / "captures", address)
        for _ in range(rounds):
            local, _ = batch(home, "captures/*", workers=1, cores=set(cores[:1]))
            remote, _ = batch(home, f"s3://{BUCKET}/*", workers=1, cores=set(cores[:1]))
            pairs.append((local, remote))
            print(f"from disk {local:.1f} s, from storage {remote:.1f} s: {local / remote:.0%}")
    return pairs


@contextmanager
def server(core: int) -> Iterator[str]:
    """A server of S3 on loopback, with a core of its own."""
    code = "\n".join(
        (
            "import time",
            "from moto.server import ThreadedMotoServer",
            "server = ThreadedMotoServer(ip_address='127.0.0.1', port=0, verbose=False)",
            "server.start()",
            "print(server.get_host_and_port()[1], flush=True)",
            "time.sleep(1e6)",
        )
    )
    words = [sys.executable, "-c", code]
    process = subprocess.Popen(
        words,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        preexec_fn=lambda: os.sched_setaffinity(0, {core}),
    )
    try:
        assert process.stdout is not None
        yield f"http://127.0.0.1:{int(process.stdout.readline())}"
    finally:
        process.kill()
        process.wait()


def upload(folder: Path, address: str) -> None:
    """Put all files of a folder into the bucket."""
    import boto3

    client = boto3.client("s3", endpoint_url=address)
    client.create_bucket(Bucket=BUCKET)
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            client.upload_file(str(path), BUCKET, path.relative_to(folder).as_posix())


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
    """Measure, print, and say whether the limits are kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("demo", type=Path, help="folder that `jaxscan demo` wrote")
    parser.add_argument("--copies", type=int, default=24, help="for the workers; 0 leaves them out")
    parser.add_argument("--storage", type=int, default=6, help="copies on storage; 0 leaves it out")
    parser.add_argument("--rounds", type=int, default=3, help="pairs of batches from disk and from storage")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    cores = sorted(os.sched_getaffinity(0))[:2]
    found: dict[str, object] = {}
    kept = True
    for count in filter(None, (given.copies, given.storage)):
        with tempfile.TemporaryDirectory(dir=given.demo) as name:
            home = Path(name)
            copies_of(given.demo, home, count)
            batch(home, "captures/room-00", workers=1, cores=set(cores))
            if count == given.copies:
                times = measure_workers(home, count, cores)
                gain = times["one_one_s"] / times["two_two_s"]
                print(f"two workers do {gain:.2f} times the work of one on one core, asked {WORKERS_LIMIT}")
                kept &= gain >= WORKERS_LIMIT
                found["workers"] = times | {"gain": gain}
            else:
                pairs = measure_storage(home, given.rounds, cores)
                share = statistics.median(local / remote for local, remote in pairs)
                print(f"from storage {share:.0%} of the speed from disk, asked {STORAGE_LIMIT:.0%}")
                kept &= share >= STORAGE_LIMIT
                found["storage"] = {"pairs_s": pairs, "share": share}
    if given.json:
        given.json.write_text(json.dumps(found, indent=2) + "\n")
    print(f"limits {'kept' if kept else 'MISSED'}")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
