"""Kills scans of the bench at random moments with SIGKILL, resumes each at once, and verifies the finished captures.

The firmware runs in a simulated processor and the GigE Vision camera answers on loopback (hardware/bench), so the kill
leaves real things behind: an open serial port, a table in motion, a lit laser, and a camera under the control of a
process that is gone. Every second session is a fresh process; the others are forked, so that they reach the camera
within a fraction of a second, before its heartbeat has ended.

    python -m experiments.kills [--kills 50] [--seed 1] [--steps 40] [--load 0] [--console] [--json FILE]

With --console it is `jaxscan console` that scans, by the order of a page that shows the token and leaves; as long as it
lives, a flood of half-open connections from the loopback stands at its door. Just before each kill a page that has the
cookie asks for the console's page.

Verified after each kill: what the journal held is there, byte for byte, and no shot is lost but those in flight: the
one that is taken, and those that wait for proof or disk.
Verified at the end: the capture is complete and `jaxscan doctor --capture` finds nothing; each image is, pixel for
pixel, the picture that the simulated room gives at the record's angle, with or without laser. In the log of the
firmware's pins no pulse of the laser is longer than its lease in a shot, and after the host's death none is lit later
than the link's watchdog allows.

Needs `make bench-deps`.
"""

import argparse
import asyncio
import http.client
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import aiohttp
import numpy as np
from bench import CLOCK_HZ
from bench.camera.rendered import View, World, load_world
from bench.desk import Desk, set_up
from bench.flood import Flood
from bench.places import WORLD
from scanrig.config import load_rig
from scanrig.recording import AHEAD
from scanrig.session.plan import controller_settings

from experiments.report import ROOT, command_line, verb, write_json
from jaxscan.cli.main import main as jaxscan_main
from jaxscan.files.capture import open_capture, verify_capture


CONFIG = ROOT / "configs" / "bench.toml"
SESSION_S = 300.0
"""A session that is not killed must end within this time."""
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
    flood: list[int] = field(default_factory=list)
    """Half-open connections that each console got."""
    answers_s: list[float] = field(default_factory=list)
    """How long pages with the cookie waited for the console's page, in the flood."""
    unanswered: int = 0
    """Pages with the cookie that got another answer than the page, or none."""
    said: int = 0
    """Most lines that a console printed."""


class Scan:
    """A session by `jaxscan scan`, in a process of its own."""

    def __init__(self, child: int, log: Path) -> None:
        self.child, self.log = child, log

    def ended(self, within_s: float) -> int | None:
        """Its exit status, or None if it still runs after `within_s`."""
        return ended(self.child, within_s)

    def last_words(self, tally: Tally) -> None:
        """Called just before it is killed."""

    def killed(self) -> None:
        """Kill it."""
        with suppress(ProcessLookupError, ChildProcessError):
            os.kill(self.child, signal.SIGKILL)
            ended(self.child, 10.0)


class ConsoleScan(Scan):
    """A session by `jaxscan console` in a flood of connections; it has ended when the page says so."""

    def __init__(self, child: int, log: Path, capture: Path) -> None:
        super().__init__(child, log)
        self._capture = capture
        log.touch()
        self._before = log.stat().st_size
        self._order = json.dumps({"do": "sweep", "name": capture.name, "resume": True})
        self.port, self._cookie = 0, ""

    def lines(self) -> list[str]:
        """What it has printed."""
        return self.log.read_bytes()[self._before :].decode(errors="replace").splitlines()

    def address(self) -> str:
        """The address that it prints, with its token."""
        end = time.monotonic() + SESSION_S
        while time.monotonic() < end and ended(self.child, 0.0) is None:
            words = [line.split()[-1] for line in self.lines()[:1] if "?token=" in line]
            if words and self.log.read_bytes().endswith(b"\n"):
                self.port = urlsplit(words[0]).port or 0
                return words[0]
            time.sleep(0.01)
        raise SystemExit(f"The console printed no address, but: {self.lines()}")

    async def give_order(self, address: str) -> None:
        """Be a page that begins the scan, and leave when it has begun."""
        jar = aiohttp.CookieJar(unsafe=True)
        limit = aiohttp.ClientTimeout(total=60.0)
        async with aiohttp.ClientSession(cookie_jar=jar, timeout=limit) as page:
            async with page.get(address) as answer:
                answer.raise_for_status()
            self._cookie = "; ".join(f"{one.key}={one.value}" for one in jar)
            own = f"http://127.0.0.1:{self.port}"
            async with page.ws_connect(f"{own}/socket", headers={"Origin": own}) as wire, asyncio.timeout(60.0):
                await wire.send_str(json.dumps({"page": "0" * 32}))
                await wire.receive_str()
                await wire.send_str(self._order)
                async for message in wire:
                    if message.type is not aiohttp.WSMsgType.TEXT:
                        continue
                    told = json.loads(message.data)
                    if told["kind"] == "refused":
                        raise SystemExit(f"The console refused to scan: {told['says']}")
                    if told["state"]["doing"] != "nothing" or told["state"]["finished"]:
                        return
        raise SystemExit("The console ended its page's connection.")

    def ended(self, within_s: float) -> int | None:
        """0 when the sweep is complete, 1 when the session has ended otherwise; the console is ended then."""
        end = time.monotonic() + within_s
        while True:
            status = ended(self.child, 0.0)
            if status is None and any(line.startswith("jaxscan: ") for line in self.lines()):
                status = self._leave(1)
            elif status is None and b'"complete"' in whole_lines(self._capture).rpartition(b'"event"')[2]:
                status = self._leave(0)
            if status is not None or time.monotonic() >= end:
                return status
            time.sleep(0.02)

    def _leave(self, status: int) -> int:
        os.kill(self.child, signal.SIGTERM)
        if ended(self.child, 30.0) is None:
            super().killed()
            return 1
        return status

    def last_words(self, tally: Tally) -> None:
        """Ask for the page, as one that has the cookie."""
        start = time.monotonic()
        asking = http.client.HTTPConnection("127.0.0.1", self.port, timeout=30.0)
        try:
            asking.request("GET", "/", headers={"Cookie": self._cookie})
            well = asking.getresponse().status == 200
        except (OSError, http.client.HTTPException):
            well = False
        finally:
            asking.close()
        if well:
            tally.answers_s.append(time.monotonic() - start)
        else:
            tally.unanswered += 1


@contextmanager
def scanning(
    desk: Desk, config: Path, capture: Path, tally: Tally, arguments: argparse.Namespace, *, fresh: bool
) -> Iterator[Scan]:
    """A session that scans. With --console it is a console in a flood, which ends with the `with` block."""
    log, port = capture.with_suffix(".log"), desk.rig.port
    if not arguments.console:
        yield Scan(begin(["scan", str(config), "-o", str(capture), "--resume", "--port", port], log, fresh=fresh), log)
        return
    words = ["console", str(config), "--captures", str(capture.parent), "--port", port, "--web-port", "0"]
    scan = ConsoleScan(0, log, capture)
    scan.child = begin(words, log, fresh=fresh)
    try:
        address = scan.address()
        with Flood(scan.port, held=arguments.held, per_s=arguments.per_s) as flood:
            asyncio.run(scan.give_order(address))
            yield scan
    except BaseException:
        # A forked one holds the bench's lock, too.
        scan.killed()
        raise
    tally.flood.append(flood.opened)
    tally.said = max(tally.said, len(scan.lines()))


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


def after_records(scan: Scan, folder: Path, known: int, count: int) -> int | None:
    """Wait until a session has added so many records to the journal of `known` bytes; its exit status if it ended."""
    end = time.monotonic() + SESSION_S
    while time.monotonic() < end:
        status = scan.ended(0.0)
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
            start = time.monotonic()
            with scanning(desk, config, capture, tally, arguments, fresh=fresh) as scan:
                if enough:
                    status = scan.ended(SESSION_S)
                elif generator.random() < 0.5:
                    # Any moment, most of them while it begins; a fresh process loads its modules first. A console has
                    # loaded them when it is asked to scan.
                    load_s = arguments.load_s * (fresh and not arguments.console)
                    status = scan.ended(generator.uniform(0.0, arguments.latest_s) + load_s)
                else:
                    # Any moment of a scan that takes records.
                    status = after_records(scan, capture, len(before), generator.randint(1, 8))
                    status = scan.ended(generator.uniform(0.0, 0.5)) if status is None else status
                if status is None:
                    scan.last_words(tally)
                    scan.killed()
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
            said = " ".join(log.read_text(errors="replace").split())[-600:] if log.exists() else ""
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


def light(edges: list[dict[str, Any]]) -> dict[str, float]:
    """The laser in the pins' log [ms]: its longest pulse, and how late it shone after a host was gone.

    The latter ends at the link's watchdog, or with the next host, whose greeting puts the laser off.
    """
    longest = latest = 0.0
    lit: int | None = None
    gone: int | None = None
    for edge in edges:
        now = edge["cycle"]
        if edge.get("host") == "closed":
            gone = now
        elif edge.get("host") == "open":
            gone = None
        elif edge.get("pin") == "light" and edge["v"]:
            lit = now
        elif edge.get("pin") == "light" and lit is not None:
            longest, lit = max(longest, now - lit), None
            if gone is not None:
                latest = max(latest, now - gone)
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


def in_the_flood(tally: Tally) -> dict[str, float]:
    """The figures of consoles that were flooded."""
    answers = np.array(tally.answers_s)
    return {
        "half_open_connections": sum(tally.flood),
        "most_lines_of_a_console": tally.said,
        "pages_answered": len(answers),
        "pages_unanswered": tally.unanswered,
        "answer_median_s": round(float(np.median(answers)), 3),
        "answer_longest_s": round(float(np.max(answers)), 3),
    }


def main() -> int:
    parser = command_line(__doc__, json=True)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=40, help="of each scan, one degree apart")
    parser.add_argument("--latest-s", type=float, default=10.0, help="latest moment of a kill after the start")
    parser.add_argument("--load-s", type=float, default=3.0, help="time that a fresh process needs to load its modules")
    parser.add_argument("--load", type=int, default=0, metavar="N", help="busy loops beside it")
    parser.add_argument("--console", action="store_true", help="scan by a console that is flooded")
    parser.add_argument("--held", type=int, default=300, help="half-open connections at a time")
    parser.add_argument("--per-s", type=float, default=300.0, help="new ones in a second, at most")
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
            desk.rig.run_for(1.0)
            shone = light(desk.rig.edges())
        settings = controller_settings(load_rig(config))
        lease_ms = settings.laser_on_ms + settings.ready_ms + settings.exposure_ms + settings.gap_ms
        shone |= {"lease_ms": lease_ms, "watchdog_ms": settings.watchdog_ms}
        minutes = (time.perf_counter() - start) / 60
        figures = {**verdict(tally, ledger, arguments.steps), "minutes": round(minutes, 1)}
        figures |= shone | (in_the_flood(tally) if arguments.console else {})
        figures |= {"load_before": load, "load_after": os.getloadavg()[0], "busy_loops": arguments.load}
    for name, value in figures.items():
        print(f"{name:>30} {value}")
    write_json(arguments.json, {"seed": arguments.seed, **figures})
    good = figures["captures"] == figures["captures_complete"] == figures["captures_clean"]
    good = good and figures["images"] == figures["images_right"] > 0
    good = good and figures["kills"] == arguments.kills and not tally.unanswered
    good = (
        good
        and figures["longest_pulse_ms"] <= lease_ms + 1
        and (figures["latest_light_after_death_ms"] <= settings.watchdog_ms + 1)
    )
    return 0 if good and not tally.failed and not tally.lost and not tally.shortened else 1


if __name__ == "__main__":
    sys.exit(main())
