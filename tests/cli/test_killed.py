"""Verbs killed at random moments: one line within two seconds, nothing half written under its name, nothing beside it.

A few moments in `make test`, many in `make test-all`. Each verb runs as a process of its own, in both ways in which it
is started. Before jaxscan hears signals, in the first hundredths of a second, Python itself answers them.
"""

import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import pytest

import jaxscan
from jaxscan.files.capture import open_capture, verify_capture
from jaxscan.vision import encode_png

from ..conftest import TINY


pytestmark = pytest.mark.rig


VERBS = {
    "demo": "demo -o demo",
    "simulate": "simulate rig.toml -o made --every 4 --json made.json",
    "calibrate": "calibrate boards -o new.json --report new.html --json result.json",
    "recalibrate": "recalibrate sweep -c calibration.json -o new.json --report new.html --json result.json",
    "reconstruct": "reconstruct sweep -c calibration.json -o new.ply --json result.json",
    "measure": "measure compare room.ply truth.npz -c calibration.json --json result.json",
    "convert": "convert sweep fast --storage npy --json result.json",
    "import": "import pictures --output fast --step-deg 6 --json result.json",
    "convert-cloud": "convert room.ply new.e57 --json result.json",
    "align": "align room.ply -o new.npz --targets targets.toml --json result.json",
    "panorama": "panorama sweep -c calibration.json --cloud room.ply -o new.jpg --json result.json",
    "panorama-scan": "panorama sweep -c calibration.json --cloud room.ply -o new.e57 --json result.json",
    "mesh": "mesh room.ply -o new.glb -c calibration.json --texture sweep --json result.json",
    "mesh-text": "mesh room.ply -o new.obj --json result.json",
    "plan": "plan room.ply -o new.svg --json result.json",
    "orthophoto": "orthophoto room.ply -o fast --json result.json",
    "deviations": "measure deviations room.ply --at 2 0.3 0.3 --radius-mm 500 -o new.png --json result.json",
    "board": "board boards -o new.pdf --json result.json",
    "init": "init new.toml",
    "report": "report calibration.json -o new.html --json result.json",
    "doctor": "doctor --json result.json",
    "doctor-capture": "doctor --capture sweep --json result.json",
}
LONGEST_S = 2.0
ENDS = {
    ".jpg": b"\xff\xd9",
    ".png": b"IEND\xae\x42\x60\x82",
    ".svg": b"</svg>\n",
    ".pdf": b"%%EOF\n",
    ".obj": b"\n",
    ".toml": b"\n",
}
"""With what a whole file ends."""
PROGRESS = re.compile(r"\w+: \d+ %, about .* left")
ANSWERS = {signal.SIGINT: 130, signal.SIGTERM: 143}
NAMES = {"script": "import sys; sys.argv[0] = 'jaxscan'; from jaxscan.cli.main import main; sys.exit(main())"}
STARTS = ([sys.executable, "-c", NAMES["script"]], [sys.executable, "-m", "jaxscan"])


@pytest.fixture
def workplace(tiny, tmp_path):
    """A folder with what the verbs read; the inputs are links, and what a verb writes is removed between trials."""
    (tmp_path / "rig.toml").write_text(TINY)
    places = ("0, 0, 0", "1, 0, 0", "0, 1, 0")
    text = (f'[[target]]\nname = "{place}"\nscanner = [{place}]\nsite = [{place}]\n' for place in places)
    (tmp_path / "targets.toml").write_text("".join(text))
    for name in ("calibration.json", "calibration.npz", "room.ply"):
        shutil.copy(tiny.folder / name, tmp_path / name)
    shutil.copy(tiny.true_cloud, tmp_path / "truth.npz")
    for name in ("boards", "sweep"):
        shutil.copytree(tiny.folder / "captures" / name, tmp_path / name)
    (tmp_path / "sweep" / "stripes.npz").unlink(missing_ok=True)
    (tmp_path / "pictures").mkdir()
    sweep = open_capture(tmp_path / "sweep")
    for index in range(12):
        for side, frame in zip(("on", "off"), sweep.frames(index), strict=True):
            (tmp_path / "pictures" / f"{side}_{index:02}.png").write_bytes(encode_png(frame))
    return Workplace(tmp_path)


class Workplace:
    """Starts verbs, kills them, and looks at what is left."""

    def __init__(self, folder):
        self.folder = folder
        self.before = self.files()

    def files(self):
        return {path.relative_to(self.folder).as_posix() for path in self.folder.rglob("*") if path.is_file()}

    def partial(self):
        """What is in work, or was left so."""
        return sorted(path.name for path in [*self.folder.glob(".part-*"), *self.folder.glob("*/.part-*")])

    def clean(self):
        for name in self.files() - self.before:
            (self.folder / name).unlink(missing_ok=True)
        for name in ("demo", "made", "fast", *self.partial()):
            shutil.rmtree(self.folder / name, ignore_errors=True)

    def start(self, verb, *, way=0, cache="warm"):
        environment = {**os.environ, "XDG_CACHE_HOME": str(self.folder.parent / f"cache-{cache}")}
        child = subprocess.Popen(
            # As in a shell, whatever the tests were started from.
            ["env", "--default-signal", *STARTS[way], *VERBS[verb].split()],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            cwd=self.folder,
            env=environment,
        )
        while child.poll() is None and not hears(child.pid, signal.SIGTERM):
            time.sleep(0.001)
        return child

    def kill(self, verb, after_s, number, *, way=0, cache="warm"):
        """Kill a verb; returns faults in words."""
        child = self.start(verb, way=way, cache=cache)
        time.sleep(after_s)
        since = time.monotonic()
        child.send_signal(number)
        try:
            _, said = child.communicate(timeout=60)
        except subprocess.TimeoutExpired:
            child.kill()
            _, said = child.communicate()
        seconds = time.monotonic() - since
        said, faults = said.decode(errors="replace"), []
        if child.returncode == ANSWERS.get(number):
            lines = [line for line in said.splitlines() if not PROGRESS.fullmatch(line)]
            if lines != ["jaxscan: interrupted"]:
                faults.append(f"said {said[-500:]!r}")
        elif child.returncode != 0 and number != signal.SIGKILL:
            faults.append(f"code {child.returncode}, said {said[-500:]!r}")
        if seconds > LONGEST_S:
            faults.append(f"late: {seconds:.1f} s")
        if number != signal.SIGKILL:
            faults += [f"left {name}" for name in self.partial()]
        return faults + self.incomplete()

    def incomplete(self):
        """Files under their final names that are not whole."""
        faults = []
        for name in sorted(self.files() - self.before):
            path = self.folder / name
            if ".part-" in name:
                continue
            try:
                if path.suffix == ".json" and "captures" not in name and "made/" not in name:
                    json.loads(path.read_text())
                elif path.suffix == ".html" and not path.read_text().rstrip().endswith("</html>"):
                    faults.append(f"half written: {name}")
                elif path.stem in ("calibration", "stripes") and path.suffix == ".npz":
                    zipfile.ZipFile(path).testzip()
                elif path.suffix in (".ply", ".npz", ".e57"):
                    jaxscan.load_cloud(path)
                elif path.suffix in ENDS and not path.read_bytes().endswith(ENDS[path.suffix]):
                    faults.append(f"half written: {name}")
                elif path.suffix == ".glb" and int.from_bytes(path.read_bytes()[8:12], "little") != path.stat().st_size:
                    faults.append(f"half written: {name}")
                elif path.name == "frames.jsonl":
                    faults += [f"{name}: {problem}" for problem in verify_capture(path.parent)]
                    open_capture(path.parent)
            except (jaxscan.JaxscanError, ValueError, zipfile.BadZipFile) as problem:
                faults.append(f"half written: {name}: {problem}")
        return faults


def hears(process, number):
    """Whether a process has a handler for a signal, as Linux tells; Python itself has none for SIGTERM."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return True
    caught = next((line.split()[1] for line in status.splitlines() if line.startswith("SigCgt")), "0")
    return bool(int(caught, 16) >> (number - 1) & 1)


needs_linux = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux's /proc")


@needs_linux
@pytest.mark.parametrize(
    ("verb", "after_s", "number", "way"),
    [
        ("measure", 0.0, signal.SIGINT, 0),
        ("measure", 0.15, signal.SIGTERM, 1),
        ("convert-cloud", 0.6, signal.SIGINT, 1),
        ("report", 1.2, signal.SIGTERM, 0),
        ("report", 2.4, signal.SIGINT, 1),
    ],
)
def test_a_verb_is_ended(workplace, verb, after_s, number, way):
    assert workplace.kill(verb, after_s, number, way=way) == []


@needs_linux
@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("verb", VERBS)
def test_verbs_are_ended_at_any_moment(workplace, verb):
    """Some moments, half of them in the first two seconds, with and without a cache of compiled code."""
    many = int(os.environ.get("JAXSCAN_KILLS", "12"))
    rng = random.Random(f"killed {verb}")
    since = time.monotonic()
    child = workplace.start(verb)
    child.communicate(timeout=1800)
    assert child.returncode == 0
    whole_s = time.monotonic() - since
    faults, kinds = [], list(ANSWERS)
    for trial in range(many):
        workplace.clean()
        after = rng.uniform(0, 2) if trial % 2 else rng.uniform(0, min(whole_s, 40.0))
        number = kinds[trial // 2 % 2]
        cache = "warm" if trial % 4 < 2 else f"cold-{trial}"
        found = workplace.kill(verb, after, number, way=trial // 4 % 2, cache=cache)
        shutil.rmtree(workplace.folder.parent / f"cache-cold-{trial}", ignore_errors=True)
        faults += [f"{trial}: {number.name} after {after:.3f} s: {fault}" for fault in found]
    print(f"{verb}: {many} trials, {whole_s:.0f} s whole, {len(faults)} faults", *faults, sep="\n  ")
    assert faults == []


@needs_linux
@pytest.mark.slow
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("verb", [verb for verb in VERBS if not verb.startswith("doctor")])
def test_what_kill_leaves_beside_is_removed_by_the_next_run(workplace, verb):
    rng, left = random.Random(f"KILL {verb}"), 0
    for _ in range(int(os.environ.get("JAXSCAN_KILLS", "8")) // 8 or 1):
        workplace.clean()
        child = workplace.start(verb)
        # As soon as something is in work; most verbs have that for some milliseconds only.
        while child.poll() is None and not workplace.partial():
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.01))
        child.kill()
        child.communicate()
        left += bool(workplace.partial())
        assert workplace.incomplete() == []
        child = workplace.start(verb)
        _, said = child.communicate(timeout=1800)
        assert child.returncode == 0, said
        assert workplace.partial() == []
    print(f"{verb}: {left} kills left something")
