"""Strict settings for every test: 64 bit, no silent promotion, shapes and types checked."""

import fcntl
import gc
import importlib.util
import json
import os
import shutil
import sys
from pathlib import Path
from typing import NamedTuple


# Of processes that share the cores each has one thread for products of matrices: more would wait for each other, and
# the tests of tables take twice the processor time. NumPy reads it when it is loaded, so it is for the processes that
# `-n` starts; a plugin has loaded NumPy in this one.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# With checks in every function, compiling the package to bytecode takes seconds: for all processes, once.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import jax  # noqa: E402
import pytest  # noqa: E402


# Compiling is most of the time that the tests take; the processes that share them share it too. The
# command line keeps its own in the same place.
CACHE = Path(__file__).resolve().parents[1] / ".pytest_cache" / "xdg"
os.environ["XDG_CACHE_HOME"] = str(CACHE)
jax.config.update("jax_compilation_cache_dir", str(CACHE / "jaxscan" / "compiled"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")


# Tracing makes objects by the million that all stay; looking through them for rubbish costs a fifth of it.
gc.set_threshold(100_000, 20, 100)

TESTS = Path(__file__).resolve().parent
FIRST = ("cli/test_chain.py", "reconstruction", "stripes", "calibration", "hardware", "test_api.py", "cli")
"""What takes long comes first, so that no process is left alone with it; and one process makes the tiny rig
while the other does what needs none."""


def pytest_addoption(parser):
    parser.addoption("--part", metavar="K/N", help="of the chosen tests every Nth, from the Kth on")


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config, items):
    """An order that keeps two processes busy to the end; whole files, and the tests of a file, stay as they are.

    Tests in a browser are marked `rig`. Without embreex, which ARM64 has not, the tests that render are skipped, by
    name; JAXSCAN_REQUIRE_SIMULATOR=1 refuses that.
    """

    def turn(item):
        path = item.path.relative_to(TESTS)
        return next((k for k, first in enumerate(FIRST) if first in (path.as_posix(), path.parts[0])), len(FIRST))

    items.sort(key=turn)
    problem = "" if importlib.util.find_spec("embreex") else "the simulator needs embreex"
    if problem and os.environ.get("JAXSCAN_REQUIRE_SIMULATOR"):
        raise pytest.UsageError(problem)
    for item in items:
        names = getattr(item, "fixturenames", ())
        if "browser" in names:
            item.add_marker(pytest.mark.rig)
        if problem and ("tiny" in names or "simulation" in item.path.parts):
            item.add_marker(pytest.mark.skip(reason=problem))
    yield  # Here pytest leaves out what -m does not name.
    if part := config.getoption("--part"):
        first, number = map(int, part.split("/"))
        chosen = items[first - 1 :: number]
        config.hook.pytest_deselected(items=[item for item in items if item not in set(chosen)])
        items[:] = chosen


@pytest.fixture(autouse=True)
def _no_colour(monkeypatch):
    monkeypatch.setenv("NO_COLOR", "1")


TINY = """
seed = 3
[camera]
width = 320
height = 256
fx = 215.0
fy = 215.2
cx = 161.2
cy = 127.1
k1 = -0.05
k2 = 0.01
[sensor]
psf_px = 0.8
[laser]
name = "red"
baseline_m = 0.3
crossing_m = 2.0
fan_deg = 110.0
waist_mm = 1.5
[turntable]
direction = [0.012, -0.99989, 0.008]
point_m = [0.12, 0.0, -0.06]
[room]
size_m = [3.2, 3.8, 2.4]
rig_m = [1.5, 1.8, 1.2]
furniture = false
[boards]
type = "chessboard"
columns = 7
rows = 5
square_mm = 80.0
free_views = 12
placements = 3
angles = 3
range_m = [0.7, 1.6]
[plan]
steps = 60
"""


class TinyRig(NamedTuple):
    """A small simulated rig that went the whole way once, on the command line. Copy, do not change."""

    folder: Path
    config: Path
    boards: Path
    sweep: Path
    truth: Path
    true_cloud: Path
    calibration: Path
    cloud: Path
    results: dict
    """What each verb wrote as JSON, by its name."""


@pytest.fixture(scope="session")
def tiny(tmp_path_factory):
    """Simulate, calibrate, reconstruct, measure: once for all tests, and for all processes that share them."""
    root = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        root = root.parent  # Every process has a folder of its own, in that of the whole run.
    folder = root / "tiny"
    with open(root / "tiny.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "complete").exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            go_the_whole_way(folder)
            (folder / "complete").touch()
    captures = folder / "captures"
    return TinyRig(
        folder,
        folder / "rig.toml",
        captures / "boards",
        captures / "sweep",
        captures / "truth.json",
        captures / "truth.npz",
        folder / "calibration.json",
        folder / "room.ply",
        {verb: json.loads((folder / f"{verb}.json").read_text()) for verb in VERBS},
    )


VERBS = {
    "simulate": "rig.toml -o captures",
    "calibrate": "captures/boards -o calibration.json",
    "reconstruct": "captures/sweep -c calibration.json -o room.ply",
    "measure-room": "room.ply -c calibration.json",
    "measure-compare": "room.ply captures/truth.npz -c calibration.json",
}


def go_the_whole_way(folder):
    """Every verb on the tiny rig, in a folder of its own."""
    from jaxscan.cli.main import main

    (folder / "rig.toml").write_text(TINY)
    for verb, words in VERBS.items():
        words = [word if word.startswith("-") else str(folder / word) for word in words.split()]
        assert main([*verb.split("-"), *words, "--json", str(folder / f"{verb}.json")]) == 0, verb
