"""Kills scans of the bench at random moments with SIGKILL, resumes each at once, and verifies the finished captures.

The firmware runs in a simulated processor and the GigE Vision camera answers on loopback (hardware/bench), so the kill
leaves real things behind: an open serial port, a table in motion, a lit laser, and a camera under the control of a
process that is gone. Every second session is a fresh process; the others are forked, so that they reach the camera
within a fraction of a second, before its heartbeat has ended.

    python -m experiments.kills [--kills 50] [--seed 1] [--steps 40] [--json FILE]

Verified after each kill: what the journal held is there, byte for byte, and no shot is lost but those in flight: the
one that is taken, and those that wait for proof or disk.
Verified at the end: the capture is complete and `jaxscan doctor --capture` finds nothing; each image is, pixel for
pixel, the picture that the simulated room gives at the record's angle, with or without laser. In the log of the
firmware's pins no pulse of the laser is longer than its lease in a shot, and after the host's death none is lit later
than the link's watchdog allows.

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
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench import CLOCK_HZ
from bench.camera.rendered import View, World, load_world
from bench.desk import Desk, set_up
from bench.places import WORLD
from scanrig.config import load_rig
from scanrig.recording import AHEAD
from scanrig.session.plan import controller_settings

from experiments.report import ROOT, command_line, progress, verb, write_json
from jaxscan.cli.main import main as jaxscan_main
from jaxscan.files.capture import open_capture, verify_capture


CONFIG = ROOT / "configs" / "bench.toml"
SESSION_S, LATEST_S, LOAD_S = 300.0, 10.0, 3.0
"""Time in which a session that is not killed must end, latest moment of a kill, and time to load modules first."""
MOST_FAILED = 10
"""Sessions that may end by themselves with an error before the run is given up; one is enough for it to fail."""


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
            said = {**os.environ, "PYTHONUNBUFFERED": "1"}
            return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=file, stderr=file, cwd=ROOT, env=said).pid
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
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


def accounted(lines: bytes) -> int:
    """Shots that a journal accounts for: records, comparisons and retakes."""
    entries = [json.loads(line) for line in lines.splitlines()]
    return sum("i" in entry or entry.get("event") in ("compared", "closing", "retake") for entry in entries)


def kill_scans(desk: Desk, config: Path, folder: Path, kills: int, generator: random.Random) -> Tally:
    """Begin, kill and resume scans until so many kills are done; the last scan is brought to its end."""
    tally, sessions = Tally(), 0
    while tally.kills < kills:
        capture = folder / f"room{len(tally.captures)}"
        log, status = capture.with_suffix(".log"), None
        words = ["scan", str(config), "-o", str(capture), "--resume", "--port", desk.rig.port]
        while status != 0:
            enough, sessions = tally.kills >= kills, sessions + 1
            fresh = sessions % 2 == 1
            before, seen = whole_lines(capture), len(desk.camera.frames())
            start, child = time.monotonic(), begin(words, log, fresh=fresh)
            if enough:
                status = ended(child, SESSION_S)
            elif generator.random() < 0.5:
                # Any moment, most of them while it begins; a fresh process loads its modules first.
                status = ended(child, generator.uniform(0.0, LATEST_S) + LOAD_S * fresh)
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
            # A shot is one frame in the light of the laser.
            adrift = sum(entry["light"] > 0 for entry in desk.camera.frames()[seen:]) - accounted(new)
            taken = records_in(new)
            tally.with_records += status is None and taken > 0
            tally.after_home += status is None and taken == 0 and b'"home"' in new
            # The firmware may finish the shot in flight only after the kill, when the next session has begun.
            tally.adrift += adrift
            tally.lost = max(tally.lost, tally.adrift - (1 + AHEAD) * tally.kills)
            progress(
                f"kill {tally.kills:3d} {capture.name} {'fresh' if fresh else 'forked':6} "
                f"{time.monotonic() - start:5.1f} s, status {status}, +{taken} records, {adrift} in flight, "
                f"load {os.getloadavg()[0]:.2f}"
            )
            if status not in (None, 0) or (enough and status != 0):
                tally.failed.append(" ".join(log.read_text(errors="replace").split())[-600:] if log.exists() else "")
                progress(tally.failed[-1])
                if len(tally.failed) > MOST_FAILED:
                    return tally
        tally.captures.append(capture)
    return tally


def pixels_right(capture: Path, ledger: list[dict[str, Any]], world: World) -> tuple[int, int]:
    """Number of images of a capture, and of those that the room gives at the record's position, pixel for pixel."""
    at: dict[tuple[int, bool], list[dict[str, Any]]] = {}
    for entry in ledger:
        if entry["sent"]:
            at.setdefault((entry["position"], entry["light"] > 0), []).append(entry)
    lines = map(json.loads, (capture / "frames.jsonl").read_text().splitlines())
    records = {line["i"]: line for line in lines if "i" in line}
    opened, right = open_capture(capture), 0
    for k, record in enumerate(opened.records):
        for image, lit in zip(opened.frames(k), (True, False), strict=True):
            entries = at.get((records[record.i]["microsteps"], lit), [])
            right += any(np.array_equal(image, _picture(world, entry)) for entry in entries)
    return 2 * len(opened.records), right


def _picture(world: World, entry: dict[str, Any]) -> np.ndarray:
    view = View(entry["angle"], (entry["light"], entry["light_2"]), entry["board"], entry["exposure"])
    return world.frame(view, entry["cycle"])


def light(edges: list[dict[str, Any]]) -> dict[str, float]:
    """The laser in the pins' log [ms]: its longest pulse, and how late it shone after a host was gone.

    The latter ends at the link's watchdog, or with the next host, whose greeting puts the laser off.
    """
    longest = latest = 0.0
    lit: int | None = None
    gone: int | None = None
    for edge in edges:
        now = edge["cycle"]
        if "host" in edge:
            gone = now if edge["host"] == "closed" else None
        elif edge.get("pin") == "light" and edge["v"]:
            lit = now
        elif edge.get("pin") == "light" and lit is not None:
            longest, lit = max(longest, now - lit), None
            latest = latest if gone is None else max(latest, now - gone)
    if lit is not None:
        raise SystemExit("The laser still shines at the end of the log.")
    per_ms = CLOCK_HZ / 1e3
    return {"longest_pulse_ms": round(longest / per_ms, 2), "latest_light_after_death_ms": round(latest / per_ms, 2)}


def verdict(tally: Tally, ledger: list[dict[str, Any]], steps: int) -> dict[str, float]:
    """The figures of a run."""
    world = load_world(WORLD, reach_deg=10.0)
    complete = clean = images = right = 0
    for capture in tally.captures:
        records = [record.i for record in open_capture(capture).records]
        complete += records == list(range(steps)) and verify_capture(capture) == []
        clean += verb("doctor", "--capture", capture).code == 0
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


def run(arguments: argparse.Namespace, folder: Path) -> dict[str, float]:
    """All figures of scans on a bench of their own."""
    text, config = CONFIG.read_text(), folder / "bench.toml"
    if "steps = 180" not in text:
        raise SystemExit(f"{CONFIG}: expected steps = 180")
    config.write_text(text.replace("steps = 180", f"steps = {arguments.steps}\nturn_deg = {arguments.steps}.0"))
    start = time.perf_counter()
    with set_up(folder / "bench", world=WORLD, wait_s=600.0) as desk:
        tally = kill_scans(desk, config, folder, arguments.kills, random.Random(arguments.seed))
        ledger = desk.camera.frames()
        desk.rig.run_for(1.0)
        shone = light(desk.rig.edges())
    settings = controller_settings(load_rig(config))
    lease_ms = settings.laser_on_ms + settings.ready_ms + settings.exposure_ms + settings.gap_ms
    figures = verdict(tally, ledger, arguments.steps) | shone | {"lease_ms": lease_ms}
    return figures | {
        "watchdog_ms": settings.watchdog_ms,
        "minutes": round((time.perf_counter() - start) / 60, 1),
        "load": os.getloadavg()[0],
    }


def main() -> int:
    """The command."""
    parser = command_line(__doc__, json=True)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=40, help="of each scan, one degree apart")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        figures = run(arguments, Path(temporary))
    for name, value in figures.items():
        print(f"{name:>30} {value}")
    write_json(arguments.json, {"seed": arguments.seed, **figures})
    good = (
        figures["captures"] == figures["captures_complete"] == figures["captures_clean"]
        and figures["images"] == figures["images_right"] > 0
        and figures["kills"] == arguments.kills
        and not any(figures[name] for name in ("sessions_failed", "shots_lost", "journal_lines_lost"))
        and figures["longest_pulse_ms"] <= figures["lease_ms"] + 1
        and figures["latest_light_after_death_ms"] <= figures["watchdog_ms"] + 1
    )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
