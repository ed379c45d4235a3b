"""Whether a change that matters is noticed: mutations of a capture, reconstructed, with and without a seal.

A small sweep is rendered once, as image files, as raw shards and as a mosaic. Each mutation is applied to a copy, which
is then reconstructed. The cloud has changed if at least ten points moved by more than three of their own sigmas,
appeared or vanished. The mutation is noticed if opening or reconstructing ends with an error, or gives a note that the
unchanged capture does not have. "sealed" captures are as jaxscan writes them; from "unsealed" ones all digests and the
seal were taken, so only plausibility is left. The calibration is the true one without covariance, so the sigmas are
those of the stripes alone, the strictest measure.

Of the unchanged capture a cloud is written too, as PLY, PCD and XYZ, and a bit of the file is turned, a digit is
changed, or a block is lost or exchanged. "sealed" files have the digest that jaxscan writes; XYZ has no place for one.
A cloud has changed if a point reads another place, sigma or colour; where the file is refused, that of the unsealed one
tells. Clouds are counted apart.

    python experiments/silent_differences.py [--each N] [--seed S] [--only KIND] [--json FILE] [--results DIR]
"""

import argparse
import json
import shutil
import sys
import tempfile
import time
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from worlds.capture_mutations import COLOURS, PICTURES, SHARDS
from worlds.journal_mutations import Mutation, Place, unseal

import jaxscan
from jaxscan.api import reconstruct_capture
from jaxscan.calibration import Calibration
from jaxscan.errors import JaxscanError
from jaxscan.files.calibration import calibration_notes
from jaxscan.files.clouds import load_cloud
from jaxscan.files.recording import repack_capture
from jaxscan.reconstruction import PointCloud
from jaxscan.simulation import SimulationConfig, true_scanner


CONFIG = Path(jaxscan.__file__).parent / "data" / "demo.toml"
EVERY = 4
"""45 of the 180 steps."""
MOVED = 3.0
"""Movement of a point that counts [sigma]."""
POINTS = 10
"""Points that must have moved."""
ASKED = {"sealed": 0.99, "unsealed": 0.90}
"""Share of the mutations that change the cloud which must be noticed."""


class Outcome(NamedTuple):
    """One mutation."""

    kind: str
    capture: str
    changed: bool
    noticed: bool
    said: str


def small(pixel_format: str, seed: int, yaw_deg: float) -> SimulationConfig:
    """The rig of the demo with a quarter of its pixels, in a room that is turned."""
    config = jaxscan.load_simulation(CONFIG)
    camera = config.camera.model_copy(
        update={"width": 320, "height": 256, "fx": 205.0, "fy": 205.25, "cx": 161.2, "cy": 127.05}
    )
    sensor = config.sensor.model_copy(update={"pixel_format": pixel_format})
    boards = config.boards.model_copy(update={"free_views": 0, "placements": 0})
    room = config.room.model_copy(update={"yaw_deg": yaw_deg})
    return config.model_copy(update={"camera": camera, "sensor": sensor, "boards": boards, "room": room, "seed": seed})


def make(folder: Path, seed: int) -> Path:
    """All captures and the calibration, once."""
    scanner = true_scanner(small("mono8", seed, 50.0))
    jaxscan.save_calibration(Calibration(scanner.camera, scanner, (), np.zeros((0, 0))), folder / "calibration.json")
    for name, config in (
        ("files", small("mono8", seed, 50.0)),
        ("other", small("mono8", seed + 1, 140.0)),
        ("mosaic", small("bayer_rggb8", seed, 50.0)),
    ):
        jaxscan.simulate(config, folder / "made", every=EVERY)
        # Image files, which the mutations edit; the storage of new captures has a checksum in every frame.
        repack_capture(folder / "made" / "sweep", folder / name, storage="png")
        shutil.rmtree(folder / "made")
    repack_capture(folder / "files", folder / "shards", storage="npy")
    for name in ("files", "shards", "mosaic"):
        shutil.copytree(folder / name, folder / f"{name} unsealed")
        unseal(folder / f"{name} unsealed")
    return folder


def reconstructed(place: Place, cache: bool) -> tuple[PointCloud | None, set[str]]:
    """The cloud, and all that was said; no cloud after an error."""
    try:
        capture = jaxscan.open_capture(place.sweep)
        notes = [*calibration_notes(place.calibration), *capture.notes]
        done = reconstruct_capture(capture, jaxscan.load_scanner(place.calibration), cache=cache)
    except JaxscanError as problem:
        return None, {f"error: {problem}"}
    numbers = np.array([record.i for record in capture.records])
    # Records by their own numbers, so that a missing one is missing.
    rows = np.full(int(numbers.max()) + 1, -1)
    rows[numbers] = np.arange(len(numbers))
    return _by_number(done.cloud, rows), {note.replace(str(place.sweep.parent), "") for note in (*notes, *done.notes)}


def _by_number(cloud: PointCloud, rows: np.ndarray) -> Any:
    valid = np.asarray(cloud.valid)[rows] & (rows >= 0)[:, None]
    return np.asarray(cloud.xyz)[rows], np.asarray(cloud.sigma_random)[rows], valid


def differs(one: Any, other: Any) -> bool:
    """Whether enough points have moved, appeared or vanished."""
    if one[0].shape[1:] != other[0].shape[1:]:
        return True
    count = min(len(one[0]), len(other[0]))
    gone = sum(int(cloud[2][count:].sum()) for cloud in (one, other))
    (xyz, sigma, valid), (xyz2, _, valid2) = ([field[:count] for field in cloud] for cloud in (one, other))
    moved = np.linalg.norm(xyz - xyz2, axis=-1) > MOVED * np.maximum(sigma, 1e-9)
    return gone + int(np.count_nonzero(valid != valid2) + np.count_nonzero(moved & valid & valid2)) >= POINTS


def attempt(base: Path, name: str, kind: str, mutate: Mutation, rng: np.random.Generator) -> tuple[Any, set[str]]:
    """A mutated copy, reconstructed."""
    with tempfile.TemporaryDirectory() as scratch:
        place = Place(Path(scratch) / "sweep", Path(scratch) / "calibration.json", base / "other")
        shutil.copytree(base / name, place.sweep)
        shutil.copy(base / "calibration.json", place.calibration)
        cached = kind.startswith("cache")
        if cached:
            reconstructed(place, True)
        mutate(place, rng)
        return reconstructed(place, cached)


def nothing(place: Place, rng: np.random.Generator) -> None:
    """The capture as it is."""


def run(base: Path, each: int, seed: int, only: str) -> list[Outcome]:
    """All mutations of all kinds."""
    outcomes: list[Outcome] = []
    for capture, kinds in (("files", PICTURES), ("shards", SHARDS), ("mosaic", COLOURS)):
        chosen = {kind: mutate for kind, mutate in kinds.items() if only in kind}
        matters: dict[tuple[str, int], bool] = {}
        # An error hides how the cloud would have changed; the same mutation of the unsealed capture shows it.
        for state in ("unsealed", "sealed") if chosen else ():
            name = capture if state == "sealed" else f"{capture} unsealed"
            before, usual = attempt(base, name, "", nothing, np.random.default_rng(0))
            if usual:
                print(f"false alarm, {name}: {usual}")
            for kind, mutate in chosen.items():
                if state == "unsealed" and kind.startswith("seal "):
                    continue
                for k in range(each):
                    rng = np.random.default_rng([seed, k, zlib.crc32(kind.encode())])
                    after, said = attempt(base, name, kind, mutate, rng)
                    changed = matters.get((kind, k), True) if after is None else differs(before, after)
                    matters[kind, k] = changed
                    new = said - usual
                    outcomes.append(Outcome(kind, state, changed, bool(new), "; ".join(sorted(new))[:300]))
    return outcomes


def _bit(data: bytearray, rng: np.random.Generator) -> bytearray:
    data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
    return data


def _block_lost(data: bytearray, rng: np.random.Generator) -> bytearray:
    at = int(rng.integers(len(data) - 4096))
    data[at : at + 4096] = bytes(4096)
    return data


def _block_moved(data: bytearray, rng: np.random.Generator) -> bytearray:
    a, b = (int(at) for at in rng.integers(len(data) - 4096, size=2))
    data[a : a + 4096] = data[b : b + 4096]
    return data


def _digit(data: bytearray, rng: np.random.Generator) -> bytearray:
    places = np.flatnonzero(np.isin(np.frombuffer(data, np.uint8), np.frombuffer(b"0123456789", np.uint8)))
    data[rng.choice(places)] = ord("0") + int(rng.integers(10))
    return data


CLOUDS = {
    "a bit turned": _bit,
    "a digit changed": _digit,
    "a block of zeros": _block_lost,
    "a block moved": _block_moved,
}


def run_clouds(base: Path, each: int, seed: int, only: str) -> list[Outcome]:
    """All mutations of the files of a cloud."""
    chosen = {
        f"cloud as {suffix}: {name}": (suffix, change)
        for suffix in ("ply", "pcd", "xyz")
        for name, change in CLOUDS.items()
        if only in f"cloud as {suffix}: {name}"
    }
    outcomes: list[Outcome] = []
    if chosen:
        capture = jaxscan.open_capture(base / "files")
        cloud = reconstruct_capture(capture, jaxscan.load_scanner(base / "calibration.json"), cache=False).cloud
    for kind, (suffix, change) in chosen.items():
        matters: dict[int, bool] = {}
        path = base / f"room.{suffix}"
        jaxscan.save_cloud(cloud, path)
        whole = path.read_bytes()
        before = load_cloud(path)
        for state in ("unsealed",) if suffix == "xyz" else ("unsealed", "sealed"):
            for k in range(each):
                # The same mutation of both; only the line's own name tells them apart.
                rng = np.random.default_rng([seed, k, zlib.crc32(kind.encode())])
                data = bytearray(whole if state == "sealed" else whole.replace(b"seal blake2b", b"mark blake2b"))
                path.write_bytes(change(data, rng))
                try:
                    changed, said = _reads_otherwise(before, load_cloud(path)), ""
                except JaxscanError as problem:
                    changed, said = matters.get(k, True), f"error: {problem}"
                matters[k] = changed
                outcomes.append(Outcome(kind, state, changed, bool(said), said[:300]))
    return outcomes


def _reads_otherwise(one: PointCloud, other: PointCloud) -> bool:
    if one.valid.shape != other.valid.shape or not np.array_equal(one.valid, other.valid):
        return True
    fields = ("xyz", "rgb", "sigma_random", "sigma_systematic")
    return not all(np.array_equal(getattr(one, name), getattr(other, name)) for name in fields)


def table(outcomes: list[Outcome]) -> str:
    """Counts per kind, as Markdown."""
    rows = ["| kind | sealed: noticed of changed | unsealed: noticed of changed |", "| --- | --- | --- |"]
    totals: dict[str, list[int]] = {"sealed": [0, 0], "unsealed": [0, 0]}
    for kind in dict.fromkeys(one.kind for one in outcomes):
        cells = []
        for state in totals:
            own = [one for one in outcomes if one.kind == kind and one.capture == state and one.changed]
            noticed = sum(one.noticed for one in own)
            totals[state] = [totals[state][0] + noticed, totals[state][1] + len(own)]
            cells.append(f"{noticed} of {len(own)}" if own else "–")
        rows.append(f"| {kind} | {cells[0]} | {cells[1]} |")
    parts = [f"{100 * seen / max(of, 1):.1f} % ({seen} of {of})" for seen, of in totals.values()]
    return "\n".join([*rows, f"| **all** | **{parts[0]}** | **{parts[1]}** |"])


def main() -> int:
    """Run, print the table, and say whether the limits are met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=10, help="mutations of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="kinds whose name has this text")
    parser.add_argument("--base", type=Path, help="folder for the rendered captures, used again if it exists")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--results", type=Path, help="folder for silent_differences.md")
    options = parser.parse_args()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        base = options.base or Path(scratch)
        if not (base / "shards unsealed").exists():
            base.mkdir(parents=True, exist_ok=True)
            make(base, options.seed)
        outcomes = run(base, options.each, options.seed, options.only)
        clouds = run_clouds(base, options.each, options.seed, options.only)
    text = "\n\n".join(table(part) for part in (outcomes, clouds) if part)
    print(text)
    print(f"{len(outcomes) + len(clouds)} mutations in {time.perf_counter() - start:.0f} s")
    sealed = [one.noticed for one in clouds if one.capture == "sealed" and one.changed]
    # Without a digest nothing compares the numbers of a cloud.
    met = sum(sealed) >= ASKED["sealed"] * len(sealed)
    for state, asked in ASKED.items():
        own = [one for one in outcomes if one.capture == state and one.changed]
        met &= sum(one.noticed for one in own) >= asked * len(own)
    if options.json:
        options.json.write_text(json.dumps([one._asdict() for one in (*outcomes, *clouds)], indent=1) + "\n")
    if options.results:
        command = f"python experiments/silent_differences.py --each {options.each} --seed {options.seed}"
        head = f"# Silent differences\n\nWritten by `{command}`; the file says how each column is counted.\n"
        (options.results / "silent_differences.md").write_text(f"{head}\n{text}\n")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
