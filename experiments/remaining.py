"""How true the times are that verbs say are left: `python -m experiments.remaining FOLDER SWEEP`, of `jaxscan demo -o
FOLDER` and a sweep of the same room from another place, as `jaxscan simulate` makes it.

Each verb runs as a person runs it, its standard error a pipe. At each line of progress the clock and the processor time
that the verb has taken are noted; at the end it is known how much was left of either. Beside other load the clock
belongs to others too, so the time that is said is compared by the share of the work: said / (said + passed) against the
share of the processor time that was left.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path


_LEFT = re.compile(r"(\d+) %, about ([\d.]+) (s|min|h)(?: (\d+) min)? left")
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def processor_s(pid: int) -> float:
    """Processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def said_s(line: str) -> tuple[int, float] | None:
    """The percentage, and the time that a line says is left [s]."""
    found = _LEFT.search(line)
    return found and (int(found[1]), float(found[2]) * _UNITS[found[3]] + 60.0 * int(found[4] or 0))


def watch(words: list[str], environment: dict[str, str]) -> list[tuple[int, float, float, float, float]]:
    """Of each line: the percentage, what is said to be left, what was left by the clock, and both by the processor."""
    command, seen = [sys.executable, "-m", "jaxscan.cli.main", *words], []
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=environment
    ) as process:
        begun = time.monotonic()
        for line in process.stderr or ():
            if (said := said_s(line)) is not None:
                seen.append((*said, time.monotonic() - begun, processor_s(process.pid)))
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        lasted, worked = time.monotonic() - begun, processor_s(process.pid)
    if process.returncode:
        raise SystemExit(f"{words[0]} ended with {process.returncode}.")
    return [
        (percent, said, lasted - clock, worked * said / (said + clock), worked - used)
        for percent, said, clock, used in seen
    ]


def verbs(folder: Path, second: Path, made: Path) -> list[list[str]]:
    """What is run, of a folder of the demo and a sweep from another place."""
    sweep, calibration = str(folder / "captures" / "sweep"), ["-c", str(folder / "calibration.json")]
    return [
        ["calibrate", str(folder / "captures" / "boards"), "-o", str(made / "calibration.json")],
        ["reconstruct", sweep, *calibration, "--no-cache", "-o", str(made / "room.ply")],
        ["recalibrate", sweep, *calibration, "-o", str(made / "better.json")],
        ["register", sweep, str(second), *calibration, "-o", str(made / "both.ply")],
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="of jaxscan demo")
    parser.add_argument("second", type=Path, help="sweep of the same room")
    parser.add_argument("--only", help="one verb")
    parser.add_argument("--runs", type=int, default=2)
    arguments = parser.parse_args()
    print("| verb | compiled before | done % | said left s | left s | off % | by the processor % |")
    print("|---|---|---|---|---|---|---|")
    for cold in (False, True):
        for _ in range(1 if cold else arguments.runs):
            with tempfile.TemporaryDirectory() as made:
                kept = {"JAX_COMPILATION_CACHE_DIR": f"{made}/compiled"} if cold else {}
                for words in verbs(arguments.folder, arguments.second, Path(made)):
                    if arguments.only not in (None, words[0]):
                        continue
                    for percent, said, left, said_cpu, left_cpu in watch(words, os.environ | kept):
                        off, off_cpu = 100 * (said / left - 1), 100 * (said_cpu / left_cpu - 1)
                        row = f"| {words[0]} | {'no' if cold else 'yes'} | {percent} | {said:.0f} | {left:.0f} |"
                        print(f"{row} {off:+.0f} | {off_cpu:+.0f} |", flush=True)


if __name__ == "__main__":
    main()
