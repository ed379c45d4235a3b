"""Kills scans of the bench at random moments with SIGKILL, resumes each at once, and verifies the finished captures.

The firmware runs in a simulated processor and the GigE Vision camera answers on loopback (hardware/bench), so the kill
leaves real things behind: an open serial port, a table in motion, a lit laser, and a camera under the control of a
process that is gone. Every second session is a fresh process; the others are forked, so that they reach the camera
within a fraction of a second, before its heartbeat has ended.

    python experiments/kills.py [--kills 50] [--seed 1] [--steps 40] [--load 0] [--json FILE]

Verified after each kill: what the journal held is there, byte for byte, and no shot is lost but those in flight: the
one that is taken, and those that wait for proof or disk.
Verified at the end: the capture is complete and `jaxscan doctor --capture` finds nothing; each image is, pixel for
pixel, the picture that the simulated room gives at the record's angle, with or without laser.

Needs `make bench-deps`.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench.camera.world import View, World, load_world
from bench.desk import Desk, set_up
from bench.places import WORLD
from scanrig.recording import AHEAD

from jaxscan.cli.main import main as jaxscan_main
from jaxscan.files.capture import open_capture, verify_capture


ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "configs" / "bench.toml"
SESSION_S = 120.0
"""A session that is not killed must end within this time."""


@dataclass
class Tally:
    """Counts of a whole run."""

    kills: int = 0
    with_records: int = 0
    """Kills after the session had taken a record."""
    after_home: int = 0
    """Kills of a session that had begun, before its first record."""
    failed: list[str] = field(default_factory=list)
    """The last words of sessions that ended by themselves with an error."""
    shortened: int = 0
    """Kills after which the journal lost a line that it held."""
    adrift: int = 0
    """Shots without a record: those in flight at a kill."""
    lost: int = 0
    """How many more these were at any time than the kills before allow."""
    captures: list[Path] = field(default_factory=list)


def begin(words: list[str], log: Path, *, fresh: bool) -> int:
    """Start a session; returns the process number."""
    if fresh:
        with open(log, "ab") as file:
            command = [sys.executable, "-m", "jaxscan.cli.main", *words]
            return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, cwd=ROOT).pid
    child = os.fork()
    if child:
        return child
    with open(log, "ab") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    status = 70
    try:
        status = jaxscan_main(words)
        sys.stdout.flush()
    finally:
        os._exit(status)


def ended(child: int, within_s: float) -> int | None:
    """Its exit status, or None if it still runs after `within_s`."""
    end = time.monotonic() + within_s
    while True:
        number, status = os.waitpid(child, os.WNOHANG)
        if number:
            return os.waitstatus_to_exitcode(status)
        if time.monotonic() >= end:
            return None
        time.sleep(0.005)


def after_records(child: int, folder: Path, known: int, count: int) -> int | None:
    """Wait until a session has added so many records to the journal of `known` bytes; its exit status if it ended."""
    end = time.monotonic() + SESSION_S
    while time.monotonic() < end:
        status = ended(child, 0.0)
        if status is not None or records_in(whole_lines(folder)[known:]) >= count:
            return status
        time.sleep(0.01)
    return None


def records_in(lines: bytes) -> int:
    """Number of records among journal lines."""
    return sum("i" in json.loads(line) for line in lines.splitlines())


def whole_lines(folder: Path) -> bytes:
    """The journal up to its last whole line."""
    path = folder / "frames.jsonl"
    text = path.read_bytes() if path.exists() else b""
    return text[: text.rfind(b"\n") + 1]


def shots(ledger: list[dict[str, Any]]) -> int:
    """Frames in the light of the laser: one per shot."""
    return sum(entry["light"] > 0 for entry in ledger)


def accounted(lines: bytes) -> int:
    """Shots that a journal accounts for: records, comparisons and retakes."""
    entries = [json.loads(line) for line in lines.splitlines()]
    return sum("i" in entry or entry.get("event") in ("compared", "closing", "retake") for entry in entries)


def kill_scans(desk: Desk, config: Path, folder: Path, arguments: argparse.Namespace) -> Tally:
    """Begin, kill and resume scans until so many kills are done; the last scan is brought to its end."""
    tally, generator, sessions = Tally(), random.Random(arguments.seed), 0
    while tally.kills < arguments.kills:
        capture = folder / f"room{len(tally.captures)}"
        log = capture.with_suffix(".log")
        complete = False
        while not complete:
            enough = tally.kills >= arguments.kills
            sessions += 1
            fresh = sessions % 2 == 1
            before, seen = whole_lines(capture), len(desk.camera.frames())
            words = ["scan", str(config), "-o", str(capture), "--resume", "--port", desk.rig.port]
            start = time.monotonic()
            child = begin(words, log, fresh=fresh)
            if enough:
                status = ended(child, SESSION_S)
            elif generator.random() < 0.5:
                # Any moment, most of them while it begins; a fresh process loads its modules first.
                status = ended(child, generator.uniform(0.0, arguments.latest_s) + arguments.load_s * fresh)
            else:
                # Any moment of a scan that takes records.
                status = after_records(child, capture, len(before), generator.randint(1, 8))
                status = ended(child, generator.uniform(0.0, 0.5)) if status is None else status
            if status is None:
                os.kill(child, signal.SIGKILL)
                ended(child, 10.0)
                tally.kills += 1
            after = whole_lines(capture)
            tally.shortened += not after.startswith(before)
            new = after[len(before) :]
            desk.camera.settle()
            adrift = shots(desk.camera.frames()[seen:]) - accounted(new)
            taken = records_in(new)
            tally.with_records += status is None and taken > 0
            tally.after_home += status is None and taken == 0 and b'"home"' in new
            # The firmware may finish the shot in flight only after the kill, when the next session has begun.
            tally.adrift += adrift
            tally.lost = max(tally.lost, tally.adrift - (1 + AHEAD) * tally.kills)
            complete = status == 0
            said = " ".join(log.read_text(errors="replace").split())[-200:] if log.exists() else ""
            print(
                f"kill {tally.kills:3d} {capture.name} {'fresh' if fresh else 'forked':6} "
                f"{time.monotonic() - start:5.1f} s, status {status}, +{taken} records, {adrift} in flight, "
                f"load {os.getloadavg()[0]:.2f}",
                file=sys.stderr,
                flush=True,
            )
            if status not in (None, 0) or (enough and not complete):
                tally.failed.append(said)
                print(said, file=sys.stderr)
                if len(tally.failed) > 3:
                    return tally
        tally.captures.append(capture)
    return tally


def pixels_right(capture: Path, ledger: list[dict[str, Any]], world: World) -> tuple[int, int]:
    """Number of images of a capture, and of those that the room gives at the record's position, pixel for pixel."""
    at: dict[tuple[int, bool], list[dict[str, Any]]] = {}
    for entry in ledger:
        if entry["sent"]:
            at.setdefault((entry["position"], entry["light"] > 0), []).append(entry)
    records = {}
    for line in map(json.loads, (capture / "frames.jsonl").read_text().splitlines()):
        if "i" in line:
            records[line["i"]] = line
    opened, right = open_capture(capture), 0
    for k, record in enumerate(opened.records):
        for image, lit in zip(opened.frames(k), (True, False), strict=True):
            right += any(
                np.array_equal(image, _picture(world, entry))
                for entry in at.get((records[record.i]["microsteps"], lit), [])
            )
    return 2 * len(opened.records), right


def _picture(world: World, entry: dict[str, Any]) -> np.ndarray:
    view = View(entry["angle"], (entry["light"], entry["light_2"]), entry["board"], entry["exposure"])
    return world.frame(view, entry["cycle"])


def verdict(tally: Tally, ledger: list[dict[str, Any]], steps: int) -> dict[str, float]:
    """The figures of a run."""
    world = load_world(WORLD, reach_deg=10.0)
    complete = clean = images = right = 0
    for capture in tally.captures:
        records = [record.i for record in open_capture(capture).records]
        complete += records == list(range(steps)) and verify_capture(capture) == []
        command = [sys.executable, "-m", "jaxscan.cli.main", "doctor", "--capture", str(capture)]
        clean += subprocess.run(command, stdout=subprocess.DEVNULL, cwd=ROOT).returncode == 0
        more, good = pixels_right(capture, ledger, world)
        images, right = images + more, right + good
    return {
        "kills": tally.kills,
        "kills_with_records": tally.with_records,
        "kills_before_the_first_record": tally.after_home,
        "sessions_failed": len(tally.failed),
        "journal_lines_lost": tally.shortened,
        "shots_in_flight": tally.adrift,
        "shots_lost": tally.lost,
        "captures": len(tally.captures),
        "captures_complete": complete,
        "captures_clean": clean,
        "images": images,
        "images_right": right,
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=40, help="of each scan, one degree apart")
    parser.add_argument("--latest-s", type=float, default=10.0, help="latest moment of a kill after the start")
    parser.add_argument("--load-s", type=float, default=3.0, help="time that a fresh process needs to load its modules")
    parser.add_argument("--load", type=int, default=0, metavar="N", help="busy loops beside it")
    parser.add_argument("--json", metavar="FILE", help="write the figures to a file")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary, ExitStack() as stack:
        folder = Path(temporary)
        text = CONFIG.read_text()
        if "steps = 180" not in text:
            raise SystemExit(f"{CONFIG}: expected steps = 180")
        config = folder / "bench.toml"
        config.write_text(text.replace("steps = 180", f"steps = {arguments.steps}\nturn_deg = {arguments.steps}.0"))
        for _ in range(arguments.load):
            stack.callback(subprocess.Popen([sys.executable, "-c", "while True: pass"]).kill)
        start, load = time.perf_counter(), os.getloadavg()[0]
        with set_up(folder / "bench", world=WORLD, wait_s=600.0) as desk:
            tally = kill_scans(desk, config, folder, arguments)
            ledger = desk.camera.frames()
        minutes = (time.perf_counter() - start) / 60
        figures = {**verdict(tally, ledger, arguments.steps), "minutes": round(minutes, 1)}
        figures |= {"load_before": load, "load_after": os.getloadavg()[0], "busy_loops": arguments.load}
    for name, value in figures.items():
        print(f"{name:>30} {value}")
    if arguments.json:
        Path(arguments.json).write_text(json.dumps({"seed": arguments.seed, **figures}, indent=2) + "\n")
    good = figures["captures"] == figures["captures_complete"] == figures["captures_clean"]
    good = good and figures["images"] == figures["images_right"] > 0
    good = good and figures["kills"] == arguments.kills
    return 0 if good and not tally.failed and not tally.lost and not tally.shortened else 1


if __name__ == "__main__":
    sys.exit(main())
